// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How fine a map is, and where: the policies that tell an adaptive map from a fixed one.
#pragma once

#include <optional>

#include "ndtree/cell/merge_rule.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/split_test.hpp"
#include "ndtree/mapping/map_options.hpp"

namespace ndtree {

/// Cells start at max_cell_size, split where the counts contradict each other and merge where all agree,
/// exactly as the paper has it (Sec. III-A, III-B).
struct PaperRefinement {
  static constexpr const char* kName = "paper";
  static constexpr bool kAdaptive = true;

  ChiSquareSplitTest split_test;
  SameStateMergeRule merge_rule;

  explicit PaperRefinement(const MapOptions& options) : split_test(options), merge_rule(options) {}

  /// Leaves above this level are unknown space and are divided before a beam updates them.
  [[nodiscard]] static int coarsest_level(int /*finest_level*/) { return 0; }
  [[nodiscard]] bool splits(const OccupancyCell& cell) const { return split_test(cell); }
  [[nodiscard]] bool may_merge(const OccupancyCell& updated) const { return merge_rule.is_extreme(updated); }
  template <class NodeType>
  [[nodiscard]] std::optional<OccupancyCell> merged(const NodeType* siblings, int count) const {
    return merge_rule(siblings, count, split_test);
  }
};

/// Every cell that a beam updates has min_cell_size: the fixed-resolution grid, by the same code.
struct FixedRefinement {
  static constexpr const char* kName = "fixed";
  static constexpr bool kAdaptive = false;

  explicit FixedRefinement(const MapOptions&) {}

  [[nodiscard]] static int coarsest_level(int finest_level) { return finest_level; }
  [[nodiscard]] static bool splits(const OccupancyCell&) { return false; }
  [[nodiscard]] static bool may_merge(const OccupancyCell&) { return false; }
  template <class NodeType>
  [[nodiscard]] static std::optional<OccupancyCell> merged(const NodeType*, int) {
    return std::nullopt;
  }
};

}  // namespace ndtree
