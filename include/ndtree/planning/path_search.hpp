// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Any-angle search through cells of any size.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <queue>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/cone.hpp"
#include "ndtree/planning/free_space.hpp"
#include "ndtree/planning/goal_flood.hpp"
#include "ndtree/planning/number_table.hpp"
#include "ndtree/planning/path.hpp"
#include "ndtree/planning/place_walk.hpp"

namespace ndtree::detail {

/// Straight to the goal: what a search without a guide takes for what is left of the way.
struct NoGuide {};

/// Lazy Theta* (Nash, Koenig, Tovey, AAAI 2010) over the cells of a free space. A node is a cell, and a point
/// on the face through which it was entered: where the straight way from the node's parent to the goal, or
/// its reflection, meets the face. A new node takes the parent of the node that it was reached from, as if
/// one saw the other; whether it does is looked at when the node is expanded, first through the faces on the
/// way here (Cone), then, as the space says, by a walk. If not, the best of the expanded cells beside takes
/// its place: a cell is convex, so its own point sees every point of its faces, and no edge needs a test, but
/// where the space says so. Invariant: the way from an expanded node to its parent is free.
/// Points and costs are in smallest cells. A guide tells what is left of the way, else it is the straight
/// line. O(cells expanded · (cells beside + cells on a straight way)).
template <class Space, class Guide = NoGuide>
class PathSearch {
 public:
  static constexpr int D = Space::D;
  using Cell = PlaceCell<D>;

  /// @param greed factor of what is left of the way, >= 1: above 1, fewer cells are expanded.
  PathSearch(Space& space, double unknown_cost, double greed, Guide* guide = nullptr)
      : space_(space), flood_(space), unknown_cost_(unknown_cost), greed_(greed), guide_(guide) {}
  /// As if there was no way, once it has looked at this many cells.
  void end_after(std::size_t most_cells) { most_cells_ = most_cells; }

  void add_start(const Anchor<D>& anchor) {
    std::uint32_t& number = numbers_[anchor.cell.number];
    if (number != NumberTable::kNone && nodes_[number].cost <= anchor.way) return;
    if (number == NumberTable::kNone) {
      number = static_cast<std::uint32_t>(nodes_.size());
      nodes_.emplace_back();
    }
    Node& node = nodes_[number];
    node.point = anchor.point;
    node.cell = anchor.cell;
    node.cost = anchor.way;
    node.parent = node.via = number;
    node.is_certain = true;
    starts_.push_back(number);
  }
  /// @param goal itself, for what is left of the way.
  void add_goal(const Anchor<D>& anchor) { goals_.push_back(anchor); }

  /// Searches for one goal. @param goal in smallest cells. @param deadline until when it searches.
  PathStatus run(const Vector<D>& goal, std::chrono::steady_clock::time_point deadline) {
    goal_ = goal;
    aims_ = true;
    for (const Anchor<D>& anchor : goals_) flood_.add(anchor.cell);
    return run(deadline, [](std::size_t) { return true; });
  }
  /// Searches for all of `count` goals, without a direction. @param found called with the number of each goal
  /// that is reached, once; path() is then the way to it.
  template <class Found>
  PathStatus run_to_all(std::size_t count, std::chrono::steady_clock::time_point deadline,
                        const Found& found) {
    aims_ = false;
    next_flood_ = 0;  // Never.
    std::vector<bool> is_left(count, false);
    for (const Anchor<D>& anchor : goals_) is_left[anchor.goal] = true;
    auto left = std::count(is_left.begin(), is_left.end(), true);
    if (left == 0) return PathStatus::none;
    return run(deadline, [&](std::size_t goal) {
      if (!is_left[goal]) return false;
      is_left[goal] = false;
      found(goal);
      return --left == 0;
    });
  }

