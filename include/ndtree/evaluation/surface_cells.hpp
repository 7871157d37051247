// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The cells in which the beams of a log ended, and how wide the surfaces in them are.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <optional>
#include <unordered_map>
#include <utility>
#include <vector>

#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/evaluation/beam_image.hpp"

namespace ndtree {

/// The cells of an even grid that points were put into, numbered from 0 in the order of their first points.
///
/// Cells lie in cubes of 64: a hash table finds the cube, and a caller that asks about points one after the
/// other, which mostly are in the same cube, keeps a Cursor. Not limited to any region but by kFarthest.
template <int D>
class CellNumbers {
 public:
  using Cell = Eigen::Matrix<std::int32_t, D, 1>;
  static constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
  static constexpr double kFarthest = 1e6;  ///< Cells on each axis from the grid's origin.

  /// Where the last point was.
  struct Cursor {
    std::uint64_t key = std::numeric_limits<std::uint64_t>::max();
    std::uint32_t cube = kNone;
  };

  /// @param size of cells [m]. @param origin a corner of one.
  CellNumbers(double size, const Vector<D>& origin) : size_(size), origin_(origin) {}

  [[nodiscard]] std::size_t size() const { return cells_.size(); }
  [[nodiscard]] const Cell& cell(std::uint32_t number) const { return cells_[number]; }

  /// The number of the cell around a point, a new one if it has none; kNone if it is too far away.
  std::uint32_t put(const Vector<D>& point, Cursor& cursor) {
    Cell cell;
    if (!cell_of(point, cell)) return kNone;
    const std::uint64_t key = key_of(cell);
    if (key != cursor.key) {
      cursor.key = key;
      cursor.cube = cubes_by_key_.try_emplace(key, static_cast<std::uint32_t>(cubes_.size())).first->second;
      if (cursor.cube == cubes_.size()) cubes_.emplace_back().fill(kNone);
    }
    std::uint32_t& number = cubes_[cursor.cube][inner(cell)];
    if (number == kNone) {
      number = static_cast<std::uint32_t>(cells_.size());
      cells_.push_back(cell);
    }
    return number;
  }
  /// The number of the cell around a point, or kNone.
  [[nodiscard]] std::uint32_t find(const Vector<D>& point, Cursor& cursor) const {
    Cell cell;
    if (!cell_of(point, cell)) return kNone;
    const std::uint64_t key = key_of(cell);
    if (key != cursor.key) {
      cursor.key = key;
      const auto found = cubes_by_key_.find(key);
      cursor.cube = found == cubes_by_key_.end() ? kNone : found->second;
    }
    return cursor.cube == kNone ? kNone : cubes_[cursor.cube][inner(cell)];
  }
  /// Gives number i the number `now[i]`.
  void renumber(const std::vector<std::uint32_t>& now) {
    for (auto& cube : cubes_)
      for (std::uint32_t& number : cube)
        if (number != kNone) number = now[number];
    std::vector<Cell> moved(cells_.size());
    for (std::size_t i = 0; i < cells_.size(); ++i) moved[now[i]] = cells_[i];
    cells_ = std::move(moved);
  }

 private:
  static constexpr int kInnerBits = D == 3 ? 2 : 3;
  static constexpr int kBits = 21;  // Of a cube's number on an axis.

  [[nodiscard]] bool cell_of(const Vector<D>& point, Cell& cell) const {
    for (int k = 0; k < D; ++k) {
      const double number = std::floor((point[k] - origin_[k]) / size_);
      if (!(std::abs(number) <= kFarthest)) return false;
      cell[k] = static_cast<std::int32_t>(number);
    }
    return true;
  }
  [[nodiscard]] static std::uint64_t key_of(const Cell& cell) {
    std::uint64_t key = 0;
    for (int k = 0; k < D; ++k)
      key = key << kBits | static_cast<std::uint64_t>((cell[k] >> kInnerBits) + (1 << (kBits - 1)));
    return key;
  }
  [[nodiscard]] static std::size_t inner(const Cell& cell) {
    std::size_t index = 0;
    for (int k = 0; k < D; ++k)
      index = index << kInnerBits | static_cast<std::size_t>(cell[k] & ((1 << kInnerBits) - 1));
    return index;
  }

