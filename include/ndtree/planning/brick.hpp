// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Bits of many smallest cells: obstacles around a cube, and the places in it from which a body meets none.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/planning/body_stencil.hpp"

namespace ndtree::detail {

/// A bit for each cell of a cube of kEdge^D smallest cells, and for each larger cube in it whose edge is a
/// power of two: whether all of its bits are set.
template <int D>
class Brick {
 public:
  static constexpr int kLevels = D == 2 ? 5 : 4;
  static constexpr int kEdge = 1 << kLevels;
  using Row = std::conditional_t<D == 2, std::uint32_t, std::uint16_t>;
  using Place = std::array<int, std::size_t{D}>;

  static constexpr int rows_of(int level) {
    int rows = 1;
    for (int a = 1; a < D; ++a) rows *= kEdge >> level;
    return rows;
  }

  /// @param place in cubes of the level.
  [[nodiscard]] bool get(int level, const Place& place) const {
    return (rows_[static_cast<std::size_t>(row_index(level, place))] >> place[0] & 1) != 0;
  }
  /// Of smallest cells, in the order of the axes after the first, the last one slowest.
  [[nodiscard]] Row& row(int number) { return rows_[static_cast<std::size_t>(number)]; }
  [[nodiscard]] Row row(int number) const { return rows_[static_cast<std::size_t>(number)]; }

  /// Sets the bits of larger cubes from those of the cells.
  void close() {
    for (int level = 0; level < kLevels; ++level) {
      Place place{};
      for (int r = 0; r < rows_of(level + 1); ++r) {
        Row all = static_cast<Row>(~Row{0});
        for (int corner = 0; corner < 1 << (D - 1); ++corner) {
          Place below{};
          for (int a = 1; a < D; ++a)
            below[static_cast<std::size_t>(a)] =
                2 * place[static_cast<std::size_t>(a)] + (corner >> (a - 1) & 1);
          all &= rows_[static_cast<std::size_t>(row_index(level, below))];
        }
        rows_[static_cast<std::size_t>(row_index(level + 1, place))] = halved(all);
        for (std::size_t a = 1; a < D && ++place[a] == kEdge >> (level + 1); ++a) place[a] = 0;
      }
    }
  }

 private:
  static constexpr int first_row(int level) {
    int first = 0;
    for (int k = 0; k < level; ++k) first += rows_of(k);
    return first;
  }
  static constexpr auto kFirstRows = [] {
    std::array<int, static_cast<std::size_t>(kLevels + 2)> first{};
    for (int k = 0; k <= kLevels + 1; ++k) first[static_cast<std::size_t>(k)] = first_row(k);
    return first;
  }();

  static int row_index(int level, const Place& place) {
    int index = 0;
    for (std::size_t a = D - 1; a > 0; --a) index = (index << (kLevels - level)) + place[a];
    return kFirstRows[static_cast<std::size_t>(level)] + index;
  }
  /// Of each two neighbouring bits, both.
  static Row halved(Row row) {
    std::uint32_t bits = row & (row >> 1) & 0x55555555u;
    bits = (bits | bits >> 1) & 0x33333333u;
    bits = (bits | bits >> 2) & 0x0f0f0f0fu;
    bits = (bits | bits >> 4) & 0x00ff00ffu;
    return static_cast<Row>((bits | bits >> 8) & 0x0000ffffu);
  }

  std::array<Row, std::size_t{kFirstRows[kLevels + 1]}> rows_{};
};

/// What a brick says of its cubes of kEdge^D smallest cells, a bit each, the first axis fastest.
template <int D>
struct CubeBits {
  static constexpr int kLevel = 2;
  static constexpr int kEdge = 1 << kLevel;
  static constexpr int kPerAxis = Brick<D>::kEdge / kEdge;
  using Place = std::array<int, std::size_t{D}>;

