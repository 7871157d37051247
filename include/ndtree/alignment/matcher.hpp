// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The pose of a scan among surfaces: the best of a window, found surely, and then refined.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <queue>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/alignment/likelihood_pyramid.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/alignment/surface_elements.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

struct MatchOptions {
  double cell_size = 0.05;  ///< Of the likelihood's grid, and the step of the grid of poses [m].
  double sigma = 0.05;      ///< Of an end point's distance from a surface, in the search [m].
  double radius = 0.2;      ///< Of the points that shape a piece of the surface [m].
  double noise = 0.02;      ///< Least standard deviation across a surface, in the refinement [m].

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    constexpr OptionBounds kSizes{1e-4, 1e4, " m"};
    require_within("cell_size", cell_size, kSizes);
    require_within("sigma", sigma, kSizes);
    require_within("radius", radius, kSizes);
    require_within("noise", noise, kSizes);
  }
};

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
  std::int64_t score = kNone;  ///< Sum of the end points' likelihoods in 255ths; kNone if there is no pose.

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

/// The grid of poses of a window: how many steps to each side, and how large they are [m, rad].
template <int D>
struct PoseGrid {
  typename GridPose<D>::Steps count{};
  Motion<D> step = Motion<D>::Ones();

  [[nodiscard]] Motion<D> motion(const GridPose<D>& pose) const {
    Motion<D> result;
    for (int a = 0; a < kFreedoms<D>; ++a) result[a] = pose.steps[static_cast<std::size_t>(a)] * step[a];
    return result;
  }
};

/// A pose that was found.
template <int D>
struct Match {
  Pose<D> pose;
  MotionMatrix<D> covariance = MotionMatrix<D>::Zero();  ///< Of a Motion of the pose.
  double score = 0.0;    ///< Mean likelihood of the end points at the grid's best pose, in [0, 1].
  double second = 0.0;   ///< Score of the best other pose of the window; 0 if there is none.
  double inliers = 0.0;  ///< Fraction of points that lie on a surface at the refined pose.
  GridPose<D> grid;      ///< The grid's best pose.

  /// Whether no other pose explains the scan nearly as well.
  [[nodiscard]] bool is_unique(double ratio = 0.9) const { return score > 0.0 && second < ratio * score; }
};

/// Finds scans among the surfaces that it was made of.
///
/// Strategy: poses on a grid, whose translations are steps of a cell and whose rotations move the farthest
/// point by a cell at most, are scored by the likelihood of the end points. Branch and bound, best first,
/// over blocks of translations of each rotation: a block's bound is the sum of its points' maxima in the
/// LikelihoodPyramid, so no pose in it scores more, and the first pose that leaves the queue is the grid's
/// best. The refinement is Gauss-Newton on the distances of the points from the nearest surface elements, in
/// their metric, with a Cauchy kernel. Invariant, tested: a search gives what trying all poses gives, bit for
/// bit. Safe to use from several threads. Cost: O(points of the surface · cells within 3 sigma) to make; a
/// search O(rotations · points), and what the bounds leave.
template <int D>
class Matcher {
 public:
  using Cell = typename LikelihoodPyramid<D>::Cell;

  /// @param points of surfaces [m]; points with NaN or infinity are left out.
  /// @throws std::invalid_argument if an option is out of bounds, or the surface too large for its cells.
  explicit Matcher(const Points<D>& points, const MatchOptions& options = {})
      : options_(validated(options)),
        surface_(finite(points), options.cell_size, options.radius, options.noise),
        pyramid_(surface_.points, options.cell_size, options.sigma) {
    pyramid_.grow_to(kTop);
  }

  [[nodiscard]] const MatchOptions& options() const { return options_; }
  [[nodiscard]] const SurfaceElements<D>& surface() const { return surface_; }

