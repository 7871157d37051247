// SPDX-License-Identifier: BSD-3-Clause
// Worlds of which every wall is known and everything inside was seen: nothing behind a wall is free, nothing
// inside is unknown, and there is no frontier.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "ndtree/core/scan.hpp"
#include "ndtree/map.hpp"
#include "ndtree/query/frontiers.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_closed_worlds {
namespace {

constexpr double kSigma = 0.02;
constexpr double kCell = 0.05;

/// A tube of a square section around the first axis, closed at both ends, through which a robot drives there
/// and back.
struct Tube {
  double half_width, half_length;  // [m]
  double off_centre;               // Of the sensor, on each axis across [m].
  double step;                     // Between two scans [m].
  double spacing;                  // Of neighbouring beams [degrees].
  double view;                     // Around the way ahead [degrees].
};

template <int D>
std::vector<Vector<D>> directions(const Tube& tube) {
  constexpr double kDegree = 3.14159265358979323846 / 180.0;
  std::vector<Vector<D>> all;
  for (double yaw = -0.5 * tube.view; yaw < 0.5 * tube.view; yaw += tube.spacing) {
    const double a = yaw * kDegree;
    if constexpr (D == 2)
      all.push_back({std::cos(a), std::sin(a)});
    else
      for (double pitch = -60.0; pitch <= 60.0; pitch += tube.spacing) {
        const double b = pitch * kDegree;
        all.push_back({std::cos(a) * std::cos(b), std::sin(a) * std::cos(b), std::sin(b)});
      }
  }
  return all;
}

template <class Map>
void drive(const Tube& tube, Random& random, Map& map) {
  constexpr int D = Map::kDim;
  const std::vector<Vector<D>> ahead = directions<D>(tube);
  const double end = tube.half_length - 1.0;
  const int steps = static_cast<int>(2.0 * end / tube.step);
  for (int i = 0; i <= 2 * steps; ++i) {
    const double way = i <= steps ? 1.0 : -1.0;
    Scan<D> scan;
    scan.origins = Vector<D>::Constant(tube.off_centre);
    scan.origins(0, 0) = -end + tube.step * (i <= steps ? i : 2 * steps - i);
    scan.endpoints.resize(D, static_cast<Eigen::Index>(ahead.size()));
    for (std::size_t k = 0; k < ahead.size(); ++k) {
      Vector<D> direction = ahead[k];
      direction[0] *= way;
      double range = HUGE_VAL;
      for (int a = 0; a < D; ++a) {
        const double wall = std::copysign(a == 0 ? tube.half_length : tube.half_width, direction[a]);
        if (direction[a] != 0.0) range = std::min(range, (wall - scan.origins(a, 0)) / direction[a]);
      }
      scan.endpoints.col(static_cast<Eigen::Index>(k)) =
          scan.origins.col(0) + (range + kSigma * random.normal()) * direction;
    }
    map.insert(scan);
  }
}

template <class S>
class ClosedTube : public ::testing::Test {};
using TubeShapes = ::testing::Types<Shape<2, 2>, Shape<3, 2>, Shape<2, 3>>;
TYPED_TEST_SUITE(ClosedTube, TubeShapes, ShapeNames);

TYPED_TEST(ClosedTube, NothingIsFreeBehindAWallAndNothingUnknownInside) {
  NDTREE_SHAPE;
  const std::vector<Tube> tubes =
      D == 2 ? std::vector<Tube>{{1.025, 15.0, 0.013, 0.2, 0.5, 270.0}, {1.025, 15.0, 0.3, 0.5, 0.5, 270.0},
                                 {0.915, 15.0, -0.2, 0.2, 1.0, 180.0},  {1.585, 20.0, 0.4, 0.1, 0.25, 270.0},
                                 {1.2, 10.0, 0.05, 0.3, 1.0, 360.0},    {0.775, 25.0, 0.1, 0.2, 0.5, 180.0}}
             : std::vector<Tube>{{1.025, 3.0, 0.013, 0.2, 2.0, 240.0}, {0.87, 2.5, -0.11, 0.3, 1.5, 300.0}};
  Random random(31);
  for (const Tube& tube : tubes) {
    SCOPED_TRACE("half width " + std::to_string(tube.half_width) + ", sensor at " +
                 std::to_string(tube.off_centre));
    MapOptions options;
    options.min_cell_size = kCell;
    options.max_cell_size = N == 2 ? 1.6 : 1.35;
    options.range_sigma = kSigma;
    AdaptiveMap<N, D> map(options);
    drive(tube, random, map);
    // Noise, and a smallest cell that reaches out of it.
    const double behind = 3.0 * std::max(kSigma, kCell / kThinnestSurface) + kCell;
    int free_behind = 0;
    int unknown_inside = 0;
    for (int i = 0; i < 200000; ++i) {
      Vector<D> point;
      for (int a = 0; a < D; ++a)
        point[a] = random.uniform(-1.0, 1.0) * (1.0 + (a == 0 ? tube.half_length : tube.half_width));
      bool is_behind = false;
      bool is_inside = true;
      for (int a = 0; a < D; ++a) {
        const double wall = a == 0 ? tube.half_length : tube.half_width;
        is_behind |= std::abs(point[a]) > wall + behind;
        is_inside &= std::abs(point[a]) < (a == 0 ? wall - 1.0 : wall - behind);
      }
      const CellState at = state(map, point);
      free_behind += is_behind && at == CellState::free;
      unknown_inside += is_inside && at == CellState::unknown;
    }
    EXPECT_EQ(free_behind, 0);
    if (N == 2 && D == 2) {  // In 3-D the sensor never looks straight up.
      EXPECT_EQ(unknown_inside, 0);
      EXPECT_TRUE(FrontierSearch<decltype(map)>(map).frontiers().empty());
    }
  }
}

}  // namespace
}  // namespace ndtree::test::test_closed_worlds
