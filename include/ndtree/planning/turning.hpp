// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Paths in the plane of a body that turns in place and moves without turning in between.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/coarse_space.hpp"
#include "ndtree/planning/path_search.hpp"
#include "ndtree/planning/planner.hpp"
#include "ndtree/planning/sweep.hpp"
#include "ndtree/query/collision.hpp"

namespace ndtree {

[[nodiscard]] inline Body<2> turned(const Body<2>& body, double angle) {
  Pose<2> pose;
  pose.rotation << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  return moved(body, pose);
}

/// Whether a body meets an obstacle while it turns about its origin at a point, both ends counted in. It is
/// looked at in steps in which no point moves farther than a quarter of a smallest cell, and is larger by as
/// much as it may move between them: what is free is free for certain.
template <class Map>
[[nodiscard]] bool turn_collides(const Map& map, const Body<2>& body, const Vector<2>& at, double from,
                                 double to, UnknownSpace unknown = UnknownSpace::free) {
  const double arc = reach_of(body) * std::abs(to - from);
  const double steps = std::max(1.0, std::ceil(4.0 * arc / map.tree().geometry().unit()));
  const Body<2> larger = inflated(body, 0.5 * arc / steps);
  Pose<2> pose;
  pose.translation = at;
  for (double i = 0.0; i <= steps; i += 1.0)
    if (collides(map, turned(larger, from + (to - from) * (i / steps)), pose, unknown)) return true;
  return false;
}

namespace detail {

inline constexpr double kTurn = 2.0 * 3.14159265358979323846;  // [rad]

/// How a body gets from one pose x, y and yaw to the next. @param same that no point of a body with this
/// reach moves farther by what is no motion but rounding [m].
enum class Motion { moves, turns, both };
[[nodiscard]] inline Motion motion_between(const Vector<3>& from, const Vector<3>& to, double reach,
                                           double same) {
  const bool stays = (to - from).head<2>().norm() <= same;
  if (stays && to[2] != from[2]) return Motion::turns;
  return stays || reach * std::abs(std::remainder(to[2] - from[2], kTurn)) <= same ? Motion::moves
                                                                                   : Motion::both;
}

/// Whether a body meets an obstacle in a motion that is not both.
template <class Map>
[[nodiscard]] bool motion_collides(const Map& map, const Body<2>& body, const Vector<3>& from,
                                   const Vector<3>& to, Motion motion, UnknownSpace unknown) {
  if (motion == Motion::turns) return turn_collides(map, body, from.head<2>(), from[2], to[2], unknown);
  return sweep_collides(map, turned(body, from[2]), Vector<2>(from.head<2>()), Vector<2>(to.head<2>()),
                        unknown);
}

}  // namespace detail

/// The first segment between poses x, y [m] and yaw [rad] in which a planner's body, kept away from
/// obstacles, meets one of the planner's map; none if there is none. Motions below kOnBorder of a smallest
/// cell are rounding; so yaw may be wrapped where the body moves. It turns the way that the numbers go.
/// @throws std::invalid_argument if a pose is not finite, or a segment both moves and turns.
template <class Map>
[[nodiscard]] std::optional<std::size_t> first_blocked_turning(const Planner<Map>& planner,
                                                               const std::vector<Vector<3>>& poses) {
  std::vector<Vector<2>> places;
  for (const Vector<3>& pose : poses) places.emplace_back(pose.head<2>());
  planner.require_places(places, "points");
  const auto refuse = [](std::size_t i, const std::string& why) {
    throw std::invalid_argument("points[" + std::to_string(i) + "]: " + why);
  };
  const Body<2> body = inflated(planner.body(), planner.options().clearance);
  const double same = kOnBorder * planner.map().tree().geometry().unit();
  std::vector<detail::Motion> motions(poses.size() == 1, detail::Motion::moves);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (!std::isfinite(poses[i][2])) refuse(i, "yaw must be finite");
    if (i == 0) continue;
    motions.push_back(detail::motion_between(poses[i - 1], poses[i], reach_of(body), same));
    if (motions.back() == detail::Motion::both)
      refuse(i, "moves by " + describe_number((places[i] - places[i - 1]).norm()) + " m and turns by " +
                    describe_number(poses[i][2] - poses[i - 1][2]) + " rad at once, expected one of both");
  }
  return detail::first_segment(poses, [&](std::size_t i, std::size_t next) {
    return detail::motion_collides(planner.map(), body, poses[i], poses[next], motions[i], planner.unknown());
  });
}

