// SPDX-License-Identifier: BSD-3-Clause
// How probable it is that a scan's points moved, told while it is inserted: against a slow rule, point by
// point.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "ndtree/io/map_file.hpp"
#include "ndtree/logs/simulator.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"

namespace ndtree::test::test_moved_points {
namespace {

/// The rule as it is said: one minus the largest probability of the cell and the cells beside it; cells that
/// may hold something thin count 0.5 at least, cells beside it that the last scan passed 0.5 at most. 0.5 at
/// most while a cell with evidence remembers that a beam ended in it, and 0.5 of what is unknown or may have
/// left.
template <class Map>
float expected(const Map& map, const Vector<Map::kDim>& point) {
  constexpr int D = Map::kDim;
  const MapOptions& options = map.options();
  const double reach = options.min_cell_size + 3.0 * options.range_sigma;
  auto most = static_cast<float>(probability(map, point));
  if (most == 0.5F || most >= 0.6F) return 1.0F - most;
  const auto take = [&](float p) {
    if (p >= static_cast<float>(options.partial_probability - 1e-4)) p = std::max(p, 0.5F);
    most = std::max(most, p);
  };
  take(most);
  if constexpr (std::is_same_v<typename Map::Cell, EvidenceCell>) {
    const EvidenceCell cell = cell_at(map, point);
    const std::uint32_t passes = cell.streak_is_of_hits() ? 0 : cell.streak();
    if (cell.hits() > 0 && cell.probability() < 0.5) {
      if (passes >= std::min(cell.hits() + 1, 3U)) return 0.5F;
      take(0.5F);
    }
  }
  const auto ask = [&](const Vector<D>& step) {
    const auto cell = cell_at(map, Vector<D>(point + step));
    auto p = static_cast<float>(cell.probability());
    if constexpr (std::is_same_v<typename Map::Cell, EvidenceCell>)
      if (!cell.streak_is_of_hits() && cell.streak() > 0) p = std::min(p, 0.5F);
    take(p);
  };
  for (int axis = 0; axis < D; ++axis)
    for (const double side : {-1.0, -0.5, 0.5, 1.0}) ask(Vector<D>(side * reach * Vector<D>::Unit(axis)));
  for (int corner = 0; corner < 1 << D; ++corner) {
    Vector<D> step = Vector<D>::Constant(0.5 * reach);
    for (int axis = 0; axis < D; ++axis)
      if ((corner >> axis & 1) != 0) step[axis] = -step[axis];
    ask(step);
  }
  return 1.0F - most;
}

template <class Map>
class MovedPointsTest : public ::testing::Test {};
using Maps = ::testing::Types<AdaptiveMap<2, 3>, FixedMap<2, 2>>;
TYPED_TEST_SUITE(MovedPointsTest, Maps);

auto log_of(std::integral_constant<int, 2> /*dim*/, const SimulationOptions& options) {
  return simulate_office(options);
}
auto log_of(std::integral_constant<int, 3> /*dim*/, const SimulationOptions& options) {
  return simulate_apartment(options);
}

TYPED_TEST(MovedPointsTest, AReportHasWhatTheMapSaidBefore) {
  constexpr int D = TypeParam::kDim;
  constexpr double kMaxRange = 6.0;
  SimulationOptions simulation;
  simulation.seed = 811;
  simulation.scans = D == 2 ? 120 : 14;
  simulation.people = 4;
  const auto log = log_of(std::integral_constant<int, D>(), simulation);
  MapOptions options;
  options.range_sigma = 0.02;
  TypeParam map(options);
  TypeParam with_threads(options);
  TypeParam plain(options);
  std::size_t returned = 0;
  std::size_t above = 0;
  std::size_t others = 0;
  for (std::size_t i = 0; i < log.size(); ++i) {
    const Scan<D> scan = log.scan(i);
    const TypeParam before = map.snapshot();
    const InsertReport report = map.insert(scan, kMaxRange, 1, std::nullopt, true);
    ASSERT_TRUE(report.moved);
    ASSERT_EQ(report.moved->size(), static_cast<std::size_t>(scan.size()));
    EXPECT_EQ(with_threads.insert(scan, kMaxRange, 3, std::nullopt, true).moved, report.moved);
    EXPECT_FALSE(plain.insert(scan, kMaxRange, 1).moved) << "nobody asked";
    const std::vector<float> of_points = probability_moved(before, scan.endpoints);
    for (Eigen::Index k = 0; k < scan.size(); ++k) {
      const float told = (*report.moved)[static_cast<std::size_t>(k)];
      const double range = (scan.endpoints.col(k) - scan.origins.col(0)).norm();
      if (!scan.returned[k] || !(range <= kMaxRange)) {
        ++others;
        EXPECT_EQ(told, 0.5F);
        continue;
      }
      ++returned;
      above += told > 0.5F ? 1 : 0;
      EXPECT_EQ(told, expected(before, scan.endpoints.col(k)));
      EXPECT_EQ(told, of_points[static_cast<std::size_t>(k)]);
    }
  }
  EXPECT_EQ(to_bytes(map), to_bytes(plain)) << "asking changes nothing";
  EXPECT_EQ(to_bytes(map), to_bytes(with_threads));
  EXPECT_GT(returned, 10'000U);
  EXPECT_GT(others, 100U);
  EXPECT_GT(above, returned / 100) << "some walked through space that was free";
  EXPECT_LT(above, returned / 5);
}

TEST(MovedPoints, OfAFreeCellInWhichABeamEndedNothingIsSaid) {
  // A post of 1 cm that one beam in ten meets, then one that never was: most of both cells' beams pass.
  MapOptions options;
  options.range_sigma = 0.01;
  AdaptiveMap<2, 2> map(options);
  Scan<2> scan;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, 40);
  const Vector<2> post(2.02, 0.02);
  for (int i = 0; i < 60; ++i) {
    for (int k = 0; k < 40; ++k) scan.endpoints.col(k) = Vector<2>(4.0, 4.0 * (0.008 * (k - 20) + 0.0003));
    if (i % 10 == 0) scan.endpoints.col(25) = post + Vector<2>(1e-3 * i / 10, 0.0);  // Samples differ.
    map.insert(scan);
  }
  const Vector<2> beside(2.02, -0.18);
  ASSERT_LT(probability(map, beside), 0.2);
  Points<2> points(2, 2);
  points << post[0], beside[0], post[1], beside[1];
  const std::vector<float> moved = probability_moved(map, points);
  EXPECT_LE(moved[0], 0.5F);
  EXPECT_GT(cell_at(map, post).hits(), 0U);
  EXPECT_GT(moved[1], 0.5F);
}

TEST(MovedPoints, ASurfaceInTheNextCellExplainsAPointUntilAsManyScansPassed) {
  // A wall in the cell behind x = 2 m; every third scan some points before it, for a while.
  MapOptions options;
  options.range_sigma = 0.01;
  AdaptiveMap<2, 2> map(options);
  const Vector<2> point(1.98, 0.02);
  const auto look = [&](bool has_point) {
    Scan<2> scan;
    scan.origins = Vector<2>(0.0, 0.0);
    scan.endpoints.resize(2, 41);
    for (int k = 0; k < 41; ++k) scan.endpoints.col(k) = Vector<2>(2.03, 2.03 * 0.01 * (k - 20) + 0.001);
    for (int k = 20; has_point && k < 23; ++k) scan.endpoints(0, k) = point[0];
    map.insert(scan);
  };
  const Points<2> points = point;
  for (int i = 0; i < 40; ++i) look(i % 3 == 0);
  ASSERT_LT(probability(map, point), 0.5);
  ASSERT_GT(cell_at(map, point).hits(), 0U);
  EXPECT_LT(probability_moved(map, points)[0], 0.4F);
  for (int i = 0; i < 30; ++i) look(false);
  ASSERT_GT(cell_at(map, point).hits(), 0U);
  EXPECT_EQ(probability_moved(map, points)[0], 0.5F) << "it may have left";
}

TEST(MovedPoints, WhatIsUnknownSaysNothingAndWrongCallsChangeNothing) {
  AdaptiveMap<2, 2> map;
  Scan<2> scan;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, 3);
  scan.endpoints << 1.0, std::nan(""), 0.0, 1.0, 0.0, 0.0;
  const auto first = map.insert(scan, kUnlimitedRange, 1, std::nullopt, true);
  EXPECT_EQ(*first.moved, std::vector<float>(3, 0.5F));
  const std::string before = to_bytes(map);
  EXPECT_THROW((void)map.insert(scan, -1.0, 1, std::nullopt, true), std::invalid_argument);
  EXPECT_THROW((void)map.insert(scan, std::nan(""), 1, std::nullopt, true), std::invalid_argument);
  EXPECT_THROW((void)map.insert(scan, kUnlimitedRange, -1, std::nullopt, true), std::invalid_argument);
  EXPECT_EQ(to_bytes(map), before);
  scan.endpoints.resize(2, 0);
  const auto empty = map.insert(scan, kUnlimitedRange, 1, std::nullopt, true);
  ASSERT_TRUE(empty.moved);
  EXPECT_TRUE(empty.moved->empty());
}

}  // namespace
}  // namespace ndtree::test::test_moved_points
