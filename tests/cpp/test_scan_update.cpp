// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "flat_scan_map.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "options.hpp"
#include "random.hpp"
#include "shapes.hpp"
#include "trees.hpp"

namespace ndtree::test::test_scan_update {
namespace {

/// Beams within (-size, size), of which many come from one place and end in one wall: measured numbers, or
/// exact ones on a grid, often parallel to an axis, sometimes of no length.
template <int D>
Scan<D> random_scan(Random& random, int count, double size, double grid, double wall) {
  Scan<D> scan;
  scan.origins.resize(D, count);
  scan.endpoints.resize(D, count);
  scan.returned.resize(count);
  const auto place = [&](double x) { return grid > 0.0 ? std::round(x / grid) * grid : x; };
  for (Eigen::Index i = 0; i < count; ++i) {
    const bool from_one_place = random.chance(0.7);
    for (int a = 0; a < D; ++a) {
      scan.origins(a, i) = place(from_one_place ? -0.8 * size : random.uniform(-size, size));
      scan.endpoints(a, i) = place(random.uniform(-size, size));
      if (grid > 0.0 && random.chance(0.3)) scan.endpoints(a, i) = scan.origins(a, i);
    }
    if (random.chance(0.6)) scan.endpoints(0, i) = place(wall);
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}

template <int D>
Scan<D> shuffled(Random& random, const Scan<D>& scan) {
  Scan<D> result = scan;
  for (auto i = static_cast<int>(scan.size()) - 1; i > 0; --i) {
    const int j = random.integer(0, i);
    if (scan.origins.cols() > 1) result.origins.col(i).swap(result.origins.col(j));
    result.endpoints.col(i).swap(result.endpoints.col(j));
    std::swap(result.returned[i], result.returned[j]);
  }
  return result;
}

/// A sensor in the empty room [-half, half]^D that looks in the same directions in every scan.
template <int D>
struct Room {
  Vector<D> origin;
  double half;
  std::vector<Vector<D>> directions;

  Room(Random& random, const Vector<D>& from, double half_edge, int count) : origin(from), half(half_edge) {
    for (int i = 0; i < count; ++i) {
      Vector<D> direction;
      for (int a = 0; a < D; ++a) direction[a] = random.normal();
      directions.push_back(direction.normalized());
    }
  }
  [[nodiscard]] Scan<D> scan(Random& random, double sigma) const {
    Scan<D> scan;
    scan.origins = origin;
    scan.endpoints.resize(D, static_cast<Eigen::Index>(directions.size()));
    for (std::size_t i = 0; i < directions.size(); ++i) {
      const Vector<D>& direction = directions[i];
      double range = HUGE_VAL;
      for (int a = 0; a < D; ++a)
        if (direction[a] != 0.0)
          range = std::min(range, (std::copysign(half, direction[a]) - origin[a]) / direction[a]);
      scan.endpoints.col(static_cast<Eigen::Index>(i)) =
          origin + (range + sigma * random.normal()) * direction;
    }
    return scan;
  }
};

template <class Cells>
auto passed_of(const Cells& cells) {
  Cells observed;
  for (const auto& [index, cell] : cells)
    if (cell != EvidenceCell{}) observed.emplace(index, cell);
  return observed;
}

std::string text_of(const EvidenceCell& cell) {
  return std::to_string(cell.occupied_evidence()) + " for, " + std::to_string(cell.free_evidence()) +
         " against, " + std::to_string(cell.hits()) + " hits, " + std::to_string(cell.misses()) + " misses";
}

/// Every leaf that beams have passed, to the last unit, and the counters.
template <class Map, class Flat>
void expect_equal(const Map& map, const Flat& flat) {
  const auto leaves = passed_of(leaves_of(map.tree()));
  const auto expected = passed_of(flat.cells);
  int wrong = 0;
  for (const auto& [index, cell] : leaves) {
    const auto found = expected.find(index);
    if (found != expected.end() && found->second == cell) continue;
    if (wrong++ == 0)
      ADD_FAILURE() << "level " << index.level << " at " << index.lower[0] << " ...: " << text_of(cell)
                    << "; expected " << (found == expected.end() ? "another cell" : text_of(found->second));
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(leaves.size(), expected.size());
  EXPECT_EQ(map.counters().updates, flat.updates);
  EXPECT_EQ(map.counters().splits, flat.splits);
  EXPECT_EQ(map.counters().merges, flat.merges);
}

template <class S>
class ScanUpdateOf : public ::testing::Test {};
TYPED_TEST_SUITE(ScanUpdateOf, Shapes, ShapeNames);
template <class S>
class ScanUpdateOfTwo : public ::testing::Test {};
TYPED_TEST_SUITE(ScanUpdateOfTwo, TwoShapes, ShapeNames);

constexpr double kUnit = 0.25;

TYPED_TEST(ScanUpdateOf, BeamsThatAreCutHaveTheNoiseOfTheirLengthAfterTheCut) {
  NDTREE_SHAPE;
  Random random(132);
  const double coarsest = kUnit * (N == 2 ? 4 : N);
  MapOptions options = spelled_out_options(kUnit, coarsest);
  const double cut = 0.75 * coarsest;
  options.range_sigma = 0.02 * kUnit;
  options.range_sigma_quadratic = 0.8 * kUnit / (cut * cut);
  options.noise_sigmas = 1.0;
  options.sample_beams = 1e6;
  AdaptiveMap<N, D> map(options);
  FlatScanMap<N, D> flat(options, -2, 2);
  // Coarse hits, and then beams that pass them, are cut, and can place what they see.
  for (int i = 0; i < 12; ++i) {
    const double size = i % 2 == 0 ? 0.4 * coarsest : 2.0 * coarsest - 2.6 * kUnit;
    Scan<D> scan = random_scan<D>(random, 60, size, 0.0, 0.9 * size);
    if (i % 2 == 0) scan.range_sigma = Eigen::ArrayXd::Constant(60, 0.5 * coarsest);
    Simd::limit(i % 4 < 2 ? 1 : Simd::kWidest);
    map.insert(scan, cut);
    Simd::limit(Simd::kWidest);
    flat.insert(scan, cut);
    expect_equal(map, flat);
    if (this->HasFailure()) return;
  }
  EXPECT_GT(flat.splits, 0u);
}

TYPED_TEST(ScanUpdateOf, EqualsEveryCellClippedAgainstEveryBeam) {
  NDTREE_SHAPE;
  Random random(131);
  struct Row {
    double range_sigma, range_sigma_quadratic, noise_sigmas, merge_loss, evidence_memory, free_memory,
        scan_beams, known_evidence, sample_beams, covered_share, coverage_cells;
    double beam_divergence = 0.0;
    double partial_probability = 0.0;
    bool one_size = false;
  };
  const Row rows[] = {
      {0.06, 0.0, 1.0, 4.0, 200.0, 200.0, 1e6, 1.0, 1e6, 0.75, 1.0, 0.3},
      {0.06, 0.001, 1.0, 4.0, 200.0, 20.0, 8.0, 2.0, 0.3, 0.5, 2.0, 0.08},
      {0.06, 0.0, 1.0, 4.0, 200.0, 200.0, 1e6, 1.0, 1e6, 0.75, 1.0},
      {0.06, 0.0, 1.0, 4.0, 200.0, 20.0, 8.0, 2.0, 0.3, 0.9, 2.0},
      {0.02, 0.0, 1.0, 4.0, 20.0, 20.0, 64.0, 50.0, 0.05, 1.0, 8.0},
      {0.06, 0.0, 1.0, 4.0, 200.0, 200.0, 1e6, 1.0, 1e6, 0.0, 2.0},
      {0.06, 0.0, 1.0, 4.0, 200.0, 2.0, 3.0, 2.0, 0.3, 0.0, 2.0},  // Free space is saturated soon.
      {0.3, 0.0, 0.0, 1.0, 200.0, 20.0, 16.0, 1.0, 1e6, 0.0,
       2.0},  // Cells of all sizes are small beside the noise.
      {0.2, 0.0, 1.5, 2.0, 20.0, 200.0, 16.0, 3.0, 0.1, 0.0, 2.0},  // So they are, and not all may split.
      {0.02, 0.002, 3.0, 0.3, 5.0, 1.0, 1.0, 1.0, 0.05, 0.0, 2.0},  // Every beam has noise of its own.
      {0.06, 0.0, 1.0, 4.0, 200.0, 20.0, 16.0, 1.0, 1e6, 0.5, 2.0, 0.0, 0.6},  // What is thin stays.
      {0.06, 0.0, 1.0, 4.0, 2.0, 200.0, 1e6, 1.0, 1e6, 0.0, 2.0, 0.0, 0.0, true}};
  std::uint64_t splits = 0, merges = 0, remerged = 0, predicted_remerges = 0, sampled = 0, for_coverage = 0;
  std::uint64_t for_grazing_ends = 0, partly_seen = 0, kept_occupied = 0, unclear_passes = 0,
                stayed_apart = 0;
  for (const Row& row : rows)
    for (const double grid : {0.0, kUnit / 4.0}) {
      const int levels = row.one_size ? 0 : N == 2 ? 2 : 1;
      const double coarsest = kUnit * std::pow(N, levels);
      MapOptions options = spelled_out_options(kUnit, coarsest);
      options.range_sigma = row.range_sigma;
      options.range_sigma_quadratic = row.range_sigma_quadratic;
      options.noise_sigmas = row.noise_sigmas;
      options.merge_loss = row.merge_loss;
      options.evidence_memory = row.evidence_memory;
      options.free_memory = row.free_memory;
      options.scan_beams = row.scan_beams;
      options.known_evidence = row.known_evidence;
      options.sample_beams = row.sample_beams;
      options.covered_share = row.covered_share;
      options.coverage_cells = row.coverage_cells;
      options.beam_divergence = row.beam_divergence;
      options.partial_probability = row.partial_probability;
      ASSERT_EQ(options.num_levels(N), levels);
      SCOPED_TRACE("row " + std::to_string(&row - rows) + ", grid " + std::to_string(grid));
      AdaptiveMap<N, D> map(options);
      const int cells = !row.one_size ? 2 : D < 4 ? 6 : 4;  // From -cells to cells on each axis.
      FlatScanMap<N, D> flat(options, -cells, cells);
      const double reach = cells * coarsest;
      const double sigma = row.range_sigma + row.range_sigma_quadratic * 4.0 * D * reach * reach;
      const double size = reach - 3.0 * std::max(sigma, kUnit / kThinnestSurface) - kUnit / 4.0;
      for (int i = 0; i < 12; ++i) {              // Half-way the wall is taken away.
        const int beams = i % 6 == 5 ? 120 : 30;  // Leaves of many beams may split before all are weighed.
        Scan<D> scan = random_scan<D>(random, beams, size, grid, (i < 6 ? 0.2 : 0.9) * size);
        if (i / 3 % 2 == 0) scan.origins = scan.origins.leftCols(1).eval();  // Of which lists go by vectors.
        if (i % 4 == 3) scan.range_sigma = Eigen::ArrayXd::LinSpaced(beams, 0.1, 1.0) * row.range_sigma;
        Simd::limit(i % 3 == 0 ? 1 : i % 3 == 1 ? 8 : Simd::kWidest);
        const std::uint64_t before = map.counters().updates;
        const InsertReport report = map.insert(scan);
        Simd::limit(Simd::kWidest);
        flat.insert(scan, kUnlimitedRange);
        EXPECT_EQ(report.updates, map.counters().updates - before);
        expect_equal(map, flat);
        ASSERT_NO_THROW(map.check_invariants());
        if (this->HasFailure()) return;
      }
      splits += flat.splits;
      merges += flat.merges;
      remerged += flat.remerged;
      predicted_remerges += flat.predicted_remerges;
      sampled += flat.not_sampled;
      for_coverage += flat.for_coverage;
      for_grazing_ends += flat.for_grazing_ends;
      partly_seen += flat.partly_seen;
      kept_occupied += flat.kept_occupied;
      unclear_passes += flat.unclear_passes;
      stayed_apart += flat.stayed_apart;
    }
  EXPECT_GE(for_coverage, D == 1 ? 0u : N == 2 ? 20u : 5u);
  EXPECT_GE(for_grazing_ends, D == 1 ? 0u : N <= 3 ? 5u : 2u);
  EXPECT_GE(partly_seen, D == 1 ? 0u : N == 2 ? 30u : 5u);
  EXPECT_GE(kept_occupied, D < 4 ? 50u : 5u);
  EXPECT_GE(unclear_passes, 5u);
  EXPECT_GE(stayed_apart, D == 1 ? 5u : N == 2 && D == 2 ? 1u : 0u);
  EXPECT_GE(splits, 30u);
  EXPECT_GE(merges, 5u);
  EXPECT_GE(remerged, 5u);
  EXPECT_GE(predicted_remerges, 2u);
  EXPECT_GE(sampled, D == 1 ? 0u : 1000u);
}

/// A sensor of one's own for the default: its noise grows linearly. Its beams are packed several at a time.
class LinearNoise : public BeamSensorModel {
 public:
  using BeamSensorModel::BeamSensorModel;
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles sigma(const Doubles& range) const {
    return 0.1 + unfused(0.05 * range);
  }
};
/// The same, whose beams are packed one by one.
class PlainLinearNoise : public BeamSensorModel {
 public:
  using BeamSensorModel::BeamSensorModel;
  [[nodiscard]] double sigma(double range) const { return 0.1 + unfused(0.05 * range); }
};
#ifdef NDTREE_HAS_EIGHTS
static_assert(kPacksByEights<BeamSensorModel> && kPacksByEights<LinearNoise> &&
              !kPacksByEights<PlainLinearNoise>);
#endif

TEST(ScanUpdate, TakesASensorOfOnesOwn) {
  constexpr int D = 3;
  Random random(141);
  MapOptions options = spelled_out_options(kUnit, 4.0 * kUnit);
  options.covered_share = 0.5;
  options.sample_beams = 0.3;
  OccupancyMap<2, D, EvidenceRefinement, LinearNoise> map(options);
  OccupancyMap<2, D, EvidenceRefinement, PlainLinearNoise> plain(options);
  FlatScanMap<2, D, LinearNoise> flat(options, -2, 2);
  AdaptiveMap<2, D> other(options);
  const double size = 2.0 * 4.0 * kUnit - 3.0 * (0.1 + 0.05 * 16.0 * kUnit) - kUnit / 4.0;
  for (int i = 0; i < 12; ++i) {
    Scan<D> scan = random_scan<D>(random, 60, size, 0.0, 0.3 * size);
    scan.origins = scan.origins.leftCols(1).eval();  // Of which lists go by vectors.
    Simd::limit(i % 3 == 0 ? 1 : i % 3 == 1 ? 8 : Simd::kWidest);
    map.insert(scan);
    plain.insert(scan);
    Simd::limit(Simd::kWidest);
    other.insert(scan);
    flat.insert(scan, kUnlimitedRange);
    expect_equal(map, flat);
    expect_equal(plain, flat);
    if (HasFailure()) return;
  }
  EXPECT_NE(map.stats().observed_leaves, other.stats().observed_leaves) << "the noise matters";
}

/// More beams than are partitioned at once, of one origin and of several.
TYPED_TEST(ScanUpdateOf, LongListsSayWhatEachOfTheirBeamsDoes) {
  NDTREE_SHAPE;
  if constexpr (D > 2) return;  // The plain map takes too long; pieces are put together as in the plane.
  Random random(144);
  MapOptions options = spelled_out_options(kUnit, kUnit * N);
  options.scan_beams = 1e6;
  for (const double sample_beams : {1e6, 5.0}) {
    options.sample_beams = sample_beams;
    AdaptiveMap<N, D> map(options);
    FlatScanMap<N, D> flat(options, -2, 2);
    for (int i = 0; i < 3; ++i) {
      Scan<D> scan = random_scan<D>(random, 2600, 0.9 * kUnit * N, 0.0, 0.3 * i * kUnit * N);
      if (i > 0) scan.origins = scan.origins.leftCols(1).eval();
      map.insert(scan, kUnlimitedRange, 1);
      flat.insert(scan, kUnlimitedRange);
      expect_equal(map, flat);
      if (this->HasFailure()) return;
    }
  }
}

/// The evidence of the first of many beams must not decide about an occupied cell.
TYPED_TEST(ScanUpdateOf, OccupiedCellsOfManyBeamsAreWeighedAsAWhole) {
  NDTREE_SHAPE;
  Random random(143);
  MapOptions options = spelled_out_options(kUnit, kUnit * N);
  options.range_sigma = 0.5 * kUnit * N;  // Noise brings hits anywhere in a cell: they alone split none.
  options.noise_sigmas = 0.0;
  options.sample_beams = 1e6;
  std::uint64_t occupied = 0;
  std::uint64_t splits = 0;
  for (int i = 0; i < 10; ++i) {
    AdaptiveMap<N, D> map(options);
    FlatScanMap<N, D> flat(options, -4, 4);
    for (int k = 0; k < 5; ++k) {
      Scan<D> scan;
      scan.origins = Vector<D>::Constant(-0.6 * kUnit * N);
      scan.endpoints.resize(D, 150);
      scan.returned.resize(150);
      for (Eigen::Index b = 0; b < scan.size(); ++b) {
        for (int a = 0; a < D; ++a) scan.endpoints(a, b) = random.uniform(0.0, 0.99 * kUnit * N);
        scan.returned[b] = !random.chance(0.1 + 0.015 * i * k);
        if (!scan.returned[b]) scan.endpoints.col(b) *= 1.5;
      }
      map.insert(scan);
      flat.insert(scan, kUnlimitedRange);
      expect_equal(map, flat);
      if (this->HasFailure()) return;
      const auto cell = flat.cells.find(CellIndex<D>{});
      occupied += cell != flat.cells.end() && cell->second.state() == CellState::occupied;
    }
    splits += flat.splits;
  }
  EXPECT_GE(occupied, 5u);
  EXPECT_GE(splits, D == 1 ? 0u : 3u);
}

TYPED_TEST(ScanUpdateOfTwo, AnyOrderOfBeamsAndNumberOfThreadsGivesTheSameMap) {
  NDTREE_SHAPE;
  Random random(139);
  MapOptions options = spelled_out_options(0.1, 0.1 * N * N);
  options.free_memory = 5.0;
  options.sample_beams = 0.02;  // Not all beams count.
  options.covered_share = 0.75;
  AdaptiveMap<N, D> alone(options);
  AdaptiveMap<N, D> others[3] = {alone, alone, alone};
  std::uint64_t splits = 0;
  for (int scans = 0; scans < 4; ++scans) {
    Scan<D> scan = random_scan<D>(random, 2500, D >= 4 ? 0.8 : 2.0, 0.0, 0.3 * scans);
    if (scans % 2 == 0) scan.origins = scan.origins.leftCols(1).eval();  // All from one place.
    const InsertReport report = alone.insert(scan, 3.0, 1);
    ASSERT_NO_THROW(alone.check_invariants());
    splits += report.splits;
    const std::string bytes = to_bytes(alone);
    for (int i = 0; i < 3; ++i) {
      if (i == 1) Simd::limit(1);             // As machines without vectors do it.
      const int threads = (i + 2) * (i + 1);  // 2, 6, 12
      const InsertReport other = others[i].insert(i == 2 ? shuffled(random, scan) : scan, 3.0, threads);
      Simd::limit(Simd::kWidest);
      ASSERT_TRUE(to_bytes(others[i]) == bytes);
      ASSERT_NO_THROW(others[i].check_invariants());
      EXPECT_EQ(other.updates, report.updates);
      EXPECT_EQ(other.splits, report.splits);
      EXPECT_EQ(other.merges, report.merges);
    }
  }
  EXPECT_GT(splits, 5u);
  AdaptiveMap<N, D> map(options);
  EXPECT_THROW(map.insert(random_scan<D>(random, 5, 1.0, 0.0, 0.3), 3.0, -1), std::invalid_argument);
  EXPECT_EQ(map.stats().nodes, 1u);
}

/// Far beams are noisier: the part of a scan that has only near ones must not grow the tree less.
TYPED_TEST(ScanUpdateOfTwo, AnyNumberOfThreadsGrowsTheSameTree) {
  NDTREE_SHAPE;
  Random random(141);
  MapOptions options = spelled_out_options(0.1, 0.1 * N);
  options.range_sigma_quadratic = 0.05;
  for (int i = 0; i < 25; ++i) {
    Scan<D> scan;
    scan.origins = Points<D>::Constant(D, 1, random.uniform(-0.2, 0.2));
    scan.endpoints =
        Points<D>::Zero(D, 2000);  // Two parts: of near beams one way, of far beams the other way.
    scan.endpoints.row(0).head(1000).setConstant(random.uniform(0.3, 6.5));
    scan.endpoints.row(0).tail(1000).setConstant(-random.uniform(0.3, 6.5));
    AdaptiveMap<N, D> alone(options);
    AdaptiveMap<N, D> two(options);
    alone.insert(scan, kUnlimitedRange, 1);
    two.insert(scan, kUnlimitedRange, 2);
    ASSERT_TRUE(to_bytes(two) == to_bytes(alone)) << i;
  }
}

TYPED_TEST(ScanUpdateOfTwo, ThreadsBringLargeScansInMorePartsThanTheyAre) {
  NDTREE_SHAPE;
  Random random(149);
  MapOptions options = spelled_out_options(0.2, 0.2 * N);
  options.sample_beams = 1e9;  // All of them.
  AdaptiveMap<N, D> alone(options);
  AdaptiveMap<N, D> others[3] = {alone, alone, alone};
  const Box<D> window{Vector<D>::Constant(-0.3), Vector<D>::Constant(0.5)};
  for (int i = 0; i < 2; ++i) {
    Scan<D> scan = random_scan<D>(random, 25000, 0.8, 0.0, 0.1);
    if (i == 1) scan.origins = scan.origins.leftCols(1).eval();
    const std::optional<Box<D>> in = i == 0 ? std::nullopt : std::optional<Box<D>>(window);
    alone.insert(scan, 3.0, 1, in);
    const std::string bytes = to_bytes(alone);
    for (int t = 0; t < 3; ++t) {
      others[t].insert(scan, 3.0, 2 + t, in);
      ASSERT_TRUE(to_bytes(others[t]) == bytes) << i << ", " << 2 + t << " threads";
      ASSERT_NO_THROW(others[t].check_invariants());
    }
  }
}

TYPED_TEST(ScanUpdateOfTwo, ThreadsShareTheInsideOfACoarseCell) {
  NDTREE_SHAPE;
  Random random(141);
  const MapOptions options = spelled_out_options(0.05, 0.05 * N * N * N * N);
  AdaptiveMap<N, D> alone(options);
  AdaptiveMap<N, D> shared(options);
  for (int i = 0; i < 12; ++i) {
    const bool is_all_over = i % 2 == 0;  // Others are in a corner; most of the map does not change.
    Scan<D> scan = random_scan<D>(random, 6000, is_all_over ? 0.4 : 0.02, 0.0, 0.01);
    scan.origins.array() += is_all_over ? 0.4 : 0.38;
    scan.endpoints.array() += is_all_over ? 0.4 : 0.38;
    if (i % 4 < 2) scan.origins = scan.origins.leftCols(1).eval();
    const InsertReport report = alone.insert(scan, 3.0, 1);
    const InsertReport other = shared.insert(scan, 3.0, 6);
    ASSERT_TRUE(to_bytes(shared) == to_bytes(alone)) << i;
    ASSERT_NO_THROW(shared.check_invariants());
    EXPECT_EQ(other.splits, report.splits);
    EXPECT_EQ(other.merges, report.merges);
    EXPECT_EQ(other.updates, report.updates);
  }
}

TYPED_TEST(ScanUpdateOfTwo, NothingIsOccupiedWithoutAHitNearby) {
  NDTREE_SHAPE;
  Random random(136);
  int occupied = 0;
  for (int worlds = 0; worlds < 12; ++worlds) {
    MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, N == 2 ? 4 : 2));
    options.range_sigma = random.uniform(0.03, 0.1);
    options.range_sigma_quadratic = worlds % 3 == 2 ? 0.03 : 0.0;
    options.noise_sigmas = worlds % 4 == 0 ? 1.0 : 4.0;
    AdaptiveMap<N, D> map(options);
    const Room<D> room(random, Vector<D>::Constant(random.uniform(-0.5, 0.5)), 1.51, 50);
    std::vector<std::pair<Vector<D>, double>> ends;  // With three standard deviations.
    for (int i = 0; i < 10; ++i) {
      const Scan<D> scan = worlds % 2 == 0 ? room.scan(random, options.range_sigma)
                                           : random_scan<D>(random, 50, 2.0, 0.0, i < 6 ? 0.5 : 1.9);
      map.insert(scan);
      for (Eigen::Index k = 0; k < scan.size(); ++k) {
        if (scan.returned.size() != 0 && !scan.returned[k]) continue;
        const auto origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : k);
        const double squared_range = (scan.endpoints.col(k) - origin).squaredNorm();
        ends.emplace_back(scan.endpoints.col(k),
                          3.0 * (options.range_sigma + options.range_sigma_quadratic * squared_range));
      }
    }
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      if (leaf.cell().state() != CellState::occupied) return;
      const Box<D> box = map.tree().box(leaf.index);
      const double size = map.tree().geometry().cell_size(leaf.index.level);
      EXPECT_TRUE(std::any_of(
          ends.begin(), ends.end(),
          [&](const auto& end) { return std::sqrt(box.squared_distance(end.first)) <= end.second + size; }))
          << "level " << leaf.index.level << ", " << text_of(leaf.cell());
      ++occupied;
    });
  }
  EXPECT_GT(occupied, 30);
}

