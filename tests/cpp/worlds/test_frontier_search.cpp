// SPDX-License-Identifier: BSD-3-Clause
// Frontiers that follow a map are those of the map.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/frontiers.hpp"
#include "options.hpp"
#include "random.hpp"
#include "random_maps.hpp"

namespace ndtree::test::test_frontier_search {
namespace {

/// What counts of frontiers, in an order that does not depend on how they were found.
template <int D>
std::vector<std::vector<double>> described(const std::vector<Frontier<D>>& frontiers) {
  std::vector<std::vector<double>> all;
  for (const Frontier<D>& frontier : frontiers) {
    std::vector<std::vector<double>> cells;
    for (const Box<D>& cell : frontier.cells) {
      cells.emplace_back(cell.lower.data(), cell.lower.data() + D);
      cells.back().push_back(cell.upper[0]);
    }
    std::sort(cells.begin(), cells.end());
    std::vector<double> one;
    for (const auto& cell : cells) one.insert(one.end(), cell.begin(), cell.end());
    all.push_back(one);
  }
  std::sort(all.begin(), all.end());
  return all;
}
template <class Map>
void expect_same(const FrontierSearch<Map>& search, const Map& map,
                 const std::optional<Box<Map::kDim>>& box) {
  const auto found = search.frontiers(0.0);
  const auto expected = frontiers(map, box, 0.0);
  ASSERT_EQ(described(found), described(expected));
  for (std::size_t i = 0; i < found.size(); ++i) {
    ASSERT_NEAR(found[i].area, expected[i].area, 1e-9 * expected[i].area);
    const auto same = std::find_if(expected.begin(), expected.end(), [&](const auto& one) {
      return described<Map::kDim>({one}) == described<Map::kDim>({found[i]});
    });
    ASSERT_NE(same, expected.end());
    ASSERT_LT((same->center - found[i].center).norm(), 1e-9);
    ASSERT_LT((same->direction - found[i].direction).norm(), 1e-6);
  }
}
template <class Map>
void frontiers_follow(Random& random, bool has_box) {
  constexpr int D = Map::kDim;
  Map map(some_options(Map::kBranching));
  std::optional<Box<D>> box;
  if (has_box) box = Box<D>{Vector<D>::Constant(-3.1), Vector<D>::Constant(2.3)};
  FrontierSearch<Map> search(map, box);
  for (int i = 0; i < 25; ++i) {
    const int scans = i % 5 == 0 ? 3 : 1;
    for (int k = 0; k < scans; ++k) map.insert(scan_about<D>(random, random.uniform(-0.4, 0.4) * i));
    if (i % 7 == 3) map.clear({Vector<D>::Constant(random.uniform(-3.0, 0.0)), Vector<D>::Constant(1.0)});
    if (i % 11 == 8) map.keep_near(Vector<D>::Constant(0.5), 4.0);
    search.update(map);
    expect_same(search, map, box);
    if (testing::Test::HasFatalFailure()) FAIL() << "after step " << i;
  }
  search.update(map);  // Nothing has changed.
  expect_same(search, map, box);
  Map other(some_options(Map::kBranching));
  search.update(other);
  EXPECT_TRUE(search.frontiers(0.0).empty());
}

TEST(FrontierSearch, FollowsTheMap) {
  Random random(2718);
  for (const bool has_box : {false, true}) {
    frontiers_follow<AdaptiveMap<2, 2>>(random, has_box);
    frontiers_follow<PaperMap<3, 2>>(random, has_box);
    frontiers_follow<FixedMap<2, 2>>(random, has_box);
    frontiers_follow<AdaptiveMap<2, 3>>(random, has_box);
  }
}
TEST(FrontierSearch, BeginsAnewAfterItWasStopped) {
  Random random(5);
  AdaptiveMap<2, 2> map(some_options(2));
  FrontierSearch<AdaptiveMap<2, 2>> search(map);
  for (int i = 0; i < 400; ++i) map.insert(scan_about<2>(random, random.uniform(-40.0, 40.0)));
  {
    const CancelScope scope([] { return true; });
    EXPECT_THROW(search.update(map), Cancelled);
  }
  EXPECT_TRUE(search.frontiers(0.0).empty());
  search.update(map);
  expect_same(search, map, std::nullopt);
}
TEST(FrontierSearch, RefusesWhatDoesNotFit) {
  AdaptiveMap<2, 2> map(some_options(2));
  FrontierSearch<AdaptiveMap<2, 2>> search(map);
  MapOptions options = some_options(2);
  options.min_cell_size = 0.125;
  EXPECT_THROW(search.update(AdaptiveMap<2, 2>(options)), std::invalid_argument);
  EXPECT_THROW((void)search.frontiers(-1.0), std::invalid_argument);
  const Box<2> upside_down{Vector<2>(1.0, 1.0), Vector<2>(0.0, 2.0)};
  EXPECT_THROW(FrontierSearch<decltype(map)>(map, upside_down), std::invalid_argument);
}

}  // namespace
}  // namespace ndtree::test::test_frontier_search
