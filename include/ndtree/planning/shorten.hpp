// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A path is made shorter as long as it pays.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree::detail {

/// Pulls a path tight: points that are not needed go, and corners are cut, by chords as long as they may be.
/// Each new segment is asked for, so the result is as free as the segments that it began with. What it finds
/// is nearly the shortest path that the first one can be pulled to; it finds no other way around an
/// obstacle.
/// @tparam Cost cost(a, b) of a segment, infinite if it is not free; never less than its length.
template <int D, class Cost>
class PathShortener {
 public:
  explicit PathShortener(const Cost& cost) : cost_(cost) {}

  void shorten(std::vector<Vector<D>>& points) {
    skip(points);
    double before = total(points);
    for (int round = 0; round < kMostRounds && points.size() > 2; ++round) {
      cut(points);
      skip(points);
      const double now = total(points);
      if (!(now < before * (1.0 - kWorthwhile))) break;
      before = now;
    }
  }

 private:
  static constexpr int kMostRounds = 16;
  static constexpr double kWorthwhile = 2e-4;  // A round that gains less, of the length, is the last one.

  [[nodiscard]] double total(const std::vector<Vector<D>>& points) const {
    double sum = 0.0;
    for (std::size_t i = 0; i + 1 < points.size(); ++i) sum += (points[i + 1] - points[i]).norm();
    return sum;
  }
  /// From each point to the farthest of the next ones that it costs no more to go to at once.
  void skip(std::vector<Vector<D>>& points) {
    std::vector<Vector<D>> kept{points.front()};
    for (std::size_t i = 0; i + 1 < points.size();) {
      std::size_t next = i + 1;
      double through = 0.0;
      const auto add = [&] {  // What is free is shorter, where all costs the same.
        through = cost_.is_uniform() ? std::numeric_limits<double>::max()
                                     : through + (1.0 + 1e-9) * cost_(points[next - 1], points[next]);
      };
      for (add(); next + 1 < points.size();) {
        pace_.spend(200);
        ++next;
        add();
        if (cost_(points[i], points[next]) <= through) continue;
        --next;
        break;
      }
      kept.push_back(points[next]);
      i = next;
    }
    points = std::move(kept);
  }
  void cut(std::vector<Vector<D>>& points) {
    std::vector<Vector<D>> result{points.front()};
    const double least = kWorthwhile * total(points) / static_cast<double>(points.size());
    for (std::size_t i = 1; i + 1 < points.size(); ++i) {
      const Vector<D> a = result.back();
      const Vector<D>& b = points[i];
      const Vector<D>& c = points[i + 1];
      const double gain = (a - b).norm() + (b - c).norm() - (a - c).norm();
      bool is_cut = false;
      for (double part = 0.5; part * gain > least && part > 0.01; part *= 0.5) {
        pace_.spend(200);
        const Vector<D> first = b + part * (a - b);
        const Vector<D> second = b + part * (c - b);
        const double before =
            cost_.is_uniform() ? std::numeric_limits<double>::max() : cost_(first, b) + cost_(b, second);
        if (!(cost_(first, second) < before)) continue;
        result.push_back(first);
        result.push_back(second);
        is_cut = true;
        break;
      }
      if (!is_cut) result.push_back(b);
    }
    result.push_back(points.back());
    points = std::move(result);
  }

  const Cost& cost_;
  Pace pace_;
};

}  // namespace ndtree::detail
