// SPDX-License-Identifier: BSD-3-Clause
// The OctoMap baseline: what it counts, and that it says what our fixed map says.

#ifdef NDTREE_HAVE_OCTOMAP

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/core/log_odds.hpp"
#include "ndtree/evaluation/calibration.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "octomap_baseline.hpp"

namespace ndtree::test::test_octomap_baseline {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

template <int D>
Scan<D> beam(const Vector<D>& origin, const Vector<D>& endpoint, bool returned = true) {
  Scan<D> scan;
  scan.origins = origin;
  scan.endpoints = endpoint;
  scan.returned.setConstant(1, returned);
  return scan;
}

/// Beams from two places to the walls of a room and to a thing in it, and a few that do not return.
template <int D>
std::vector<Scan<D>> room(std::uint64_t seed, int beams) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Scan<D>> scans(2);
  for (std::size_t s = 0; s < scans.size(); ++s) {
    Scan<D>& scan = scans[s];
    scan.origins = Vector<D>::Constant(s == 0 ? 0.013 : -0.777);
    scan.endpoints.resize(D, beams);
    scan.returned.resize(beams);
    for (Eigen::Index i = 0; i < beams; ++i) {
      Vector<D> direction;
      for (int a = 0; a < D; ++a) direction[a] = normal(random);
      direction.normalize();
      const double range = direction[0] > 0.9 ? 2.0 : 3.5;
      scan.endpoints.col(i) = scan.origins.col(0) + range * direction;
      scan.returned[i] = i % 7 != 0;
    }
  }
  return scans;
}

struct CountCase {
  const char* what;
  Vector<3> endpoint;
  bool returned;
  double max_range;
  std::uint64_t updates, free_cells, occupied_cells;
};

// Cells of 10 cm, beams from (0.05, 0.05, 0.05).
const CountCase kCountCases[] = {
    {"along x", {1.05, 0.05, 0.05}, true, kUnlimitedRange, 11, 10, 1},
    {"against y", {0.05, -0.95, 0.05}, true, kUnlimitedRange, 11, 10, 1},
    {"along z, no return", {0.05, 0.05, 1.05}, false, kUnlimitedRange, 10, 10, 0},
    {"along x, from too far", {1.05, 0.05, 0.05}, true, 0.5, 5, 5, 0},
    {"as long as max_range", {1.05, 0.05, 0.05}, true, 1.0, 11, 10, 1},
    {"no return, from too far", {1.05, 0.05, 0.05}, false, 0.5, 5, 5, 0},
    {"within the cell of the origin", {0.08, 0.05, 0.05}, true, kUnlimitedRange, 1, 0, 1},
    {"no return within the cell of the origin", {0.08, 0.05, 0.05}, false, kUnlimitedRange, 0, 0, 0},
};

TEST(OctomapBaseline, CountsTheCellsThatABeamTouches) {
  for (const OctomapInsertion how : {OctomapInsertion::beam_by_beam, OctomapInsertion::scan_at_once,
                                     OctomapInsertion::scan_at_once_lazy, OctomapInsertion::scan_discretized})
    for (const CountCase& c : kCountCases) {
      SCOPED_TRACE(c.what);
      OctomapBaseline map(0.1, {}, how);
      const InsertReport report =
          map.insert(beam<3>(Vector<3>::Constant(0.05), c.endpoint, c.returned), c.max_range);
      EXPECT_EQ(report.beams, 1u);
      EXPECT_EQ(report.returned + report.not_returned + report.beyond_max_range, 1u);
      EXPECT_EQ(report.returned, c.occupied_cells);
      EXPECT_EQ(report.updates, c.updates);
      EXPECT_EQ(map.stats().updates, c.updates);
      const OctomapLeaves leaves = map.leaves();
      EXPECT_EQ((leaves.log_odds.array() < 0.0f).count(), static_cast<Eigen::Index>(c.free_cells));
      EXPECT_EQ((leaves.log_odds.array() > 0.0f).count(), static_cast<Eigen::Index>(c.occupied_cells));
    }
}

