// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The pose of a scan among surfaces: the best of a window, found surely, and then refined.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
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
#include "ndtree/alignment/match_options.hpp"
#include "ndtree/alignment/pose_likelihood.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/alignment/surface_elements.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
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
  double worth = 0.0;                               ///< 255ths that are worth a log-likelihood of 1.

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
    worth = worth_of_one;
  }
  /// What the prior takes off the score of each pose of a block, at least: its translations are up to `more`
  /// steps from the pose.
  [[nodiscard]] std::int64_t penalty(const GridPose<D>& pose, std::int32_t more = 0) const {
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

  [[nodiscard]] bool wants(const GridPose<D>& pose, const GridPose<D>& best) const {
    return pose.score > 0 && pose.score >= best.score - margin && poses.size() < kMost;
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
/// best. The refinement is Gauss-Newton on PoseLikelihood, times the prior of the guess. Invariant,
/// tested: a search gives what trying all poses gives, bit for bit. Safe to use from several threads. Cost:
/// O(points of the surface · cells within 3 sigma) to make; a search O(rotations · points), and what the
/// bounds leave.
template <int D>
class Matcher {
 public:
  using Cell = typename LikelihoodPyramid<D>::Cell;

  /// @param points of surfaces [m]; points with NaN or infinity are left out.
  /// @throws std::invalid_argument if an option is out of bounds, or the surface too large for its cells.
  explicit Matcher(const Points<D>& points, const MatchOptions& options = {})
      : Matcher(SurfacePoints<D>{finite(points), {}}, options) {}
  /// @param points of surfaces, finite [m]. @throws as above.
  explicit Matcher(const SurfacePoints<D>& points, const MatchOptions& options = {})
      : options_(validated(options)),
        surface_(points, options),
        pyramid_(surface_.points, options.cell_size, options.sigma) {
    pyramid_.grow_to(kTop);
  }

  [[nodiscard]] const MatchOptions& options() const { return options_; }
  [[nodiscard]] const SurfaceElements<D>& surface() const { return surface_; }

  /// @throws std::invalid_argument if the window is negative or too large.
  [[nodiscard]] PoseGrid<D> grid_of(const Points<D>& points, const Motion<D>& half,
                                    const MotionMatrix<D>& information = MotionMatrix<D>::Zero()) const {
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
    grid.set_prior(information, LikelihoodPyramid<D>::kMaximum *
                                    std::max(1.0, static_cast<double>(points.cols())) /
                                    std::max(1.0, static_cast<double>(pieces_of(points))));
    return grid;
  }
  /// Of one pose: what search() maximises.
  [[nodiscard]] std::int64_t score(const Points<D>& points, const Pose<D>& guess, const PoseGrid<D>& grid,
                                   const GridPose<D>& pose) const {
    return std::max<std::int64_t>(0, likelihood(points, guess, grid, pose) - grid.penalty(pose));
  }
  /// The best poses of a grid, the best first, each `apart` from those before it: `most` of them, or as many
  /// as there are. @param near gets the poses that it wants, the best first, if it is given.
  /// @pre the points are finite.
  [[nodiscard]] std::vector<GridPose<D>> search(const Points<D>& points, const Pose<D>& guess,
                                                const PoseGrid<D>& grid, const MatchWindow<D>& window,
                                                std::size_t most = 1, NearPoses<D>* near = nullptr) const {
    Exclusion excluded(grid, window);
    std::vector<std::vector<Cell>> placed;  // By rotation.
    std::priority_queue<Block> queue;
    Pace pace;
    const auto push = [&](const Block& block) {
      if (excluded.contains(block)) return;
      pace.spend(static_cast<std::size_t>(points.cols()) + 1);
      Block bounded = block;
      const std::int32_t more = (std::int32_t{1} << block.level) - 1;
      bounded.pose.score = std::max<std::int64_t>(
          0, bound(placed[block.rotation], block.level, block.pose) - grid.penalty(block.pose, more));
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

    std::vector<GridPose<D>> found;
    std::vector<GridPose<D>> scored;  // Not near one that was found.
    GridPose<D> best;
    while (found.size() < most) {
      const bool is_final =
          queue.empty() || (queue.top().pose.score < best.score &&
                            (near == nullptr || !found.empty() || !near->wants(queue.top().pose, best)));
      // Where nothing is likely, one pose is as good as another.
      if (is_final || (queue.top().pose.score == 0 && best.score == 0)) {
        if (best.score == GridPose<D>::kNone) break;
        found.push_back(best);
        if (best.score == 0) break;
        excluded.add(best);
        best = {};
        std::vector<GridPose<D>> others;
        for (const GridPose<D>& pose : scored) {
          if (excluded.contains({pose})) continue;
          others.push_back(pose);
          if (pose.is_better_than(best)) best = pose;
        }
        scored.swap(others);
        continue;
      }
      block = queue.top();
      queue.pop();
      if (excluded.contains(block)) continue;
      if (block.level == 0) {
        if (near != nullptr && found.empty()) near->poses.push_back(block.pose);
        if (most > 1) scored.push_back(block.pose);
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
    return found;
  }

  /// Refines a pose, and sets `pose`, `covariance` and `inliers` of a match.
  /// @param guess, information what the pose is beforehand: the inverse covariance of a Motion of
  /// the
  ///   guess, 0 for nothing. @pre the points are finite.
  void refine(const Points<D>& points, const Pose<D>& from, const Pose<D>& guess,
              const MotionMatrix<D>& information, Match<D>& match) const {
    constexpr int kSteps = 30;
    constexpr double kLeast = 1e-6;  // Information: keeps a match without points solvable.
    constexpr double kStill = 1e-6;  // [m, rad]
    PoseLikelihood<D> likelihood(surface_, options_);
    match.pose = from;
    for (int step = 0; step < kSteps; ++step) {
      likelihood.begin(match.pose);
      for (Eigen::Index i = 0; i < points.cols(); ++i) {
        const Vector<D> turned = match.pose.rotation * points.col(i);
        const std::int32_t nearest = pyramid_.nearest(pyramid_.cell_of(turned + match.pose.translation));
        if (nearest != LikelihoodPyramid<D>::kNoPoint)
          likelihood.add(turned, static_cast<std::size_t>(nearest));
      }
      const typename PoseLikelihood<D>::Result found = likelihood.result();
      const Motion<D> off = motion_between(guess, match.pose);
      const MotionMatrix<D> known =
          PriorTail::weight(off.dot(information * off)) * information + kLeast * MotionMatrix<D>::Identity();
      const Motion<D> gradient = found.gradient + known * off;
      const Decomposition posterior(found.information / found.spread + known);
      match.inliers = points.cols() == 0 ? 0.0 : found.inliers / static_cast<double>(points.cols());
      match.covariance = posterior.inverse();
      const Motion<D> change = -Decomposition(found.information + known).solve(gradient);
      if (!change.allFinite()) break;
      match.pose = moved(match.pose, change);
      if (change.cwiseAbs().maxCoeff() < kStill) break;
    }
  }

  /// The best pose of a window, refined.
  /// @param information as of refine().
  /// @param wants_second whether `second` is looked for, too.
  /// @throws std::invalid_argument as grid_of().
  [[nodiscard]] Match<D> match(const Points<D>& points, const Pose<D>& guess, const MatchWindow<D>& window,
                               const MotionMatrix<D>& information = MotionMatrix<D>::Zero(),
                               bool wants_second = true) const {
    const Points<D> good = finite(points);
    const PoseGrid<D> grid = grid_of(good, window.half, information);
    NearPoses<D> near;
    near.margin = static_cast<std::int64_t>(kLeastLikely * grid.worth);
    const std::vector<GridPose<D>> found = search(good, guess, grid, window, wants_second ? 2 : 1, &near);
    Match<D> match = refined(good, guess, grid, found.front(), information);
    if (found.size() > 1 && found[1].score > 0)
      match.second = score(good, moved(guess, grid.motion(found[1])));
    match.covariance = with_others(match, guess, grid, near.poses);
    return match;
  }
  /// The best poses of a window, each `apart` from those before it, refined, and with the covariance of its
  /// own mode alone: `most` of them, or as many as have a likelihood. @throws std::invalid_argument as
  /// grid_of().
  [[nodiscard]] std::vector<Match<D>> modes(
      const Points<D>& points, const Pose<D>& guess, const MatchWindow<D>& window, std::size_t most,
      const MotionMatrix<D>& information = MotionMatrix<D>::Zero()) const {
    const Points<D> good = finite(points);
    const PoseGrid<D> grid = grid_of(good, window.half, information);
    std::vector<Match<D>> matches;
    for (const GridPose<D>& one : search(good, guess, grid, window, most))
      if (one.score > 0) matches.push_back(refined(good, guess, grid, one, information));
    return matches;
  }
  /// Mean likelihood of the end points at a pose, as `Match::score`; 0 without points.
  [[nodiscard]] double score(const Points<D>& points, const Pose<D>& pose) const {
    std::int64_t sum = 0;
    Eigen::Index count = 0;
    for (Eigen::Index i = 0; i < points.cols(); ++i) {
      if (!points.col(i).allFinite()) continue;
      sum += pyramid_.bound(0, pyramid_.cell_of(pose * points.col(i)));
      ++count;
    }
    return count == 0 ? 0.0
                      : static_cast<double>(sum) / (static_cast<double>(LikelihoodPyramid<D>::kMaximum) *
                                                    static_cast<double>(count));
  }

  /// Pieces of surface that a scan sees: end points on one are wrong alike, and count once in the search.
  [[nodiscard]] std::size_t pieces_of(const Points<D>& points) const {
    std::vector<std::array<std::int64_t, std::size_t{D}>> cells(static_cast<std::size_t>(points.cols()));
    for (std::size_t i = 0; i < cells.size(); ++i)
      for (int a = 0; a < D; ++a)
        cells[i][static_cast<std::size_t>(a)] = static_cast<std::int64_t>(
            std::floor(points(a, static_cast<Eigen::Index>(i)) / (kCellsOfPiece * options_.cell_size)));
    std::sort(cells.begin(), cells.end());
    return static_cast<std::size_t>(std::unique(cells.begin(), cells.end()) - cells.begin());
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
  static constexpr double kCellsOfPiece = 4.0;
  // Poses count whose log-likelihood is at most this much less than the best one's.
  static constexpr double kLeastLikely = 5.0;

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

  /// Poses that are too near one that was found to count as another.
  class Exclusion {
   public:
    Exclusion(const PoseGrid<D>& grid, const MatchWindow<D>& window) {
      for (std::size_t a = 0; a < steps_.size(); ++a) {
        const double apart = a < std::size_t{D} ? window.apart : window.apart_angle;
        const double steps = std::ceil(apart / grid.step[static_cast<int>(a)] - kOnBorder) - 1.0;
        steps_[a] = static_cast<std::int32_t>(std::min(steps, kMostSteps));
      }
    }
    void add(const GridPose<D>& pose) { around_.push_back(pose.steps); }
    /// Whether all poses of a block are near one.
    [[nodiscard]] bool contains(const Block& block) const {
      return std::any_of(around_.begin(), around_.end(), [&](const typename GridPose<D>::Steps& middle) {
        for (std::size_t a = 0; a < steps_.size(); ++a) {
          const std::int32_t more = a < std::size_t{D} ? (std::int32_t{1} << block.level) - 1 : 0;
          if (block.pose.steps[a] < middle[a] - steps_[a] ||
              block.pose.steps[a] + more > middle[a] + steps_[a])
            return false;
        }
        return true;
      });
    }

   private:
    typename GridPose<D>::Steps steps_{};
    std::vector<typename GridPose<D>::Steps> around_;
  };

  [[nodiscard]] static const MatchOptions& validated(const MatchOptions& options) {
    options.validate();
    return options;
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
  /// A pose of a grid, refined.
  [[nodiscard]] Match<D> refined(const Points<D>& points, const Pose<D>& guess, const PoseGrid<D>& grid,
                                 const GridPose<D>& from, const MotionMatrix<D>& information) const {
    Match<D> match;
    match.grid = from;
    const Pose<D> pose = moved(guess, grid.motion(from));
    match.score = score(points, pose);
    refine(points, pose, guess, information, match);
    return match;
  }
  /// The covariance of a match and of the posterior's other modes around it: poses that are farther than
  /// kMode standard deviations and steps of the grid, and likelier than on the slope of the first mode.
  [[nodiscard]] MotionMatrix<D> with_others(const Match<D>& match, const Pose<D>& guess,
                                            const PoseGrid<D>& grid,
                                            const std::vector<GridPose<D>>& near) const {
    constexpr double kMode = 3.0;
    constexpr double kValley = 1.0;  // Log-likelihood.
    MotionMatrix<D> width = match.covariance;
    width.diagonal() += grid.step.cwiseAbs2();
    const Decomposition inverse(width);
    MotionMatrix<D> others = MotionMatrix<D>::Zero();
    double all = 0.0;
    for (const GridPose<D>& pose : near) {
      const double likely = static_cast<double>(pose.score - match.grid.score) / grid.worth;
      const Motion<D> off = motion_between(match.pose, moved(guess, grid.motion(pose)));
      const double square = off.dot(inverse.solve(off));
      all += std::exp(likely);
      if (square > kMode * kMode && likely > kValley - PriorTail::cost(square))
        others += std::exp(likely) * off * off.transpose();
    }
    return all > 0.0 ? MotionMatrix<D>(match.covariance + others / all) : match.covariance;
  }
  /// Sum of the end points' likelihoods at a pose of a grid, in 255ths.
  [[nodiscard]] std::int64_t likelihood(const Points<D>& points, const Pose<D>& guess,
                                        const PoseGrid<D>& grid, const GridPose<D>& pose) const {
    std::vector<Cell> cells;
    place(points, guess, grid, pose, cells);
    return bound(cells, 0, pose);
  }
  /// Not less than the sum of the likelihoods at any pose in a block.
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