TYPED_TEST(ScanUpdateOfTwo, StationaryInputSettles) {
  NDTREE_SHAPE;
  Random random(137);
  for (const bool noisy : {false, true}) {
    MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, N == 2 ? 4 : 2));
    options.range_sigma = 0.03;
    AdaptiveMap<N, D> map(options);
    const Room<D> room(random, Vector<D>::Constant(0.13), 1.01, 200);
    const Scan<D> first = room.scan(random, options.range_sigma);
    std::uint64_t in_second_half = 0;
    std::uint64_t changes = 0;
    for (int i = 0; i < 240; ++i) {
      const InsertReport report = map.insert(noisy ? room.scan(random, options.range_sigma) : first);
      changes += report.splits + report.merges;
      if (i >= 120) in_second_half += report.splits + report.merges;
    }
    const MapStats stats = map.stats();
    EXPECT_GT(changes, 0u);
    EXPECT_LE(changes, 100 + 5 * stats.observed_leaves / 2);
    // In 120 scans, fifteen and of a hundred cells two; noise moves end points between cells.
    const double share = noisy ? 0.6 : 0.02;
    EXPECT_LE(static_cast<double>(in_second_half), 15.0 + share * static_cast<double>(stats.observed_leaves));
  }
}

}  // namespace
}  // namespace ndtree::test::test_scan_update
