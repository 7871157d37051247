// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How likely an end point is at a place, on a grid and as maxima over blocks of it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// exp(-d²/2σ²) of the distance d from a grid cell's centre to the nearest surface point, in 255ths, and for
/// each level h its maxima: bound(h, q) is at least the likelihood of each cell in [q, q + 2^h) on each axis.
///
/// Level h >= 1 is stored at every 2^(h-1)-th cell, so a bound looks at up to 1.5 times its block per axis,
/// and all levels together take little more than the first two. Integers, so that sums are the same in any
/// order.
template <int D>
class LikelihoodPyramid {
 public:
  using Cell = std::array<std::int32_t, std::size_t{D}>;
  static constexpr int kMaximum = 255;
  static constexpr std::int32_t kNoPoint = -1;

  /// @param points of surfaces. @param cell_size of the grid [m]. @param sigma of an end point's distance
  /// [m].
  /// @throws std::invalid_argument if the grid would have more than 2^30 cells.
  LikelihoodPyramid(const Points<D>& points, double cell_size, double sigma) : cell_size_(cell_size) {
    const double reach = kReach * sigma;
    Vector<D> upper = Vector<D>::Zero();
    lower_ = Vector<D>::Zero();
    if (points.cols() > 0) {
      lower_ = points.rowwise().minCoeff().array() - reach;
      upper = points.rowwise().maxCoeff().array() + reach;
    }
    // Grids of one map share their lattice, wherever they begin.
    double cells = 1.0;
    for (int a = 0; a < D; ++a) {
      lower_[a] = std::floor(lower_[a] / cell_size) * cell_size;
      const double count = std::floor((upper[a] - lower_[a]) / cell_size) + 1.0;
      cells *= count;
      if (!(cells <= 1073741824.0))
        throw std::invalid_argument("cell_size = " + describe_number(cell_size) +
                                    " m: the surface's box has more than 2^30 such cells");
      shape_[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(count);
    }
    make_base(points, sigma, reach);
  }

  [[nodiscard]] double cell_size() const { return cell_size_; }
  [[nodiscard]] const Vector<D>& lower() const { return lower_; }
  [[nodiscard]] int num_levels() const { return static_cast<int>(levels_.size()); }

  /// The cell that a point is in, which may be outside the grid.
  [[nodiscard]] Cell cell_of(const Vector<D>& point) const {
    Cell cell;
    for (int a = 0; a < D; ++a) {
      const double place = std::floor((point[a] - lower_[a]) / cell_size_);
      cell[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(std::clamp(place, -kFar, kFar));
    }
    return cell;
  }
  /// @param level below num_levels(). @param cell may be outside, where nothing is likely.
  [[nodiscard]] std::int32_t bound(int level, const Cell& cell) const {
    const Level& of = levels_[static_cast<std::size_t>(level)];
    std::size_t index = 0;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) {
      const std::int32_t at = (cell[a] >> of.shift) + kPad;
      if (static_cast<std::uint32_t>(at) >= static_cast<std::uint32_t>(of.shape[a])) return 0;
      index = index * static_cast<std::size_t>(of.shape[a]) + static_cast<std::size_t>(at);
    }
    return of.values[index];
  }
  /// The surface point nearest to a cell's centre, or kNoPoint if none is within 3 sigma.
  [[nodiscard]] std::int32_t nearest(const Cell& cell) const {
    std::size_t index = 0;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) {
      if (static_cast<std::uint32_t>(cell[a]) >= static_cast<std::uint32_t>(shape_[a])) return kNoPoint;
      index = index * static_cast<std::size_t>(shape_[a]) + static_cast<std::size_t>(cell[a]);
    }
    return nearest_[index];
  }
  /// Makes levels up to one, if they are not there yet.
  void grow_to(int level) {
    while (num_levels() <= level) levels_.push_back(above(levels_.back(), num_levels()));
  }

 private:
  static constexpr double kReach = 3.0;  // Sigmas; beyond, 0.
  static constexpr double kFar = 1e8;
  static constexpr std::int32_t kPad = 2;  // Places before the grid from which a block reaches into it.

  struct Level {
    Cell shape{};  // With kPad places before the first.
    int shift = 0;
    std::vector<std::uint8_t> values;
  };

