// SPDX-License-Identifier: BSD-3-Clause
// Copies that share what has not changed, and what is different between them.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "map_kinds.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/point.hpp"
#include "options.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "refusals.hpp"
#include "trees.hpp"

namespace ndtree::test::test_snapshot {
namespace {

template <int D>
Box<D> random_box(Random& random, double center) {
  Box<D> box{Vector<D>::Constant(center), Vector<D>::Constant(center)};
  for (int a = 0; a < D; ++a) {
    box.lower[a] += random.uniform(-3.0, 0.0);
    box.upper[a] += random.uniform(0.1, 3.0);
  }
  return box;
}
/// Does something to a map; the same to all maps for the same state of the generator.
template <class Map>
void change(Map& map, Random& random, int threads) {
  constexpr int D = Map::kDim;
  const double center = random.uniform(-12.0, 12.0);
  switch (random.integer(0, 10)) {
    case 0:
      map.crop(random_box<D>(random, center));
      break;
    case 1:
      map.clear(random_box<D>(random, center));
      break;
    case 2:
      map.keep_near(Vector<D>::Constant(center), random.uniform(1.0, 10.0));
      break;
    case 3:
      map.shrink_to_fit();
      break;
    case 4:
      map.mark(random_box<D>(random, center), random.chance(0.5) ? CellState::free : CellState::occupied);
      break;
    default:
      map.insert(scan_about<D>(random, center), kUnlimitedRange, threads);
  }
}

/// Compares each smallest cell of both maps, one by one, in the leaves of the maps.
template <class Map>
void expect_changes(const Map& before, const Map& after, ChangeOf what) {
  constexpr int D = Map::kDim;
  using Cell = typename Map::Cell;
  const auto& geometry = after.tree().geometry();
  const ThinThings thin = what == ChangeOf::columns ? ThinThings(after) : ThinThings();
  const auto state_of = [thin](const Cell& cell) { return thin.state_in_column(cell); };
  struct Place {
    Cell cell;
    int level;
  };
  const auto place_in = [](const Map& map, const Lattice<D>& corner) {
    const auto leaf = map.tree().find_leaf(corner);
    return leaf ? Place{leaf->cell(), leaf->index.level} : Place{Cell{}, 0};
  };
  const auto is_blank = [&](const Cell& cell) {
    return what != ChangeOf::cells ? state_of(cell) == CellState::unknown : cell == Cell{};
  };
  const auto is_large = [&](const Place& place) {
    return what == ChangeOf::columns && state_of(place.cell) == CellState::occupied &&
           place.level > geometry.finest_level();
  };
  const auto differ = [&](const Place& one, const Place& other) {
    if (what != ChangeOf::cells)
      return state_of(one.cell) != state_of(other.cell) || is_large(one) != is_large(other);
    return !(one.cell == other.cell) || (one.cell.observed() && one.level != other.level);
  };
  std::size_t cells = 0;
  for (const Change<D>& change : changes(before, after, what)) {
    const std::int64_t edge = geometry.edge(change.index.level);
    for (const std::int64_t at : {std::int64_t{0}, edge - 1, edge / 2}) {
      Lattice<D> corner = change.index.lower;
      for (std::int64_t& coordinate : corner) coordinate += at;
      ASSERT_EQ(state_of(place_in(before, corner).cell), change.before);
      ASSERT_EQ(state_of(place_in(after, corner).cell), change.after);
      ASSERT_EQ(is_large(place_in(before, corner)), change.was_large);
      ASSERT_EQ(is_large(place_in(after, corner)), change.is_large);
      ASSERT_TRUE(differ(place_in(before, corner), place_in(after, corner)));
    }
    cells += static_cast<std::size_t>(integer_power(edge, D));
  }
  // As many smallest cells as differ. Each cell is of a leaf of one of the maps that is not blank.
  std::size_t differing = 0;
  const auto count = [&](const Map& map, const Map& other, bool blank_only) {
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      if (is_blank(leaf.cell())) return;
      const auto edge = static_cast<int>(geometry.edge(leaf.index.level));
      for (const CellIndex<D>& small : cells_within(leaf.index, 1, 0, edge)) {
        const Place there = place_in(other, small.lower);
        if (!blank_only || is_blank(there.cell)) differing += differ({leaf.cell(), leaf.index.level}, there);
      }
    });
  };
  count(before, after, false);
  count(after, before, true);
  ASSERT_EQ(cells, differing);
}
template <class Map>
void expect_changes(const Map& before, const Map& after) {
  for (const ChangeOf what : {ChangeOf::states, ChangeOf::columns, ChangeOf::cells})
    expect_changes(before, after, what);
}