  std::uint64_t any = 0;   ///< Some place in it is passable.
  std::uint64_t free = 0;  ///< Some place in it is free.
  /// Places are passable on both sides of its upper face on an axis, somewhere; 0 at the side of the brick.
  std::array<std::uint64_t, std::size_t{D}> joined{};

  [[nodiscard]] static std::uint64_t bit(const Place& cube) {
    int number = 0;
    for (std::size_t a = D; a-- > 0;) number = number * kPerAxis + cube[a];
    return std::uint64_t{1} << number;
  }
  /// @param passable places, free or at a cost.
  [[nodiscard]] static CubeBits of(const Brick<D>& free, const Brick<D>& passable) {
    CubeBits bits;
    for (int r = 0; r < Brick<D>::rows_of(0); ++r) {
      const std::uint32_t row = passable.row(r);
      const int shift = shift_of(r);
      bits.any |= gathered(row) << shift;
      bits.free |= gathered(free.row(r)) << shift;
      bits.joined[0] |= gathered(row & row >> 1 & kLasts) << shift;
      for (int a = 1, step = 1; a < D; ++a, step *= Brick<D>::kEdge) {
        const int at = r / step % Brick<D>::kEdge;
        if (at % kEdge == kEdge - 1 && at < Brick<D>::kEdge - 1)
          bits.joined[static_cast<std::size_t>(a)] |= gathered(row & passable.row(r + step)) << shift;
      }
    }
    return bits;
  }

 private:
  static constexpr std::uint32_t kLasts = 0x88888888u;

  /// Of the first cube in a row of places.
  [[nodiscard]] static int shift_of(int row) {
    constexpr int kBrick = Brick<D>::kEdge;
    return kPerAxis * (row % kBrick / kEdge + (D == 3 ? kPerAxis * (row / kBrick / kEdge) : 0));
  }
  /// For each four bits, whether one of them is set.
  [[nodiscard]] static std::uint64_t gathered(std::uint32_t row) {
    row = (row | row >> 1 | row >> 2 | row >> 3) & 0x11111111u;
    row = (row | row >> 3) & 0x03030303u;
    row = (row | row >> 6) & 0x000f000fu;
    return (row | row >> 12) & 0xffu;
  }
};

/// Obstacles in a brick and as far around it as a stencil reaches: a bit for each smallest cell, in rows
/// along the first axis.
template <int D>
class ObstacleBits {
 public:
  using Place = std::array<int, std::size_t{D}>;

  explicit ObstacleBits(const BodyStencil<D>& stencil) : stencil_(stencil) {
    for (std::size_t a = 0; a < D; ++a)
      extent_[a] = Brick<D>::kEdge + stencil.upper()[a] - stencil.lower()[a];
    words_ = static_cast<std::size_t>(extent_[0]) / 64 + 2;  // What is read may begin in the last one.
    std::size_t rows = 1;
    for (std::size_t a = 1; a < D; ++a) rows *= static_cast<std::size_t>(extent_[a]);
    bits_.assign(rows * words_, 0);
  }

  void clear() { std::fill(bits_.begin(), bits_.end(), std::uint64_t{0}); }
  /// Sets the cells of a box, half-open, in cells from the lower corner of what is looked at.
  void set(Place lower, Place upper, bool to = true) {
    for (std::size_t a = 0; a < D; ++a) {
      lower[a] = std::max(lower[a], 0);
      upper[a] = std::min(upper[a], extent_[a]);
      if (lower[a] >= upper[a]) return;
    }
    Place at = lower;
    for (bool goes_on = true; goes_on;) {
      set_row(bits_.data() + row_of(at) * words_, lower[0], upper[0], to);
      goes_on = false;
      for (std::size_t a = 1; a < D && !goes_on; ++a) {
        goes_on = ++at[a] < upper[a];
        if (!goes_on) at[a] = lower[a];
      }
    }
  }
  /// Sets the bits of all cells of a brick from which the body meets an obstacle.
  /// O(rows with an obstacle · runs from which it is met in the brick). @throws Cancelled
  void spread(Brick<D>& met) {
    for (int r = 0; r < Brick<D>::rows_of(0); ++r) met.row(r) = 0;
    Spread spread(stencil_.spans().size(), {~std::size_t{0}, 0});
    Place at{};
    for (std::size_t r = 0; r * words_ < bits_.size(); ++r) {
      spread_row(r, at, spread, met);
      for (std::size_t a = 1; a < D && ++at[a] == extent_[a]; ++a) at[a] = 0;
    }
  }

