// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Signed distance to obstacles on a grid of points, exact for cells of any size.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/nearest_boxes.hpp"

namespace ndtree {

/// Signed distances [m] at the centres of equal cells that fill a box: positive outside obstacles, up to
/// max_distance; negative inside, where it is the distance to the nearest space that is none, down to
/// -max_distance; 0 on a border.
template <int D>
class DistanceField {
 public:
  using Shape = typename FieldGrid<D>::Shape;

  /// @param lower corner of the grid. @param shape cells on each axis. @param unknown space, what it counts
  /// for.
  DistanceField(const Vector<D>& lower, double cell_size, const Shape& shape, double max_distance,
                UnknownSpace unknown = UnknownSpace::free)
      : grid_(lower, cell_size, shape), max_distance_(max_distance), unknown_(unknown) {
    values_.assign(grid_.size(), static_cast<float>(max_distance));
  }

  [[nodiscard]] const FieldGrid<D>& grid() const { return grid_; }
  [[nodiscard]] const Vector<D>& lower() const { return grid_.lower(); }
  [[nodiscard]] double cell_size() const { return grid_.cell_size(); }
  [[nodiscard]] const Shape& shape() const { return grid_.shape(); }
  [[nodiscard]] double max_distance() const { return max_distance_; }
  [[nodiscard]] UnknownSpace unknown() const { return unknown_; }
  [[nodiscard]] double center(std::size_t axis, std::size_t i) const { return grid_.center(axis, i); }
  /// Where the value of a cell is.
  [[nodiscard]] std::size_t index(const Shape& cell) const { return grid_.index(cell); }
  /// In the order of a C array: the last axis varies fastest.
  [[nodiscard]] const std::vector<float>& values() const { return values_; }
  [[nodiscard]] std::vector<float>& values() { return values_; }

  /// Between the centres of cells, linear on each axis; NaN outside the grid, and constant towards its border
  /// from the last centres on.
  [[nodiscard]] double distance(const Vector<D>& point) const {
    Corners corners;
    return find(point, corners) ? sum(corners, -1) : std::numeric_limits<double>::quiet_NaN();
  }
  /// Of distance(); towards free space.
  [[nodiscard]] Vector<D> gradient(const Vector<D>& point) const {
    Corners corners;
    if (!find(point, corners)) return Vector<D>::Constant(std::numeric_limits<double>::quiet_NaN());
    Vector<D> result;
    for (int a = 0; a < D; ++a) result[a] = sum(corners, a) / cell_size();
    return result;
  }

 private:
  struct Corners {
    std::array<std::size_t, std::size_t{D}> first;
    std::array<std::size_t, std::size_t{D}> second;  // The same at the border.
    std::array<double, std::size_t{D}> share;        // Of the second.
  };

  [[nodiscard]] bool find(const Vector<D>& point, Corners& corners) const {
    for (std::size_t a = 0; a < D; ++a) {
      const double place = (point[static_cast<int>(a)] - lower()[static_cast<int>(a)]) / cell_size();
      const auto count = static_cast<double>(shape()[a]);
      if (!(place >= 0.0) || !(place <= count)) return false;
      const double centre = std::clamp(place - 0.5, 0.0, count - 1.0);
      corners.first[a] = std::min(static_cast<std::size_t>(centre), shape()[a] - 1);
      corners.second[a] = std::min(corners.first[a] + 1, shape()[a] - 1);
      corners.share[a] = centre - static_cast<double>(corners.first[a]);
    }
    return true;
  }
  /// The value, or, for an axis, its difference from one centre to the next.
  [[nodiscard]] double sum(const Corners& corners, int along) const {
    double total = 0.0;
    for (unsigned corner = 0; corner < 1u << D; ++corner) {
      double weight = 1.0;
      Shape cell;
      for (std::size_t a = 0; a < D; ++a) {
        const bool is_second = (corner >> a & 1u) != 0;
        cell[a] = is_second ? corners.second[a] : corners.first[a];
        if (static_cast<int>(a) == along)
          weight *= is_second ? 1.0 : -1.0;
        else
          weight *= is_second ? corners.share[a] : 1.0 - corners.share[a];
      }
      total += weight * static_cast<double>(values_[index(cell)]);
    }
    return total;
  }

