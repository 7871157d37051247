// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The best poses of a grid, found surely: branch and bound.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "ndtree/alignment/block_queue.hpp"
#include "ndtree/alignment/likelihood_pyramid.hpp"
#include "ndtree/alignment/likelihood_windows.hpp"
#include "ndtree/alignment/pose_grid.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// The cells of points at a pose of a grid, without its translation's steps.
template <int D>
[[nodiscard]] std::vector<typename LikelihoodPyramid<D>::Cell> cells_of(const LikelihoodPyramid<D>& pyramid,
                                                                        const Points<D>& points,
                                                                        const Pose<D>& guess,
                                                                        const PoseGrid<D>& grid,
                                                                        const GridPose<D>& rotation) {
  Motion<D> motion = grid.motion(rotation);
  motion.template head<D>().setZero();
  const Pose<D> pose = moved(guess, motion);
  std::vector<typename LikelihoodPyramid<D>::Cell> cells(static_cast<std::size_t>(points.cols()));
  for (Eigen::Index i = 0; i < points.cols(); ++i)
    cells[static_cast<std::size_t>(i)] = pyramid.cell_of(pose * points.col(i));
  return cells;
}

/// Finds the best poses of a grid.
///
/// Strategy: best first, over blocks of translations of each rotation. A block's bound is the sum of its
/// points' maxima over its translations, so no pose in it scores more, and the first pose that leaves the
/// queue is the grid's best. Maxima are looked up in the LikelihoodPyramid; a search of many poses makes
/// LikelihoodWindows first. Invariant, tested: it finds what trying all poses finds, bit for bit, whichever
/// is used. Cost: O(rotations · points), and what the bounds leave.
template <int D>
class PoseSearch {
 public:
  using Cell = typename LikelihoodPyramid<D>::Cell;

  static constexpr int kTop = 6;  ///< Highest level of the pyramid that is used: blocks of 64 steps.
  static constexpr double kMostSteps = 1e6;

  /// @param worth cells of windows that are made for each point of each root block. @pre the points are
  /// finite.
  PoseSearch(const LikelihoodPyramid<D>& pyramid, const Points<D>& points, const Pose<D>& guess,
             const PoseGrid<D>& grid, const MatchWindow<D>& window, double worth = kWorth)
      : pyramid_(pyramid), grid_(grid) {
    for (std::size_t a = 0; a < apart_.size(); ++a) {
      const double apart = a < std::size_t{D} ? window.apart : window.apart_angle;
      const double steps = std::ceil(apart / grid.step[static_cast<int>(a)] - kOnBorder) - 1.0;
      apart_[a] = static_cast<std::int32_t>(std::min(steps, kMostSteps));
    }
    const std::int32_t longest = 2 * *std::max_element(grid.count.begin(), grid.count.begin() + D) + 1;
    while (top_ < kTop && (std::int32_t{2} << top_) <= longest) ++top_;
    GridPose<D> rotation;
    for (std::size_t a = 0; a < rotation.steps.size(); ++a) rotation.steps[a] = -grid.count[a];
    do {
      rotations_.push_back(rotation);
      cells_.push_back(cells_of(pyramid, points, guess, grid, rotation));
    } while (next(rotation, D, kFreedoms<D>, 1));
    constexpr Eigen::Index kMostPoints = 1 << 24;  // Sums of as many bytes fit 32 bits.
    if (points.cols() > 0 && points.cols() <= kMostPoints)
      make_windows(worth * static_cast<double>(points.cols()));
  }

  /// Whether it looks maxima up in LikelihoodWindows.
  [[nodiscard]] bool has_windows() const { return windows_.has_value(); }
  /// The best poses, the best first, each apart from those before it: `most` of them, or as many as there
  /// are.
  /// @param near gets the poses that it wants, the best first, if it is given. @throws Cancelled.
  [[nodiscard]] std::vector<GridPose<D>> best(std::size_t most, NearPoses<D>* near = nullptr) {
    BlockQueue<D> queue = roots();
    std::vector<GridPose<D>> found;
    std::vector<GridPose<D>> scored;  // Not near one that was found.
    GridPose<D> best;
    while (found.size() < most) {
      const std::int64_t bound = queue.bound();
      const bool is_final =
          bound < 0 ||
          (bound < best.score && (near == nullptr || !found.empty() || !near->wants(bound, best.score)));
      // Where nothing is likely, one pose is as good as another.
      if (is_final || (bound == 0 && best.score == 0)) {
        if (best.score == GridPose<D>::kNone) break;
        if (near != nullptr && found.empty()) sort(*near, best);
        found.push_back(best);
        if (best.score == 0) break;
        best = {};
        std::vector<GridPose<D>> others;
        for (const GridPose<D>& pose : scored) {
          if (is_near(found.back(), pose, 0)) continue;
          others.push_back(pose);
          if (pose.is_better_than(best)) best = pose;
        }
        scored.swap(others);
        continue;
      }
      const PoseBlock<D> block = queue.pop();
      const GridPose<D> pose = pose_of(block);
      if (is_near_any(found, pose, static_cast<int>(block.level))) continue;
      if (block.level > 0) {
        push_parts(block, found, queue);
        continue;
      }
      if (near != nullptr && found.empty()) near->poses.push_back(pose);
      if (most > 1) scored.push_back(pose);
      if (pose.is_better_than(best)) best = pose;
    }
    return found;
  }

