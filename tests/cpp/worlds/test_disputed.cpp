// SPDX-License-Identifier: BSD-3-Clause
// Where the evidence of a map contradicts itself in time: of single cells, and of worlds with people and
// without.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/logs/simulator.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/disputed.hpp"
#include "options.hpp"

namespace ndtree::test::test_disputed {
namespace {

ScanEvidence scan_of(bool hit, std::uint32_t beams) {
  ScanEvidence scan;
  (hit ? scan.occupied : scan.free) = (hit ? 200 : 104) * static_cast<std::int64_t>(beams);
  (hit ? scan.hits : scan.misses) = scan.beams = beams;
  return scan;
}

TEST(Disputed, ACellIsWhileTwelveScansContradictTwoBeams) {
  MapOptions options = spelled_out_options(0.05, 1.6);
  options.change_probability = 0.0;  // Nothing is forgotten.
  const EvidenceModel model(options, options);
  for (const bool hit : {false, true})
    for (std::uint32_t before = 0; before < 5; ++before)
      for (std::uint32_t after = 0; after < 30; ++after) {
        EvidenceCell cell;
        model.update(cell, scan_of(hit, 3));  // So that a streak can begin.
        for (std::uint32_t i = 0; i < 2; ++i) model.update(cell, scan_of(!hit, 1));
        model.update(cell, scan_of(hit, 1));
        cell.set_counts(hit ? 4 : before, hit ? before : 4);
        for (std::uint32_t i = 1; i < after; ++i) model.update(cell, scan_of(hit, 1));
        EXPECT_EQ(is_disputed(cell), before >= 2 && after >= 12) << hit << " " << before << " " << after;
      }
  EXPECT_FALSE(is_disputed(EvidenceCell{}));
  EXPECT_FALSE(is_disputed(OccupancyCell{}));
}

TEST(Disputed, WhereSomethingStoodForAWhile) {
  AdaptiveMap<2, 2> map;
  EXPECT_FALSE(disputed_fraction(map)) << "nothing was observed";
  const auto scan_to = [](double distance) {
    Scan<2> scan;
    scan.origins = Vector<2>(0.0, 0.0);
    scan.endpoints.resize(2, 200);
    for (int i = 0; i < 200; ++i) {
      const double angle = -0.3 + 0.003 * i;
      scan.endpoints.col(i) = distance * Vector<2>(std::cos(angle), std::sin(angle));
    }
    return scan;
  };
  for (int i = 0; i < 30; ++i) map.insert(scan_to(4.0));
  EXPECT_EQ(disputed_fraction(map), 0.0);
  for (int i = 0; i < 20; ++i) map.insert(scan_to(2.0));
  for (int i = 0; i < 6; ++i) map.insert(scan_to(4.0));
  EXPECT_EQ(disputed_fraction(map), 0.0) << "too few scans say otherwise";
  for (int i = 0; i < 11; ++i) map.insert(scan_to(4.0));
  const std::optional<double> disputed = disputed_fraction(map);
  ASSERT_TRUE(disputed);
  EXPECT_GT(*disputed, 0.0);
  EXPECT_LT(*disputed, 0.002) << "most of what left is forgotten: it is free, and disputes nothing";
  double observed = 0.0;
  double volume = 0.0;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    const Box<2> box = map.tree().box(leaf.index);
    const double area = (box.upper - box.lower).prod();
    observed += leaf.cell().observed() ? area : 0.0;
    volume += leaf.cell().streak() >= 12 && leaf.cell().hits() >= 2 && !leaf.cell().streak_is_of_hits() ? area
                                                                                                        : 0.0;
  });
  EXPECT_NEAR(*disputed, volume / observed, 1e-12);
  FixedMap<2, 2> fixed;
  fixed.insert(scan_to(4.0));
  EXPECT_FALSE(disputed_fraction(fixed)) << "cells count no streaks";
}

double of_office(std::uint64_t seed, std::size_t people, double noise) {
  SimulationOptions simulation;
  simulation.seed = seed;
  simulation.people = people;
  simulation.noise_scale = noise;
  const auto log = simulate_office(simulation);
  MapOptions options;
  options.range_sigma = 0.02;
  AdaptiveMap<2, 2> map(options);
  for (std::size_t i = 0; i < log.size(); ++i) map.insert(log.scan(i), kUnlimitedRange, 1);
  return disputed_fraction(map).value();
}

TEST(Disputed, NearlyNothingOfAWorldThatStandsAndMoreWherePeopleWalk) {
  const double stands = of_office(821, 0, 1.0);
  EXPECT_LT(stands, 0.008);
  EXPECT_LT(of_office(821, 0, 2.0), 0.015) << "twice the noise that the map knows of";
  EXPECT_GT(of_office(821, 6, 1.0), std::max(0.024, 5.0 * stands));
}

}  // namespace
}  // namespace ndtree::test::test_disputed
