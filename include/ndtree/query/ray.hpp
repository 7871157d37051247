// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Ray casts through a map.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>

#include "ndtree/cell/hit_rate.hpp"
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

/// A surface is at most this many smallest cells behind where a ray enters its first occupied cell:
/// where few beams have ended, half of those that come would end farther behind than the surface is.
inline constexpr double kMostDepth = 0.75;

/// Where half of the beams that reach a cell end, in it or behind: the beams go from cell to cell, and in
/// each its hit rate ends some, with the same probability in each part of the way through it. At most a
/// limit.
class MedianEnd {
 public:
  explicit MedianEnd(double t_limit) : t_limit_(t_limit), t_(t_limit) {}

  /// The next cell. @param rate [0, 1); 0 in unknown space. @returns whether the beams go on.
  bool pass(double rate, double t_enter, double t_exit) {
    const double left = left_ * (1.0 - rate);
    if (left <= 0.5) {
      const double part = std::log(2.0 * left_) / -std::log1p(-rate);
      t_ = std::min(t_limit_, t_enter + part * (t_exit - t_enter));
      return false;
    }
    left_ = left;
    return t_exit < t_limit_;
  }
  [[nodiscard]] double t() const { return t_; }

 private:
  double t_limit_;
  double t_;
  double left_ = 1.0;  // Fraction of the beams.
};

template <class Map>
struct EndOfBeams : BeamVisitor {
  MedianEnd end;
  HitRateModel model;

  EndOfBeams(const Map& map, double t_limit) : end(t_limit), model(map.options()) {}
  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    return end.pass(leaf.cell().observed() ? model(leaf.cell()).mean() : 0.0, t_enter, t_exit);
  }
};

/// @param t_enter where the ray enters an occupied cell.
template <class Map>
[[nodiscard]] double surface_behind(const Map& map, const Vector<Map::kDim>& origin,
                                    const Vector<Map::kDim>& direction, double t_enter, double length) {
  EndOfBeams<Map> beams(map, t_enter + kMostDepth * map.options().min_cell_size / length);
  traverse_beam(map.tree(), origin, direction, t_enter, std::numeric_limits<double>::infinity(), beams);
  return beams.end.t();
}

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

/// What is meant by the distance to an occupied cell: to where the ray enters it; or to the surface, which is
/// where half of the beams that come this way would end by now, at most 3/4 of a smallest cell behind that.
enum class RayAim { cell, surface };

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
                                                         bool stops_at_unknown,
                                                         RayAim aim = RayAim::surface) {
  constexpr int D = Map::kDim;
  const Vector<D> direction = detail::of_usual_length<D>(towards);
  const double length = direction.norm();
  detail::check_ray(origin.allFinite() && direction.allFinite(), length, max_range);
  const auto distance_to = [&](double t, CellState state) {
    const bool estimates = aim == RayAim::surface && state == CellState::occupied;
    return (estimates ? detail::surface_behind(map, origin, direction, t, length) : t) * length;
  };
  if (!stops_at_unknown) {
    detail::FirstOccupied<D> first;
    traverse_beam(map.tree(), origin, direction, 0.0, max_range / length, first);
    if (!first.t) return std::nullopt;
    const CellState state = CellState::occupied;
    return RayEnd<D>{distance_to(*first.t, state), state, map.tree().box(first.leaf_index)};
  }
  detail::FirstNotFree<D> first;
  const double t_end = max_range / length;
  traverse_beam(map.tree(), origin, direction, 0.0, t_end, first);
  if (!first.entered || first.t_first > 0.0) return RayEnd<D>{0.0, CellState::unknown, std::nullopt};
  if (first.t)
    return RayEnd<D>{distance_to(*first.t, first.state), first.state, map.tree().box(first.leaf_index)};
  const double inside = first.t_inside * length;
  if (!(first.t_inside < t_end && inside < max_range)) return std::nullopt;  // t_end * length may be less.
  return RayEnd<D>{inside, CellState::unknown, std::nullopt};
}

/// Distance [m] from `origin` to where the surface is likely to be in the first occupied leaf that the ray
/// enters within `max_range` [m]; none if there is none. Unknown space does not stop a ray. The direction may
/// have any length but zero.
/// @param aim cell: instead, to where the ray enters that leaf, 0 if it starts in one; at most 3/4 of a
/// smallest cell shorter.
/// @throws std::invalid_argument if origin or direction is not finite, the direction zero or max_range not >
/// 0.
template <class Map>
[[nodiscard]] std::optional<double> cast_ray(const Map& map, const Vector<Map::kDim>& origin,
                                             const Vector<Map::kDim>& towards, double max_range,
                                             RayAim aim = RayAim::surface) {
  const Vector<Map::kDim> direction = detail::of_usual_length<Map::kDim>(towards);
  const double length = direction.norm();
  detail::check_ray(origin.allFinite() && direction.allFinite(), length, max_range);
  detail::FirstOccupied<Map::kDim> first;
  traverse_beam(map.tree(), origin, direction, 0.0, max_range / length, first);
  if (!first.t) return std::nullopt;
  return (aim == RayAim::cell ? *first.t : detail::surface_behind(map, origin, direction, *first.t, length)) *
         length;
}

}  // namespace ndtree