 private:
  static constexpr unsigned kParts = 1u << D;
  // Cells that windows may have in all levels, for each point of each root block; and at most.
  static constexpr double kWorth = 4.0;
  static constexpr double kMostCells = 67108864.0;

  using Sums = std::array<std::int64_t, kParts>;

  /// Steps on in axes [begin, end), the first fastest. @returns false at the end, where it begins anew.
  [[nodiscard]] bool next(GridPose<D>& pose, std::size_t begin, std::size_t end, std::int32_t step) const {
    for (std::size_t a = begin; a < end; ++a) {
      if ((pose.steps[a] += step) <= grid_.count[a]) return true;
      pose.steps[a] = -grid_.count[a];
    }
    return false;
  }
  [[nodiscard]] GridPose<D> pose_of(const PoseBlock<D>& block) const {
    GridPose<D> pose = rotations_[static_cast<std::size_t>(block.rotation)];
    for (std::size_t a = 0; a < std::size_t{D}; ++a) pose.steps[a] = block.steps[a];
    pose.score = block.bound;
    return pose;
  }
  /// Whether all poses of a block are too near a pose to count as others.
  [[nodiscard]] bool is_near(const GridPose<D>& middle, const GridPose<D>& first, int level) const {
    for (std::size_t a = 0; a < apart_.size(); ++a) {
      const std::int32_t more = a < std::size_t{D} ? (std::int32_t{1} << level) - 1 : 0;
      if (first.steps[a] < middle.steps[a] - apart_[a] || first.steps[a] + more > middle.steps[a] + apart_[a])
        return false;
    }
    return true;
  }
  [[nodiscard]] bool is_near_any(const std::vector<GridPose<D>>& found, const GridPose<D>& first,
                                 int level) const {
    return std::any_of(found.begin(), found.end(),
                       [&](const GridPose<D>& middle) { return is_near(middle, first, level); });
  }
  /// Leaves the poses that are wanted, the best first.
  static void sort(NearPoses<D>& near, const GridPose<D>& best) {
    const auto is_less = [&](const GridPose<D>& pose) { return pose.score < best.score - near.margin; };
    near.poses.erase(std::remove_if(near.poses.begin(), near.poses.end(), is_less), near.poses.end());
    std::sort(near.poses.begin(), near.poses.end(),
              [](const GridPose<D>& a, const GridPose<D>& b) { return a.is_better_than(b); });
  }

