// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The grid of poses of a window: steps, scores, and the prior of a pose.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Where a scan may be, and which of its poses are different ones.
template <int D>
struct MatchWindow {
  Motion<D> half = Motion<D>::Zero();  ///< Farthest from the guess on each axis [m, rad].
  double apart = 0.5;         ///< A pose is another one if it is as far from the best on some axis [m]
  double apart_angle = 0.35;  ///< or turned by as much [rad].
};

/// A pose on the grid of a window, in steps of each axis from the guess.
template <int D>
struct GridPose {
  using Steps = std::array<std::int32_t, std::size_t{kFreedoms<D>}>;
  static constexpr std::int64_t kNone = -1;

  Steps steps{};
  /// Sum of the end points' likelihoods in 255ths, less what the prior takes off, at least 0; kNone if there
  /// is no pose.
  std::int64_t score = kNone;

  /// Squared steps from the guess.
  [[nodiscard]] std::int64_t away() const {
    std::int64_t sum = 0;
    for (const std::int32_t s : steps) sum += std::int64_t{s} * s;
    return sum;
  }
  /// Whether this one is taken rather than another: the more likely, the nearer to the guess, the first.
  [[nodiscard]] bool is_better_than(const GridPose& other) const {
    if (score != other.score) return score > other.score;
    return away() != other.away() ? away() < other.away() : steps < other.steps;
  }
};

/// A guess has heavy tails: a wheel slips more often than a normal distribution knows.
struct PriorTail {
  static constexpr double kFar = 3.0;  ///< Standard deviations from which on a guess counts half, and less.

  /// Negative log-likelihood of a squared distance in standard deviations.
  [[nodiscard]] static double cost(double square) {
    return 0.5 * kFar * kFar * std::log1p(square / (kFar * kFar));
  }
  /// Factor of the guess's information there.
  [[nodiscard]] static double weight(double square) { return 1.0 / (1.0 + square / (kFar * kFar)); }
};

/// The grid of poses of a window: how many steps to each side, and how large they are [m, rad].
template <int D>
struct PoseGrid {
  typename GridPose<D>::Steps count{};
  Motion<D> step = Motion<D>::Ones();
  MotionMatrix<D> prior = MotionMatrix<D>::Zero();  ///< Of a guess: takes a motion to standard deviations.
  bool has_prior = false;
  double worth = 0.0;  ///< 255ths that are worth a log-likelihood of 1.

  [[nodiscard]] Motion<D> motion(const GridPose<D>& pose) const {
    Motion<D> result;
    for (int a = 0; a < kFreedoms<D>; ++a) result[a] = pose.steps[static_cast<std::size_t>(a)] * step[a];
    return result;
  }
  /// @param information of a guess, its inverse covariance.
  void set_prior(const MotionMatrix<D>& information, double worth_of_one) {
    const Eigen::SelfAdjointEigenSolver<SmallMatrix<6>> solver{SmallMatrix<6>(information)};
    const Motion<D> lengths = solver.eigenvalues().cwiseMax(0.0).cwiseSqrt();
    prior = lengths.asDiagonal() * solver.eigenvectors().transpose();
    has_prior = !prior.isZero(0.0);
    worth = worth_of_one;
  }
  /// What the prior takes off the score of each pose of a block, at least: its translations are up to `more`
  /// steps from the pose.
  [[nodiscard]] std::int64_t penalty(const GridPose<D>& pose, std::int32_t more = 0) const {
    if (!has_prior) return 0;
    const Motion<D> first = prior * motion(pose);
    double sum = 0.0;
    for (int k = 0; k < kFreedoms<D>; ++k) {
      double low = first[k];
      double high = first[k];
      for (int a = 0; a < D && more > 0; ++a) {
        const double way = prior(k, a) * more * step[a];
        (way < 0.0 ? low : high) += way;
      }
      const double least = low > 0.0 ? low : std::min(high, 0.0);
      sum += least * least;
    }
    // Sums of other steps are rounded otherwise.
    return static_cast<std::int64_t>(worth * PriorTail::cost(more > 0 ? sum * (1.0 - 1e-9) : sum));
  }
};

/// Poses of a grid whose scores are nearly the best: where else a scan may be.
template <int D>
struct NearPoses {
  static constexpr std::size_t kMost = 4000;

  std::int64_t margin = 0;  ///< By which a score may be less than the best, in 255ths.
  std::vector<GridPose<D>> poses;

  /// @param score that a pose may have. @param best of all.
  [[nodiscard]] bool wants(std::int64_t score, std::int64_t best) const {
    return score > 0 && score >= best - margin && poses.size() < kMost;
  }
};

}  // namespace ndtree