  [[nodiscard]] std::size_t expanded() const { return expanded_; }
  /// Of the way that was found, in smallest cells. @pre there is one.
  [[nodiscard]] double length() const { return nodes_[end_].cost; }
  /// From a start to a point in a cell, if the search has come there.
  /// @param exactly not as if the point was seen from where the cell is seen from.
  [[nodiscard]] std::optional<double> way_from(std::uint64_t cell, const Vector<D>& point,
                                               bool exactly) const {
    const std::uint32_t number = numbers_.find(cell);
    if (number == NumberTable::kNone || !nodes_[number].is_expanded) return std::nullopt;
    const Node& node = nodes_[number];
    const Node& from = exactly ? node : nodes_[node.parent];
    return from.cost + (from.point - point).norm() * (exactly ? rate(node.cell) : 1.0);
  }
  [[nodiscard]] std::size_t memory_bytes() const {
    return nodes_.capacity() * sizeof(Node) + numbers_.memory_bytes();
  }
  /// Calls `visit(cell)` for each cell that was looked at.
  template <class Visit>
  void for_each_expanded(const Visit& visit) const {
    for (const Node& node : nodes_)
      if (node.is_expanded && node.goal == kNoGoal) visit(node.cell);
  }
  /// Calls `visit(point, cell)` from the last anchor to the first. @pre the search has found a path.
  template <class Visit>
  void for_each_back(const Visit& visit) const {
    for (std::uint32_t number = end_;; number = nodes_[number].parent) {
      const Node& node = nodes_[number];
      visit(node.point, node.cell);
      if constexpr (Space::kTestsWays)
        if (node.bend) visit(*node.bend, node.cell);
      if (node.parent == number) return;
    }
  }
  /// From the first anchor to the last, in smallest cells. @pre the search has found a path.
  [[nodiscard]] std::vector<Vector<D>> path() const {
    std::vector<Vector<D>> points;
    for_each_back([&](const Vector<D>& point, const Cell&) { points.push_back(point); });
    std::reverse(points.begin(), points.end());
    return points;
  }

 private:
  static constexpr std::uint32_t kNoGoal = ~std::uint32_t{0};

  /// Of a way into a narrow cell, at the side through which it comes from one that is not.
  struct NoBend {};
  using Bend = std::conditional_t<Space::kTestsWays, std::optional<Vector<D>>, NoBend>;
  struct Node {
    Vector<D> point;
    Cell cell;
    double cost = std::numeric_limits<double>::infinity();   // Of the way here.
    double total = std::numeric_limits<double>::infinity();  // And of what is left, times greed.
    std::uint32_t parent = 0;                                // That is seen from here, if is_certain.
    std::uint32_t goal = kNoGoal;                            // Which of the anchors, if it is one.
    std::uint32_t via = 0;                                   // The cell that it was reached from.
    bool is_certain = false;
    bool is_expanded = false;
    Bend bend{};
    Cone<D> seen;  // What the parent sees through the cells on the way here.
  };
  struct Entry {
    double total;
    std::uint32_t number;
    friend bool operator<(const Entry& a, const Entry& b) {  // The top of a queue is the greatest.
      return a.total != b.total ? a.total > b.total : a.number < b.number;
    }
  };

  /// @param is_last whether a goal that was reached ends the search.
  template <class IsLast>
  PathStatus run(std::chrono::steady_clock::time_point deadline, const IsLast& is_last) {
    for (const Anchor<D>& anchor : goals_) goal_numbers_[anchor.cell.number] = 0;
    for (const std::uint32_t number : starts_) push(number);
    while (!open_.empty()) {
      const Entry entry = open_.top();
      open_.pop();
      pace_.spend(20);
      Node& node = nodes_[entry.number];
      if (node.is_expanded || entry.total != node.total) continue;
      if (!node.is_certain && !settle(entry.number)) continue;
      node.is_expanded = true;
      if (node.goal != kNoGoal) {
        end_ = entry.number;
        if (is_last(goals_[node.goal].goal)) return PathStatus::found;
        continue;
      }
      if (expanded_ == most_cells_) return PathStatus::none;
      expand(entry.number);
      if ((++expanded_ & 63u) == 0 && std::chrono::steady_clock::now() > deadline)
        return PathStatus::out_of_time;
      if (expanded_ == next_flood_) {
        const auto met = [&](const Cell& cell) { return numbers_.find(cell.number) != NumberTable::kNone; };
        const Joined joined = flood_.run(expanded_ / 4, met);
        if (joined == Joined::no) return PathStatus::none;
        next_flood_ = joined == Joined::yes ? 0 : 2 * next_flood_;
      }
    }
    return PathStatus::none;
  }

