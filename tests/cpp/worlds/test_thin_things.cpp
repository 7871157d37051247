// SPDX-License-Identifier: BSD-3-Clause
// What is thinner than the smallest cell: partial_probability keeps it, until it is gone.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

#include "ndtree/core/scan.hpp"
#include "ndtree/map.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"

namespace ndtree::test::test_thin_things {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kTop = 0.753;  // Of the table, 4 cm thick [m].

/// Where a beam meets a box, or infinity.
double distance(const Box<3>& box, const Vector<3>& origin, const Vector<3>& direction) {
  double enter = 0.0;
  double exit = HUGE_VAL;
  for (int a = 0; a < 3; ++a) {
    const double lower = (box.lower[a] - origin[a]) / direction[a];
    const double upper = (box.upper[a] - origin[a]) / direction[a];
    enter = std::max(enter, std::min(lower, upper));
    exit = std::min(exit, std::max(lower, upper));
  }
  return enter < exit ? enter : HUGE_VAL;
}

/// A lidar goes around a table in a room.
Scan<3> scan(Random& random, double around, bool with_table) {
  const Box<3> table{{-0.8, -0.5, kTop - 0.04}, {0.8, 0.5, kTop}};
  Scan<3> scan;
  scan.origins =
      Vector<3>(2.2 * std::cos(around), 2.2 * std::sin(around), 1.0 + 0.1 * random.uniform(-1.0, 1.0));
  const Vector<3> origin = scan.origins.col(0);
  std::vector<Vector<3>> ends;
  for (int ring = -16; ring <= 16; ++ring)
    for (int k = 0; k < 360; ++k) {
      const double pitch = (1.5 * ring + 0.01) * kPi / 180.0;
      const double yaw = (k + 0.013) * kPi / 180.0;
      const Vector<3> direction(std::cos(pitch) * std::cos(yaw), std::cos(pitch) * std::sin(yaw),
                                std::sin(pitch));
      double range = with_table ? distance(table, origin, direction) : HUGE_VAL;
      for (int a = 0; a < 3; ++a) {  // The room's walls, its floor and ceiling.
        const double wall = direction[a] > 0.0 ? (a == 2 ? 2.53 : 4.03) : (a == 2 ? -0.03 : -4.03);
        range = std::min(range, (wall - origin[a]) / direction[a]);
      }
      ends.push_back(origin + (range + 0.01 * random.uniform(-1.0, 1.0)) * direction);
    }
  scan.endpoints.resize(3, static_cast<Eigen::Index>(ends.size()));
  for (std::size_t i = 0; i < ends.size(); ++i) scan.endpoints.col(static_cast<Eigen::Index>(i)) = ends[i];
  return scan;
}

/// Of upright lines through the table, how many meet an occupied cell.
double share_met(const AdaptiveMap<2, 3>& map) {
  int met = 0;
  int all = 0;
  for (double x = -0.73; x < 0.75; x += 0.05)
    for (double y = -0.43; y < 0.45; y += 0.05, ++all) {
      bool is_met = false;
      for (double z = 0.7; z < 0.8; z += 0.02)
        is_met = is_met || state(map, Vector<3>(x, y, z)) == CellState::occupied;
      met += is_met;
    }
  return static_cast<double>(met) / all;
}

AdaptiveMap<2, 3> map_with(double partial_probability) {
  MapOptions options;
  options.min_cell_size = 0.1;
  options.range_sigma = 0.005;
  options.partial_probability = partial_probability;
  return AdaptiveMap<2, 3>(options);
}

TEST(ThinThings, ATableTopIsKeptHoweverManyBeamsPassBesideIt) {
  Random random(41);
  AdaptiveMap<2, 3> plain = map_with(0.0);
  AdaptiveMap<2, 3> partial = map_with(0.6);
  const auto all = [&](int scans, bool with_table) {
    for (int i = 0; i < scans; ++i) {
      const Scan<3> one = scan(random, 2.0 * kPi * i / 40.0, with_table);
      plain.insert(one);
      partial.insert(one);
    }
  };
  all(40, true);
  EXPECT_LT(share_met(plain), 0.3);
  EXPECT_GT(share_met(partial), 0.5);
  ASSERT_NO_THROW(partial.check_invariants());
  int scans = 0;
  for (; share_met(partial) > 0.0 && scans < 200; scans += 40) all(40, false);  // The table is carried away.
  EXPECT_LE(scans, 120);
  EXPECT_EQ(share_met(partial), 0.0);
}

TEST(ThinThings, TheOptionHasBounds) {
  EXPECT_NO_THROW(map_with(0.95));
  EXPECT_THROW(map_with(0.96), std::invalid_argument);
  EXPECT_THROW(map_with(-0.1), std::invalid_argument);
}

}  // namespace
}  // namespace ndtree::test::test_thin_things
