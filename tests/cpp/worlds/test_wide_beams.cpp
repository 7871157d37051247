// SPDX-License-Identifier: BSD-3-Clause
// Sonar: the surface that a beam meets lies somewhere across a cone.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <string>

#include "ndtree/core/scan.hpp"
#include "ndtree/map.hpp"
#include "ndtree/query/point.hpp"
#include "support/random.hpp"

namespace ndtree::test::test_wide_beams {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDivergence = 0.26;  // 15 degrees.
constexpr double kRoom = 4.0;         // From the middle of the room to each wall [m].

MapOptions options(double divergence) {
  MapOptions options;
  options.min_cell_size = 0.05;
  options.max_cell_size = 1.6;
  options.range_sigma = 0.02;
  options.beam_divergence = divergence;
  return options;
}
/// Where a ray meets a wall of the room, or a pillar of 0.5 m in it.
double distance(const Vector<2>& origin, double angle) {
  const Vector<2> d(std::cos(angle), std::sin(angle));
  double range = HUGE_VAL;
  double enter = 0.0;
  double exit = HUGE_VAL;
  for (int a = 0; a < 2; ++a) {
    range = std::min(range, ((d[a] > 0.0 ? kRoom : -kRoom) - origin[a]) / d[a]);
    const double lower = (1.0 - origin[a]) / d[a];
    const double upper = (1.5 - origin[a]) / d[a];
    enter = std::max(enter, std::min(lower, upper));
    exit = std::min(exit, std::max(lower, upper));
  }
  return enter < exit ? std::min(range, enter) : range;
}
/// A ring of sonars: each says how near the nearest surface in its cone is.
Scan<2> sonars(Random& random, const Vector<2>& origin, double heading) {
  Scan<2> scan;
  scan.origins = origin;
  scan.endpoints.resize(2, 24);
  for (int i = 0; i < 24; ++i) {
    const double axis = heading + 2.0 * kPi * (i + 0.01) / 24.0;
    double range = HUGE_VAL;
    for (int k = -8; k <= 8; ++k) range = std::min(range, distance(origin, axis + kDivergence / 16.0 * k));
    range += 0.02 * random.uniform(-1.0, 1.0);
    scan.endpoints.col(i) = origin + range * Vector<2>(std::cos(axis), std::sin(axis));
  }
  return scan;
}

TEST(WideBeams, AreWorthTheirCoveredPart) {
  const BeamSensorModel model{SensorOptions(options(kDivergence))};
  EXPECT_FALSE(BeamSensorModel{SensorOptions{}}.has_cone());
  EXPECT_NEAR(model.cone_width(2.0f), 4.0 * std::tan(0.13), 1e-6);
  EXPECT_FLOAT_EQ(BeamWeight::covered_part<3>(0.1f, 0.4f), 1.0f / 16.0f);
  EXPECT_FLOAT_EQ(BeamWeight::covered_part<2>(0.1f, 0.4f), 0.25f);
  EXPECT_FLOAT_EQ(BeamWeight::covered_part<3>(0.4f, 0.1f), 1.0f);
  EXPECT_FLOAT_EQ(BeamWeight::covered_part<3>(0.4f, 0.0f), 1.0f) << "a laser";
}

/// A robot with sonars drives through a room: its map says more that is true if it knows how wide they are,
/// and has as much of the walls.
TEST(WideBeams, MakeATruerMapWhereTheirWidthIsKnown) {
  for (const int scans : {50, 200, 800}) {
    Random random(2601);
    SCOPED_TRACE(random.trace() + ", " + std::to_string(scans) + " scans");
    std::array<AdaptiveMap<2, 2>, 2> maps{AdaptiveMap<2, 2>(options(kDivergence)),
                                          AdaptiveMap<2, 2>(options(0.0))};
    for (int k = 0; k < scans; ++k) {
      const double way = 2.0 * kPi * k / scans;
      const Scan<2> scan =
          sonars(random, Vector<2>(2.6 * std::cos(way) + 0.01, 2.6 * std::sin(way) + 0.02), 0.37 * k);
      for (auto& map : maps) map.insert(scan);
    }
    std::array<double, 2> score{};  // Of free space at least 0.1 m from each surface.
    std::array<std::size_t, 2> wrong{};
    for (int i = 0; i < 10'000; ++i) {
      const Vector<2> point(random.uniform(-3.9, 3.9), random.uniform(-3.9, 3.9));
      if ((point.array() > 0.9 && point.array() < 1.6).all()) continue;
      for (std::size_t m = 0; m < 2; ++m) {
        const double p = probability(maps[m], point);
        score[m] += std::log(1.0 - std::min(p, 0.99));
        wrong[m] += p > 0.5;
      }
    }
    EXPECT_GT(score[0], score[1]);
    EXPECT_LT(7 * wrong[0], 4 * wrong[1]) << "cells on the arcs of cones, in front of walls";
    std::array<std::size_t, 2> occupied{};
    for (int i = 0; i < 400; ++i) {
      const Vector<2> wall(-3.5 + 7.0 * (i + 0.5) / 400.0, kRoom + 0.01);
      for (std::size_t m = 0; m < 2; ++m) occupied[m] += probability(maps[m], wall) > 0.5;
    }
    EXPECT_GE(10 * occupied[0], 8 * occupied[1]);
    EXPECT_GE(occupied[1], scans == 50 ? 20u : 150u);
  }
}

}  // namespace
}  // namespace ndtree::test::test_wide_beams