TEST(OctomapBaseline, AScanAtOnceUpdatesACellOnce) {
  Scan<3> scan;
  scan.origins = Vector<3>::Constant(0.05);
  scan.endpoints.resize(3, 4);
  scan.endpoints << 1.05, 1.06, 0.55, 1.55, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05;
  scan.returned.resize(4);
  scan.returned << true, true, true, false;
  OctomapBaseline by_beam(0.1);
  OctomapBaseline at_once(0.1, {}, OctomapInsertion::scan_at_once);
  EXPECT_EQ(by_beam.insert(scan).updates, 11u + 11u + 6u + 15u);
  EXPECT_EQ(at_once.insert(scan).updates, 15u);
  // The cell with a hit is passed by three other beams: it stays occupied.
  const Vector<3> hit(0.55, 0.05, 0.05);
  const auto occupied = static_cast<float>(log_odds(MapOptions{}.probability_max));
  const auto free = static_cast<float>(log_odds(MapOptions{}.probability_min));
  EXPECT_FLOAT_EQ(at_once.log_odds(hit).value(), occupied);
  EXPECT_FLOAT_EQ(by_beam.log_odds(hit).value(), occupied + 3.0f * free);
}

template <int D>
void expect_equal_to_fixed_map(int beams, std::size_t least) {
  constexpr std::uint64_t kSeed = 11;
  MapOptions options;
  options.range_sigma = 0.005;
  options.min_cell_size = 0.1;
  options.log_odds_min = -50.0;  // The sums of all updates are compared, not their bounds.
  OctomapBaseline octomap(options.min_cell_size, options);
  FixedMap<2, D> fixed(options);
  const std::vector<Scan<D>> scans = room<D>(kSeed, beams);
  for (const Scan<D>& scan : scans) {
    const InsertReport a = octomap.insert(scan, 3.0);
    const InsertReport b = fixed.insert(scan, 3.0);
    EXPECT_EQ(a.returned, b.returned);
    EXPECT_EQ(a.not_returned, b.not_returned);
    EXPECT_EQ(a.beyond_max_range, b.beyond_max_range);
    EXPECT_NEAR(static_cast<double>(a.updates), static_cast<double>(b.updates),
                0.05 * static_cast<double>(b.updates));
  }
  // Cells that no returned beam ends in or next to: there both have counted the beams that pass.
  const OctomapLeaves leaves = octomap.leaves();
  std::size_t compared = 0;
  std::size_t equal = 0;
  for (Eigen::Index i = 0; i < leaves.size.size(); ++i) {
    const Vector<3> center = leaves.lower.col(i).array() + 0.5 * leaves.size[i];
    const Vector<D> point = center.head<D>();
    if (leaves.size[i] > 0.11) continue;
    double nearest = HUGE_VAL;
    for (const Scan<D>& scan : scans)
      for (Eigen::Index k = 0; k < scan.size(); ++k) {
        const Vector<D> d = scan.endpoints.col(k) - scan.origins.col(0);
        nearest = std::min(nearest, (scan.endpoints.col(k) - point).norm());
        nearest = std::min(nearest, (scan.origins.col(0) + d * (3.0 / d.norm()) - point).norm());
      }
    if (nearest < 0.25) continue;
    ++compared;
    EXPECT_EQ(state(fixed, point), CellState::free);
    EXPECT_EQ(state(octomap, point), CellState::free);
    equal += std::abs(leaves.log_odds[i] - cell_at(fixed, point).log_odds()) < 1e-3f;
  }
  EXPECT_GE(compared, least);
  // OctoMap's float coordinates may lead a beam past the other side of an edge.
  EXPECT_GE(static_cast<double>(equal), 0.99 * static_cast<double>(compared));
}

TEST(OctomapBaseline, AgreesWithTheFixedMap) {
  expect_equal_to_fixed_map<2>(300, 1000);
  expect_equal_to_fixed_map<3>(100, 1500);
}

TEST(OctomapBaseline, QueriesAgreeWithTheFixedMap) {
  constexpr std::uint64_t kSeed = 12;
  MapOptions options;
  options.range_sigma = 1e-6;  // Nothing behind the end points, as in OctoMap.
  options.min_cell_size = 0.1;
  OctomapBaseline octomap(options.min_cell_size, options);
  FixedMap<2, 3> fixed(options);
  for (const Scan<3>& scan : room<3>(kSeed, 2000)) {
    octomap.insert(scan);
    fixed.insert(scan);
  }
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> place(-4.0, 4.0);
  const auto anywhere = [&] { return Vector<3>(place(random), place(random), place(random)); };
  int states = 0;
  int near = 0;
  int casts = 0;
  int found = 0;
  constexpr int kQuestions = 2000;
  for (int i = 0; i < kQuestions; ++i) {
    const Vector<3> point = anywhere();
    states += state(octomap, point) == state(fixed, point);
    near += occupied_within(octomap, point, 0.3) == occupied_within(fixed, point, 0.3);
    const Vector<3> direction = anywhere();
    const auto a = cast_ray(octomap, point, direction, 6.0, RayAim::cell);
    const auto b = cast_ray(fixed, point, direction, 6.0, RayAim::cell);
    casts += a.has_value() == b.has_value() && (!a || std::abs(*a - *b) < 1e-4);
    found += b.has_value();
  }
  EXPECT_GE(states, 0.99 * kQuestions);
  EXPECT_GE(near, 0.99 * kQuestions);
  EXPECT_GE(casts, 0.99 * kQuestions);
  EXPECT_GT(found, kQuestions / 10);
  EXPECT_LT(found, kQuestions);
}

