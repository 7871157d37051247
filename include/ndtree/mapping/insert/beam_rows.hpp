// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The noise of a scan's beams, and how far before its end a beam has surely passed all cells; the two table
/// rows of a beam, and the rows of eight beams in vectors.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// A beam clearly passes every cell that it leaves before t_free = t_max - fixed - growth * t_max^2: a
/// margin fitted to the noise of near and far beams, that holds for any noise, as `fixed` is the largest that
/// a beam needs.
struct FreeMargin {
  float fixed = 0.0f;   ///< [m]
  float growth = 0.0f;  ///< [1 / m]
};

/// The least and the largest noise of a set of beams, and the least margin that holds for each of them.
///
/// Strategy: a running minimum and maxima, eight of each, so that loops over eight beams need no reduction.
/// Invariants: the result depends neither on the order of the beams nor on the width.
/// Cost: O(1) for each beam.
class BeamNoise {
 public:
  explicit BeamNoise(float margin_growth = 0.0f) : growth_(margin_growth) {
    smallest_.fill(std::numeric_limits<float>::infinity());
    largest_.fill(0.0f);
    margin_.fill(0.0f);
  }
  /// Adds one beam, or eight. @param sigma standard deviation of the range. @param t_max where its evidence
  /// ends. @param t_free it clearly passes every cell that it leaves before this distance. All in [m].
  template <class Floats>
  NDTREE_ALWAYS_INLINE void add(const Floats& sigma, const Floats& t_max, const Floats& t_free) {
    Floats smallest, largest, margin;
    load_from(smallest, smallest_.data());
    load_from(largest, largest_.data());
    load_from(margin, margin_.data());
    store_to(min_of(smallest, sigma), smallest_.data());
    store_to(max_of(largest, sigma), largest_.data());
    store_to(max_of(margin, margin_of(t_max, t_free)), margin_.data());
  }
  /// Adds the beams of another set. @pre both have the same growth.
  void add(const BeamNoise& other) {
    smallest_[0] = std::min(smallest_[0], other.smallest());
    largest_[0] = std::max(largest_[0], other.largest());
    margin_[0] = std::max(margin_[0], other.margin().fixed);
  }
  /// The smallest standard deviation [m].
  [[nodiscard]] float smallest() const { return *std::min_element(smallest_.begin(), smallest_.end()); }
  /// The largest standard deviation [m].
  [[nodiscard]] float largest() const { return *std::max_element(largest_.begin(), largest_.end()); }
  /// The least margin of this growth that holds for every beam.
  [[nodiscard]] FreeMargin margin() const {
    return {*std::max_element(margin_.begin(), margin_.end()), growth_};
  }

 private:
  static constexpr float kAboveRounding = 1.0f + 0x1p-21f;
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats margin_of(const Floats& t_max, const Floats& t_free) const {
    return unfused(t_max * kAboveRounding) - t_free - unfused(unfused(growth_ * t_max) * t_max);
  }
  float growth_;
  // Element k is of every eighth beam; width 1 uses element 0 alone.
  alignas(32) std::array<float, 8> smallest_;
  alignas(32) std::array<float, 8> largest_;
  alignas(32) std::array<float, 8> margin_;
};

/// The row that partitioning a list reads: a beam's inverse direction and t_max. 16 bytes up to 3-D.
template <int D>
struct alignas(16) BeamRay {
  /// Range over displacement on each axis: metres along the beam for one metre along the axis.
  std::array<float, std::size_t{D}> inverse;
  float t_max;  ///< The distance at which its evidence ends [m].
};

/// The row that leaves near a beam's end read; distances are along the beam [m]. A row of 32 bytes lies in
/// one cache line.
///
/// A cell that the beam leaves before clearly_free_until, see BeamSensorModel, is clearly free: the beam is a
/// miss of it, and no more. The exit of a cell that is small beside the noise counts as at least `surface`
/// behind its entry. So cells of any size are clearly free that the beam leaves before t_free =
/// clearly_free_until - surface: it clearly passes them.
template <int D>
struct alignas(D <= 3 ? 32 : 16) BeamEnd {
  float range;               ///< Of the end point, or t_free of a beam without return.
  float slant;               ///< Depth over range, in [1 / sqrt D, 1].
  float clearly_free_until;  ///< See above.
  float surface;  ///< Its way through a small cell counts as at least this long. 0: without return.
  float sigma;    ///< Standard deviation of the range.
  /// Smallest cell of its end minus the base, see ScanBeams::ends_fit_32_bits().
  std::array<std::int32_t, std::size_t{D}> cell;

  [[nodiscard]] bool is_returned() const { return surface != 0.0f; }
};

#ifdef NDTREE_HAS_EIGHTS
/// The columns of eight BeamRay rows.
template <int D>
struct EightRays {
  EightFloats inverse[std::size_t{D}];
  EightFloats t_max;
};
/// The columns of eight BeamEnd rows.
template <int D>
struct EightEnds {
  EightFloats range, slant, clearly_free_until, surface, sigma;
  EightInts cell[std::size_t{D}];
};

/// A ray packet: up to eight beams that go down the tree together. Their rows are read once, at its start.
template <int D>
struct EightBeams {
  /// Ascending; elements without a beam hold any valid number.
  alignas(32) std::array<std::uint32_t, 8> number;
  EightRays<D> rays;
  EightFloats t_free;  ///< See ScanBeams::t_free_of().
  EightEnds<D> ends;   ///< Valid if has_ends; ScanBeams::ends_of() reads them.
  bool has_ends = false;
};
#endif

}  // namespace ndtree
