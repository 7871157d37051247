// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A body on the lattice of smallest cells: which of them it may touch while it stands in one.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree::detail {

/// A body that stands anywhere in a smallest cell touches only cells at these offsets from it. Wherever in
/// the closed cell it stands, it is free exactly if none of them has an obstacle. They depend on nothing but
/// the body, as all obstacles are made of whole cells. Bodies are convex, or unions of convex parts, so
/// offsets are runs along the first axis.
template <int D>
class BodyStencil {
 public:
  /// Offsets first..last along the first axis, at these on the others.
  struct Run {
    std::array<int, std::size_t{D}> at;  ///< That of axis 0 is 0.
    int span;                            ///< Number of {first, last} in spans().
  };
  using Span = std::pair<int, int>;

  /// @param body in its orientation, as much larger as it shall stay away from obstacles. @param unit [m].
  BodyStencil(const Body<D>& body, double unit) {
    for (std::size_t a = 0; a < kAxes; ++a) lower_[a] = upper_[a] = 0;
    for (const BodyPart<D>& part : body) add(part, unit);
  }

  [[nodiscard]] const std::vector<Run>& runs() const { return runs_; }
  [[nodiscard]] const std::vector<Span>& spans() const { return spans_; }
  /// The least and the greatest offset on each axis.
  [[nodiscard]] const std::array<int, std::size_t{D}>& lower() const { return lower_; }
  [[nodiscard]] const std::array<int, std::size_t{D}>& upper() const { return upper_; }

 private:
  static constexpr auto kAxes = static_cast<std::size_t>(D);

  void add(const BodyPart<D>& part, double unit) {
    const Box<D> bounds = bounds_of(part);
    std::array<int, kAxes> first, last;
    for (std::size_t a = 0; a < kAxes; ++a) {
      first[a] = static_cast<int>(std::floor(bounds.lower[static_cast<int>(a)] / unit)) - 1;
      last[a] = static_cast<int>(std::ceil(bounds.upper[static_cast<int>(a)] / unit)) + 1;
    }
    std::array<int, kAxes> at = first;
    for (bool goes_on = true; goes_on;) {
      add_run(part, unit, at, first[0], last[0]);
      goes_on = false;
      for (std::size_t a = 1; a < kAxes && !goes_on; ++a) {
        goes_on = ++at[a] <= last[a];
        if (!goes_on) at[a] = first[a];
      }
    }
  }
  void add_run(const BodyPart<D>& part, double unit, std::array<int, kAxes> at, int first, int last) {
    const auto is_met = [&](int x) {
      Box<D> box;  // The cell, less those in which the body may stand.
      for (int a = 0; a < D; ++a) {
        const int place = a == 0 ? x : at[static_cast<std::size_t>(a)];
        box.lower[a] = (place - 1) * unit;
        box.upper[a] = (place + 1) * unit;
      }
      return touch(part, box);
    };
    while (first <= last && !is_met(first)) ++first;
    while (first <= last && !is_met(last)) --last;
    if (first > last) return;
    const Span span{first, last};
    auto found = std::find(spans_.begin(), spans_.end(), span);
    if (found == spans_.end()) found = spans_.insert(spans_.end(), span);
    at[0] = 0;
    runs_.push_back({at, static_cast<int>(found - spans_.begin())});
    for (std::size_t a = 0; a < kAxes; ++a) {
      lower_[a] = std::min(lower_[a], a == 0 ? first : at[a]);
      upper_[a] = std::max(upper_[a], a == 0 ? last : at[a]);
    }
  }

  std::vector<Run> runs_;
  std::vector<Span> spans_;
  std::array<int, kAxes> lower_;
  std::array<int, kAxes> upper_;
};

}  // namespace ndtree::detail
