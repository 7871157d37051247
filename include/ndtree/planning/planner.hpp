// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Short paths of a body through a map, checked exactly, that follow what changes.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/coarse_space.hpp"
#include "ndtree/planning/corridor.hpp"
#include "ndtree/planning/free_space.hpp"
#include "ndtree/planning/narrow_space.hpp"
#include "ndtree/planning/path.hpp"
#include "ndtree/planning/path_search.hpp"
#include "ndtree/planning/place_walk.hpp"
#include "ndtree/planning/places_near.hpp"
#include "ndtree/planning/shorten.hpp"
#include "ndtree/planning/sweep.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/collision.hpp"

namespace ndtree {

namespace detail {

/// The first segment between points i and `next` for which something holds. One point alone is a segment.
template <class Points, class Holds>
[[nodiscard]] std::optional<std::size_t> first_segment(const Points& points, const Holds& holds) {
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::size_t next = std::min(i + 1, points.size() - 1);
    if ((next != i || i == 0) && holds(i, next)) return i;
  }
  return std::nullopt;
}

}  // namespace detail

/// Finds paths for one body of fixed orientation in one map, as it was when the planner was made or last
/// updated. What was found out about free space is kept for the next question.
template <class Map>
class Planner {
 public:
  static constexpr int D = Map::kDim;

  /// @param body in its orientation. @throws std::invalid_argument if it has no part, or an option is wrong.
  Planner(const Map& map, Body<D> body, const PlannerOptions& options = {})
      : seen_(map.snapshot()), options_(options), body_(std::move(body)) {
    options_.validate();
    if (body_.empty()) throw std::invalid_argument("body: has no part");
    kept_away_ = inflated(body_, options_.clearance);
    tested_ = inflated(kept_away_, kOnBorder * unit());
    reach_ = reach_of(body_);
    const double most = unit() * static_cast<double>(kMostReach);
    if (!(reach_ + options_.clearance <= most))
      throw std::invalid_argument("body: with its clearance it reaches " +
                                  describe_number(reach_ + options_.clearance) + " m: with cells of " +
                                  describe_number(unit()) + " m at most " + describe_number(most) +
                                  " m can be planned for");
    rebuild(around(seen_));
  }

  [[nodiscard]] const Map& map() const { return seen_; }
  [[nodiscard]] const Body<D>& body() const { return body_; }
  [[nodiscard]] const PlannerOptions& options() const { return options_; }
  [[nodiscard]] UnknownSpace unknown() const {
    return std::isfinite(options_.unknown_cost) ? UnknownSpace::free : UnknownSpace::occupied;
  }
  [[nodiscard]] std::size_t memory_bytes() const {
    return space_->memory_bytes() + possible_->memory_bytes() + narrow_->memory_bytes() + search_bytes_;
  }