  /// An estimate of what is left of the way.
  [[nodiscard]] double left_from(const Node& node, const Vector<D>& point) const {
    if (aims_) {
      double left = (goal_ - point).norm();
      if constexpr (!std::is_same_v<Guide, NoGuide>)
        if (node.goal == kNoGoal) left = std::max(left, guide_->left_from(node.cell, point));
      return greed_ * left;
    }
    return node.goal == kNoGoal ? 0.0 : goals_[node.goal].way;
  }
  void push(std::uint32_t number) {
    Node& node = nodes_[number];
    node.total = node.cost + left_from(node, node.point);
    open_.push({node.total, number});
  }
  [[nodiscard]] double rate(const Cell& cell) const {
    return cell.passage == Passage::costly ? unknown_cost_ : 1.0;
  }

  /// Where a way from a point to the goal goes through a face; to no goal, where it comes nearest.
  [[nodiscard]] Vector<D> point_on(const Box<D>& face, const Vector<D>& from) const {
    if (!aims_) return nearest_in(face, from);
    const int axis = axis_of(face);
    const double before = std::abs(from[axis] - face.lower[axis]);
    const double after = std::abs(goal_[axis] - face.lower[axis]);
    const double fraction = before + after > 0.0 ? before / (before + after) : 0.0;
    return nearest_in(face, Vector<D>(from + fraction * (goal_ - from)));
  }

  /// Makes sure that a node's parent is seen. @returns whether the node's turn has come, now that its cost is
  /// certain.
  bool settle(std::uint32_t number) {
    Node& node = nodes_[number];
    const Node& parent = nodes_[node.parent];
    node.bend = {};
    const Vector<D> way = node.point - parent.point;
    const bool is_seen = looks_through_cells() && node.seen.contains(way);
    double best =
        is_seen ? parent.cost + way.norm()
        : (looks_through_cells() && Space::kSight == Sight::cells) || is_tested(node.cell, parent.cell)
            ? std::numeric_limits<double>::infinity()
            : parent.cost + straight_cost(node.cell, node.point, parent.point);
    if (!is_seen) node.seen = Cone<D>::empty();  // Only the point may be.
    if (!(best <= node.cost + kEqual)) {
      const double through = cost_through(node.cell, node.point, nodes_[node.via], node.bend);
      if (through < best) {
        best = through;
        node.parent = node.via;
      }
      if (node.goal == kNoGoal) best = try_beside(node, best);
      look(node);
      if (!std::isfinite(best)) {  // It may still be reached through another cell.
        node.cost = node.total = best;
        return false;
      }
    }
    node.cost = best;
    node.is_certain = true;
    const double before = node.total;
    const double total = node.cost + left_from(node, node.point);
    if (total <= before + kEqual || open_.empty() || total <= open_.top().total) return true;
    push(number);
    return false;
  }
  /// Costs on a way are only known from a walk along it.
  [[nodiscard]] bool looks_through_cells() const {
    return Space::kSight != Sight::walk && (unknown_cost_ == 1.0 || !std::isfinite(unknown_cost_));
  }
  /// What is seen from the cell beside that a node was reached from, if that is its parent.
  void look(Node& node) {
    const Node& parent = nodes_[node.parent];
    node.seen = Cone<D>::empty();
    if (node.parent != node.via || is_tested(node.cell, parent.cell) || node.goal != kNoGoal) return;
    node.seen = Cone<D>();
    node.seen.narrow(common_box(parent.cell, node.cell), parent.point);
  }
  /// Whether a way from one cell to another is only free if the space says so.
  [[nodiscard]] bool is_tested(const Cell& a, const Cell& b) const {
    if constexpr (Space::kTestsWays) return space_.is_tested(a, b);
    return false;
  }
  /// Where a way that comes from a point enters a cell beside.
  [[nodiscard]] Vector<D> entry(const Cell& from_cell, const Cell& cell, const Vector<D>& from) {
    if constexpr (Space::kTestsWays)
      if (space_.is_tested(from_cell, cell)) return space_.entry(from_cell, cell, from);
    return point_on(common_box(from_cell, cell), from);
  }
  [[nodiscard]] double straight_cost(const Cell& cell, const Vector<D>& from, const Vector<D>& to) {
    if constexpr (Space::kTestsWays) {
      return cost_of_way(space_.cells_like(cell), from, to, unknown_cost_);
    } else {
      (void)cell;
      return cost_of_way(space_, from, to, unknown_cost_);
    }
  }
  /// The cost of a way to a point in a cell through an expanded cell beside, or the same; infinite if it is
  /// not free.
  [[nodiscard]] double cost_through(const Cell& cell, const Vector<D>& point, const Node& via, Bend& bend) {
    bend = {};
    if constexpr (Space::kTestsWays)
      if (space_.is_tested(cell, via.cell))
        return via.cost + space_.length_between(via.cell, via.point, cell, point, bend) * rate(via.cell);
    return via.cost + (via.point - point).norm() * rate(via.cell);
  }
  /// Takes the best way through an expanded cell beside, if it is better; of those that have to
  /// be tested, if there is none.
  double try_beside(Node& node, double best) {
    space_.for_each_beside(node.cell, [&](const Cell& beside) {
      const std::uint32_t number = numbers_.find(beside.number);
      if (number == NumberTable::kNone || !nodes_[number].is_expanded) return;
      if (is_tested(beside, node.cell) && std::isfinite(best)) return;
      const Node& other = nodes_[number];
      const Vector<D> point = entry(beside, node.cell, other.point);
      Bend bend{};
      const double cost = cost_through(node.cell, point, other, bend);
      const double gain = best + left_from(node, node.point) - cost - left_from(node, point);
      if (!(gain > kEqual)) return;
      best = cost;
      node.point = point;
      node.bend = bend;
      node.parent = node.via = number;
    });
    return best;
  }

