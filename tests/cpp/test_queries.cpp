// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "options.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "refusals.hpp"
#include "shapes.hpp"
#include "trees.hpp"

namespace ndtree::test::test_queries {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
const double kNan = std::numeric_limits<double>::quiet_NaN();

/// A map's leaves as boxes, for questions answered one by one.
template <int D>
struct PlainLeaf {
  Box<D> box;
  OccupancyCell cell;
};

template <class Map>
std::vector<PlainLeaf<Map::kDim>> plain_leaves(const Map& map) {
  std::vector<PlainLeaf<Map::kDim>> leaves;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    leaves.push_back({map.tree().box(leaf.index), leaf.cell()});
  });
  return leaves;
}

/// Free space, scattered surfaces and unknown rest, in cells of 0.25 m and more.
template <int N, int D>
PaperMap<N, D> random_map(Random& random) {
  PaperMap<N, D> map(spelled_out_options(0.25, 0.25 * N));
  Scan<D> scan = scan_about<D>(random, 0.0);
  map.insert(scan);
  scan.origins = Vector<D>::Constant(-1.3);
  map.insert(scan);
  return map;
}

template <int D>
std::optional<double> nearest_crossing(const std::vector<PlainLeaf<D>>& leaves, const Vector<D>& origin,
                                       const Vector<D>& direction, double max_range) {
  std::optional<double> nearest;
  const double length = direction.norm();
  for (const auto& leaf : leaves) {
    if (leaf.cell.log_odds() <= 0.0f) continue;
    double enter = 0.0;
    double exit = max_range / length;
    for (int a = 0; a < D; ++a) {
      if (direction[a] == 0.0) {
        if (origin[a] < leaf.box.lower[a] || origin[a] >= leaf.box.upper[a]) exit = enter;
        continue;
      }
      const double t = (leaf.box.lower[a] - origin[a]) / direction[a];
      const double u = (leaf.box.upper[a] - origin[a]) / direction[a];
      enter = std::max(enter, std::min(t, u));
      exit = std::min(exit, std::max(t, u));
    }
    if (enter < exit && (!nearest || enter * length < *nearest)) nearest = enter * length;
  }
  return nearest;
}

template <class S>
class QueriesOf : public ::testing::Test {};
TYPED_TEST_SUITE(QueriesOf, TwoShapes, ShapeNames);

TYPED_TEST(QueriesOf, StateProbabilityAndHitRateAreThoseOfTheLeafAround) {
  NDTREE_SHAPE;
  Random random(50);
  int known = 0;
  const auto map = random_map<N, D>(random);
  const HitRateModel model(map.options());
  const auto leaves = plain_leaves(map);
  const Box<D> around = widened(map.tree().box(map.tree().root().index), 0.2);
  for (int cases = 0; cases < 600; ++cases) {
    Vector<D> point = random_point<D>(random, {Vector<D>::Constant(-2.2), Vector<D>::Constant(2.2)});
    if (cases % 5 == 0) point = random_point(random, around);
    if (cases % 3 == 0) point = (point * 4.0).array().round() / 4.0;  // On borders and corners.
    OccupancyCell expected;
    double size = 1.0;  // In smallest cells.
    for (const auto& leaf : leaves) {
      bool inside = true;
      for (int a = 0; a < D; ++a)
        inside = inside && leaf.box.lower[a] <= point[a] && point[a] < leaf.box.upper[a];
      if (!inside) continue;
      expected = leaf.cell;
      size = (leaf.box.upper[0] - leaf.box.lower[0]) / 0.25;
    }
    ASSERT_EQ(cell_at(map, point), expected);
    ASSERT_EQ(state(map, point), expected.log_odds() > 0.0f   ? CellState::occupied
                                 : expected.log_odds() < 0.0f ? CellState::free
                                                              : CellState::unknown);
    ASSERT_NEAR(probability(map, point), 1.0 / (1.0 + std::exp(-static_cast<double>(expected.log_odds()))),
                1e-15);
    const auto rate = hit_rate(map, point);
    ASSERT_EQ(rate.has_value(), expected.observed());
    if (rate) {
      ASSERT_EQ(rate->mean(), model(expected, size).mean());
    }
    known += expected.observed();
  }
  EXPECT_GT(known, 20);
  for (const double bad : {kNan, kInfinity, -kInfinity, 1e30}) {
    EXPECT_EQ(state(map, Vector<D>::Constant(bad).eval()), CellState::unknown);
    EXPECT_EQ(probability(map, Vector<D>::Constant(bad).eval()), 0.5);
    EXPECT_FALSE(hit_rate(map, Vector<D>::Constant(bad).eval()));
  }
}

