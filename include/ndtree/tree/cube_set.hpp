// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Sets of cubes: cells of level 0, of max_cell_size.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// A set of cells of level 0, one bit for each in a box around them.
/// Invariant: the box holds every cube of the set; rows along axis 0 begin with a word of their own.
/// Cost: O(1) for a cube, O(words of the box) for whole sets.
template <int D>
class CubeSet {
 public:
  CubeSet() = default;
  /// An empty set. @param edge of a cube in smallest cells. @param box that may get cubes, in smallest cells.
  CubeSet(std::int64_t edge, const LatticeBox<D>& box) : edge_(edge) {
    for (std::size_t a = 0; a < D; ++a) {
      first_[a] = floor_divide(box.lower[a], edge);
      count_[a] = floor_divide(box.upper[a] - 1, edge) + 1 - first_[a];
    }
    resize();
  }
  [[nodiscard]] std::int64_t edge() const { return edge_; }
  [[nodiscard]] bool empty() const {
    return std::all_of(words_.begin(), words_.end(), [](std::uint64_t word) { return word == 0; });
  }
  [[nodiscard]] std::size_t size() const {
    std::size_t cubes = 0;
    for_each([&](const Lattice<D>&) { ++cubes; });
    return cubes;
  }
  /// @param cube its lower corner over its edge. @pre it lies in the box of the set.
  void insert(const Lattice<D>& cube) {
    const auto x = static_cast<std::uint64_t>(cube[0] - first_[0]);
    words_[row_of(cube) + x / 64] |= std::uint64_t{1} << x % 64;
  }
  /// Whether a cell shares a volume with a cube of the set. @param edge of the cell.
  [[nodiscard]] bool overlaps(const CellIndex<D>& cell, std::int64_t edge) const {
    Lattice<D> first;
    Lattice<D> last;
    for (std::size_t a = 0; a < D; ++a) {
      first[a] = std::max(first_[a], floor_divide(cell.lower[a], edge_));
      last[a] = std::min(first_[a] + count_[a], floor_divide(cell.lower[a] + edge - 1, edge_) + 1);
      if (first[a] >= last[a]) return false;
    }
    Lattice<D> row = first;
    do {
      if (has_any(row_of(row), first[0] - first_[0], last[0] - first_[0])) return true;
    } while (next_row(row, first, last));
    return false;
  }
  /// Whether the sets share a cube. @pre their cubes are equally large.
  [[nodiscard]] bool overlaps(const CubeSet& other) const {
    const CubeSet& smaller = words_.size() < other.words_.size() ? *this : other;
    const CubeSet& larger = words_.size() < other.words_.size() ? other : *this;
    bool found = false;
    smaller.for_each([&](const Lattice<D>& cube) { found = found || larger.contains(cube); });
    return found;
  }
  [[nodiscard]] bool contains(const Lattice<D>& cube) const {
    for (std::size_t a = 0; a < D; ++a)
      if (cube[a] < first_[a] || cube[a] >= first_[a] + count_[a]) return false;
    const std::int64_t x = cube[0] - first_[0];
    return has_any(row_of(cube), x, x + 1);
  }
  /// Adds the cubes of another set, and room for them.
  void add(const CubeSet& other) {
    if (other.words_.empty()) return;
    if (words_.empty()) {
      *this = other;
      return;
    }
    LatticeBox<D> both;
    for (std::size_t a = 0; a < D; ++a) {
      both.lower[a] = std::min(first_[a], other.first_[a]) * edge_;
      both.upper[a] = std::max(first_[a] + count_[a], other.first_[a] + other.count_[a]) * edge_;
    }
    CubeSet sum(edge_, both);
    for (const CubeSet* set : {static_cast<const CubeSet*>(this), &other})
      set->for_each([&](const Lattice<D>& cube) { sum.insert(cube); });
    *this = std::move(sum);
  }
  /// Calls `visit(cube)` with each cube's lower corner over its edge, in ascending order of rows.
  template <class Visit>
  void for_each(const Visit& visit) const {
    if (words_.empty()) return;
    Lattice<D> end;
    for (std::size_t a = 0; a < D; ++a) end[a] = first_[a] + count_[a];
    Lattice<D> row = first_;
    do {
      for (std::size_t w = 0; w < words_of_row(); ++w)
        for (std::uint64_t word = words_[row_of(row) + w]; word != 0; word &= word - 1) {
          Lattice<D> cube = row;
          cube[0] = first_[0] + static_cast<std::int64_t>(64 * w + lowest_bit(word));
          visit(cube);
        }
    } while (next_row(row, first_, end));
  }
  [[nodiscard]] std::size_t memory_bytes() const { return words_.capacity() * sizeof(std::uint64_t); }
  /// The largest integer that is not above a / b. @pre b > 0.
  [[nodiscard]] static std::int64_t floor_divide(std::int64_t a, std::int64_t b) {
    return a / b - (a % b < 0 ? 1 : 0);
  }

 private:
  [[nodiscard]] static std::size_t lowest_bit(std::uint64_t word) {
    std::size_t bit = 0;
    for (; (word & 1) == 0; word >>= 1) ++bit;
    return bit;
  }
  [[nodiscard]] std::size_t words_of_row() const { return (static_cast<std::size_t>(count_[0]) + 63) / 64; }
  /// The first word of a cube's row.
  [[nodiscard]] std::size_t row_of(const Lattice<D>& cube) const {
    std::size_t row = 0;
    for (std::size_t a = D; a-- > 1;)
      row = row * static_cast<std::size_t>(count_[a]) + static_cast<std::size_t>(cube[a] - first_[a]);
    return row * words_of_row();
  }
  /// Whether a row has a cube in [first, last), counted from the first of the box.
  [[nodiscard]] bool has_any(std::size_t row, std::int64_t first, std::int64_t last) const {
    for (std::int64_t x = first; x < last;) {
      const std::int64_t end = std::min(last, (x / 64 + 1) * 64);
      const std::uint64_t up_to = end % 64 == 0 ? ~std::uint64_t{0} : (std::uint64_t{1} << end % 64) - 1;
      const std::uint64_t mask = up_to & ~((std::uint64_t{1} << x % 64) - 1);
      if ((words_[row + static_cast<std::size_t>(x / 64)] & mask) != 0) return true;
      x = end;
    }
    return false;
  }
  /// The next row of a box of cubes. @returns false behind the last.
  [[nodiscard]] static bool next_row(Lattice<D>& row, const Lattice<D>& first, const Lattice<D>& end) {
    for (std::size_t a = 1; a < D; ++a) {
      if (++row[a] < end[a]) return true;
      row[a] = first[a];
    }
    return false;
  }
  void resize() {
    std::size_t words = words_of_row();
    for (std::size_t a = 1; a < D; ++a) words *= static_cast<std::size_t>(count_[a]);
    words_.assign(words, 0);
  }

  std::int64_t edge_ = 1;
  Lattice<D> first_{};  // Of the box, in cubes.
  Lattice<D> count_{};
  std::vector<std::uint64_t> words_;
};

/// Where cells may change: in a box, and there in cubes of a set if there is one.
template <int D>
struct ChangeWindow {
  const LatticeBox<D>* box = nullptr;  ///< Null: everywhere.
  const CubeSet<D>* cubes = nullptr;   ///< Null: in all cubes.

  /// Whether anything of a cell may change. @param edge of the cell.
  [[nodiscard]] bool overlaps(const CellIndex<D>& cell, std::int64_t edge) const {
    return (box == nullptr || box->overlaps(cell, edge)) && (cubes == nullptr || cubes->overlaps(cell, edge));
  }
};

}  // namespace ndtree
