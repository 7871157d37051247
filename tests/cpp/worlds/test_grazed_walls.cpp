// SPDX-License-Identifier: BSD-3-Clause
// Walls that are seen at grazing angles: no ray passes where the map of equal cells stops it.
#include <gtest/gtest.h>

#include <cmath>
#include <optional>

#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/ray.hpp"
#include "random.hpp"

namespace ndtree::test::test_grazed_walls {
namespace {

constexpr double kCell = 0.05;
constexpr double kDegree = 3.14159265358979323846 / 180.0;

struct Passing {
  int rays = 0;
  int pass_fixed = 0;
  int pass_adaptive_alone = 0;  ///< Rays that the fixed map stops.
};

/// A wall across the axis x, at a distance of 1 m minus `offset` from the sensor, which stands or drives
/// along it for 30 scans; then rays at up to 78 degrees.
/// @param sign -1: the mirrored world.
template <int N, int D>
void count(double offset, double noise, bool drives, double sign, Passing& sum) {
  MapOptions options;
  options.min_cell_size = kCell;
  AdaptiveMap<N, D> adaptive(options);
  FixedMap<N, D> fixed(options);
  Random random(5);
  const double wall = 1.0 - offset;
  const auto direction_at = [&](double degrees, double turn) {
    Vector<D> direction = Vector<D>::Zero();
    direction[0] = sign * std::cos(degrees * kDegree);
    direction[1] = std::sin(degrees * kDegree) * std::cos(turn);
    if constexpr (D > 2) direction[2] = std::sin(degrees * kDegree) * std::sin(turn);
    return direction;
  };
  constexpr int kScans = 30;
  constexpr int kTurns = D > 2 ? 24 : 2;
  const double step = D > 2 ? 2.0 : 0.5;
  Vector<D> origin = Vector<D>::Constant(0.013);
  for (int i = 0; i < kScans; ++i) {
    origin[1] = 0.013 + (drives ? 4.0 * i / (kScans - 1) - 2.0 : 0.0);
    const int in_turn = static_cast<int>(80.0 / step);
    Scan<D> scan;
    scan.origins = origin;
    scan.endpoints.resize(D, in_turn * kTurns);
    for (int beam = 0; beam < scan.endpoints.cols(); ++beam) {
      const Vector<D> direction = direction_at(step * (beam % in_turn + random.uniform(0.0, 1.0)),
                                               6.2831853 * (beam / in_turn) / kTurns);
      const double range = (sign * wall - origin[0]) / direction[0] + noise * random.uniform(-1.732, 1.732);
      scan.endpoints.col(beam) = origin + range * direction;
    }
    adaptive.insert(scan);
    fixed.insert(scan);
  }
  origin[1] = 0.013;
  for (int i = 0; i < 1000; ++i) {
    const Vector<D> direction = direction_at(random.uniform(0.0, 78.0), random.uniform(0.0, 6.2831853));
    const double at_wall = (sign * wall - origin[0]) / direction[0];
    const auto passes = [&](const auto& map) {
      const std::optional<double> end = cast_ray(map, origin, direction, 20.0, RayAim::cell);
      return !end || *end > at_wall + 0.3;
    };
    const bool passes_fixed = passes(fixed);
    ++sum.rays;
    sum.pass_fixed += passes_fixed;
    sum.pass_adaptive_alone += !passes_fixed && passes(adaptive);
  }
}

template <int N, int D>
void test(const std::initializer_list<double>& offsets) {
  Passing sum;
  for (const double offset : offsets)
    for (const double noise : {0.0, 0.005, 0.03})
      for (const bool drives : {false, true})
        for (const double sign : {1.0, -1.0}) count<N, D>(offset, noise, drives, sign, sum);
  EXPECT_EQ(sum.rays, static_cast<int>(offsets.size()) * 12000);
  EXPECT_LE(sum.pass_fixed, sum.rays / (D == 2 ? 100 : 3)) << "in space, beams are far apart";
  EXPECT_LE(sum.pass_adaptive_alone, sum.rays / 200);
}

TEST(GrazedWalls, StopTheRaysThatEqualCellsStop) {
  test<2, 2>({0.0, 0.003, 0.007, 0.012, 0.02, 0.03, 0.045});
  test<3, 2>({0.0, 0.007, 0.02});
}
TEST(GrazedWalls, StopThemInSpaceToo) { test<2, 3>({0.007}); }

}  // namespace
}  // namespace ndtree::test::test_grazed_walls
