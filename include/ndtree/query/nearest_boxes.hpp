// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The nearest of many boxes, for all points of a grid at once.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

/// The centres of equal cells that fill a box.
template <int D>
class FieldGrid {
 public:
  using Shape = std::array<std::size_t, std::size_t{D}>;

  /// @param lower corner of the grid. @param shape cells on each axis.
  FieldGrid(const Vector<D>& lower, double cell_size, const Shape& shape)
      : lower_(lower), cell_size_(cell_size), shape_(shape) {}

  [[nodiscard]] const Vector<D>& lower() const { return lower_; }
  [[nodiscard]] double cell_size() const { return cell_size_; }
  [[nodiscard]] const Shape& shape() const { return shape_; }
  /// Cells in all.
  [[nodiscard]] std::size_t size() const {
    std::size_t n = 1;
    for (const std::size_t count : shape_) n *= count;
    return n;
  }
  /// Around all cells.
  [[nodiscard]] Box<D> box() const {
    Box<D> box{lower_, lower_};
    for (std::size_t a = 0; a < D; ++a)
      box.upper[static_cast<int>(a)] += static_cast<double>(shape_[a]) * cell_size_;
    return box;
  }
  /// Coordinate of the centre of the i-th cell along an axis [m].
  [[nodiscard]] double center(std::size_t axis, std::size_t i) const {
    return lower_[static_cast<int>(axis)] + (static_cast<double>(i) + 0.5) * cell_size_;
  }
  /// Along an axis, the first cell whose centre is not below a coordinate; one more than there are for none.
  [[nodiscard]] std::size_t first_not_below(std::size_t axis, double coordinate) const {
    const double place = (coordinate - lower_[static_cast<int>(axis)]) / cell_size_ - 0.5;
    auto i = static_cast<std::size_t>(std::clamp(std::floor(place), 0.0, static_cast<double>(shape_[axis])));
    while (i < shape_[axis] && center(axis, i) < coordinate) ++i;
    return i;
  }
  /// Where a cell is in the order of a C array: the last axis varies fastest.
  [[nodiscard]] std::size_t index(const Shape& cell) const {
    std::size_t at = 0;
    for (std::size_t a = 0; a < D; ++a) at = at * shape_[a] + cell[a];
    return at;
  }

 private:
  Vector<D> lower_;
  double cell_size_;
  Shape shape_;
};

/// Points of a grid, from the first to before the last on each axis.
template <int D>
struct GridBlock {
  typename FieldGrid<D>::Shape first{};
  typename FieldGrid<D>::Shape last{};

  [[nodiscard]] bool empty() const {
    for (std::size_t a = 0; a < D; ++a)
      if (first[a] >= last[a]) return true;
    return false;
  }
};

namespace detail {

/// Whether something holds for some place of a block, which is not empty: from the first to before the last
/// on each axis, of which the last varies fastest.
template <class Shape, class Holds>
bool any_place(const Shape& first, const Shape& last, const Holds& holds) {
  Shape at = first;
  for (;;) {
    if (holds(at)) return true;
    std::size_t a = at.size();
    for (; a > 0 && ++at[a - 1] == last[a - 1]; --a) at[a - 1] = first[a - 1];
    if (a == 0) return false;
  }
}

/// Distances from all points of a grid to the nearest of many boxes. Blocks of points are halved, each with
/// those boxes and groups of boxes of which one may be the nearest to one of its points: a group goes as soon
/// as something is surely nearer to all of them. What is left for a block of some dozens of points is looked
/// at one by one.
template <int D>
class NearestBoxes {
 public:
  using Shape = typename FieldGrid<D>::Shape;

  NearestBoxes(const FieldGrid<D>& grid, BoxTree<D> boxes, double max_distance)
      : grid_(grid), boxes_(std::move(boxes)), limit_(max_distance * max_distance) {}

  /// Calls `visit(index, squared_distance)` for each point that is asked for, and some beside it; with
  /// infinity where nothing is at most max_distance away.
  /// @param all the points that may be asked for. @param wants says of a block, by its first point and the
  /// one after its last on each axis, and of the box
  ///   around its points, whether any of them is asked for. @param done(box) when a small block has been
  ///   visited.
  template <class Wants, class Visit, class Done>
  void run(const GridBlock<D>& all, const Wants& wants, const Visit& visit, const Done& done) const {
    if (all.empty()) return;
    Pace pace;
    std::vector<Candidate> candidates;
    if (!boxes_.empty()) candidates.push_back({0, kNotOne});
    halve(all, candidates, wants, visit, done, pace);
  }

 private:
  static constexpr std::uint32_t kNotOne = 0xffffffffu;
  static constexpr std::size_t kSide = D == 2 ? 8 : 4;  // Of the smallest blocks, in points.

  using Block = GridBlock<D>;
  /// A node of the tree of boxes, or one box.
  struct Candidate {
    std::uint32_t node;
    std::uint32_t box;
  };

