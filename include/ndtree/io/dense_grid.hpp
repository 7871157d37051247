// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A part of a map as a dense array, and a map from such an array.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/coarser.hpp"
#include "ndtree/io/map_builder.hpp"
#include "ndtree/io/wall_fronts.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// Cells of one size in rows. Cell i on an axis is [lower + i * cell_size, lower + (i + 1) * cell_size).
/// Arrays have an axis for each of space, x first, and are stored with the last axis running fastest.
template <int D>
struct GridGeometry {
  Vector<D> lower = Vector<D>::Zero();              ///< [m]
  double cell_size = 0.05;                          ///< [m]
  std::array<std::size_t, std::size_t{D}> shape{};  ///< Cells along each axis.

  /// @throws std::invalid_argument naming the first value that is out of bounds.
  void validate() const {
    if (!(cell_size > 0.0) || !std::isfinite(cell_size))
      throw std::invalid_argument("cell_size = " + describe_number(cell_size) + " m: must be > 0 and finite");
    if (!lower.allFinite()) throw std::invalid_argument("lower: every component must be finite");
    double cells = 1.0;
    for (const std::size_t n : shape) cells *= static_cast<double>(n);
    if (!(cells <= static_cast<double>(std::numeric_limits<std::ptrdiff_t>::max())))
      throw std::invalid_argument("a grid of " + describe_number(cells) +
                                  " cells: more than can be addressed");
  }
  [[nodiscard]] std::size_t size() const {
    std::size_t cells = 1;
    for (const std::size_t n : shape) cells *= n;
    return cells;
  }
  /// Where cell i has its centre on an axis [m].
  [[nodiscard]] double centre(int axis, std::size_t i) const {
    return lower[axis] + (static_cast<double>(i) + 0.5) * cell_size;
  }
};

