// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "ndtree/cell/merge_rule.hpp"
#include "ndtree/cell/split_test.hpp"
#include "ndtree/tree/node_pool.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test::test_merge_rule {
namespace {

struct Sibling {
  float log_odds;
  std::uint32_t hits = 0;
  std::uint32_t misses = 0;
};

std::vector<Node<OccupancyCell>> nodes_of(const std::vector<Sibling>& siblings) {
  std::vector<Node<OccupancyCell>> nodes(siblings.size());
  for (std::size_t j = 0; j < siblings.size(); ++j) {
    OccupancyCell cell;
    cell.set_counts(siblings[j].hits, siblings[j].misses);
    cell.set_log_odds(siblings[j].log_odds);
    nodes[j].become_leaf(cell);
  }
  return nodes;
}

MergeOptions options_of(double free_below, double occupied_above) {
  MergeOptions options;
  options.merge_free_below = free_below;
  options.merge_occupied_above = occupied_above;
  return options;
}

const ChiSquareSplitTest& split_test() {
  static const ChiSquareSplitTest kTest{spelled_out_options(1.0, 1.0)};
  return kTest;
}

std::optional<OccupancyCell> merged(const MergeOptions& options,
                                    const std::vector<Node<OccupancyCell>>& nodes) {
  return SameStateMergeRule(options)(nodes.data(), static_cast<int>(nodes.size()), split_test());
}

TEST(MergeRule, AgreesWithThePapersRule) {
  Random random(37);
  const MergeOptions options = options_of(0.2, 0.9);
  int joined_free = 0;
  int joined_occupied = 0;
  int refused_by_counts = 0;
  for (int cases = 0; cases < 20000; ++cases) {
    const int kind = random.integer(0, 2);
    const auto count = static_cast<std::size_t>(random.chance(0.5) ? 4 : 9);
    std::vector<Sibling> siblings;
    for (std::size_t j = 0; j < count; ++j) {
      // Mostly one state, now and then beyond the threshold of log-odds -1.386 or 2.197.
      const double value = kind == 0   ? random.uniform(-3.0, -1.3)
                           : kind == 1 ? random.uniform(2.15, 4.0)
                                       : random.uniform(-3.0, 4.0);
      const int rare = random.chance(0.05) ? 1 : 0;
      siblings.push_back({static_cast<float>(value),
                          static_cast<std::uint32_t>(kind == 0 ? rare : random.integer(0, 40)),
                          static_cast<std::uint32_t>(kind == 1 ? rare : random.integer(0, 40))});
    }
    bool all_free = true;
    bool all_occupied = true;
    double sum = 0.0;
    std::uint32_t hits = 0;
    std::uint32_t misses = 0;
    for (const Sibling& s : siblings) {
      const double p = 1.0 / (1.0 + std::exp(-static_cast<double>(s.log_odds)));
      all_free = all_free && p <= 0.2;
      all_occupied = all_occupied && p >= 0.9;
      sum += p;
      hits += s.hits;
      misses += s.misses;
    }
    const auto parent = merged(options, nodes_of(siblings));
    const bool would_split = split_test()(hits, misses);
    ASSERT_EQ(parent.has_value(), (all_free || all_occupied) && !would_split);
    refused_by_counts += (all_free || all_occupied) && would_split;
    if (!parent) continue;
    ASSERT_NEAR(parent->probability(), sum / static_cast<double>(count), 1e-6);
    ASSERT_EQ(parent->hits(), hits);
    ASSERT_EQ(parent->misses(), misses);
    ASSERT_TRUE(parent->observed());
    ASSERT_FALSE(split_test()(*parent));
    joined_free += all_free;
    joined_occupied += all_occupied;
  }
  EXPECT_GT(joined_free, 500);
  EXPECT_GT(joined_occupied, 500);
  EXPECT_GT(refused_by_counts, 15);
}

TEST(MergeRule, DividedSiblingsStay) {
  for (std::size_t inner = 0; inner < 4; ++inner) {
    auto nodes = nodes_of({{-5.0f}, {-5.0f}, {-5.0f}, {-5.0f}});
    ASSERT_TRUE(merged(options_of(0.2, 0.9), nodes).has_value());
    nodes[inner].become_inner(7);
    EXPECT_FALSE(merged(options_of(0.2, 0.9), nodes).has_value());
  }
}

TEST(MergeRule, JoinedCountsSaturateTogether) {
  const auto nodes =
      nodes_of({{-5.0f, 0, 0x7fff}, {-5.0f, 0, 0x7fff}, {-5.0f, 0, 0x7fff}, {-5.0f, 4, 0x7fff}});
  const auto parent = merged(options_of(0.2, 0.9), nodes);
  ASSERT_TRUE(parent.has_value());
  EXPECT_EQ(parent->misses(), 0x7fffu);
  EXPECT_EQ(parent->hits(), 1u);
}

TEST(MergeRule, OnlyExtremeCellsCanTakePart) {
  const SameStateMergeRule rule(options_of(0.2, 0.9));
  struct Row {
    double probability;
    bool extreme;
  };
  const Row rows[] = {{0.1, true},    {0.2, true}, {0.201, false}, {0.5, false},
                      {0.899, false}, {0.9, true}, {0.95, true}};
  for (const Row& row : rows) {
    OccupancyCell cell;
    cell.set_log_odds(static_cast<float>(std::log(row.probability / (1.0 - row.probability))));
    EXPECT_EQ(rule.is_extreme(cell), row.extreme) << row.probability;
  }
}

}  // namespace
}  // namespace ndtree::test::test_merge_rule