namespace detail {

/// Largest ball around the origin in one of the parts of a body; of radius 0 if the origin is in none.
template <int D>
[[nodiscard]] double radius_inside(const Body<D>& body) {
  double radius = 0.0;
  for (const BodyPart<D>& part : body) {
    if (const auto* const capsule = std::get_if<Capsule<D>>(&part)) {
      const Box<D> origin{Vector<D>::Zero(), Vector<D>::Zero()};
      radius =
          std::max(radius, capsule->radius - std::sqrt(squared_distance(capsule->a, capsule->b, origin)));
    } else {
      const auto& box = std::get<OrientedBox<D>>(part);
      radius = std::max(radius,
                        (box.half_size - (box.axes.transpose() * box.center).cwiseAbs()).eval().minCoeff());
    }
  }
  return radius;
}

/// The free spaces of a body at several headings, in a ring: cells of one heading are joined as there, and to
/// cells of the next headings where they overlap and the body can turn. Points are in smallest cells.
template <class Map>
class TurningSpace {
 public:
  static constexpr int D = 2;
  using Cell = PlaceCell<2>;
  static constexpr bool kHasWalls = false;
  static constexpr bool kTestsWays = true;
  static constexpr Sight kSight = Sight::cells_and_walk;

  /// A heading [rad], and a planner of the body that has it.
  struct Layer {
    double angle;
    std::unique_ptr<Planner<Map>> planner;
  };

  /// @param body kept away from obstacles, and a little more, at heading 0.
  TurningSpace(const Map& map, std::vector<Layer>& layers, const Body<2>& body, UnknownSpace unknown)
      : map_(map),
        layers_(layers),
        body_(body),
        unknown_(unknown),
        unit_(map.tree().geometry().unit()),
        reach_(reach_of(body) / unit_) {}

  [[nodiscard]] static std::size_t layer_of(const Cell& cell) { return cell.number >> kBits; }
  [[nodiscard]] static Anchor<2> in_layer(Anchor<2> anchor, std::size_t layer) {
    anchor.cell.number |= std::uint64_t{layer} << kBits;
    return anchor;
  }
  [[nodiscard]] FreeSpace<Map>& cells_like(const Cell& cell) { return space_at(layer_of(cell)); }
  [[nodiscard]] static bool is_tested(const Cell& a, const Cell& b) { return layer_of(a) != layer_of(b); }
  /// Where it turns: the nearest place in both cells.
  [[nodiscard]] static Vector<2> entry(const Cell& a, const Cell& b, const Vector<2>& point) {
    return nearest_in(common_box(a, b), point);
  }
  /// To where it turns, and as far as its outermost point moves then; infinite if it cannot turn.
  [[nodiscard]] double length_between(const Cell& from_cell, const Vector<2>& from, const Cell& cell,
                                      const Vector<2>& to, std::optional<Vector<2>>&) const {
    const double angle = layers_[layer_of(from_cell)].angle;
    const double turn = turn_between(angle, layers_[layer_of(cell)].angle);
    if (!can_turn(Vector<2>(to * unit_), angle, angle + turn)) return std::numeric_limits<double>::infinity();
    return (to - from).norm() + reach_ * std::abs(turn);
  }
  /// At a place [m].
  [[nodiscard]] bool can_turn(const Vector<2>& at, double from, double to) const {
    return !turn_collides(map_, body_, at, from, to, unknown_);
  }
  template <class Visit>
  void for_each_beside(const Cell& cell, const Visit& visit) {
    const std::size_t layer = layer_of(cell);
    Cell own = cell;
    own.number &= (std::uint64_t{1} << kBits) - 1;
    const auto visit_in = [&](std::size_t other) {
      return [&visit, other](Cell beside) {
        beside.number |= std::uint64_t{other} << kBits;
        visit(beside);
      };
    };
    space_at(layer).for_each_beside(own, visit_in(layer));
    LatticeBox<2> box{cell.lower, cell.lower};
    for (std::int64_t& x : box.upper) x += cell.edge;
    const std::size_t count = layers_.size();
    for (const std::size_t other : {(layer + 1) % count, (layer + count - 1) % count}) {
      if (other == layer) continue;
      space_at(other).for_each_in(box, visit_in(other));
      if (count == 2) return;
    }
  }
  /// The smaller angle from one heading to another, in (-pi, pi].
  [[nodiscard]] static double turn_between(double from, double to) {
    const double turn = std::remainder(to - from, kTurn);
    return turn <= -0.5 * kTurn ? turn + kTurn : turn;
  }

 private:
  static constexpr int kBits = 48;

  [[nodiscard]] FreeSpace<Map>& space_at(std::size_t layer) const { return layers_[layer].planner->space(); }