  /// Makes windows of all that points may come to, if that is less work than what is looked up anyhow.
  /// @param worth cells for each root block.
  void make_windows(double worth) {
    Cell lower;
    Cell upper;
    double blocks = static_cast<double>(rotations_.size());
    double cells = top_ + 1.0;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) {
      const std::int32_t count = grid_.count[a];
      lower[a] = std::numeric_limits<std::int32_t>::max();
      upper[a] = std::numeric_limits<std::int32_t>::min();
      for (const std::vector<Cell>& of : cells_)
        for (const Cell& cell : of) {
          if (cell[a] + count < 0 || cell[a] - count >= pyramid_.count(a)) continue;
          lower[a] = std::min(lower[a], cell[a] - count);
          upper[a] = std::max(upper[a], cell[a] + count);
        }
      if (lower[a] > upper[a]) return;
      upper[a] += std::int32_t{1} << top_;  // A block may reach beyond the window.
      cells *= static_cast<double>(upper[a]) - lower[a] + 1.0;
      blocks *= std::ceil((2.0 * count + 1.0) / static_cast<double>(std::int32_t{1} << top_));
    }
    if (cells > std::min(kMostCells, worth * blocks)) return;
    windows_.emplace(pyramid_, lower, upper, top_);
    numbers_.resize(cells_.size());
    for (std::size_t i = 0; i < cells_.size(); ++i) {
      for (const Cell& cell : cells_[i])
        if (may_be_likely(cell)) numbers_[i].push_back(windows_->number_of(cell));
      cells_[i] = {};
    }
  }
  /// Whether a point may come to where the pyramid has cells.
  [[nodiscard]] bool may_be_likely(const Cell& cell) const {
    for (std::size_t a = 0; a < std::size_t{D}; ++a)
      if (cell[a] + grid_.count[a] < 0 || cell[a] - grid_.count[a] >= pyramid_.count(a)) return false;
    return true;
  }

  /// All blocks of the highest level.
  [[nodiscard]] BlockQueue<D> roots() {
    std::size_t most = 0;
    for (std::size_t i = 0; i < cells_.size(); ++i)
      most = std::max(most, windows_ ? numbers_[i].size() : cells_[i].size());
    BlockQueue<D> queue(static_cast<std::int64_t>(most) * LikelihoodPyramid<D>::kMaximum);
    PoseBlock<D> block;
    block.level = static_cast<std::uint8_t>(top_);
    for (GridPose<D> pose : rotations_) {
      do {
        for (std::size_t a = 0; a < std::size_t{D}; ++a) block.steps[a] = pose.steps[a];
        Sums sums{};
        add_up<1>(block, sums);
        push(block, sums[0], {}, queue);
      } while (next(pose, 0, D, std::int32_t{1} << top_));
      ++block.rotation;
    }
    return queue;
  }
  /// The blocks that a block consists of.
  void push_parts(const PoseBlock<D>& block, const std::vector<GridPose<D>>& found, BlockQueue<D>& queue) {
    PoseBlock<D> part = block;
    --part.level;
    Sums sums{};
    add_up<kParts>(part, sums);
    for (unsigned k = 0; k < kParts; ++k) {
      bool is_inside = true;
      for (std::size_t a = 0; a < std::size_t{D}; ++a) {
        part.steps[a] = block.steps[a] + (static_cast<std::int32_t>(k >> a & 1u) << part.level);
        is_inside = is_inside && part.steps[a] <= grid_.count[a];
      }
      if (is_inside) push(part, sums[k], found, queue);
    }
  }
  void push(PoseBlock<D>& block, std::int64_t sum, const std::vector<GridPose<D>>& found,
            BlockQueue<D>& queue) const {
    const GridPose<D> pose = pose_of(block);
    if (is_near_any(found, pose, static_cast<int>(block.level))) return;
    block.bound = std::max<std::int64_t>(0, sum - grid_.penalty(pose, (std::int32_t{1} << block.level) - 1));
    queue.push(block);
  }
  /// Sums of the points' maxima for a block, and for those beside it, up to `Parts`.
  template <unsigned Parts>
  void add_up(const PoseBlock<D>& block, Sums& sums) {
    const auto rotation = static_cast<std::size_t>(block.rotation);
    if (windows_) {
      const std::uint8_t* const maxima = windows_->level(static_cast<int>(block.level));
      std::int32_t first = 0;
      std::array<std::int32_t, Parts> away{};
      for (std::size_t a = 0; a < std::size_t{D}; ++a) {
        first += block.steps[a] * windows_->stride(a);
        for (unsigned k = 0; k < Parts; ++k)
          away[k] += static_cast<std::int32_t>(k >> a & 1u) * (windows_->stride(a) << block.level);
      }
      pace_.spend(numbers_[rotation].size() + 1);
      std::array<std::uint32_t, Parts> short_sums{};
      for (const std::int32_t number : numbers_[rotation])
        for (unsigned k = 0; k < Parts; ++k) short_sums[k] += maxima[number + first + away[k]];
      std::copy(short_sums.begin(), short_sums.end(), sums.begin());
      return;
    }
    pace_.spend(Parts * (cells_[rotation].size() + 1));
    for (const Cell& cell : cells_[rotation])
      for (unsigned k = 0; k < Parts; ++k) {
        Cell at;
        for (std::size_t a = 0; a < std::size_t{D}; ++a)
          at[a] = cell[a] + block.steps[a] + (static_cast<std::int32_t>(k >> a & 1u) << block.level);
        sums[k] += pyramid_.bound(static_cast<int>(block.level), at);
      }
  }

  const LikelihoodPyramid<D>& pyramid_;
  const PoseGrid<D>& grid_;
  typename GridPose<D>::Steps apart_{};  // Steps within which poses are the same.
  int top_ = 0;
  std::vector<GridPose<D>> rotations_;
  std::vector<std::vector<Cell>>
      cells_;  // Of the points, by rotation; or, with windows, their numbers there.
  std::optional<LikelihoodWindows<D>> windows_;
  std::vector<std::vector<std::int32_t>> numbers_;
  Pace pace_;
};

}  // namespace ndtree
