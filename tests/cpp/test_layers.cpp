// SPDX-License-Identifier: BSD-3-Clause
// Values beside a map's cells: colours, labels, times.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/io/layer_file.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/tree/visit.hpp"
#include "options.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_layers {
namespace {

TEST(Values, MeanIsTheMean) {
  Random random(1);
  MeanValue<2> value;
  EXPECT_TRUE(value.is_empty());
  double sum[2] = {0.0, 0.0};
  for (int i = 1; i <= 1000; ++i) {
    const std::array<float, 2> x{static_cast<float>(random.uniform(-5.0, 5.0)),
                                 static_cast<float>(random.uniform(0.0, 255.0))};
    value.add(x);
    for (std::size_t k = 0; k < 2; ++k) {
      sum[k] += static_cast<double>(x[k]);
      EXPECT_NEAR(static_cast<double>(value.mean()[k]), sum[k] / i, 1e-3);
    }
  }
  EXPECT_EQ(value.weight(), 1000.0f);
  const MeanValue<2> part = value.part(8);
  EXPECT_EQ(part.mean(), value.mean());
  EXPECT_EQ(part.weight(), 125.0f);
  MeanValue<2> again;
  for (int j = 0; j < 8; ++j) again.join(part);
  EXPECT_EQ(again.weight(), 1000.0f);
  EXPECT_NEAR(static_cast<double>(again.mean()[1]), static_cast<double>(value.mean()[1]), 1e-3);
}
TEST(Values, MeanOfManyForgetsSlowly) {
  MeanValue<1> value;
  for (int i = 0; i < 100'000; ++i) value.add({1.0f});
  EXPECT_EQ(value.weight(), MeanValue<1>::kMostWeight);
  for (int i = 0; i < 300'000; ++i) value.add({3.0f});
  EXPECT_GT(value.mean()[0], 2.9f);
}
TEST(Values, LabelOfTheMajority) {
  Random random(2);
  for (int round = 0; round < 200; ++round) {
    std::map<std::int64_t, int> counts;
    MajorityLabel value;
    MajorityLabel halves[2];
    int most = 0;
    std::int64_t frequent = -1;
    const int n = 20 + round;
    for (int i = 0; i < n; ++i) {
      const std::int64_t label =
          random.uniform(0.0, 1.0) < 0.55 ? 7 : static_cast<std::int64_t>(random.uniform(0.0, 60000.0));
      value.add(label);
      halves[i % 2].add(label);
      if (++counts[label] > most) {
        most = counts[label];
        frequent = label;
      }
    }
    if (2 * most <= n) continue;
    EXPECT_EQ(value.label(), frequent);
    halves[0].join(halves[1]);
    EXPECT_EQ(halves[0].label(), frequent);
    EXPECT_LE(value.counted()[0].count, most);
    EXPECT_GE(value.counted()[0].count, most - (n - most));
    EXPECT_EQ(value.part(8).label(), frequent);
  }
  MajorityLabel value;  // Few that cells divide and join: the majority stays.
  for (const int label : {9, 9, 9, 9, 3}) value.add(label);
  MajorityLabel joined;
  for (int child = 0; child < 4; ++child) joined.join(value.part(4));
  joined.add(7);
  EXPECT_EQ(joined.label(), 9);
  EXPECT_LE(joined.counted()[1].count, 1);
  EXPECT_TRUE(MajorityLabel{}.part(4).is_empty());
}
TEST(Values, CountsOfFourLabelsAreExact) {
  MajorityLabel value;
  const int counts[] = {5, 9, 1, 9};
  for (int label = 0; label < 4; ++label)
    for (int i = 0; i < counts[label]; ++i) value.add(label);
  const std::array<std::array<int, 2>, 4> expected{{{1, 9}, {3, 9}, {0, 5}, {2, 1}}};
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(value.counted()[i].label, expected[i][0]);
    EXPECT_EQ(value.counted()[i].count, expected[i][1]);
  }
  for (int i = 0; i < 100'000; ++i) value.add(3);
  EXPECT_EQ(value.label(), 3);
  EXPECT_LE(value.counted()[0].count, MajorityLabel::kMaxCount);
}
template <class Value>
void expect_same_words(const Value& value) {
  const auto words = value.words();
  EXPECT_NE(words[0], 0u);
  EXPECT_LT(words[0], 0x80000000u);
  EXPECT_EQ(Value::from_words(words).words(), words);
}
TEST(Values, WordsAndBackAndTheLatestOfAll) {
  MeanValue<3> mean;
  EXPECT_EQ(mean.words()[0], 0u);
  mean.add({1.0f, -2.0f, 3.0f});
  expect_same_words(mean);
  expect_same_words(mean.part(1000));
  MajorityLabel label;
  EXPECT_EQ(label.words()[0], 0u);
  for (int i = 0; i < 70'000; ++i) label.add(i % 3);
  expect_same_words(label);
  LatestStamp stamp;
  EXPECT_EQ(stamp.words()[0], 0u);
  EXPECT_TRUE(stamp.is_empty());
  for (const auto& [added, latest] : {std::pair(-1e9, -1e9), {3.0, 3.0}, {2.0, 3.0}}) {
    stamp.add(added);
    EXPECT_EQ(stamp.stamp(), latest);
  }
  stamp.join(LatestStamp{});
  EXPECT_EQ(stamp.part(8).stamp(), 3.0);
  expect_same_words(stamp);
  EXPECT_THROW((void)MeanValue<1>::from_words({0x7fc00000u, 0u}), std::invalid_argument);
  EXPECT_THROW((void)MajorityLabel::from_words({0x00010000u, 0x00020001u, 0, 0}), std::invalid_argument);
  EXPECT_THROW((void)LatestStamp::from_words({2, 0, 0}), std::invalid_argument);
}
TEST(Values, RefuseWhatCannotBeAdded) {
  EXPECT_THROW(MeanValue<1>::check({std::numeric_limits<float>::infinity()}), std::invalid_argument);
  EXPECT_THROW(MajorityLabel::check(-1), std::invalid_argument);
  EXPECT_THROW(MajorityLabel::check(65536), std::invalid_argument);
  EXPECT_THROW(LatestStamp::check(std::nan("")), std::invalid_argument);
}

template <class Map>
using Layered = LayeredMap<Map, MeanValue<1>, MajorityLabel, LatestStamp>;

struct Measured {
  std::vector<std::array<float, 1>> heights;
  std::vector<std::int64_t> labels;
  std::vector<double> stamps;
};
template <int D>
Scan<D> random_scan(Random& random, Measured& measured) {
  Scan<D> scan;
  scan.origins.resize(D, 1);
  scan.endpoints.resize(D, 60);
  scan.returned.resize(60);
  measured = {};
  for (int a = 0; a < D; ++a) scan.origins(a, 0) = random.uniform(-0.5, 0.5);
  for (Eigen::Index k = 0; k < 60; ++k) {
    for (int a = 0; a < D; ++a) scan.endpoints(a, k) = random.uniform(-3.0, 3.0);
    scan.endpoints(0, k) = 2.6;  // A wall.
    scan.returned[k] = random.uniform(0.0, 1.0) < 0.8;
    measured.heights.push_back({static_cast<float>(scan.endpoints(1, k))});
    measured.labels.push_back(scan.endpoints(1, k) > 0.0 ? 3 : 5);
    measured.stamps.push_back(random.uniform(0.0, 100.0));
  }
  return scan;
}

template <class Map>
class Layers : public testing::Test {};
using Maps = testing::Types<AdaptiveMap<2, 3>, FixedMap<2, 2>>;
TYPED_TEST_SUITE(Layers, Maps);

/// As nothing splits after a hit in the fixed map, and where cells do, parts have the mean of the whole: what
/// a cell has is the values of its own beams and of those before its last split.
TYPED_TEST(Layers, CellsKnowWhatEndsInThem) {
  constexpr int D = TypeParam::kDim;
  Random random(3);
  Layered<TypeParam> map(some_options(TypeParam::kBranching));
  TypeParam alone(some_options(TypeParam::kBranching));
  std::vector<Vector<D>> ends;
  std::vector<double> stamps;
  for (int i = 0; i < 30; ++i) {
    Measured measured;
    const Scan<D> scan = random_scan<D>(random, measured);
    map.insert(scan, measured.heights, measured.labels, measured.stamps);
    alone.insert(scan);
    for (Eigen::Index k = 0; k < scan.size(); ++k) {
      if (!scan.returned[k]) continue;
      ends.push_back(scan.endpoints.col(k));
      stamps.push_back(measured.stamps[static_cast<std::size_t>(k)]);
    }
  }
  EXPECT_EQ(to_bytes(map.map()), to_bytes(alone));  // The map does not depend on its layers.
  map.template layer<0>().tree().check_invariants();
  std::size_t looked_at = 0;
  for_each_leaf(map.map().tree(), [&](const auto& leaf) {
    const Box<D> box = map.map().tree().box(leaf.index);
    const Vector<D> centre = 0.5 * (box.lower + box.upper);
    double latest = -1.0;
    for (std::size_t i = 0; i < ends.size(); ++i)
      if (map.map().tree().geometry().contains(leaf.index, map.map().tree().geometry().coordinates(ends[i])))
        latest = std::max(latest, stamps[i]);
    const LatestStamp stamp = map.template value<2>(centre);
    const MeanValue<1> height = map.template value<0>(centre);
    if (latest < 0.0 || !leaf.cell().observed()) return;
    ++looked_at;
    ASSERT_FALSE(stamp.is_empty());
    EXPECT_GE(stamp.stamp(), latest);  // A part may have the time of the whole.
    if constexpr (std::is_same_v<TypeParam, FixedMap<2, 2>>) {
      EXPECT_EQ(stamp.stamp(), latest);
      EXPECT_NEAR(static_cast<double>(height.mean()[0]), centre[1],
                  0.5 * (box.upper[1] - box.lower[1]) + 1e-5);
    } else {
      EXPECT_NEAR(static_cast<double>(height.mean()[0]), centre[1], 2.5);
    }
    if (std::abs(centre[1]) > 1.5) {
      EXPECT_EQ(map.template value<1>(centre).label(), centre[1] > 0.0 ? 3 : 5);
    }
  });
  EXPECT_GT(looked_at, 5u);
  EXPECT_TRUE(map.template value<0>(Vector<D>::Constant(500.0)).is_empty());
}

template <class Map>
Layered<Map> some_map(Random& random, int scans) {
  Layered<Map> map(some_options(Map::kBranching));
  for (int i = 0; i < scans; ++i) {
    Measured measured;
    const Scan<Map::kDim> scan = random_scan<Map::kDim>(random, measured);
    map.insert(scan, measured.heights, measured.labels, measured.stamps);
  }
  return map;
}

TYPED_TEST(Layers, FilesHoldThem) {
  Random random(4);
  const auto map = some_map<TypeParam>(random, 5);
  const std::string bytes = to_bytes(map);
  EXPECT_EQ(to_bytes(from_bytes<TypeParam>(bytes)), to_bytes(map.map()));
  const auto back = layered_from_bytes<Layered<TypeParam>>(bytes, map.names());
  EXPECT_EQ(to_bytes(back), bytes);
  using Other = LayeredMap<TypeParam, LatestStamp>;
  EXPECT_EQ(to_bytes(layered_from_bytes<Other>(bytes, {"latest"}).map()), to_bytes(map.map()));
  EXPECT_EQ(refusal_by<std::runtime_error>([&] { (void)layered_from_bytes<Other>(bytes, {"mean"}); }),
            "layer 'mean': follows the rule 'mean', expected 'latest'");
}
TYPED_TEST(Layers, WhatIsForgottenHasNone) {
  constexpr int D = TypeParam::kDim;
  Random random(5);
  auto map = some_map<TypeParam>(random, 8);
  Box<D> half{Vector<D>::Constant(-10.0), Vector<D>::Constant(10.0)};
  half.lower[1] = 0.0;
  map.clear(half);
  map.template layer<0>().tree().check_invariants();
  std::size_t left = 0;
  map.template layer<0>().for_each([&](const auto&, const Vector<D>& centre, const auto&) {
    ++left;
    EXPECT_LT(centre[1], 0.0);
  });
  EXPECT_GT(left, 0u);
  map.keep_near(Vector<D>::Constant(-100.0), 1.0);
  map.template layer<0>().for_each([&](const auto&, const auto&, const auto&) { ADD_FAILURE(); });
  EXPECT_EQ(map.template layer<2>().tree().num_nodes(), map.template layer<0>().tree().num_nodes());
}
TYPED_TEST(Layers, ForgettingLooksWhereTheMapForgets) {
  // As if it looked everywhere.
  constexpr int D = TypeParam::kDim;
  Random random(15);
  const auto before = some_map<TypeParam>(random, 6);
  std::size_t smaller = 0;
  for (int round = 0; round < 30; ++round) {
    auto map = before;
    Box<D> box;
    for (int a = 0; a < D; ++a) {
      box.lower[a] = random.uniform(-3.0, 2.0);
      box.upper[a] = box.lower[a] + random.uniform(0.3, 4.0);
    }
    if (round % 3 == 0) map.crop(box);
    if (round % 3 == 1) map.clear(box);
    if (round % 3 == 2) map.keep_near(box.lower, random.uniform(0.5, 4.0));
    auto expected = before.template layer<1>();
    expected.keep_known(map.map().tree(), [](const auto&) { return true; });
    for_each_leaf(map.map().tree(), [&](const auto& leaf) {
      if (!leaf.cell().observed()) return;
      EXPECT_EQ(map.template layer<1>().of(leaf.index).words(), expected.of(leaf.index).words()) << round;
    });
    smaller +=
        static_cast<std::size_t>(expected.tree().num_nodes() < before.template layer<1>().tree().num_nodes());
  }
  EXPECT_GT(smaller, 10u);
}
TYPED_TEST(Layers, MapAndLayersTogetherKeepToTheirMemory) {
  constexpr int D = TypeParam::kDim;
  Random random(16);
  const auto few = some_map<TypeParam>(random, 2);
  MapOptions options = few.map().options();
  // An empty map may hold some bytes more than one that was copied.
  const std::size_t most = std::max(few.memory_bytes(), Layered<TypeParam>(options).memory_bytes());
  options.max_memory = static_cast<double>(most);
  Layered<TypeParam> map(options);
  Measured measured;
  int refused = 0;
  for (int i = 0; i < 200 && refused < 5; ++i) {
    Scan<D> scan = random_scan<D>(random, measured);
    scan.endpoints *= 1.0 + 0.3 * i;
    if (i > 2) scan.returned.setConstant(false);  // The map alone grows.
    const std::string before = to_bytes(map);
    try {
      map.insert(scan, measured.heights, measured.labels, measured.stamps);
    } catch (const MemoryLimitReached&) {
      ++refused;
      EXPECT_EQ(to_bytes(map), before);
    }
    ASSERT_LE(map.memory_bytes(), most);
  }
  EXPECT_EQ(refused, 5);
}
TYPED_TEST(Layers, MergedMapsKnowBoth) {
  Random random(6);
  const auto one = some_map<TypeParam>(random, 4);
  const auto other = some_map<TypeParam>(random, 4);
  auto both = one;
  both.merge(other);
  auto same = other;
  same.merge(one);
  EXPECT_EQ(to_bytes(both.map()), to_bytes(same.map()));
  for_each_leaf(both.map().tree(), [&](const auto& leaf) {
    if (!leaf.cell().observed()) return;
    const LatestStamp stamp = both.template layer<2>().of(leaf.index);
    EXPECT_EQ(stamp.words(), same.template layer<2>().of(leaf.index).words());
    LatestStamp expected = one.template layer<2>().of(leaf.index);
    expected.join(other.template layer<2>().of(leaf.index));
    EXPECT_GE(stamp.stamp(), expected.stamp());  // Where a cell of one was larger, it may know more.
    const auto height = both.template layer<0>().of(leaf.index);
    const auto height_of_same = same.template layer<0>().of(leaf.index);
    ASSERT_EQ(height.is_empty(), height_of_same.is_empty());
    if (!height.is_empty()) {
      EXPECT_NEAR(height.mean()[0], height_of_same.mean()[0], 1e-4);
    }
  });
}
TYPED_TEST(Layers, RefusedCallsChangeNothingAndOthersNoSnapshot) {
  constexpr int D = TypeParam::kDim;
  Random random(7);
  auto map = some_map<TypeParam>(random, 2);
  const auto snapshot = map.snapshot();
  const std::string before = to_bytes(map);
  Measured measured;
  const Scan<D> scan = random_scan<D>(random, measured);
  Eigen::Index returned = 0;
  while (!scan.returned[returned]) ++returned;
  measured.labels[static_cast<std::size_t>(returned)] = -7;
  EXPECT_EQ(refusal_by([&] { map.insert(scan, measured.heights, measured.labels, measured.stamps); }),
            "'majority' of beam " + std::to_string(returned) + " = -7: must be a whole number in [0, 65535]");
  measured.labels.pop_back();
  EXPECT_THROW(map.insert(scan, measured.heights, measured.labels, measured.stamps), std::invalid_argument);
  EXPECT_EQ(to_bytes(map), before);
  EXPECT_THROW((Layered<TypeParam>(MapOptions{}, {"a", "b", "a"})), std::invalid_argument);
  const auto next = random_scan<D>(random, measured);
  map.insert(next, measured.heights, measured.labels, measured.stamps);
  EXPECT_NE(to_bytes(map), before);
  EXPECT_EQ(to_bytes(snapshot), before);
}
TYPED_TEST(Layers, AWindowTakesWhatEndsInIt) {
  constexpr int D = TypeParam::kDim;
  Random random(8);
  Layered<TypeParam> whole(some_options(TypeParam::kBranching));
  Layered<TypeParam> parts(some_options(TypeParam::kBranching));
  const double border = 0.0;
  for (int i = 0; i < 4; ++i) {
    Measured measured;
    const Scan<D> scan = random_scan<D>(random, measured);
    whole.insert(scan, measured.heights, measured.labels, measured.stamps);
    for (const bool upper : {false, true}) {
      Box<D> box{Vector<D>::Constant(-50.0), Vector<D>::Constant(50.0)};
      (upper ? box.lower : box.upper)[1] = border;
      parts.insert(scan, measured.heights, measured.labels, measured.stamps, kUnlimitedRange, 0, box);
    }
  }
  std::size_t n = 0;
  for_each_leaf(whole.map().tree(), [&](const auto& leaf) {
    if (!leaf.cell().observed()) return;
    ++n;
    // Means are sums in the order in which cells were joined.
    const auto at_once = whole.template layer<0>().of(leaf.index).words();
    const auto in_parts = parts.template layer<0>().of(leaf.index).words();
    for (std::size_t k = 0; k < at_once.size(); ++k)
      EXPECT_LE(std::max(at_once[k], in_parts[k]) - std::min(at_once[k], in_parts[k]), 1u);
  });
  EXPECT_GT(n, 10u);
}

}  // namespace
}  // namespace ndtree::test::test_layers
