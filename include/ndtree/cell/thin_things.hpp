// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Smallest cells that are free, but known to hold something thin.
#pragma once

#include <limits>
#include <type_traits>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/log_odds.hpp"

namespace ndtree {

/// Which cells of a map are free, but hold something: see EvidenceRefinement::keep_partial(). None of maps
/// that keep no such cells. O(1).
class ThinThings {
 public:
  /// Of no map: there are none.
  ThinThings() = default;
  template <class Map>
  explicit ThinThings(const Map& map) {
    constexpr double kRounding = 1e-4;  // Of a cell's log-odds.
    if constexpr (std::is_same_v<typename Map::Tree::Cell, EvidenceCell>)
      if (map.options().partial_probability > 0.0)
        least_ = static_cast<float>(log_odds(map.options().partial_probability) - kRounding);
  }

  template <class Cell>
  [[nodiscard]] bool are_in(const Cell& cell) const {
    return cell.log_odds() >= least_ && cell.state() == CellState::free && cell.hits() >= kLeastHits;
  }
  /// Whether a node has, or might have, such a cell.
  [[nodiscard]] bool may_be_below(const Summary& summary) const {
    return !summary.is_valid() || (summary.may_contain(CellState::free) && summary.max_log_odds() >= least_);
  }
  /// The state of a cell for a robot that drives there: a shelf that beams meet at a grazing angle, a fence
  /// and a pane are in no cell but such.
  template <class Cell>
  [[nodiscard]] CellState state_in_column(const Cell& cell) const {
    return are_in(cell) ? CellState::occupied : cell.state();
  }

 private:
  static constexpr std::uint32_t kLeastHits = 2;  // One may be an outlier.
  float least_ = std::numeric_limits<float>::infinity();
};

}  // namespace ndtree
