// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>

#include "ndtree/cell/evidence_model.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test::test_evidence_model {
namespace {

MapOptions options_with(double memory, double prior = 0.5, double inherited_beams = 3.0) {
  MapOptions options = spelled_out_options(0.05, 1.6);
  options.evidence_memory = memory;
  options.free_memory = memory;
  options.evidence_prior = prior;
  options.inherited_beams = inherited_beams;
  return options;
}

EvidenceModel model_with(double memory, double prior = 0.5, double inherited_beams = 3.0) {
  const MapOptions options = options_with(memory, prior, inherited_beams);
  return EvidenceModel(options, options);
}

// log(0.6 / 0.4) = 0.405465, of probability_min = 0.4, in units of 1/256.
constexpr std::int64_t kMiss = 104;

TEST(EvidenceModel, LogOddsAreTheRatioWithinItsBounds) {
  Random random(140);
  int low = 0;
  int high = 0;
  for (const double prior : {0.01, 0.5, 4.0}) {
    const EvidenceModel model = model_with(200.0, prior);
    for (int i = 0; i < 5000; ++i) {
      const auto occupied = static_cast<std::int64_t>(std::exp(random.uniform(0.0, 11.0)) - 1.0);
      const auto free = random.chance(0.1)
                            ? occupied
                            : static_cast<std::int64_t>(std::exp(random.uniform(0.0, 11.0)) - 1.0);
      const float value = model.log_odds_of(occupied, free);
      const double ratio =
          (static_cast<double>(occupied) / 256.0 + prior) / (static_cast<double>(free) / 256.0 + prior);
      ASSERT_NEAR(value, std::min(std::max(std::log(ratio), -2.0), 3.5), 1e-6) << occupied << ", " << free;
      ASSERT_EQ(value > 0.0f, occupied > free);
      ASSERT_EQ(value < 0.0f, occupied < free);
      ASSERT_GE(model.log_odds_of(occupied + 1, free), value);
      ASSERT_LE(model.log_odds_of(occupied, free + 1), value);
      low += value == -2.0f;
      high += value == 3.5f;
    }
  }
  EXPECT_GT(low, 100);
  EXPECT_GT(high, 100);
  // The smallest difference of the largest sums is still told.
  const EvidenceModel model = model_with(255.0, 4.0);
  EXPECT_GT(model.log_odds_of(0xffff, 0xfffe), 0.0f);
  EXPECT_LT(model.log_odds_of(0xfffe, 0xffff), 0.0f);
  EXPECT_EQ(model.log_odds_of(0xffff, 0xffff), 0.0f);
}

TEST(EvidenceModel, MoreEvidenceHasTheLargerLogarithm) {
  for (const double prior : {1e-6, 0.01, 0.5, 4.0, 1e6}) {  // [nats]
    const double units = prior / EvidenceCell::kUnit;
    const std::shared_ptr<const EvidenceLogs> logs = EvidenceLogs::of_prior(units);
    EXPECT_EQ(logs, EvidenceLogs::of_prior(units)) << "one for all models of a prior";
    const double last = std::log(EvidenceCell::kMaxEvidence + units);
    for (std::int64_t evidence = 0; evidence <= EvidenceCell::kMaxEvidence; ++evidence) {
      if (evidence > 0) {
        ASSERT_GT((*logs)[evidence], (*logs)[evidence - 1]) << evidence << ", " << prior;
      }
      const double difference = last - std::log(static_cast<double>(evidence) + units);
      ASSERT_NEAR((*logs)[EvidenceCell::kMaxEvidence] - (*logs)[evidence], difference, 2e-6)
          << evidence << ", " << prior;
    }
  }
}

TEST(EvidenceModel, LogOddsOfAFileThatAreNotThoseOfItsEvidenceAreAChange) {
  const EvidenceModel model = model_with(20.0);
  for (const std::int64_t occupied : {0, 400}) {
    EvidenceCell cell;
    ScanEvidence scan;
    scan.occupied = occupied;
    scan.free = 1000 * kMiss;
    scan.misses = 1000;
    while (model.update(cell, scan)) scan.occupied = 0;  // Until it remembers no more.
    const auto words = cell.words();
    EvidenceCell other;
    other.set_evidence(cell.occupied_evidence(), cell.free_evidence(), 1.0f);
    auto of_file = other.words();
    of_file[0] = words[0];
    EvidenceCell read = EvidenceCell::from_words(of_file);
    ASSERT_TRUE(read.has_same_evidence(cell));
    EXPECT_TRUE(model.update(read, scan)) << "what lies above is summed up anew";
    EXPECT_TRUE(read == cell);
  }
}

TEST(EvidenceModel, BeamsWeighWhatTheSensorModelSays) {
  const EvidenceModel model = model_with(200.0);
  EXPECT_EQ(model.miss_evidence(), kMiss);
  for (const float sigmas : {0.6f, 0.25f, 0.001f}) {  // In edges of the cell.
    ScanEvidence sum;
    std::int64_t occupied = 0;
    std::int64_t free = 0;
    for (int i = -200; i <= 200; ++i) {
      const auto log_odds = static_cast<float>(0.01 * i);
      BeamWeight::add(sum, BeamWeight::units_of(log_odds, BeamWeight::probability_inside_table()(sigmas)));
      const double weight = BeamWeight::probability_inside(1.0 / static_cast<double>(sigmas));
      if (i > 0) occupied += std::lrint(256.0 * weight * static_cast<double>(log_odds));
      if (i < 0) free += std::lrint(-256.0 * static_cast<double>(log_odds));
      ASSERT_EQ(sum.occupied, occupied) << log_odds;
      ASSERT_EQ(sum.free, free) << log_odds;
    }
    EXPECT_EQ(sum.hits + sum.misses + sum.beams, 0u) << "counts are not its business";
  }
  // A beam that passed, and a beam near its end that says the same.
  ScanEvidence near;
  BeamWeight::add(near, BeamWeight::units_of(static_cast<float>(std::log(0.4 / 0.6)), 0.3f));
  EXPECT_EQ(near.free, model.miss_evidence());
}

TEST(EvidenceModel, TheMeanChordOfACube) {
  EXPECT_DOUBLE_EQ(mean_chord_of_unit_cube(1), 1.0);
  EXPECT_DOUBLE_EQ(mean_chord_of_unit_cube(2), std::acos(-1.0) / 4.0);
  EXPECT_DOUBLE_EQ(mean_chord_of_unit_cube(3), 2.0 / 3.0);
}

TEST(EvidenceModel, ProbabilityInsideIsTheMeanOverPlaces) {
  double last = 0.0;
  for (double u = 0.25; u < 40.0; u *= 1.3) {
    constexpr int kPieces = 20000;
    double sum = 0.0;
    for (int i = 0; i < kPieces; ++i) {
      const double x =
          u * (i + 0.5) / kPieces;  // Measured there; the surface is x too near to u - x too far.
      sum += 0.5 * (std::erfc(-(u - x) / std::sqrt(2.0)) - std::erfc(x / std::sqrt(2.0)));
    }
    const double inside = BeamWeight::probability_inside(u);
    ASSERT_NEAR(inside, sum / kPieces, 1e-7) << u;
    ASSERT_GT(inside, last);
    ASSERT_LT(inside, 1.0);
    last = inside;
  }
}

TEST(EvidenceModel, FadingKeepsTheRatio) {
  Random random(141);
  int faded = 0;
  for (int cases = 0; cases < 20000; ++cases) {
    const double memory = random.uniform(1.0, 255.0);
    const std::int64_t limit = std::llround(256.0 * memory);
    const EvidenceModel model = model_with(memory);
    const auto occupied = static_cast<std::int64_t>(std::exp(random.uniform(0.0, 14.0)) - 1.0);
    const auto free = static_cast<std::int64_t>(std::exp(random.uniform(0.0, 14.0)) - 1.0);
    EvidenceCell cell;
    cell.set_counts(3, 4);
    model.assign(cell, occupied, free);
    ASSERT_TRUE(cell.observed());
    ASSERT_EQ(cell.hits(), 3u);
    ASSERT_EQ(cell.misses(), 4u);
    const std::int64_t kept_occupied = cell.occupied_evidence();
    const std::int64_t kept_free = cell.free_evidence();
    ASSERT_EQ(cell.log_odds(), model.log_odds_of(kept_occupied, kept_free));
    if (occupied + free <= limit) {
      ASSERT_EQ(kept_occupied, occupied);
      ASSERT_EQ(kept_free, free);
      continue;
    }
    ++faded;
    const double scale = static_cast<double>(limit) / static_cast<double>(occupied + free);
    ASSERT_LE(kept_occupied + kept_free, limit + 1);  // Each is rounded for itself.
    ASSERT_NEAR(static_cast<double>(kept_occupied), scale * static_cast<double>(occupied) - 0.5, 0.5 + 1e-9);
    ASSERT_NEAR(static_cast<double>(kept_free), scale * static_cast<double>(free) - 0.5, 0.5 + 1e-9);
    ASSERT_LE(kept_occupied, EvidenceCell::kMaxEvidence);
    ASSERT_LE(kept_free, EvidenceCell::kMaxEvidence);
  }
  EXPECT_GT(faded, 5000);
  // Cells come closer to what they are told lately: a free cell is occupied after as much of the other.
  const EvidenceModel model = model_with(10.0);
  EvidenceCell cell;
  model.assign(cell, 0, 1000000);
  EXPECT_EQ(cell.free_evidence(), 2560);
  model.assign(cell, 2570, cell.free_evidence());
  EXPECT_EQ(cell.state(), CellState::occupied);
}

TEST(EvidenceModel, AScanAddsUpHoweverItIsDivided) {
  Random random(142);
  const EvidenceModel model = model_with(200.0);
  for (int cases = 0; cases < 500; ++cases) {
    ScanEvidence whole;
    EvidenceCell in_parts;
    const int parts = random.integer(1, 12);
    for (int i = 0; i < parts; ++i) {
      ScanEvidence part;
      part.occupied = random.integer(0, 2000);
      part.free = random.integer(0, 2000);
      part.hits = static_cast<std::uint32_t>(random.integer(0, 42));
      part.misses = static_cast<std::uint32_t>(random.integer(0, 42));
      model.update(in_parts, part);
      whole.occupied += part.occupied;
      whole.free += part.free;
      whole.hits += part.hits;
      whole.misses += part.misses;
    }
    EvidenceCell at_once;
    model.update(at_once, whole);
    ASSERT_EQ(in_parts.occupied_evidence(), whole.occupied);
    ASSERT_EQ(in_parts.free_evidence(), whole.free);
    ASSERT_EQ(in_parts.hits(), whole.hits);
    ASSERT_EQ(in_parts.misses(), whole.misses);
    ASSERT_EQ(in_parts.log_odds(), at_once.log_odds());
    ASSERT_EQ(at_once.occupied_evidence(), whole.occupied);
    ASSERT_EQ(at_once.free_evidence(), whole.free);
    ASSERT_EQ(at_once.hits(), whole.hits);
    ASSERT_EQ(at_once.misses(), whole.misses);
    ASSERT_EQ(at_once.log_odds(), model.log_odds_of(whole.occupied, whole.free));
  }
  // What a cell can hold at most, and more.
  EvidenceCell cell;
  ScanEvidence much;
  much.occupied = std::int64_t{1} << 40;
  much.free = std::int64_t{1} << 40;
  much.hits = much.misses = 1u << 30;
  for (int i = 0; i < 3; ++i) model.update(cell, much);
  EXPECT_EQ(cell.occupied_evidence(), 25600);
  EXPECT_EQ(cell.free_evidence(), 25600);
  EXPECT_EQ(cell.hits(), cell.misses());
}

TEST(EvidenceModel, OfOneScanOnlySoManyPassesCount) {
  MapOptions options = options_with(200.0);
  options.scan_beams = 16.0;
  const EvidenceModel model(options, options);
  struct Row {
    std::uint32_t hits, misses;
    std::int64_t occupied, free;
    std::uint32_t kept_misses;
    std::int64_t kept_free;
  };
  const Row rows[] = {{0, 15, 0, 15 * kMiss, 15, 15 * kMiss},
                      {0, 16, 0, 16 * kMiss, 16, 16 * kMiss},
                      {0, 900, 0, 900 * kMiss, 16, 16 * kMiss},
                      {0, 900, 0, 40, 16, 40},  // Many corners.
                      {0, 3, 0, 40 * kMiss, 3, 16 * kMiss},
                      {1, 900, 0, 900 * kMiss, 900, 900 * kMiss},   // With hits, all count ...
                      {0, 900, 1, 900 * kMiss, 900, 900 * kMiss}};  // With the evidence of a surface near by.
  for (const Row& row : rows) {
    ScanEvidence scan;
    scan.hits = row.hits;
    scan.misses = row.misses;
    scan.occupied = row.occupied;
    scan.free = row.free;
    scan.beams = row.hits + row.misses;
    model.limit(scan);
    EXPECT_EQ(scan.misses, row.kept_misses);
    EXPECT_EQ(scan.free, row.kept_free);
    EXPECT_EQ(scan.hits, row.hits);
    EXPECT_EQ(scan.occupied, row.occupied);
    EXPECT_EQ(scan.beams, row.hits + row.kept_misses);
  }
}

TEST(EvidenceModel, ASaturatedCellIsOneThatPassesLeaveAsItIs) {
  Random random(145);
  int saturated = 0;
  for (const double free_memory : {1.0, 20.0, 200.0, 255.0})
    for (const double half_life : {0.0, 5.0}) {
      MapOptions options = options_with(200.0);
      options.free_memory = free_memory;
      options.evidence_half_life = half_life;
      const EvidenceModel model(options, options);
      EvidenceCell cell;
      ScanEvidence hit;
      hit.hits = hit.beams = 1;
      hit.occupied = 217;
      model.update(cell, hit);
      for (int i = 0; i < 3000; ++i) {
        ScanEvidence passed;
        passed.misses = passed.beams = static_cast<std::uint32_t>(random.integer(1, 16));
        passed.free = kMiss * passed.misses + random.integer(-50, 50);
        const EvidenceCell before = cell;
        model.update(cell, passed);
        ASSERT_TRUE(!model.is_saturated(before) || cell == before);
        ASSERT_FALSE(cell == before && !model.is_saturated(before) && half_life == 0.0 && i > 2900);
        saturated += model.is_saturated(cell);
      }
      EXPECT_EQ(model.is_saturated(cell), half_life == 0.0);
      if (half_life > 0.0) continue;
      EXPECT_EQ(cell.free_evidence(), std::llround(256.0 * std::min(free_memory, 200.0)));
      EXPECT_EQ(cell.hits(), 0u);
      model.update(cell, hit);
      EXPECT_FALSE(model.is_saturated(cell));
    }
  EXPECT_GT(saturated, 4000);
}

TEST(EvidenceModel, ChildrenStartWithTheirPart) {
  Random random(143);
  int none = 0;
  for (const int divisor : {1, 2, 3, 5, 9, 8})
    for (const double inherited_beams : {0.0, 3.0, 50.0}) {
      const EvidenceModel model = model_with(200.0, 0.5, inherited_beams);
      EXPECT_EQ(model.initial_child(EvidenceCell{}, divisor, 3, 5), EvidenceCell{}) << "of nothing, nothing";
      for (int i = 0; i < 300; ++i) {
        EvidenceCell parent;
        parent.set_counts(static_cast<std::uint32_t>(random.integer(0, 511)),
                          static_cast<std::uint32_t>(random.integer(0, 511)));
        model.assign(parent, random.integer(0, random.chance(0.5) ? 500 : 25000), random.integer(0, 25000));
        const int beams = random.integer(1, 40);
        const int passed = random.integer(0, beams);
        const EvidenceCell child = model.initial_child(parent, divisor, static_cast<std::size_t>(passed),
                                                       static_cast<std::size_t>(beams));
        const double share =
            0.05 / divisor + 0.95 * (passed + inherited_beams / divisor) / (beams + inherited_beams);
        const double free = share * static_cast<double>(parent.free_evidence());
        if (parent.state() != CellState::occupied && free < static_cast<double>(kMiss) - 1e-6) {
          ASSERT_EQ(child, EvidenceCell{});
          ++none;
          continue;
        }
        ASSERT_TRUE(child.observed());
        ASSERT_NEAR(static_cast<double>(child.free_evidence()), free - 0.5, 0.5 + 1e-6);
        const bool of_occupied = parent.state() == CellState::occupied;
        const double share_of_hits = of_occupied ? 1.0 / divisor : std::min(1.0 / divisor, share);
        ASSERT_NEAR(static_cast<double>(child.occupied_evidence()),
                    share_of_hits * static_cast<double>(parent.occupied_evidence()) - 0.5, 0.5 + 1e-6);
        if (parent.state() == CellState::free) {
          ASSERT_NE(child.state(), CellState::occupied);
        }
        ASSERT_EQ(child.log_odds(), model.log_odds_of(child.occupied_evidence(), child.free_evidence()));
        const bool counts_anew = parent.state() == CellState::free;
        ASSERT_NEAR(child.hits(), counts_anew ? 0.0 : share_of_hits * parent.hits() - 0.5, 0.5 + 1e-6);
        ASSERT_NEAR(child.misses(), counts_anew ? 0.0 : share * parent.misses() - 0.5, 0.5 + 1e-6);
      }
    }
  EXPECT_GT(none, 50);
}

/// A cell with evidence, and the evidence of one scan for it.
struct CellAndScan {
  EvidenceCell cell;
  ScanEvidence scan;
};
CellAndScan random_cell_and_scan(Random& random, const EvidenceModel& model) {
  CellAndScan both;
  both.cell.set_counts(static_cast<std::uint32_t>(random.integer(0, 200)),
                       static_cast<std::uint32_t>(random.integer(0, 200)));
  const bool is_free = random.chance(0.5);
  model.assign(both.cell, random.integer(0, is_free ? 4000 : 30000),
               random.integer(0, is_free ? 30000 : 6000));
  ScanEvidence& scan = both.scan;
  scan.hits = static_cast<std::uint32_t>(random.integer(0, 4));
  scan.misses = static_cast<std::uint32_t>(random.integer(scan.hits == 0 ? 1 : 0, 8));
  scan.beams = scan.hits + scan.misses;
  scan.occupied = random.integer(0, 220) * static_cast<std::int64_t>(scan.hits);
  scan.free = model.miss_evidence() * static_cast<std::int64_t>(scan.misses);
  return both;
}

/// Calls `visit(cell, scan, children_across)` for many cells of a state. @returns for how many.
template <class Visit>
int for_each_cell_and_scan(Random& random, const EvidenceModel& model, CellState state, const Visit& visit) {
  int cases = 0;
  for (const int divisor : {2, 3, 4})
    for (int i = 0; i < 4000; ++i) {
      const CellAndScan both = random_cell_and_scan(random, model);
      if (both.cell.state() != state) continue;
      ++cases;
      visit(both.cell, both.scan, divisor);
    }
  return cases;
}

TEST(EvidenceModel, OccupiedCellsArePredictedToRemergeUnlessAChildMayBeFree) {
  Random random(152);
  const EvidenceModel model = model_with(200.0, 0.5, 2.0);
  int predicted_remerges = 0;
  const int cases = for_each_cell_and_scan(
      random, model, CellState::occupied,
      [&](const EvidenceCell& cell, const ScanEvidence& scan, int divisor) {
        if (!model.predicted_to_remerge(cell, scan, divisor)) return;
        ++predicted_remerges;
        EXPECT_LE(model.effective_misses(cell), 12.0);
        // All that passed may have passed one child, and nothing ended there.
        EvidenceCell child = model.initial_child(cell, divisor, scan.misses, scan.beams);
        ASSERT_TRUE(child.observed());
        ScanEvidence passed;
        passed.misses = passed.beams = scan.misses;
        passed.free = 2 * scan.free;
        model.update(child, passed);
        ASSERT_EQ(child.state(), CellState::occupied);
      });
  EXPECT_GT(cases, 3000);
  EXPECT_GT(predicted_remerges, cases / 10);
  EXPECT_LT(predicted_remerges, cases / 2);
  EXPECT_FALSE(model.predicted_to_remerge(EvidenceCell{}, ScanEvidence{}, 2)) << "nothing is known of it";
  for_each_cell_and_scan(random, model, CellState::free,
                         [&](const EvidenceCell& cell, const ScanEvidence& scan, int divisor) {
                           ASSERT_FALSE(model.predicted_to_remerge(cell, scan, divisor));
                         });
}

TEST(EvidenceModel, WhatAnUndoneSplitLeavesIsLessOfWhatWasKnown) {
  Random random(153);
  for (const double half_life : {0.0, 20.0})
    for (int i = 0; i < 3000; ++i) {
      EvidenceOptions evidence;
      evidence.evidence_half_life = half_life;
      const EvidenceModel model(evidence, SensorOptions{});
      const auto [before, scan] = random_cell_and_scan(random, model);
      EvidenceCell cell = before;
      for (int k = 0; k < 3; ++k) cell.count_scan(true, false);
      const double scans_kept = half_life > 0.0 ? std::exp2(-1.0 / half_life) : 1.0;
      const double beams = scan.beams;
      const double kept = scans_kept * (0.05 + 0.95 * (beams - 0.75 * scan.hits + 2.0) / (beams + 2.0));
      const double occupied =
          scans_kept * static_cast<double>(cell.occupied_evidence()) + static_cast<double>(scan.occupied);
      const double free = kept * static_cast<double>(cell.free_evidence()) + static_cast<double>(scan.free);
      model.update_without_split(cell, scan);
      const double limit = 256.0 * (occupied == 0.0 ? 50.0 : 200.0);
      const double faded = std::min(1.0, limit / (occupied + free));
      ASSERT_NEAR(static_cast<double>(cell.occupied_evidence()), faded * occupied, 2.0);
      ASSERT_NEAR(static_cast<double>(cell.free_evidence()), faded * free, 2.0);
      ASSERT_EQ(cell.log_odds(), model.log_odds_of(cell.occupied_evidence(), cell.free_evidence()));
      ASSERT_EQ(cell.streak(), 0u);
      if (cell.occupied_evidence() > 0) {
        ASSERT_NEAR(cell.hits(), scans_kept * before.hits() + scan.hits + 0.5, 0.5 + 1e-6);
        ASSERT_NEAR(cell.misses(), kept * before.misses() + scan.misses + 0.5, 0.5 + 1e-6);
      }
    }
}

TEST(EvidenceModel, EffectiveBeamsAreThoseThatWereAdded) {
  const EvidenceModel model = model_with(200.0);
  const auto hit = static_cast<float>(std::log(0.7 / 0.3));
  constexpr float kInside = 1.0f;  // In a cell large beside the noise, the surface is certainly.
  for (int hits = 0; hits <= 30; ++hits)
    for (int misses = 0; misses <= 60; misses += 3) {
      ScanEvidence scan;
      for (int i = 0; i < hits; ++i) BeamWeight::add(scan, BeamWeight::units_of(hit, kInside));
      scan.free = misses * model.miss_evidence();
      EvidenceCell cell;
      model.update(cell, scan);
      ASSERT_NEAR(model.effective_hits(cell), hits, 3e-3 * hits);  // Units are rounded.
      ASSERT_EQ(model.effective_misses(cell), misses);
    }
}

}  // namespace
}  // namespace ndtree::test::test_evidence_model
