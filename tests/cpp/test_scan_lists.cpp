// SPDX-License-Identifier: BSD-3-Clause
// The loops over lists of beams: against plain formulas, and eight at a time against one by one.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "at_a_time.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/scan/beams.hpp"
#include "ndtree/mapping/scan/clip.hpp"
#include "ndtree/mapping/scan/coverage.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/mapping/scan/leaf.hpp"
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
    beams.resize(count, {ScanFace<D>(origin, 0, false)}, std::make_unique<std::uint32_t[]>(1), own_origins,
                 geometry.coordinates(origin), true);
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
    SigmaRange sigmas;
    for (std::size_t i = 0; i < count; ++i)
      beams.set(i, geometry, sensor, measurements, static_cast<Eigen::Index>(i), 0, sigmas);
    beams.finish(sigmas);
  }
  /// All beams, as far as they reach.
  [[nodiscard]] Crossings list(CrossingStack& stack) const {
    Crossings list = stack.allocate(all.size() + Crossings::kSlack);
    for (std::size_t i = 0; i < all.size(); ++i) {
      list.beam[i] = static_cast<std::uint32_t>(i);
      list.enter()[i] = 0.0f;
      list.exit()[i] = beams.reach()[i];
    }
    list.size = all.size();
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

template <class S>
class ScanLists : public ::testing::Test {};
TYPED_TEST_SUITE(ScanLists, Shapes, ShapeNames);

TYPED_TEST(ScanLists, ChildrenShareTheWayOfEachBeamAmongThem) {
  NDTREE_SHAPE;
  Random random(260);
  SCOPED_TRACE(random.trace());
  std::size_t crossings = 0;
  for (const bool own_origins : {false, true})
    for (const std::size_t count : {1u, 7u, 8u, 9u, 16u, 17u, 100u}) {
      const Beams<N, D> scan(random, count, own_origins);
      for (const int at_a_time : {1, 8, Simd::kWidest}) {
        const AtATime loops(at_a_time);
        const ChildClip<N, D> clip(scan.geometry, scan.beams);
        CrossingStack stack;
        const Crossings list = scan.list(stack);
        auto children = clip.lists_for(scan.root(), list, stack);
        clip(scan.root(), list, children);
        std::vector<double> way(count, 0.0);
        for (int j = 0; j < ChildClip<N, D>::kNumChildren; ++j) {
          const Crossings child = children.of(j);
          const Offset<D> offset = child_offset<N, D>(j);
          EXPECT_TRUE(std::is_sorted(child.beam, child.beam + child.size));
          for (std::size_t i = 0; i < child.size; ++i, ++crossings) {
            const std::uint32_t beam = child.beam[i];
            float enter = 0.0f;
            float exit = scan.beams.reach()[beam];
            for (std::size_t a = 0; a < D; ++a) {
              const auto axis = static_cast<int>(a);
              const float inverse = scan.beams.way(beam).inverse[a];
              const auto at = [&](int plane) {
                const double border =
                    scan.geometry.border(scan.root().lower[a] + plane * scan.geometry.edge(0));
                return static_cast<float>(border - scan.beams.origin(beam)[axis]) * inverse;
              };
              if (offset[a] > 0)
                (inverse > 0.0f ? enter : exit) =
                    inverse > 0.0f ? std::max(enter, at(offset[a])) : std::min(exit, at(offset[a]));
              if (offset[a] < N - 1)
                (inverse > 0.0f ? exit : enter) =
                    inverse > 0.0f ? std::min(exit, at(offset[a] + 1)) : std::max(enter, at(offset[a] + 1));
            }
            ASSERT_EQ(child.enter()[i], enter);
            ASSERT_EQ(child.exit()[i], exit);
            ASSERT_GT(exit, enter);
            way[beam] += static_cast<double>(exit) - static_cast<double>(enter);
          }
        }
        for (std::size_t i = 0; i < count; ++i)
          EXPECT_NEAR(way[i], static_cast<double>(scan.beams.reach()[i]), 1e-5) << "without gap or overlap";
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
  for (const double far_away : {0.0, 1e9 * kUnit})
    for (const std::size_t count : {1u, 8u, 13u, 64u, 65u, 1500u}) {
      const Beams<N, D> scan(random, count, false, far_away);
      MapOptions options;
      options.noise_sigmas = random.uniform(0.5, 3.0);
      const EvidenceModel model(options, options);
      for (int level = scan.geometry.finest_level(); level <= 0; ++level) {
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
          const ChildClip<N, D> clip(scan.geometry, scan.beams);
          const LeafEvidence<N, D, BeamSensorModel> leaves(scan.geometry, scan.beams, model, scan.sensor);
          CrossingStack stack;
          // Any interval will do, in the cell or not.
          Crossings list = scan.list(stack);
          for (std::size_t i = 0; i < list.size; ++i) {
            list.enter()[i] = list.exit()[i] * static_cast<float>(i % 17) / 20.0f;
            if (i % 5 != 0) list.exit()[i] *= 0.9f;
          }
          leaves.add(leaf, list, evidence[w]);
          all_pass[w] = leaves.all_pass(list);
          if (level == scan.geometry.finest_level()) continue;
          const LeafCoverage<N, D> covering(scan.beams, clip);
          for (const BeamWidths& widths : {BeamWidths{0.0f, 0.5f}, BeamWidths{0.3f, 0.0f}})
            covering(leaf, list, 2.0f, widths, coverage[w]);
        }
        EXPECT_EQ(evidence[0].occupied, evidence[1].occupied);
        EXPECT_EQ(evidence[0].free, evidence[1].free);
        EXPECT_EQ(evidence[0].hits, evidence[1].hits);
        EXPECT_EQ(evidence[0].misses, evidence[1].misses);
        EXPECT_EQ(evidence[0].resolvable_hits, evidence[1].resolvable_hits);
        EXPECT_EQ(evidence[0].resolvable_misses, evidence[1].resolvable_misses);
        EXPECT_EQ(evidence[0].deep_hits, evidence[1].deep_hits);
        EXPECT_EQ(evidence[0].beams, evidence[1].beams);
        EXPECT_EQ(all_pass[0], all_pass[1]);
        for (int j = 0; j < ScanCoverage<N, D>::kNumChildren; ++j) {
          EXPECT_EQ(coverage[0].units_of_child(j), coverage[1].units_of_child(j));
          seen += coverage[1].units_of_child(j);
        }
        EXPECT_EQ(coverage[0].of_cell(), coverage[1].of_cell());
        EXPECT_EQ(coverage[0].beams_for_child(), coverage[1].beams_for_child());
        hits += evidence[1].hits;
        misses += evidence[1].misses;
      }
    }
  EXPECT_GE(hits, 5u);
  EXPECT_GT(misses, 1000u);
  EXPECT_GT(seen, 1000000);
}

TEST(CrossingStack, GivesBackWhatWasAllocatedLast) {
  CrossingStack stack;
  const Crossings first = stack.allocate(10);
  const CrossingStack::Mark mark = stack.mark();
  std::set<const std::uint32_t*> places{first.beam};
  for (const std::size_t n : {100u, 16000u, 100000u, 5u}) {  // In blocks of their own, if need be.
    const Crossings list = stack.allocate(n);
    list.beam[n - 1] = 7;
    list.enter()[n - 1] = 1.0f;
    list.exit()[n - 1] = 2.0f;
    EXPECT_TRUE(places.insert(list.beam).second);
  }
  stack.release(mark);
  const Crossings again = stack.allocate(100);
  EXPECT_EQ(again.beam, first.beam + 10);
  EXPECT_EQ(stack.allocate(10).beam, first.beam + 110);
}

TEST(SiblingLists, MoveTogetherAsTheyAre) {
  CrossingStack stack;
  SiblingLists<4> lists;
  lists.memory = stack.allocate(4 * 108);
  const std::size_t sizes[] = {0, 100, 3, 40};
  for (std::size_t c = 0; c < 4; ++c) {
    lists.first[c] = c * 108;
    lists.last[c] = c * 108 + sizes[c];
    for (std::size_t i = lists.first[c]; i < lists.last[c]; ++i) {
      lists.memory.beam[i] = static_cast<std::uint32_t>(i);
      lists.memory.enter()[i] = static_cast<float>(i) + 0.25f;
      lists.memory.exit()[i] = static_cast<float>(i) + 0.5f;
    }
  }
  const std::size_t used = lists.pack();
  EXPECT_EQ(used, 143 + 4 * Crossings::kSlack);
  stack.shrink(lists.memory, used);
  EXPECT_EQ(stack.allocate(10).beam, lists.memory.beam + used);
  for (std::size_t c = 0; c < 4; ++c) {
    const Crossings list = lists.of(static_cast<int>(c));
    ASSERT_EQ(list.size, sizes[c]);
    for (std::size_t i = 0; i < list.size; ++i) {
      ASSERT_EQ(list.beam[i], c * 108 + i);
      ASSERT_EQ(list.enter()[i], static_cast<float>(c * 108 + i) + 0.25f);
      ASSERT_EQ(list.exit()[i], static_cast<float>(c * 108 + i) + 0.5f);
    }
  }
}

TYPED_TEST(ScanLists, InPiecesTheyAreTheSame) {
  NDTREE_SHAPE;
  using Clip = ChildClip<N, D>;
  Random random(263);
  SCOPED_TRACE(random.trace());
  const Beams<N, D> scan(random, 300, false);
  const Clip clip(scan.geometry, scan.beams);
  CrossingStack stack;
  const Crossings list = scan.list(stack);
  auto whole = clip.lists_for(scan.root(), list, stack);
  clip(scan.root(), list, whole);
  PiecewiseLists<Clip::kNumChildren> pieces;
  for (const std::size_t piece : {7u, 64u, 300u}) {
    for (std::size_t first = 0; first < list.size; first += piece) {
      const Crossings part = list.part(first, std::min(first + piece, list.size));
      auto children = clip.lists_for(scan.root(), part, pieces.memory());
      clip(scan.root(), part, children);
      pieces.add(children);
    }
    const auto joined = pieces.join(stack);
    for (int j = 0; j < Clip::kNumChildren; ++j) {
      const Crossings child = joined.of(j);
      const Crossings expected = whole.of(j);
      ASSERT_EQ(child.size, expected.size);
      for (std::size_t i = 0; i < child.size; ++i) {
        ASSERT_EQ(child.beam[i], expected.beam[i]);
        ASSERT_EQ(child.enter()[i], expected.enter()[i]);
        ASSERT_EQ(child.exit()[i], expected.exit()[i]);
      }
    }
    for (int j = 1; j < Clip::kNumChildren; ++j)  // Whoever frees one frees those of the children before it.
      ASSERT_GE(joined.of(j - 1).beam, joined.of(j).beam + joined.of(j).size + Crossings::kSlack);
  }
}

TEST(CrossingStack, FreesFromAListOnIfItIsItsOwn) {
  CrossingStack stack;
  CrossingStack other;
  other.free_from(stack.allocate(10));
  const Crossings first = stack.allocate(50);
  const Crossings second = stack.allocate(60);
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