  void expand(std::uint32_t number) {
    const Node node = nodes_[number];
    const std::uint32_t parent = node.parent;
    const Vector<D> from = nodes_[parent].point;
    const double cost = nodes_[parent].cost;
    space_.for_each_beside(node.cell, [&](const Cell& beside) {
      pace_.spend(4);
      std::uint32_t& found = numbers_[beside.number];
      if (found == NumberTable::kNone) {
        found = static_cast<std::uint32_t>(nodes_.size());
        nodes_.emplace_back();
        nodes_.back().cell = beside;
      }
      if (nodes_[found].is_expanded) return;
      const Box<D> face = common_box(node.cell, beside);
      Cone<D> seen = node.seen;
      if (is_tested(node.cell, beside))
        seen = Cone<D>::empty();
      else
        seen.narrow(face, from);
      offer(found, {number, parent, cost, from}, seen.moved_into(entry(node.cell, beside, from), face, from),
            seen);
    });
    if (goal_numbers_.find(node.cell.number) == NumberTable::kNone) return;
    for (std::size_t i = 0; i < goals_.size(); ++i) {
      if (goals_[i].cell.number != node.cell.number) continue;
      const auto goal = static_cast<std::uint32_t>(nodes_.size());
      nodes_.emplace_back();
      nodes_.back().cell = node.cell;
      nodes_.back().goal = static_cast<std::uint32_t>(i);
      offer(goal, {number, parent, cost, from}, goals_[i].point, node.seen);
    }
  }
  /// Through a node, straight on from its parent.
  struct Way {
    std::uint32_t via, parent;
    double cost;     // As far as the parent.
    Vector<D> from;  // Where that is.
  };
  void offer(std::uint32_t number, const Way& way, const Vector<D>& point, const Cone<D>& seen) {
    Node& node = nodes_[number];
    const double cost = way.cost + (point - way.from).norm();
    const double total = cost + left_from(node, point);
    if (!(total < node.total - kEqual)) return;
    node.point = point;
    node.cost = cost;
    node.parent = way.parent;
    node.via = way.via;
    node.seen = seen;
    node.is_certain = false;
    push(number);
  }

  static constexpr double kEqual = 1e-9;  // Costs nearer than this, in smallest cells, are the same.

  Space& space_;
  GoalFlood<Space> flood_;
  double unknown_cost_;
  double greed_;
  Guide* guide_;
  std::size_t most_cells_ = ~std::size_t{0};
  Vector<D> goal_ = Vector<D>::Zero();
  bool aims_ = false;  // At one goal.
  std::vector<Node> nodes_;
  NumberTable numbers_;
  std::priority_queue<Entry> open_;
  std::vector<std::uint32_t> starts_;
  std::vector<Anchor<D>> goals_;
  NumberTable goal_numbers_;
  std::size_t next_flood_ = 512;
  std::size_t expanded_ = 0;
  std::uint32_t end_ = 0;
  Pace pace_;
};

}  // namespace ndtree::detail
