// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Searches over the grid of smallest cells, to compare with.
#pragma once

#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <queue>
#include <unordered_map>
#include <utility>
#include <vector>

#include "ndtree/planning/free_space.hpp"
#include "ndtree/planning/path_search.hpp"

namespace ndtree {

struct GridAnswer {
  double length = std::numeric_limits<double>::infinity();  ///< In smallest cells.
  std::size_t expanded = 0;
};

/// A free space whose cells are all smallest ones. Numbers are those of their coordinates.
template <class Space>
class GridSpace {
 public:
  static constexpr int D = Space::D;
  static constexpr bool kHasWalls = false;
  static constexpr bool kTestsWays = false;
  static constexpr detail::Sight kSight = detail::Sight::walk;

  explicit GridSpace(Space& space) : space_(space) {}
  [[nodiscard]] PlaceCell<D> cell_at(const Lattice<D>& at) {
    const PlaceCell<D> cell = space_.cell_at(at);
    std::uint64_t number = 0;
    for (std::size_t a = 0; a < D; ++a)
      number = (number << 21) + static_cast<std::uint64_t>(at[a] - space_.limits().lower[a]);
    return {at, 1, cell.passage, number};
  }
  template <class Visit>
  void for_each_beside(const PlaceCell<D>& cell, const Visit& visit) {
    for (std::size_t a = 0; a < D; ++a)
      for (const int by : {-1, 1}) {
        Lattice<D> at = cell.lower;
        at[a] += by;
        const PlaceCell<D> beside = cell_at(at);
        if (beside.passage != Passage::blocked) visit(beside);
      }
  }

 private:
  Space& space_;
};

/// Lazy Theta* as the planner has it, but for the size of cells, and without greed.
/// @param visit called with each cell that it looked at.
template <class Space, class Visit>
GridAnswer lazy_theta_on_grid(Space& space, const Vector<Space::D>& start, const Vector<Space::D>& goal,
                              const Visit& visit) {
  constexpr int D = Space::D;
  GridSpace<Space> grid(space);
  detail::PathSearch<GridSpace<Space>> search(grid, 1.0, 1.0);
  const auto anchor = [&](const Vector<D>& at) {
    return detail::Anchor<D>{at, grid.cell_at(detail::cell_ahead<D>(at, Vector<D>::Zero()))};
  };
  search.add_start(anchor(start));
  search.add_goal(anchor(goal));
  GridAnswer answer;
  const PathStatus status = search.run(goal, std::chrono::steady_clock::time_point::max());
  answer.expanded = search.expanded();
  search.for_each_expanded(visit);
  if (status != PathStatus::found) return answer;
  answer.length = 0.0;
  const auto points = search.path();
  for (std::size_t i = 0; i + 1 < points.size(); ++i) answer.length += (points[i + 1] - points[i]).norm();
  return answer;
}

/// A* over centres, to all cells that share a corner where all cells between are free, too.
template <class Space>
GridAnswer a_star_on_grid(Space& space, const Vector<Space::D>& start, const Vector<Space::D>& goal) {
  constexpr int D = Space::D;
  struct Node {
    double cost = std::numeric_limits<double>::infinity();
    bool is_expanded = false;
    Lattice<D> at{};
  };
  GridSpace<Space> grid(space);
  const auto from = grid.cell_at(detail::cell_ahead<D>(start, Vector<D>::Zero()));
  const auto to = grid.cell_at(detail::cell_ahead<D>(goal, Vector<D>::Zero()));
  std::unordered_map<std::uint64_t, Node> nodes;
  using Entry = std::pair<double, std::uint64_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
  const auto left = [&](const Lattice<D>& at) {
    double squared = 0.0;
    for (std::size_t a = 0; a < D; ++a) squared += std::pow(static_cast<double>(at[a] - to.lower[a]), 2);
    return std::sqrt(squared);
  };
  nodes[from.number] = {0.0, false, from.lower};
  open.emplace(left(from.lower), from.number);
  GridAnswer answer;
  while (!open.empty()) {
    const std::uint64_t number = open.top().second;
    open.pop();
    Node& node = nodes[number];
    if (node.is_expanded) continue;
    node.is_expanded = true;
    ++answer.expanded;
    if (number == to.number) {
      answer.length = node.cost;
      return answer;
    }
    const double cost = node.cost;
    const Lattice<D> at = node.at;
    unsigned blocked[27] = {};  // By steps 0, 1 or 2 less 1 on each axis.
    int count = 1;
    for (int a = 0; a < D; ++a) count *= 3;
    const auto step = [&](int code) {
      Lattice<D> offset;
      for (std::size_t a = 0; a < D; ++a, code /= 3) offset[a] = code % 3 - 1;
      return offset;
    };
    for (int code = 0; code < count; ++code) {
      Lattice<D> beside = at;
      for (std::size_t a = 0; a < D; ++a) beside[a] += step(code)[a];
      blocked[code] = grid.cell_at(beside).passage == Passage::blocked;
    }
    for (int code = 0; code < count; ++code) {
      if (blocked[code] != 0) continue;
      const Lattice<D> offset = step(code);
      bool is_clear = true;
      double squared = 0.0;
      for (std::size_t a = 0; a < D; ++a) squared += static_cast<double>(offset[a] * offset[a]);
      for (int other = 0; other < count && is_clear; ++other) {
        bool is_between = true;
        const Lattice<D> part = step(other);
        for (std::size_t a = 0; a < D; ++a) is_between = is_between && (part[a] == 0 || part[a] == offset[a]);
        is_clear = !is_between || blocked[other] == 0;
      }
      if (!is_clear) continue;
      Lattice<D> beside = at;
      for (std::size_t a = 0; a < D; ++a) beside[a] += offset[a];
      const auto cell = grid.cell_at(beside);
      Node& found = nodes[cell.number];
      const double way = cost + std::sqrt(squared);
      if (found.is_expanded || way >= found.cost) continue;
      found = {way, false, beside};
      open.emplace(way + left(beside), cell.number);
    }
  }
  return answer;
}

}  // namespace ndtree