  /// A path from one point to another, of the origin of the body. Each of its segments is free for the volume
  /// that the body sweeps. It is any-angle and pulled tight, nearly the shortest and not proved to be. Its
  /// reason says why there is none: proved, as even all places where the body may be free are not connected;
  /// or not, where they are connected through gaps hardly wider than the body; or out of time.
  /// @param max_seconds that the search may take.
  /// @throws std::invalid_argument if the body collides at an end: what with, and where it would not.
  [[nodiscard]] Path<D> plan(const Vector<D>& start, const Vector<D>& goal,
                             double max_seconds = std::numeric_limits<double>::infinity()) {
    const Deadline deadline = deadline_after(max_seconds);
    require_free(start, "start", deadline);
    require_free(goal, "goal", deadline);
    Path<D> path;
    if (is_free(start, goal) && (!space_->has_costs() || start == goal)) {
      finish(path, {start, goal});
      return path;
    }
    const Query query{start, goal, deadline, anchors(start), anchors(goal)};
    search_bytes_ = 0;
    search_in_all(query, path);
    if (path.status == PathStatus::found) finish(path, std::vector<Vector<D>>(std::move(path.points)));
    return path;
  }
  /// Lengths of short ways from one place to each of several [m], times what unknown space costs; infinite
  /// where there is none, or the body collides; NaN where the time was over before that was known. One
  /// search, which has no direction: ways may be other ones than those of plan(), and a little longer or
  /// shorter.
  /// @throws std::invalid_argument if the body collides at the start, or a goal is not finite.
  [[nodiscard]] std::vector<double> ways(const Vector<D>& start, const std::vector<Vector<D>>& goals,
                                         double max_seconds = std::numeric_limits<double>::infinity()) {
    const Deadline deadline = deadline_after(max_seconds);
    require_places(goals, "goals");
    for (const Vector<D>& goal : goals) include(goal);
    require_free(start, "start", deadline);
    std::vector<double> costs(goals.size(), std::numeric_limits<double>::infinity());
    detail::PathSearch<detail::NarrowSpace<Map>> search(*narrow_, options_.unknown_cost, 1.0);
    for (const auto& anchor : anchors(start)) search.add_start(anchor);
    for (std::size_t i = 0; i < goals.size(); ++i) {
      if (!is_free(goals[i], goals[i])) continue;
      if (!space_->has_costs() && is_free(start, goals[i])) {
        costs[i] = (goals[i] - start).norm();
        continue;
      }
      for (auto anchor : anchors(goals[i])) {
        anchor.goal = i;
        search.add_goal(anchor);
        costs[i] = std::numeric_limits<double>::quiet_NaN();  // Until the search ends.
      }
    }
    const PathStatus status = search.run_to_all(goals.size(), deadline, [&](std::size_t i) {
      costs[i] = cost_of(tightened(search, start, goals[i]));
    });
    if (status != PathStatus::out_of_time)
      for (double& cost : costs)
        if (std::isnan(cost)) cost = std::numeric_limits<double>::infinity();
    search_bytes_ = search.memory_bytes();
    return costs;
  }
  /// The first segment of a path in which the body meets an obstacle of the map as it is now; none if there
  /// is none. One point alone is a segment. @throws std::invalid_argument if a point is not finite.
  [[nodiscard]] std::optional<std::size_t> first_blocked(const std::vector<Vector<D>>& points) const {
    require_places(points, "points");
    return detail::first_segment(points, [&](std::size_t i, std::size_t next) {
      return sweep_collides(seen_, kept_away_, points[i], points[next], unknown());
    });
  }
  /// Convex sets of places around the segments of a path, from which the body meets no obstacle, see
  /// corridors().
  /// @throws as corridors().
  [[nodiscard]] std::vector<std::vector<HalfSpace<D>>> corridors(const std::vector<Vector<D>>& points,
                                                                 double reach) const {
    require_places(points, "points");
    return ndtree::corridors(seen_, kept_away_, points, reach, unknown());
  }

  /// Follows a map. O(what changed since).
  /// @returns whether anything did. @throws std::invalid_argument if its cells are of other sizes; Cancelled:
  /// then nothing has changed.
  bool update(const Map& map) {
    std::vector<CellIndex<D>> changed;
    detail::for_each_difference(seen_, map, [&](const CellIndex<D>& index) { changed.push_back(index); });
    const Box<D> needed = changed.empty() ? around_ : around(map);  // From here on, nothing can be cancelled.
    seen_ = map.snapshot();
    space_->set_map(seen_);
    possible_->set_map(seen_);
    if (changed.empty()) return false;
    if (needed.lower != around_.lower || needed.upper != around_.upper) {
      rebuild(needed);
      return true;
    }
    const auto& geometry = seen_.tree().geometry();
    for (const CellIndex<D>& index : changed) {
      LatticeBox<D> box;
      for (std::size_t a = 0; a < D; ++a) {
        box.lower[a] = index.lower[a];
        box.upper[a] = index.lower[a] + geometry.edge(index.level);
      }
      space_->forget(box);
      possible_->forget(box);
    }
    forget_gaps();
    return true;
  }

  using Anchor = detail::Anchor<D>;
  using Deadline = std::chrono::steady_clock::time_point;

