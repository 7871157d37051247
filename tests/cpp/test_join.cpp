// SPDX-License-Identifier: BSD-3-Clause
// Two maps of one place become one.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "map_kinds.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/transform.hpp"
#include "options.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "refusals.hpp"
#include "trees.hpp"

namespace ndtree::test::test_join {
namespace {

template <class Map>
Map random_map(Random& random, int scans) {
  Map map(some_options(Map::kBranching));
  const double centre = random.uniform(-6.0, 6.0);
  for (int i = 0; i < scans; ++i) map.insert(scan_about<Map::kDim>(random, centre, 40, 1.0, 3.0));
  return map;
}
template <class Map>
Map merged(Map one, const Map& other) {
  one.merge(other);
  one.check_invariants();
  return one;
}
/// Calls `visit(cell of one, cell of other)` for each smallest cell that either knows.
template <class Map, class Visit>
void for_each_smallest(const Map& one, const Map& other, const Visit& visit) {
  using Cell = typename Map::Cell;
  const auto look = [&](const Map& map, const Map& beside, bool is_first) {
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      if (leaf.index.level > 0) return;
      const auto edge = static_cast<int>(map.tree().geometry().edge(leaf.index.level));
      for (const CellIndex<Map::kDim>& at : cells_within(leaf.index, 1, 0, edge)) {
        const auto found = beside.tree().find_leaf(at.lower);
        const bool is_there = found && found->index.level <= 0;
        if (is_first)
          visit(leaf.cell(), is_there ? found->cell() : Cell{});
        else if (!is_there)
          visit(Cell{}, leaf.cell());
      }
    });
  };
  look(one, other, true);
  look(other, one, false);
}

template <class Map>
class Joined : public testing::Test {};
TYPED_TEST_SUITE(Joined, MapKinds);

TYPED_TEST(Joined, DoesNotDependOnWhichIsMergedIntoWhich) {
  Random random(8);
  for (int round = 0; round < 10; ++round) {
    const auto one = random_map<TypeParam>(random, random.integer(0, 4));
    const auto other = random_map<TypeParam>(random, random.integer(0, 4));
    const TypeParam both = merged(one, other);
    ASSERT_EQ(to_bytes(both), to_bytes(merged(other, one)));
    EXPECT_EQ(both.counters().updates, one.counters().updates + other.counters().updates);
    TypeParam more = both;  // Mapping goes on.
    more.merge(random_map<TypeParam>(random, 1));
    more.check_invariants();
  }
}

TYPED_TEST(Joined, KnowsNoMoreFromAMapThatKnowsNothing) {
  Random random(9);
  for (int round = 0; round < 5; ++round) {
    const auto one = random_map<TypeParam>(random, 3);
    const TypeParam same = merged(one, TypeParam(some_options(TypeParam::kBranching)));
    for_each_smallest(one, same, [](const auto& before, const auto& after) { ASSERT_EQ(before, after); });
    ASSERT_EQ(one.stats().observed_leaves, same.stats().observed_leaves);
  }
}

TYPED_TEST(Joined, KnowsAllThatOneOfThemKnows) {
  Random random(10);
  std::size_t cells = 0;
  for (int round = 0; round < 10; ++round) {
    const auto one = random_map<TypeParam>(random, 3);
    const TypeParam both = merged(one, random_map<TypeParam>(random, 3));
    for_each_smallest(one, both, [&](const auto& before, const auto& after) {
      cells += before.observed();
      ASSERT_TRUE(after.observed() || !before.observed());
    });
  }
  EXPECT_GT(cells, 1000u);
}

TEST(JoinedFixedMaps, AddUpCellByCell) {
  using Map = FixedMap<2, 2>;
  Random random(11);
  const MapOptions options = some_options(2);
  int both_known = 0;
  for (int round = 0; round < 10; ++round) {
    const Map one = random_map<Map>(random, 3);
    Map other = random_map<Map>(random, 3);
    other.merge(one);  // So that there is something in common.
    const Map both = merged(one, other);
    for_each_leaf(both.tree(), [&](const auto& leaf) {
      const auto cell_of = [&](const Map& map) {
        const auto found = map.tree().find_leaf(leaf.index.lower);
        return found ? found->cell() : OccupancyCell{};
      };
      const OccupancyCell a = cell_of(one);
      const OccupancyCell b = cell_of(other);
      both_known += a.observed() && b.observed();
      ASSERT_EQ(leaf.cell().hits(), a.hits() + b.hits());
      ASSERT_EQ(leaf.cell().misses(), a.misses() + b.misses());
      ASSERT_EQ(leaf.cell().log_odds(),
                std::clamp(a.log_odds() + b.log_odds(), static_cast<float>(options.log_odds_min),
                           static_cast<float>(options.log_odds_max)));
    });
  }
  EXPECT_GT(both_known, 500);
}

