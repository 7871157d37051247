// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The logarithms of evidence, so that a cell's log-odds is a difference of two.
#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/shared_table.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/unfused.hpp"

namespace ndtree {

/// log(evidence + prior) less a constant, for evidence in [0, EvidenceCell::kMaxEvidence]: one by one up to
/// 64 nats, else at every 16th. One table of 76 kB for all models of a prior. Larger
/// evidence has a larger one, however little larger, and differences are within 1e-6 where the prior is at
/// least 0.01 nats. (For less, within 2e-6 where one of the two is no evidence.)
class EvidenceLogs {
 public:
  /// @param prior > 0, in EvidenceCell::kUnit.
  explicit EvidenceLogs(double prior) {
    const double inverse = 1.0 / std::max(prior, kMuch);
    for (std::size_t i = 0; i < logs_.size(); ++i)
      logs_[i] = static_cast<float>(quick_log((static_cast<double>(i) + prior) * inverse));
    for (std::size_t i = 0; i < of_many_.size(); ++i) {
      // Between two points of a logarithm a straight line is too low by up to an eighth of this, squared.
      const double evidence = static_cast<double>(kInTable + static_cast<std::int64_t>(i) * kStep) + prior;
      const double bend = kStep / evidence;
      of_many_[i] = static_cast<float>(quick_log(evidence * inverse) + bend * bend / 16.0);
    }
  }
  [[nodiscard]] static std::shared_ptr<const EvidenceLogs> of_prior(double prior) {
    return shared_table<const EvidenceLogs>(prior,
                                            [&] { return std::make_shared<const EvidenceLogs>(prior); });
  }

  /// @pre evidence is in [0, EvidenceCell::kMaxEvidence].
  [[nodiscard]] NDTREE_ALWAYS_INLINE float operator[](std::int64_t evidence) const {
    assert(evidence >= 0 && evidence <= EvidenceCell::kMaxEvidence);
    return evidence < kInTable ? logs_[static_cast<std::size_t>(evidence)] : of_many(evidence);
  }

 private:
  // The logarithms of much evidence, which are closest together, are near 0, and so told apart best.
  static constexpr double kMuch = 16.0 / EvidenceCell::kUnit;
  static constexpr std::int64_t kInTable = 1 << 14;
  static constexpr std::int64_t kStep = 16;  // Of larger evidence; in between, straight lines within 1e-7.

  [[nodiscard]] NDTREE_ALWAYS_INLINE float of_many(std::int64_t evidence) const {
    const auto step = static_cast<std::size_t>((evidence - kInTable) / kStep);
    const float below = of_many_[step];
    return below +
           unfused(static_cast<float>(evidence % kStep) * (1.0f / kStep) * (of_many_[step + 1] - below));
  }

  std::array<float, std::size_t{kInTable}> logs_;
  std::array<float, std::size_t{(EvidenceCell::kMaxEvidence + 1 - kInTable) / kStep + 1}> of_many_;
};

}  // namespace ndtree
