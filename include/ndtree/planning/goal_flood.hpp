// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Whether cells around a goal end before a search has come to one of them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/planning/number_table.hpp"
#include "ndtree/planning/place_cell.hpp"

namespace ndtree::detail {

/// Whether two sets of cells are joined, as far as one has looked.
enum class Joined { yes, no, perhaps };

/// All cells that are joined to those of a goal, a few at a time: in a small part of a space they end soon,
/// however large the part is in which one looks for the goal.
template <class Space>
class GoalFlood {
 public:
  using Cell = PlaceCell<Space::D>;

  explicit GoalFlood(Space& space) : space_(space) {}
  void add(const Cell& cell) {
    std::uint32_t& seen = seen_[cell.number];
    if (seen != NumberTable::kNone) return;
    seen = 0;
    cells_.push_back(cell);
  }
  /// Goes on until `count` cells were looked at. @param met whether a cell belongs to what is looked for.
  template <class Met>
  Joined run(std::size_t count, const Met& met) {
    for (; at_ < cells_.size() && at_ < count; ++at_) {
      pace_.spend(20);
      const Cell cell = cells_[at_];
      if (met(cell)) return Joined::yes;
      space_.for_each_beside(cell, [&](const Cell& beside) { add(beside); });
    }
    return at_ < cells_.size() ? Joined::perhaps : Joined::no;
  }

 private:
  Space& space_;
  std::vector<Cell> cells_;
  std::size_t at_ = 0;
  NumberTable seen_;
  Pace pace_;
};

}  // namespace ndtree::detail