 private:
  static constexpr int kChunk = 64 - Brick<D>::kEdge;  // Offsets that a word answers for all bits of a row.

  [[nodiscard]] std::size_t row_of(const Place& at) const {
    std::size_t row = 0;
    for (std::size_t a = D - 1; a > 0; --a)
      row = row * static_cast<std::size_t>(extent_[a]) + static_cast<std::size_t>(at[a]);
    return row;
  }
  static void set_row(std::uint64_t* row, int first, int last, bool to) {
    while (first < last) {
      const int end = std::min(last, (first / 64 + 1) * 64);
      const std::uint64_t mask = (~std::uint64_t{0} >> (64 - (end - first))) << first % 64;
      if (to)
        row[first / 64] |= mask;
      else
        row[first / 64] &= ~mask;
      first = end;
    }
  }
  /// 64 bits from one on.
  static std::uint64_t word_at(const std::uint64_t* row, int bit) {
    const int shift = bit % 64;
    row += bit / 64;
    return shift == 0 ? row[0] : row[0] >> shift | row[1] << (64 - shift);
  }
  /// For each of the first bits, whether one of `count` bits from there on is set.
  static std::uint64_t any_of(std::uint64_t bits, int count) {
    int done = 1;
    for (; 2 * done <= count; done *= 2) bits |= bits >> done;
    return done < count ? bits | bits >> (count - done) : bits;
  }

  /// By span: the bits of a row from which it is met, and which row they are of.
  using Spread = std::vector<std::pair<std::size_t, std::uint32_t>>;

  [[nodiscard]] std::uint32_t spread_by(const typename BodyStencil<D>::Span& span, const std::uint64_t* row) {
    const auto [first, last] = span;
    std::uint64_t bits = 0;
    for (int from = first; from <= last; from += kChunk)
      bits |= any_of(word_at(row, from - stencil_.lower()[0]), std::min(kChunk, last - from + 1));
    pace_.spend(1 + static_cast<std::size_t>(last - first) / (4 * kChunk));
    return static_cast<std::uint32_t>(bits);
  }
  void spread_row(std::size_t number, const Place& at, Spread& spread, Brick<D>& met) {
    const std::uint64_t* const row = bits_.data() + number * words_;
    std::uint64_t any = 0;
    for (std::size_t w = 0; w < words_; ++w) any |= row[w];
    if (any == 0) return;
    const int first = at[1] + stencil_.lower()[1];  // Its offset from the first row of a plane of the brick.
    for (int plane = 0; plane < Brick<D>::rows_of(0) / Brick<D>::kEdge; ++plane)
      stencil_.for_each_run(first - (Brick<D>::kEdge - 1), first, at[D - 1] + stencil_.lower()[D - 1] - plane,
                            [&](const auto& run) {
                              auto& [of, bits] = spread[static_cast<std::size_t>(run.span)];
                              if (of != number) {
                                of = number;
                                bits = spread_by(stencil_.spans()[static_cast<std::size_t>(run.span)], row);
                              }
                              auto& target = met.row(plane * Brick<D>::kEdge + first - run.at[1]);
                              target = static_cast<typename Brick<D>::Row>(target | bits);
                            });
  }

  const BodyStencil<D>& stencil_;
  Place extent_;
  std::size_t words_;
  std::vector<std::uint64_t> bits_;
  Pace pace_;
};

}  // namespace ndtree::detail
