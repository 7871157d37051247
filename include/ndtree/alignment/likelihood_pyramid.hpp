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

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Values on a grid, stored in bricks of 8^D places: only where one was written. Elsewhere all have one
/// value.
template <int D, class T>
class BrickGrid {
 public:
  using Place = std::array<std::int32_t, std::size_t{D}>;
  static constexpr int kBits = 3;  ///< A brick has 2^kBits places on each axis.
  static constexpr std::size_t kPlaces = std::size_t{1} << (kBits * D);

  BrickGrid() = default;
  BrickGrid(const Place& shape, T everywhere)
      : shape_(shape), everywhere_(everywhere), values_(kPlaces, everywhere) {
    std::size_t count = 1;
    for (const std::int32_t n : shape_) count *= bricks_along(n);
    bricks_.assign(count, 0);
  }
  [[nodiscard]] static std::size_t bricks_along(std::int32_t places) {
    return (static_cast<std::size_t>(places) + (std::size_t{1} << kBits) - 1) >> kBits;
  }
  [[nodiscard]] const Place& shape() const { return shape_; }

  /// @pre the place is inside.
  [[nodiscard]] T at(const Place& place) const {
    const Index index = index_of(place);
    return values_[(static_cast<std::size_t>(bricks_[index.brick]) << (kBits * D)) + index.inner];
  }
  [[nodiscard]] bool is_inside(const Place& place) const {
    bool inside = true;
    for (std::size_t a = 0; a < std::size_t{D}; ++a)
      inside = inside && static_cast<std::uint32_t>(place[a]) < static_cast<std::uint32_t>(shape_[a]);
    return inside;
  }
  /// To write to. @pre the place is inside.
  [[nodiscard]] T& make(const Place& place) {
    const Index index = index_of(place);
    std::uint32_t& brick = bricks_[index.brick];
    if (brick == 0) {
      brick = static_cast<std::uint32_t>(values_.size() >> (kBits * D));
      values_.resize(values_.size() + kPlaces, everywhere_);
    }
    return values_[(static_cast<std::size_t>(brick) << (kBits * D)) + index.inner];
  }
  /// Calls `visit(place, value)` for each place that has not the value of everywhere, brick by brick.
  template <class Visit>
  void for_each(const Visit& visit) const {
    Place first{};  // Of the brick.
    for (const std::uint32_t brick : bricks_) {
      if (brick != 0) {
        const T* const values = &values_[static_cast<std::size_t>(brick) << (kBits * D)];
        for (std::size_t inner = 0; inner < kPlaces; ++inner) {
          if (values[inner] == everywhere_) continue;
          Place place = first;
          for (std::size_t a = 0; a < std::size_t{D}; ++a)
            place[a] += static_cast<std::int32_t>(inner >> (kBits * (D - 1 - static_cast<int>(a))) & 7u);
          visit(place, values[inner]);
        }
      }
      for (std::size_t a = std::size_t{D}; a-- > 0;) {
        first[a] += std::int32_t{1} << kBits;
        if (first[a] < shape_[a]) break;
        first[a] = 0;
      }
    }
  }

 private:
  struct Index {
    std::size_t brick;
    std::size_t inner;
  };
  [[nodiscard]] Index index_of(const Place& place) const {
    Index index{0, 0};
    for (std::size_t a = 0; a < std::size_t{D}; ++a) {
      const auto at = static_cast<std::size_t>(place[a]);
      index.brick = index.brick * bricks_along(shape_[a]) + (at >> kBits);
      index.inner = index.inner << kBits | (at & 7u);
    }
    return index;
  }

  Place shape_{};
  T everywhere_{};
  std::vector<std::uint32_t> bricks_;  // Numbers; 0 is the one of places not written to.
  std::vector<T> values_;              // By brick.
};