  /// @throws std::invalid_argument if the window is negative or too large.
  [[nodiscard]] PoseGrid<D> grid_of(const Points<D>& points, const Motion<D>& half) const {
    const double farthest = points.cols() == 0 ? 0.0 : points.colwise().norm().maxCoeff();
    PoseGrid<D> grid;
    grid.step.template head<D>().setConstant(options_.cell_size);
    grid.step.template tail<kAngles>().setConstant(options_.cell_size /
                                                   std::max(farthest, options_.cell_size));
    double rotations = 1.0;
    for (int a = 0; a < kFreedoms<D>; ++a) {
      const double count = std::floor(half[a] / grid.step[a] + kOnBorder);
      if (a >= D) rotations *= 2.0 * count + 1.0;
      if (!(half[a] >= 0.0) || !(count <= kMostSteps) || !(rotations <= kMostSteps))
        throw std::invalid_argument("window = " + describe_number(half[a]) + ": must be >= 0, with at most " +
                                    "1e6 steps of " + describe_number(grid.step[a]) + " and 1e6 rotations");
      grid.count[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(count);
    }
    return grid;
  }
  /// Of one pose: what search() maximises.
  [[nodiscard]] std::int64_t score(const Points<D>& points, const Pose<D>& guess, const PoseGrid<D>& grid,
                                   const GridPose<D>& pose) const {
    std::vector<Cell> cells;
    place(points, guess, grid, pose, cells);
    return bound(cells, 0, pose);
  }
  /// The best pose of a grid. @param except poses that are not `apart` from this one, if it is given.
  /// @pre the points are finite.
  [[nodiscard]] GridPose<D> search(const Points<D>& points, const Pose<D>& guess, const PoseGrid<D>& grid,
                                   const MatchWindow<D>& window, const GridPose<D>* except = nullptr) const {
    const Exclusion excluded(grid, window, except);
    std::vector<std::vector<Cell>> placed;  // By rotation.
    std::priority_queue<Block> queue;
    Pace pace;
    const auto push = [&](const Block& block) {
      if (excluded.contains(block)) return;
      pace.spend(static_cast<std::size_t>(points.cols()) + 1);
      Block bounded = block;
      bounded.pose.score = bound(placed[block.rotation], block.level, block.pose);
      queue.push(bounded);
    };
    Block block;
    const std::int32_t longest = 2 * *std::max_element(grid.count.begin(), grid.count.begin() + D) + 1;
    while (block.level < kTop && (std::int32_t{2} << block.level) <= longest) ++block.level;
    for (std::size_t a = 0; a < block.pose.steps.size(); ++a) block.pose.steps[a] = -grid.count[a];
    do {
      block.rotation = placed.size();
      placed.emplace_back();
      place(points, guess, grid, block.pose, placed.back());
      do {
        push(block);
      } while (next(block.pose, grid, 0, D, std::int32_t{1} << block.level));
    } while (next(block.pose, grid, D, kFreedoms<D>, 1));

    GridPose<D> best;
    while (!queue.empty()) {
      block = queue.top();
      // Where nothing is likely, one pose is as good as another.
      if (block.pose.score < best.score || (block.pose.score == 0 && best.score == 0)) break;
      queue.pop();
      if (block.level == 0) {
        if (block.pose.is_better_than(best)) best = block.pose;
        continue;
      }
      --block.level;
      const GridPose<D> first = block.pose;
      for (unsigned child = 0; child < 1u << D; ++child) {
        bool is_inside = true;
        for (std::size_t a = 0; a < std::size_t{D}; ++a) {
          block.pose.steps[a] =
              first.steps[a] + ((child >> a & 1u) != 0 ? std::int32_t{1} << block.level : 0);
          is_inside = is_inside && block.pose.steps[a] <= grid.count[a];
        }
        if (is_inside) push(block);
      }
    }
    return best;
  }

  /// Refines a pose, and sets `pose`, `covariance` and `inliers` of a match.
  /// @param guess, information what the pose is beforehand: the inverse covariance of a Motion of
  /// the
  ///   guess, 0 for nothing. @pre the points are finite.
  void refine(const Points<D>& points, const Pose<D>& from, const Pose<D>& guess,
              const MotionMatrix<D>& information, Match<D>& match) const {
    constexpr int kSteps = 30;
    constexpr double kKernel = 2.0;  // Standard deviations from which on a point counts half, and less.
    constexpr double kLeast = 1e-6;  // Information: keeps a match without points solvable.
    constexpr double kStill = 1e-6;  // [m, rad]
    const MotionMatrix<D> least = kLeast * MotionMatrix<D>::Identity();
    MotionMatrix<D> hessian;
    match.pose = from;
    double squares = 0.0;
    double weights = 0.0;
    for (int step = 0; step < kSteps; ++step) {
      hessian = information + least;
      Motion<D> gradient = information * motion_between(guess, match.pose);
      squares = weights = 0.0;
      int inliers = 0;
      for (Eigen::Index i = 0; i < points.cols(); ++i) {
        const Vector<D> turned = match.pose.rotation * points.col(i);
        const Vector<D> at = turned + match.pose.translation;
        const std::int32_t nearest = pyramid_.nearest(pyramid_.cell_of(at));
        if (nearest == LikelihoodPyramid<D>::kNoPoint) continue;
        const Vector<D> error = at - surface_.points.col(nearest);
        const auto& metric = surface_.information[static_cast<std::size_t>(nearest)];
        const Vector<D> weighted = metric * error;
        const double square = error.dot(weighted);
        const double weight = 1.0 / (1.0 + square / (kKernel * kKernel));
        const Eigen::Matrix<double, D, kFreedoms<D>> jacobian = jacobian_of(turned);
        hessian.noalias() += weight * jacobian.transpose() * metric * jacobian;
        gradient.noalias() += weight * jacobian.transpose() * weighted;
        squares += weight * square;
        weights += weight;
        if (square < 2.0 * kKernel * kKernel) ++inliers;
      }
      match.inliers = points.cols() == 0 ? 0.0 : inliers / static_cast<double>(points.cols());
      const Motion<D> change = -Decomposition(hessian).solve(gradient);
      if (!change.allFinite()) break;
      match.pose = moved(match.pose, change);
      if (change.cwiseAbs().maxCoeff() < kStill) break;
    }
    // Points that lie closer than their model says are no reason to be surer than it is.
    const double spread = weights > 0.0 ? std::max(squares / weights, 0.1) : 1.0;
    match.covariance = spread * Decomposition(hessian).inverse();
  }

  /// The best pose of a window, refined.
  /// @param information as of refine(); it counts less where the search ends far from the guess.
  /// @param wants_second whether `second` is looked for, which costs another search.
  /// @throws std::invalid_argument as grid_of().
  [[nodiscard]] Match<D> match(const Points<D>& points, const Pose<D>& guess, const MatchWindow<D>& window,
                               const MotionMatrix<D>& information = MotionMatrix<D>::Zero(),
                               bool wants_second = true) const {
    constexpr double kFar = 3.0;  // Standard deviations from which on a guess counts half, and less.
    const Points<D> good = finite(points);
    const PoseGrid<D> grid = grid_of(good, window.half);
    const double most = LikelihoodPyramid<D>::kMaximum * std::max(1.0, static_cast<double>(good.cols()));
    Match<D> match;
    match.grid = search(good, guess, grid, window);
    match.score = static_cast<double>(match.grid.score) / most;
    if (wants_second) {
      const GridPose<D> second = search(good, guess, grid, window, &match.grid);
      match.second = static_cast<double>(std::max<std::int64_t>(second.score, 0)) / most;
    }
    const Motion<D> off = grid.motion(match.grid);
    const double weight = 1.0 / (1.0 + off.dot(information * off) / (kFar * kFar));
    refine(good, moved(guess, off), guess, weight * information, match);
    return match;
  }

  /// Columns without NaN or infinity.
  [[nodiscard]] static Points<D> finite(const Points<D>& points) {
    Points<D> good(D, points.cols());
    Eigen::Index count = 0;
    for (Eigen::Index i = 0; i < points.cols(); ++i)
      if (points.col(i).allFinite()) good.col(count++) = points.col(i);
    good.conservativeResize(D, count);
    return good;
  }

 private:
  static constexpr int kAngles = kFreedoms<D> - D;
  static constexpr int kTop = 6;  // Highest level: blocks of 64 steps.
  static constexpr double kMostSteps = 1e6;

  /// Of a MotionMatrix.
  using Decomposition = Eigen::PartialPivLU<SmallMatrix<kFreedoms<3>>>;

  /// Poses of one rotation whose translations are up to 2^level steps from `pose`, which has their bound.
  struct Block {
    GridPose<D> pose;
    int level = 0;
    std::size_t rotation = 0;

    /// For a queue that gives the largest bound first, and poses before blocks.
    friend bool operator<(const Block& a, const Block& b) {
      if (a.pose.score != b.pose.score) return a.pose.score < b.pose.score;
      return a.level > b.level;
    }
  };

  /// Poses near one, which are no others.
  class Exclusion {
   public:
    Exclusion(const PoseGrid<D>& grid, const MatchWindow<D>& window, const GridPose<D>* around) {
      if (around == nullptr) return;
      is_any_ = true;
      for (std::size_t a = 0; a < first_.size(); ++a) {
        const double apart = a < std::size_t{D} ? window.apart : window.apart_angle;
        const double steps = std::ceil(apart / grid.step[static_cast<int>(a)] - kOnBorder) - 1.0;
        first_[a] = around->steps[a] - static_cast<std::int32_t>(std::min(steps, kMostSteps));
        last_[a] = around->steps[a] + static_cast<std::int32_t>(std::min(steps, kMostSteps));
      }
    }
    /// Whether all poses of a block are near.
    [[nodiscard]] bool contains(const Block& block) const {
      if (!is_any_) return false;
      for (std::size_t a = 0; a < first_.size(); ++a) {
        const std::int32_t more = a < std::size_t{D} ? (std::int32_t{1} << block.level) - 1 : 0;
        if (block.pose.steps[a] < first_[a] || block.pose.steps[a] + more > last_[a]) return false;
      }
      return true;
    }

   private:
    bool is_any_ = false;
    typename GridPose<D>::Steps first_{};
    typename GridPose<D>::Steps last_{};
  };

  [[nodiscard]] static const MatchOptions& validated(const MatchOptions& options) {
    options.validate();
    return options;
  }
  /// Of a point's place, by a Motion of its scan's pose. @param turned from the scan's origin.
  [[nodiscard]] static Eigen::Matrix<double, D, kFreedoms<D>> jacobian_of(const Vector<D>& turned) {
    Eigen::Matrix<double, D, kFreedoms<D>> jacobian;
    jacobian.template leftCols<D>().setIdentity();
    if constexpr (D == 2) {
      jacobian.col(2) << -turned[1], turned[0];
    } else {
      jacobian.template rightCols<3>() << 0.0, turned[2], -turned[1],  //
          -turned[2], 0.0, turned[0],                                  //
          turned[1], -turned[0], 0.0;
    }
    return jacobian;
  }
  /// Steps on in axes [begin, end), the first fastest. @returns false at the end, where it begins anew.
  [[nodiscard]] static bool next(GridPose<D>& pose, const PoseGrid<D>& grid, std::size_t begin,
                                 std::size_t end, std::int32_t step) {
    for (std::size_t a = begin; a < end; ++a) {
      if ((pose.steps[a] += step) <= grid.count[a]) return true;
      pose.steps[a] = -grid.count[a];
    }
    return false;
  }
  /// The points' cells for a pose's rotation, without its translation's steps.
  void place(const Points<D>& points, const Pose<D>& guess, const PoseGrid<D>& grid,
             const GridPose<D>& rotation, std::vector<Cell>& cells) const {
    Motion<D> motion = grid.motion(rotation);
    motion.template head<D>().setZero();
    const Pose<D> pose = moved(guess, motion);
    cells.resize(static_cast<std::size_t>(points.cols()));
    for (Eigen::Index i = 0; i < points.cols(); ++i)
      cells[static_cast<std::size_t>(i)] = pyramid_.cell_of(pose * points.col(i));
  }
  /// Not less than the score of any pose in a block.
  [[nodiscard]] std::int64_t bound(const std::vector<Cell>& cells, int level, const GridPose<D>& pose) const {
    std::int64_t sum = 0;
    for (const Cell& cell : cells) {
      Cell at;
      for (std::size_t a = 0; a < std::size_t{D}; ++a) at[a] = cell[a] + pose.steps[a];
      sum += pyramid_.bound(level, at);
    }
    return sum;
  }

  MatchOptions options_;
  SurfaceElements<D> surface_;
  LikelihoodPyramid<D> pyramid_;
};

}  // namespace ndtree
