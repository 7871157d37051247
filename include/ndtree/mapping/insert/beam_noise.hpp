// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The noise of a scan's beams, and how far before its end a beam has surely passed all cells.
#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/unfused.hpp"

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

}  // namespace ndtree
