// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The distance to the nearest of many boxes, for all points of a grid at once.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/field_grid.hpp"

namespace ndtree::detail {

/// Squared distances from the points of a block to the nearest of many boxes, one axis after the other
/// (Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions", 2012), but exact for boxes of
/// any size at any place: the borders of all boxes cut space into slabs on each axis, so that every box is a
/// block of slabs; what is nearest in each row of slabs along the last axis is known from the row alone, and
/// every further axis adds the distance to each of its slabs and takes the least. Values are those of
/// ((z² + y²) + x²) in float32 for the nearest box, whatever the block and the other boxes.
template <int D>
class DistanceTransform {
 public:
  /// @param most distance that matters [m]. @param pace of the whole call.
  DistanceTransform(const FieldGrid<D>& grid, const GridBlock<D>& block, double most, Pace& pace)
      : limit_(static_cast<float>(most * most)),
        points_(grid.box_of(block)),
        reach_(points_.inflated(most)),
        pace_(pace) {
    for (int a = 0; a < D; ++a) {  // What is added may be less than what rounding takes away.
      reach_.lower[a] = std::nextafter(reach_.lower[a], -std::numeric_limits<double>::infinity());
      reach_.upper[a] = std::nextafter(reach_.upper[a], std::numeric_limits<double>::infinity());
    }
    for (std::size_t a = 0; a < kAxes; ++a)
      for (std::size_t i = block.first[a]; i < block.last[a]; ++i)
        axes_[a].points.push_back(grid.center(a, i));
    below_[kAxes - 1] = 1;
    for (std::size_t a = kAxes - 1; a > 0; --a) below_[a - 1] = below_[a] * axes_[a].points.size();
  }

  /// What lies beyond is farther from all points than what matters.
  [[nodiscard]] const Box<D>& reach() const { return reach_; }
  /// The square of the distance that matters: what points have without anything nearer.
  [[nodiscard]] float limit() const { return limit_; }

  /// At most limit(), in the order of a C array: the last axis varies fastest. Good until the next call.
  [[nodiscard]] const std::vector<float>& squared_distances(const std::vector<Box<D>>& boxes) {
    squared_.resize(below_[0] * axes_[0].points.size());
    cut(boxes);
    if (spans_.empty()) {
      std::fill(squared_.begin(), squared_.end(), limit_);
      return squared_;
    }
    measure();
    std::vector<std::uint32_t> all(spans_.size());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = static_cast<std::uint32_t>(i);
    transform<0>(all, squared_.data());
    return squared_;
  }

 private:
  static constexpr auto kAxes = static_cast<std::size_t>(D);
  static constexpr std::size_t kLanes = 16;      // Points that loops look at together.
  static constexpr std::size_t kMostRows = 512;  // Of slabs, that wait for the next axis.
  using Lanes = std::array<float, kLanes>;

  struct Axis {
    std::vector<double> points;
    std::vector<double> borders;         // Of slabs: one more than there are slabs.
    std::vector<float> squared;          // From each point to each slab.
    std::vector<std::uint32_t> slab_of;  // Of each point, or the nearest.
    // Along the last axis, instead: from each border, for each point above and below it, 0 on the other side.
    std::vector<float> above;
    std::vector<float> below;
    // While an axis is transformed.
    std::vector<std::uint32_t> order;      // Boxes, by their first slab.
    std::vector<std::uint32_t> starts;     // Of each slab, where its boxes begin in the order.
    std::vector<std::uint32_t> active;     // Boxes that a slab cuts.
    std::vector<std::uint32_t> row_slabs;  // Slabs that have any,
    std::vector<float> rows;               // and what is nearest in each, for points on the axes after this.
    std::vector<float> column;
    std::vector<std::uint32_t> column_slabs;

    [[nodiscard]] std::size_t slabs() const { return borders.size() - 1; }
  };
  /// The slabs of a box: [first, last) on each axis.
  struct Span {
    std::array<std::uint32_t, kAxes> first;
    std::array<std::uint32_t, kAxes> last;
  };

  [[nodiscard]] static std::size_t padded(std::size_t n) { return (n + kLanes - 1) / kLanes * kLanes; }

