// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
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

/// The default without a least thickness of surfaces, so that noise much below a cell is tried, too.
struct SharpRefinement : EvidenceRefinement {
  using EvidenceRefinement::EvidenceRefinement;
  template <class Tree, class Sensor>
  using Update = ScanUpdate<Tree, SharpRefinement, Sensor>;
  [[nodiscard]] static double least_sigma(const MapOptions&) { return 0.0; }
};
template <int N, int D>
using AdaptiveMap = OccupancyMap<N, D, SharpRefinement, BeamSensorModel>;

template <int D>
Scan<D> scan_of(const std::vector<Vector<D>>& origins, const std::vector<Vector<D>>& endpoints) {
  Scan<D> scan;
  scan.origins.resize(D, static_cast<Eigen::Index>(origins.size()));
  scan.endpoints.resize(D, static_cast<Eigen::Index>(endpoints.size()));
  for (std::size_t i = 0; i < origins.size(); ++i)
    scan.origins.col(static_cast<Eigen::Index>(i)) = origins[i];
  for (std::size_t i = 0; i < endpoints.size(); ++i)
    scan.endpoints.col(static_cast<Eigen::Index>(i)) = endpoints[i];
  return scan;
}

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
    result.origins.col(i).swap(result.origins.col(j));
    result.endpoints.col(i).swap(result.endpoints.col(j));
    std::swap(result.returned[i], result.returned[j]);
  }
  return result;
}

