// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The pose of a scan among surfaces: the best of a window, found surely, and then refined.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/alignment/likelihood_pyramid.hpp"
#include "ndtree/alignment/match_options.hpp"
#include "ndtree/alignment/pose_grid.hpp"
#include "ndtree/alignment/pose_likelihood.hpp"
#include "ndtree/alignment/pose_search.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/alignment/scan_pieces.hpp"
#include "ndtree/alignment/surface_elements.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

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
/// point by a cell at most, are scored by the likelihood of the end points, and PoseSearch finds the best.
/// The refinement is Gauss-Newton on PoseLikelihood, times the prior of the guess. Safe to use from several
/// threads. Cost: O(points of the surface · cells within 3 sigma) to make.
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
    pyramid_.grow_to(PoseSearch<D>::kTop);
  }

  [[nodiscard]] const MatchOptions& options() const { return options_; }
  [[nodiscard]] const SurfaceElements<D>& surface() const { return surface_; }
  [[nodiscard]] const LikelihoodPyramid<D>& pyramid() const { return pyramid_; }

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
                                    std::max(1.0, static_cast<double>(pieces_of(points).count())));
    return grid;
  }
  /// Of one pose: what search() maximises.
  [[nodiscard]] std::int64_t score(const Points<D>& points, const Pose<D>& guess, const PoseGrid<D>& grid,
                                   const GridPose<D>& pose) const {
    const std::vector<std::int32_t> likelihoods = likelihoods_of(points, guess, grid, pose);
    return std::max<std::int64_t>(
        0, std::accumulate(likelihoods.begin(), likelihoods.end(), -grid.penalty(pose)));
  }
  /// The best poses of a grid, the best first, each `apart` from those before it: `most` of them, or as many
  /// as there are. @param near gets the poses that it wants, the best first, if it is given.
  /// @pre the points are finite.
  [[nodiscard]] std::vector<GridPose<D>> search(const Points<D>& points, const Pose<D>& guess,
                                                const PoseGrid<D>& grid, const MatchWindow<D>& window,
                                                std::size_t most = 1, NearPoses<D>* near = nullptr) const {
    return PoseSearch<D>(pyramid_, points, guess, grid, window).best(most, near);
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
    near.margin = static_cast<std::int64_t>((D == 2 ? kLeastLikely : kFarBelow) * grid.worth);
    const std::vector<GridPose<D>> found = search(good, guess, grid, window, wants_second ? 2 : 1, &near);
    Match<D> match = refined(good, guess, grid, found.front(), information);
    if (found.size() > 1 && found[1].score > 0)
      match.second = score(good, moved(guess, grid.motion(found[1])));
    match.covariance =
        with_others(match, guess, grid, near.poses, likely_of(near.poses, match.grid, good, guess, grid));
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
  static constexpr double kMostSteps = PoseSearch<D>::kMostSteps;
  static constexpr double kCellsOfPiece = 4.0;
  // Poses count whose log-likelihood is at most this much less than the best one's; in space, those are
  // looked at that are by the scores' sum.
  static constexpr double kLeastLikely = 5.0;
  static constexpr double kFarBelow = 20.0;

  /// Of a MotionMatrix.
  using Decomposition = Eigen::PartialPivLU<SmallMatrix<kFreedoms<3>>>;

  [[nodiscard]] ScanPieces<D> pieces_of(const Points<D>& points) const {
    return {points, kCellsOfPiece * options_.cell_size};
  }
  [[nodiscard]] static const MatchOptions& validated(const MatchOptions& options) {
    options.validate();
    return options;
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
  /// Of each end point at a pose of a grid, in 255ths.
  [[nodiscard]] std::vector<std::int32_t> likelihoods_of(const Points<D>& points, const Pose<D>& guess,
                                                         const PoseGrid<D>& grid,
                                                         const GridPose<D>& pose) const {
    std::vector<std::int32_t> likelihoods;
    likelihoods.reserve(static_cast<std::size_t>(points.cols()));
    for (Cell cell : cells_of(pyramid_, points, guess, grid, pose)) {
      for (std::size_t a = 0; a < std::size_t{D}; ++a) cell[a] += pose.steps[a];
      likelihoods.push_back(pyramid_.bound(0, cell));
    }
    return likelihoods;
  }
  /// How likely poses are beside the best, as logarithms: in space, as the pieces of the scan tell. In the
  /// plane, few pieces tell much, as the edges of a recess in a long wall: the sum of scores counts.
  [[nodiscard]] std::vector<double> likely_of(const std::vector<GridPose<D>>& poses, const GridPose<D>& best,
                                              const Points<D>& points, const Pose<D>& guess,
                                              const PoseGrid<D>& grid) const {
    std::vector<double> likely;
    if (D == 2) {
      for (const GridPose<D>& pose : poses)
        likely.push_back(static_cast<double>(pose.score - best.score) / grid.worth);
      return likely;
    }
    const ScanPieces<D> pieces = pieces_of(points);
    const std::vector<std::int32_t> of_best = likelihoods_of(points, guess, grid, best);
    Pace pace;
    for (const GridPose<D>& pose : poses) {
      pace.spend(of_best.size());
      const auto prior = static_cast<double>(grid.penalty(best) - grid.penalty(pose)) / grid.worth;
      likely.push_back(prior + pieces.told(of_best, likelihoods_of(points, guess, grid, pose), grid.worth));
    }
    return likely;
  }
  /// The covariance of a match and of the posterior's other modes around it: poses that are farther than
  /// kMode standard deviations and half a step of the grid, and likelier than on the slope of the first mode.
  /// @param likely of the poses near it, from likely_of().
  [[nodiscard]] static MotionMatrix<D> with_others(const Match<D>& match, const Pose<D>& guess,
                                                   const PoseGrid<D>& grid,
                                                   const std::vector<GridPose<D>>& near,
                                                   const std::vector<double>& likely) {
    constexpr double kMode = 3.0;
    constexpr double kValley = 1.0;  // Log-likelihood.
    MotionMatrix<D> width = match.covariance;
    width.diagonal() += 0.25 * grid.step.cwiseAbs2();
    const Decomposition inverse(width);
    MotionMatrix<D> others = MotionMatrix<D>::Zero();
    double all = 0.0;
    for (std::size_t i = 0; i < near.size(); ++i) {
      if (likely[i] < -kLeastLikely) continue;
      const Motion<D> off = motion_between(match.pose, moved(guess, grid.motion(near[i])));
      const double square = off.dot(inverse.solve(off));
      all += std::exp(likely[i]);
      if (square > kMode * kMode && likely[i] > kValley - PriorTail::cost(square))
        others += std::exp(likely[i]) * off * off.transpose();
    }
    return all > 0.0 ? MotionMatrix<D>(match.covariance + others / all) : match.covariance;
  }
  MatchOptions options_;
  SurfaceElements<D> surface_;
  LikelihoodPyramid<D> pyramid_;
};

}  // namespace ndtree