  /// Finds all slabs, and those of each box that matters.
  void cut(const std::vector<Box<D>>& boxes) {
    spans_.clear();
    inside_.clear();
    const auto nearest = static_cast<double>(limit_) * (1.0 + 1e-6);
    for (Numbers& numbers : numbers_) numbers.clear();
    for (const Box<D>& box : boxes) {
      pace_.spend(4);
      const Box<D> part{box.lower.cwiseMax(reach_.lower), box.upper.cwiseMin(reach_.upper)};
      if (!(part.lower.array() < part.upper.array()).all() || points_.squared_distance(part) > nearest)
        continue;
      inside_.push_back(part);
      for (std::size_t a = 0; a < kAxes; ++a) {
        numbers_[a].add(part.lower[static_cast<int>(a)]);
        numbers_[a].add(part.upper[static_cast<int>(a)]);
      }
    }
    for (std::size_t a = 0; a < kAxes; ++a) axes_[a].borders = numbers_[a].sorted();
    spans_.resize(inside_.size());
    for (std::size_t i = 0; i < inside_.size(); ++i)
      for (std::size_t a = 0; a < kAxes; ++a) {
        spans_[i].first[a] = numbers_[a].of(inside_[i].lower[static_cast<int>(a)]);
        spans_[i].last[a] = numbers_[a].of(inside_[i].upper[static_cast<int>(a)]);
      }
  }

  /// All distances along one axis.
  void measure() {
    const auto square = [](double x) { return static_cast<float>(x * x); };
    for (std::size_t a = 0; a < kAxes; ++a) {
      Axis& axis = axes_[a];
      const std::size_t n = axis.points.size();
      if (a + 1 < kAxes) {
        axis.squared.resize(n * axis.slabs());
        axis.slab_of.resize(n);
        for (std::size_t p = 0; p < n; ++p) {
          const double at = axis.points[p];
          for (std::size_t c = 0; c < axis.slabs(); ++c)
            axis.squared[p * axis.slabs() + c] =
                square(std::max({axis.borders[c] - at, at - axis.borders[c + 1], 0.0}));
          const auto not_below = std::lower_bound(axis.borders.begin(), axis.borders.end(), at);
          const auto slab = std::max<std::ptrdiff_t>(not_below - axis.borders.begin() - 1, 0);
          axis.slab_of[p] =
              static_cast<std::uint32_t>(std::min(static_cast<std::size_t>(slab), axis.slabs() - 1));
        }
      } else {
        axis.above.assign(axis.borders.size() * padded(n), 0.0f);
        axis.below.assign(axis.borders.size() * padded(n), 0.0f);
        for (std::size_t e = 0; e < axis.borders.size(); ++e)
          for (std::size_t p = 0; p < n; ++p) {
            const double distance = axis.points[p] - axis.borders[e];
            (distance < 0.0 ? axis.below : axis.above)[e * padded(n) + p] = square(distance);
          }
        bits_.resize(axis.slabs() / 64 + 1);
      }
    }
  }

  template <std::size_t A>
  void transform(const std::vector<std::uint32_t>& boxes, float* out) {
    if constexpr (A + 1 == kAxes) {
      along_row(boxes, out);
    } else {
      Axis& axis = axes_[A];
      axis.starts.assign(axis.slabs() + 1, 0);
      for (const std::uint32_t i : boxes) ++axis.starts[spans_[i].first[A] + 1];
      for (std::size_t c = 0; c < axis.slabs(); ++c) axis.starts[c + 1] += axis.starts[c];
      axis.order.resize(boxes.size());
      for (const std::uint32_t i : boxes) axis.order[axis.starts[spans_[i].first[A]]++] = i;
      axis.active.clear();
      axis.row_slabs.clear();
      std::fill_n(out, axis.points.size() * below_[A], limit_);
      const std::size_t row = padded(below_[A]);
      std::size_t next = 0;
      for (std::uint32_t c = 0; c < axis.slabs(); ++c) {
        axis.active.erase(std::remove_if(axis.active.begin(), axis.active.end(),
                                         [&](std::uint32_t i) { return spans_[i].last[A] <= c; }),
                          axis.active.end());
        for (; next < axis.starts[c]; ++next) axis.active.push_back(axis.order[next]);
        if (axis.active.empty()) continue;
        pace_.spend(axis.active.size() + 4);
        const std::size_t at = axis.row_slabs.size() * row;
        axis.row_slabs.push_back(c);
        if (axis.rows.size() < at + row) axis.rows.resize(std::max(at + row, 2 * axis.rows.size()));
        std::fill(axis.rows.begin() + static_cast<std::ptrdiff_t>(at + below_[A]),
                  axis.rows.begin() + static_cast<std::ptrdiff_t>(at + row), limit_);
        transform<A + 1>(axis.active, axis.rows.data() + at);
        if (axis.row_slabs.size() < kMostRows) continue;
        combine(axis, below_[A], out);
        axis.row_slabs.clear();
      }
      combine(axis, below_[A], out);
    }
  }

