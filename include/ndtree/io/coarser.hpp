// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Cells of another size than a map's: the one rule of all that is written with a cell_size.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/map_builder.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

// The rule. A cell that is larger than the map's smallest is occupied if some occupied cell of the map
// overlaps it, else free if some free one does, else unknown: no wall is lost, however thin. Its log-odds are
// the largest of the known cells that overlap it. Cells that only touch do not overlap. A cell that is no
// larger than the map's smallest has what the map says at its centre, which loses no cell of the map either.

/// Cells of one size along an axis, in units of a map's smallest cells about 0. Sizes are decimal numbers
/// that no double holds exactly: a border within 1e-9 of a whole number, or that part of it, is taken for it.
class CellsAlong {
 public:
  /// @param unit edge of the map's smallest cells, @param lower where cell 0 begins, @param cell_size [m].
  /// @throws std::invalid_argument unless the cell size is > 0 and finite.
  CellsAlong(double unit, double lower, double cell_size)
      : unit_(unit), lower_(lower), cell_size_(cell_size) {
    if (!(cell_size > 0.0) || !std::isfinite(cell_size))
      throw OptionError("cell_size", describe_number(cell_size) + " m", "> 0 and finite");
    const double units = std::round(cell_size / unit);
    const double begin = std::round(lower / unit);
    if (units >= 1.0 && units < 0x1p30 && std::abs(begin) < 1e5 && is_nearly(cell_size / unit, units) &&
        is_nearly(lower / unit, begin)) {
      units_ = static_cast<std::int64_t>(units);
      begin_ = static_cast<std::int64_t>(begin);
    }
  }

  /// Whether cells are larger than the map's smallest.
  [[nodiscard]] bool are_coarser() const { return whole(cell_size_ / unit_) > 1.0; }
  /// Where a cell begins, and the one before it ends.
  [[nodiscard]] double border(std::int64_t i) const {
    return whole((lower_ + static_cast<double>(i) * cell_size_) / unit_);
  }
  /// First cell that overlaps [k, ...).
  [[nodiscard]] std::int64_t first(std::int64_t k) const {
    if (units_ == 1 && std::abs(k) < kMostExact) return k - begin_;
    if (units_ > 1 && std::abs(k) < kMostExact) return floor_of(k - begin_, units_);
    const auto at = static_cast<double>(k);
    const double guess = std::floor((at * unit_ - lower_) / cell_size_);
    auto i = static_cast<std::int64_t>(std::clamp(guess, -0x1p60, 0x1p60));
    if (std::abs(guess) > 0x1p52 || cell_size_ < 1e-6 * unit_) return i;  // Borders have no digits left.
    while (border(i) > at) --i;
    while (border(i + 1) <= at) ++i;
    return i;
  }
  /// One behind the last cell that overlaps [..., k).
  [[nodiscard]] std::int64_t last(std::int64_t k) const {
    if (units_ >= 1 && std::abs(k) < kMostExact) return first(k - 1) + 1;
    const std::int64_t i = first(k);
    return border(i) < static_cast<double>(k) ? i + 1 : i;
  }
  /// A ratio of sizes.
  [[nodiscard]] static double whole(double ratio) {
    const double nearest = std::round(ratio);
    const double tolerance = std::min(1e-3, 1e-9 * std::max(1.0, std::abs(ratio)));
    return std::abs(ratio - nearest) <= tolerance ? nearest : ratio;
  }

 private:
  // A whole number of units but for some rounding errors, which whole() takes away from every border up to
  // here.
  static constexpr std::int64_t kMostExact = std::int64_t{1} << 39;
  [[nodiscard]] static bool is_nearly(double ratio, double whole) {
    return std::abs(ratio - whole) <=
           4.0 * std::numeric_limits<double>::epsilon() * std::max(1.0, std::abs(whole));
  }
  [[nodiscard]] static std::int64_t floor_of(std::int64_t k, std::int64_t divisor) {
    return k / divisor - static_cast<std::int64_t>(k % divisor < 0);
  }

  double unit_;
  double lower_;
  double cell_size_;
  std::int64_t units_ =
      0;  // Along a cell, if that is a whole number of them, and cell 0 begins at one; else 0.
  std::int64_t begin_ = 0;  // Of cell 0, then.
};

/// A map with larger smallest cells, by the rule above. Equal siblings are joined; counts of beams stay
/// behind. O(leaves of both).
/// @tparam Target its type: with an OccupancyCell, log-odds are exactly those of the map, see MapBuilder.
/// @param cell_size [m]. @throws std::invalid_argument unless it is finite and no less than the map's
///   min_cell_size, MemoryLimitReached.
template <class Target, class Map>
[[nodiscard]] Target with_cell_size(const Map& map, double cell_size) {
  constexpr int D = Map::kDim;
  const CellsAlong cells(map.options().min_cell_size, 0.0, cell_size);
  if (CellsAlong::whole(cell_size / map.options().min_cell_size) < 1.0)
    throw OptionError("cell_size", describe_number(cell_size) + " m",
                      ">= " + describe_number(map.options().min_cell_size) + " m, the map's ",
                      "min_cell_size");
  typename Target::Options options = map.options();
  options.min_cell_size = cell_size;
  options.max_cell_size = std::max(options.max_cell_size, cell_size);
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    const auto log_odds = static_cast<double>(leaf.cell().log_odds());
    if (!std::isfinite(log_odds)) return;
    options.log_odds_min = std::min(options.log_odds_min, log_odds);
    options.log_odds_max = std::max(options.log_odds_max, log_odds);
  });
  MapBuilder<Target> builder(options);
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (leaf.cell().state() == CellState::unknown) return;
    const std::int64_t edge = map.tree().geometry().edge(leaf.index.level);
    Lattice<D> lower, upper;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t begin = leaf.index.lower[a];
      lower[a] = cells.first(begin);
      upper[a] = cells.last(begin + edge);
    }
    builder.raise(lower, upper, leaf.cell().log_odds());
  });
  return std::move(builder).finish();
}

}  // namespace ndtree