  double size_;
  Vector<D> origin_;
  std::unordered_map<std::uint64_t, std::uint32_t> cubes_by_key_;
  std::vector<std::array<std::uint32_t, 64>> cubes_;
  std::vector<Cell> cells_;
};

/// The cells of an even grid in which beams ended, with the mean of their points, of their sigmas, and the
/// width of what they ended on: wide surfaces are met by any scan that looks, rods and leaves by chance.
///
/// Points are added first, then sort() ends that. Coordinates are relative to base(), near the first point,
/// so that floats are exact enough [m].
template <int D>
class SurfaceCells {
 public:
  using Point = Eigen::Matrix<float, D, 1>;
  static constexpr std::size_t kSides = D - 1;
  static constexpr std::uint32_t kNone = CellNumbers<D>::kNone;
  using Cursor = typename CellNumbers<D>::Cursor;
  using Size = typename BeamImage<D>::Offset;

  /// @param size of cells [m].
  explicit SurfaceCells(double size) : size_(size) {}

  [[nodiscard]] std::size_t size() const { return numbers_ ? numbers_->size() : 0; }
  [[nodiscard]] const Vector<D>& base() const { return base_; }
  [[nodiscard]] Point relative(const Vector<D>& point) const {
    return (point - base_).template cast<float>();
  }
  /// The number of the cell around a point; kNone.
  [[nodiscard]] std::uint32_t find(const Vector<D>& point, Cursor& cursor) const {
    return numbers_ ? numbers_->find(point, cursor) : kNone;
  }

  /// Adds a point with the standard deviation of its range [m]. @returns its cell; kNone if it is more than a
  /// million cells from the first.
  std::uint32_t add(const Vector<D>& point, float sigma, Cursor& cursor) {
    if (!numbers_) {
      base_ = point;
      numbers_.emplace(size_, base_);
    }
    const std::uint32_t number = numbers_->put(point, cursor);
    if (number == kNone) return kNone;
    if (number == cells_.size()) cells_.emplace_back();
    Cell& cell = cells_[number];
    ++cell.points;
    const float part = 1.0F / static_cast<float>(cell.points);
    const Point at = relative(point);
    for (int k = 0; k < D; ++k) cell.mean[k] = unfused((at[k] - cell.mean[k]) * part) + cell.mean[k];
    cell.sigma = unfused((sigma - cell.sigma) * part) + cell.sigma;
    return number;
  }
  /// Whether a scan, counted from 1, is to measure the surface in a cell: once, since its other points there
  /// look alike, and not after many others. @pre then measure() is called.
  [[nodiscard]] bool wants_size(std::uint32_t number, std::uint32_t scan) {
    Cell& cell = cells_[number];
    if (cell.scan == scan || cell.measured == kMostMeasured) return false;
    cell.scan = scan;
    return true;
  }
  /// Counts a surface of a size [m], 0 of a rod, see BeamImage::size_of_surface().
  void measure(std::uint32_t number, const Size& size) {
    ++cells_[number].measured;
    for (std::size_t k = 0; k < kSides; ++k) ++cells_[number].widths[k][width_class(size[k])];
  }
  /// The size from which on all are alike [m].
  [[nodiscard]] float largest_size() const { return 8.0F * static_cast<float>(size_); }

  /// Renumbers the cells in Morton order: eight in a row are near each other, and so are eight of these.
  void sort() {
    const std::size_t n = size();
    std::vector<std::uint64_t> place(n, 0);
    constexpr int kBits = 21;
    for (std::size_t i = 0; i < n; ++i)
      for (int k = 0; k < D; ++k) {
        const auto shifted =
            static_cast<std::uint64_t>(numbers_->cell(static_cast<std::uint32_t>(i))[k] + (1 << (kBits - 1)));
        for (int bit = 0; bit < kBits; ++bit) place[i] |= (shifted >> bit & 1U) << (bit * D + k);
      }
    std::vector<std::uint32_t> order(n);
    std::iota(order.begin(), order.end(), 0U);
    std::sort(order.begin(), order.end(),
              [&](std::uint32_t a, std::uint32_t b) { return place[a] < place[b]; });
    std::vector<Cell> sorted(n);
    std::vector<std::uint32_t> now(n);
    for (std::size_t i = 0; i < n; ++i) {
      sorted[i] = cells_[order[i]];
      now[order[i]] = static_cast<std::uint32_t>(i);
    }
    cells_ = std::move(sorted);
    if (numbers_) numbers_->renumber(now);
  }
  /// The first cell of each cube of 16 cells' edge that has any. @pre sort()
  [[nodiscard]] std::vector<std::uint32_t> blocks() const {
    std::vector<std::uint32_t> firsts;
    typename CellNumbers<D>::Cell last = CellNumbers<D>::Cell::Zero();
    for (std::uint32_t i = 0; i < size(); ++i) {
      typename CellNumbers<D>::Cell block = numbers_->cell(i);
      for (int k = 0; k < D; ++k) block[k] >>= kBlockBits;
      if (firsts.empty() || block != last) firsts.push_back(i);
      last = block;
    }
    return firsts;
  }
  // Of a cell, until forget():
  [[nodiscard]] const Point& mean(std::size_t i) const { return cells_[i].mean; }
  [[nodiscard]] float sigma(std::size_t i) const { return cells_[i].sigma; }
  /// Of what a cell's points are on, along an axis [m]: at most a fraction of kNarrower looks narrower.
  [[nodiscard]] float width(std::size_t i, std::size_t axis) const {
    const Cell& cell = cells_[i];
    std::uint32_t below = 0;
    for (std::size_t c = 0; c < kWidths; ++c) {
      below += cell.widths[axis][c];
      if (static_cast<double>(below) > kNarrower * static_cast<double>(cell.measured)) return least_width(c);
    }
    return least_width(kWidths - 1);
  }
  /// Frees all but the numbers.
  void forget() { cells_ = {}; }

