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
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/distance_transform.hpp"
#include "ndtree/query/field_grid.hpp"
#include "ndtree/query/region.hpp"

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

/// What counts as an obstacle, and what does not.
struct ObstacleStates {
  RegionStates obstacles;
  RegionStates others;

  template <class Map>
  ObstacleStates(const Map& map, UnknownSpace unknown)
      : obstacles(obstacles_of(map, unknown)), others{false, true, !obstacles.unknown, obstacles.thin} {}
};

/// How far a field looks.
class DistanceLimit {
 public:
  /// @param most distance that matters [m].
  explicit DistanceLimit(double most)
      : most_(static_cast<float>(most)), squared_(static_cast<float>(most * most)) {}

  /// From here on, a squared distance means that nothing is near.
  [[nodiscard]] float squared() const { return squared_; }
  /// The value of a field for a squared distance.
  [[nodiscard]] float distance(float squared) const {
    return squared < squared_ ? std::min(std::sqrt(squared), most_) : most_;
  }

 private:
  float most_;
  float squared_;
};

/// Values for the points of one block.
template <int D>
class BlockValues {
 public:
  using Shape = typename FieldGrid<D>::Shape;

  explicit BlockValues(const GridBlock<D>& block) : block_(block), values_(block.size()) {}

  [[nodiscard]] float& operator[](const Shape& at) { return values_[block_.index(at)]; }

 private:
  GridBlock<D> block_;
  std::vector<float> values_;
};

/// The values of distance fields of one map.
template <class Map>
class FieldValues {
 public:
  static constexpr int D = Map::kDim;
  using Shape = typename FieldGrid<D>::Shape;
  using Block = GridBlock<D>;

  FieldValues(const Map& map, const DistanceField<D>& field, Pace& pace)
      : map_(map), field_(field), limit_(field.max_distance()), states_(map, field.unknown()), pace_(pace) {}

  /// Sets the values of a block. @param guess of how far to look: where that is not far enough, it is
  /// doubled.
  void find(BlockValues<D>& values, const Block& block, double guess) const {
    find_nearest(
        states_.obstacles, block, guess, [](const Shape&) { return true; },
        [&](const Shape& at, float distance) { values[at] = distance; });
    Block inside;
    any_place(block.first, block.last, [&](const Shape& at) {
      if (values[at] == 0.0f) inside.add(at);
      return false;
    });
    // Obstacles are thin, most of them.
    find_nearest(
        states_.others, inside, 4.0 * field_.cell_size(), [&](const Shape& at) { return values[at] <= 0.0f; },
        [&](const Shape& at, float distance) { values[at] = 0.0f - distance; });
  }

 private:
  template <class Wants, class Set>
  void find_nearest(const RegionStates& states, Block block, double guess, const Wants& wants,
                    const Set& set) const {
    const double most = field_.max_distance();
    for (double reach = std::min(guess, most); !block.empty(); reach = std::min(2.0 * reach, most)) {
      DistanceTransform<D> transform(field_.grid(), block, reach, pace_);
      const std::vector<float>& squared =
          transform.squared_distances(boxes_of(map_, transform.reach(), states));
      Block left;
      std::size_t i = 0;
      any_place(block.first, block.last, [&](const Shape& at) {
        const float found = squared[i++];
        if (!wants(at)) return false;
        if (found < transform.limit() || reach >= most)
          set(at, limit_.distance(found));
        else
          left.add(at);
        return false;
      });
      block = left;
    }
  }

  const Map& map_;
  const DistanceField<D>& field_;
  DistanceLimit limit_;
  ObstacleStates states_;
  Pace& pace_;
};

/// Calls `visit(block)` for the parts of a block that are at most so long, those of them that may matter.
/// @param step the length of all parts is a multiple of it, but at the block's end.
template <int D, class Matters, class Visit>
void for_each_part(const GridBlock<D>& block, std::size_t longest, std::size_t step, const Matters& matters,
                   const Visit& visit) {
  if (block.empty() || !matters(block)) return;
  std::size_t axis = 0;
  for (std::size_t a = 1; a < std::size_t{D}; ++a)
    if (block.last[a] - block.first[a] > block.last[axis] - block.first[axis]) axis = a;
  if (block.last[axis] - block.first[axis] <= longest) {
    visit(block);
    return;
  }
  GridBlock<D> half = block;
  const std::size_t steps = (block.last[axis] - block.first[axis] + step - 1) / step;
  half.last[axis] = block.first[axis] + steps / 2 * step;
  for_each_part(half, longest, step, matters, visit);
  half.first[axis] = half.last[axis];
  half.last[axis] = block.last[axis];
  for_each_part(half, longest, step, matters, visit);
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
    const double count = std::max(1.0, std::ceil(extent / cell_size - kOnBorder));
    cells *= count;
    require(cells <= 4e9, "cell_size", cell_size, "the box has more than 4e9 such cells");
    shape[static_cast<std::size_t>(a)] = static_cast<std::size_t>(count);
  }
  DistanceField<D> field(box.lower, cell_size, shape, max_distance, unknown);
  Pace pace;
  const detail::FieldValues<Map> values(map, field, pace);
  // As large as the space around it that is looked at, too, where far points change nothing.
  const double side =
      std::clamp(4.0 * max_distance / cell_size, D == 2 ? 128.0 : 16.0, D == 2 ? 1024.0 : 128.0);
  detail::for_each_part(
      GridBlock<D>{{}, field.shape()}, static_cast<std::size_t>(side), 1, [](const auto&) { return true; },
      [&](const GridBlock<D>& block) {
        detail::BlockValues<D> found(block);
        values.find(found, block, 0.5 * side * cell_size);
        detail::any_place(block.first, block.last, [&](const auto& at) {
          field.values()[field.index(at)] = found[at];
          return false;
        });
      });
  return field;
}

}  // namespace ndtree