TEST(OctomapBaseline, PrunesWhatExpandsToTheSameCells) {
  // A block of 4 x 4 x 4 cells in one node of level 2, each hit until its log-odds are at their upper bound.
  OctomapBaseline pruning(0.1);
  OctomapBaseline lazy(0.1, {}, OctomapInsertion::scan_at_once_lazy);
  for (int repetition = 0; repetition < 10; ++repetition)
    for (int i = 0; i < 64; ++i) {
      const Vector<3> cell(0.05 + 0.1 * (i % 4), 0.05 + 0.1 * (i / 4 % 4), 0.05 + 0.1 * (i / 16));
      const auto scan = beam<3>(cell + Vector<3>(0.01, 0.0, 0.0), cell);
      pruning.insert(scan);
      lazy.insert(scan);
    }
  for (const OctomapBaseline* map : {&pruning, &lazy}) {
    EXPECT_EQ(map->stats().leaves_expanded, 64u);
    EXPECT_EQ(map->stats().leaves_pruned, 1u);
    EXPECT_EQ(map->stats().updates, 640u);
  }
  EXPECT_EQ(pruning.stats().leaves, 1u);
  EXPECT_EQ(lazy.stats().leaves, 64u);
  EXPECT_EQ(lazy.stats().nodes, 64u + 8u + 15u) << "16 levels above the cells, with 8 nodes in the lowest";
  EXPECT_LT(pruning.stats().memory_bytes, lazy.stats().memory_bytes);
  const OctomapLeaves leaves = pruning.leaves();
  ASSERT_EQ(leaves.size.size(), 1);
  EXPECT_DOUBLE_EQ(leaves.size[0], 0.4);
  EXPECT_EQ(Vector<3>(leaves.lower.col(0)), Vector<3>::Zero());
  EXPECT_FLOAT_EQ(leaves.log_odds[0], 3.5f);
}

TEST(OctomapBaseline, EvidenceStaysWithinItsBounds) {
  MapOptions options;
  options.log_odds_min = -1.25;
  options.log_odds_max = 0.75;
  OctomapBaseline map(0.1, options);
  for (int i = 0; i < 20; ++i) map.insert(beam<2>({0.05, 0.05}, {1.05, 0.05}));
  EXPECT_EQ(map.log_odds({1.05, 0.05, 0.0}), 0.75f);
  EXPECT_EQ(map.log_odds({0.55, 0.05, 0.0}), -1.25f);
  EXPECT_DOUBLE_EQ(probability(map, Vector<2>(0.55, 0.05)), probability(-1.25));
  // Where it balances, it is unknown.
  options.probability_max = 0.6;
  options.probability_min = 0.4;
  OctomapBaseline balanced(0.1, options);
  balanced.insert(beam<2>({0.05, 0.05}, {0.55, 0.05}));
  balanced.insert(beam<2>({0.05, 0.05}, {1.05, 0.05}));
  ASSERT_EQ(balanced.log_odds({0.55, 0.05, 0.0}), 0.0f);
  EXPECT_EQ(state(balanced, Vector<2>(0.55, 0.05)), CellState::unknown);
  EXPECT_NEAR(cast_ray(balanced, Vector<2>(0.05, 0.05), Vector<2>(1.0, 0.0), 5.0, RayAim::cell).value(), 0.95,
              1e-6);
}