  /// Around the points.
  [[nodiscard]] Box<D> box_of(const Block& block) const {
    Box<D> box;
    for (std::size_t a = 0; a < D; ++a) {
      box.lower[static_cast<int>(a)] = grid_.center(a, block.first[a]);
      box.upper[static_cast<int>(a)] = grid_.center(a, block.last[a] - 1);
    }
    return box;
  }
  [[nodiscard]] const Box<D>& bounds(const Candidate& candidate) const {
    return candidate.box == kNotOne ? boxes_.nodes()[candidate.node].bounds : boxes_.box(candidate.box);
  }
  /// From each point something of the candidate is at most so far away.
  [[nodiscard]] double most(const Box<D>& points, const Candidate& candidate) const {
    const Box<D>& box = bounds(candidate);
    if (candidate.box != kNotOne)
      return (box.lower - points.lower).cwiseMax(points.upper - box.upper).cwiseMax(0.0).squaredNorm();
    return (box.upper - points.lower).cwiseMax(points.upper - box.lower).squaredNorm();
  }

  template <class Wants, class Visit, class Done>
  void halve(const Block& block, const std::vector<Candidate>& above, const Wants& wants, const Visit& visit,
             const Done& done, Pace& pace) const {
    const Box<D> points = box_of(block);
    if (!wants(block.first, block.last, points)) return;
    std::size_t longest = 0;
    for (std::size_t a = 1; a < D; ++a)
      if (block.last[a] - block.first[a] > block.last[longest] - block.first[longest]) longest = a;
    const bool is_small = block.last[longest] - block.first[longest] <= kSide;
    const double extent = is_small ? -1.0 : (points.upper - points.lower).maxCoeff();

    double nearest = limit_;
    for (const Candidate& candidate : above) nearest = std::min(nearest, most(points, candidate));
    std::vector<Candidate> candidates;
    std::vector<Candidate> open = above;
    while (!open.empty()) {
      const Candidate candidate = open.back();
      open.pop_back();
      pace.spend();
      const Box<D>& box = bounds(candidate);
      if (points.squared_distance(box) > nearest) continue;
      if (candidate.box != kNotOne || (box.upper - box.lower).maxCoeff() <= extent) {
        candidates.push_back(candidate);
        continue;
      }
      const auto add = [&](const Candidate& part) {
        nearest = std::min(nearest, most(points, part));
        open.push_back(part);
      };
      const auto& node = boxes_.nodes()[candidate.node];
      if (node.is_leaf()) {
        for (std::uint32_t i = node.first; i < node.last; ++i) add({0, i});
      } else {
        add({candidate.node + 1, kNotOne});
        add({node.second, kNotOne});
      }
    }
    candidates.erase(
        std::remove_if(candidates.begin(), candidates.end(),
                       [&](const Candidate& c) { return points.squared_distance(bounds(c)) > nearest; }),
        candidates.end());
    if (candidates.empty() && !is_small) {
      any_place(block.first, block.last, [&](const Shape& at) {
        visit(grid_.index(at), std::numeric_limits<double>::infinity());
        return false;
      });
      return;
    }
    if (is_small) {
      pace.spend(candidates.size() * static_cast<std::size_t>(integer_power(kSide, D)));
      look_at_all(block, candidates, visit);
      done(points);
      return;
    }
    Block half = block;
    half.last[longest] = block.first[longest] + (block.last[longest] - block.first[longest]) / 2;
    halve(half, candidates, wants, visit, done, pace);
    half.first[longest] = half.last[longest];
    half.last[longest] = block.last[longest];
    halve(half, candidates, wants, visit, done, pace);
  }

  template <class Visit>
  void look_at_all(const Block& block, const std::vector<Candidate>& candidates, const Visit& visit) const {
    constexpr auto kPoints = static_cast<std::size_t>(integer_power(kSide, D));
    std::array<double, kPoints> squared;
    squared.fill(std::numeric_limits<double>::infinity());
    for (const Candidate& candidate : candidates) {
      const Box<D>& box = boxes_.box(candidate.box);
      std::array<std::array<double, kSide>, std::size_t{D}> across{};  // Squared distance on each axis alone.
      for (std::size_t a = 0; a < D; ++a)
        for (std::size_t i = 0; i < block.last[a] - block.first[a]; ++i) {
          const double at = grid_.center(a, block.first[a] + i);
          const double d =
              std::max({box.lower[static_cast<int>(a)] - at, at - box.upper[static_cast<int>(a)], 0.0});
          across[a][i] = d * d;
        }
      add_up<0>(across, 0.0, 0, squared);
    }
    any_place(block.first, block.last, [&](const Shape& at) {
      std::size_t in_block = 0;
      for (std::size_t a = 0; a < D; ++a) in_block = in_block * kSide + (at[a] - block.first[a]);
      const double to_nearest = squared[in_block];
      visit(grid_.index(at), to_nearest <= limit_ ? to_nearest : std::numeric_limits<double>::infinity());
      return false;
    });
  }
  template <std::size_t A, class Across, class Squared>
  static void add_up(const Across& across, double sum, std::size_t at, Squared& squared) {
    for (std::size_t i = 0; i < kSide; ++i) {
      if constexpr (A + 1 < D)
        add_up<A + 1>(across, sum + across[A][i], (at + i) * kSide, squared);
      else
        squared[at + i] = std::min(squared[at + i], sum + across[A][i]);
    }
  }

  const FieldGrid<D>& grid_;
  BoxTree<D> boxes_;
  double limit_;
};

}  // namespace detail

}  // namespace ndtree
