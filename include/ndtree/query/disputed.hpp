// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where the evidence of a map contradicts itself in time.
#pragma once

#include <cmath>
#include <optional>
#include <type_traits>

#include "ndtree/cell/change_detection.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// Whether beams ended in a cell that the last scans, at least 12, all passed, or passed one in which they
/// all ended: see ChangeDetection. A cell that has changed has forgotten what was before, and is not disputed
/// any more. Never true of cells that count no streaks, as in fixed maps.
template <class Cell>
[[nodiscard]] bool is_disputed([[maybe_unused]] const Cell& cell) {
  if constexpr (std::is_same_v<Cell, EvidenceCell>)
    return ChangeDetection::is_disputed(cell);
  else
    return false;
}

/// The fraction of the observed volume that is disputed; none where nothing was observed, or cells count no
/// streaks. O(leaves).
template <class Map>
[[nodiscard]] std::optional<double> disputed_fraction(const Map& map) {
  double observed = 0.0;
  double disputed = 0.0;
  if constexpr (std::is_same_v<typename Map::Cell, EvidenceCell>) {
    const auto& geometry = map.tree().geometry();
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      if (!leaf.cell().observed()) return;
      const double volume = std::pow(geometry.cell_size(leaf.index.level), Map::kDim);
      observed += volume;
      disputed += is_disputed(leaf.cell()) ? volume : 0.0;
    });
  }
  if (observed == 0.0) return std::nullopt;
  return disputed / observed;
}

}  // namespace ndtree
