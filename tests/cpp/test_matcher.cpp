// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A match is the best pose of its window, and refining it finds where the scan was.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <stdexcept>
#include <vector>

#include "ndtree/alignment/block_queue.hpp"
#include "ndtree/alignment/likelihood_pyramid.hpp"
#include "ndtree/alignment/likelihood_windows.hpp"
#include "ndtree/alignment/matcher.hpp"
#include "ndtree/alignment/pose_grid.hpp"
#include "ndtree/alignment/pose_search.hpp"
#include "ndtree/alignment/surface_elements.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/match.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test::test_matcher {
namespace {

template <int D>
Motion<D> random_motion(Random& random, double reach, double angle) {
  Motion<D> motion;
  for (int a = 0; a < kFreedoms<D>; ++a) motion[a] = random.uniform(-1.0, 1.0) * (a < D ? reach : angle);
  return motion;
}

template <int D>
Points<D> random_points(Random& random, int count, double reach) {
  Points<D> points(D, count);
  for (Eigen::Index i = 0; i < points.size(); ++i) points(i) = random.uniform(-reach, reach);
  return points;
}

/// The likelihood of a point among others, as its definition says.
template <int D>
std::int64_t likelihood(const Points<D>& surface, const LikelihoodPyramid<D>& pyramid, double sigma,
                        const typename LikelihoodPyramid<D>::Cell& cell) {
  double nearest = std::numeric_limits<double>::infinity();
  for (Eigen::Index i = 0; i < surface.cols(); ++i) {
    double square = 0.0;
    for (int a = 0; a < D; ++a) {
      const double centre =
          pyramid.lower()[a] + (cell[static_cast<std::size_t>(a)] + 0.5) * pyramid.cell_size();
      square += (centre - surface(a, i)) * (centre - surface(a, i));
    }
    nearest = std::min(nearest, square);
  }
  if (nearest >= 9.0 * sigma * sigma) return 0;
  return std::lround(255.0 * std::exp(-0.5 * nearest / (sigma * sigma)));
}

/// All poses of a grid, one after the other.
template <int D>
GridPose<D> best_of_all(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& guess,
                        const PoseGrid<D>& grid, const MatchWindow<D>& window,
                        const std::vector<GridPose<D>>& excepted) {
  GridPose<D> best;
  GridPose<D> pose;
  for (std::size_t a = 0; a < pose.steps.size(); ++a) pose.steps[a] = -grid.count[a];
  for (;;) {
    bool is_other = true;
    for (const GridPose<D>& except : excepted) {
      bool is_apart = false;
      for (std::size_t a = 0; a < pose.steps.size() && !is_apart; ++a) {
        const double apart = a < std::size_t{D} ? window.apart : window.apart_angle;
        is_apart = std::abs(pose.steps[a] - except.steps[a]) * grid.step[static_cast<int>(a)] >=
                   apart * (1.0 - 1e-9);
      }
      is_other = is_other && is_apart;
    }
    if (is_other) {
      pose.score = matcher.score(points, guess, grid, pose);
      if (pose.is_better_than(best)) best = pose;
    }
    std::size_t a = 0;
    for (; a < pose.steps.size(); ++a) {
      if (++pose.steps[a] <= grid.count[a]) break;
      pose.steps[a] = -grid.count[a];
    }
    if (a == pose.steps.size()) return best;
  }
}

template <int D>
void search_is_exhaustive(int cases, double reach, double angle) {
  Random random(D == 2 ? 11 : 12);
  int with_points = 0;
  int with_others = 0;
  int with_prior = 0;
  int with_windows = 0;
  for (int i = 0; i < cases; ++i) {
    MatchOptions options;
    options.cell_size = random.uniform(0.08, 0.2);
    options.sigma = random.uniform(0.5, 1.5) * options.cell_size;
    const Matcher<D> matcher(random_points<D>(random, random.integer(0, 60), 1.5), options);
    const Points<D> points = random_points<D>(random, random.integer(0, 25), 1.0);
    const Pose<D> guess = moved(Pose<D>{}, random_motion<D>(random, 0.5, 3.0));
    MatchWindow<D> window;
    window.half = random_motion<D>(random, reach, angle).cwiseAbs();
    window.apart = random.uniform(0.1, 0.6);
    window.apart_angle = random.uniform(0.1, 0.6);
    PoseGrid<D> grid = matcher.grid_of(points, window.half);
    if (i % 2 == 0) {  // A guess that is known beforehand, also in directions beside the axes.
      const MotionMatrix<D> root = MotionMatrix<D>::NullaryExpr([&] { return random.uniform(-2.0, 2.0); });
      grid.set_prior(root * root.transpose(), 255.0);
      with_prior += grid.prior.isZero() ? 0 : 1;
    }
    PoseSearch<D> search(matcher.pyramid(), points, guess, grid, window, i % 3 == 0 ? 0.0 : 1e9);
    with_windows += search.has_windows() ? 1 : 0;
    const std::vector<GridPose<D>> found = search.best(3);
    std::vector<GridPose<D>> before;
    for (const GridPose<D>& one : found) {
      const GridPose<D> expected = best_of_all<D>(matcher, points, guess, grid, window, before);
      ASSERT_EQ(one.score, expected.score) << "case " << i << ", after " << before.size();
      if (one.score > 0) {
        ASSERT_EQ(one.steps, expected.steps) << "case " << i << ", after " << before.size();
        ++(before.empty() ? with_points : with_others);
      }
      before.push_back(one);
    }
    if (found.size() < 3) {
      ASSERT_LE(best_of_all<D>(matcher, points, guess, grid, window, before).score, 0) << "case " << i;
    }
  }
  EXPECT_GT(with_points, cases / 2);
  EXPECT_GT(with_others, cases / 4);
  EXPECT_EQ(with_prior, (cases + 1) / 2);
  EXPECT_GT(with_windows, cases / 5);
  EXPECT_LT(with_windows, cases - cases / 5);
}

TEST(Matcher, SearchFindsTheBestOfAllPosesInThePlane) { search_is_exhaustive<2>(1500, 1.2, 0.4); }
TEST(Matcher, SearchFindsTheBestOfAllPosesInSpace) { search_is_exhaustive<3>(200, 0.35, 0.12); }

template <int D>
void bounds_are_maxima(int cases) {
  Random random(D == 2 ? 21 : 22);
  int likely = 0;
  for (int i = 0; i < cases; ++i) {
    const double size = random.uniform(0.05, 0.2);
    const double sigma = random.uniform(0.4, 2.0) * size;
    const Points<D> surface = random_points<D>(random, random.integer(1, 8), 0.6);
    LikelihoodPyramid<D> pyramid(surface, size, sigma);
    pyramid.grow_to(4);
    for (int k = 0; k < 20; ++k) {
      const auto cell = pyramid.cell_of(random_points<D>(random, 1, 1.5).col(0));
      ASSERT_NEAR(static_cast<double>(pyramid.bound(0, cell)),
                  static_cast<double>(likelihood(surface, pyramid, sigma, cell)), 1.0);
      const int level = random.integer(1, 4);
      const std::int32_t bound = pyramid.bound(level, cell);
      for (int j = 0; j < 10; ++j) {
        auto inside = cell;
        for (auto& c : inside) c += random.integer(0, (1 << level) - 1);
        ASSERT_LE(pyramid.bound(0, inside), bound) << "level " << level;
        likely += pyramid.bound(0, inside) > 0 ? 1 : 0;
      }
      // What a block reaches is not more than 1.5 times as long: beyond, nothing counts.
      std::int32_t most = 0;
      const std::int32_t step = level == 1 ? 1 : 1 << (level - 1);
      auto first = cell;
      for (auto& c : first) c = static_cast<std::int32_t>(std::floor(static_cast<double>(c) / step)) * step;
      auto at = first;
      const std::int32_t length = level == 1 ? 2 : 3 * step - 1;
      for (;;) {
        most = std::max(most, pyramid.bound(0, at));
        std::size_t a = 0;
        for (; a < at.size(); ++a) {
          if (++at[a] < first[a] + length) break;
          at[a] = first[a];
        }
        if (a == at.size()) break;
      }
      ASSERT_EQ(bound, most) << "level " << level;
    }
  }
  EXPECT_GT(likely, cases);
}

TEST(LikelihoodPyramid, LevelsAreMaximaInThePlane) { bounds_are_maxima<2>(200); }
TEST(LikelihoodPyramid, LevelsAreMaximaInSpace) { bounds_are_maxima<3>(15); }

template <int D>
void windows_are_maxima(int cases) {
  using Cell = typename LikelihoodPyramid<D>::Cell;
  Random random(D == 2 ? 23 : 24);
  int likely = 0;
  for (int i = 0; i < cases; ++i) {
    const double size = random.uniform(0.05, 0.2);
    const LikelihoodPyramid<D> pyramid(random_points<D>(random, random.integer(1, 8), 0.6), size, size);
    Cell lower;
    Cell upper;
    for (std::size_t a = 0; a < std::size_t{D}; ++a) {
      lower[a] = random.integer(-10, 10);
      upper[a] = lower[a] + random.integer(0, 20);
    }
    const LikelihoodWindows<D> windows(pyramid, lower, upper, 4);
    for (int k = 0; k < 20; ++k) {
      const int level = random.integer(0, 4);
      Cell first;
      for (std::size_t a = 0; a < std::size_t{D}; ++a) first[a] = random.integer(lower[a], upper[a]);
      std::int32_t most = 0;
      for (int cell = 0; cell < 1 << (level * D); ++cell) {
        Cell at = first;
        bool is_inside = true;
        for (std::size_t a = 0; a < std::size_t{D}; ++a) {
          at[a] += cell >> (level * static_cast<int>(a)) & ((1 << level) - 1);
          is_inside = is_inside && at[a] <= upper[a];
        }
        if (is_inside) most = std::max(most, pyramid.bound(0, at));
      }
      ASSERT_EQ(windows.level(level)[windows.number_of(first)], most) << "case " << i << ", level " << level;
      likely += most > 0 ? 1 : 0;
    }
  }
  EXPECT_GT(likely, cases);
}

TEST(LikelihoodWindows, LevelsAreMaximaInThePlane) { windows_are_maxima<2>(200); }
TEST(LikelihoodWindows, LevelsAreMaximaInSpace) { windows_are_maxima<3>(30); }

/// Bounds of more points than there are lists for: a list has a range of them.
TEST(BlockQueue, GivesTheLargestFirst) {
  Random random(25);
  for (const std::int64_t largest : {std::int64_t{50}, std::int64_t{1} << 30}) {
    BlockQueue<2> queue(largest);
    std::multiset<std::int64_t> bounds;
    for (int i = 0; i < 2000; ++i) {
      if (i % 3 != 2) {
        PoseBlock<2> block;
        block.bound =
            i % 7 == 0 ? 0 : static_cast<std::int64_t>(random.uniform(0.0, static_cast<double>(largest)));
        queue.push(block);
        bounds.insert(block.bound);
        continue;
      }
      const std::int64_t bound = queue.bound();
      ASSERT_GE(bound, *bounds.rbegin());
      if (largest == 50) {
        ASSERT_EQ(bound, *bounds.rbegin());
      }
      const PoseBlock<2> popped = queue.pop();
      ASSERT_LE(popped.bound, bound);
      ASSERT_GE(popped.bound + largest / 1000, bound);
      const auto kept = bounds.find(popped.bound);
      ASSERT_NE(kept, bounds.end());
      bounds.erase(kept);
    }
    while (!bounds.empty()) {
      ASSERT_GE(queue.bound(), *bounds.rbegin());
      bounds.erase(bounds.find(queue.pop().bound));
    }
    EXPECT_EQ(queue.bound(), -1);
  }
}

/// A wall at 45 degrees is one cell in each row along an axis: they err alike, as the cells of a level wall
/// do.
TEST(SurfaceElements, CellsOfADiagonalWallAreOnePiece) {
  MatchOptions options;
  options.cell_size = 0.05;
  options.radius = 0.5;
  for (const double slope : {1.0, -1.0, 0.0}) {
    SurfacePoints<2> cells{Points<2>(2, 80), Points<2>(2, 80), options.cell_size};
    for (int i = 0; i < 80; ++i) {
      const double along = (i % 40 + 0.5) * options.cell_size;
      const double apart = i < 40 ? 0.0 : 3.0;  // Two walls side by side.
      cells.points.col(i) << along, slope * along + apart + (slope == 0.0 ? 0.025 : 0.0);
      cells.sides.col(i) << -slope, 1.0;
    }
    const SurfaceElements<2> surface(cells, options);
    ASSERT_EQ(surface.shapes.size(), 80u);
    std::set<std::int32_t> pieces;
    for (const SurfaceShape<2>& shape : surface.shapes) {
      ASSERT_TRUE(shape.is_flat);
      EXPECT_EQ(shape.direction >= 2, slope != 0.0);
      pieces.insert(shape.piece);
    }
    EXPECT_EQ(pieces.size(), 2u) << "slope " << slope;
  }
}

/// Where rings lie on the ground, only beams end: they do not tell how far a scan is along; thin bars do.
TEST(SurfaceElements, RingsOnTheGroundTellNoPlaceAlong) {
  constexpr double kCell = 0.1;
  MatchOptions options;
  options.cell_size = options.sigma = kCell;
  options.radius = 10 * kCell;
  for (const bool are_bars : {false, true}) {
    SurfacePoints<3> cells{Points<3>(3, 600), Points<3>(3, 600), kCell, Points<3>(3, 600)};
    for (int i = 0; i < 600; ++i) {
      cells.points.col(i) << 1.5 * (i / 100) + 0.05, (i % 100 - 49.5) * kCell, 0.05;
      cells.sides.col(i) << 0.0, 0.0, 1.0;
      cells.open.col(i) << (are_bars ? 1.0 : 0.0), 0.0, 1.0;
    }
    MotionMatrix<3> known = MotionMatrix<3>::Identity();
    known.diagonal() << 25.0, 25.0, 25.0, 1e4, 1e4, 1e4;
    Match<3> match;
    Matcher<3>(cells, options).refine(cells.points, Pose<3>{}, Pose<3>{}, known, match);
    if (are_bars)
      EXPECT_LT(match.covariance(0, 0), 0.1 / 25.0);
    else
      EXPECT_NEAR(match.covariance(0, 0), 1.0 / 25.0, 0.01 / 25.0);
    EXPECT_LT(match.covariance(2, 2), 0.1 / 25.0);
  }
}

/// Far along a corridor, cells of its wall are single: they do not tell how far a scan is along; posts do.
TEST(SurfaceElements, SingleCellsOfAWallTellNoPlaceAlong) {
  constexpr double kCell = 0.05;
  constexpr auto kFree = static_cast<std::int8_t>(CellState::free);
  constexpr auto kUnknown = static_cast<std::int8_t>(CellState::unknown);
  for (const bool are_posts : {false, true}) {
    SurfaceOfBoxes<2> boxes(kCell);
    std::vector<std::int8_t> states;
    for (int i = 0; i < 20; ++i) {
      boxes.add({Vector<2>(3.0 * i, 0.0), Vector<2>(3.0 * i + kCell, kCell)});
      states.insert(states.end(), {kFree, are_posts ? kFree : kUnknown, kFree, kFree});
    }
    const SurfacePoints<2> cells = boxes.surface(states);
    const MotionMatrix<2> known = Motion<2>(25.0, 25.0, 1e4).asDiagonal();
    Match<2> match;
    Matcher<2>(cells).refine(cells.points, Pose<2>{}, Pose<2>{}, known, match);
    if (are_posts)
      EXPECT_LT(match.covariance(0, 0), 0.1 / 25.0);
    else
      EXPECT_NEAR(match.covariance(0, 0), 1.0 / 25.0, 0.01 / 25.0);
    EXPECT_LT(match.covariance(1, 1), 0.1 / 25.0);
  }
}

/// The walls of a room that looks different from everywhere.
template <int D>
Points<D> room(double spacing) {
  std::vector<Vector<D>> all;
  const auto wall = [&](double x, double y, double to_x, double to_y, double to_z = 2.5) {
    const double length = std::max(std::hypot(to_x - x, to_y - y), spacing);
    const int along = static_cast<int>(std::ceil(length / spacing));
    const int up = D == 3 ? std::max(1, static_cast<int>(std::ceil(to_z / spacing))) : 1;
    for (int i = 0; i < along; ++i)
      for (int k = 0; k < up; ++k) {
        Vector<D> point = Vector<D>::Zero();
        point.template head<2>() << x + (to_x - x) * (i + 0.5) / along, y + (to_y - y) * (i + 0.5) / along;
        if constexpr (D == 3) point[2] = to_z * (k + 0.5) / up;
        all.push_back(point);
      }
  };
  wall(-4.0, -3.0, 5.0, -3.0);
  wall(-4.0, -3.0, -4.0, 3.5);
  wall(5.0, -3.0, 5.0, 3.5);
  wall(-4.0, 3.5, 1.0, 3.5);
  wall(2.0, 3.5, 5.0, 3.5);
  wall(2.0, 1.5, 2.0, 3.5);
  if constexpr (D == 3)
    for (double y = -3.0 + 0.5 * spacing; y < 3.5; y += spacing) wall(-4.0, y, 5.0, y, 0.0);
  Points<D> points(D, static_cast<Eigen::Index>(all.size()));
  for (std::size_t i = 0; i < all.size(); ++i) points.col(static_cast<Eigen::Index>(i)) = all[i];
  return points;
}

/// What a scan at a pose sees of points, with noise.
template <int D>
Points<D> seen_from(const Points<D>& surface, const Pose<D>& pose, double sigma, Random& random) {
  Points<D> points = pose.rotation.transpose() * (surface.colwise() - pose.translation);
  for (Eigen::Index i = 0; i < points.size(); ++i) points(i) += random.uniform(-1.7, 1.7) * sigma;
  return points;
}

TEST(Matcher, FindsScansOfARoomInThePlane) {
  Random random(31);
  const Matcher<2> matcher(room<2>(0.02));
  const Points<2> seen = room<2>(0.11);
  int unique = 0;
  double worst = 0.0;
  for (int i = 0; i < 50; ++i) {
    const Pose<2> pose = moved(Pose<2>{}, random_motion<2>(random, 1.0, 3.1));
    const Points<2> points = seen_from<2>(seen, pose, 0.01, random);
    MatchWindow<2> window;
    window.half << 1.0, 1.0, 0.35;
    const Match<2> match = matcher.match(points, moved(pose, random_motion<2>(random, 0.95, 0.33)), window);
    const Motion<2> off = motion_between(pose, match.pose);
    worst = std::max(worst, off.head<2>().norm());
    EXPECT_LT(off.head<2>().norm(), 0.01);
    EXPECT_LT(std::abs(off[2]), 0.003);
    EXPECT_GT(match.inliers, 0.9);
    // Within five standard deviations, which the covariance knows.
    EXPECT_LT(off.dot(match.covariance.inverse() * off), 25.0 * 3.0);
    unique += match.is_unique() ? 1 : 0;
  }
  EXPECT_GT(worst, 0.0);
  EXPECT_EQ(unique, 50);
}

TEST(Matcher, FindsScansOfARoomInSpace) {
  Random random(32);
  MatchOptions options;
  options.cell_size = options.sigma = 0.1;
  options.radius = 0.3;
  const Matcher<3> matcher(room<3>(0.08), options);
  const Points<3> seen = room<3>(0.6);
  for (int i = 0; i < 3; ++i) {
    const Pose<3> pose = moved(Pose<3>{}, random_motion<3>(random, 1.0, 0.5));
    const Points<3> points = seen_from<3>(seen, pose, 0.01, random);
    MatchWindow<3> window;
    window.half << 0.3, 0.3, 0.2, 0.04, 0.04, 0.1;
    const Match<3> match = matcher.match(points, moved(pose, Motion<3>(0.8 * window.half)), window);
    const Motion<3> off = motion_between(pose, match.pose);
    EXPECT_LT(off.head<3>().norm(), 0.02);
    EXPECT_LT(off.tail<3>().norm(), 0.01);
  }
}

TEST(Matcher, ACorridorIsNotUnique) {
  Points<2> walls(2, 1000);
  for (int i = 0; i < 500; ++i) {
    walls.col(2 * i) << 0.04 * i - 10.0, -1.0;
    walls.col(2 * i + 1) << 0.04 * i - 10.0, 1.0;
  }
  const Matcher<2> matcher(walls);
  Points<2> points(2, 60);
  for (int i = 0; i < 60; ++i) points.col(i) << 0.1 * (i / 2) - 1.5, i % 2 == 0 ? -1.0 : 1.0;
  MatchWindow<2> window;
  window.half << 2.0, 0.3, 0.2;
  const Match<2> match = matcher.match(points, Pose<2>{}, window);
  EXPECT_FALSE(match.is_unique());
  // Along the corridor nothing is known, across it much.
  EXPECT_GT(match.covariance(0, 0), 100.0 * match.covariance(1, 1));
  // A guess that is known along it stays there.
  MotionMatrix<2> information = MotionMatrix<2>::Zero();
  information(0, 0) = 1e4;
  window.half << 0.0, 0.3, 0.2;
  const Match<2> known = matcher.match(points, Pose<2>{}, window, information);
  EXPECT_NEAR(known.pose.translation[0], 0.0, 0.01);
  EXPECT_LT(known.covariance(0, 0), 1.1e-4);
}

TEST(Matcher, AnotherPlaceThatFitsAsWellWidensTheCovariance) {
  constexpr double kApart = 0.8;
  Points<2> surface(2, 600), points(2, 110);
  for (int i = 0; i < 400; ++i) surface.col(i) << 0.02 * i - 4.0, 1.0;
  for (int i = 0; i < 200; ++i) surface.col(400 + i) << (i % 2) * kApart, 0.02 * (i / 2) - 1.0;
  for (int i = 0; i < 60; ++i) points.col(i) << 0.05 * i - 1.5, 1.0;
  for (int i = 0; i < 50; ++i) points.col(60 + i) << 0.0, 0.04 * i - 1.0;  // One of two walls.
  const Matcher<2> matcher(surface);
  MatchWindow<2> window;
  window.half << 0.75 * kApart, 0.2, 0.05;
  EXPECT_LT(matcher.match(points, Pose<2>{}, window).covariance(0, 0), 1e-4);
  window.half[0] = 1.5 * kApart;
  const Match<2> match = matcher.match(points, Pose<2>{}, window);
  EXPECT_NEAR(match.covariance(0, 0), 0.5 * kApart * kApart, 0.1 * kApart * kApart) << "half is there";
  EXPECT_LT(match.covariance(1, 1), 1e-3);
}

TEST(Matcher, FindsScansInAMap) {
  Random random(41);
  MapOptions map_options = spelled_out_options(0.05, 0.8);
  AdaptiveMap<2, 2> map(map_options);
  const Points<2> surface = room<2>(0.02);
  Scan<2> scan;
  scan.origins = Eigen::Vector2d(0.5, -0.5);
  scan.endpoints = surface;
  for (int i = 0; i < 5; ++i) map.insert(scan);
  const Pose<2> pose = moved(Pose<2>{}, Motion<2>(0.3, -0.2, 0.4));
  MatchWindow<2> window;
  window.half << 0.5, 0.5, 0.2;
  const Match<2> match = ndtree::match(map, seen_from<2>(room<2>(0.1), pose, 0.01, random),
                                       moved(pose, Motion<2>(0.3, 0.3, -0.15)), window);
  const Motion<2> off = motion_between(pose, match.pose);
  EXPECT_LT(off.head<2>().norm(), 0.03);  // Walls are cells of 0.05 m.
  EXPECT_LT(std::abs(off[2]), 0.01);
  EXPECT_TRUE(match.is_unique());
}

TEST(Matcher, NothingMatchesNothing) {
  const Matcher<2> empty((Points<2>(2, 0)));
  MatchWindow<2> window;
  window.half << 5.0, 5.0, 1.0;
  Points<2> points(2, 2);
  points << 1.0, std::numeric_limits<double>::quiet_NaN(), 2.0, 0.0;
  const Match<2> match = empty.match(points, Pose<2>{}, window);
  EXPECT_EQ(match.score, 0.0);
  EXPECT_FALSE(match.is_unique());
  EXPECT_EQ(match.inliers, 0.0);
  EXPECT_EQ(Matcher<2>::finite(points).cols(), 1);
}

TEST(Matcher, RefusesWhatIsOutOfBounds) {
  MatchOptions options;
  options.cell_size = 0.0;
  EXPECT_THROW(Matcher<2>(room<2>(0.5), options), std::invalid_argument);
  options.cell_size = 1e-4;
  EXPECT_THROW(Matcher<2>(room<2>(0.5), options), std::invalid_argument);  // More than 2^24 bricks.
  const Matcher<2> matcher(room<2>(0.5));
  MatchWindow<2> window;
  window.half << -1.0, 0.0, 0.0;
  EXPECT_THROW((void)matcher.match(room<2>(0.5), Pose<2>{}, window), std::invalid_argument);
  window.half << 1e6, 0.0, 0.0;
  EXPECT_THROW((void)matcher.match(room<2>(0.5), Pose<2>{}, window), std::invalid_argument);
}

}  // namespace
}  // namespace ndtree::test::test_matcher