/// exp(-d²/2σ²) of the distance d from a grid cell's centre to the nearest surface point, in 255ths, and for
/// each level h its maxima: bound(h, q) is at least the likelihood of each cell in [q, q + 2^h) on each axis.
///
/// Level h >= 1 is stored at every 2^(h-1)-th cell, so a bound looks at up to 1.5 times its block per axis,
/// and all levels together take little more than the first two. Integers, so that sums are the same in any
/// order. Memory: bricks of 8^D cells where a point is within 3 sigma, with 10 bytes a cell while it is made,
/// and for others 20 bytes a brick; so it grows with the surface, and its box takes 350 MB at most.
template <int D>
class LikelihoodPyramid {
 public:
  using Cell = std::array<std::int32_t, std::size_t{D}>;
  static constexpr int kMaximum = 255;
  static constexpr std::int32_t kNoPoint = -1;

  /// @param points of surfaces. @param cell_size of the grid [m]. @param sigma of an end point's distance
  /// [m].
  /// @throws std::invalid_argument if the grid would have more than 2^24 bricks. @throws Cancelled.
  LikelihoodPyramid(const Points<D>& points, double cell_size, double sigma) : cell_size_(cell_size) {
    const double reach = kReach * sigma;
    Vector<D> upper = Vector<D>::Zero();
    lower_ = Vector<D>::Zero();
    if (points.cols() > 0) {
      lower_ = points.rowwise().minCoeff().array() - reach;
      upper = points.rowwise().maxCoeff().array() + reach;
    }
    // Grids of one map share their lattice, wherever they begin.
    double bricks = 1.0;
    for (int a = 0; a < D; ++a) {
      lower_[a] = std::floor(lower_[a] / cell_size) * cell_size;
      const double count = std::floor((upper[a] - lower_[a]) / cell_size) + 1.0;
      bricks *= std::ceil((count + kPad) / 8.0);
      if (!(bricks <= 16777216.0))
        throw std::invalid_argument(
            "cell_size = " + describe_number(cell_size) +
            " m: the surface's box has more than 2^24 bricks of 8 such cells on each axis");
      shape_[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(count) + kPad;
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
    const BrickGrid<D, std::uint8_t>& of = levels_[static_cast<std::size_t>(level)];
    const int shift = level == 0 ? 0 : level - 1;
    Cell at;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) at[a] = (cell[a] >> shift) + kPad;
    return of.is_inside(at) ? of.at(at) : 0;
  }
  /// The surface point nearest to a cell's centre, or kNoPoint if none is within 3 sigma.
  [[nodiscard]] std::int32_t nearest(const Cell& cell) const {
    Cell at;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) at[a] = cell[a] + kPad;
    return nearest_.is_inside(at) ? nearest_.at(at) : kNoPoint;
  }
  /// Cells on an axis: beyond, nothing is likely.
  [[nodiscard]] std::int32_t count(std::size_t axis) const { return shape_[axis] - kPad; }
  /// Calls `visit(cell, likelihood)` for each cell where something is likely.
  template <class Visit>
  void for_each_likely(const Visit& visit) const {
    levels_[0].for_each([&](Cell cell, std::uint8_t likelihood) {
      for (std::int32_t& at : cell) at -= kPad;
      visit(cell, likelihood);
    });
  }
  /// Makes levels up to one, if they are not there yet. @throws Cancelled.
  void grow_to(int level) {
    while (num_levels() <= level) levels_.push_back(above(levels_.back(), num_levels()));
  }

 private:
  using Likelihoods = BrickGrid<D, std::uint8_t>;
  static constexpr double kReach = 3.0;  // Sigmas; beyond, 0.
  static constexpr double kFar = 1e8;
  static constexpr std::int32_t kPad = 2;  // Places before the grid from which a block reaches into it.

