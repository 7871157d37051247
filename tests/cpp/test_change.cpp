// SPDX-License-Identifier: BSD-3-Clause
// A world that changes: which cells follow it, how soon, and which are left as they are.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test::test_change {
namespace {

MapOptions options_with(double change_probability, double half_life = 0.0) {
  MapOptions options = spelled_out_options(0.05, 1.6);
  options.change_probability = change_probability;
  options.evidence_half_life = half_life;
  return options;
}

ScanEvidence hits(std::uint32_t n) {
  ScanEvidence scan;
  scan.occupied = 200 * n;
  scan.hits = scan.beams = n;
  return scan;
}
ScanEvidence passes(std::uint32_t n) {
  ScanEvidence scan;
  scan.free = 104 * n;
  scan.misses = scan.beams = n;
  return scan;
}

/// Scans until the cell has the state, or 1000.
int scans_until(const EvidenceModel& model, EvidenceCell cell, const ScanEvidence& scan, CellState state) {
  int n = 0;
  for (; n < 1000 && cell.state() != state; ++n) model.update(cell, scan);
  return n;
}

TEST(Change, AStreakIsOfScansThatAllSayTheSame) {
  const MapOptions options = options_with(0.0);
  const EvidenceModel model(options, options);
  EvidenceCell cell;
  const auto expect_streak = [&](const ScanEvidence& scan, std::uint32_t length, bool of_hits) {
    model.update(cell, scan);
    EXPECT_EQ(cell.streak(), length);
    if (length > 0) {
      EXPECT_EQ(cell.streak_is_of_hits(), of_hits);
    }
    EXPECT_EQ(EvidenceCell::from_words(cell.words()), cell);
  };
  expect_streak(passes(3), 0, false);  // There is no hit that passes could contradict.
  expect_streak(passes(1), 0, false);
  expect_streak(hits(1), 1, true);
  expect_streak(hits(5), 2, true);
  ScanEvidence both = hits(5);
  both.misses = 1;
  expect_streak(both, 0, false);
  expect_streak(passes(1), 1, false);
  ScanEvidence nothing;
  nothing.free = 10;
  expect_streak(nothing, 1, false);
  for (std::uint32_t n = 2; n < 40; ++n) expect_streak(passes(1), std::min(n, 31u), false);
  EXPECT_EQ(cell.hits(), 11u);
  EXPECT_EQ(cell.misses(), 44u);
}

TEST(Change, ALongStreakOutweighsOldEvidenceAndAShortOneDoesNot) {
  struct Row {
    const char* what;
    std::uint32_t hits_before, passes_before;
    bool hit;
    int least, most;  // Scans until the cell has followed.
  };
  const Row rows[] = {{"a wall is gone", 500, 0, false, 12, 12},
                      {"a wall with some passes is gone", 300, 100, false, 12, 12},
                      {"half of the beams always passed", 200, 200, false, 13, 25},
                      {"a door closes", 0, 500, true, 12, 12},
                      {"little was known", 3, 0, false, 3, 11},
                      {"it stood for five scans of three beams", 15, 0, false, 3, 5}};
  const MapOptions options = options_with(1e-5);
  const EvidenceModel model(options, options);
  const MapOptions never_options = options_with(0.0);
  const EvidenceModel never(never_options, never_options);
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    EvidenceCell cell;
    // The other kind came first, so that the streak begins with what follows.
    model.update(cell, row.hit ? hits(row.hits_before) : passes(row.passes_before));
    model.update(cell, row.hit ? passes(row.passes_before) : hits(row.hits_before));
    const ScanEvidence now = row.hit ? hits(1) : passes(1);
    const CellState then = row.hit ? CellState::occupied : CellState::free;
    ASSERT_NE(cell.state(), then);
    const int scans = scans_until(model, cell, now, then);
    EXPECT_GE(scans, row.least);
    EXPECT_LE(scans, row.most);
    if (scans >= 12) {
      EXPECT_GT(scans_until(never, cell, now, then), 5 * scans) << "without the rule";
    }
  }
}

TEST(Change, PassesThatDoNotLookEmptyAreNoStreak) {
  const MapOptions options = options_with(1e-5);
  const EvidenceModel model(options, options);
  EvidenceCell cell;
  model.update(cell, hits(100));
  for (std::uint32_t i = 0; i < 40; ++i) {
    model.update_passed(cell, passes(1), false);
    ASSERT_EQ(cell.streak(), 1u) << "of the hits";
    ASSERT_TRUE(cell.streak_is_of_hits());
  }
  ASSERT_EQ(cell.state(), CellState::occupied);
  ASSERT_EQ(cell.misses(), 40u);
  for (std::uint32_t i = 1; i <= 11; ++i) {
    model.update_passed(cell, passes(3), true);
    ASSERT_EQ(cell.streak(), i);
    ASSERT_EQ(cell.misses(), 42u + i) << "of a streak, each scan but the first counts once";
  }
  EXPECT_EQ(cell.state(), CellState::occupied);
}

