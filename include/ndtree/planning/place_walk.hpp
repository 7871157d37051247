// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A straight way through the free space of a body.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "ndtree/core/types.hpp"
#include "ndtree/planning/free_space.hpp"

namespace ndtree::detail {

/// The smallest cell that a way goes through from a point on; points are in smallest cells. Where the point
/// lies on a border, it is the one ahead.
template <int D>
[[nodiscard]] Lattice<D> cell_ahead(const Vector<D>& point, const Vector<D>& way) {
  Lattice<D> cell;
  for (int a = 0; a < D; ++a) {
    const double floor = std::floor(point[a]);
    cell[static_cast<std::size_t>(a)] =
        static_cast<std::int64_t>(floor) - static_cast<std::int64_t>(floor == point[a] && way[a] < 0.0);
  }
  return cell;
}

/// The cost of a straight way, in smallest cells: its length, that in costly cells times `unknown_cost`, that
/// in blocked ones times `blocked_cost`. O(cells on the way).
template <class Space>
[[nodiscard]] double cost_of_way(Space& space, const Vector<Space::D>& from, const Vector<Space::D>& to,
                                 double unknown_cost,
                                 double blocked_cost = std::numeric_limits<double>::infinity()) {
  constexpr int D = Space::D;
  const Vector<D> way = to - from;
  const double length = way.norm();
  Lattice<D> at = cell_ahead<D>(from, way);
  double begin = 0.0;
  double cost = 0.0;
  auto cell = space.cell_at(at);
  for (bool is_joined = true;;) {
    const bool is_blocked = cell.passage == Passage::blocked || !is_joined;
    if (is_blocked && !std::isfinite(blocked_cost)) return blocked_cost;
    double end = 1.0;
    int axis = -1;
    for (int a = 0; a < D; ++a) {
      if (way[a] == 0.0) continue;
      const std::int64_t border = cell.lower[static_cast<std::size_t>(a)] + (way[a] > 0.0 ? cell.edge : 0);
      const double t = (static_cast<double>(border) - from[a]) / way[a];
      if (t >= end) continue;
      end = t;
      axis = a;
    }
    end = std::max(end, begin);
    cost += (end - begin) * length *
            (is_blocked                        ? blocked_cost
             : cell.passage == Passage::costly ? unknown_cost
                                               : 1.0);
    if (axis < 0) return cost;
    for (int a = 0; a < D; ++a) {
      const auto b = static_cast<std::size_t>(a);
      at[b] = std::clamp(static_cast<std::int64_t>(std::floor(from[a] + end * way[a])), cell.lower[b],
                         cell.lower[b] + cell.edge - 1);
    }
    const auto b = static_cast<std::size_t>(axis);
    at[b] = way[axis] > 0.0 ? cell.lower[b] + cell.edge : cell.lower[b] - 1;
    begin = end;
    const auto before = cell;
    cell = space.cell_at(at);
    if constexpr (Space::kHasWalls)
      is_joined = cell.passage == Passage::blocked || space.are_joined(before, cell, axis, way[axis] > 0.0);
  }
}

}  // namespace ndtree::detail
