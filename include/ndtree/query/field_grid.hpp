// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The points of a distance field: the centres of equal cells that fill a box.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "ndtree/core/types.hpp"

namespace ndtree {

template <int D>
struct GridBlock;

/// The centres of equal cells that fill a box.
template <int D>
class FieldGrid {
 public:
  using Shape = std::array<std::size_t, std::size_t{D}>;

  /// @param lower corner of the grid. @param shape cells on each axis.
  FieldGrid(const Vector<D>& lower, double cell_size, const Shape& shape)
      : lower_(lower), cell_size_(cell_size), shape_(shape) {}

  [[nodiscard]] const Vector<D>& lower() const { return lower_; }
  [[nodiscard]] double cell_size() const { return cell_size_; }
  [[nodiscard]] const Shape& shape() const { return shape_; }
  /// Cells in all.
  [[nodiscard]] std::size_t size() const {
    std::size_t n = 1;
    for (const std::size_t count : shape_) n *= count;
    return n;
  }
  /// Around all cells.
  [[nodiscard]] Box<D> box() const {
    Box<D> box{lower_, lower_};
    for (std::size_t a = 0; a < D; ++a)
      box.upper[static_cast<int>(a)] += static_cast<double>(shape_[a]) * cell_size_;
    return box;
  }
  /// Coordinate of the centre of the i-th cell along an axis [m].
  [[nodiscard]] double center(std::size_t axis, std::size_t i) const {
    return lower_[static_cast<int>(axis)] + (static_cast<double>(i) + 0.5) * cell_size_;
  }
  /// Around the points of a block, which is not empty.
  [[nodiscard]] Box<D> box_of(const GridBlock<D>& block) const {
    Box<D> box;
    for (std::size_t a = 0; a < D; ++a) {
      box.lower[static_cast<int>(a)] = center(a, block.first[a]);
      box.upper[static_cast<int>(a)] = center(a, block.last[a] - 1);
    }
    return box;
  }
  /// Where a cell is in the order of a C array: the last axis varies fastest.
  [[nodiscard]] std::size_t index(const Shape& cell) const {
    std::size_t at = 0;
    for (std::size_t a = 0; a < D; ++a) at = at * shape_[a] + cell[a];
    return at;
  }

 private:
  Vector<D> lower_;
  double cell_size_;
  Shape shape_;
};

/// Points of a grid: [first, last) on each axis.
template <int D>
struct GridBlock {
  typename FieldGrid<D>::Shape first{};
  typename FieldGrid<D>::Shape last{};

  [[nodiscard]] bool empty() const {
    for (std::size_t a = 0; a < D; ++a)
      if (first[a] >= last[a]) return true;
    return false;
  }
  /// Points in all. @pre not empty().
  [[nodiscard]] std::size_t size() const {
    std::size_t n = 1;
    for (std::size_t a = 0; a < D; ++a) n *= last[a] - first[a];
    return n;
  }
  /// Where one of its points is in a C array of its own.
  [[nodiscard]] std::size_t index(const typename FieldGrid<D>::Shape& place) const {
    std::size_t at = 0;
    for (std::size_t a = 0; a < D; ++a) at = at * (last[a] - first[a]) + (place[a] - first[a]);
    return at;
  }
  /// Grows to hold a point, too.
  void add(const typename FieldGrid<D>::Shape& place) {
    const bool was_empty = empty();
    for (std::size_t a = 0; a < D; ++a) {
      first[a] = was_empty ? place[a] : std::min(first[a], place[a]);
      last[a] = was_empty ? place[a] + 1 : std::max(last[a], place[a] + 1);
    }
  }
};

namespace detail {

/// Whether something holds for some position of a block, [first, last) on each axis; the last axis varies
/// fastest. An empty block has none.
template <class Shape, class Holds>
bool any_place(const Shape& first, const Shape& last, const Holds& holds) {
  for (std::size_t a = 0; a < first.size(); ++a)
    if (first[a] >= last[a]) return false;
  Shape at = first;
  for (;;) {
    if (holds(at)) return true;
    std::size_t a = at.size();
    for (; a > 0 && ++at[a - 1] == last[a - 1]; --a) at[a - 1] = first[a - 1];
    if (a == 0) return false;
  }
}

/// Calls `visit(tile)` for the parts of a block that are so long, or shorter at its end, in the order of a C
/// array.
template <int D, class Visit>
void for_each_tile(const GridBlock<D>& block, const typename FieldGrid<D>::Shape& sides, const Visit& visit) {
  if (block.empty()) return;
  typename FieldGrid<D>::Shape count;
  for (std::size_t a = 0; a < D; ++a) count[a] = (block.last[a] - block.first[a] + sides[a] - 1) / sides[a];
  any_place({}, count, [&](const auto& number) {
    GridBlock<D> tile;
    for (std::size_t a = 0; a < D; ++a) {
      tile.first[a] = block.first[a] + number[a] * sides[a];
      tile.last[a] = std::min(tile.first[a] + sides[a], block.last[a]);
    }
    visit(tile);
    return false;
  });
}

/// Calls `visit(place, length)` for each row of a block along the last axis.
template <int D, class Visit>
void for_each_row(const GridBlock<D>& block, const Visit& visit) {
  if (block.empty()) return;
  auto ends = block.last;
  ends[D - 1] = block.first[D - 1] + 1;
  any_place(block.first, ends, [&](const auto& at) {
    visit(at, block.last[D - 1] - block.first[D - 1]);
    return false;
  });
}

}  // namespace detail

}  // namespace ndtree