  void make_base(const Points<D>& points, double sigma, double reach) {
    nearest_ = BrickGrid<D, std::int32_t>(shape_, kNoPoint);
    const float none = static_cast<float>(reach * reach);
    BrickGrid<D, float> squared(shape_, none);
    Pace pace;
    for (Eigen::Index i = 0; i < points.cols(); ++i) {
      const Vector<D> point = points.col(i);
      Cell first;
      Cell last;
      std::size_t cells = 1;
      for (int a = 0; a < D; ++a) {
        const auto axis = static_cast<std::size_t>(a);
        first[axis] =
            kPad +
            std::max(0, static_cast<std::int32_t>(std::floor((point[a] - reach - lower_[a]) / cell_size_)));
        last[axis] = std::min(
            shape_[axis] - 1,
            kPad + static_cast<std::int32_t>(std::floor((point[a] + reach - lower_[a]) / cell_size_)));
        cells *= static_cast<std::size_t>(std::max(0, last[axis] - first[axis] + 1));
      }
      pace.spend(cells);
      Cell at = first;
      splat<0>(first, last, point, at, 0.0, static_cast<std::int32_t>(i), squared);
    }
    Likelihoods base(shape_, 0);
    const double scale = -0.5 / (sigma * sigma);
    squared.for_each([&](const Cell& place, float square) {
      pace.spend();
      base.make(place) =
          static_cast<std::uint8_t>(std::lround(kMaximum * std::exp(scale * static_cast<double>(square))));
    });
    levels_.push_back(std::move(base));
  }

  template <int A>
  void splat(const Cell& first, const Cell& last, const Vector<D>& point, Cell& at, double sum,
             std::int32_t number, BrickGrid<D, float>& squared) {
    for (at[A] = first[A]; at[A] <= last[A]; ++at[A]) {
      const double away = lower_[A] + (at[A] - kPad + 0.5) * cell_size_ - point[A];
      const double total = sum + away * away;
      if constexpr (A + 1 < D) {
        splat<A + 1>(first, last, point, at, total, number, squared);
      } else if (static_cast<float>(total) < squared.at(at)) {
        squared.make(at) = static_cast<float>(total);
        nearest_.make(at) = number;
      }
    }
  }

  /// Level h + 1 of level h. A value of level h >= 1 at place j, of size s = 2^(h-1), covers the cells
  /// [js, js + 3s - 2]; the next covers [2js, 2js + 6s - 2], which are the places 2j, 2j + 1 and 2j + 3.
  [[nodiscard]] Likelihoods above(const Likelihoods& below, int level) const {
    const bool is_first = level == 1;  // Same places, blocks of two.
    Cell shape;
    for (std::size_t a = 0; a < std::size_t{D}; ++a)
      shape[a] = ((shape_[a] - kPad - 1) >> (level - 1)) + 1 + kPad;
    Likelihoods next(shape, 0);
    Pace pace;
    below.for_each([&](const Cell& place, std::uint8_t value) {
      pace.spend(std::size_t{2} << D);
      // On each axis, the places above that look at this one: the larger, and how much smaller the other is.
      Cell upper;
      Cell step;
      for (std::size_t a = 0; a < std::size_t{D}; ++a) {
        const std::int32_t from = place[a] - kPad;
        upper[a] = (is_first ? from : from >> 1) + kPad;
        step[a] = is_first || (from & 1) != 0 ? 1 : 0;
      }
      for (unsigned corner = 0; corner < 1u << D; ++corner) {
        Cell to = upper;
        bool is_other = true;
        for (std::size_t a = 0; a < std::size_t{D}; ++a) {
          if ((corner >> a & 1u) == 0) continue;
          to[a] -= step[a];
          is_other = is_other && step[a] != 0;
        }
        if (!is_other || !next.is_inside(to) || next.at(to) >= value) continue;
        next.make(to) = value;
      }
    });
    return next;
  }

  double cell_size_;
  Vector<D> lower_;
  Cell shape_{};  // With kPad places before the first.
  BrickGrid<D, std::int32_t> nearest_;
  std::vector<Likelihoods> levels_;
};

}  // namespace ndtree