TEST(OctomapBaseline, CellsOfARayAreThoseAtItsPoints) {
  constexpr std::uint64_t kSeed = 13;
  OctomapBaseline map(0.1);
  for (const Scan<3>& scan : room<3>(kSeed, 2000)) map.insert(scan);
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> place(-4.0, 4.0);
  std::uniform_real_distribution<double> part(0.05, 0.95);
  const auto anywhere = [&] { return Vector<3>(place(random), place(random), place(random)); };
  int cells = 0;
  int known = 0;
  int surfaces = 0;
  for (int i = 0; i < 300; ++i) {
    const Vector<3> origin = anywhere();
    const Vector<3> unit = anywhere().normalized();
    double last = 0.7;
    map.for_each_cell(origin, unit, 0.7, [&](float log_odds, double enter, double exit) {
      EXPECT_EQ(enter, last);
      EXPECT_GT(exit, enter);
      EXPECT_LE(exit - enter, 0.1 * std::sqrt(3.0) + 1e-9);
      const Vector<3> point = origin + (enter + part(random) * (exit - enter)) * unit;
      if (exit - enter > 1e-4) {  // Else the point is too near to other cells.
        EXPECT_EQ(map.log_odds(point).value_or(0.0f), log_odds);
      }
      last = exit;
      ++cells;
      known += log_odds != 0.0f;
      return exit < 3.0;
    });
    EXPECT_GE(last, 3.0);
    const auto entry = cast_ray(map, origin, unit, 6.0, RayAim::cell);
    const auto surface = cast_ray(map, origin, unit, 6.0, RayAim::surface);
    ASSERT_EQ(surface.has_value(), entry.has_value());
    if (!surface) continue;
    ++surfaces;
    double left = 1.0;  // Of the beams, in steps of a tenth of a millimetre.
    double half = *entry + 0.075;
    map.for_each_cell(origin, unit, *entry, [&](float log_odds, double enter, double exit) {
      const double rate = log_odds == 0.0f ? 0.0 : HitRateModel::mean_of(static_cast<double>(log_odds));
      for (double d = enter; d < exit && left > 0.5; d += 1e-4) {
        left *= std::pow(1.0 - rate, std::min(1e-4, exit - d) / (exit - enter));
        if (left <= 0.5) half = std::min(half, d);
      }
      return left > 0.5 && exit < *entry + 0.075;
    });
    EXPECT_NEAR(*surface, half, 2e-4);
  }
  EXPECT_GT(cells, 3000);
  EXPECT_GT(known, 300);
  EXPECT_GT(surfaces, 30);
}

TEST(OctomapBaseline, CalibrationAsksEachCellUpToTheEnd) {
  OctomapBaseline map(0.1);
  const Scan<2> scan = beam<2>({0.05, 0.05}, {1.05, 0.05});
  map.insert(scan);
  Calibration calibration;
  calibrate(map, scan.view(), kUnlimitedRange, calibration);
  std::uint64_t pairs = 0;
  std::uint64_t ends = 0;
  for (const auto& [group, bins] : calibration.groups) {
    EXPECT_EQ(std::get<1>(group), 0.1);
    EXPECT_EQ(std::get<2>(group), -1);
    for (const auto& bin : bins) {
      pairs += bin.pairs;
      ends += bin.ends;
    }
  }
  EXPECT_EQ(pairs, 11u);
  EXPECT_EQ(ends, 1u);
  EXPECT_EQ(calibration.ends_at_unknown, 0u);
}

TEST(OctomapBaseline, NearnessCountsTheBorderIn) {
  OctomapBaseline map(0.5);
  map.insert(beam<2>({-2.25, 0.25}, {0.25, 0.25}));  // Occupied: [0, 0.5).
  EXPECT_TRUE(occupied_within(map, Vector<2>(0.25, 0.25), 0.0));
  EXPECT_TRUE(occupied_within(map, Vector<2>(0.75, 0.25), 0.25));
  EXPECT_FALSE(occupied_within(map, Vector<2>(0.75, 0.25), 0.24));
  EXPECT_TRUE(occupied_within(map, Vector<2>(-0.25, 0.25), 0.25));
  EXPECT_FALSE(occupied_within(map, Vector<2>(-0.25, 0.25), 0.24));
  EXPECT_FALSE(occupied_within(map, Vector<2>(0.75, 0.75), 0.35)) << "the corner is farther";
  EXPECT_TRUE(occupied_within(map, Vector<2>(1e6, 0.25), 2e6));
  EXPECT_FALSE(occupied_within(map, Vector<2>(kNan, 0.25), 1.0));
  EXPECT_FALSE(occupied_within(OctomapBaseline(0.5), Vector<2>(0.0, 0.0), 1.0));
}

TEST(OctomapBaseline, SaysNothingOutsideAndPrintsNothing) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  OctomapBaseline map(0.1);
  for (int pass = 0; pass < 2; ++pass) {
    for (const Vector<3>& point :
         {Vector<3>(1e9, 0.0, 0.0), Vector<3>(0.0, -1e300, 0.0), Vector<3>(0.0, 0.0, kNan)}) {
      EXPECT_EQ(state(map, point), CellState::unknown);
      EXPECT_EQ(probability(map, point), 0.5);
      EXPECT_FALSE(occupied_within(map, point, 1.0));
    }
    EXPECT_EQ(cast_ray(map, Vector<3>(3000.0, 0.0, 0.0), Vector<3>(1.0, 1.0, 1.0), kUnlimitedRange),
              std::nullopt);
    EXPECT_THROW(map.insert(beam<3>({0.0, 0.0, 0.0}, {4000.0, 0.0, 0.0})), std::invalid_argument);
    EXPECT_THROW(map.insert(beam<3>(Vector<3>::Constant(-3270.0), Vector<3>::Constant(3270.0))),
                 std::invalid_argument);
    map.insert(beam<3>({0.05, 0.05, 0.05}, {1.05, 0.05, 0.05}));
  }
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  EXPECT_EQ(map.stats().updates, 22u) << "scans that throw change nothing";
}