  void make_base(const Points<D>& points, double sigma, double reach) {
    std::size_t cells = 1;
    for (const std::int32_t n : shape_) cells *= static_cast<std::size_t>(n);
    nearest_.assign(cells, kNoPoint);
    std::vector<float> squared(cells, static_cast<float>(reach * reach));
    for (Eigen::Index i = 0; i < points.cols(); ++i) {
      const Vector<D> point = points.col(i);
      Cell first;
      Cell last;
      for (int a = 0; a < D; ++a) {
        const auto axis = static_cast<std::size_t>(a);
        first[axis] =
            std::max(0, static_cast<std::int32_t>(std::floor((point[a] - reach - lower_[a]) / cell_size_)));
        last[axis] =
            std::min(shape_[axis] - 1,
                     static_cast<std::int32_t>(std::floor((point[a] + reach - lower_[a]) / cell_size_)));
      }
      splat<0>(first, last, point, 0, 0.0, static_cast<std::int32_t>(i), squared);
    }
    Level base;
    base.shape = shape_;
    for (std::int32_t& n : base.shape) n += kPad;
    std::size_t padded = 1;
    for (const std::int32_t n : base.shape) padded *= static_cast<std::size_t>(n);
    base.values.assign(padded, 0);
    const double scale = -0.5 / (sigma * sigma);
    const std::size_t row = static_cast<std::size_t>(shape_[D - 1]);
    for (std::size_t begin = 0; begin < cells; begin += row) {
      std::size_t rest = begin / row;
      std::size_t index = 0;
      std::size_t stride = static_cast<std::size_t>(base.shape[D - 1]);
      for (int a = D - 2; a >= 0; --a) {
        const auto axis = static_cast<std::size_t>(a);
        index += (rest % static_cast<std::size_t>(shape_[axis]) + kPad) * stride;
        rest /= static_cast<std::size_t>(shape_[axis]);
        stride *= static_cast<std::size_t>(base.shape[axis]);
      }
      for (std::size_t i = 0; i < row; ++i)
        if (nearest_[begin + i] != kNoPoint)
          base.values[index + kPad + i] = static_cast<std::uint8_t>(
              std::lround(kMaximum * std::exp(scale * static_cast<double>(squared[begin + i]))));
    }
    levels_.push_back(std::move(base));
  }

  template <int A>
  void splat(const Cell& first, const Cell& last, const Vector<D>& point, std::size_t index, double sum,
             std::int32_t number, std::vector<float>& squared) {
    for (std::int32_t c = first[A]; c <= last[A]; ++c) {
      const double away = lower_[A] + (c + 0.5) * cell_size_ - point[A];
      const double total = sum + away * away;
      const std::size_t at = index * static_cast<std::size_t>(shape_[A]) + static_cast<std::size_t>(c);
      if constexpr (A + 1 < D) {
        splat<A + 1>(first, last, point, at, total, number, squared);
      } else if (static_cast<float>(total) < squared[at]) {
        squared[at] = static_cast<float>(total);
        nearest_[at] = number;
      }
    }
  }

  /// Level h + 1 of level h. A value of level h >= 1 at place j, of size s = 2^(h-1), covers the cells
  /// [js, js + 3s - 2]; the next covers [2js, 2js + 6s - 2], which are the places 2j, 2j + 1 and 2j + 3.
  [[nodiscard]] Level above(const Level& below, int level) const {
    Level next;
    next.shift = level - 1;
    const bool is_first = level == 1;  // Same places, blocks of two.
    Level current = below;
    for (std::size_t axis = 0; axis < std::size_t{D}; ++axis) {
      Cell shape = current.shape;
      shape[axis] = ((shape_[axis] - 1) >> next.shift) + 1 + kPad;
      std::size_t before = 1;
      std::size_t after = 1;
      for (std::size_t a = 0; a < axis; ++a) before *= static_cast<std::size_t>(shape[a]);
      for (std::size_t a = axis + 1; a < std::size_t{D}; ++a) after *= static_cast<std::size_t>(shape[a]);
      const auto count = static_cast<std::size_t>(shape[axis]);
      const auto had = static_cast<std::int32_t>(current.shape[axis]);
      std::vector<std::uint8_t> values(before * count * after, 0);
      for (std::size_t b = 0; b < before; ++b)
        for (std::int32_t j = 0; j < shape[axis]; ++j) {
          std::uint8_t* const to = &values[(b * count + static_cast<std::size_t>(j)) * after];
          const std::int32_t at = is_first ? j : 2 * (j - kPad) + kPad;
          for (const std::int32_t step : {0, 1, is_first ? 1 : 3}) {
            if (at + step < 0 || at + step >= had) continue;
            const std::uint8_t* const from =
                &current.values[(b * static_cast<std::size_t>(had) + static_cast<std::size_t>(at + step)) *
                                after];
            for (std::size_t i = 0; i < after; ++i) to[i] = std::max(to[i], from[i]);
          }
        }
      current.shape = shape;
      current.values = std::move(values);
    }
    next.shape = current.shape;
    next.values = std::move(current.values);
    return next;
  }

  double cell_size_;
  Vector<D> lower_;
  Cell shape_{};
  std::vector<std::int32_t> nearest_;
  std::vector<Level> levels_;
};

}  // namespace ndtree