TEST(JoinedAdaptiveMaps, AddUpWhereCellsAreAlike) {
  using Map = AdaptiveMap<2, 2>;
  Random random(12);
  int both_known = 0;
  for (int round = 0; round < 10; ++round) {
    const Map one = random_map<Map>(random, 4);
    const Map both = merged(one, one);
    for_each_leaf(both.tree(), [&](const auto& leaf) {
      const auto found = one.tree().find_leaf(leaf.index.lower);
      if (!found || found->index != leaf.index || !leaf.cell().observed()) return;
      ++both_known;  // Below what cells can remember, but for some that are free alone.
      ASSERT_EQ(leaf.cell().occupied_evidence(), 2 * found->cell().occupied_evidence());
      const auto most = static_cast<std::int64_t>(256.0 * one.options().free_memory);
      const std::int64_t free = 2 * found->cell().free_evidence();
      ASSERT_EQ(leaf.cell().free_evidence(),
                leaf.cell().occupied_evidence() == 0 ? std::min(free, most) : free);
      ASSERT_EQ(leaf.cell().hits(), 2 * found->cell().hits());
      ASSERT_EQ(leaf.cell().state(), found->cell().state());
    });
  }
  EXPECT_GT(both_known, 500);
}

TEST(JoinedAdaptiveMaps, AreNearlyAssociative) {
  using Map = AdaptiveMap<2, 2>;
  Random random(13);
  std::size_t cells = 0;
  std::size_t different = 0;
  for (int round = 0; round < 30; ++round) {
    const Map a = random_map<Map>(random, 3);
    const Map b = random_map<Map>(random, 3);
    const Map c = random_map<Map>(random, 3);
    for_each_smallest(merged(merged(a, b), c), merged(a, merged(b, c)),
                      [&](const EvidenceCell& one, const EvidenceCell& other) {
                        ASSERT_EQ(one.observed(), other.observed());
                        cells += one.observed();
                        different += one.state() != other.state();
                      });
  }
  EXPECT_GT(cells, 10000u);
  EXPECT_LT(static_cast<double>(different), 0.002 * static_cast<double>(cells));
}

template <class Map>
void expect_within_own_bounds(Random& random) {
  MapOptions wide = some_options(2);
  wide.log_odds_min = -20.0;
  wide.log_odds_max = 20.0;
  wide.probability_max = 0.99;
  if (Map::RefinementType::kName == EvidenceRefinement::kName) {
    wide.evidence_memory = 255.0;
    wide.free_memory = 255.0;
    wide.evidence_prior = 0.01;
  }
  Map other(wide);
  Scan<2> scan;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, 40);
  for (Eigen::Index i = 0; i < 40; ++i)
    scan.endpoints.col(i) << random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0);
  for (int i = 0; i < 60; ++i) other.insert(scan);
  const Map both = merged(Map(some_options(2)), other);  // Which checks the invariants.
  EXPECT_EQ(to_bytes(from_bytes<Map>(to_bytes(both))), to_bytes(both));
}
TEST(JoinedMaps, MergeWhatBecomesAlike) {
  using Map = AdaptiveMap<2, 2>;
  const Vector<2> low(0.0, 0.0), high(1.0, 1.0);
  Map left(some_options(2)), right = left, whole = left;
  left.mark(Box<2>{low, Vector<2>(0.25, 1.0)}, CellState::free);
  right.mark(Box<2>{Vector<2>(0.25, 0.0), high}, CellState::free);
  whole.mark(Box<2>{low, high}, CellState::free);
  EXPECT_GT(left.stats().observed_leaves, 1u);
  EXPECT_EQ(merged(left, right).stats().observed_leaves, 1u);
  for_each_smallest(whole, merged(left, right),
                    [](const auto& a, const auto& b) { EXPECT_EQ(a.state(), b.state()); });
}

TEST(JoinedMaps, KeepToTheirOwnOptions) {
  Random random(14);
  expect_within_own_bounds<AdaptiveMap<2, 2>>(random);
  expect_within_own_bounds<PaperMap<2, 2>>(random);
  expect_within_own_bounds<FixedMap<2, 2>>(random);
}

TEST(JoinedMaps, ReachAsFarAsTheLattice) {
  MapOptions options = some_options(3);  // Whose largest cells go beyond it.
  options.covered_share = 0.0;
  AdaptiveMap<3, 2> map(options);
  const double reach = map.tree().geometry().reach();
  Scan<2> scan;
  scan.origins = Vector<2>(reach - 5.0, 0.1);
  scan.endpoints = Vector<2>(reach - 1.0, 0.1);
  map.insert(scan);
  AdaptiveMap<3, 2> other(options);
  other.merge(map);
  EXPECT_EQ(other.stats().observed_leaves, map.stats().observed_leaves);
  const AdaptiveMap<3, 2> same = transformed(map, Pose<2>{});
  for (double x = reach - 6.0; x < reach; x += 0.1) {
    const Vector<2> point(x, 0.1);
    EXPECT_EQ(state(same, point), state(map, point)) << x - reach;
  }
  Pose<2> beyond;
  beyond.translation[0] = 100.0;
  EXPECT_THROW((void)transformed(map, beyond), std::invalid_argument);
}

TEST(JoinedMaps, MustHaveCellsOfTheSameSizes) {
  AdaptiveMap<2, 2> map(some_options(2));
  MapOptions finer = some_options(2);
  finer.min_cell_size = 0.125;
  EXPECT_EQ(refusal_by([&] { map.merge(AdaptiveMap<2, 2>(finer)); }),
            "a map with cells from 0.125 to 1.0 m cannot be merged into one with cells from 0.25 to 1.0 m");
}

}  // namespace
}  // namespace ndtree::test::test_join