  const Map& map_;
  std::vector<Layer>& layers_;
  const Body<2>& body_;
  UnknownSpace unknown_;
  double unit_;
  double reach_;
};

/// One question of plan_turning().
template <class Map>
class TurningSearch {
 public:
  TurningSearch(const Map& map, const Body<2>& body, const PlannerOptions& options, int headings)
      : map_(map),
        body_(body),
        kept_away_(inflated(body, options.clearance)),
        tested_(inflated(kept_away_, kOnBorder * map.tree().geometry().unit())),
        options_(options) {
    options_.validate();
    if (headings < 4 || headings > 256)
      throw std::invalid_argument("headings = " + std::to_string(headings) + ": must be 4 to 256");
    headings_ = headings;
  }

  [[nodiscard]] Path<3> run(const Vector<3>& start, const Vector<3>& goal, double max_seconds) {
    const auto deadline = Planner<Map>::deadline_after(max_seconds);
    make_layers(start, goal);
    Planner<Map>& first = *layers_.front().planner;
    Planner<Map>& last = *layers_[goal_layer_].planner;
    // Whatever its heading, the body holds a ball: its ways are no longer than the body's.
    const double radius = std::max(1e-6 * map_.tree().geometry().unit(), radius_inside(kept_away_));
    Planner<Map> ball(map_, {Capsule<2>{Vector<2>::Zero(), Vector<2>::Zero(), radius}}, options_);
    first.require_free(start.head<2>(), "start", deadline);
    last.require_free(goal.head<2>(), "goal", deadline);
    for (const Vector<3>& end : {start, goal}) {
      for (const Layer& layer : layers_) layer.planner->include(end.head<2>());
      ball.include(end.head<2>());
    }
    const double unit = map_.tree().geometry().unit();
    Path<3> path;
    const auto from = first.anchors(start.head<2>());
    const auto to = last.anchors(goal.head<2>());
    CoarseGuide<Map> guide(ball.space(), options_.unknown_cost);
    path.status = guide.run(in_ball(from, ball), in_ball(to, ball), start.head<2>() / unit, deadline);
    path.expanded = guide.expanded();
    if (path.status == PathStatus::found) {
      TurningSpace<Map> space(map_, layers_, tested_, first.unknown());
      PathSearch<TurningSpace<Map>, CoarseGuide<Map>> search(space, options_.unknown_cost, options_.greed,
                                                             &guide);
      for (const auto& anchor : from) search.add_start(TurningSpace<Map>::in_layer(anchor, 0));
      for (const auto& anchor : to) search.add_goal(TurningSpace<Map>::in_layer(anchor, goal_layer_));
      path.status = search.run(goal.head<2>() / unit, deadline);
      path.expanded += search.expanded();
      if (path.status == PathStatus::found) take(search, space, start, goal, path);
    }
    if (path.status != PathStatus::found)
      path.reason =
          path.status == PathStatus::out_of_time
              ? Planner<Map>::out_of_time_after(path.expanded)
              : "no way at these headings through cells in which the body is free wherever it stands";
    return path;
  }

 private:
  using Layer = typename TurningSpace<Map>::Layer;

  /// That of the start, and as many at equal angles; and that of the goal among them.
  void make_layers(const Vector<3>& start, const Vector<3>& goal) {
    for (const auto& [name, end] : {std::pair("start", &start), std::pair("goal", &goal)})
      if (!std::isfinite((*end)[2]))
        throw std::invalid_argument(std::string(name) + " = " + describe_point(*end) +
                                    ": yaw must be finite");
    double ahead = std::fmod(goal[2] - start[2], kTurn);
    if (ahead < 0.0) ahead += kTurn;
    std::vector<double> angles;
    for (int k = 0; k < headings_; ++k) angles.push_back(kTurn * k / headings_);
    auto place = std::lower_bound(angles.begin(), angles.end(), ahead - kSame);
    if (place == angles.end() && kTurn - ahead <= kSame) place = angles.begin();
    if (place == angles.end() || std::abs(std::remainder(*place - ahead, kTurn)) > kSame)
      place = angles.insert(place, ahead);
    goal_layer_ = static_cast<std::size_t>(place - angles.begin());
    for (const double angle : angles)
      layers_.push_back({start[2] + angle,
                         std::make_unique<Planner<Map>>(map_, turned(body_, start[2] + angle), options_)});
  }
  /// Anchors in the free space of the ball.
  [[nodiscard]] std::vector<Anchor<2>> in_ball(std::vector<Anchor<2>> anchors, Planner<Map>& ball) const {
    for (Anchor<2>& anchor : anchors) {
      const Lattice<2> at = cell_ahead<2>(anchor.point, Vector<2>::Zero());
      anchor.cell = ball.space().cell_at(anchor.cell.edge == 1 ? anchor.cell.lower : at);
    }
    anchors.erase(std::remove_if(anchors.begin(), anchors.end(),
                                 [](const auto& a) { return a.cell.passage == Passage::blocked; }),
                  anchors.end());
    return anchors;
  }

