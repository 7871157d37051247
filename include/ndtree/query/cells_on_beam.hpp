// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The cells that a beam reaches, and the probability that it ends in each.
#pragma once

#include <limits>

#include "ndtree/cell/hit_rate.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/tree/beam_traversal.hpp"

namespace ndtree {

/// What a map says about one cell on a beam's way.
struct CellOnBeam {
  CellState state = CellState::unknown;
  double hit_rate = 0.0;  ///< Probability that a beam which reaches the cell ends in it.
  double size = 0.0;      ///< Its edge [m].
  double beams = std::numeric_limits<double>::quiet_NaN();  ///< That its evidence is worth; NaN: not kept.
  bool ends_beam = false;  ///< The end point lies in it; on a border, the beam would enter it next.
};

/// Calls `visit(const CellOnBeam&)` for each observed cell that a beam reaches, in order, to that of its end
/// point. @pre the end point is not the origin.
template <class Map, class Visit>
void for_each_cell_on(const Map& map, const Beam<Map::kDim>& beam, const Visit& visit) {
  const HitRateModel model(map.options());
  const auto& geometry = map.tree().geometry();
  traverse_beam(map.tree(), beam.origin, beam.displacement, 0.0, std::numeric_limits<double>::infinity(),
                [&](const auto& leaf, double t_enter, double t_exit) {
                  if (t_enter > 1.0) return false;
                  const auto& cell = leaf.cell();
                  if (cell.observed()) {
                    const HitRate rate = model(cell, static_cast<double>(geometry.edge(leaf.index.level)));
                    visit(CellOnBeam{cell.state(), rate.mean(), geometry.cell_size(leaf.index.level),
                                     rate.beams(), t_exit > 1.0});
                  }
                  return t_exit <= 1.0;
                });
}

}  // namespace ndtree
