// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Ray casts through a map.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/beam_traversal.hpp"

namespace ndtree {

namespace detail {

struct FirstOccupied : BeamVisitor {
  std::optional<double> t;
  template <class Ref>
  bool passes_over(const Ref& parent) {
    return !Summary::of(*parent.node).may_contain(CellState::occupied);
  }
  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double) {
    if (leaf.cell().state() != CellState::occupied) return true;
    t = t_enter;
    return false;
  }
};

}  // namespace detail

/// Distance [m] from `origin` to where the ray enters the first occupied leaf; 0 if it starts in one; none if
/// there is none within `max_range` [m]. Unknown space does not stop a ray. The direction may have any length
/// but zero.
/// @throws std::invalid_argument if origin or direction is not finite, the direction zero or max_range not >
/// 0.
template <class Map>
[[nodiscard]] std::optional<double> cast_ray(const Map& map, const Vector<Map::kDim>& origin,
                                             const Vector<Map::kDim>& direction, double max_range) {
  const double length = direction.stableNorm();  // Neither overflows nor underflows.
  if (!origin.allFinite() || !(length > 0.0) || !direction.allFinite())
    throw std::invalid_argument("ray: origin and direction must be finite, and the direction not zero");
  if (!(max_range > 0.0))
    throw std::invalid_argument("max_range = " + std::to_string(max_range) + " m: must be > 0");
  detail::FirstOccupied first;
  traverse_beam(map.tree(), origin, direction, 0.0, max_range / length, first);
  return first.t ? std::optional<double>(*first.t * length) : std::nullopt;
}

}  // namespace ndtree
