// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// When N^D siblings merge, and what their parent is then (Sec. III-B).
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/log_odds.hpp"

namespace ndtree {

struct MergeOptions {
  double merge_free_below = 0.13;      ///< Siblings merge if all are at most this probable,
  double merge_occupied_above = 0.96;  ///< or all at least this.
};

/// Siblings merge where all are almost surely free, or all almost surely occupied. The parent gets the mean
/// of their probabilities and the sum of their counts, unless these would split it again at once.
class SameStateMergeRule {
 public:
  explicit SameStateMergeRule(const MergeOptions& options)
      : free_below_(static_cast<float>(log_odds(options.merge_free_below))),
        occupied_above_(static_cast<float>(log_odds(options.merge_occupied_above))) {}

  /// A cell that could take part in a merge.
  [[nodiscard]] bool is_extreme(const OccupancyCell& cell) const {
    return cell.log_odds() <= free_below_ || cell.log_odds() >= occupied_above_;
  }

  /// @param siblings nodes; they merge only if all are leaves. @param splits the split test.
  /// @returns the parent's cell, or none if the siblings stay. O(siblings).
  template <class NodeType, class SplitTest>
  [[nodiscard]] std::optional<OccupancyCell> operator()(const NodeType* siblings, int count,
                                                        const SplitTest& splits) const {
    const bool free = siblings[0].is_leaf() && siblings[0].cell().log_odds() <= free_below_;
    for (int j = 0; j < count; ++j) {
      if (!siblings[j].is_leaf()) return std::nullopt;
      const float value = siblings[j].cell().log_odds();
      if (free ? value > free_below_ : value < occupied_above_) return std::nullopt;
    }
    double sum = 0.0;
    float lowest = siblings[0].cell().log_odds();
    float highest = lowest;
    std::uint32_t hits = 0;
    std::uint32_t misses = 0;
    for (int j = 0; j < count; ++j) {
      sum += siblings[j].cell().probability();
      lowest = std::min(lowest, siblings[j].cell().log_odds());
      highest = std::max(highest, siblings[j].cell().log_odds());
      hits += siblings[j].cell().hits();
      misses += siblings[j].cell().misses();
    }
    OccupancyCell parent;
    parent.set_counts(hits, misses);
    if (splits(parent)) return std::nullopt;
    // The mean lies among its parts; near 0 and 1 rounding would leave them.
    parent.set_log_odds(std::clamp(static_cast<float>(log_odds(sum / count)), lowest, highest));
    return parent;
  }

 private:
  float free_below_;
  float occupied_above_;
};

}  // namespace ndtree
