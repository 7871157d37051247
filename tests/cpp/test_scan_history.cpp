// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A map whose scans move is the map that its scans make where they are.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "history_scans.hpp"
#include "map_kinds.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/history/scan_history.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "random.hpp"

namespace ndtree::test::test_scan_history {
namespace {

template <class Map>
struct Taken {
  Scan<Map::kDim> scan;
  double max_range;

  Taken(const ScanHistory<Map>& history, std::int64_t key)
      : scan(history.scan(key)), max_range(history.max_range(key)) {}
  void insert_into(Map& map, std::uint64_t number) const {
    ScanView<Map::kDim> view = scan.view();
    view.number = number;
    (void)map.insert(view, max_range);
  }
  static void insert(Random&, ScanHistory<Map>& history, std::int64_t key, const Scan<Map::kDim>& scan,
                     std::uint64_t number, const Pose<Map::kDim>& pose, double max_range) {
    ScanView<Map::kDim> view = scan.view();
    view.number = number;
    (void)history.insert(key, view, pose, max_range);
  }
  static std::string bytes_of(const Map& map) {
    map.check_invariants();
    UpdateCounters counters;
    counters.scans = map.counters().scans;
    return to_bytes(Map(map.options(), typename Map::Tree(map.tree()), counters));
  }
};

template <class Map>
class ScanHistoryOf : public ::testing::Test {};
TYPED_TEST_SUITE(ScanHistoryOf, MapKinds);

TYPED_TEST(ScanHistoryOf, TheMapIsThatOfTheScansWhereTheyAre) {
  std::size_t replayed = 0;
  for (std::uint64_t seed = 1; seed <= (TypeParam::kDim < 3 ? 12 : 4); ++seed)
    replayed += play<TypeParam, Taken<TypeParam>>(seed, 24);
  EXPECT_GT(replayed, 20u);
}

TEST(ScanHistory, WhatIsFrozenTakesNoMemoryOfItsBeams) {
  Random random(41);
  ScanHistory<AdaptiveMap<2, 2>> history(options_of_history(2));
  const Scan<2> scan = random_scan<2>(random);
  for (int i = 0; i < 3000; ++i) (void)history.insert(i, scan.view(), Pose<2>{});
  const std::size_t before = history.memory_bytes();
  history.freeze(2999);
  EXPECT_LT(history.memory_bytes() + 2000 * 8 * static_cast<std::size_t>(scan.size()), before);
  EXPECT_EQ(history.size(), 1u);
  EXPECT_FALSE(history.contains(0));
  EXPECT_THROW(history.freeze(2), std::invalid_argument);
  EXPECT_EQ(history.num_frozen(), 2999u);
}

TEST(ScanHistory, ABeamIsKeptToAThousandthOfACell) {
  Random random(5);
  Scan<3> scan = random_scan<3>(random);

  const PackedScan<3> packed(scan.view(), 0.05);
  const Scan<3> again = packed.at({});
  Eigen::Index kept = 0;
  for (Eigen::Index i = 0; i < scan.size(); ++i) {
    if (!scan.endpoints.col(i).allFinite()) continue;
    EXPECT_LE((again.endpoints.col(kept) - scan.endpoints.col(i)).cwiseAbs().maxCoeff(), 0.05 / 2048);
    EXPECT_EQ(again.returned[kept], scan.returned[i]);
    ++kept;
  }
  EXPECT_EQ(kept, again.size());
  const PackedScan<3> twice(again.view(), 0.05);
  EXPECT_EQ(twice.at({}).endpoints, again.endpoints) << "what was packed once is packed without loss";
}

TEST(ScanHistory, FarBeamsAreKeptAsWellAsTheyCanBe) {
  Scan<2> scan;
  scan.origins = Vector<2>::Zero();
  scan.endpoints.resize(2, 2);
  scan.endpoints.col(0) = Vector<2>(3000.0, 1.0);
  scan.endpoints.col(1) = Vector<2>(1.0, 1.0);
  const Scan<2> again = PackedScan<2>(scan.view(), 0.05).at({});
  EXPECT_NEAR(again.endpoints(0, 0), 3000.0, 0.003);
  scan.endpoints(0, 0) = 1e6;
  EXPECT_THROW((void)PackedScan<2>(scan.view(), 0.05), std::invalid_argument);
}

TEST(ScanHistory, OnlyWhatMovedScansCrossIsMadeAnew) {
  ScanHistory<AdaptiveMap<2, 2>> history(options_of_history(2));
  Random random(8);
  for (int i = 0; i < 20; ++i) {
    Pose<2> pose;
    pose.translation[0] = 20.0 * i;  // Scans reach 4 m.
    (void)history.insert(i, random_scan<2>(random).view(), pose);
  }
  Pose<2> pose = history.pose(7);
  pose.translation[1] += 0.3;
  const HistoryReport report = history.move({{7, pose}});
  EXPECT_EQ(report.moved, 1u);
  EXPECT_EQ(report.replayed, 1u);
  EXPECT_LT(report.cube_scans, report.all_cube_scans / 10);
  EXPECT_EQ(history.move({{7, pose}}).replayed, 0u) << "it is there already";
}

TEST(ScanHistory, BadCallsChangeNothing) {
  ScanHistory<AdaptiveMap<2, 2>> history(options_of_history(2));
  Random random(9);
  const Scan<2> scan = random_scan<2>(random);
  (void)history.insert(1, scan.view(), {});
  (void)history.insert(2, scan.view(), {});
  const std::string before = to_bytes(history.map());
  Pose<2> bad;
  bad.rotation *= 2.0;
  Pose<2> mirrored;
  mirrored.rotation(0, 0) = -1.0;
  EXPECT_THROW((void)history.insert(1, scan.view(), {}), std::invalid_argument) << "the key is there";
  EXPECT_THROW((void)history.insert(3, scan.view(), bad), std::invalid_argument);
  EXPECT_THROW((void)history.insert(3, scan.view(), {}, -1.0), std::invalid_argument);
  ScanView<2> as_before = scan.view();
  as_before.number = 1;
  EXPECT_THROW((void)history.insert(3, as_before, {}), std::invalid_argument) << "the second's number";
  EXPECT_THROW((void)history.move({{1, mirrored}}), std::invalid_argument);
  EXPECT_THROW((void)history.move({{1, {}}, {1, {}}}), std::invalid_argument) << "twice";
  EXPECT_THROW((void)history.move({{4, {}}}), std::out_of_range);
  EXPECT_THROW((void)history.remove({1, 4}), std::out_of_range);
  EXPECT_EQ(to_bytes(history.map()), before);
  EXPECT_EQ(history.keys(), (std::vector<std::int64_t>{1, 2}));
  EXPECT_FALSE(history.contains(3));
  (void)history.remove({1, 2});
  EXPECT_EQ(history.size(), 0u);
  EXPECT_EQ(history.map().stats().observed_leaves, 0u);
}

TEST(ScanHistory, ACancelledCallChangesNothing) {
  ScanHistory<AdaptiveMap<2, 2>> history(options_of_history(2));
  Random random(10);
  for (int i = 0; i < 30; ++i)
    (void)history.insert(i, random_scan<2>(random).view(), random_pose<2>(random, 3.0));
  const std::string before = to_bytes(history.map());
  std::vector<std::pair<std::int64_t, Pose<2>>> poses;
  for (int i = 0; i < 30; ++i) poses.emplace_back(i, random_pose<2>(random, 3.0));
  int calls = 0;
  {
    const CancelScope scope([&] { return ++calls > 5; });
    EXPECT_THROW((void)history.move(poses), Cancelled);
  }
  EXPECT_EQ(to_bytes(history.map()), before);
  EXPECT_TRUE(history.pose(0).translation != poses[0].second.translation);
  (void)history.move(poses);
  EXPECT_TRUE(history.pose(0).translation == poses[0].second.translation);
}

TEST(CubeSet, IsASetOfCubes) {
  Random random(11);
  for (int round = 0; round < 50; ++round) {
    const LatticeBox<3> box{{random.integer(-900, 0), random.integer(-90, 0), random.integer(-90, 0)},
                            {random.integer(1, 900), random.integer(1, 90), random.integer(1, 90)}};
    CubeSet<3> set(8, box);
    EXPECT_TRUE(set.empty());
    std::vector<Lattice<3>> cubes;
    for (int i = 0; i < 20; ++i) {
      Lattice<3> cube;
      for (std::size_t a = 0; a < 3; ++a)
        cube[a] = CubeSet<3>::floor_divide(
            random.integer(static_cast<int>(box.lower[a]), static_cast<int>(box.upper[a]) - 1), 8);
      set.insert(cube);
      cubes.push_back(cube);
    }
    std::sort(cubes.begin(), cubes.end());
    cubes.erase(std::unique(cubes.begin(), cubes.end()), cubes.end());
    std::vector<Lattice<3>> found;
    set.for_each([&](const Lattice<3>& cube) { found.push_back(cube); });
    std::sort(found.begin(), found.end());
    EXPECT_EQ(found, cubes);
    EXPECT_EQ(set.size(), cubes.size());
    for (int i = 0; i < 200; ++i) {
      CellIndex<3> cell;
      const std::int64_t edge = std::int64_t{1} << random.integer(0, 7);
      for (auto& lower : cell.lower)
        lower = edge * random.integer(-120 * 8 / static_cast<int>(edge), 120 * 8 / static_cast<int>(edge));
      const bool expected = std::any_of(cubes.begin(), cubes.end(), [&](const Lattice<3>& cube) {
        for (std::size_t a = 0; a < 3; ++a)
          if (8 * cube[a] >= cell.lower[a] + edge || 8 * cube[a] + 8 <= cell.lower[a]) return false;
        return true;
      });
      EXPECT_EQ(set.overlaps(cell, edge), expected);
    }
    CubeSet<3> other(8, {{-400, -30, -30}, {400, 300, 30}});
    other.insert({2, 30, 1});
    EXPECT_FALSE(set.overlaps(other));
    CubeSet<3> sum = set;
    sum.add(other);
    EXPECT_EQ(sum.size(), set.size() + 1);
    EXPECT_TRUE(sum.overlaps(other) && sum.overlaps(set) && sum.contains({2, 30, 1}));
  }
}

}  // namespace
}  // namespace ndtree::test::test_scan_history
