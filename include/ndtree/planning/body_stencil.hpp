// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A body on the lattice of smallest cells: which of them it may touch while it stands in one.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree::detail {

/// Which cells a body touches: from some place in its own cell, from each, or from its centre.
enum class Touches { from_some, from_each, from_centre };

/// A body that stands anywhere in a smallest cell touches only cells at these offsets from it. Wherever in
/// the closed cell it stands, it is free exactly if none of them has an obstacle. They depend on nothing but
/// the body, as all obstacles are made of whole cells. Bodies are convex, or unions of convex parts, so
/// offsets are runs along the first axis. Or only the offsets of cells that it touches wherever in its cell
/// it stands: if one of them has an obstacle, it is free nowhere there. Or those from the centre of its cell.
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
  BodyStencil(const Body<D>& body, double unit, Touches touches = Touches::from_some) : touches_(touches) {
    for (std::size_t a = 0; a < kAxes; ++a) lower_[a] = upper_[a] = 0;
    for (const BodyPart<D>& part : body) add(part, unit);
    const auto row = [&](const Run& run) { return row_of(run.at[1], run.at[kAxes - 1]); };
    std::sort(runs_.begin(), runs_.end(), [&](const Run& a, const Run& b) { return row(a) < row(b); });
    firsts_.assign(row_of(upper_[1], upper_[kAxes - 1]) + 2, 0);
    for (const Run& run : runs_) ++firsts_[row(run) + 1];
    std::partial_sum(firsts_.begin(), firsts_.end(), firsts_.begin());
  }

  /// Calls `visit(run)` for those at offsets first..last on axis 1; in space, at `plane` on the last axis.
  template <class Visit>
  void for_each_run(int first, int last, int plane, const Visit& visit) const {
    first = std::max(first, lower_[1]);
    last = std::min(last, upper_[1]);
    if (first > last || (D > 2 && (plane < lower_[kAxes - 1] || plane > upper_[kAxes - 1]))) return;
    const std::size_t end = firsts_[row_of(last, plane) + 1];
    for (std::size_t i = firsts_[row_of(first, plane)]; i < end; ++i) visit(runs_[i]);
  }
  [[nodiscard]] const std::vector<Span>& spans() const { return spans_; }
  /// The least and the greatest offset on each axis.
  [[nodiscard]] const std::array<int, std::size_t{D}>& lower() const { return lower_; }
  [[nodiscard]] const std::array<int, std::size_t{D}>& upper() const { return upper_; }

 private:
  static constexpr auto kAxes = static_cast<std::size_t>(D);

  /// By their offsets, that on axis 1 the fastest.
  [[nodiscard]] std::size_t row_of(int at, int plane) const {
    const int planes_before = D == 2 ? 0 : plane - lower_[kAxes - 1];
    return static_cast<std::size_t>(planes_before * (upper_[1] - lower_[1] + 1) + at - lower_[1]);
  }

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
  /// @param half the cell's size, and that of the places in which the body may stand, around its middle.
  static bool is_met(const BodyPart<D>& part, double unit, const std::array<int, kAxes>& at, double half) {
    Box<D> box;
    for (int a = 0; a < D; ++a) {
      box.lower[a] = (at[static_cast<std::size_t>(a)] - half) * unit;
      box.upper[a] = (at[static_cast<std::size_t>(a)] + half) * unit;
    }
    return touch(part, box);
  }
  /// The distance of two convex sets is convex in where one of them stands: it is greatest at a corner.
  static bool is_met_from_each(const BodyPart<D>& part, double unit, const std::array<int, kAxes>& at) {
    for (unsigned corner = 0; corner < 1u << D; ++corner) {
      Box<D> box;
      for (int a = 0; a < D; ++a) {
        box.lower[a] = (at[static_cast<std::size_t>(a)] - static_cast<int>(corner >> a & 1u)) * unit;
        box.upper[a] = box.lower[a] + unit;
      }
      if (!touch(part, box)) return false;
    }
    return true;
  }
  void add_run(const BodyPart<D>& part, double unit, std::array<int, kAxes> at, int first, int last) {
    const auto is_met_at = [&](int x) {
      at[0] = x;
      return touches_ == Touches::from_each
                 ? is_met_from_each(part, unit, at)
                 : is_met(part, unit, at, touches_ == Touches::from_some ? 1.0 : 0.5);
    };
    while (first <= last && !is_met_at(first)) ++first;
    while (first <= last && !is_met_at(last)) --last;
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

  Touches touches_;
  std::vector<Run> runs_;
  std::vector<std::size_t> firsts_;  // The first run of each row_of().
  std::vector<Span> spans_;
  std::array<int, kAxes> lower_;
  std::array<int, kAxes> upper_;
};

}  // namespace ndtree::detail
