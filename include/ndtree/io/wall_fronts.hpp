// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Of far walls, which scatter over large cells, what is near free space.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// How far behind free space occupied cells larger than the smallest are drawn into a grid. The hits of a
/// wall seen from afar scatter over several of them, one behind the other.
class WallFronts {
 public:
  /// @param depth [m]; none or infinite: all of each is drawn, as it is of a map in which no beam has ended.
  /// @throws std::invalid_argument if it is not > 0.
  template <class Map>
  WallFronts(const Map& map, std::optional<double> depth) : depth_(depth.value_or(kAll)) {
    if (!(depth_ > 0.0)) throw OptionError("wall_depth", describe_number(depth_) + " m", "> 0");
    if (depth_ == kAll) return;
    bool is_measured = false;
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      is_measured |= leaf.cell().hits() > 0 && leaf.cell().state() == CellState::occupied;
    });
    if (!is_measured) depth_ = kAll;
  }
  [[nodiscard]] bool draw_all() const { return depth_ == kAll; }

  /// Of a grid's cells that only large occupied cells overlap, those become occupied that have a free one
  /// within the depth along all axes, the others unknown. O(cells).
  /// @param values of the grid, the last axis running fastest. @param large what these cells have.
  template <std::size_t D, class T>
  void draw(T* values, const std::array<std::size_t, D>& shape, double cell_size, T large, T free, T occupied,
            T unknown) const {
    if (draw_all()) return;
    std::size_t size = 1;
    for (const std::size_t n : shape) size *= n;
    std::vector<std::uint8_t> near(size);
    std::transform(values, values + size, near.begin(), [=](T value) { return value == free; });
    const auto reach =
        static_cast<std::size_t>(std::clamp(std::floor(depth_ / cell_size * (1.0 + 1e-9)), 1.0, 0x1p30));
    std::size_t stride = 1;
    for (std::size_t a = D; a-- > 0; stride *= shape[a])
      for (std::size_t first = 0; first < size; first += stride * shape[a])
        for (std::size_t i = first; i < first + stride; ++i) widen(&near[i], shape[a], stride, reach);
    for (std::size_t i = 0; i < size; ++i)
      if (values[i] == large) values[i] = near[i] != 0 ? occupied : unknown;
  }

 private:
  static constexpr double kAll = std::numeric_limits<double>::infinity();

  /// Marks what is within a reach of what is marked in a row.
  static void widen(std::uint8_t* row, std::size_t count, std::size_t stride, std::size_t reach) {
    std::size_t marked_to = 0;  // What was marked before reaches so far.
    std::size_t done = 0;       // What is behind that is marked.
    for (std::size_t i = 0; i < count; ++i) {
      const bool was = row[i * stride] != 0;
      if (was) {
        for (std::size_t k = std::max(done, i - std::min(i, reach)); k < i; ++k) row[k * stride] = 1;
        marked_to = i + reach + 1;
        done = i + 1;
      } else if (i < marked_to) {
        row[i * stride] = 1;
        done = i + 1;
      }
    }
  }

  double depth_;
};

}  // namespace ndtree
