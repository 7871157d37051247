// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Exact geometry of cells: integer lattice coordinates, their borders in metres, and the edge of each level.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

/// Which cell: its lower corner on the lattice, and its level. Level 0 is the first root, +1 is N times
/// larger.
template <int D>
struct CellIndex {
  Lattice<D> lower{};
  int level = 0;

  friend bool operator==(const CellIndex& a, const CellIndex& b) {
    return a.level == b.level && a.lower == b.lower;
  }
  friend bool operator!=(const CellIndex& a, const CellIndex& b) { return !(a == b); }
};

/// Cells from a lower corner to an upper one, half-open, in units of the smallest cell.
template <int D>
struct LatticeBox {
  Lattice<D> lower{};
  Lattice<D> upper{};

  /// @param edge of the cell.
  [[nodiscard]] bool overlaps(const CellIndex<D>& cell, std::int64_t edge) const {
    for (std::size_t a = 0; a < D; ++a)
      if (cell.lower[a] >= upper[a] || cell.lower[a] + edge <= lower[a]) return false;
    return true;
  }
};

/// The lattice whose unit is the smallest cell. The border at coordinate k is the double nearest to k * unit,
/// whichever cell it is computed for; so neighbours of any two levels share their face to the last bit, and
/// `coordinate(x) == k` exactly if `border(k) <= x < border(k + 1)`.
template <int N, int D>
class LatticeGeometry {
 public:
  /// @param unit edge of the smallest cell [m]. @param num_levels levels below level 0, >= 0.
  /// @throws std::invalid_argument if the unit is not positive or N^num_levels exceeds 2^36.
  LatticeGeometry(double unit, int num_levels)
      : unit_(unit), per_metre_(1.0 / unit), num_levels_(num_levels) {
    if (!(unit > 0.0) || !std::isfinite(per_metre_) || !std::isfinite(reach()))
      throw std::invalid_argument("min_cell_size = " + describe_number(unit) +
                                  " m: must be > 0, and 2^38 of it and 1 / it finite");
    if (num_levels < 0)
      throw std::invalid_argument("number of levels = " + std::to_string(num_levels) + ": must be >= 0");
    std::int64_t edge = 1;
    std::vector<std::int64_t> edges{edge};  // From the finest level up.
    for (int i = 0; i < num_levels; ++i) {
      edge *= N;
      if (edge > kLargestCell)
        throw std::invalid_argument(
            "cells of " + describe_number(unit) + " m and " + std::to_string(num_levels) +
            " levels above them: at most 2^36 of the smallest fit along max_cell_size");
      edges.push_back(edge);
    }
    // Up to one above the first that is longer than the whole reach: a root of that one may still end within
    // reach on one side, and growing once more adds that side on every axis.
    while (edges.size() < 2 || edges[edges.size() - 2] <= 2 * kReach) edges.push_back(edge *= N);
    std::copy(edges.begin(), edges.end(), edges_.begin() + kMostBelow - num_levels);
    coarsest_level_ = static_cast<int>(edges.size()) - 1 - num_levels;
  }

  [[nodiscard]] double unit() const { return unit_; }
  [[nodiscard]] int finest_level() const { return -num_levels_; }
  /// No root grows above this level: it contains all that is in reach.
  [[nodiscard]] int coarsest_level() const { return coarsest_level_; }
  /// Edge of a cell in lattice units.
  [[nodiscard]] std::int64_t edge(int level) const {
    return edges_[static_cast<std::size_t>(level + kMostBelow)];
  }
  /// Edge of a cell [m].
  [[nodiscard]] double cell_size(int level) const {
    return unfused(static_cast<double>(edge(level)) * unit_);
  }
  /// Edge of a level's cells in those of another level, at least 1.
  [[nodiscard]] double edge_in(int level, int other) const {
    return static_cast<double>(std::max<std::int64_t>(1, edge(level) / edge(other)));
  }
  /// The finest level whose cells have at least this edge [m]; at most 0.
  [[nodiscard]] int level_of(double size) const {
    int level = finest_level();
    while (level < 0 && cell_size(level) < size) ++level;
    return level;
  }
  [[nodiscard]] double border(std::int64_t coordinate) const {
    return unfused(static_cast<double>(coordinate) * unit_);
  }

  /// Points with every |component| at or below this [m] have a place on the lattice.
  [[nodiscard]] double reach() const { return static_cast<double>(kReach) * unit_; }
  [[nodiscard]] bool in_reach(double x) const { return std::abs(x) <= reach(); }