  /// The last axis: between runs of slabs that boxes fill.
  void along_row(const std::vector<std::uint32_t>& boxes, float* out) {
    const Axis& axis = axes_[kAxes - 1];
    std::fill(bits_.begin(), bits_.end(), std::uint64_t{0});
    for (const std::uint32_t i : boxes)
      for (std::uint32_t c = spans_[i].first[kAxes - 1]; c < spans_[i].last[kAxes - 1];) {
        const std::uint32_t end = std::min((c / 64 + 1) * 64, spans_[i].last[kAxes - 1]);
        bits_[c / 64] |= (~std::uint64_t{0} >> (64 - (end - c))) << c % 64;
        c = end;
      }
    runs_.clear();
    const auto slabs = static_cast<std::uint32_t>(axis.slabs());
    for (std::uint32_t c = next_bit(0, true, slabs); c < slabs;) {
      const std::uint32_t end = next_bit(c, false, slabs);
      runs_.emplace_back(c, end);
      c = next_bit(end, true, slabs);
    }
    const std::size_t n = axis.points.size();
    for (std::size_t p = 0; p < n; p += kLanes) {
      Lanes best;
      best.fill(limit_);
      for (const auto& [first, last] : runs_) {
        const float* const before = axis.below.data() + first * padded(n) + p;
        const float* const after = axis.above.data() + last * padded(n) + p;
        for (std::size_t k = 0; k < kLanes; ++k) {
          const float squared = before[k] + after[k];  // One of them is 0.
          best[k] = squared < best[k] ? squared : best[k];
        }
      }
      std::copy_n(best.begin(), std::min(kLanes, n - p), out + p);
    }
  }
  /// From a slab on, the next one that is set, or not.
  [[nodiscard]] std::uint32_t next_bit(std::uint32_t c, bool is_set, std::uint32_t end) const {
    while (c < end) {
      std::uint64_t word = bits_[c / 64];
      if (!is_set) word = ~word;
      word >>= c % 64;
      if (word != 0) {
        while ((word & 0xffu) == 0) word >>= 8, c += 8;
        while ((word & 1u) == 0) word >>= 1, ++c;
        return std::min(c, end);
      }
      c = (c / 64 + 1) * 64;
    }
    return end;
  }

  /// Of each point along an axis, and each that follows it, the least of what it has, and over all rows of
  /// what is in the row and the distance to it: from the nearest row on, until none can be nearer.
  void combine(Axis& axis, std::size_t below, float* out) {
    const std::size_t row = padded(below);
    axis.column.resize(axis.row_slabs.size() * kLanes);
    axis.column_slabs.resize(axis.row_slabs.size());
    for (std::size_t first = 0; first < below; first += kLanes) {
      std::size_t n = 0;
      for (std::size_t r = 0; r < axis.row_slabs.size(); ++r) {
        const float* const from = axis.rows.data() + r * row + first;
        float* const to = axis.column.data() + n * kLanes;
        unsigned near = 0;
        for (std::size_t k = 0; k < kLanes; ++k) {
          to[k] = from[k];
          near |= static_cast<unsigned>(from[k] < limit_);
        }
        axis.column_slabs[n] = axis.row_slabs[r];
        n += near;
      }
      pace_.spend(axis.points.size() * 4 + axis.row_slabs.size());
      std::size_t start = 0;
      for (std::size_t p = 0; p < axis.points.size(); ++p) {
        while (start < n && axis.column_slabs[start] < axis.slab_of[p]) ++start;
        const std::size_t width = std::min(kLanes, below - first);
        float* const to = out + p * below + first;
        alignas(32) Lanes best{};  // Where there is no point, nothing is nearer.
        std::copy_n(to, width, best.begin());
        const float* const squared = axis.squared.data() + p * axis.slabs();
#ifdef NDTREE_HAS_EIGHTS
        if (by_eights_)
          add_rows_by_eights(squared, axis.column_slabs.data(), axis.column.data(), start, n, best);
        else
#endif
          add_rows(squared, axis.column_slabs.data(), axis.column.data(), start, n, best);
        std::copy_n(best.begin(), width, to);
      }
    }
  }