/// The sum of twelve uniform numbers: nearly normal, and never beyond six.
inline double normal(Random& random) {
  double sum = -6.0;
  for (int i = 0; i < 12; ++i) sum += random.uniform();
  return sum;
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
      for (int a = 0; a < D; ++a) direction[a] = normal(random);
      directions.push_back(direction.normalized());
    }
  }
  [[nodiscard]] Scan<D> scan(Random& random, double sigma) const {
    std::vector<Vector<D>> endpoints;
    for (const Vector<D>& direction : directions) {
      double range = HUGE_VAL;
      for (int a = 0; a < D; ++a)
        if (direction[a] != 0.0)
          range = std::min(range, (std::copysign(half, direction[a]) - origin[a]) / direction[a]);
      endpoints.push_back(origin + (range + sigma * normal(random)) * direction);
    }
    return scan_of<D>({origin}, endpoints);
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

constexpr double kUnit = 0.25;

TYPED_TEST(ScanUpdateOf, EveryCellOfOneSizeGetsTheSumOverTheBeams) {
  NDTREE_SHAPE;
  Random random(130);
  SCOPED_TRACE(random.trace());
  struct Row {
    double range_sigma, evidence_memory, max_range;
  };
  const Row rows[] = {{0.06, 200.0, kUnlimitedRange}, {0.2, 200.0, 1.0}, {0.2, 2.0, kUnlimitedRange}};
  const int cells = D <= 2 ? 12 : D == 3 ? 6 : 4;  // From -cells to cells on each axis.
  int beams = 0;
  std::uint64_t hits = 0;
  for (const Row& row : rows)
    for (const double grid : {0.0, kUnit / 4.0}) {
      MapOptions options = spelled_out_options(kUnit, kUnit);
      options.range_sigma = row.range_sigma;
      options.evidence_memory = row.evidence_memory;
      AdaptiveMap<N, D> map(options);
      FlatScanMap<N, D> flat(options, -cells, cells);
      const double size = cells * kUnit - 3.0 * row.range_sigma - 0.01;
      for (int i = 0; i < 4; ++i) {
        const Scan<D> scan = random_scan<D>(random, 25, size, grid, 0.125);
        const std::uint64_t before = flat.updates;
        const InsertReport report = map.insert(scan, row.max_range);
        flat.insert(scan, row.max_range);
        EXPECT_EQ(report.updates, flat.updates - before);
        EXPECT_EQ(report.splits + report.merges, 0u);
        expect_equal(map, flat);
        ASSERT_NO_THROW(map.check_invariants());
        beams += 25;
      }
      for (const auto& [index, cell] : flat.cells) hits += cell.hits();
    }
  EXPECT_EQ(beams, 3 * 2 * 4 * 25);
  EXPECT_GT(hits, 100u);
}

TYPED_TEST(ScanUpdateOf, BeamsThatAreCutHaveTheNoiseOfTheirLengthAfterTheCut) {
  NDTREE_SHAPE;
  Random random(132);
  SCOPED_TRACE(random.trace());
  const double coarsest = kUnit * (N == 2 ? 4 : N);
  MapOptions options = spelled_out_options(kUnit, coarsest);
  const double cut = 0.75 * coarsest;
  options.range_sigma = 0.02 * kUnit;
  options.range_sigma_quadratic = 0.1 * kUnit / (cut * cut);
  options.noise_sigmas = 3.0;
  options.sample_beams = 1e6;
  AdaptiveMap<N, D> map(options);
  FlatScanMap<N, D> flat(options, -2, 2);
  // Coarse hits, and then beams that pass them, are cut, and can place what they see.
  for (int i = 0; i < 12; ++i) {
    const double size = i % 2 == 0 ? 0.4 * coarsest : 2.0 * coarsest - kUnit;
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
  SCOPED_TRACE(random.trace());
  struct Row {
    double range_sigma, range_sigma_quadratic, noise_sigmas, merge_loss, evidence_memory, free_memory,
        scan_beams, known_evidence, sample_beams, covered_share, coverage_cells;
    double beam_divergence = 0.0;
    double partial_probability = 0.0;
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
      {0.06, 0.0, 1.0, 4.0, 200.0, 20.0, 16.0, 1.0, 1e6, 0.5, 2.0, 0.0, 0.6}};  // What is thin stays.
  const int levels = N == 2 ? 2 : 1;
  const double coarsest = kUnit * std::pow(N, levels);
  int scans = 0;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  std::uint64_t remerged = 0;
  std::uint64_t predicted_remerges = 0;
  std::uint64_t sampled = 0;
  std::uint64_t for_coverage = 0;
  std::uint64_t for_grazing_ends = 0;
  std::uint64_t partly_seen = 0;
  std::uint64_t kept_occupied = 0;
  std::uint64_t unclear_passes = 0;
  std::uint64_t stayed_apart = 0;
  for (const Row& row : rows)
    for (const double grid : {0.0, kUnit / 4.0}) {
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
      FlatScanMap<N, D> flat(options, -2, 2);
      const double reach = 2.0 * coarsest;
      const double size =
          reach - 3.0 * (row.range_sigma + row.range_sigma_quadratic * 4.0 * D * reach * reach) - kUnit / 4.0;
      for (int i = 0; i < 12; ++i, ++scans) {     // Half-way the wall is taken away.
        const int beams = i % 6 == 5 ? 120 : 30;  // Leaves of many beams may split before all are weighed.
        Scan<D> scan = random_scan<D>(random, beams, size, grid, (i < 6 ? 0.2 : 0.9) * size);
        if (i / 3 % 2 == 0) scan.origins = scan.origins.leftCols(1).eval();  // Of which lists go by vectors.
        if (i % 4 == 3) scan.range_sigma = Eigen::ArrayXd::LinSpaced(beams, 0.1, 1.0) * row.range_sigma;
        Simd::limit(i % 3 == 0 ? 1 : i % 3 == 1 ? 8 : Simd::kWidest);
        map.insert(scan);
        Simd::limit(Simd::kWidest);
        flat.insert(scan, kUnlimitedRange);
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
  EXPECT_EQ(scans, 11 * 2 * 12);
  EXPECT_GE(for_coverage, D == 1 ? 0u : N == 2 ? 20u : 5u);
  EXPECT_GE(for_grazing_ends, D == 1 ? 0u : N <= 3 ? 5u : 2u);
  EXPECT_GE(partly_seen, D == 1 ? 0u : N == 2 ? 30u : 5u);
  EXPECT_GE(kept_occupied, D < 4 ? 50u : 5u);
  EXPECT_GE(unclear_passes, 5u);
  EXPECT_GE(stayed_apart, N == 2 && D <= 2 ? 5u : 0u);
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
    return 0.01 + unfused(0.005 * range);
  }
};
/// The same, whose beams are packed one by one.
class PlainLinearNoise : public BeamSensorModel {
 public:
  using BeamSensorModel::BeamSensorModel;
  [[nodiscard]] double sigma(double range) const { return 0.01 + unfused(0.005 * range); }
};
#ifdef NDTREE_HAS_EIGHTS
static_assert(kPacksByEights<BeamSensorModel> && kPacksByEights<LinearNoise> &&
              !kPacksByEights<PlainLinearNoise>);
#endif

TYPED_TEST(ScanUpdateOf, ASurfaceIsAsThickAsASmallestCell) {
  NDTREE_SHAPE;
  Random random(142);
  SCOPED_TRACE(random.trace());
  MapOptions options = spelled_out_options(kUnit, kUnit * N);
  const double least = kUnit / kThinnestSurface;
  options.range_sigma = least;
  ndtree::AdaptiveMap<N, D> thick(options);
  OccupancyMap<N, D, EvidenceRefinement, LinearNoise> of_ones_own(options);
  AdaptiveMap<N, D> sharp(options);
  options.range_sigma = 0.001;
  ndtree::AdaptiveMap<N, D> map(options);
  ndtree::AdaptiveMap<N, D> by_beam(options);
  for (int i = 0; i < 6; ++i) {
    Scan<D> scan = random_scan<D>(random, 40, 0.9 * kUnit * N, 0.0, 0.2 * kUnit * N);
    if (i % 2 == 0) scan.origins = scan.origins.leftCols(1).eval();
    for (auto* one : {&thick, &map}) one->insert(scan);
    of_ones_own.insert(scan);
    sharp.insert(scan);
    scan.range_sigma = Eigen::ArrayXd::Constant(scan.size(), i % 3 == 0 ? least : 0.002);
    by_beam.insert(scan);
  }
  const auto expected = passed_of(leaves_of(thick.tree()));
  EXPECT_GT(expected.size(), 1u);
  EXPECT_TRUE(passed_of(leaves_of(map.tree())) == expected) << "the sensor's noise";
  EXPECT_TRUE(passed_of(leaves_of(by_beam.tree())) == expected) << "noise of each beam";
  EXPECT_TRUE(passed_of(leaves_of(of_ones_own.tree())) == expected) << "another sensor's";
  EXPECT_TRUE(passed_of(leaves_of(sharp.tree())) == expected) << "as large as the least";
}

TEST(ScanUpdate, TakesASensorOfOnesOwn) {
  constexpr int D = 3;
  Random random(141);
  SCOPED_TRACE(random.trace());
  MapOptions options = spelled_out_options(kUnit, 4.0 * kUnit);
  options.covered_share = 0.5;
  options.sample_beams = 0.3;
  OccupancyMap<2, D, SharpRefinement, LinearNoise> map(options);
  OccupancyMap<2, D, SharpRefinement, PlainLinearNoise> plain(options);
  FlatScanMap<2, D, LinearNoise> flat(options, -2, 2);
  AdaptiveMap<2, D> other(options);
  const double size = 2.0 * 4.0 * kUnit - 3.0 * (0.01 + 0.005 * 16.0 * kUnit) - kUnit / 4.0;
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
  SCOPED_TRACE(random.trace());
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
  SCOPED_TRACE(random.trace());
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

TYPED_TEST(ScanUpdateOf, TheOrderOfAScansBeamsDoesNotMatter) {
  NDTREE_SHAPE;
  Random random(133);
  SCOPED_TRACE(random.trace());
  int orders = 0;
  for (const double grid : {0.0, 0.025}) {
    MapOptions options = spelled_out_options(0.1, 0.1 * N * N);
    options.evidence_memory = 20.0;
    options.covered_share = 0.75;
    AdaptiveMap<N, D> map(options);
    for (int i = 0; i < 5; ++i) {
      const Scan<D> scan = random_scan<D>(random, 80, 2.0, grid, 0.3 * i);
      AdaptiveMap<N, D> others[3] = {map, map, map};
      map.insert(scan, 3.0);
      ASSERT_NO_THROW(map.check_invariants());
      const std::string bytes = to_bytes(map);
      Scan<D> backwards = scan;
      backwards.origins = scan.origins.rowwise().reverse().eval();
      backwards.endpoints = scan.endpoints.rowwise().reverse().eval();
      backwards.returned = scan.returned.reverse().eval();
      others[0].insert(backwards, 3.0);
      others[1].insert(shuffled(random, scan), 3.0);
      others[2].insert(shuffled(random, scan), 3.0);
      for (const auto& other : others) {
        ASSERT_TRUE(to_bytes(other) == bytes);
        ++orders;
      }
    }
    EXPECT_GT(map.stats().observed_leaves, 10u);
  }
  EXPECT_EQ(orders, 30);
}

TYPED_TEST(ScanUpdateOf, AnyNumberOfThreadsGivesTheSameMap) {
  NDTREE_SHAPE;
  Random random(139);
  SCOPED_TRACE(random.trace());
  MapOptions options = spelled_out_options(0.1, 0.1 * N * N);
  options.free_memory = 5.0;
  options.sample_beams = 0.02;  // Not all beams count.
  options.covered_share = 0.75;
  AdaptiveMap<N, D> alone(options);
  AdaptiveMap<N, D> others[3] = {alone, alone, alone};
  int scans = 0;
  std::uint64_t splits = 0;
  for (; scans < 4; ++scans) {
    Scan<D> scan = random_scan<D>(random, 2500, D >= 4 ? 0.8 : 2.0, 0.0, 0.3 * scans);
    if (scans % 2 == 0) scan.origins = scan.origins.leftCols(1).eval();  // All from one place.
    const InsertReport report = alone.insert(scan, 3.0, 1);
    ASSERT_NO_THROW(alone.check_invariants());
    splits += report.splits;
    const std::string bytes = to_bytes(alone);
    for (int i = 0; i < 3; ++i) {
      if (i == 1) Simd::limit(1);  // As machines without vectors do it.
      const InsertReport other = others[i].insert(scan, 3.0, (i + 2) * (i + 1));  // 2, 6, 12
      Simd::limit(Simd::kWidest);
      ASSERT_TRUE(to_bytes(others[i]) == bytes);
      ASSERT_NO_THROW(others[i].check_invariants());
      EXPECT_EQ(other.updates, report.updates);
      EXPECT_EQ(other.splits, report.splits);
      EXPECT_EQ(other.merges, report.merges);
    }
  }
  EXPECT_EQ(scans, 4);
  EXPECT_GT(splits, 5u);
  AdaptiveMap<N, D> map(options);
  EXPECT_THROW(map.insert(random_scan<D>(random, 5, 1.0, 0.0, 0.3), 3.0, -1), std::invalid_argument);
  EXPECT_EQ(map.stats().nodes, 1u);
}

/// Far beams are noisier: the part of a scan that has only near ones must not grow the tree less.
TYPED_TEST(ScanUpdateOf, AnyNumberOfThreadsGrowsTheSameTree) {
  NDTREE_SHAPE;
  Random random(141);
  SCOPED_TRACE(random.trace());
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

TYPED_TEST(ScanUpdateOf, ThreadsBringLargeScansInMorePartsThanTheyAre) {
  NDTREE_SHAPE;
  Random random(149);
  SCOPED_TRACE(random.trace());
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

TYPED_TEST(ScanUpdateOf, ThreadsShareTheInsideOfACoarseCell) {
  NDTREE_SHAPE;
  Random random(141);
  SCOPED_TRACE(random.trace());
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

TYPED_TEST(ScanUpdateOf, FilesHoldAllOfAMap) {
  NDTREE_SHAPE;
  Random random(134);
  SCOPED_TRACE(random.trace());
  AdaptiveMap<N, D> map(spelled_out_options(0.1, 0.1 * N * N));
  int scans = 0;
  for (; scans < 6; ++scans) {
    map.insert(random_scan<D>(random, 60, 2.0, 0.0, 0.5));
    const std::string bytes = to_bytes(map);
    AdaptiveMap<N, D> again = from_bytes<AdaptiveMap<N, D>>(bytes);
    ASSERT_TRUE(to_bytes(again) == bytes);
    ASSERT_EQ(passed_of(leaves_of(again.tree())), passed_of(leaves_of(map.tree())));
    ASSERT_EQ(map_file_header(bytes).refinement, "evidence");
    const Scan<D> next = random_scan<D>(random, 20, 2.0, 0.0, -0.5);
    map.insert(next);
    again.insert(next);
    ASSERT_TRUE(to_bytes(again) == to_bytes(map)) << "a loaded map goes on as the original";
  }
  EXPECT_EQ(scans, 6);
}

TYPED_TEST(ScanUpdateOf, ALongWayAndAHitSplitUnknownSpaceAtOnce) {
  NDTREE_SHAPE;
  Random random(135);
  SCOPED_TRACE(random.trace());
  const int levels = N == 2 ? 5 : N == 3 ? 3 : 2;
  int beams = 0;
  int finest = 0;
  int noisy = 0;
  int clear = 0;
  for (const double sigma : {0.002, 0.03, 0.11})
    for (const double noise_sigmas : {0.0, 1.0, 4.0})
      for (int i = 0; i < 40; ++i, ++beams) {
        MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, levels));
        options.range_sigma = sigma;
        options.noise_sigmas = noise_sigmas;
        AdaptiveMap<N, D> map(options);
        const auto& geometry = map.tree().geometry();
        const double size = geometry.cell_size(0);
        const Box<D> whole{Vector<D>::Zero(), Vector<D>::Constant(size)};
        Vector<D> from = random_point(random, whole);
        Vector<D> to = random_point(random, whole);
        while ((to - from).norm() < 0.5 * size) {
          from = random_point(random, whole);
          to = random_point(random, whole);
        }
        const double range = (to - from).norm();
        map.insert(scan_of<D>({from}, {to}));
        ASSERT_NO_THROW(map.check_invariants());

        const auto end = *map.tree().find_leaf(to);
        double way = 0.0;   // Length in the cell of the end point, up to the end point.
        double rest = 0.0;  // Length behind the end point.
        traverse_beam(map.tree(), from, Vector<D>(to - from), 0.0, 1.0 + 3.0 * sigma / range,
                      [&](const auto& leaf, double t_enter, double t_exit) {
                        if (leaf.index == end.index) {
                          way = (1.0 - t_enter) * range;
                          rest = (t_exit - 1.0) * range;
                        }
                        // F(exit + 5/3) < probability_min = 0.4, by a margin.
                        if ((t_exit - 1.0) * range < -1.93 * sigma) {
                          EXPECT_EQ(leaf.cell().state(), CellState::free) << text_of(leaf.cell());
                        }
                      });
        if (way > 0.5 * sigma &&
            rest > 0.5 * sigma) {  // F(0.5) - F(-0.5) / 2 = 0.54: more occupied than not.
          EXPECT_EQ(end.cell().state(), CellState::occupied);
          ++clear;
        }
        // As fine as possible, as the noise allows, or as the hit asks for. On a line all siblings can join.
        const double end_size = geometry.cell_size(end.index.level);
        const bool is_finest = end.index.level == geometry.finest_level();
        const bool is_noisy = end_size / N < noise_sigmas * sigma;
        const bool is_shallow = end_size <= 3.0 * sigma && way <= 3.0 * sigma;
        EXPECT_TRUE(D == 1 || is_finest || is_noisy || is_shallow) << end_size << ", way " << way;
        EXPECT_TRUE(D == 1 || is_noisy || end.index.level < 0);
        // Behind the end point, cells may split that the beam enters at a grazing angle.
        const auto splits_for_hit = static_cast<std::uint64_t>(-end.index.level);
        EXPECT_GE(map.counters().splits, splits_for_hit);
        if (rest > 3.0 * sigma) {
          EXPECT_EQ(map.counters().splits, splits_for_hit);
        }
        finest += is_finest;
        noisy += !is_finest && is_noisy;
        for_each_leaf(map.tree(), [&](const auto& leaf) {
          EXPECT_TRUE(leaf.index.level >= 0 || geometry.cell_size(leaf.index.level) >= noise_sigmas * sigma);
        });
        if (this->HasFailure()) return;
      }
  EXPECT_EQ(beams, 3 * 3 * 40);
  EXPECT_GT(finest, 40);
  EXPECT_GT(noisy, 40);
  EXPECT_GT(clear, 200);
}

TYPED_TEST(ScanUpdateOf, NothingIsOccupiedWithoutAHitNearby) {
  NDTREE_SHAPE;
  Random random(136);
  SCOPED_TRACE(random.trace());
  int occupied = 0;
  int worlds = 0;
  for (; worlds < 12; ++worlds) {
    MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, N == 2 ? 4 : 2));
    options.range_sigma = random.uniform(0.01, 0.1);
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
  EXPECT_EQ(worlds, 12);
  EXPECT_GT(occupied, 30);
}

TYPED_TEST(ScanUpdateOf, StationaryInputSettles) {
  NDTREE_SHAPE;
  Random random(137);
  SCOPED_TRACE(random.trace());
  const int count = D == 1 ? 2 : 200;
  int scans = 0;
  for (const bool noisy : {false, true}) {
    MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, N == 2 ? 4 : 2));
    options.range_sigma = 0.03;
    AdaptiveMap<N, D> map(options);
    const Room<D> room(random, Vector<D>::Constant(0.13), 1.01, count);
    const Scan<D> first = room.scan(random, options.range_sigma);
    std::uint64_t in_second_half = 0;
    std::uint64_t changes = 0;
    for (int i = 0; i < 240; ++i, ++scans) {
      const InsertReport report = map.insert(noisy ? room.scan(random, options.range_sigma) : first);
      changes += report.splits + report.merges;
      if (i >= 120) in_second_half += report.splits + report.merges;
    }
    const MapStats stats = map.stats();
    EXPECT_GT(changes, 0u);
    EXPECT_LE(changes, 100 + 5 * stats.observed_leaves / 2);
    // In 120 scans, fifteen and of a hundred cells two. Noise moves end points between cells, two of which
    // are all that a beam in 1-D ever ends in: half a change a cell and more, and one every other scan.
    const double of_all = noisy && D == 1 ? 60.0 : 15.0;
    const double share = noisy ? 0.6 : 0.02;
    EXPECT_LE(static_cast<double>(in_second_half),
              of_all + share * static_cast<double>(stats.observed_leaves));
  }
  EXPECT_EQ(scans, 480);
}

TYPED_TEST(ScanUpdateOf, ChildrenKnowWhatTheirParentKnew) {
  NDTREE_SHAPE;
  Random random(138);
  SCOPED_TRACE(random.trace());
  const int levels = N == 2 ? 3 : 2;
  const double size = 0.05 * std::pow(N, levels);
  MapOptions options = spelled_out_options(0.05, size);
  options.range_sigma = 0.005;
  AdaptiveMap<N, D> map(options);
  const Box<D> whole{Vector<D>::Zero(), Vector<D>::Constant(size)};
  std::vector<Vector<D>> origins;
  std::vector<Vector<D>> endpoints;
  for (int i = 0; i < 120; ++i) {  // Through the whole cell, without a hit in it.
    origins.push_back(random_point(random, whole));
    origins.back()[0] = -0.5 * size;
    endpoints.push_back(origins.back());
    endpoints.back()[0] = 2.5 * size;
  }
  map.insert(scan_of<D>(origins, endpoints));
  const Vector<D> middle = Vector<D>::Constant(0.5 * size);
  const auto before = *map.tree().find_leaf(middle);
  ASSERT_EQ(before.index, CellIndex<D>{});
  const EvidenceCell coarse = before.cell();
  ASSERT_EQ(coarse.misses(), 120u);
  ASSERT_EQ(coarse.state(), CellState::free);

  Vector<D> from = Vector<D>::Constant(0.02);  // Along the first row of cells, into the last.
  from[0] = -0.02;
  Vector<D> hit = from;
  hit[0] = size - 0.02;
  map.insert(scan_of<D>({from}, std::vector<Vector<D>>(10, hit)));
  EXPECT_EQ(map.tree().geometry().cell_size(map.tree().find_leaf(hit)->index.level), options.min_cell_size);
  int cases = 0;
  int unvisited = 0;
  for_each_leaf_in(map.tree(), whole, [&](const auto& leaf) {
    const Box<D> box = map.tree().box(leaf.index);
    if (!whole.contains(box.lower)) return;
    ++cases;
    if (box.squared_distance(hit) > 0.0) {
      EXPECT_NE(leaf.cell().state(), CellState::occupied) << text_of(leaf.cell());
    }
    bool crossed = true;
    for (int a = 1; a < D; ++a) crossed = crossed && box.lower[a] == 0.0;
    if (crossed) {
      EXPECT_TRUE(leaf.cell().observed());
      return;
    }
    ++unvisited;
    // None of ten beams came here, nor passed the parent's siblings, in which they ended.
    const double mean = 1.0 / static_cast<double>(integer_power(N, D - 1));
    const double share = 0.05 * mean + 0.95 * (0.0 + 2.0 * mean) / (10.0 + 2.0);
    auto evidence = static_cast<double>(coarse.free_evidence());
    for (int level = 0; level > leaf.index.level; --level) evidence = std::floor(evidence * share);
    EXPECT_EQ(leaf.cell().observed(), evidence >= 104.0) << evidence;  // Of one beam.
    if (!leaf.cell().observed()) return;
    EXPECT_EQ(leaf.cell().state(), CellState::free) << text_of(leaf.cell());
    EXPECT_NEAR(static_cast<double>(leaf.cell().free_evidence()), evidence, 2.0);  // Rounded at each level.
    EXPECT_EQ(leaf.cell().occupied_evidence(), 0);
    EXPECT_EQ(leaf.cell().misses(), 0u) << "counted anew";
  });
  EXPECT_GT(cases, 3);
  EXPECT_EQ(unvisited == 0, D == 1);
}

/// The end point where two or more borders meet belongs to one cell, though the beam may only touch it.
TEST(ScanUpdate, EndPointsOnCornersCountOneHit) {
  struct Row {
    Vector<2> origin;
    Vector<2> endpoint;
  };
  const Row rows[] = {{{0.25, 0.25}, {1.0, 1.0}}, {{1.75, 1.75}, {1.0, 1.0}}, {{1.75, 1.0}, {1.0, 1.0}},
                      {{1.0, 0.25}, {1.0, 1.0}},  {{0.25, 1.75}, {1.0, 1.0}}, {{1.75, 0.25}, {1.0, 1.0}}};
  int cases = 0;
  for (const Row& row : rows) {
    SCOPED_TRACE(cases);
    AdaptiveMap<2, 2> map(spelled_out_options(0.5, 0.5));
    map.insert(scan_of<2>({row.origin}, {row.endpoint}));
    std::uint32_t hits = 0;
    for_each_leaf(map.tree(), [&](const auto& leaf) { hits += leaf.cell().hits(); });
    EXPECT_EQ(hits, 1u);
    ++cases;
  }
  EXPECT_EQ(cases, 6);
}

}  // namespace
}  // namespace ndtree::test::test_scan_update