namespace detail {

/// Calls `visit(i)` for the numbers, in a grid's array, of its cells from `first` to `last`, half-open.
template <int D, class Visit>
void for_each_in_grid(const GridGeometry<D>& grid, const std::array<std::size_t, std::size_t{D}>& first,
                      const std::array<std::size_t, std::size_t{D}>& last, const Visit& visit) {
  for (auto at = first;;) {  // Row by row along the last axis.
    std::size_t row = 0;
    for (std::size_t a = 0; a < D; ++a) row = row * grid.shape[a] + at[a];
    for (std::size_t i = row; i < row + (last[D - 1] - first[D - 1]); ++i) visit(i);
    int a = D - 2;
    while (a >= 0 && ++at[static_cast<std::size_t>(a)] == last[static_cast<std::size_t>(a)]) {
      at[static_cast<std::size_t>(a)] = first[static_cast<std::size_t>(a)];
      --a;
    }
    if (a < 0) return;
  }
}

/// What cells have that are no larger than the map's.
template <class Map, class T, class ValueOf>
void sample_at_centres(const Map& map, const GridGeometry<Map::kDim>& grid, const ValueOf& value_of, T* out) {
  constexpr int D = Map::kDim;
  Box<D> region;
  std::array<std::vector<double>, std::size_t{D}> centres;
  for (int a = 0; a < D; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    for (std::size_t i = 0; i < grid.shape[axis]; ++i) centres[axis].push_back(grid.centre(a, i));
    region.lower[a] = centres[axis].front();
    region.upper[a] = centres[axis].back();
  }
  for_each_leaf_in(map.tree(), region, [&](const auto& leaf) {
    const Box<D> box = map.tree().box(leaf.index);
    std::array<std::size_t, std::size_t{D}> first, last;
    for (int a = 0; a < D; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      const auto& all = centres[axis];
      const auto begin = std::lower_bound(all.begin(), all.end(), box.lower[a]);
      first[axis] = static_cast<std::size_t>(begin - all.begin());
      last[axis] = static_cast<std::size_t>(std::lower_bound(begin, all.end(), box.upper[a]) - all.begin());
      if (first[axis] == last[axis]) return;
    }
    const T value = value_of(leaf);
    for_each_in_grid<D>(grid, first, last, [&](std::size_t i) { out[i] = value; });
  });
}

/// What larger cells have: of the known ones that overlap them, that with the largest rank.
/// @param rank_of float(leaf).
template <class Map, class T, class ValueOf, class RankOf>
void take_largest(const Map& map, const GridGeometry<Map::kDim>& grid, const ValueOf& value_of,
                  const RankOf& rank_of, T* out) {
  constexpr int D = Map::kDim;
  std::vector<float> largest(grid.size(), -std::numeric_limits<float>::infinity());
  std::vector<CellsAlong> axes;
  Box<D> region{grid.lower, grid.lower};
  for (int a = 0; a < D; ++a) {
    axes.emplace_back(map.options().min_cell_size, grid.lower[a], grid.cell_size);
    region.upper[a] += static_cast<double>(grid.shape[static_cast<std::size_t>(a)]) * grid.cell_size;
  }
  for_each_leaf_in(map.tree(), region, [&](const auto& leaf) {
    if (leaf.cell().state() == CellState::unknown) return;
    const std::int64_t edge = map.tree().geometry().edge(leaf.index.level);
    std::array<std::size_t, std::size_t{D}> first, last;
    for (std::size_t a = 0; a < D; ++a) {
      const auto cells = static_cast<std::int64_t>(grid.shape[a]);
      const std::int64_t begin = leaf.index.lower[a];
      first[a] = static_cast<std::size_t>(std::clamp<std::int64_t>(axes[a].first(begin), 0, cells));
      last[a] = static_cast<std::size_t>(std::clamp<std::int64_t>(axes[a].last(begin + edge), 0, cells));
      if (first[a] >= last[a]) return;
    }
    const float rank = rank_of(leaf);
    const T value = value_of(leaf);
    for_each_in_grid<D>(grid, first, last, [&](std::size_t i) {
      if (rank <= largest[i]) return;
      largest[i] = rank;
      out[i] = value;
    });
  });
}

/// What the leaves of a map have, or where there is none, what is `unknown`. @param value_of T(leaf).
/// @param rank_of see take_largest().
template <class Map, class T, class ValueOf, class RankOf>
void leaves_to_grid(const Map& map, const GridGeometry<Map::kDim>& grid, T unknown, const ValueOf& value_of,
                    const RankOf& rank_of, T* out) {
  grid.validate();
  const std::size_t size = grid.size();
  std::fill(out, out + size, unknown);
  if (size == 0) return;
  if (CellsAlong(map.options().min_cell_size, 0.0, grid.cell_size).are_coarser())
    take_largest(map, grid, value_of, rank_of, out);
  else
    sample_at_centres(map, grid, value_of, out);
}

}  // namespace detail

/// What the map says of the grid's cells, by the rule of coarser.hpp: at the centres of those that are no
/// larger than the map's smallest; a larger one is as the known cell with the largest log-odds of those that
/// overlap it. Where nothing is known, what the map says of unknown space. O(leaves in the grid + cells).
/// @param value_of what is stored for a cell of the map: T(const Map::Cell&).
/// @param out grid.size() values.
/// @throws std::invalid_argument as GridGeometry::validate().
template <class Map, class T, class ValueOf>
void to_grid(const Map& map, const GridGeometry<Map::kDim>& grid, const ValueOf& value_of, T* out) {
  detail::leaves_to_grid(
      map, grid, value_of(typename Map::Cell{}), [&](const auto& leaf) { return value_of(leaf.cell()); },
      [](const auto& leaf) { return leaf.cell().log_odds(); }, out);
}

