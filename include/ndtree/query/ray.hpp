// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Ray casts through a map, and the cells that a beam reaches.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/hit_rate.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/types.hpp"
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
                    const HitRate rate = model(cell, map.edge_in_smallest(leaf.index.level));
                    visit(CellOnBeam{cell.state(), rate.mean(), geometry.cell_size(leaf.index.level),
                                     rate.beams(), t_exit > 1.0});
                  }
                  return t_exit <= 1.0;
                });
}

namespace detail {

/// Of a free cell with evidence for occupied space, and at most four times as much for free space.
inline constexpr float kLeastOfEnd = -1.4f;
/// Whether beams may have ended in a free cell, beside those that passed it. Of maps that keep no evidence,
/// this is not known.
template <class Cell>
[[nodiscard]] bool may_end_beams(const Cell& cell) {
  if constexpr (std::is_same_v<Cell, EvidenceCell>)
    return cell.occupied_evidence() > 0 && cell.log_odds() >= kLeastOfEnd;
  else
    return false;
}

/// Where a ray meets a surface: at the first leaf that is occupied, or that is free, may_end_beams() and has
/// unknown space behind it. Of the cells that a surface passes through, beams beside it make some free; no
/// beam has gone on from there into the unknown, so the surface is in between, at most a smallest cell before
/// the unknown.
template <int D>
class FirstSurface : public BeamVisitor {
 public:
  /// @param t_cell length of a smallest cell along the ray.
  FirstSurface(double t_cell, bool stops_at_unknown) : t_cell_(t_cell), stops_at_unknown_(stops_at_unknown) {}

  std::optional<double> t;  ///< Where the ray enters the leaf that it ends at, or the surface in it.
  CellIndex<D> leaf_index;
  CellState state = CellState::unknown;  ///< Of what it meets there.
  double t_inside = 0.0;                 ///< Up to there the ray was in the map.
  std::optional<double> t_first;         ///< Where it entered the map.

  template <class Ref>
  bool passes_over(const Ref& parent) {
    if (stops_at_unknown_) return false;
    const Summary all = Summary::of(*parent.node);
    if (!all.is_valid() || all.may_contain(CellState::occupied)) return false;
    if (all.may_contain(CellState::free) ? all.max_log_odds() >= kLeastOfEnd : t_partial_.has_value())
      return false;
    t_partial_.reset();
    return true;
  }
  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    if (!t_first) t_first = t_enter;
    t_inside = t_exit;
    const auto& cell = leaf.cell();
    state = cell.state();
    if (state == CellState::free) {
      t_partial_.reset();
      if (may_end_beams(cell)) {
        t_partial_ = std::max(t_enter, t_exit - t_cell_);
        leaf_index = leaf.index;
      }
      return true;
    }
    if (state == CellState::unknown && t_partial_) return meet(CellState::occupied, *t_partial_);
    if (state == CellState::unknown && !stops_at_unknown_) return true;
    leaf_index = leaf.index;
    return meet(state, t_enter);
  }
  /// To be called at the end. @param t_end of the ray: it may have left the map before.
  void finish(double t_end) {
    if (!t && t_partial_ && t_inside < t_end) meet(CellState::occupied, *t_partial_);
  }

 private:
  bool meet(CellState what, double at) {
    t = at;
    state = what;
    return false;
  }

  double t_cell_;
  bool stops_at_unknown_;
  std::optional<double> t_partial_;  // Where a surface is in the leaf before, if beams may have ended in it.
};

template <class Map>
[[nodiscard]] FirstSurface<Map::kDim> first_surface(const Map& map, const Vector<Map::kDim>& origin,
                                                    const Vector<Map::kDim>& direction, double t_end,
                                                    bool stops_at_unknown) {
  FirstSurface<Map::kDim> first(map.smallest_cell() / direction.norm(), stops_at_unknown);
  traverse_beam(map.tree(), origin, direction, 0.0, t_end, first);
  first.finish(t_end);
  return first;
}

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
    const double rate =
        leaf.cell().observed() ? HitRateModel::kMostInAny * model(leaf.cell(), 1.0).fraction() : 0.0;
    return end.pass(rate, t_enter, t_exit);
  }
};

/// @param t_enter where the ray enters an occupied cell.
template <class Map>
[[nodiscard]] double surface_behind(const Map& map, const Vector<Map::kDim>& origin,
                                    const Vector<Map::kDim>& direction, double t_enter, double length) {
  EndOfBeams<Map> beams(map, t_enter + kMostDepth * map.smallest_cell() / length);
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
  const double t_end = max_range / length;
  const auto first = detail::first_surface(map, origin, direction, t_end, stops_at_unknown);
  if (stops_at_unknown && !(first.t_first && *first.t_first <= 0.0))
    return RayEnd<D>{0.0, CellState::unknown, std::nullopt};
  if (first.t)
    return RayEnd<D>{distance_to(*first.t, first.state), first.state, map.tree().box(first.leaf_index)};
  const double inside = first.t_inside * length;
  if (!stops_at_unknown || !(first.t_inside < t_end && inside < max_range))  // t_end * length may be less.
    return std::nullopt;
  return RayEnd<D>{inside, CellState::unknown, std::nullopt};
}

/// Distance [m] from `origin` to where the surface is likely to be in the first occupied leaf that the ray
/// enters within `max_range` [m]; none if there is none. Unknown space does not stop a ray; but where it goes
/// into the unknown from a free cell in which beams have ended, that cell counts as occupied. The direction
/// may have any length but zero.
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
  const auto first = detail::first_surface(map, origin, direction, max_range / length, false);
  if (!first.t) return std::nullopt;
  return (aim == RayAim::cell ? *first.t : detail::surface_behind(map, origin, direction, *first.t, length)) *
         length;
}

}  // namespace ndtree
