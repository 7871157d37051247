// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Free space with its gaps: smallest cells in which a body is free at some place, not wherever it stands.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/free_space.hpp"
#include "ndtree/planning/number_table.hpp"
#include "ndtree/planning/sweep.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree::detail {

/// How far apart a shape and a box are [m]; if they overlap, less than 0.
template <int D>
[[nodiscard]] double gap_between(const Capsule<D>& capsule, const Box<D>& box) {
  return std::sqrt(squared_distance<D>(capsule.a, capsule.b, box)) - capsule.radius;
}
/// Along the separating axis that tells the most.
[[nodiscard]] inline double gap_between(const OrientedBox<2>& oriented, const Box<2>& box) {
  const Vector<2> half = 0.5 * (box.upper - box.lower);
  const Vector<2> between = oriented.center - 0.5 * (box.upper + box.lower);
  double gap = -std::numeric_limits<double>::infinity();
  const auto look_along = [&](const Vector<2>& axis) {
    const double others = oriented.half_size.dot((oriented.axes.transpose() * axis).cwiseAbs());
    gap = std::max(gap, std::abs(between.dot(axis)) - half.dot(axis.cwiseAbs()) - others);
  };
  for (int k = 0; k < 2; ++k) {
    look_along(Vector<2>::Unit(k));
    look_along(oriented.axes.col(k));
  }
  return gap;
}

/// The cells of a free space, and the smallest cells beside them that may be free at some place. Such a
/// narrow cell has one point: where the body has the most room in it, found by a compass search. Only the
/// exact test of the swept volume says whether a way to that point is free: a gap is found if it is hardly
/// wider than the body, as the points of its cells lie in its middle. Points are in smallest cells. What is
/// found out lasts as long as this.
template <class Map>
class NarrowSpace {
 public:
  static constexpr int D = Map::kDim;
  using Cell = PlaceCell<D>;
  static constexpr bool kHasWalls = false;
  static constexpr bool kTestsWays = true;
  static constexpr Sight kSight = Sight::cells_and_walk;

  /// @param sure cells that are free wherever the body stands. @param possible all that may be free.
  /// @param tested the body, as much larger as it shall stay away from obstacles.
  NarrowSpace(const Map& map, FreeSpace<Map>& sure, FreeSpace<Map>& possible, const Body<D>& tested,
              UnknownSpace unknown)
      : map_(map),
        sure_(sure),
        possible_(possible),
        tested_(tested),
        unit_(map.tree().geometry().unit()),
        reach_(reach_of(tested)),
        unknown_(unknown),
        gaps_(sure.limits()) {
    const CellIndex<D> root = map.tree().root().index;
    const auto reach = static_cast<std::int64_t>(reach_ / unit_) + 2;
    for (std::size_t a = 0; a < D; ++a) {
      gaps_.lower[a] = std::max(gaps_.lower[a], root.lower[a] - reach);
      gaps_.upper[a] =
          std::min(gaps_.upper[a], root.lower[a] + map.tree().geometry().edge(root.level) + reach);
    }
  }