/// to_grid() with the number of each CellState. @param wall_depth see WallFronts; none: all of each.
/// @throws std::invalid_argument as to_grid() and WallFronts.
template <class Map>
void states_to_grid(const Map& map, const GridGeometry<Map::kDim>& grid, std::optional<double> wall_depth,
                    std::int8_t* out) {
  constexpr std::int8_t kLarge = 2;  // Until its fronts are drawn.
  const auto number = [](CellState state) { return static_cast<std::int8_t>(state); };
  const WallFronts fronts(map, wall_depth);
  const int finest = map.tree().geometry().finest_level();
  const auto is_large = [&](const auto& leaf) {
    return !fronts.draw_all() && leaf.index.level > finest && leaf.cell().state() == CellState::occupied;
  };
  detail::leaves_to_grid(
      map, grid, number(CellState::unknown),
      [&](const auto& leaf) { return is_large(leaf) ? kLarge : number(leaf.cell().state()); },
      [&](const auto& leaf) {  // Large occupied cells may become unknown: others go before them.
        const bool is_occupied = leaf.cell().state() == CellState::occupied;
        return is_occupied && !is_large(leaf) ? std::numeric_limits<float>::infinity()
                                              : leaf.cell().log_odds();
      },
      out);
  fronts.draw(out, grid.shape, grid.cell_size, kLarge, number(CellState::free), number(CellState::occupied),
              number(CellState::unknown));
}

/// A map with the states of a grid's cells: free ones get log_odds_min, occupied ones log_odds_max (see
/// MapBuilder), equal siblings are joined.
/// @param states grid.size() numbers of CellState.
/// @param options of the map, but for min_cell_size, which is the grid's; max_cell_size is at least that.
/// @throws std::invalid_argument if the grid's lower corner is not within a millionth of a cell of a whole
///   number of cells from 0, if a number is no state, or as GridGeometry::validate().
template <class Map>
[[nodiscard]] Map from_grid(const std::int8_t* states, const GridGeometry<Map::kDim>& grid,
                            typename Map::Options options = {}) {
  constexpr int D = Map::kDim;
  grid.validate();
  options.min_cell_size = grid.cell_size;
  options.max_cell_size = std::max(options.max_cell_size, grid.cell_size);
  Lattice<D> corner;
  for (int a = 0; a < D; ++a) {
    const double cells = grid.lower[a] / grid.cell_size;
    if (!(std::abs(cells) < 9e15) || std::abs(cells - std::round(cells)) > 1e-6)
      throw std::invalid_argument("lower = " + describe_number(grid.lower[a]) + " m on axis " +
                                  std::to_string(a) + ": must be a whole number of cells of " +
                                  describe_number(grid.cell_size) + " m");
    corner[static_cast<std::size_t>(a)] = std::llround(cells);
  }
  MapBuilder<Map> builder(options);
  const std::size_t size = grid.size();
  const std::size_t row = grid.shape[D - 1];
  for (std::size_t i = 0; i < size;) {  // Runs of one state along the last axis.
    const std::int8_t state = states[i];
    if (state < -1 || state > 1)
      throw std::invalid_argument("state " + std::to_string(state) + " at " + std::to_string(i) +
                                  ": must be -1 unknown, 0 free or 1 occupied");
    std::size_t end = i + 1;
    while (end % row != 0 && states[end] == state) ++end;
    if (state >= 0) {
      Lattice<D> lower;
      std::size_t rest = i;
      for (std::size_t a = D; a-- > 0; rest /= grid.shape[a])
        lower[a] = corner[a] + static_cast<std::int64_t>(rest % grid.shape[a]);
      Lattice<D> upper = lower;
      for (std::size_t a = 0; a + 1 < D; ++a) ++upper[a];
      upper[D - 1] += static_cast<std::int64_t>(end - i);
      builder.fill(lower, upper,
                   static_cast<float>(state == 1 ? options.log_odds_max : options.log_odds_min));
    }
    i = end;
  }
  return std::move(builder).finish();
}

}  // namespace ndtree
