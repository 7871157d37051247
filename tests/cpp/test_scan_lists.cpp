// SPDX-License-Identifier: BSD-3-Clause
// The loops over lists of beams: against plain formulas, and eight at a time against one by one.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <numeric>
#include <set>
#include <utility>
#include <vector>

#include "at_a_time.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/leaf_coverage.hpp"
#include "ndtree/mapping/insert/leaf_evidence.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/partition.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_scan_lists {
namespace {

constexpr double kUnit = 0.25;

/// Random beams, of which some are parallel to axes, on borders of cells, or without return.
template <int N, int D>
struct Beams {
  MapOptions options;
  LatticeGeometry<N, D> geometry{kUnit, 2};
  BeamSensorModel sensor{options};
  ScanBeams<D> beams;
  std::vector<Beam<D>> all;

  Beams(Random& random, std::size_t count, bool own_origins, double far_away = 0.0) {
    const auto place = [&](bool on_grid) {
      const double x = random.uniform(-1.0, 1.0) * geometry.cell_size(0);
      return far_away + (on_grid ? std::round(x / kUnit) * kUnit : x);
    };
    Vector<D> origin;
    for (int a = 0; a < D; ++a) origin[a] = place(random.chance(0.3));
    CubeFace<D> face(origin, 0, false);
    face.end_of_beams = static_cast<std::uint32_t>(count);
    beams.resize(count, {face}, {0}, own_origins, geometry.coordinates(origin), true,
                 count % 2 == 1);  // Some say what they pass themselves.
    Scan<D> scan;
    scan.origins.resize(D, static_cast<Eigen::Index>(count));
    scan.endpoints.resize(D, static_cast<Eigen::Index>(count));
    scan.returned.resize(static_cast<Eigen::Index>(count));
    scan.range_sigma.resize(static_cast<Eigen::Index>(count));
    while (all.size() < count) {
      if (own_origins)
        for (int a = 0; a < D; ++a) origin[a] = place(random.chance(0.5));
      Vector<D> end;
      for (int a = 0; a < D; ++a) end[a] = random.chance(0.2) ? origin[a] : place(random.chance(0.3));
      const Beam<D> beam(origin, end, random.chance(0.8));
      if (beam.outcome == BeamOutcome::invalid) continue;
      const auto i = static_cast<Eigen::Index>(all.size());
      scan.origins.col(i) = origin;
      scan.endpoints.col(i) = end;
      scan.returned[i] = beam.outcome == BeamOutcome::returned;
      scan.range_sigma[i] = random.uniform(0.005, 0.3);
      all.push_back(beam);
    }
    const Measurements<D, BeamSensorModel> measurements(scan.view(), kUnlimitedRange, sensor);
    BeamNoise noise;
    for (std::size_t i = 0; i < count; ++i)
      beams.set(i, geometry, sensor, measurements, static_cast<Eigen::Index>(i), noise);
    beams.finish(noise);
  }
  /// All beams that cross a cell.
  [[nodiscard]] BeamList list(const CellIndex<D>& cell, ListStack& stack) const {
    BeamList list = stack.allocate(all.size() + BeamList::kSlack);
    const CellCrossings<N, D> crossings(geometry, beams, cell);
    for (std::uint32_t i = 0; i < all.size(); ++i)
      if (crossings.of(i).exit > crossings.of(i).enter) list.beam[list.size++] = i;
    list.pad();
    return list;
  }
  /// Those of a child of a cell that begins at -1 (for N = 2) or so, and is four or more cells wide.
  [[nodiscard]] CellIndex<D> root() const {
    CellIndex<D> root;
    root.level = 1;
    for (auto& lower : root.lower) lower = -(N / 2) * geometry.edge(0);
    return root;
  }
};

/// Behind the last beam, those who read many at a time find numbers of some.
template <int D>
void expect_padded(const BeamList& list, const ScanBeams<D>& beams) {
  if (Simd::width() < 8) return;  // Loops of width 1 read no padding.
  for (std::size_t i = 0; i < BeamList::kSlack; ++i) ASSERT_LT(list.beam[list.size + i], beams.size());
}

template <class S>
class ScanLists : public ::testing::Test {};
TYPED_TEST_SUITE(ScanLists, Shapes, ShapeNames);

TYPED_TEST(ScanLists, ChildrenShareTheWayOfEachBeamAmongThem) {
  NDTREE_SHAPE;
  constexpr std::size_t kAll = 20'000;  // Numbers that lists of the children may take.
  Random random(260);
  SCOPED_TRACE(random.trace());
  std::size_t crossings = 0;
  for (const bool own_origins : {false, true})
    for (const std::size_t count : {1u, 7u, 8u, 9u, 16u, 17u, 100u}) {
      const Beams<N, D> scan(random, count, own_origins);
      for (const int at_a_time : {1, 8, Simd::kWidest}) {
        const AtATime loops(at_a_time);
        const ChildPartition<N, D> partition(scan.geometry, scan.beams);
        ListStack stack;
        const CellIndex<D> root = scan.root();
        const BeamList list = scan.list(root, stack);
        const auto mark = stack.mark();
        std::fill_n(stack.allocate(kAll).beam, kAll, 0xffffffffu);
        stack.release(mark);
        auto children = partition.lists_for(root, list, stack);
        const auto planes = partition.planes_of(root);
        partition(root, planes, list, children);
        std::vector<double> ray(count, 0.0);
        for (int j = 0; j < ChildPartition<N, D>::kNumChildren; ++j) {
          const BeamList child = children.of(j);
          const Offset<D> offset = child_offset<N, D>(j);
          const CellIndex<D> index = scan.geometry.child(root, offset);
          const CellCrossings<N, D> of_child(scan.geometry, scan.beams, index);
          const CellCrossings<N, D> of_child_by_node(scan.geometry, scan.beams, index, planes, j);
          std::size_t found = 0;
          for (std::uint32_t beam = 0; beam < count; ++beam) {
            float enter = 0.0f;
            float exit = scan.beams.ray(beam).t_max;
            for (std::size_t a = 0; a < D; ++a) {
              const float inverse = scan.beams.ray(beam).inverse[a];
              const auto at = [&](int plane) {
                const double border = scan.geometry.border(root.lower[a] + plane * scan.geometry.edge(0));
                return static_cast<float>(border - scan.beams.origin(beam)[static_cast<int>(a)]) * inverse;
              };
              const bool up = inverse > 0.0f;
              enter = std::max(enter, at(up ? offset[a] : offset[a] + 1));
              exit = std::min(exit, at(up ? offset[a] + 1 : offset[a]));
            }
            ASSERT_EQ(of_child.of(beam).enter, enter);
            ASSERT_EQ(of_child.of(beam).exit, exit);
            ASSERT_EQ(of_child_by_node.of(beam).enter, enter);
            ASSERT_EQ(of_child_by_node.of(beam).exit, exit);
            if (!(exit > enter)) continue;
            ASSERT_LT(found, child.size);
            ASSERT_EQ(child.beam[found++], beam);
            ray[beam] += static_cast<double>(exit) - static_cast<double>(enter);
          }
          EXPECT_EQ(found, child.size);
          expect_padded(child, scan.beams);
          crossings += found;
        }
        const CellCrossings<N, D> of_root(scan.geometry, scan.beams, root);
        for (std::uint32_t i = 0; i < count; ++i) {
          const auto [enter, exit] = of_root.of(i);
          const double whole = exit > enter ? static_cast<double>(exit) - static_cast<double>(enter) : 0.0;
          EXPECT_NEAR(ray[i], whole, 1e-5) << "without gap or overlap";
        }
        if (this->HasFailure()) return;
      }
    }
  EXPECT_GT(crossings, 400u);
}

/// What a leaf gets, by loops of both widths; far from 0, where 32 bits do not hold the place of a cell, too.
TYPED_TEST(ScanLists, EvidenceAndCoverageAreTheSameEightAtATime) {
  NDTREE_SHAPE;
  Random random(261);
  SCOPED_TRACE(random.trace());
  std::uint64_t hits = 0;
  std::uint64_t misses = 0;
  std::int64_t seen = 0;
  for (const auto& [far_away, own_origins] :
       {std::pair{0.0, false}, std::pair{0.0, true}, std::pair{1e9 * kUnit, false}})
    for (const std::size_t count : {1u, 8u, 13u, 64u, 65u, 1500u, 5000u}) {
      const Beams<N, D> scan(random, count, own_origins, far_away);
      MapOptions options;
      options.noise_sigmas = random.uniform(0.5, 3.0);
      const EvidenceModel model(options, options);
      for (int i = 0; i < 4 * (1 - scan.geometry.finest_level()); ++i) {
        const int level = -(i / 4);
        CellIndex<D> leaf;
        leaf.level = level;
        for (auto& lower : leaf.lower)
          lower = (scan.geometry.coordinate(far_away) / scan.geometry.edge(level) + random.integer(-2, 1)) *
                  scan.geometry.edge(level);
        std::array<ScanEvidence, 2> evidence;
        std::array<ScanCoverage<N, D>, 2> coverage;
        std::array<bool, 2> all_pass{};
        for (const int wide : {0, 1}) {
          const AtATime loops(wide ? 8 : 1);
          const auto w = static_cast<std::size_t>(wide);
          const ChildPartition<N, D> partition(scan.geometry, scan.beams);
          const LeafEvidence<N, D, BeamSensorModel> leaves(scan.geometry, scan.beams, model, scan.sensor);
          ListStack stack;
          const BeamList list = scan.list(leaf, stack);
          const CellCrossings<N, D> crossings(scan.geometry, scan.beams, leaf);
          evidence[w] = leaves.of(leaf, crossings, list);
          all_pass[w] = leaves.all_pass(crossings, list);
          if (level == scan.geometry.finest_level()) continue;
          const LeafCoverage<N, D> covering(scan.beams, partition, 0.0f);
          const auto per_child = 1.0f / static_cast<float>(scan.geometry.cell_size(level - 1));
          for (const BeamWidths& widths : {BeamWidths{0.0f, 0.5f}, BeamWidths{0.3f, 0.0f}})
            covering(leaf, list, per_child, widths, CoverageModel(CoverageOptions{}), 8.0, coverage[w]);
        }
        EXPECT_EQ(evidence[0].occupied, evidence[1].occupied);
        EXPECT_EQ(evidence[0].free, evidence[1].free);
        EXPECT_EQ(evidence[0].hits, evidence[1].hits);
        EXPECT_EQ(evidence[0].misses, evidence[1].misses);
        EXPECT_EQ(evidence[0].resolvable_hits, evidence[1].resolvable_hits);
        EXPECT_EQ(evidence[0].resolvable_misses, evidence[1].resolvable_misses);
        EXPECT_EQ(evidence[0].partial_hits, evidence[1].partial_hits);
        EXPECT_EQ(evidence[0].beams, evidence[1].beams);
        EXPECT_EQ(all_pass[0], all_pass[1]);
        for (int j = 0; j < ScanCoverage<N, D>::kNumChildren; ++j) {
          EXPECT_EQ(coverage[0].units_of_child(j), coverage[1].units_of_child(j));
          seen += coverage[1].units_of_child(j);
        }
        EXPECT_EQ(coverage[0].beams_for_child(), coverage[1].beams_for_child());
        hits += evidence[1].hits;
        misses += evidence[1].misses;
      }
    }
  EXPECT_GE(hits, 5u);
  EXPECT_GT(misses, 1000u);
  EXPECT_GT(seen, 1000000);
}

#ifdef NDTREE_HAS_EIGHTS
template <int D>
NDTREE_BY_EIGHTS std::array<float, 8> passes_of_eight(const ScanBeams<D>& beams, std::uint32_t first) {
  std::array<std::uint32_t, 8> numbers;
  std::iota(numbers.begin(), numbers.end(), first);
  EightBeams<D> eight;
  beams.look_up(numbers.data(), eight);
  std::array<float, 8> passes;
  eight.t_free.store(passes.data());
  return passes;
}
#endif

/// Where the sensor says how noisy beams are, one margin tells of all beams what they surely pass: not more
/// than they do, and not much less. Beams that have noise of their own say it for themselves.
TEST(ScanBeams, SurelyPassAlmostAllThatTheyDo) {
  Random random(264);
  SCOPED_TRACE(random.trace());
  constexpr std::size_t kBeams = 400;
  SensorOptions options;
  options.range_sigma = 0.005;
  options.range_sigma_quadratic = 0.0015;
  const BeamSensorModel sensor(options);
  const LatticeGeometry<2, 3> geometry(0.05, 5);
  Scan<3> scan;
  scan.origins = Eigen::Vector3d(0.1, -0.2, 0.3);
  scan.endpoints.resize(3, kBeams);
  for (std::size_t i = 0; i < kBeams; ++i)
    for (int a = 0; a < 3; ++a) scan.endpoints(a, static_cast<Eigen::Index>(i)) = random.uniform(-2.5, 2.5);
  for (const bool own_noise : {false, true}) {
    if (own_noise) {  // One of them is far noisier than the others.
      scan.range_sigma = Eigen::ArrayXd::Constant(kBeams, 0.01);
      scan.range_sigma[7] = 2.0;
    }
    std::vector<float> passes;
    for (const int at_a_time : {1, 8}) {
      const AtATime loops(at_a_time);
      const Measurements<3, BeamSensorModel> measurements(scan.view(), kUnlimitedRange, sensor);
      ScanBeams<3> beams;
      CubeFace<3> face(scan.origins.col(0), 0, false);
      face.end_of_beams = kBeams;
      beams.resize(kBeams, {face}, {0}, false, geometry.coordinates(scan.origins.col(0)), true, own_noise);
      BeamNoise noise(static_cast<float>((3.0 + 0.26 + 5.0 / 3.0) * options.range_sigma_quadratic));
      std::size_t by_eights = 0;
      for (std::uint32_t i = 0; i < kBeams; i += 8) {
        std::array<std::uint32_t, 8> numbers;
        std::iota(numbers.begin(), numbers.end(), i);
#ifdef NDTREE_HAS_EIGHTS
        if (!own_noise && Simd::width() >= 8 &&
            beams.set_eight(i, geometry, sensor, measurements, numbers.data(), noise)) {
          ++by_eights;
          continue;
        }
#endif
        for (const std::uint32_t k : numbers) beams.set(k, geometry, sensor, measurements, k, noise);
      }
      EXPECT_GE(by_eights, !own_noise && Simd::width() >= 8 ? kBeams / 9 : 0);
      beams.finish(noise);
      for (std::uint32_t i = 0; i < kBeams; ++i) {
        const BeamEnd<3>& end = beams.end(i);
        const float t_free = beams.t_free_of(i);
        ASSERT_LE(t_free, end.clearly_free_until - end.surface);
        ASSERT_GT(t_free, end.clearly_free_until - end.surface - 0.02f);
        if (at_a_time == 1) passes.push_back(t_free);
        ASSERT_EQ(t_free, passes[i]);
#ifdef NDTREE_HAS_EIGHTS
        if (Simd::width() >= 8) {
          ASSERT_EQ(t_free, passes_of_eight(beams, i - i % 8)[i % 8]);
        }
#endif
      }
    }
  }
}

TEST(ListStack, GivesBackWhatWasAllocatedLast) {
  ListStack stack;
  const BeamList first = stack.allocate(10);
  const ListStack::Mark mark = stack.mark();
  std::set<const std::uint32_t*> places{first.beam};
  for (const std::size_t n : {100u, 16000u, 100000u, 5u}) {  // In blocks of their own, if need be.
    const BeamList list = stack.allocate(n);
    list.beam[n - 1] = 7;
    EXPECT_TRUE(places.insert(list.beam).second);
  }
  stack.release(mark);
  const BeamList again = stack.allocate(100);
  EXPECT_EQ(again.beam, first.beam + 10);
  EXPECT_EQ(stack.allocate(10).beam, first.beam + 110);
}

TEST(SiblingLists, MoveTogetherAsTheyAre) {
  ListStack stack;
  SiblingLists<4> lists;
  lists.memory = stack.allocate(4 * 108);
  const std::size_t sizes[] = {0, 100, 3, 40};
  for (std::size_t c = 0; c < 4; ++c) {
    lists.first[c] = c * 108;
    lists.last[c] = c * 108 + sizes[c];
    for (std::size_t i = lists.first[c]; i < lists.last[c]; ++i)
      lists.memory.beam[i] = static_cast<std::uint32_t>(i);
  }
  const std::size_t used = lists.pack();
  EXPECT_EQ(used, 143 + 4 * BeamList::kSlack);
  stack.shrink(lists.memory, used);
  EXPECT_EQ(stack.allocate(10).beam, lists.memory.beam + used);
  for (std::size_t c = 0; c < 4; ++c) {
    const BeamList list = lists.of(static_cast<int>(c));
    ASSERT_EQ(list.size, sizes[c]);
    for (std::size_t i = 0; i < list.size; ++i) ASSERT_EQ(list.beam[i], c * 108 + i);
  }
}

TYPED_TEST(ScanLists, InPiecesTheyAreTheSame) {
  NDTREE_SHAPE;
  using Partition = ChildPartition<N, D>;
  Random random(263);
  SCOPED_TRACE(random.trace());
  const Beams<N, D> scan(random, 300, false);
  const Partition partition(scan.geometry, scan.beams);
  ListStack stack;
  const BeamList list = scan.list(scan.root(), stack);
  auto whole = partition.lists_for(scan.root(), list, stack);
  const auto planes = partition.planes_of(scan.root());
  partition(scan.root(), planes, list, whole);
  PiecewiseLists<Partition::kNumChildren> pieces;
  for (const std::size_t piece : {7u, 64u, 300u}) {
    for (std::size_t first = 0; first < list.size; first += piece) {
      const BeamList part = list.part(first, std::min(first + piece, list.size));
      auto children = partition.lists_for(scan.root(), part, pieces.memory());
      partition(scan.root(), planes, part, children);
      pieces.add(children);
    }
    const auto joined = pieces.join(stack);
    for (int j = 0; j < Partition::kNumChildren; ++j) {
      const BeamList child = joined.of(j);
      const BeamList expected = whole.of(j);
      ASSERT_EQ(child.size, expected.size);
      for (std::size_t i = 0; i < child.size; ++i) ASSERT_EQ(child.beam[i], expected.beam[i]);
      expect_padded(child, scan.beams);
    }
    // Releasing a child's list releases the lists of the children before it.
    for (int j = 1; j < Partition::kNumChildren; ++j)
      ASSERT_GE(joined.of(j - 1).beam, joined.of(j).beam + joined.of(j).size + BeamList::kSlack);
  }
}

TEST(ListStack, FreesFromAListOnIfItIsItsOwn) {
  ListStack stack;
  ListStack other;
  other.free_from(stack.allocate(10));
  const BeamList first = stack.allocate(50);
  const BeamList second = stack.allocate(60);
  stack.free_from(other.allocate(10));
  EXPECT_EQ(stack.allocate(10).beam, second.beam + 60);
  stack.free_from(second);
  EXPECT_EQ(stack.allocate(10).beam, second.beam);
  stack.free_from(first);
  EXPECT_EQ(stack.allocate(10).beam, first.beam);
}

TEST(QuickLog, IsTheLogarithm) {
  int cases = 0;
  for (double x = 1e-300; x < 1e300; x *= 1.0137, ++cases)
    ASSERT_NEAR(quick_log(x), std::log(x), 1e-12 + 3e-16 * std::abs(std::log(x))) << x;
  EXPECT_GT(cases, 90000);
  EXPECT_EQ(quick_log(1.0), std::log(1.0)) << "nothing for and against is unknown";
}

TEST(Simd, RoundsToTheNearestAndTheEven) {
  const std::pair<float, std::int32_t> rows[] = {{0.5f, 0},   {1.5f, 2},    {2.5f, 2},         {-0.5f, 0},
                                                 {-1.5f, -2}, {2.4999f, 2}, {1e9f, 1000000000}};
  int cases = 0;
  for (const auto& [x, expected] : rows) {
    EXPECT_EQ(nearest_integer(x), expected) << x;
    ++cases;
  }
  EXPECT_EQ(cases, 7);
  EXPECT_TRUE(Simd::width() == 1 || Simd::width() == 8 || Simd::width() == Simd::kWidest);
}

}  // namespace
}  // namespace ndtree::test::test_scan_lists
