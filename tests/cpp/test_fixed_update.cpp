// SPDX-License-Identifier: BSD-3-Clause
// Equal cells task by task are those of one beam after the other.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "ndtree/io/map_file.hpp"
#include "ndtree/map.hpp"
#include "ndtree/mapping/baseline/fixed_update.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_fixed_update {
namespace {

/// The oracle: beam by beam, and down the whole tree for each cell.
struct BeamByBeam : FixedRefinement {
  using FixedRefinement::FixedRefinement;
  template <class Tree, class Sensor>
  using Update = BeamUpdate<Tree, BeamByBeam, Sensor>;
};
/// Takes a scan in pieces, as one whose lists would be too long.
struct InPieces : FixedRefinement {
  using FixedRefinement::FixedRefinement;
  template <class Tree, class Sensor>
  struct Update : FixedUpdate<Tree, InPieces, Sensor> {
    Update(Tree& tree, const InPieces& refinement, const Sensor& sensor, const MapOptions& options,
           UpdateCounters& counters)
        : FixedUpdate<Tree, InPieces, Sensor>(tree, refinement, sensor, options, counters, 200.0) {}
  };
};
template <int N, int D>
using MapInPieces = OccupancyMap<N, D, InPieces, BeamSensorModel>;
template <int N, int D>
using Oracle = OccupancyMap<N, D, BeamByBeam, BeamSensorModel>;

MapOptions random_options(Random& random) {
  MapOptions options;
  options.min_cell_size = random.chance(0.5) ? 0.125 : 0.1;
  options.max_cell_size = options.min_cell_size * std::pow(2.0, random.integer(0, 6));
  options.range_sigma = random.chance(0.5) ? 0.001 : 0.08;
  options.range_sigma_quadratic = random.chance(0.5) ? 0.0 : 0.01;
  options.probability_min = random.uniform(0.1, 0.45);
  return options;
}

/// Many coordinates lie on borders of cells, many beams along axes.
template <int D>
Scan<D> random_scan(Random& random, double size) {
  const double reach = random.chance(0.2) ? 5.0 : 1.5;
  const auto coordinate = [&] {
    const double x = random.uniform(-reach, reach);
    return random.chance(0.3) ? size * std::round(x / size) : x;
  };
  const auto point = [&] {
    Vector<D> p;
    for (int a = 0; a < D; ++a) p[a] = coordinate();
    return p;
  };
  Scan<D> scan;
  const int beams = random.integer(1, 60);
  scan.endpoints.resize(D, beams);
  scan.origins.resize(D, random.chance(0.5) ? 1 : beams);
  for (int i = 0; i < scan.origins.cols(); ++i) scan.origins.col(i) = point();
  scan.returned.resize(beams);
  for (int i = 0; i < beams; ++i) {
    const Vector<D> origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
    Vector<D> end = point();
    for (int a = 0; a < D; ++a)
      if (random.chance(0.15)) end[a] = origin[a];
    if (random.chance(0.02)) end[0] = std::numeric_limits<double>::quiet_NaN();
    scan.endpoints.col(i) = end;
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}

template <class Shape>
class FixedUpdateTest : public ::testing::Test {};
TYPED_TEST_SUITE(FixedUpdateTest, TwoShapes, ShapeNames);

TYPED_TEST(FixedUpdateTest, IsBeamByBeam) {
  NDTREE_SHAPE;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    Random random(seed);
    SCOPED_TRACE(random.trace());
    MapOptions options = random_options(random);
    if (N > 2) options.max_cell_size = options.min_cell_size * std::pow(N, random.integer(0, 2));
    FixedMap<N, D> map(options);
    Oracle<N, D> oracle(options);
    for (int i = random.integer(1, 4); i > 0; --i) {
      const Scan<D> scan = random_scan<D>(random, options.min_cell_size);
      const double max_range = random.chance(0.3) ? random.uniform(0.3, 3.0) : kUnlimitedRange;
      std::optional<Box<D>> window;
      if (random.chance(0.4))
        window = Box<D>{Vector<D>::Constant(random.uniform(-1.0, -0.1)),
                        Vector<D>::Constant(random.uniform(0.1, 1.0))};
      const InsertReport report = map.insert(scan, max_range, random.integer(1, 3), window);
      const InsertReport expected = oracle.insert(scan, max_range, 1, window);
      EXPECT_EQ(report.updates, expected.updates);
    }
    map.check_invariants();
    ASSERT_EQ(to_bytes(map), to_bytes(oracle));
  }
}

TYPED_TEST(FixedUpdateTest, ManyBeamsDoNotDependOnThreads) {
  NDTREE_SHAPE;
  Random random(7);
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.1 * N * N;
  Scan<D> scan;
  scan.origins = Points<D>::Zero(D, 1);
  scan.endpoints.resize(D, 2000);
  for (Eigen::Index i = 0; i < scan.endpoints.size(); ++i)
    scan.endpoints.data()[i] = random.uniform(-3.0, 3.0);
  Oracle<N, D> oracle(options);
  for (int threads = 1; threads <= 4; ++threads) {
    FixedMap<N, D> map(options);
    map.insert(scan, kUnlimitedRange, threads);
    map.insert(scan, kUnlimitedRange, threads);
    if (threads == 1) {
      oracle.insert(scan);
      oracle.insert(scan);
    }
    map.check_invariants();
    ASSERT_EQ(to_bytes(map), to_bytes(oracle)) << threads << " threads";
    MapInPieces<N, D> in_pieces(options);
    in_pieces.insert(scan, kUnlimitedRange, threads);
    in_pieces.insert(scan, kUnlimitedRange, threads);
    ASSERT_EQ(to_bytes(in_pieces), to_bytes(oracle)) << threads << " threads, in pieces";
  }
}

/// Scans of ever more cells, until a map is full: it is then as before.
template <class Map>
void is_full_at_last(std::uint64_t seed) {
  constexpr int D = Map::kDim;
  Random random(seed);
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.1 * Map::kBranching * Map::kBranching;
  options.max_memory = 60'000.0;
  Map map(options);
  Scan<D> scan;
  scan.origins = Points<D>::Zero(D, 1);
  scan.endpoints.resize(D, 500);
  for (int threads = 1; threads <= 3; ++threads) {
    bool failed = false;
    for (double reach = 0.3; !failed && reach < 100.0; reach *= 1.5) {
      for (Eigen::Index i = 0; i < scan.endpoints.size(); ++i)
        scan.endpoints.data()[i] = random.uniform(-reach, reach);
      const std::string before = to_bytes(map);
      try {
        map.insert(scan, kUnlimitedRange, threads);
      } catch (const MemoryLimitReached&) {
        failed = true;
        EXPECT_EQ(to_bytes(map), before);
        map.check_invariants();
      }
    }
    EXPECT_TRUE(failed);
  }
}

TYPED_TEST(FixedUpdateTest, WithoutMemoryChangesNothing) {
  NDTREE_SHAPE;
  is_full_at_last<FixedMap<N, D>>(8);
  is_full_at_last<MapInPieces<N, D>>(8);
}

}  // namespace
}  // namespace ndtree::test::test_fixed_update
