// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maxima of a likelihood over windows of cells, for searches that ask for very many.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/alignment/likelihood_pyramid.hpp"

namespace ndtree {

/// The LikelihoodPyramid in a box of cells, as flat arrays: at level h, each cell has the maximum of the
/// cells in [q, q + 2^h) on each axis that are in the box.
///
/// Against the pyramid, a window is as long as its block and no longer, and a value takes one load: a cell is
/// a number, and the cells a step on are at a fixed distance. Memory and time: a byte for each cell of the
/// box and level, so it is made for one search and its box, and only for searches that ask for more.
template <int D>
class LikelihoodWindows {
 public:
  using Cell = typename LikelihoodPyramid<D>::Cell;

  /// @param lower, upper first and last cell of the box. @param levels above the cells themselves.
  LikelihoodWindows(const LikelihoodPyramid<D>& pyramid, const Cell& lower, const Cell& upper, int levels)
      : lower_(lower), levels_(static_cast<std::size_t>(levels) + 1) {
    std::size_t cells = 1;
    for (std::size_t a = std::size_t{D}; a-- > 0;) {
      shape_[a] = upper[a] - lower[a] + 1;
      strides_[a] = static_cast<std::int32_t>(cells);
      cells *= static_cast<std::size_t>(shape_[a]);
    }
    levels_[0].assign(cells, 0);
    pyramid.for_each_likely([&](const Cell& cell, std::uint8_t likelihood) {
      for (std::size_t a = 0; a < std::size_t{D}; ++a)
        if (cell[a] < lower[a] || cell[a] > upper[a]) return;
      levels_[0][static_cast<std::size_t>(number_of(cell))] = likelihood;
    });
    for (std::size_t level = 1; level < levels_.size(); ++level) {
      levels_[level] = levels_[level - 1];
      for (std::size_t a = 0; a < std::size_t{D}; ++a)
        widen(levels_[level], a, std::size_t{1} << (level - 1));
    }
  }

  /// @pre the cell is in the box.
  [[nodiscard]] std::int32_t number_of(const Cell& cell) const {
    std::int32_t number = 0;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) number += (cell[a] - lower_[a]) * strides_[a];
    return number;
  }
  /// By which the number of a cell grows a step on along an axis.
  [[nodiscard]] std::int32_t stride(std::size_t axis) const { return strides_[axis]; }
  /// Maxima, by the cells' numbers.
  [[nodiscard]] const std::uint8_t* level(int level) const {
    return levels_[static_cast<std::size_t>(level)].data();
  }

 private:
  using Maxima = std::vector<std::uint8_t>;

  /// Joins each window with the one that is some cells on along an axis.
  void widen(Maxima& maxima, std::size_t axis, std::size_t cells) const {
    const auto stride = static_cast<std::size_t>(strides_[axis]);
    const std::size_t row = stride * static_cast<std::size_t>(shape_[axis]);
    const std::size_t away = std::min(cells * stride, row);
    for (std::size_t begin = 0; begin < maxima.size(); begin += row)
      for (std::size_t i = begin; i < begin + row - away; ++i)
        maxima[i] = std::max(maxima[i], maxima[i + away]);
  }

  Cell lower_;
  Cell shape_{};
  Cell strides_{};
  std::vector<Maxima> levels_;
};

}  // namespace ndtree
