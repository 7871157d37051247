// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What beams that pass must clear, however alike they are, and what no beam came through must not be free.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <string>
#include <vector>

#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_passing_beams {
namespace {

constexpr double kPi = 3.14159265358979323846;

/// The defaults, which tests of single parts spell out otherwise.
MapOptions options_of(double cell_size, double max_cell_size) {
  MapOptions options;
  options.min_cell_size = cell_size;
  options.max_cell_size = max_cell_size;
  options.range_sigma = 0.02;
  return options;
}
MapOptions options_of(double cell_size, int branching) {
  return options_of(cell_size, cell_size * std::pow(branching, branching == 2 ? 4 : 2));
}

template <int D>
Vector<D> direction(Random& random) {
  Vector<D> d;
  do {
    for (int a = 0; a < D; ++a) d[a] = random.uniform(-1.0, 1.0);
  } while (d.norm() < 0.1);
  return d.normalized();
}

template <int D>
Scan<D> fan(const Vector<D>& origin, const std::vector<Vector<D>>& directions, double range, double noise,
            Random& random, bool returned = true) {
  Scan<D> scan;
  scan.origins = origin;
  scan.endpoints.resize(D, static_cast<Eigen::Index>(directions.size()));
  for (std::size_t i = 0; i < directions.size(); ++i)
    scan.endpoints.col(static_cast<Eigen::Index>(i)) =
        origin + directions[i] * (range + noise * random.uniform(-1.0, 1.0));
  if (!returned) scan.returned = Eigen::Array<bool, Eigen::Dynamic, 1>::Constant(scan.size(), false);
  return scan;
}

template <class Map>
int occupied_leaves(const Map& map) {
  int n = 0;
  for_each_leaf(map.tree(), [&](const auto& leaf) { n += leaf.cell().state() == CellState::occupied; });
  return n;
}

template <class Map, int D>
int occupied_of(const Map& map, const std::vector<Vector<D>>& points) {
  int n = 0;
  for (const Vector<D>& point : points) n += state(map, point) == CellState::occupied;
  return n;
}

template <class S>
class PassingBeams : public ::testing::Test {};
TYPED_TEST_SUITE(PassingBeams, TwoShapes, ShapeNames);

/// Scans after which nothing is left where equal beams passed something that was seen before, through at
/// least half an edge of its cells: less says too little for a change. A cell remembers evidence of 200 nats,
/// or 235 hits; of equal passes it counts at least one in two scans.
constexpr int kScansToClear = 400;

/// In edges of a smallest cell: how far a beam goes through those that are asked about. Evidence is in
/// proportion to ways, so half of this takes twice as many scans.
constexpr double kLeastWay = 0.5;

/// One point on each beam in each smallest cell that it crosses over at least kLeastWay, but for the last.
template <int D>
std::vector<Vector<D>> points_crossed(const Vector<D>& origin, const std::vector<Vector<D>>& directions,
                                      double range, double cell_size) {
  std::vector<Vector<D>> points;
  for (const Vector<D>& d : directions) {
    std::vector<double> borders{0.0};  // Where the beam enters smallest cells.
    for (int a = 0; a < D; ++a) {
      if (d[a] == 0.0) continue;
      const int first = static_cast<int>(std::floor(std::min(0.0, range * d[a]) / cell_size)) - 1;
      const int last = static_cast<int>(std::ceil(std::max(0.0, range * d[a]) / cell_size)) + 1;
      for (int i = first; i <= last; ++i) {
        const double t = (i * cell_size - origin[a]) / d[a];
        if (t > 0.0 && t < range) borders.push_back(t);
      }
    }
    std::sort(borders.begin(), borders.end());
    for (std::size_t i = 1; i < borders.size(); ++i)
      if (borders[i] - borders[i - 1] >= kLeastWay * cell_size)
        points.push_back(origin + 0.5 * (borders[i - 1] + borders[i]) * d);
  }
  return points;
}

TYPED_TEST(PassingBeams, EqualBeamsClearWhatTheyPassAndItStaysClear) {
  NDTREE_SHAPE;
  for (const double sample_beams : {0.5, 8.0})
    for (const int beams : {1, 3, 40}) {
      Random random(10 * beams + D);
      SCOPED_TRACE(random.trace());
      MapOptions options = options_of(0.05, N);
      options.sample_beams = sample_beams;
      AdaptiveMap<N, D> map(options);
      const Vector<D> origin = Vector<D>::Constant(0.021);
      std::vector<Vector<D>> directions;
      for (int i = 0; i < beams; ++i) directions.push_back(direction<D>(random));
      for (int i = 0; i < 40; ++i) map.insert(fan<D>(origin, directions, 1.0, 0.04, random));
      EXPECT_GT(occupied_leaves(map), 0);
      const Scan<D> passing = fan<D>(origin, directions, 2.0, 0.0, random, false);
      const auto crossed = points_crossed<D>(origin, directions, 1.5, options.min_cell_size);
      for (int i = 0; i < kScansToClear; ++i) map.insert(passing);
      EXPECT_EQ(occupied_of(map, crossed), 0) << beams << " beams";
      for (int i = 0; i < 30; ++i) {
        map.insert(passing);
        ASSERT_EQ(occupied_of(map, crossed), 0) << "and stays so";
      }
    }
}

/// Scans after which every cell that equal beams cross is free, whatever the options. The slowest are cells
/// that a single beam clips, when a scan samples one beam in twenty.
constexpr int kScansToFree = 2500;
struct OptionRow {
  const char* name;
  void (*set)(MapOptions&);
};
const OptionRow kOptionRows[] = {
    {"defaults", [](MapOptions&) {}},
    {"sample_beams 0.05", [](MapOptions& o) { o.sample_beams = 0.05; }},
    {"sample_beams 8", [](MapOptions& o) { o.sample_beams = 8.0; }},
    {"sample_beams 1e9", [](MapOptions& o) { o.sample_beams = 1e9; }},
    {"scan_beams 1", [](MapOptions& o) { o.scan_beams = 1.0; }},
    {"known_evidence 1e9", [](MapOptions& o) { o.known_evidence = 1e9; }},
    {"free_memory 1", [](MapOptions& o) { o.free_memory = 1.0; }},
    {"evidence_memory 5", [](MapOptions& o) { o.evidence_memory = 5.0; }},
    {"evidence_prior 10", [](MapOptions& o) { o.evidence_prior = 10.0; }},
    {"evidence_half_life 20", [](MapOptions& o) { o.evidence_half_life = 20.0; }},
    {"change_probability 0", [](MapOptions& o) { o.change_probability = 0.0; }},
    {"split_probability 0.1", [](MapOptions& o) { o.split_probability = 0.1; }},
    {"split_probability 0.99", [](MapOptions& o) { o.split_probability = 0.99; }},
    {"partial_probability 0.6", [](MapOptions& o) { o.partial_probability = 0.6; }},
    {"merge_loss 0", [](MapOptions& o) { o.merge_loss = 0.0; }},
    {"inherited_beams 0", [](MapOptions& o) { o.inherited_beams = 0.0; }},
    {"noise_sigmas 10", [](MapOptions& o) { o.noise_sigmas = 10.0; }},
    {"range_sigma 0.1", [](MapOptions& o) { o.range_sigma = 0.1; }},
    {"covered_share 0", [](MapOptions& o) { o.covered_share = 0.0; }},
    {"covered_share 1", [](MapOptions& o) { o.covered_share = 1.0; }},
    {"coverage_cells 1", [](MapOptions& o) { o.coverage_cells = 1.0; }},
    {"smallest cells only", [](MapOptions& o) { o.max_cell_size = o.min_cell_size; }},
};

TYPED_TEST(PassingBeams, WhateverTheOptionsEveryCrossedCellBecomesFreeAndStaysSo) {
  NDTREE_SHAPE;
  constexpr double kRange = 2.0;
  constexpr int kMore = 40;
  std::size_t points_asked = 0;
  for (std::size_t number = 0; number < std::size(kOptionRows); ++number)
    for (const bool is_bundle : {false, true}) {
      const OptionRow& row = kOptionRows[number];
      SCOPED_TRACE(std::string(row.name) + (is_bundle ? ", a bundle" : ", spread"));
      Random random(70 + D + (is_bundle ? 1 : 0));
      SCOPED_TRACE(random.trace());
      MapOptions options = options_of(0.05, N);
      row.set(options);
      AdaptiveMap<N, D> map(options);
      const Vector<D> origin = Vector<D>::Constant(0.021);
      const Vector<D> middle = direction<D>(random);
      const auto another = [&] {
        const Vector<D> d = direction<D>(random);
        return is_bundle ? Vector<D>((middle + 0.2 * d).normalized()) : d;
      };
      std::vector<Vector<D>> directions;
      for (int i = 0; i < (is_bundle ? 30 : 10); ++i) directions.push_back(another());
      // What stands in their way was seen by these beams, and by others, before and after space there was.
      for (int i = 0; i < 60; ++i) {
        std::vector<Vector<D>> some = directions;
        for (int k = 0; k < 20; ++k) some.push_back(another());
        map.insert(fan<D>(origin, some, i < 10 ? 1.4 : 1.0, 0.06, random));
      }
      EXPECT_GT(occupied_leaves(map), 0);
      const Scan<D> passing = fan<D>(origin, directions, kRange, 0.0, random, false);
      for (int i = 0; i < kScansToFree; ++i) map.insert(passing);
      const std::vector<Vector<D>> points = points_crossed<D>(origin, directions, kRange, 0.05);
      const auto not_free = [&] {
        return std::count_if(points.begin(), points.end(),
                             [&](const Vector<D>& point) { return state(map, point) != CellState::free; });
      };
      ASSERT_EQ(not_free(), 0) << "of " << points.size();
      const UpdateCounters before = map.counters();
      for (int i = 0; i < kMore; ++i) {
        map.insert(passing);
        if (i % 8 == 0) {
          ASSERT_EQ(not_free(), 0) << "and stays so";
        }
      }
      const std::uint64_t splits = map.counters().splits - before.splits;
      const std::uint64_t merges = map.counters().merges - before.merges;
      EXPECT_EQ(std::min(splits, merges), 0u) << "no cell splits and joins again";
      points_asked += points.size();
    }
  EXPECT_GT(points_asked, 10000u);
}

TYPED_TEST(PassingBeams, WhatStandsAtTheMaximumRangeIsClearedByBeamsThatAreCutThere) {
  NDTREE_SHAPE;
  Random random(5);
  AdaptiveMap<N, D> adaptive(options_of(0.05, N));
  FixedMap<N, D> fixed(options_of(0.05, N));
  const Vector<D> origin = Vector<D>::Constant(0.013);
  std::vector<Vector<D>> directions;
  for (int i = 0; i < 20; ++i) directions.push_back(direction<D>(random));
  const auto insert = [&](double range, int times) {
    for (int i = 0; i < times; ++i) {
      const Scan<D> scan = fan<D>(origin, directions, range, 0.0, random);
      adaptive.insert(scan, 1.5);
      fixed.insert(scan, 1.5);
    }
  };
  insert(1.48, 5);
  int seen = 0;
  for (const Vector<D>& d : directions)
    seen += state(fixed, Vector<D>(origin + 1.481 * d)) == CellState::occupied;
  EXPECT_GE(seen, 10);
  insert(4.0, 200);
  for (const Vector<D>& d : directions) {
    EXPECT_NE(state(adaptive, Vector<D>(origin + 1.48 * d)), CellState::occupied);
    EXPECT_NE(state(fixed, Vector<D>(origin + 1.48 * d)), CellState::occupied);
  }
}

TEST(PassingBeams, EachScanSamplesOtherBeamsWhateverTheOrderAndTheThreads) {
  MapOptions options = options_of(0.05, 2);
  Random random(8);
  std::vector<Vector<2>> directions;
  for (int i = 0; i < 4000; ++i) directions.emplace_back(std::cos(i * 1e-3), std::sin(i * 1e-3));
  const Scan<2> scan = fan<2>(Vector<2>(0.01, 0.02), directions, 1.0, 0.0, random);
  ScanView<2> numbered = scan.view();
  AdaptiveMap<2, 2> counted(options);
  AdaptiveMap<2, 2> given(options);
  AdaptiveMap<2, 2> other(options);
  for (std::uint64_t i = 0; i < 3; ++i) {
    counted.insert(scan);
    numbered.number = i;
    given.insert(numbered, kUnlimitedRange, 3);
    numbered.number = 2 * i;
    other.insert(numbered);
  }
  EXPECT_EQ(counted.counters().scans, 3u);
  EXPECT_EQ(counted.counters().updates, given.counters().updates);
  EXPECT_EQ(other.counters().scans, 5u) << "the next has the number after";
  EXPECT_NE(counted.counters().updates, other.counters().updates) << "another sample";
}

TEST(PassingBeams, BeamsAlongAWallSayNothingOfTheSpaceBehindIt) {
  MapOptions options = options_of(0.05, 1.6);
  AdaptiveMap<2, 2> map(options);
  const auto insert = [&](const std::vector<Vector<2>>& ends, double x) {
    Scan<2> scan;
    scan.origins = Vector<2>(x, 0.013);
    scan.endpoints.resize(2, static_cast<Eigen::Index>(ends.size()));
    for (std::size_t i = 0; i < ends.size(); ++i) scan.endpoints.col(static_cast<Eigen::Index>(i)) = ends[i];
    map.insert(scan);
  };
  insert({{9.844, -1.025}, {11.971, -1.025}, {14.806, -1.025}, {-3.988, 1.025}}, -5.0);
  insert({{10.044, -1.025}, {12.171, -1.025}, {15.0, -1.025}, {-3.788, 1.025}}, -4.8);
  insert({{10.844, -1.025}, {12.971, -1.025}, {15.0, -0.983}, {-2.988, 1.025}}, -4.0);
  EXPECT_EQ(state(map, Vector<2>(10.6, -1.4)), CellState::unknown);
}

TYPED_TEST(PassingBeams, MirroredScansMakeMirroredMapsOnBordersToo) {
  NDTREE_SHAPE;
  Random random(31);
  int on_borders = 0;
  for (int world = 0; world < 12; ++world) {
    const int axis = random.integer(0, D - 1);
    const MapOptions options = options_of(0.1, N);
    FixedMap<N, D> fixed(options);
    FixedMap<N, D> fixed_mirrored(options);
    for (int i = 0; i < 20; ++i) {
      Scan<D> scan;
      Vector<D> origin;
      for (int a = 0; a < D; ++a) origin[a] = random.uniform(-0.2, 0.2);
      scan.origins = origin;
      scan.endpoints.resize(D, 12);
      for (Eigen::Index k = 0; k < scan.size(); ++k)
        for (int a = 0; a < D; ++a) {
          const bool is_on_border = random.chance(0.5);
          on_borders += is_on_border;
          scan.endpoints(a, k) = is_on_border ? 0.1 * random.integer(-15, 15) : random.uniform(-1.5, 1.5);
        }
      Scan<D> mirror = scan;
      mirror.origins.row(axis) *= -1.0;
      mirror.endpoints.row(axis) *= -1.0;
      fixed.insert(scan);
      fixed_mirrored.insert(mirror);
    }
    for (int i = 0; i < 300; ++i) {
      Vector<D> point;
      for (int a = 0; a < D; ++a) point[a] = 0.1 * random.integer(-16, 15) + 0.05;
      Vector<D> image = point;
      image[axis] *= -1.0;
      EXPECT_EQ(state(fixed, point), state(fixed_mirrored, image));
    }
  }
  EXPECT_GT(on_borders, 300);
}

TEST(PassingBeams, ANoiseFreeWallOnOrNearABorderStopsRays) {
  for (const double x : {1.0, 0.9999, 0.999, 1.0001, 0.975})
    for (const double side : {-1.0, 1.0}) {
      MapOptions options = options_of(0.05, 1.6);
      AdaptiveMap<2, 2> map(options);
      const Vector<2> origin(0.013, 0.021);
      Scan<2> scan;
      scan.origins = origin;
      scan.endpoints.resize(2, 241);
      for (Eigen::Index i = 0; i < scan.size(); ++i)
        scan.endpoints.col(i) = Vector<2>(
            side * x, origin[1] + x * std::tan((0.5 * static_cast<double>(i) - 60.0) * kPi / 180.0));
      for (int i = 0; i < 50; ++i) map.insert(scan);
      int passed = 0;
      int rays = 0;
      for (double angle = -55.0; angle < 55.0; angle += 0.37) {
        const Vector<2> d(side * std::cos(angle * kPi / 180.0), std::sin(angle * kPi / 180.0));
        const auto met = cast_ray(map, origin, d, 5.0, RayAim::cell);
        const double range = std::abs((side * x - origin[0]) / d[0]);
        passed += !(met && std::abs(*met - range) < 0.15);
        ++rays;
      }
      EXPECT_LE(passed, rays / 20) << "wall at " << side * x;
    }
}

TEST(PassingBeams, WhatStoodIsClearedByADozenScansInCellsThatSplitAndMergeAgain) {
  constexpr int kWorlds = 300;
  constexpr double kFrom = 2.8;  // A square of 2 x 2 smallest cells stands here, and at y = 0.4.
  Random random(5);
  int longest = 0;
  for (int world = 0; world < kWorlds; ++world) {
    AdaptiveMap<2, 2> map(options_of(0.1, 1.6));
    Scan<2> scan;
    scan.origins = Vector<2>(0.0, 0.04);
    scan.endpoints.resize(2, random.integer(4, 23));
    const int stays = random.integer(10, 29);
    for (int i = 0; i < stays; ++i, scan.origins(0, 0) += 0.05) {
      for (Eigen::Index k = 0; k < scan.size(); ++k)
        scan.endpoints.col(k) << random.uniform(kFrom, kFrom + 0.2), random.uniform(0.4, 0.6);
      map.insert(scan);
    }
    const Eigen::Index beams = random.integer(4, 15);
    scan.endpoints.resize(2, beams);
    const std::vector<Vector<2>> centres{{2.85, 0.45}, {2.95, 0.45}, {2.85, 0.55}, {2.95, 0.55}};
    ASSERT_GT(occupied_of(map, centres), 0);
    int passed = 0;
    for (; passed < 40 && occupied_of(map, centres) > 0; ++passed, scan.origins(0, 0) += 0.03) {
      const Vector<2> origin = scan.origins.col(0);
      for (Eigen::Index k = 0; k < beams; ++k) {
        const double x = kFrom + 0.2 * (static_cast<double>(k) + 0.5) / static_cast<double>(beams);
        scan.endpoints.col(k) = origin + 2.0 * (Vector<2>(x, random.uniform(0.4, 0.6)) - origin);
      }
      map.insert(scan);
    }
    longest = std::max(longest, passed);
  }
  EXPECT_LE(longest, 12);
}

}  // namespace
}  // namespace ndtree::test::test_passing_beams
