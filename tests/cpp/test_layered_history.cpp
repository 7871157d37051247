// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Layers of a map whose scans move are those that its scans make where they are.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <limits>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "history_scans.hpp"
#include "ndtree/io/layer_file.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/mapping/history/scan_history.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_layered_history {
namespace {

template <class Map>
using Layered = LayeredMap<Map, MeanValue<3>, MajorityLabel, LatestStamp, MeanValue<1>>;
using Key = std::int64_t;

struct Measured {
  std::vector<std::array<float, 3>> colours;
  std::vector<std::int64_t> labels;
  std::vector<double> stamps;
  std::vector<std::array<float, 1>> heights;
};
/// One of each a beam; of all beams the same time in half of the scans.
Measured random_measured(Random& random, Eigen::Index beams) {
  Measured measured;
  const double stamp = random.uniform(-100.0, 100.0);
  const bool is_same = random.chance(0.5);
  for (Eigen::Index i = 0; i < beams; ++i) {
    std::array<float, 3> colour{};
    for (float& x : colour) x = static_cast<float>(random.uniform(0.0, 255.0));
    measured.colours.push_back(colour);
    measured.labels.push_back(random.chance(0.5) ? 65535 : random.integer(0, 8));
    measured.stamps.push_back(is_same ? stamp : random.uniform(-100.0, 100.0));
    measured.heights.push_back({static_cast<float>(random.uniform(-1.0, 1.0))});
  }
  return measured;
}

template <class Map>
InsertReport insert(ScanHistory<Layered<Map>>& history, Key key, const Scan<Map::kDim>& scan,
                    const Pose<Map::kDim>& pose, const Measured& m, double max_range = kUnlimitedRange) {
  return history.insert(key, scan.view(), pose, {m.colours, m.labels, m.stamps, m.heights}, max_range);
}

/// What is kept of a scan's measurements is what was given, to the last bit.
template <class Map>
void expect_kept(const ScanHistory<Layered<Map>>& history, Key key, const Scan<Map::kDim>& given,
                 const Measured& m) {
  const auto& [colours, labels, stamps, heights] = history.measurements(key);
  std::size_t kept = 0;
  for (Eigen::Index i = 0; i < given.size(); ++i) {
    if (!given.endpoints.col(i).allFinite()) continue;
    const auto from = static_cast<std::size_t>(i);
    const std::size_t to = kept++;
    ASSERT_LT(to, colours.size());
    if (!given.returned[i]) continue;
    EXPECT_EQ(colours[to], m.colours[from]);
    EXPECT_EQ(labels[to], m.labels[from]);
    EXPECT_EQ(stamps[to], m.stamps[from]);
    EXPECT_EQ(heights[to], m.heights[from]);
  }
  EXPECT_EQ(kept, stamps.size());
}

/// A scan as a history has kept it.
template <class Map>
struct Taken {
  Scan<Map::kDim> scan;
  double max_range;
  Measured measured;