  /// @param squared distance to each slab. @param slabs, column of n rows, and what is nearest in each.
  /// @param start the first row that is not below the point's slab.
  static void add_rows(const float* squared, const std::uint32_t* slabs, const float* column,
                       std::size_t start, std::size_t n, Lanes& best) {
    const auto add = [&](std::size_t r) {
      const float distance = squared[slabs[r]];
      unsigned farther = 0;
      for (std::size_t k = 0; k < kLanes; ++k) farther |= static_cast<unsigned>(best[k] > distance);
      if (farther == 0) return false;
      for (std::size_t k = 0; k < kLanes; ++k) {
        const float sum = column[r * kLanes + k] + distance;
        best[k] = sum < best[k] ? sum : best[k];
      }
      return true;
    };
    std::size_t up = start;
    std::size_t down = start;
    while (up < n || down > 0) {
      if (up < n) up = add(up) ? up + 1 : n;
      if (down > 0) down = add(down - 1) ? down - 1 : 0;
    }
  }
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS static void add_rows_by_eights(const float* squared, const std::uint32_t* slabs,
                                                  const float* column, std::size_t start, std::size_t n,
                                                  Lanes& best) {
    static_assert(kLanes == 16);
    EightFloats low = EightFloats::load(best.data());
    EightFloats high = EightFloats::load(best.data() + 8);
    std::size_t up = start;
    std::size_t down = start;
    while (up < n || down > 0) {
      for (const bool is_up : {true, false}) {
        if (is_up ? up >= n : down == 0) continue;
        const std::size_t r = is_up ? up : down - 1;
        const EightFloats distance = squared[slabs[r]];
        const bool matters = ((low > distance) | (high > distance)).set() != 0;
        if (is_up)
          up = matters ? up + 1 : n;
        else
          down = matters ? down - 1 : 0;
        if (!matters) continue;
        low = min_of(EightFloats::load(column + r * kLanes) + distance, low);
        high = min_of(EightFloats::load(column + r * kLanes + 8) + distance, high);
      }
    }
    low.store(best.data());
    high.store(best.data() + 8);
  }
#endif

  /// Numbers for the borders of slabs, in order.
  class Numbers {
   public:
    void clear() {
      entries_.assign(64, {});
      borders_.clear();
    }
    void add(double border) {
      Entry& entry = find(border);
      if (entry.number != 0) return;
      entry = {border, 1};
      borders_.push_back(border);
      if (2 * borders_.size() < entries_.size()) return;
      entries_.assign(2 * entries_.size(), {});
      for (const double known : borders_) find(known) = {known, 1};
    }
    /// Sorts them and gives them their numbers.
    [[nodiscard]] const std::vector<double>& sorted() {
      std::sort(borders_.begin(), borders_.end());
      for (std::size_t i = 0; i < borders_.size(); ++i)
        find(borders_[i]).number = static_cast<std::uint32_t>(i + 1);
      return borders_;
    }
    [[nodiscard]] std::uint32_t of(double border) { return find(border).number - 1; }

   private:
    struct Entry {
      double border = 0.0;
      std::uint32_t number = 0;  // From 1 on; 0: none.
    };
    [[nodiscard]] Entry& find(double border) {
      std::uint64_t bits;
      border += 0.0;  // -0 is 0.
      std::memcpy(&bits, &border, sizeof bits);
      std::size_t at = (bits * 0x9e3779b97f4a7c15u) >> 32;
      for (;; ++at) {
        Entry& entry = entries_[at & (entries_.size() - 1)];
        if (entry.number == 0 || entry.border == border) return entry;
      }
    }
    std::vector<Entry> entries_;
    std::vector<double> borders_;
  };

  float limit_;
  Box<D> points_;
  Box<D> reach_;
  std::array<Axis, kAxes> axes_;
  std::array<std::size_t, kAxes> below_;  // Points of the axes after each.
  std::array<Numbers, kAxes> numbers_;
  bool by_eights_ = Simd::width() >= 8;
  std::vector<Box<D>> inside_;
  std::vector<Span> spans_;
  std::vector<std::uint64_t> bits_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> runs_;
  std::vector<float> squared_;
  Pace& pace_;
};

}  // namespace ndtree::detail