TEST(OctomapBaseline, InvalidBeamsAreCounted) {
  Scan<2> scan;
  scan.origins = Vector<2>(0.05, 0.05);
  scan.endpoints.resize(2, 4);
  scan.endpoints << 1.05, kNan, 0.05, HUGE_VAL, 0.05, 0.05, 0.05, 0.05;
  for (const OctomapInsertion how : {OctomapInsertion::beam_by_beam, OctomapInsertion::scan_at_once}) {
    OctomapBaseline map(0.1, {}, how);
    const InsertReport report = map.insert(scan);
    EXPECT_EQ(report.beams, 4u);
    EXPECT_EQ(report.returned, 1u);
    EXPECT_EQ(report.invalid, 3u);
    EXPECT_EQ(report.updates, 11u);
  }
}

TEST(OctomapBaseline, MistakesAreNamed) {
  const Scan<2> scan = beam<2>({0.0, 0.0}, {1.0, 0.0});
  EXPECT_THROW(OctomapBaseline(0.0), std::invalid_argument);
  MapOptions options;
  options.probability_max = 1.0;
  EXPECT_THROW(OctomapBaseline(0.1, options), std::invalid_argument);
  OctomapBaseline map(0.1);
  EXPECT_THROW(map.insert(scan, 0.0), std::invalid_argument);
  EXPECT_THROW(map.insert(beam<2>({kNan, 0.0}, {1.0, 0.0})), std::invalid_argument);
  Scan<2> two;
  two.origins.resize(2, 2);
  two.origins << 0.0, 1.0, 0.0, 0.0;
  two.endpoints.resize(2, 2);
  two.endpoints << 1.0, 2.0, 1.0, 1.0;
  EXPECT_EQ(map.insert(two).returned, 2u);
  OctomapBaseline at_once(0.1, {}, OctomapInsertion::scan_at_once);
  EXPECT_THROW(at_once.insert(two), std::invalid_argument);
}

TEST(OctomapBaseline, SavedAndLoadedIsTheSame) {
  MapOptions options;
  options.log_odds_max = 2.25;
  for (const bool filled : {false, true}) {
    OctomapBaseline map(0.1, options, OctomapInsertion::scan_at_once);
    if (filled)
      for (const Scan<3>& scan : room<3>(3, 300)) map.insert(scan);
    std::stringstream stream;
    map.save(stream);
    const OctomapBaseline loaded = OctomapBaseline::load(stream);
    EXPECT_EQ(loaded.cell_size(), 0.1);
    EXPECT_EQ(loaded.options().log_odds_max, 2.25);
    EXPECT_EQ(loaded.insertion(), OctomapInsertion::scan_at_once);
    EXPECT_EQ(loaded.stats().updates, map.stats().updates);
    EXPECT_EQ(loaded.leaves().lower, map.leaves().lower);
    EXPECT_EQ(loaded.leaves().log_odds, map.leaves().log_odds);
    std::stringstream again;
    loaded.save(again);
    EXPECT_EQ(again.str(), stream.str());
  }
}

TEST(OctomapBaseline, DamagedStreamsThrow) {
  OctomapBaseline map(0.1);
  map.insert(beam<2>({0.05, 0.05}, {1.05, 0.05}));
  std::stringstream stream;
  map.save(stream);
  const std::string bytes = stream.str();
  int damaged = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    std::string wrong = bytes;
    wrong[i] = static_cast<char>(wrong[i] ^ 0x10);
    std::istringstream changed(wrong);
    EXPECT_THROW(static_cast<void>(OctomapBaseline::load(changed)), std::runtime_error) << "byte " << i;
    std::istringstream cut(bytes.substr(0, i));
    EXPECT_THROW(static_cast<void>(OctomapBaseline::load(cut)), std::runtime_error) << i << " bytes";
    ++damaged;
  }
  EXPECT_GT(damaged, 100);
}

}  // namespace
}  // namespace ndtree::test::test_octomap_baseline

#endif  // NDTREE_HAVE_OCTOMAP
