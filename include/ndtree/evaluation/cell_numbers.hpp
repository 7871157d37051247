// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Numbers for the cells of an even grid in which something is.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <unordered_map>
#include <vector>

#include "ndtree/core/types.hpp"

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

}  // namespace ndtree