  FieldGrid<D> grid_;
  double max_distance_;
  UnknownSpace unknown_;
  std::vector<float> values_;
};

namespace detail {

template <int D>
struct ObstaclesOf {
  RegionStates obstacles;
  RegionStates others;

  explicit ObstaclesOf(UnknownSpace unknown) {
    obstacles.occupied = true;
    obstacles.unknown = unknown == UnknownSpace::occupied;
    others.free = true;
    others.unknown = !obstacles.unknown;
  }
};

/// Gives all values of the points that are asked for, and maybe of some others of a block.
/// @param obstacles, others boxes of what is one and what is not, as far as max_distance around the block;
///   `others()` is asked only if a point lies in an obstacle. @param wants as in NearestBoxes::run().
/// @param set(index, value) sets one.
template <int D, class Others, class Wants, class Set>
void fill(const DistanceField<D>& field, const GridBlock<D>& block, const std::vector<Box<D>>& obstacles,
          const Others& others, const Wants& wants, const Set& set) {
  const std::vector<float>& values = field.values();
  const auto most = static_cast<float>(field.max_distance());
  const auto value_of = [most](double squared) {
    return squared < std::numeric_limits<double>::infinity() ? static_cast<float>(std::sqrt(squared)) : most;
  };
  std::vector<Box<D>> with_inside;  // Blocks of points, of which some lie in an obstacle.
  bool any_inside = false;
  NearestBoxes<D>(field.grid(), BoxTree<D>(obstacles), field.max_distance())
      .run(
          block, wants,
          [&](std::size_t i, double squared) {
            set(i, value_of(squared));
            any_inside = any_inside || values[i] == 0.0f;
          },
          [&](const Box<D>& points) {
            if (any_inside) with_inside.push_back(points);
            any_inside = false;
          });
  if (with_inside.empty()) return;
  const BoxTree<D> inside(with_inside);
  NearestBoxes<D>(field.grid(), BoxTree<D>(others()), field.max_distance())
      .run(
          block,
          [&](const auto&, const auto&, const Box<D>& points) { return inside.any_within(points, 0.0); },
          [&](std::size_t i, double squared) {
            if (values[i] == 0.0f) set(i, -value_of(squared));
          },
          [](const Box<D>&) {});
}

}  // namespace detail

/// Signed Euclidean distance to the nearest obstacle, at the centres of cells of `cell_size` that fill a box:
/// exact, whatever the sizes of the map's cells and of these.
/// @param box is rounded up to whole cells, from its lower corner on.
/// @param max_distance that matters, > 0 [m]. @param unknown an obstacle or not.
/// @throws std::invalid_argument if the box is empty or not finite, or a size not > 0 and finite.
/// O((cells of the field + map cells around it) log).
template <class Map>
[[nodiscard]] DistanceField<Map::kDim> distance_field(const Map& map, const Box<Map::kDim>& box,
                                                      double cell_size, double max_distance,
                                                      UnknownSpace unknown = UnknownSpace::free) {
  constexpr int D = Map::kDim;
  const auto require = [](bool holds, const char* name, double value, const char* what) {
    if (!holds)
      throw std::invalid_argument(std::string(name) + " = " + describe_number(value) + " m: " + what);
  };
  require(cell_size > 0.0 && std::isfinite(cell_size), "cell_size", cell_size, "must be > 0 and finite");
  require(max_distance > 0.0 && std::isfinite(max_distance), "max_distance", max_distance,
          "must be > 0 and finite");
  typename DistanceField<D>::Shape shape;
  double cells = 1.0;
  for (int a = 0; a < D; ++a) {
    const double extent = box.upper[a] - box.lower[a];
    require(extent > 0.0 && std::isfinite(extent), "extent of the box", extent, "must be > 0 and finite");
    const double count = std::max(1.0, std::ceil(extent / cell_size - 1e-9));
    cells *= count;
    require(cells <= 4e9, "cell_size", cell_size, "the box has more than 4e9 such cells");
    shape[static_cast<std::size_t>(a)] = static_cast<std::size_t>(count);
  }
  DistanceField<D> field(box.lower, cell_size, shape, max_distance, unknown);
  const detail::ObstaclesOf<D> states(unknown);
  const Box<D> around = field.grid().box().inflated(max_distance);
  detail::fill(
      field, GridBlock<D>{{}, field.shape()}, boxes_of(map, around, states.obstacles),
      [&] { return boxes_of(map, around, states.others); },
      [](const auto&, const auto&, const auto&) { return true; },
      [&](std::size_t i, float value) { field.values()[i] = value; });
  return field;
}

/// Brings a field up to date after a map has changed: as distance_field() would fill it in now. What is
/// looked at again are points for which something that changed is no farther than what was nearest.
/// @param changes of the map since the field was made or updated, see changes().
/// @throws std::bad_alloc, Cancelled; the field is then as it was.
template <class Map>
void update(DistanceField<Map::kDim>& field, const Map& map, const std::vector<Change<Map::kDim>>& changes) {
  constexpr int D = Map::kDim;
  const detail::ObstaclesOf<D> states(field.unknown());
  const Box<D> reach = field.grid().box().inflated(field.max_distance());
  std::vector<Box<D>> changed;
  for (const Change<D>& change : changes)
    if (contains(states.obstacles, change.before) != contains(states.obstacles, change.after)) {
      const Box<D> box = map.tree().geometry().box(change.index);
      if (box.touches(reach)) changed.push_back(box);
    }
  if (changed.empty()) return;
  Box<D> around = changed.front();
  for (const Box<D>& box : changed)
    around = {around.lower.cwiseMin(box.lower), around.upper.cwiseMax(box.upper)};
  // Points as far as max_distance from a change, and all that is so near to them.
  around = around.inflated(field.max_distance());
  GridBlock<D> block;
  for (std::size_t a = 0; a < D; ++a) {
    block.first[a] = field.grid().first_not_below(a, around.lower[static_cast<int>(a)]);
    block.last[a] = field.grid().first_not_below(a, around.upper[static_cast<int>(a)]);
  }
  around = around.inflated(field.max_distance());
  around = {around.lower.cwiseMax(reach.lower), around.upper.cwiseMin(reach.upper)};
  const BoxTree<D> tree(changed);
  const auto wants = [&](const auto& first, const auto& last, const Box<D>& points) {
    constexpr std::size_t kFew = 1024;  // Points that are worth a look at each.
    constexpr double kRounding = 1e-5;  // Of values, relatively.
    double farthest = field.max_distance();
    std::size_t n = 1;
    for (std::size_t a = 0; a < D; ++a) n *= last[a] - first[a];
    if (n <= kFew) {
      float most = 0.0f;
      detail::any_place(first, last, [&](const auto& at) {
        most = std::max(most, std::abs(field.values()[field.index(at)]));
        return false;
      });
      farthest = static_cast<double>(most) * (1.0 + kRounding);
    }
    return tree.any_within(points, farthest);
  };
  std::vector<std::pair<std::size_t, float>> before;
  try {
    detail::fill(
        field, block, boxes_of(map, around, states.obstacles),
        [&] { return boxes_of(map, around, states.others); }, wants,
        [&](std::size_t i, float value) {
          before.emplace_back(i, field.values()[i]);
          field.values()[i] = value;
        });
  } catch (...) {
    for (; !before.empty(); before.pop_back()) field.values()[before.back().first] = before.back().second;
    throw;
  }
}

}  // namespace ndtree