TEST(Change, ACellThatIsHitAndPassedIsNoChange) {
  const MapOptions options = options_with(1e-5);
  const MapOptions never_options = options_with(0.0);
  const EvidenceModel model(options, options);
  const EvidenceModel never(never_options, never_options);
  Random random(210);
  EvidenceCell cell;
  EvidenceCell expected;
  for (int i = 0; i < 5000; ++i) {  // Of a hundred beams, seventy end: no streak is long enough.
    const ScanEvidence scan = random.chance(0.7) ? hits(1) : passes(1);
    model.update(cell, scan);
    never.update(expected, scan);
    ASSERT_EQ(cell, expected) << i;
  }
  EXPECT_EQ(cell.state(), CellState::occupied);
}

TEST(Change, EvidenceHalvesInItsHalfLifeWhereBeamsComeAndNowhereElse) {
  const MapOptions options = options_with(0.0, 10.0);
  const EvidenceModel model(options, options);
  EvidenceCell cell;
  model.update(cell, hits(100));
  const auto before = static_cast<double>(cell.occupied_evidence());
  for (int i = 0; i < 10; ++i) model.update(cell, passes(1));
  EXPECT_NEAR(static_cast<double>(cell.occupied_evidence()), 0.5 * before, 12.0);
  EXPECT_NEAR(static_cast<double>(cell.free_evidence()), 104.0 * 0.5 / (1.0 - std::exp2(-0.1)), 12.0);

  // In a map: what no beam meets stays as it is, observed or not.
  AdaptiveMap<2, 2> map(options);
  const auto beam = [](double y, double length) {
    Scan<2> scan;
    scan.origins = Vector<2>(0.1, y);
    scan.endpoints = Vector<2>(0.1 + length, y);
    return scan;
  };
  for (int i = 0; i < 5; ++i) map.insert(beam(0.12, 3.0));
  for (int i = 0; i < 5; ++i) map.insert(beam(4.12, 3.0));
  const auto evidence = [&](double x, double y) {
    return map.tree().find_leaf(Vector<2>(x, y))->cell().words();
  };
  const auto other = evidence(3.1, 4.12);
  const auto here = evidence(3.1, 0.12);
  for (int i = 0; i < 50; ++i) map.insert(beam(0.12, 3.0));
  EXPECT_EQ(evidence(3.1, 4.12), other);
  EXPECT_NE(evidence(3.1, 0.12), here);
  EXPECT_EQ(state(map, Vector<2>(2.0, 2.5)), CellState::unknown);
}

/// A corridor seen by a robot with a laser that looks all around: a door at its end, a person in it.
class Corridor {
 public:
  explicit Corridor(std::uint64_t seed) : random_(seed) {}

  /// @param robot where along the corridor. @param person where, or below 0 for none.
  Scan<2> scan(double robot, bool door_is_closed, double person) {
    Scan<2> scan;
    scan.origins = Vector<2>(robot, 0.03);
    scan.endpoints.resize(2, 360);
    for (int k = 0; k < 360; ++k) {
      const Vector<2> d(std::cos(k * kDegree), std::sin(k * kDegree));
      double range = 1e9;
      const auto meet = [&](double distance) {
        if (distance > 1e-6) range = std::min(range, distance);
      };
      if (d.y() != 0.0) meet(((d.y() > 0.0 ? 1.03 : -1.03) - 0.03) / d.y());
      if (d.x() != 0.0) meet(((d.x() > 0.0 ? (door_is_closed ? 6.03 : 10.03) : -2.03) - robot) / d.x());
      const Vector<2> to_person(person - robot, 0.17);
      const double along = to_person.dot(d);
      const double chord = along * along - to_person.squaredNorm() + 0.25 * 0.25;
      if (person > 0.0 && chord > 0.0) meet(along - std::sqrt(chord));
      const double noise = random_.normal();
      scan.endpoints.col(k) = scan.origins.col(0) + (range + 0.02 * noise) * d;
    }
    return scan;
  }

 private:
  static constexpr double kDegree = 0.017453292519943295;
  Random random_;
};