  /// Makes sure that a place is one of those of interest. No place outside what was observed is, where
  /// unknown space is an obstacle.
  void include(const Vector<D>& point) {
    if (unknown() == UnknownSpace::occupied) return;
    if (around_.encloses(Box<D>{point, point}.inflated(4.0 * unit()))) return;
    asked_ = around_both(asked_, Box<D>{point, point});
    rebuild(around(seen_));
  }
  /// @throws std::invalid_argument naming the first point that is not finite, or beyond all cells that a map
  /// can have.
  void require_places(const std::vector<Vector<D>>& points, const char* name) const {
    const auto wrong = std::find_if_not(points.begin(), points.end(),
                                        [&](const Vector<D>& point) { return is_place(point); });
    if (wrong != points.end())
      refuse_place(*wrong, std::string(name) + "[" + std::to_string(wrong - points.begin()) + "]");
  }
  /// @throws std::invalid_argument if the body collides there: what with, and where it would not.
  void require_free(const Vector<D>& point, const char* name, Deadline deadline) {
    if (!is_place(point)) refuse_place(point, name);
    include(point);
    if (is_free(point, point)) return;
    std::string message = std::string(name) + " = " + describe_point(point) + ": there the body meets " +
                          detail::obstacle_in_words(seen_, tested_, point, unknown());
    throw std::invalid_argument(message + "; " + nearest_in_words(point, deadline));
  }
  [[nodiscard]] FreeSpace<Map>& space() { return *space_; }
  /// Pulls a path tight. @pre its segments are free.
  void pull_tight(std::vector<Vector<D>>& points) const {
    const SegmentCost cost(*this);
    detail::PathShortener<D, SegmentCost>(cost).shorten(points);
  }
  /// Why a search that had no more time has found none.
  [[nodiscard]] static std::string out_of_time_after(std::size_t cells) {
    return "out of time after " + std::to_string(cells) + " cells: there may be a way";
  }
  [[nodiscard]] static Deadline deadline_after(double seconds) {
    using Clock = Deadline::clock;
    if (!(seconds < 1e9)) return Deadline::max();
    return Clock::now() +
           std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(std::max(0.0, seconds)));
  }

  /// The way of a segment is free for the body and what it keeps away.
  [[nodiscard]] bool is_free(const Vector<D>& from, const Vector<D>& to) const {
    return !sweep_collides(seen_, tested_, from, to, unknown());
  }

  /// Where a search may begin or end: at the pose, or, if its cell is not free as a whole, at the nearest
  /// places in cells that are, to which the body can go straight.
  [[nodiscard]] std::vector<Anchor> anchors(const Vector<D>& pose) {
    return detail::anchors_at(*space_, Vector<D>(pose / unit()),
                              [&](const Vector<D>& place) { return is_free(pose, place * unit()); });
  }

 private:
  /// Costs of segments, for what shortens paths [m].
  class SegmentCost {
   public:
    explicit SegmentCost(const Planner& planner) : planner_(planner) {}
    [[nodiscard]] bool is_uniform() const { return !planner_.space_->has_costs(); }
    double operator()(const Vector<D>& a, const Vector<D>& b) const {
      if (!planner_.is_free(a, b)) return std::numeric_limits<double>::infinity();
      if (is_uniform()) return (b - a).norm();
      // The exact sweep is free where cells are not as a whole: what they have of unknown space is not known.
      const double unit = planner_.unit();
      const double unknown_cost = planner_.options_.unknown_cost;
      return unit * detail::cost_of_way(*planner_.space_, Vector<D>(a / unit), Vector<D>(b / unit),
                                        unknown_cost, unknown_cost);
    }

   private:
    const Planner& planner_;
  };

  [[nodiscard]] double unit() const { return seen_.tree().geometry().unit(); }
  /// A shortest way stays in the convex hull of its ends and of all obstacles, as the body sees them. Rounded
  /// outwards to many cells, so that few changes of the map move it; to the more, the farther an end is from
  /// the map, so that cells on the way there are the larger.
  [[nodiscard]] Box<D> around(const Map& map) const {
    Box<D> box = asked_;
    double step = 128.0 * unit();
    if (const std::optional<Box<D>> known = bounds(map)) {
      const Box<D> seen = known->inflated(reach_ + options_.clearance);
      box = around_both(box, seen);
      while (((seen.lower - box.lower).array() > step).any() ||
             ((box.upper - seen.upper).array() > step).any())
        step *= 2.0;
    }
    if (!(box.lower[0] <= box.upper[0])) box = {Vector<D>::Zero(), Vector<D>::Zero()};
    for (int a = 0; a < D; ++a) {
      box.lower[a] = step * std::floor((box.lower[a] - 4.0 * unit()) / step);
      box.upper[a] = step * std::ceil((box.upper[a] + 4.0 * unit()) / step);
    }
    return box;
  }
  [[nodiscard]] static Box<D> around_both(const Box<D>& one, const Box<D>& other) {
    return {one.lower.cwiseMin(other.lower), one.upper.cwiseMax(other.upper)};
  }
  void rebuild(const Box<D>& around) {
    around_ = around;
    space_ = std::make_unique<FreeSpace<Map>>(seen_, inflated(kept_away_, 2.0 * kOnBorder * unit()),
                                              options_.unknown_cost, around_);
    possible_ =
        std::make_unique<FreeSpace<Map>>(seen_, D == 2 ? kept_away_ : tested_, options_.unknown_cost, around_,
                                         D == 2 ? detail::Touches::from_each : detail::Touches::from_centre);
    forget_gaps();
  }
  /// What was found out about them is found out again.
  void forget_gaps() {
    narrow_ = std::make_unique<detail::NarrowSpace<Map>>(seen_, *space_, *possible_, tested_, unknown());
  }
  static void add_point(std::vector<Vector<D>>& points, const Vector<D>& point) {
    if (point != points.back()) points.push_back(point);
  }

  /// The path that a search found, with its ends.
  template <class Search>
  [[nodiscard]] std::vector<Vector<D>> tightened(const Search& search, const Vector<D>& start,
                                                 const Vector<D>& goal) const {
    std::vector<Vector<D>> points{start};
    for (const Vector<D>& point : search.path()) add_point(points, point * unit());
    add_point(points, goal);
    pull_tight(points);
    return points;
  }
  /// Of a path that is free [m].
  [[nodiscard]] double cost_of(const std::vector<Vector<D>>& points) const {
    const SegmentCost cost_between(*this);
    double cost = 0.0;
    for (std::size_t i = 0; i + 1 < points.size(); ++i)
      cost +=
          space_->has_costs() ? cost_between(points[i], points[i + 1]) : (points[i + 1] - points[i]).norm();
    return cost;
  }
  void finish(Path<D>& path, std::vector<Vector<D>> points) const {
    path.status = PathStatus::found;
    path.length = 0.0;
    path.clearance = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i + 1 < points.size(); ++i) {
      if (sweep_collides(seen_, kept_away_, points[i], points[i + 1], unknown()))
        throw std::logic_error("a segment of the path collides: please report this map");
      path.length += (points[i + 1] - points[i]).norm();
      path.clearance = sweep_clearance(seen_, body_, points[i], points[i + 1], unknown(), path.clearance);
    }
    path.points = std::move(points);
  }

  struct Query {
    Vector<D> start, goal;
    Deadline deadline;
    std::vector<Anchor> from, to;
  };
  using Guide = detail::CoarseGuide<Map>;

  /// Looks for a way in a space, by a guide, at no more than this many cells; the shorter one of it and that
  /// of the path stays. @returns what it costs, in smallest cells.
  template <class Space>
  double search(Space& space, Guide& guide, const Query& query, std::size_t most_cells, Path<D>& path) {
    detail::PathSearch<Space, Guide> search(space, options_.unknown_cost, options_.greed, &guide);
    search.end_after(most_cells);
    for (const Anchor& anchor : query.from) search.add_start(anchor);
    for (const Anchor& anchor : query.to) search.add_goal(anchor);
    path.status = search.run(query.goal / unit(), query.deadline);
    path.expanded += search.expanded();
    search_bytes_ = std::max(search_bytes_, search.memory_bytes() + guide.memory_bytes());
    if (path.status != PathStatus::found) return std::numeric_limits<double>::infinity();
    std::vector<Vector<D>> points = tightened(search, query.start, query.goal);
    const double cost = cost_of(points);
    if (path.points.empty() || cost < cost_of(path.points)) path.points = std::move(points);
    return cost / unit();
  }
  /// Through cells in which the body is free wherever it stands; if that takes a way that is longer than the
  /// coarse one through all places where it may be free, also through gaps that are narrower.
  void search_in_all(const Query& query, Path<D>& path) {
    Guide guide(*possible_, options_.unknown_cost);
    const PathStatus joined = guide.run(query.from, query.to, query.start / unit(), query.deadline);
    path.expanded = guide.expanded();
    path.status = joined;
    if (joined == PathStatus::found) {
      const double found = search(*space_, guide, query, guide.expanded() + kFewCells, path);
      if (path.status != PathStatus::out_of_time && !(found < guide.length() * (1.0 + kWorthGap)))
        (void)search(*narrow_, guide, query, kAllCells, path);
      if (!path.points.empty()) path.status = PathStatus::found;
    }
    if (path.status != PathStatus::found) path.reason = reason_for(query, path, joined);
  }
  /// @param perhaps whether places are connected in which the body may be free.
  [[nodiscard]] std::string reason_for(const Query& query, const Path<D>& path, PathStatus perhaps) const {
    if (path.status == PathStatus::out_of_time) return out_of_time_after(path.expanded);
    for (const bool is_start : {true, false})
      if ((is_start ? query.from : query.to).empty())
        return std::string(is_start ? "the start" : "the goal") +
               " is in a gap: no cell in which the body is free wherever it stands is in straight reach";
    if (perhaps == PathStatus::none)
      return D == 2
                 ? "the goal is in another part of free space than the start: there is no way, proved"
                 : "the goal is in another part of free space than the start, as far as smallest cells tell";
    return "the goal is in another part of free space than the start, but for gaps hardly wider than the "
           "body, in which no way was found";
  }

  [[nodiscard]] bool is_place(const Vector<D>& point) const {
    return point.allFinite() && seen_.tree().geometry().in_reach(point);
  }
  [[noreturn]] static void refuse_place(const Vector<D>& point, const std::string& name) {
    throw std::invalid_argument(name + " = " + describe_point(point) +
                                ": must be finite, and on the map's lattice");
  }
  [[nodiscard]] std::string nearest_in_words(const Vector<D>& point, Deadline deadline) {
    try {
      const CancelScope until([&] { return Deadline::clock::now() > deadline; });
      const auto nearest = detail::nearest_free(
          *possible_, Vector<D>(point / unit()),
          [&](const Vector<D>& at) { return is_free(at * unit(), at * unit()); },
          [&](const Vector<D>& middle, double half) {
            return detail::meets_one_from_all(seen_, tested_, middle * unit(), half * unit(), unknown());
          });
      if (!nearest) return "no place was found where it fits";
      const Vector<D> place = *nearest * unit();
      const double step = 0.01 * unit();
      return "the nearest place where it fits is " +
             describe_number(step * std::ceil((place - point).norm() / step)) + " m away, at " +
             describe_point(place);
    } catch (const Cancelled&) {
      checkpoint();  // The call as a whole.
      return "out of time before the nearest place where it fits was found";
    }
  }
  static constexpr double kWorthGap = 0.015;  // Longer than the coarse way, that gaps are looked for.
  static constexpr int kMostReach =
      1 << (30 / D - 1);                        // Smallest cells: obstacles around are at most 2^30 bits.
  static constexpr std::size_t kFewCells = 64;  // More than the guide's, at which a search is misled by it.
  static constexpr std::size_t kAllCells = ~std::size_t{0};

  Map seen_;
  PlannerOptions options_;
  Body<D> body_;
  Body<D> kept_away_;  // And its clearance.
  Body<D> tested_;     // A little more, so that the same test, rounded in another way, agrees.
  double reach_ = 0.0;
  /// Around all ends of paths that were not in it; at first around none.
  Box<D> asked_{Vector<D>::Constant(std::numeric_limits<double>::infinity()),
                Vector<D>::Constant(-std::numeric_limits<double>::infinity())};
  Box<D> around_{};  // All places of interest.
  std::unique_ptr<FreeSpace<Map>> space_;
  std::unique_ptr<FreeSpace<Map>> possible_;  // And all places where the body may be free.
  std::unique_ptr<detail::NarrowSpace<Map>> narrow_;
  std::size_t search_bytes_ = 0;
};

/// One path; a Planner answers the next question faster.
template <class Map>
[[nodiscard]] Path<Map::kDim> plan(const Map& map, const Vector<Map::kDim>& start,
                                   const Vector<Map::kDim>& goal, const Body<Map::kDim>& body,
                                   const PlannerOptions& options = {},
                                   double max_seconds = std::numeric_limits<double>::infinity()) {
  return Planner<Map>(map, body, options).plan(start, goal, max_seconds);
}

}  // namespace ndtree
