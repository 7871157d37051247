// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Pieces of surface that a scan sees, and what their scores tell of one pose against another.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ndtree/core/types.hpp"

namespace ndtree {

/// End points on one piece are wrong alike, and count once. O(points log points).
template <int D>
class ScanPieces {
 public:
  /// @param points of a scan, finite [m]. @param size of a piece [m].
  ScanPieces(const Points<D>& points, double size) : piece_of_(static_cast<std::size_t>(points.cols())) {
    using Key = std::array<std::int64_t, std::size_t{D}>;
    std::vector<std::pair<Key, std::size_t>> keyed(piece_of_.size());
    for (std::size_t i = 0; i < keyed.size(); ++i) {
      keyed[i].second = i;
      for (int a = 0; a < D; ++a)
        keyed[i].first[static_cast<std::size_t>(a)] =
            static_cast<std::int64_t>(std::floor(points(a, static_cast<Eigen::Index>(i)) / size));
    }
    std::sort(keyed.begin(), keyed.end());
    for (std::size_t i = 0; i < keyed.size(); ++i) {
      if (i == 0 || keyed[i].first != keyed[i - 1].first) ++count_;
      piece_of_[keyed[i].second] = count_ - 1;
    }
  }
  [[nodiscard]] std::size_t count() const { return count_; }

  /// What points' scores at a pose tell for it against those at the best, as a log-likelihood.
  ///
  /// A sum over many pieces differs by chance, too. So it tells no more than that the pieces' changes have a
  /// mean beside their own spread (Q. H. Vuong, "Likelihood ratio tests for model selection and non-nested
  /// hypotheses", Econometrica 57, 1989). @param worth score that is a log-likelihood of 1.
  [[nodiscard]] double told(const std::vector<std::int32_t>& best, const std::vector<std::int32_t>& scores,
                            double worth) const {
    std::vector<double> changes(count_, 0.0);
    for (std::size_t i = 0; i < piece_of_.size(); ++i) changes[piece_of_[i]] += scores[i] - best[i];
    double changed = 0.0;
    double sum = 0.0;
    double squares = 0.0;
    for (const double change : changes) {
      changed += change != 0.0 ? 1.0 : 0.0;
      sum += change;
      squares += change * change;
    }
    if (squares == 0.0) return 0.0;
    const double mean = -0.5 * changed * std::log1p(-sum * sum / (changed * squares));  // May be infinite.
    return std::copysign(std::min(std::abs(sum) / worth, mean), sum);
  }

 private:
  std::vector<std::size_t> piece_of_;
  std::size_t count_ = 0;
};

}  // namespace ndtree