std::size_t num_occupied(const AdaptiveMap<2, 2>& map, double x_min, double x_max, double y_min,
                         double y_max) {
  std::size_t n = 0;
  for (double x = x_min; x < x_max; x += 0.05)
    for (double y = y_min; y < y_max; y += 0.05) n += state(map, Vector<2>(x, y)) == CellState::occupied;
  return n;
}

TEST(Change, AWallMeasuredFromAPoseThatIsALittleWrongStays) {
  // What stands right behind the cells of a wall may be that wall.
  for (const double behind : {0.1, 1.0}) {
    SCOPED_TRACE(behind);
    AdaptiveMap<2, 2> map(options_with(1e-5));
    const auto wall = [](double x) {
      Scan<2> scan;
      scan.origins = Vector<2>(0.02, 0.03);
      scan.endpoints.resize(2, 81);
      for (int i = 0; i < 81; ++i) scan.endpoints.col(i) = Vector<2>(x, 0.01 * (i - 40));
      return scan;
    };
    for (int i = 0; i < 20; ++i) map.insert(wall(2.02));
    const std::size_t before = num_occupied(map, 2.0, 2.05, -0.3, 0.3);
    ASSERT_GE(before, 10u);
    for (int i = 0; i < 20; ++i) map.insert(wall(2.02 + behind));
    const std::size_t left = num_occupied(map, 2.0, 2.05, -0.3, 0.3);
    if (behind < 0.15)
      EXPECT_EQ(left, before);
    else
      EXPECT_EQ(left, 0u);
  }
}

TEST(Change, WalkingPeopleLeaveNoGhostsAndDoNotShatterTheMap) {
  AdaptiveMap<2, 2> map(options_with(1e-5));
  Corridor corridor(211);
  for (int i = 0; i < 60; ++i) map.insert(corridor.scan(1.0 + 0.005 * i, true, -1.0));
  const std::size_t before = map.stats().observed_leaves;
  for (int walk = 0; walk < 3; ++walk) {
    for (int i = 0; i < 30; ++i) map.insert(corridor.scan(1.3, true, 5.5 - 0.1 * i));
    EXPECT_GT(num_occupied(map, 2.3, 3.2, -0.1, 0.5), 0u) << "the person is there now";
    for (int i = 0; i < 50; ++i) map.insert(corridor.scan(1.3, true, -1.0));
    EXPECT_EQ(num_occupied(map, 1.8, 5.7, -0.7, 0.7), 0u) << "and gone";
    EXPECT_LT(static_cast<double>(map.stats().observed_leaves), 1.1 * static_cast<double>(before));
  }
  // Walls and door are still there.
  const auto door = cast_ray(map, Vector<2>(1.3, 0.03), Vector<2>(1.0, 0.02), 20.0, RayAim::cell);
  ASSERT_TRUE(door);
  EXPECT_NEAR(*door, 4.73, 0.1);
}

TEST(Change, ADoorThatOpensAndClosesIsSeenSoon) {
  struct Row {
    double change_probability;
    int open_least, open_most, closed_least, closed_most;
  };
  for (const Row& row : {Row{1e-5, 5, 20, 1, 20}, Row{0.0, 60, 1000, 1, 1000}}) {
    SCOPED_TRACE(row.change_probability);
    AdaptiveMap<2, 2> map(options_with(row.change_probability));
    Corridor corridor(212);
    // Three degrees off, so that the beam goes between the others.
    const auto seen_at = [&] {
      const auto distance =
          cast_ray(map, Vector<2>(1.75, 0.03), Vector<2>(1.0, std::tan(0.0524)), 20.0, RayAim::cell);
      return distance ? 1.75 + *distance : 100.0;
    };
    const auto scans_until_seen = [&](bool closed) {
      int n = 0;
      for (; n < 300 && (std::abs(seen_at() - (closed ? 6.03 : 10.03)) > 0.15); ++n)
        map.insert(corridor.scan(1.75, closed, -1.0));
      return n;
    };
    for (int i = 0; i < 150; ++i) map.insert(corridor.scan(1.0 + 0.005 * i, true, -1.0));
    ASSERT_EQ(scans_until_seen(true), 0);
    const int open = scans_until_seen(false);
    EXPECT_GE(open, row.open_least);
    EXPECT_LE(open, row.open_most);
    for (int i = 0; i < 150; ++i) map.insert(corridor.scan(1.75, false, -1.0));
    const int closed = scans_until_seen(true);
    EXPECT_GE(closed, row.closed_least);
    EXPECT_LE(closed, row.closed_most);
  }
}

}  // namespace
}  // namespace ndtree::test::test_change
