// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "map_kinds.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/history/crossed_cubes.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "options.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test {
namespace {

/// A scan that goes all around, with ranges up to `reach` [m].
template <int D>
Scan<D> random_scan(Random& random, Eigen::Index beams, double reach, double offset = 0.0) {
  Scan<D> scan;
  scan.origins = Vector<D>::Constant(offset);
  scan.endpoints.resize(D, beams);
  scan.returned.resize(beams);
  for (Eigen::Index i = 0; i < beams; ++i) {
    for (int a = 0; a < D; ++a) scan.endpoints(a, i) = offset + random.uniform(-reach, reach);
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}

template <class Map>
class Limits : public testing::Test {};
TYPED_TEST_SUITE(Limits, MapKinds);

TYPED_TEST(Limits, AScanThatWouldTakeTooMuchMemoryLeavesTheMapAsItWas) {
  constexpr int D = TypeParam::kDim;
  int refused = 0;
  for (const int threads : {1, 3}) {
    Random random(7);
    MapOptions options = spelled_out_options(0.05, 0.8);
    options.max_memory = 300e3;
    options.split_probability = 0.5;
    TypeParam map(options);
    for (int i = 0; i < 25; ++i) {
      SCOPED_TRACE(i);
      const Scan<D> scan = random_scan<D>(random, 1200, D == 2 ? 2.0 * (1 + i) : 0.6 * (1 + i), 0.1 * i);
      const std::string before = to_bytes(map);
      bool was_refused = false;
      try {
        map.insert(scan, kUnlimitedRange, threads);
      } catch (const MemoryLimitReached& error) {
        was_refused = true;
        EXPECT_NE(std::string(error.what()).find("max_memory = 300000"), std::string::npos) << error.what();
      }
      ASSERT_LE(map.memory_bytes(), 300000u);
      ASSERT_NO_THROW(map.check_invariants());
      refused += was_refused;
      ASSERT_TRUE(!was_refused || to_bytes(map) == before);
    }
    // What it still takes is what it would without having refused anything.
    const std::string bytes = to_bytes(map);
    TypeParam again = from_bytes<TypeParam>(bytes);
    const Scan<D> small = random_scan<D>(random, 5, 0.3);
    map.insert(small, kUnlimitedRange, threads);
    again.insert(small, kUnlimitedRange, 1);
    EXPECT_TRUE(to_bytes(map) == to_bytes(again));
  }
  EXPECT_GT(refused, 10) << "else nothing was tried";
}

TYPED_TEST(Limits, AnInsertionThatIsCancelledLeavesTheMapAsItWas) {
  constexpr int D = TypeParam::kDim;
  int cancelled = 0;
  int finished = 0;
  for (const int threads : {1, 3}) {
    Random random(8);
    TypeParam map(spelled_out_options(0.02, 0.64));
    for (int i = 0; i < 8; ++i) {
      const Scan<D> scan = random_scan<D>(random, 3000, 4.0, 0.2 * i);
      const std::string before = to_bytes(map);
      int asked = 0;
      try {
        // Every other one at the first question, the rest wherever the machine has got to by then.
        const auto deadline = std::chrono::steady_clock::now() +
                              std::chrono::milliseconds(i % 2 == 1 ? -1 : random.integer(0, 30));
        const CancelScope scope([&] {
          ++asked;
          return std::chrono::steady_clock::now() > deadline;
        });
        map.insert(scan, kUnlimitedRange, threads);
        ++finished;
      } catch (const Cancelled&) {
        ++cancelled;
        EXPECT_GE(asked, 1);
        ASSERT_TRUE(to_bytes(map) == before);
      }
      ASSERT_NO_THROW(map.check_invariants());
    }
  }
  EXPECT_GE(cancelled, 1);
  EXPECT_EQ(cancelled + finished, 16);
}

TYPED_TEST(Limits, BeamsThatAreAbsurdBesideTheCellsAreRefused) {
  constexpr int D = TypeParam::kDim;
  TypeParam map(spelled_out_options(0.05, 0.8));
  const std::string empty = to_bytes(map);
  const double longest = 0x1p20 * 0.05;
  for (const double length : {1.1 * longest, 1e9, 1e300}) {
    Scan<D> scan;
    scan.origins = Vector<D>::Zero();
    scan.endpoints = Points<D>::Ones(D, 20);
    scan.endpoints.col(11) = length * Vector<D>::Unit(0);
    for (const int threads : {1, 2}) {
      const std::string error = refusal_by([&] { map.insert(scan, kUnlimitedRange, threads); });
      EXPECT_EQ(error.find("beam 11 "), 0u) << error;
      EXPECT_LT(error.size(), 300u) << error;
    }
    EXPECT_TRUE(to_bytes(map) == empty);
    EXPECT_EQ(map.insert(scan, 30.0).beyond_max_range, 1u) << "cut, they are no longer";
    map = TypeParam(map.options());
  }
  Scan<D> noisy;
  noisy.origins = Vector<D>::Zero();
  noisy.endpoints = Points<D>::Ones(D, 3);
  noisy.range_sigma = Eigen::ArrayXd::Constant(3, 0.01);
  for (const double sigma : {1e9, 1e6, 0.34 * longest}) {
    noisy.range_sigma[1] = sigma;
    const std::string error = refusal_by([&] { map.insert(noisy); });
    EXPECT_NE(error.find("beam 1"), std::string::npos) << error;
    EXPECT_NE(error.find("range_sigma"), std::string::npos) << error;
  }
  EXPECT_TRUE(to_bytes(map) == empty);
  Scan<D> just;
  just.origins = Vector<D>::Zero();
  just.endpoints = 0.9999 * longest * Vector<D>::Unit(0);
  if (TypeParam::RefinementType::kAdaptive) {
    EXPECT_NO_THROW(map.insert(just));
  }
  map.check_invariants();
}

TYPED_TEST(Limits, BeamsOfAnyLengthAreCutBeforeTheirNoiseIsAsked) {
  constexpr int D = TypeParam::kDim;
  MapOptions options = spelled_out_options(0.05, 0.8);
  options.range_sigma_quadratic = 1e-3;
  options.covered_share = 0.75;
  // Powers of two: cut at 4 m, beams of all lengths end at the same point.
  const auto scan_with = [](int exponent, bool own_origins, bool returned) {
    Scan<D> scan;
    scan.origins = Points<D>::Constant(D, own_origins ? 3 : 1, 0.0);
    scan.endpoints = Points<D>::Ones(D, 3);
    scan.endpoints(D - 1, 2) = 0.3;
    scan.endpoints.col(1) = std::ldexp(1.0, exponent) * Vector<D>::Unit(0);
    scan.returned.setConstant(3, true);
    scan.returned[1] = returned;
    return scan;
  };
  for (const bool own_origins : {false, true})
    for (const bool returned : {false, true}) {
      TypeParam expected(options);
      expected.insert(scan_with(6, own_origins, returned), 4.0);
      // A beam that is too long for float is sampled by its cut displacement instead of its whole one.
      TypeParam of_cut(options);
      of_cut.insert(scan_with(62, own_origins, returned), 4.0);
      EXPECT_NEAR(static_cast<double>(of_cut.stats().observed_leaves),
                  static_cast<double>(expected.stats().observed_leaves), 2.0);
      for (const int exponent : {33, 56, 62, 64, 128, 512, 664, 1022}) {
        TypeParam map(options);
        const InsertReport report = map.insert(scan_with(exponent, own_origins, returned), 4.0);
        EXPECT_EQ(report.beyond_max_range, returned ? 1u : 0u);
        const bool is_like_short = exponent < 60 || !std::is_same_v<typename TypeParam::Cell, EvidenceCell>;
        EXPECT_TRUE(to_bytes(map) == to_bytes(is_like_short ? expected : of_cut)) << "2^" << exponent << " m";
        const auto& geometry = map.tree().geometry();
        const auto crossed = [&](int of) {
          const Scan<D> scan = scan_with(of, own_origins, returned);
          const BeamSensorModel sensor(options);
          const Measurements<D, BeamSensorModel> measurements(
              scan.view(), 4.0, sensor, TypeParam::RefinementType::least_sigma(options));
          return cubes_crossed(geometry, measurements).size();
        };
        EXPECT_EQ(crossed(exponent), crossed(6));
        const std::string error = refusal_by([&] { map.insert(scan_with(exponent, own_origins, returned)); });
        EXPECT_NE(error.find("beam 1"), std::string::npos) << "without a cut: " << error;
      }
    }
}

TEST(Limits, NumbersInErrorsAreShort) {
  AdaptiveMap<2, 2> map;
  Scan<2> scan;
  scan.origins = Vector<2>::Zero();
  scan.endpoints = 1e300 * Vector<2>::Ones();
  const std::string far = refusal_by([&] { map.insert(scan); });
  EXPECT_LT(far.size(), 250u) << far;
  const std::string radius = refusal_by([&] { map.keep_near({0, 0}, -1e300); });
  EXPECT_LT(radius.size(), 100u) << radius;
  const std::string box = refusal_by([&] { map.crop({Vector<2>::Constant(1e300), Vector<2>::Zero()}); });
  EXPECT_LT(box.size(), 150u) << box;
}

TEST(Limits, MemoryOfTheMachineIsTheDefault) {
  MapOptions options;
  EXPECT_EQ(options.memory_limit(), machine_memory() / 4 * 3);
  EXPECT_GT(machine_memory(), std::size_t{1} << 26);
  options.max_memory = std::numeric_limits<double>::infinity();
  EXPECT_EQ(options.memory_limit(), kUnlimitedMemory);
  options.max_memory = 1e6;
  EXPECT_EQ(options.memory_limit(), 1000000u);
  options.max_memory = -1.0;
  EXPECT_THROW(options.validate(), std::invalid_argument);
  const AdaptiveMap<2, 2> empty;
  options.max_memory = static_cast<double>(empty.memory_bytes());
  EXPECT_NO_THROW((AdaptiveMap<2, 2>(options)));
  options.max_memory -= 1.0;
  EXPECT_THROW((AdaptiveMap<2, 2>(options)), std::invalid_argument) << "it is larger while it is empty";
}

TYPED_TEST(Limits, AWishToStopThatComesRightBeforeTheEndLeavesTheMapAsItWas) {
  constexpr int D = TypeParam::kDim;
  using Map = TypeParam;
  Random random(10);
  const MapOptions options = spelled_out_options(0.05, 0.8);
  Map map(options);
  Map other(options);
  Map elsewhere(options);
  Scan<D> far = random_scan<D>(random, 400, 3.0);
  far.origins.array() += 50.0;
  far.endpoints.array() += 50.0;
  for (int i = 0; i < 3; ++i) map.insert(random_scan<D>(random, 400, 3.0));
  other.insert(random_scan<D>(random, 400, 3.0));
  elsewhere.insert(far);
  const Scan<D> scan = random_scan<D>(random, 400, 3.0);
  const Box<D> box{Vector<D>::Constant(-1.0), Vector<D>::Constant(1.5)};
  const Body<D> body{Capsule<D>{Vector<D>::Zero(), Vector<D>::Ones(), 0.6}};
  std::vector<std::pair<std::string, std::function<void(Map&)>>> changes = {
      {"insert", [&](Map& m) { m.insert(scan, kUnlimitedRange, 2); }},
      {"insert in a window", [&](Map& m) { m.insert(scan, kUnlimitedRange, 1, box); }},
      {"merge", [&](Map& m) { m.merge(other); }},
      {"adopt", [&](Map& m) { m.adopt(elsewhere); }},
      {"crop", [&](Map& m) { m.crop(box); }},
      {"clear", [&](Map& m) { m.clear(box); }},
      {"clear of a body", [&](Map& m) { m.clear(body); }},
      {"mark", [&](Map& m) { m.mark(box, CellState::occupied); }},
      {"mark of a body", [&](Map& m) { m.mark(body, {}, CellState::free); }},
      {"keep_near", [&](Map& m) { m.keep_near(Vector<D>::Zero(), 1.0); }},
  };
  if constexpr (std::is_same_v<typename Map::RefinementType, EvidenceRefinement>)
    changes.push_back({"compress", [](Map& m) { m.compress({1e3, {}, {}}); }});
  for (const auto& [name, change] : changes) {
    Map changed = map;
    change(changed);
    EXPECT_TRUE(to_bytes(changed) != to_bytes(map)) << name << " should have something to do";
    // stop() never stops; what is asked in the end does, the last time that it is asked.
    int last = 0;
    {
      Map tried = map;
      const CancelScope scope([] { return false; }, [&] { return ++last < 0; });
      change(tried);
      ASSERT_TRUE(to_bytes(tried) == to_bytes(changed)) << name;
      ASSERT_GE(last, 1) << name;
    }
    Map tried = map;
    int asked = 0;
    {
      const CancelScope scope([] { return false; }, [&] { return ++asked == last; });
      EXPECT_THROW(change(tried), Cancelled) << name;
    }
    ASSERT_TRUE(to_bytes(tried) == to_bytes(map)) << name;
    {
      const CancelScope scope([] { return true; });
      EXPECT_THROW(change(tried), Cancelled) << name;
    }
    ASSERT_TRUE(to_bytes(tried) == to_bytes(map)) << name;
    ASSERT_NO_THROW(tried.check_invariants()) << name;
  }
}

TEST(CancelScopes, AreAskedAtOnceInTheEndAndOnlyNowAndThenBefore) {
  int asked = 0;
  const CancelScope outer([&] { return ++asked < 0; });
  for (int i = 0; i < 5; ++i) last_checkpoint();
  EXPECT_EQ(asked, 5);
  for (int i = 0; i < 5; ++i) checkpoint();
  EXPECT_LE(asked, 6) << "20 ms have hardly gone by";
  asked = -1000000;
  EXPECT_THROW(last_checkpoint(), Cancelled);
}

TEST(CancelScopes, AreAskedFromTheInnermostToTheOutermost) {
  std::atomic<bool> stop{false};
  checkpoint();
  {
    const CancelScope outer([&] { return stop.load(); });
    const CancelScope inner([] { return false; });
    checkpoint();
    stop = true;
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    EXPECT_THROW(checkpoint(), Cancelled);
    EXPECT_THROW(checkpoint(), Cancelled) << "for good";
  }
  EXPECT_NO_THROW(checkpoint());
  const CancelScope failing([]() -> bool { throw std::domain_error("the hook's own"); });
  EXPECT_THROW(checkpoint(), std::domain_error);
}

TEST(CancelScopes, StopAllThreadsOfACall) {
  Workers workers(3);
  std::atomic<int> running{0};
  std::atomic<bool> stop{false};
  const std::thread::id caller = std::this_thread::get_id();
  const CancelScope scope([&] {
    EXPECT_EQ(std::this_thread::get_id(), caller);
    return stop.load();
  });
  // The caller's own task is short: it waits for the others, and asks meanwhile.
  EXPECT_THROW(workers.for_each_task(3,
                                     [&](std::size_t worker, std::size_t) {
                                       ++running;
                                       if (worker == 0) {
                                         stop = true;
                                         return;
                                       }
                                       Pace pace;
                                       for (;;) pace.spend(1000);
                                     }),
               Cancelled);
  EXPECT_GE(running.load(), 1);
}

}  // namespace
}  // namespace ndtree::test
