// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "refusals.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_compress {
namespace {

/// A box of walls seen from inside, with noise.
template <int N, int D>
AdaptiveMap<N, D> room(int scans) {
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 1.6;
  options.range_sigma = 0.03;
  AdaptiveMap<N, D> map(options);
  Random random(7);
  for (int i = 0; i < scans; ++i) {
    Scan<D> scan;
    scan.origins = Vector<D>::Constant(random.uniform(-1.0, 1.0));
    scan.endpoints.resize(D, 120);
    for (int k = 0; k < 120; ++k) {
      Vector<D> direction;
      for (int a = 0; a < D; ++a) direction[a] = random.uniform(-1.0, 1.0);
      double t = 1e9;
      for (int a = 0; a < D; ++a)
        if (direction[a] != 0.0)
          t = std::min(t, ((direction[a] > 0.0 ? 2.03 : -2.03) - scan.origins(a, 0)) / direction[a]);
      scan.endpoints.col(k) = scan.origins.col(0) + direction * (t + random.uniform(-0.03, 0.03));
    }
    map.insert(scan);
  }
  return map;
}

/// What a refusal says that a limit must at least be; 0 if there was none.
template <class Map>
std::size_t least(Map map, const CompressBudget& budget) {
  try {
    map.compress(budget);
  } catch (const std::invalid_argument& error) {
    const std::string text = error.what();
    return static_cast<std::size_t>(std::stoull(text.substr(text.find("at least ") + 9)));
  }
  return 0;
}

template <class Type>
class Compress : public testing::Test {};
TYPED_TEST_SUITE(Compress, TwoShapes, ShapeNames);

TYPED_TEST(Compress, MeetsEachBudgetAndSaysWhatItCost) {
  const auto map = room<TypeParam::kBranching, TypeParam::kDim>(30);
  const MapStats stats = map.stats();
  double last_loss = 0.0;
  for (const double share : {1.0, 0.8, 0.5, 0.3}) {
    auto copy = map;
    const std::size_t bytes = copy.stats().memory_bytes;  // A copy's directory has no room to spare.
    const auto leaves =
        std::max(least(map, {{}, 0, {}}),
                 static_cast<std::size_t>(share * static_cast<double>(stats.observed_leaves)));
    const CompressReport report = copy.compress({std::nullopt, leaves, std::nullopt});
    copy.check_invariants();
    EXPECT_LE(report.leaves, leaves);
    EXPECT_EQ(report.leaves_before, stats.observed_leaves);
    EXPECT_EQ(report.leaves, copy.stats().observed_leaves);
    EXPECT_EQ(report.bytes_before, bytes);
    EXPECT_EQ(report.bytes, copy.stats().memory_bytes);
    EXPECT_EQ(copy.stats().merges, stats.merges + report.merges);
    EXPECT_GE(report.loss, last_loss);
    last_loss = report.loss;

    auto by_loss = map;
    const CompressReport lossy = by_loss.compress({report.loss, std::nullopt, std::nullopt});
    EXPECT_LE(lossy.loss, report.loss);
    EXPECT_LE(lossy.leaves, report.leaves);

    auto by_bytes = map;
    const CompressReport small = by_bytes.compress({std::nullopt, std::nullopt, report.bytes});
    EXPECT_LE(by_bytes.stats().memory_bytes, report.bytes);
    EXPECT_EQ(small.bytes, by_bytes.stats().memory_bytes);
  }
  EXPECT_GT(last_loss, 0.0);
}

TYPED_TEST(Compress, MergesWhatCostsLeastFirst) {
  const auto map = room<TypeParam::kBranching, TypeParam::kDim>(30);
  double last = 0.0;
  for (const std::size_t leaves : {map.stats().observed_leaves - 1, least(map, {{}, 0, {}})}) {
    auto copy = map;
    const CompressReport report = copy.compress({{}, leaves, {}});
    const double cost = report.loss / static_cast<double>(report.leaves_before - report.leaves);
    EXPECT_GT(cost, last) << "for each leaf saved";
    last = cost;
  }
}

TYPED_TEST(Compress, IsDeterministicAndChangesNothingTwice) {
  auto once = room<TypeParam::kBranching, TypeParam::kDim>(10);
  auto again = room<TypeParam::kBranching, TypeParam::kDim>(10);
  once.compress({20.0, std::nullopt, std::nullopt});
  again.compress({20.0, std::nullopt, std::nullopt});
  EXPECT_EQ(to_bytes(once), to_bytes(again));
  const std::size_t leaves = once.stats().observed_leaves;
  const CompressReport report = once.compress({std::nullopt, leaves, std::nullopt});
  EXPECT_LE(report.leaves, leaves);
  EXPECT_EQ(report.loss, 0.0);
  EXPECT_EQ(to_bytes(from_bytes<decltype(once)>(to_bytes(once))), to_bytes(once));
}

TEST(CompressLoss, WhatLosesLittleKeepsStates) {
  auto map = room<2, 2>(200);
  const auto before = map;
  const CompressReport report =
      map.compress({0.1 * static_cast<double>(map.stats().observed_leaves), {}, {}});
  EXPECT_GT(report.merges, 0u);
  int same = 0;
  int all = 0;
  for_each_leaf(before.tree(), [&](const auto& leaf) {
    if (!leaf.cell().observed()) return;
    const auto box = before.tree().box(leaf.index);
    ++all;
    same += state(map, Vector<2>(0.5 * (box.lower + box.upper))) == leaf.cell().state();
  });
  EXPECT_GT(all, 50);
  EXPECT_GT(same, 0.99 * all);
}

TEST(CompressBudget, WhatCannotBeIsRefusedAndTheMapIsAsItWas) {
  auto map = room<2, 2>(5);
  const std::string before = to_bytes(map);
  struct Row {
    CompressBudget budget;
    const char* message;
  };
  const std::vector<Row> rows{
      {{}, "expected max_loss, max_leaves or max_bytes"},
      {{-1.0, {}, {}}, "max_loss = -1.0: must be >= 0 bits"},
      {{{}, 3, {}}, "max_leaves = 3: must be at least "},
      {{{}, {}, 100}, "max_bytes = 100: must be at least "},
  };
  for (const Row& row : rows) {
    expect_refused([&] { map.compress(row.budget); }, row.message);
    EXPECT_EQ(to_bytes(map), before);
  }
}

TEST(CompressBudget, TheLeastThatItNamesCanBeHad) {
  auto map = room<2, 2>(5);
  const std::size_t leaves = least(map, {{}, 0, {}});
  const std::size_t bytes = least(map, {{}, {}, 0});
  auto few = map;
  EXPECT_EQ(few.compress({{}, leaves, {}}).leaves, leaves);
  auto small = map;
  EXPECT_EQ(small.compress({{}, {}, bytes}).bytes, bytes);
}

}  // namespace
}  // namespace ndtree::test::test_compress