TYPED_TEST(QueriesOf, ManyPointsGetTheirCellsInTheirOrder) {
  NDTREE_SHAPE;
  Random random(54);
  const auto map = random_map<N, D>(random);
  const Box<D> around = widened(map.tree().box(map.tree().root().index), 0.2);
  std::size_t found = 0;
  for (const std::size_t n : {0u, 1u, 15u, 16u, 17u, 1000u, 20000u}) {
    std::vector<double> points;
    for (std::size_t i = 0; i < n; ++i) {
      Vector<D> point = random_point(random, around);
      if (i % 2 == 0) point = random_point<D>(random, {Vector<D>::Constant(-2.2), Vector<D>::Constant(2.2)});
      if (i % 3 == 0) point = (point * 4.0).array().round() / 4.0;
      if (i % 50 == 7) point[0] = kNan;
      if (i % 50 == 8) point[D - 1] = 1e300;
      points.insert(points.end(), point.data(), point.data() + D);
    }
    std::size_t next = 0;
    for_each_cell_at(map, points.data(), n, [&](std::size_t i, const OccupancyCell& cell) {
      EXPECT_EQ(i, next++);
      EXPECT_EQ(cell, cell_at(map, Vector<D>(Eigen::Map<const Vector<D>>(points.data() + i * D))));
      found += cell.observed();
    });
    EXPECT_EQ(next, n);
  }
  EXPECT_GT(found, 50u);
  const PaperMap<N, D> empty(spelled_out_options(0.25, 0.25 * N));
  const Vector<D> inside = Vector<D>::Constant(0.1);
  for_each_cell_at(empty, inside.data(), 1,
                   [](std::size_t, const OccupancyCell& cell) { EXPECT_FALSE(cell.observed()); });
}

TYPED_TEST(QueriesOf, RaysEndAtTheNearestOccupiedLeaf) {
  NDTREE_SHAPE;
  Random random(51);
  const auto map = random_map<N, D>(random);
  const auto leaves = plain_leaves(map);
  int found = 0;
  int started_inside = 0;
  for (int cases = 0; cases < 1200; ++cases) {
    Vector<D> origin = random_point<D>(random, {Vector<D>::Constant(-3.0), Vector<D>::Constant(3.0)});
    Vector<D> direction = random_point<D>(random, {Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)});
    if (cases % 3 == 0) origin = (origin * 4.0).array().round() / 4.0;
    if (cases % 4 == 0) {  // Along an axis, in either sense.
      direction.setZero();
      direction[random.integer(0, D - 1)] = random.chance(0.5) ? 2.0 : -0.5;
    }
    if (cases % 7 == 0) direction *= 1000.0;
    if (cases % 2 == 0) {  // Towards an occupied cell, so that rays often find one.
      const auto& leaf =
          leaves[static_cast<std::size_t>(random.integer(0, static_cast<int>(leaves.size()) - 1))];
      if (leaf.cell.state() == CellState::occupied && cases % 4 != 0)
        direction = random_point(random, leaf.box) - origin;
    }
    // Along axes from a border: the range ends on borders, too.
    const double max_range = cases % 5 == 0    ? kInfinity
                             : cases % 12 == 0 ? 0.25 * random.integer(1, 24)
                                               : random.uniform(0.1, 6.0);
    const auto expected = nearest_crossing(leaves, origin, direction, max_range);
    const auto distance = cast_ray(map, origin, direction, max_range, RayAim::cell);
    ASSERT_EQ(distance.has_value(), expected.has_value())
        << "from " << origin.transpose() << " towards " << direction.transpose() << " up to " << max_range;
    if (!distance) continue;
    ++found;
    started_inside += *distance == 0.0;
    ASSERT_NEAR(*distance, *expected, 1e-12 * (1.0 + *expected));
    ASSERT_LT(*distance, max_range);
    // The length of the direction does not matter, also if its square is no normal number, or none at all.
    for (const double scale : {0.125, 0x1p-530, 0x1p-1000, 0x1p1000})
      ASSERT_NEAR(*cast_ray(map, origin, Vector<D>(scale * direction), max_range, RayAim::cell), *distance,
                  1e-12 * (1.0 + *expected));
    const Vector<D> tiny = std::numeric_limits<double>::denorm_min() * direction.cwiseSign();
    ASSERT_EQ(cast_ray(map, origin, tiny, max_range, RayAim::cell),
              cast_ray(map, origin, Vector<D>(direction.cwiseSign()), max_range, RayAim::cell));
  }
  EXPECT_GT(found, 25);
  EXPECT_GT(started_inside, 0);
}

