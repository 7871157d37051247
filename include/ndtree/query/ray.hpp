// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Ray casts through a map.
#pragma once

#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/beam_traversal.hpp"

namespace ndtree {

namespace detail {

template <int D>
struct FirstOccupied : BeamVisitor {
  std::optional<double> t;
  CellIndex<D> leaf_index;
  template <class Ref>
  bool passes_over(const Ref& parent) {
    return !Summary::of(*parent.node).may_contain(CellState::occupied);
  }
  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double) {
    if (leaf.cell().state() != CellState::occupied) return true;
    t = t_enter;
    leaf_index = leaf.index;
    return false;
  }
};

/// The first leaf that is not free.
template <int D>
struct FirstNotFree : BeamVisitor {
  std::optional<double> t;  // Where the ray enters it.
  CellIndex<D> leaf_index;
  CellState state = CellState::unknown;
  double t_inside = 0.0;  // Up to there the ray was in the map.
  bool entered = false;
  double t_first = 0.0;

  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    if (!entered) t_first = t_enter;
    entered = true;
    t_inside = t_exit;
    state = leaf.cell().state();
    if (state == CellState::free) return true;
    t = t_enter;
    leaf_index = leaf.index;
    return false;
  }
};

/// A direction whose length neither overflows nor underflows. Others are scaled by a power of 2, exactly.
template <int D>
[[nodiscard]] Vector<D> of_usual_length(Vector<D> direction) {
  constexpr int kUsual = 500;  // Binary exponents up to this.
  const double largest = direction.cwiseAbs().maxCoeff();
  if (!std::isfinite(largest) || largest == 0.0) return direction;  // Which is refused.
  int exponent = 0;
  (void)std::frexp(largest, &exponent);
  if (std::abs(exponent) > kUsual)
    for (double& component : direction) component = std::ldexp(component, -exponent);
  return direction;
}

inline void check_ray(bool finite, double length, double max_range) {
  if (!finite || !(length > 0.0))
    throw std::invalid_argument("ray: origin and direction must be finite, and the direction not zero");
  if (!(max_range > 0.0))
    throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
}

}  // namespace detail

/// Where a ray ends.
template <int D>
struct RayEnd {
  double distance;             ///< From the origin [m].
  CellState state;             ///< Of the space that it meets there.
  std::optional<Box<D>> cell;  ///< The leaf; none outside the map.
};

/// As cast_ray(), with what the ray ends at. @param stops_at_unknown whether unknown space ends it as well:
/// also that outside the map, where it leaves the map, or begins outside it.
/// @throws as cast_ray().
template <class Map>
[[nodiscard]] std::optional<RayEnd<Map::kDim>> trace_ray(const Map& map, const Vector<Map::kDim>& origin,
                                                         const Vector<Map::kDim>& towards, double max_range,
                                                         bool stops_at_unknown) {
  constexpr int D = Map::kDim;
  const Vector<D> direction = detail::of_usual_length<D>(towards);
  const double length = direction.norm();
  detail::check_ray(origin.allFinite() && direction.allFinite(), length, max_range);
  if (!stops_at_unknown) {
    detail::FirstOccupied<D> first;
    traverse_beam(map.tree(), origin, direction, 0.0, max_range / length, first);
    if (!first.t) return std::nullopt;
    return RayEnd<D>{*first.t * length, CellState::occupied, map.tree().box(first.leaf_index)};
  }
  detail::FirstNotFree<D> first;
  const double t_end = max_range / length;
  traverse_beam(map.tree(), origin, direction, 0.0, t_end, first);
  if (!first.entered || first.t_first > 0.0) return RayEnd<D>{0.0, CellState::unknown, std::nullopt};
  if (first.t) return RayEnd<D>{*first.t * length, first.state, map.tree().box(first.leaf_index)};
  const double inside = first.t_inside * length;
  if (!(first.t_inside < t_end && inside < max_range)) return std::nullopt;  // t_end * length may be less.
  return RayEnd<D>{inside, CellState::unknown, std::nullopt};
}

/// Distance [m] from `origin` to where the ray enters the first occupied leaf; 0 if it starts in one; none if
/// there is none within `max_range` [m]. Unknown space does not stop a ray. The direction may have any length
/// but zero.
/// @throws std::invalid_argument if origin or direction is not finite, the direction zero or max_range not >
/// 0.
template <class Map>
[[nodiscard]] std::optional<double> cast_ray(const Map& map, const Vector<Map::kDim>& origin,
                                             const Vector<Map::kDim>& towards, double max_range) {
  const Vector<Map::kDim> direction = detail::of_usual_length<Map::kDim>(towards);
  const double length = direction.norm();
  detail::check_ray(origin.allFinite() && direction.allFinite(), length, max_range);
  detail::FirstOccupied<Map::kDim> first;
  traverse_beam(map.tree(), origin, direction, 0.0, max_range / length, first);
  return first.t ? std::optional<double>(*first.t * length) : std::nullopt;
}

}  // namespace ndtree