  /// Pulls the ways between turns tight, and tests all of it once more.
  template <class Search>
  void take(const Search& search, const TurningSpace<Map>& space, const Vector<3>& start,
            const Vector<3>& goal, Path<3>& path) {
    const double unit = map_.tree().geometry().unit();
    std::vector<std::pair<Vector<2>, std::size_t>> nodes;
    search.for_each_back([&](const Vector<2>& point, const PlaceCell<2>& cell) {
      nodes.emplace_back(point * unit, TurningSpace<Map>::layer_of(cell));
    });
    std::reverse(nodes.begin(), nodes.end());
    nodes.emplace_back(goal.head<2>(), goal_layer_);
    std::vector<Vector<2>> run{start.head<2>()};
    std::size_t layer = 0;
    double yaw = start[2];
    const auto end_run = [&] {
      layers_[layer].planner->pull_tight(run);
      for (const Vector<2>& point : run) add(path.points, {point[0], point[1], yaw}, space);
    };
    for (const auto& [point, next] : nodes) {
      if (point != run.back()) run.push_back(point);
      if (next == layer) continue;
      end_run();
      yaw += TurningSpace<Map>::turn_between(layers_[layer].angle, layers_[next].angle);
      layer = next;
      run = {point};
    }
    end_run();
    finish(path);
  }
  /// Turns at one place become one that is less than half a turn, where it is free, too: for certain, as what
  /// turn_collides() adds to the body is not the same in all turns.
  static void add(std::vector<Vector<3>>& poses, const Vector<3>& pose, const TurningSpace<Map>& space) {
    const auto same_place = [&](const Vector<3>& other) { return other.head<2>() == pose.head<2>(); };
    if (!poses.empty() && poses.back() == pose) return;
    const std::size_t n = poses.size();
    if (n >= 2 && same_place(poses[n - 1]) && same_place(poses[n - 2])) {
      const double first = poses[n - 1][2] - poses[n - 2][2];
      const double both = pose[2] - poses[n - 2][2];
      if (first * (both - first) > 0.0 && std::abs(both) < 3.0 &&
          space.can_turn(pose.head<2>(), poses[n - 2][2], pose[2]))
        poses.pop_back();
    }
    poses.push_back(pose);
  }
  void finish(Path<3>& path) const {
    const UnknownSpace unknown = layers_.front().planner->unknown();
    path.length = 0.0;
    path.clearance = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i == 0 || i + 1 < path.points.size(); ++i) {
      const Vector<3>& a = path.points[i];
      const Vector<3>& b = path.points[std::min(i + 1, path.points.size() - 1)];  // One alone is a segment.
      const bool turns = a[2] != b[2];
      if (motion_collides(map_, kept_away_, a, b, turns ? Motion::turns : Motion::moves, unknown))
        throw std::logic_error("a segment of the path collides: please report this map");
      path.length += (b - a).head<2>().norm();
      for (int k = 0; k <= (turns ? kLooks : 0); ++k)
        path.clearance = sweep_clearance(map_, turned(body_, a[2] + (b[2] - a[2]) * k / double{kLooks}),
                                         a.head<2>(), b.head<2>(), unknown, path.clearance);
    }
  }

  static constexpr double kSame = 1e-9;  // Headings nearer than this are one [rad].
  static constexpr int kLooks = 16;      // At clearance while it turns.

  const Map& map_;
  const Body<2>& body_;
  Body<2> kept_away_;
  Body<2> tested_;  // A little more, as a Planner's.
  PlannerOptions options_;
  int headings_;
  std::vector<Layer> layers_;
  std::size_t goal_layer_ = 0;
};

}  // namespace detail

/// A path of a body that turns: poses x, y [m] and yaw [rad], between which it either moves without turning
/// or turns about its origin. Each move is free for the volume that it sweeps, each turn for certain, see
/// turn_collides(). Yaw is as one turns, not wrapped: it ends at that of the goal, or a whole turn beside.
/// Turns cost as far as the outermost point of the body moves; `length` has none of that.
/// @param headings at equal angles from that of the start on; that of the goal is one more.
/// @throws std::invalid_argument as Planner.
template <class Map>
[[nodiscard]] Path<3> plan_turning(const Map& map, const Vector<3>& start, const Vector<3>& goal,
                                   const Body<2>& body, const PlannerOptions& options = {},
                                   double max_seconds = std::numeric_limits<double>::infinity(),
                                   int headings = 16) {
  static_assert(Map::kDim == 2, "headings are of bodies in the plane");
  return detail::TurningSearch<Map>(map, body, options, headings).run(start, goal, max_seconds);
}

}  // namespace ndtree
