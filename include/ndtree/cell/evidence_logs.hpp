// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The logarithms of all evidence that a cell can hold, so that a cell's log-odds is a difference.
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

namespace ndtree {

/// log(evidence + prior) less a constant, for evidence in [0, EvidenceCell::kMaxEvidence]: 256 kB, one for
/// all models of a prior. Larger evidence has a larger one, however little larger, and differences are within
/// 1e-6 where the prior is at least 0.01 nats. (For less, within 2e-6 where one of the two is no evidence.)
class EvidenceLogs {
 public:
  /// @param prior > 0, in EvidenceCell::kUnit.
  explicit EvidenceLogs(double prior) {
    // The logarithms of much evidence, which are closest together, are near 0, and so told apart best.
    constexpr double kMuch = 16.0 / EvidenceCell::kUnit;
    const double inverse = 1.0 / std::max(prior, kMuch);
    for (std::size_t evidence = 0; evidence < logs_.size(); ++evidence)
      logs_[evidence] = static_cast<float>(quick_log((static_cast<double>(evidence) + prior) * inverse));
  }
  [[nodiscard]] static std::shared_ptr<const EvidenceLogs> of_prior(double prior) {
    return shared_table<const EvidenceLogs>(prior,
                                            [&] { return std::make_shared<const EvidenceLogs>(prior); });
  }

  /// @pre evidence is in [0, EvidenceCell::kMaxEvidence].
  [[nodiscard]] float operator[](std::int64_t evidence) const {
    assert(evidence >= 0 && evidence <= EvidenceCell::kMaxEvidence);
    return logs_[static_cast<std::size_t>(evidence)];
  }

 private:
  std::array<float, std::size_t{EvidenceCell::kMaxEvidence} + 1> logs_;
};

}  // namespace ndtree