/// Leaves that a ray passes through, by where it enters and leaves them [m].
template <int D>
std::vector<std::pair<std::pair<double, double>, PlainLeaf<D>>> crossings(
    const std::vector<PlainLeaf<D>>& leaves, const Vector<D>& origin, const Vector<D>& unit) {
  std::vector<std::pair<std::pair<double, double>, PlainLeaf<D>>> found;
  for (const auto& leaf : leaves) {
    double enter = 0.0;
    double exit = kInfinity;
    for (int a = 0; a < D; ++a) {
      const double t = (leaf.box.lower[a] - origin[a]) / unit[a];
      const double u = (leaf.box.upper[a] - origin[a]) / unit[a];
      enter = std::max(enter, std::min(t, u));
      exit = std::min(exit, std::max(t, u));
    }
    if (exit - enter > 1e-9) found.push_back({{enter, exit}, leaf});
  }
  return found;
}

TYPED_TEST(QueriesOf, TheSurfaceIsWhereHalfOfTheBeamsHaveEnded) {
  NDTREE_SHAPE;
  Random random(55);
  const auto map = random_map<N, D>(random);
  const auto leaves = plain_leaves(map);
  const HitRateModel model(map.options());
  const double most = 0.75 * map.options().min_cell_size;
  int found = 0;
  int inside = 0;
  int at_limit = 0;
  for (int i = 0; i < 3000; ++i) {
    const Vector<D> origin = random_point<D>(random, {Vector<D>::Constant(-3.0), Vector<D>::Constant(3.0)});
    const Vector<D> unit =
        random_point<D>(random, {Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)}).normalized();
    const double max_range = i % 3 == 0 ? kInfinity : random.uniform(0.1, 6.0);
    const auto at_cell = cast_ray(map, origin, unit, max_range, RayAim::cell);
    const auto surface = cast_ray(map, origin, unit, max_range, RayAim::surface);
    ASSERT_EQ(surface.has_value(), at_cell.has_value());
    if (!surface) continue;
    ++found;
    const double depth = *surface - *at_cell;
    ASSERT_GE(depth, 0.0);
    ASSERT_LE(depth, most * (1.0 + 1e-12));
    // What is left of the beams at a distance: each leaf between ends its share, evenly along its way.
    const auto passed = crossings(leaves, origin, unit);
    const auto log_left_at = [&](double distance) {
      double sum = 0.0;
      for (const auto& [way, leaf] : passed) {
        if (!leaf.cell.observed()) continue;
        const double from = std::max(way.first, *at_cell);  // The ray may start in it.
        const double part = (std::min(distance, way.second) - from) / (way.second - from);
        const double rate = 0.85 * model(leaf.cell, 1.0).fraction();
        if (way.second > *at_cell + 1e-9 && part > 0.0) sum += part * std::log1p(-rate);
      }
      return sum;
    };
    const double half = std::log(0.5);
    if (depth < most * (1.0 - 1e-9)) {
      ASSERT_NEAR(log_left_at(*surface), half, 1e-6) << "at " << *surface << " of " << *at_cell;
      ++inside;
    } else {
      ASSERT_GE(log_left_at(*surface), half - 1e-6);
      ++at_limit;
    }
    const auto traced = trace_ray(map, origin, unit, max_range, false, RayAim::surface);
    ASSERT_EQ(traced->distance, *surface);
    ASSERT_EQ(traced->cell->lower, trace_ray(map, origin, unit, max_range, false)->cell->lower);
  }
  EXPECT_GT(found, 20);
  EXPECT_GT(inside, 5);
  EXPECT_GT(at_limit, 0);
}

TEST(Queries, BadRaysAreRefused) {
  const FixedMap<2, 2> map;
  struct Row {
    Vector<2> origin, direction;
    double max_range;
    const char* message;
  };
  const Row rows[] = {
      {{kNan, 0.0}, {1.0, 0.0}, 1.0, "ray: "},          {{0.0, kInfinity}, {1.0, 0.0}, 1.0, "ray: "},
      {{0.0, 0.0}, {0.0, 0.0}, 1.0, "ray: "},           {{0.0, 0.0}, {kNan, 1.0}, 1.0, "ray: "},
      {{0.0, 0.0}, {kInfinity, 1.0}, 1.0, "ray: "},     {{0.0, 0.0}, {1.0, 0.0}, 0.0, "max_range = 0"},
      {{0.0, 0.0}, {1.0, 0.0}, -2.0, "max_range = -2"}, {{0.0, 0.0}, {1.0, 0.0}, kNan, "max_range = "}};
  for (const Row& row : rows)
    expect_refused([&] { (void)cast_ray(map, row.origin, row.direction, row.max_range); }, row.message);
}

}  // namespace
}  // namespace ndtree::test::test_queries