 private:
  static constexpr int kBlockBits = 4;  // Of the number of cells along a block: some rods of a fence.
  static constexpr std::size_t kWidths = 12;
  static constexpr std::uint8_t kMostMeasured = 24;  // Surfaces in a cell: more change its width little.
  // Of a cell's surfaces, that look narrower than they are: beside rods that stand in a row, beams that meet
  // two of them take both for one surface, and fewer than this do not.
  static constexpr double kNarrower = 0.15;

  struct Cell {
    Point mean = Point::Zero();
    float sigma = 0.0F;  // Of the ranges, on average [m].
    std::uint32_t points = 0;
    std::uint32_t scan = 0;  // The last with a surface that was measured.
    std::uint8_t measured = 0;
    // By axis, numbers of points on surfaces of widths, see width_class().
    std::array<std::array<std::uint8_t, kWidths>, kSides> widths{};
  };

  /// Widths of surfaces by half octaves, from a quarter of a cell on; 0: less.
  [[nodiscard]] std::size_t width_class(float width) const {
    std::size_t found = 0;
    while (found + 1 < kWidths && width >= least_width(found + 1)) ++found;
    return found;
  }
  [[nodiscard]] float least_width(std::size_t of_class) const {
    constexpr std::array<float, 2> kHalfOctaves{1.0F, 1.41421354F};
    if (of_class == 0) return 0.0F;
    return static_cast<float>(size_) * 0.25F * kHalfOctaves[(of_class - 1) % 2] *
           static_cast<float>(1U << (of_class - 1) / 2);
  }

  double size_;
  Vector<D> base_ = Vector<D>::Zero();
  std::optional<CellNumbers<D>> numbers_;  // From the first point on.
  std::vector<Cell> cells_;                // By number.
};

/// Balls around kFanOut cells each, or around kFanOut balls, by the order of SurfaceCells::sort(); a few
/// behind the last are empty.
template <int D>
struct CellBalls {
  static constexpr std::size_t kFanOut = 8;
  std::array<std::vector<float>, std::size_t{D}> centers;
  std::vector<float> radius;
  std::vector<float> margin;  ///< The largest of their cells.
  std::size_t size = 0;

  /// Levels up to one of at most kFanOut balls; level 0 holds cells. @param margins one a cell.
  [[nodiscard]] static std::vector<CellBalls> around(const SurfaceCells<D>& cells,
                                                     const std::vector<float>& margins) {
    std::vector<CellBalls> levels;
    const std::size_t n = cells.size();
    for (std::size_t width = kFanOut; n > 0; width *= kFanOut) {
      CellBalls& level = levels.emplace_back();
      for (std::size_t begin = 0; begin < n; begin += width) {
        typename SurfaceCells<D>::Point lower = cells.mean(begin);
        typename SurfaceCells<D>::Point upper = lower;
        float margin = 0.0F;
        for (std::size_t i = begin; i < std::min(n, begin + width); ++i) {
          lower = lower.cwiseMin(cells.mean(i));
          upper = upper.cwiseMax(cells.mean(i));
          margin = std::max(margin, margins[i]);
        }
        for (std::size_t k = 0; k < D; ++k)
          level.centers[k].push_back(0.5F * (lower[static_cast<int>(k)] + upper[static_cast<int>(k)]));
        level.radius.push_back(0.5F * (upper - lower).norm());
        level.margin.push_back(margin);
      }
      level.size = level.radius.size();
      const std::size_t padded = (level.size + kFanOut - 1) / kFanOut * kFanOut;
      for (std::vector<float>& center : level.centers) center.resize(padded, 0.0F);
      level.radius.resize(padded, 0.0F);
      level.margin.resize(padded, 0.0F);
      if (level.size <= kFanOut) break;
    }
    return levels;
  }
};

}  // namespace ndtree
