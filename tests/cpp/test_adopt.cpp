// SPDX-License-Identifier: BSD-3-Clause
// Space that is mapped in parts, each apart from the others, or in windows, against the map that one makes of
// all of it.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "map_kinds.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "options.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_adopt {
namespace {

/// From somewhere, as a robot that moves on: so that the root grows, now here, now there.
template <int D>
Scan<D> scan_of_somewhere(Random& random) {
  Scan<D> scan;
  const Eigen::Index beams = random.chance(0.3) ? 2000 : 30;
  scan.origins.resize(D, 1);
  scan.endpoints.resize(D, beams);
  scan.returned.resize(beams);
  for (int a = 0; a < D; ++a) scan.origins(a, 0) = random.uniform(-9.0, 9.0);
  for (Eigen::Index i = 0; i < beams; ++i) {
    for (int a = 0; a < D; ++a) scan.endpoints(a, i) = scan.origins(a, 0) + random.uniform(-5.0, 5.0);
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}
/// Boxes of this many cubes' edges that tile all that scan_of_somewhere() can reach.
template <int D>
std::vector<Box<D>> tiles(double edge) {
  const double reach = 16.0;
  const int first = static_cast<int>(std::floor(-reach / edge));
  const int last = static_cast<int>(std::ceil(reach / edge));
  std::vector<Box<D>> result{Box<D>{Vector<D>::Zero(), Vector<D>::Zero()}};
  for (int a = 0; a < D; ++a) {
    std::vector<Box<D>> more;
    for (const Box<D>& box : result)
      for (int i = first; i < last; ++i) {
        more.push_back(box);
        more.back().lower[a] = i * edge;
        more.back().upper[a] = (i + 1) * edge;
      }
    result = more;
  }
  return result;
}
/// Where no beam gets.
template <int D>
Box<D> nowhere() {
  return {Vector<D>::Constant(900.0), Vector<D>::Constant(901.0)};
}

/// Each leaf of one map that lies in some region is a leaf of the other, with the same cell. Unknown space
/// may be divided otherwise. @returns how many were compared.
template <class Map, class IsIn>
std::size_t expect_same(const Map& one, const Map& other, const IsIn& is_in) {
  std::size_t compared = 0;
  for_each_leaf(one.tree(), [&](const auto& leaf) {
    if (!is_in(leaf.index) || leaf.index.level > 0) return;
    const auto there = other.tree().find_leaf(leaf.index.lower);
    const bool is_blank = leaf.cell() == typename Map::Cell{};
    if (is_blank) {
      ASSERT_TRUE(!there || there->cell() == typename Map::Cell{});
      return;
    }
    ASSERT_TRUE(there.has_value());
    ASSERT_EQ(there->index, leaf.index);
    ASSERT_EQ(there->cell(), leaf.cell());
    ++compared;
  });
  return compared;
}

template <class Map>
class Adopted : public testing::Test {};
TYPED_TEST_SUITE(Adopted, MapKinds);

TYPED_TEST(Adopted, PartsAreTheMapThatOneMakes) {
  constexpr int N = TypeParam::kBranching;
  constexpr int D = TypeParam::kDim;
  const MapOptions options = some_options(N);
  Random random(21);
  std::size_t taken = 0;
  for (int round = 0; round < (D == 2 ? 6 : 2); ++round) {
    std::vector<Scan<D>> scans;
    for (int i = D == 2 ? random.integer(1, 5) : 2; i > 0; --i) scans.push_back(scan_of_somewhere<D>(random));
    TypeParam serial(options);
    TypeParam joined(options);
    for (const Scan<D>& scan : scans) {
      serial.insert(scan);
      const InsertReport report = joined.insert(scan, kUnlimitedRange, 1, nowhere<D>());
      ASSERT_EQ(report.updates, 0u);
    }
    for (const Box<D>& tile : tiles<D>(options.max_cell_size * (D == 2 && round % 2 == 0 ? 2 : 5))) {
      TypeParam part(options);
      for (const Scan<D>& scan : scans) part.insert(scan, kUnlimitedRange, 1, tile);
      TypeParam kept(options);  // As a file would have it: with a root around what is known.
      kept.adopt(part, tile);
      EXPECT_EQ(kept.counters().updates, 0u);
      taken += kept.stats().observed_leaves;
      joined.adopt(round % 3 == 0 ? from_bytes<TypeParam>(to_bytes(part)) : part);
      joined.check_invariants();
      TypeParam again(options);
      again.adopt(serial, tile);
      again.check_invariants();
      ASSERT_EQ(to_bytes(kept), to_bytes(again));
    }
    ASSERT_EQ(to_bytes(serial), to_bytes(joined)) << "round " << round;
    ASSERT_EQ(serial.stats().observed_leaves, joined.stats().observed_leaves);
  }
  EXPECT_GT(taken, 100u);
}

TYPED_TEST(Adopted, WhatIsPutAsideComesBackAndMappingGoesOn) {
  constexpr int N = TypeParam::kBranching;
  constexpr int D = TypeParam::kDim;
  const MapOptions options = some_options(N);
  Random random(22);
  for (int round = 0; round < 2; ++round) {
    TypeParam serial(options);
    TypeParam moving(options);
    const auto all = tiles<D>(options.max_cell_size * 4);
    for (int i = 0; i < 6; ++i) {
      const Scan<D> scan = scan_of_somewhere<D>(random);
      serial.insert(scan);
      moving.insert(scan);
      const Box<D>& tile = all[static_cast<std::size_t>(random.integer(0, static_cast<int>(all.size()) - 1))];
      TypeParam aside(options);
      aside.adopt(moving, tile);
      moving.clear(tile);
      moving.adopt(aside);
      moving.check_invariants();
    }
    ASSERT_EQ(to_bytes(serial), to_bytes(moving));
  }
}

TYPED_TEST(Adopted, CellsInABoxAreThoseThatAWindowOfItWouldHaveMapped) {
  constexpr int N = TypeParam::kBranching;
  constexpr int D = TypeParam::kDim;
  const MapOptions options = some_options(N);
  const Box<D> everywhere{Vector<D>::Constant(-500.0), Vector<D>::Constant(500.0)};
  Random random(25);
  std::size_t taken = 0;
  for (int round = 0; round < 8; ++round) {
    const Scan<D> scan = scan_of_somewhere<D>(random);
    Box<D> box;
    for (int a = 0; a < D; ++a) {
      box.lower[a] = scan.origins(a, 0) + random.uniform(-3.0, 0.0);
      box.upper[a] = box.lower[a] + random.uniform(0.1, 4.0);
    }
    TypeParam whole(options);
    TypeParam part(options);
    TypeParam expected(options);
    TypeParam adopted(options);
    whole.insert(scan);
    part.insert(scan, kUnlimitedRange, 1, box);
    expected.adopt(part, everywhere);  // With a root around what is known.
    adopted.adopt(whole, box);
    ASSERT_EQ(to_bytes(adopted), to_bytes(expected)) << "round " << round;
    taken += adopted.stats().observed_leaves;
  }
  EXPECT_GT(taken, 20u);
}

TYPED_TEST(Adopted, AWindowBecomesWhatItWouldAndNothingElseChanges) {
  constexpr int N = TypeParam::kBranching;
  constexpr int D = TypeParam::kDim;
  const MapOptions options = some_options(N);
  Random random(7);
  std::size_t inside = 0;
  std::size_t outside = 0;
  for (int round = 0; round < 30; ++round) {
    TypeParam before(options);
    for (int i = random.integer(0, 2); i > 0; --i) before.insert(scan_of_somewhere<D>(random));
    const Scan<D> scan = scan_of_somewhere<D>(random);
    Box<D> window{Vector<D>::Zero(), Vector<D>::Zero()};
    for (int a = 0; a < D; ++a) {
      window.lower[a] = scan.origins(a, 0) + random.uniform(-6.0, 3.0);
      window.upper[a] = window.lower[a] + random.uniform(0.1, 5.0);
      if (random.chance(0.2)) window.upper[a] = std::ceil(window.upper[a]);  // On a border of cells.
      if (random.chance(0.2)) window.lower[a] = std::floor(window.lower[a]);
    }
    TypeParam whole = before;
    TypeParam part = before;
    whole.insert(scan, kUnlimitedRange, 1);
    const InsertReport report = part.insert(scan, kUnlimitedRange, 1 + round % 2, window);
    EXPECT_EQ(report.beams, static_cast<std::uint64_t>(scan.size()));
    part.check_invariants();
    const double size = TypeParam::RefinementType::kAdaptive ? options.max_cell_size : options.min_cell_size;
    const auto is_in = [&](const CellIndex<D>& index) {
      Box<D> cell = whole.tree().box(index);
      for (int a = 0; a < D; ++a) {  // The cell of the coarsest size around it.
        cell.lower[a] = std::floor(cell.lower[a] / size + 1e-9) * size;
        cell.upper[a] = cell.lower[a] + size;
      }
      return cell.overlaps(window);
    };
    const auto is_out = [&](const CellIndex<D>& index) { return !is_in(index); };
    inside += expect_same(whole, part, is_in);
    expect_same(part, whole, is_in);
    outside += expect_same(before, part, is_out);
    expect_same(part, before, is_out);
    if (this->HasFatalFailure()) return;
  }
  EXPECT_GT(inside, 500u);
  EXPECT_GT(outside, 500u);
}

TEST(AdoptedCells, AreOfOneMapAlone) {
  using Map = AdaptiveMap<2, 2>;
  Random random(23);
  const MapOptions options = some_options(2);
  Map map(options);
  map.insert(scan_of_somewhere<2>(random));
  const std::string before = to_bytes(map);
  const auto refusal = [&](const Map& other, const std::optional<Box<2>>& box) {
    const std::string said = refusal_by([&] { map.adopt(other, box); });
    EXPECT_TRUE(said == "accepted" || to_bytes(map) == before);
    return said;
  };
  const std::string both = refusal(map.snapshot(), std::nullopt);
  EXPECT_EQ(both.find("both maps hold cells in the cube of 1.0 m from ("), 0u) << both;
  MapOptions coarser = options;
  coarser.min_cell_size = 0.5;
  EXPECT_EQ(refusal(Map(coarser), std::nullopt),
            "a map with cells from 0.5 to 1.0 m cannot be adopted by one with cells from 0.25 to 1.0 m");
  EXPECT_EQ(refusal(Map(options), Box<2>{Vector<2>(0.0, 0.0), Vector<2>(1.0, 0.0)}),
            "box from (0.0, 0.0) to (1.0, 0.0): must be finite, and have a volume");
  EXPECT_EQ(refusal_by([&] {
              map.insert(scan_of_somewhere<2>(random), kUnlimitedRange, 1,
                         Box<2>{Vector<2>(0.0, 0.0), Vector<2>(1.0, 0.0)});
            }),
            "box from (0.0, 0.0) to (1.0, 0.0): must be finite, and have a volume");
  EXPECT_EQ(refusal(map.snapshot(), Box<2>{Vector<2>(50.0, 50.0), Vector<2>(51.0, 51.0)}), "accepted");
  MapOptions scarce = options;
  scarce.max_memory = static_cast<double>(Map(options).memory_bytes());
  Map small(scarce);
  const std::string empty = to_bytes(small);
  EXPECT_THROW(small.adopt(map), MemoryLimitReached);
  EXPECT_EQ(to_bytes(small), empty);
}

TEST(BytesOfAMap, DoNotTellWhichUnknownSpaceWasDivided) {
  using Map = AdaptiveMap<2, 2>;
  Random random(24);
  Map map(some_options(2));
  for (int i = 0; i < 5; ++i) map.insert(scan_of_somewhere<2>(random));
  Map forgotten = map;
  forgotten.crop(Box<2>{Vector<2>(-40.0, -40.0), Vector<2>(40.0, 40.0)});
  EXPECT_EQ(to_bytes(map), to_bytes(forgotten));
  const Map loaded = from_bytes<Map>(to_bytes(map));
  EXPECT_EQ(to_bytes(map), to_bytes(loaded));
  EXPECT_EQ(map.stats().observed_leaves, loaded.stats().observed_leaves);
}

}  // namespace
}  // namespace ndtree::test::test_adopt