  [[nodiscard]] std::size_t memory_bytes() const {
    return places_.memory_bytes() + points_.capacity() * sizeof(Point);
  }
  [[nodiscard]] static bool is_narrow(const Cell& cell) { return cell.number >> 63 != 0; }
  /// What is narrow is blocked: a way that goes through it is tested in another way.
  [[nodiscard]] Cell cell_at(const Lattice<D>& at) { return sure_.cell_at(at); }
  [[nodiscard]] FreeSpace<Map>& cells_like(const Cell&) { return sure_; }
  [[nodiscard]] static bool is_tested(const Cell& a, const Cell& b) { return is_narrow(a) || is_narrow(b); }
  /// Of a way into a cell beside: the point of a narrow one, else the nearest.
  [[nodiscard]] Vector<D> entry(const Cell& from_cell, const Cell& cell, const Vector<D>& from) const {
    return is_narrow(cell) ? point_in(cell) : on_face(from_cell, cell, from);
  }
  /// Of a way from a cell to one beside; infinite if it is not free. Into a narrow cell from one that is not,
  /// it has a bend at the side between them.
  [[nodiscard]] double length_between(const Cell& from_cell, Vector<D> from, const Cell& cell,
                                      const Vector<D>& to, std::optional<Vector<D>>& bend) {
    double length = 0.0;
    if (is_narrow(cell) && !is_narrow(from_cell)) {
      bend = on_face(from_cell, cell, to);
      length = (*bend - from).norm();
      from = *bend;
    }
    const bool is_open =
        is_narrow(cell) && is_narrow(from_cell) ? are_joined(from_cell, cell) : is_clear(from, to);
    return is_open ? length + (to - from).norm() : std::numeric_limits<double>::infinity();
  }
  /// Calls `visit(cell)` for each cell that shares a face with one, and is not blocked.
  template <class Visit>
  void for_each_beside(const Cell& cell, const Visit& visit) {
    if (!is_narrow(cell)) sure_.for_each_beside(cell, visit);
    LatticeBox<D> box{cell.lower, cell.lower};
    for (std::int64_t& x : box.upper) x += cell.edge;
    for (std::size_t a = 0; a < D; ++a)
      for (const std::int64_t beside : {box.lower[a] - 1, box.upper[a]}) {
        LatticeBox<D> face = box;
        face.lower[a] = beside;
        face.upper[a] = beside + 1;
        at_face(face, is_narrow(cell), visit);
      }
  }
  /// The narrow cell at a place; none if the body does not fit there.
  [[nodiscard]] std::optional<Cell> narrow_at(const Lattice<D>& at) {
    std::uint64_t number = 0;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t from_border = at[a] - gaps_.lower[a];
      if (from_border < 0 || from_border >= kWidest || at[a] >= gaps_.upper[a]) return std::nullopt;
      number = number * static_cast<std::uint64_t>(kWidest) + static_cast<std::uint64_t>(from_border);
    }
    number |= std::uint64_t{1} << 63;
    std::uint32_t& place = places_[number];
    if (place == NumberTable::kNone) {
      const std::optional<Vector<D>> point = is_gap(at) ? roomiest(at) : std::nullopt;
      place = point ? static_cast<std::uint32_t>(points_.size()) : kNowhere;
      if (point) points_.push_back({*point, {}});
    }
    if (place == kNowhere) return std::nullopt;
    return Cell{at, 1, sure_.has_costs() ? Passage::costly : Passage::free, number};
  }

 private:
  /// Of a narrow cell, and whether the way to that of the cell beside is free, by axis and side, once it was
  /// asked.
  struct Point {
    Vector<D> at;
    std::array<std::optional<bool>, 2 * std::size_t{D}> is_joined;
  };

  /// @pre the cell is narrow.
  [[nodiscard]] const Vector<D>& point_in(const Cell& cell) const {
    return points_[places_.find(cell.number)].at;
  }
  /// Whether the way between the points of two narrow cells that share a face is free.
  [[nodiscard]] bool are_joined(const Cell& from, const Cell& to) {
    std::size_t a = 0;
    while (from.lower[a] == to.lower[a]) ++a;
    auto& point = points_[places_.find(from.number)];
    auto& is_joined = point.is_joined[2 * a + (to.lower[a] > from.lower[a] ? 1 : 0)];
    if (!is_joined) is_joined = is_clear(point.at, point_in(to));
    return *is_joined;
  }
  [[nodiscard]] bool is_clear(const Vector<D>& from, const Vector<D>& to) const {
    return !sweep_collides(map_, tested_, Vector<D>(from * unit_), Vector<D>(to * unit_), unknown_);
  }
  /// The nearest point of the side that two cells share.
  [[nodiscard]] static Vector<D> on_face(const Cell& a, const Cell& b, const Vector<D>& point) {
    return nearest_in(common_box(a, b), point);
  }
  /// @param all or only narrow cells.
  template <class Visit>
  void at_face(LatticeBox<D> face, bool all, const Visit& visit) {
    for (std::size_t a = 0; a < D && !all; ++a) {
      face.lower[a] = std::max(face.lower[a], gaps_.lower[a]);
      face.upper[a] = std::min(face.upper[a], gaps_.upper[a]);
      if (face.lower[a] >= face.upper[a]) return;
    }
    Lattice<D> at = face.lower;
    for (bool goes_on = true; goes_on;) {
      std::int64_t step = 1;
      const Cell sure = sure_.cell_at(at);
      if (sure.passage != Passage::blocked) {
        if (all) visit(sure);
        step = sure.lower[run_] + sure.edge - at[run_];
      } else if (possible_.cell_at(at).passage != Passage::blocked) {
        if (const std::optional<Cell> narrow = narrow_at(at)) visit(*narrow);
      }
      goes_on = advance(at, face, step);
    }
  }
  static bool advance(Lattice<D>& at, const LatticeBox<D>& box, std::int64_t step) {
    for (std::size_t a = 0; a < D; ++a, step = 1) {
      at[a] += step;
      if (at[a] < box.upper[a]) return true;
      at[a] = box.lower[a];
    }
    return false;
  }

  [[nodiscard]] bool is_sure(const Lattice<D>& at) { return sure_.cell_at(at).passage != Passage::blocked; }
  [[nodiscard]] bool is_open(const Lattice<D>& at) {
    return possible_.cell_at(at).passage != Passage::blocked || is_sure(at);
  }
  [[nodiscard]] static Lattice<D> moved_by(Lattice<D> at, std::size_t axis, std::int64_t by) {
    at[axis] += by;
    return at;
  }
  /// Whether a way through a place may lead to others than ways through sure cells beside it: not where there
  /// is a wall behind it, along which there are sure cells.
  [[nodiscard]] bool is_gap(const Lattice<D>& at) {
    bool is_deep = true;
    for (std::size_t a = 0; a < D; ++a)
      for (const int side : {-1, 1}) {
        const Lattice<D> sure = moved_by(at, a, side);
        if (!is_sure(sure)) continue;
        is_deep = false;
        if (is_open(moved_by(at, a, -side))) return true;
        for (std::size_t b = 0; b < D; ++b)
          for (const int along : {-1, 1})
            if (b != a && !is_sure(moved_by(sure, b, along)) && is_open(moved_by(at, b, along))) return true;
      }
    return is_deep;
  }

  /// How far the body is from obstacles at a point, in smallest cells, at most kEnough; if it overlaps one,
  /// less than 0.
  [[nodiscard]] double room_at(const Vector<D>& point, const std::vector<Box<D>>& obstacles) const {
    const Vector<D> at = point * unit_;
    const Box<D> root = map_.tree().box(map_.tree().root().index);
    double room = kEnough * unit_;
    for (const BodyPart<D>& part : tested_) {
      const Box<D> bounds = bounds_of(part);
      if (unknown_ == UnknownSpace::occupied)
        room = std::min(
            {room, (at + bounds.lower - root.lower).minCoeff(), (root.upper - at - bounds.upper).minCoeff()});
      for (const Box<D>& box : obstacles) {
        const Box<D> seen{box.lower - at, box.upper - at};
        room = std::min(room, std::visit([&](const auto& one) { return gap_between(one, seen); }, part));
      }
    }
    return room / unit_;
  }
  /// Obstacles within kEnough of the body at any point of a smallest cell.
  [[nodiscard]] std::vector<Box<D>> obstacles_near(const Vector<D>& lower) const {
    const Box<D> cell{lower * unit_, (lower.array() + 1.0).matrix() * unit_};
    const double reach = kEnough * unit_ + reach_;
    std::vector<Box<D>> found;
    const auto squared_reach = [&] { return reach * reach; };
    const auto enter = [&](const Box<D>& box, bool is_leaf) {
      if (is_leaf) found.push_back(box);
      return !is_leaf;
    };
    ObstacleWalk(map_.tree(), cell, obstacles_of(map_, unknown_), squared_reach, enter).run();
    return found;
  }
  [[nodiscard]] std::optional<Vector<D>> roomiest(const Lattice<D>& at) const {
    Vector<D> point;
    for (int a = 0; a < D; ++a) point[a] = static_cast<double>(at[static_cast<std::size_t>(a)]) + 0.5;
    if constexpr (D == 2) {
      const Vector<D> lower = (point.array() - 0.5).matrix();
      const std::vector<Box<D>> obstacles = obstacles_near(lower);
      double room = room_at(point, obstacles);
      if (room + 0.5 * std::sqrt(2.0) < -1e-6) return std::nullopt;
      for (double step = 0.25; step >= kLeastStep && room < kEnough;) {
        const Vector<D> from = point;
        for (const Vector<D>& direction : directions()) {
          const Vector<D> other =
              (from + step * direction).cwiseMax(lower).cwiseMin((lower.array() + 1.0).matrix());
          const double there = room_at(other, obstacles);
          if (!(there > room + 1e-6)) continue;
          room = there;
          point = other;
        }
        if (point == from) step *= 0.5;
      }
      if (!is_clear(point, point)) return std::nullopt;
    }
    return point;
  }
  [[nodiscard]] static const std::vector<Vector<D>>& directions() {
    static const std::vector<Vector<D>> all = [] {
      std::vector<Vector<D>> made;
      for (int a = 0; a < D; ++a)
        for (const double sign : {-1.0, 1.0}) made.push_back(sign * Vector<D>::Unit(a));
      for (unsigned corner = 0; corner < 1u << D; ++corner) {
        Vector<D> diagonal;
        for (int a = 0; a < D; ++a) diagonal[a] = (corner >> a & 1u) != 0 ? 0.7 : -0.7;
        made.push_back(diagonal);
      }
      return made;
    }();
    return all;
  }

  static constexpr std::size_t run_ = 0;
  static constexpr std::int64_t kWidest = std::int64_t{1} << (D == 2 ? 31 : 21);
  static constexpr std::uint32_t kNowhere = NumberTable::kNone - 1;
  static constexpr double kEnough = 0.5;  // More room is not looked for.
  static constexpr double kLeastStep = 0.06;

  const Map& map_;
  FreeSpace<Map>& sure_;
  FreeSpace<Map>& possible_;
  const Body<D>& tested_;
  double unit_;
  double reach_;
  UnknownSpace unknown_;
  LatticeBox<D> gaps_;  // No gap is farther from what was observed than the body reaches.
  NumberTable places_;
  std::vector<Point> points_;
};

}  // namespace ndtree::detail