  Taken(const ScanHistory<Layered<Map>>& history, Key key)
      : scan(history.scan(key)), max_range(history.max_range(key)) {
    std::tie(measured.colours, measured.labels, measured.stamps, measured.heights) =
        history.measurements(key);
  }
  void insert_into(Layered<Map>& map, std::uint64_t number) const {
    ScanView<Map::kDim> view = scan.view();
    view.number = number;
    (void)map.insert(view, measured.colours, measured.labels, measured.stamps, measured.heights, max_range);
  }
  static void insert(Random& random, ScanHistory<Layered<Map>>& history, Key key, const Scan<Map::kDim>& scan,
                     std::uint64_t number, const Pose<Map::kDim>& pose, double max_range) {
    const Measured m = random_measured(random, scan.size());
    ScanView<Map::kDim> view = scan.view();
    view.number = number;
    (void)history.insert(key, view, pose, {m.colours, m.labels, m.stamps, m.heights}, max_range);
    expect_kept(history, key, scan, m);
  }
  static std::string bytes_of(const Layered<Map>& map) {
    map.map().check_invariants();
    map.template layer<0>().tree().check_invariants();
    UpdateCounters counters;
    counters.scans = map.counters().scans;
    return to_bytes(Layered<Map>(Map(map.options(), typename Map::Tree(map.tree()), counters), map.names(),
                                 map.layers()));
  }
};

template <class Map>
class LayeredHistoryOf : public ::testing::Test {};
using Maps = ::testing::Types<AdaptiveMap<2, 2>, AdaptiveMap<2, 3>>;
TYPED_TEST_SUITE(LayeredHistoryOf, Maps);

TYPED_TEST(LayeredHistoryOf, LayersAreThoseOfTheScansWhereTheyAre) {
  std::size_t replayed = 0;
  for (std::uint64_t seed = 1; seed <= (TypeParam::kDim < 3 ? 8 : 3); ++seed)
    replayed += play<Layered<TypeParam>, Taken<TypeParam>>(seed, 24);
  EXPECT_GT(replayed, 20u);
}

TYPED_TEST(LayeredHistoryOf, CubesTakeWhatEndsInThem) {
  constexpr int D = TypeParam::kDim;
  Random random(21);
  Layered<TypeParam> whole(options_of_history(TypeParam::kBranching));
  Layered<TypeParam> parts = whole;
  const auto& geometry = whole.tree().geometry();
  LatticeBox<D> all;
  all.lower.fill(geometry.coordinate(-30.0));
  all.upper.fill(geometry.coordinate(30.0));
  for (std::uint64_t number = 0; number < 6; ++number) {
    const Scan<D> scan = PackedScan<D>(random_scan<D>(random).view(), geometry.unit()).at({});
    ScanView<D> view = scan.view();
    view.number = number;
    const Measured m = random_measured(random, scan.size());
    (void)whole.insert(view, m.colours, m.labels, m.stamps, m.heights);
    for (const bool odd : {true, false}) {
      CubeSet<D> cubes(geometry.edge(0), all);
      Lattice<D> cube{};
      const auto add = [&](const auto& self, std::size_t axis) -> void {
        if (axis == D) return (cube[0] % 2 != 0) == odd ? cubes.insert(cube) : void();
        const std::int64_t last = geometry.coordinate(6.0) / geometry.edge(0) + 1;
        for (cube[axis] = -last; cube[axis] <= last; ++cube[axis]) self(self, axis + 1);
      };
      add(add, 0);
      typename Layered<TypeParam>::Reach reach;
      (void)parts.insert_in(cubes, view, parts.packed(view, {m.colours, m.labels, m.stamps, m.heights}),
                            kUnlimitedRange, 1, reach);
    }
  }
  EXPECT_TRUE(Taken<TypeParam>::bytes_of(parts) == Taken<TypeParam>::bytes_of(whole));
  EXPECT_FALSE(whole.template layer<2>().tree().root().is_leaf()) << "without any value";
}

using Map2 = AdaptiveMap<2, 2>;

TEST(LayeredHistory, MeasurementsTakeWhatTheirTypesNeed) {
  constexpr std::size_t kBeams = 10'000;
  const auto bytes_a_beam = [](auto value, auto measurement) {
    using Value = decltype(value);
    std::vector<typename Value::Measurement> measurements(kBeams, measurement);
    Scan<2> scan;
    scan.origins = Vector<2>::Zero();
    scan.endpoints = Points<2>::Ones(2, kBeams);
    const auto bytes = [&] {
      return static_cast<double>(PackedMeasurements<Value>(scan.view(), measurements.data()).memory_bytes() -
                                 sizeof(PackedMeasurements<Value>)) /
             double{kBeams};
    };
    EXPECT_LT(bytes(), 0.01) << "all are the same";
    measurements[kBeams / 2] = {};
    return bytes();
  };
  EXPECT_EQ(bytes_a_beam(MeanValue<1>{}, std::array<float, 1>{1.0F}), 4.0);
  EXPECT_EQ(bytes_a_beam(MeanValue<3>{}, std::array<float, 3>{1.0F}), 12.0);
  EXPECT_EQ(bytes_a_beam(MajorityLabel{}, 7), 2.0);
  EXPECT_EQ(bytes_a_beam(LatestStamp{}, 7.0), 8.0);
}

TEST(LayeredHistory, MemoryCountsMeasurements) {
  Random random(3);
  Scan<2> scan = random_scan<2>(random);
  scan.returned.setConstant(true);
  const auto n = static_cast<std::size_t>(scan.endpoints.array().colwise().sum().isFinite().count());
  const Measured measured = random_measured(random, scan.size());
  ScanHistory<Layered<Map2>> history(options_of_history(2));
  ScanHistory<Map2> plain(options_of_history(2));
  const auto packed = [](const auto& h) { return h.memory_bytes() - h.map().memory_bytes(); };
  for (Key key = 0; key < 50; ++key) {
    (void)insert(history, key, scan, {}, measured);
    (void)plain.insert(key, scan.view(), {});
  }
  EXPECT_GE(packed(history), packed(plain) + 50 * n * (12 + 2 + 4));
  EXPECT_LE(packed(history), packed(plain) + 50 * (n * (12 + 2 + 4 + 8) + 200));
}

TEST(LayeredHistory, BadCallsChangeNothing) {
  Random random(4);
  Scan<2> scan = random_scan<2>(random);
  scan.returned.setConstant(true);
  scan.endpoints.col(3) = Vector<2>(1.0, 1.0);
  const Measured good = random_measured(random, scan.size());
  ScanHistory<Layered<Map2>> history(options_of_history(2));
  (void)insert(history, 1, scan, {}, good);
  const std::string before = Taken<Map2>::bytes_of(history.map());
  const std::size_t bytes = history.memory_bytes();
  const auto n = std::to_string(scan.size());

  Measured none = good;
  none.labels.clear();
  EXPECT_EQ(refusal_by([&] { (void)insert(history, 2, scan, {}, none); }),
            "'majority' has 0 values: must be " + n + ", the number of end points");
  Measured wrong = good;
  wrong.labels[3] = 70'000;
  EXPECT_EQ(refusal_by([&] { (void)insert(history, 2, scan, {}, wrong); }),
            "'majority' of beam 3 = 70000: must be a whole number in [0, 65535]");
  wrong = good;
  wrong.stamps[3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(refusal_by([&] { (void)insert(history, 2, scan, {}, wrong); }),
            "'latest' of beam 3 = nan: must be finite");
  EXPECT_EQ(refusal_by([&] { (void)ScanHistory<Layered<Map2>>(history.map()); }),
            "a map of 1 scans and " + std::to_string(history.map().tree().num_nodes()) +
                " nodes: a history must begin with an empty one");
  EXPECT_EQ(Taken<Map2>::bytes_of(history.map()), before);
  EXPECT_EQ(history.keys(), std::vector<Key>{1});
  EXPECT_EQ(history.memory_bytes(), bytes);

  scan.returned[3] = false;
  (void)insert(history, 2, scan, {}, wrong);  // What did not return has no measurement.
  EXPECT_EQ(std::get<2>(history.measurements(2))[3], 0.0);
}

/// Cancels a call at each of its checkpoints, until it passes. @returns at how many.
template <class History, class Call>
int cancel_everywhere(History& history, const Call& call) {
  const std::string before = Taken<Map2>::bytes_of(history.map());
  const auto keys = history.keys();
  for (int checkpoint = 0;; ++checkpoint) {
    int asked = 0;
    const auto stop = [&] { return asked++ >= checkpoint; };
    const CancelScope scope(stop, stop);
    try {
      (void)call();
      return checkpoint;
    } catch (const Cancelled&) {
      EXPECT_EQ(Taken<Map2>::bytes_of(history.map()), before) << "at checkpoint " << checkpoint;
      EXPECT_EQ(history.keys(), keys);
    }
  }
}

/// A history that took one scan in several places, with keys from 0 on.
struct OneScanOften {
  Scan<2> scan;
  Measured measured;
  ScanHistory<Layered<Map2>> history{options_of_history(2)};

  OneScanOften(Random& random, Key times)
      : scan(random_scan<2>(random)), measured(random_measured(random, scan.size())) {
    for (Key key = 0; key < times; ++key)
      (void)insert(history, key, scan, random_pose<2>(random, 3.0), measured);
  }
};

TEST(LayeredHistory, ACancelledCallChangesNothing) {
  Random random(10);
  OneScanOften often(random, 12);
  ScanHistory<Layered<Map2>>& history = often.history;
  std::vector<std::pair<Key, Pose<2>>> poses;
  for (Key key = 0; key < 12; key += 2) poses.emplace_back(key, random_pose<2>(random, 3.0));
  int cancelled = 0;
  cancelled +=
      cancel_everywhere(history, [&] { return insert(history, 50, often.scan, {}, often.measured); });
  EXPECT_GE(cancelled, 2);
  cancelled += cancel_everywhere(history, [&] { return history.move(poses); });
  cancelled += cancel_everywhere(history, [&] { return history.remove({3, 4}); });
  cancelled += cancel_everywhere(history, [&] { return history.freeze(2), 0; });
  EXPECT_GE(cancelled, 10);
}

TEST(LayeredHistory, MapAndLayersTogetherKeepToTheirMemory) {
  Random random(11);
  const OneScanOften often(random, 6);
  const auto& [scan, measured, free] = often;
  MapOptions options = options_of_history(2);
  options.max_memory = static_cast<double>(free.map().memory_bytes());
  ScanHistory<Layered<Map2>> history(options);
  int refused = 0;
  for (Key key = 0; key < 40; ++key) {
    const std::string before = Taken<Map2>::bytes_of(history.map());
    const std::size_t size = history.size();
    try {
      (void)insert(history, key, scan, random_pose<2>(random, 20.0), measured);
      std::vector<std::pair<Key, Pose<2>>> poses;
      for (const Key one : history.keys()) poses.emplace_back(one, history.pose(one));
      for (auto& [one, pose] : poses) pose = random_pose<2>(random, 1.0);
      (void)history.move(poses);
    } catch (const MemoryLimitReached&) {
      ++refused;
      if (history.size() == size) {
        EXPECT_EQ(Taken<Map2>::bytes_of(history.map()), before);
      }
    }
    ASSERT_LE(static_cast<double>(history.map().memory_bytes()), options.max_memory);
  }
  EXPECT_GT(refused, 5);
}

}  // namespace
}  // namespace ndtree::test::test_layered_history