template <class Map>
class Snapshots : public testing::Test {};
TYPED_TEST_SUITE(Snapshots, MapKinds);

TYPED_TEST(Snapshots, StayAsTheyAreAndChangeNothing) {
  constexpr int N = TypeParam::kBranching;
  Random random(3);
  for (int round = 0; round < 6; ++round) {
    TypeParam map(some_options(N));
    TypeParam alone(some_options(N));
    std::vector<std::pair<TypeParam, std::string>> snapshots;
    for (int step = 0; step < 25; ++step) {
      Random other = random;
      change(map, random, 1 + round % 2);
      change(alone, other, 1);
      if (random.integer(0, 2) == 0) {
        snapshots.emplace_back(map.snapshot(), to_bytes(map));
        if (random.integer(0, 1) == 0)
          snapshots.emplace_back(snapshots.front().first, snapshots.front().second);
      }
      if (snapshots.size() > 3) snapshots.erase(snapshots.begin() + random.integer(0, 3));
      if (!snapshots.empty() && random.integer(0, 3) == 0) change(snapshots.back().first, random, 1);
      if (!snapshots.empty()) snapshots.back().second = to_bytes(snapshots.back().first);
    }
    map.check_invariants();
    ASSERT_EQ(to_bytes(map), to_bytes(alone));
    for (const auto& [snapshot, bytes] : snapshots) {
      snapshot.check_invariants();
      ASSERT_EQ(to_bytes(snapshot), bytes);
    }
  }
}

TYPED_TEST(Snapshots, TellWhatHasChanged) {
  constexpr int N = TypeParam::kBranching;
  Random random(4);
  for (int round = 0; round < 8; ++round) {
    TypeParam map(some_options(N));
    TypeParam before = map;
    for (int step = 0; step < 8; ++step) {
      change(map, random, 1);
      ASSERT_NO_FATAL_FAILURE(expect_changes(before, map));
      ASSERT_NO_FATAL_FAILURE(expect_changes(map, before));
      if (random.integer(0, 1) == 0) before = map;
    }
    EXPECT_TRUE(changes(map, map.snapshot()).empty());
  }
}

TYPED_TEST(Snapshots, CompareMapsThatHaveNothingInCommon) {
  constexpr int N = TypeParam::kBranching;
  constexpr int D = TypeParam::kDim;
  Random random(5);
  for (int round = 0; round < 8; ++round) {
    TypeParam one(some_options(N));
    TypeParam other(some_options(N));
    one.insert(scan_about<D>(random, random.uniform(-9.0, 9.0)));
    other.insert(scan_about<D>(random, random.uniform(-9.0, 9.0)));
    ASSERT_NO_FATAL_FAILURE(expect_changes(one, other));
  }
  MapOptions finer = some_options(N);
  finer.min_cell_size *= 0.5;
  finer.max_cell_size *= 0.5;
  expect_refused([&] { (void)changes(TypeParam(some_options(N)), TypeParam(finer)); },
                 "smallest cells of 0.25 and 0.125 m");
}

TEST(SnapshotCost, IsThatOfWhatChangesAndNotOfTheMap) {
  AdaptiveMap<2, 2> map(some_options(2));
  Random random(6);
  for (int i = 0; i < 400; ++i) map.insert(scan_about<2>(random, 5.0 * (i % 100), 200));
  const AdaptiveMap<2, 2> before = map.snapshot();
  const auto shared = [&] {
    std::size_t same = 0;
    std::size_t all = 0;
    const auto descend = [&](const auto& self, const auto& old, const auto& now) -> void {
      if (old.is_leaf() || now.is_leaf()) return;
      ++all;
      same += map.tree().shares_children(*now.node, before.tree(), *old.node);
      for (int j = 0; j < 4; ++j) self(self, before.tree().child(old, j), map.tree().child(now, j));
    };
    descend(descend, before.tree().root(), map.tree().root());
    EXPECT_GT(all, 2000u);
    return static_cast<double>(same) / static_cast<double>(all);
  };
  EXPECT_EQ(shared(), 1.0);
  map.insert(scan_about<2>(random, 50.0, 200));
  EXPECT_GT(shared(), 0.8);  // The scan meets a hundredth of the map; chunks hold some more.
  EXPECT_LT(shared(), 1.0);
}

}  // namespace
}  // namespace ndtree::test::test_snapshot