  /// Lattice coordinate of the unit cell that contains x; x must be in reach.
  [[nodiscard]] std::int64_t coordinate(double x) const {
    auto k = static_cast<std::int64_t>(x * per_metre_);  // Towards 0, and rounded: the borders decide.
    if (border(k) > x) --k;
    if (border(k + 1) <= x) ++k;
    return k;
  }
  /// How far a coordinate that was meant to lie on a border may lie beside it: some units in its last place,
  /// and in that of an origin some hundred metres away [m].
  [[nodiscard]] double rounding_at(double x) const {
    return unfused(kRounding * std::abs(x)) + unfused(kRoundingOfUnit * unit_);
  }
#ifdef NDTREE_HAS_EIGHTS
  /// The coordinates of four numbers, as floating point. @param is_on_border whether x lies on a border of
  /// the cell, within rounding_at().
  NDTREE_BY_EIGHTS [[nodiscard]] FourDoubles coordinate(const FourDoubles& x, FourMask& is_on_border) const {
    FourDoubles k = floor_of(x * per_metre_);
    const FourDoubles lower = k * unit_;
    k = k - (FourDoubles(1.0) & (lower > x));
    const FourDoubles upper = (k + 1.0) * unit_;
    const FourDoubles rounding = kRounding * abs_of(x) + kRoundingOfUnit * unit_;
    is_on_border = min_of(abs_of(x - lower), abs_of(x - upper)) <= rounding;
    return k + (FourDoubles(1.0) & (upper <= x));
  }
#endif
  [[nodiscard]] Lattice<D> coordinates(const Vector<D>& point) const {
    Lattice<D> result;
    for (int a = 0; a < D; ++a) result[static_cast<std::size_t>(a)] = coordinate(point[a]);
    return result;
  }
  [[nodiscard]] bool in_reach(const Vector<D>& point) const { return (point.array().abs() <= reach()).all(); }
  [[nodiscard]] bool contains(const CellIndex<D>& cell, const Lattice<D>& coordinates) const {
    const auto size = static_cast<std::uint64_t>(edge(cell.level));
    bool is_inside = true;  // A coordinate below the lower one is so far above it that no cell is as large.
    for (std::size_t a = 0; a < D; ++a)
      is_inside &=
          static_cast<std::uint64_t>(coordinates[a]) - static_cast<std::uint64_t>(cell.lower[a]) < size;
    return is_inside;
  }
  [[nodiscard]] Box<D> box(const CellIndex<D>& cell) const {
    Box<D> result;
    for (int a = 0; a < D; ++a) {
      const std::int64_t lower = cell.lower[static_cast<std::size_t>(a)];
      result.lower[a] = border(lower);
      result.upper[a] = border(lower + edge(cell.level));
    }
    return result;
  }
  /// The box with each corner coordinate that lies within kOnBorder cells of a border moved onto that border:
  /// decimal corners, as 0.3 = 3 * 0.1 and sums of cell sizes are none in doubles, mean the border. Every
  /// query and change of a region takes its box so. A box thinner than that stays as it is. Idempotent.
  [[nodiscard]] Box<D> on_borders(const Box<D>& box) const {
    Box<D> result = box;
    for (int a = 0; a < D; ++a) {
      const double lower = on_border(box.lower[a]);
      const double upper = on_border(box.upper[a]);
      if (!(lower < upper) && box.lower[a] < box.upper[a]) continue;
      result.lower[a] = lower;
      result.upper[a] = upper;
    }
    return result;
  }
  /// All cells of a level up to 0 that share a volume with the part of a box that is in reach, see
  /// on_borders().
  [[nodiscard]] LatticeBox<D> cells_in(const Box<D>& region, int level) const {
    const Box<D> box = on_borders(region);
    const std::int64_t edge = this->edge(level);
    const auto floor = [edge](std::int64_t k) { return k - ((k % edge) + edge) % edge; };
    LatticeBox<D> cells;
    for (int a = 0; a < D; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      const std::int64_t last = coordinate(std::clamp(box.upper[a], -reach(), reach()));
      cells.lower[axis] = floor(coordinate(std::clamp(box.lower[a], -reach(), reach())));
      cells.upper[axis] = floor(border(last) < box.upper[a] ? last : last - 1) + edge;
    }
    return cells;
  }
  [[nodiscard]] CellIndex<D> child(const CellIndex<D>& cell, const Offset<D>& offset) const {
    CellIndex<D> result{cell.lower, cell.level - 1};
    for (std::size_t a = 0; a < D; ++a) result.lower[a] += offset[a] * edge(result.level);
    return result;
  }

 private:
  /// @returns x, or the border next to it.
  [[nodiscard]] double on_border(double x) const {
    if (!in_reach(x)) return x;
    const double nearest = border(static_cast<std::int64_t>(std::nearbyint(x * per_metre_)));
    return std::abs(x - nearest) <= unfused(kOnBorder * unit_) + rounding_at(x) ? nearest : x;
  }

  // Lattice units within reach; N² times the whole of it, 2 kReach, still fits a std::int64_t for N < 4096,
  // and no power of 4096 lies between 2^36 and 2 kReach.
  static constexpr std::int64_t kReach = std::int64_t{1} << 38;
  static constexpr std::int64_t kLargestCell = std::int64_t{1} << 36;  // Edge of one of level 0.
  static constexpr int kMostBelow = 36;  // Levels, for N = 2, and above level 0, if there are none below.
  static constexpr int kMostAbove = 41;
  static constexpr double kRounding = 0x1p-49;  // See rounding_at().
  static constexpr double kRoundingOfUnit = 0x1p-40;

  double unit_;
  double per_metre_;  // About 1 / unit_.
  int num_levels_;
  int coarsest_level_ = 0;
  // By level, without asking for the finest; others are 0.
  std::array<std::int64_t, std::size_t{kMostBelow + kMostAbove + 1}> edges_{};
};

}  // namespace ndtree

namespace ndtree::detail {

/// Grows a tree around a box of cells, of level 0 or below; what the root becomes depends on the box alone,
/// and on what the root was. @throws std::invalid_argument if a cell lies out of reach; only a part of one
/// may.
template <class Tree>
void grow_around(Tree& tree, const LatticeBox<Tree::kDim>& box) {
  Vector<Tree::kDim> first;
  Vector<Tree::kDim> last;
  const double reach = tree.geometry().reach();
  const auto within_reach = [&](double x) {
    return std::abs(x) < reach + tree.geometry().cell_size(0) ? std::clamp(x, -reach, reach) : x;
  };
  for (int a = 0; a < Tree::kDim; ++a) {
    first[a] = within_reach(tree.geometry().border(box.lower[static_cast<std::size_t>(a)]));
    last[a] = within_reach(tree.geometry().border(box.upper[static_cast<std::size_t>(a)] - 1));
  }
  tree.grow_to_contain(first);
  tree.grow_to_contain(last);
}

}  // namespace ndtree::detail
