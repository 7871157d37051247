// SPDX-License-Identifier: BSD-3-Clause
// The fraction of beams that end in a cell, and its bounds: by numerical integration of the posterior.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "ndtree/cell/hit_rate.hpp"
#include "random.hpp"

namespace ndtree::test::test_hit_rate {
namespace {

/// P(fraction < x) for Beta(a, b), by the midpoint rule on both sides of the middle, from the borders there.
/// Where the density has a pole, in t^a or (1 - t)^b, which takes it away.
double below(double a, double b, double x) {
  constexpr int kSteps = 8000;
  const auto lower_part = [](double p, double q, double end) {  // Integral of t^(p-1) (1-t)^(q-1) to end.
    const double power = std::min(p, 1.0);
    const double top = std::pow(end, power);
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      const double t = std::pow(top * (i + 0.5) / kSteps, 1.0 / power);
      sum += std::pow(t, p - power) * std::pow(1.0 - t, q - 1.0);
    }
    return sum * top / kSteps / power;
  };
  const double left = lower_part(a, b, std::min(x, 0.5)) + (x > 0.5 ? lower_part(b, a, 0.5) : 0.0) -
                      (x > 0.5 ? lower_part(b, a, 1.0 - x) : 0.0);
  return left / (lower_part(a, b, 0.5) + lower_part(b, a, 0.5));
}

TEST(HitRate, QuantilesAreThoseOfThePosterior) {
  Random random(90);
  for (int cases = 0; cases < 60; ++cases) {
    const double hits = cases % 4 == 0 ? 0.0 : random.uniform(0.0, 200.0);
    const double misses = cases % 4 == 1 ? 0.0 : random.uniform(0.0, 200.0);
    const double prior_hits = random.uniform(0.1, 1.0);
    const double prior_misses = random.uniform(0.1, 1.0);
    const double most = random.uniform(0.6, 1.0);
    const HitRate rate(most, hits, misses, prior_hits, prior_misses);
    EXPECT_DOUBLE_EQ(rate.beams(), hits + misses);
    EXPECT_NEAR(rate.mean(), most * (hits + prior_hits) / (hits + misses + prior_hits + prior_misses), 1e-15);
    double last = 0.0;
    for (const double probability : {0.025, 0.25, 0.5, 0.75, 0.975}) {
      const double quantile = rate.quantile(probability);
      EXPECT_GE(quantile, last);
      EXPECT_LE(quantile, most);
      last = quantile;
      if (quantile < 1e-6 || quantile > most * (1.0 - 1e-6)) continue;  // Within its tolerance of a border.
      EXPECT_NEAR(below(hits / 8.0 + prior_hits, misses / 8.0 + prior_misses, quantile / most), probability,
                  2e-3)
          << hits << " hits, " << misses << " misses";
    }
  }
}

TEST(HitRate, BeamsNarrowTheBounds) {
  const auto width = [](double beams) {
    const HitRate rate(0.85, 0.5 * beams, 0.5 * beams, 0.14, 0.82);
    return rate.quantile(0.975) - rate.quantile(0.025);
  };
  EXPECT_GT(width(8.0), width(32.0));
  EXPECT_NEAR(width(1600.0) / width(6400.0), 2.0, 0.02);
}

TEST(HitRate, OfCellsWithoutCountsItRisesFromLowerThanTheirOdds) {
  // Where evidence is even, few beams end: most cells that a beam reaches are free.
  EXPECT_NEAR(HitRateModel::mean_of(0.0), 0.04, 0.02);
  EXPECT_LT(HitRateModel::mean_of(-4.6), 1e-3);
  EXPECT_GT(HitRateModel::mean_of(5.9), 0.95);
  for (double log_odds = -5.0; log_odds < 5.0; log_odds += 0.25)
    EXPECT_LT(HitRateModel::mean_of(log_odds), HitRateModel::mean_of(log_odds + 0.25));
}

TEST(HitRate, CellsAreReadInBeams) {
  SensorOptions sensor;
  sensor.probability_min = 0.3;
  sensor.probability_max = 0.8;
  const HitRateModel model(sensor);
  const double hit = std::log(0.8 / 0.2);
  const double miss = std::log(0.7 / 0.3);
  EvidenceCell cell;
  cell.set_evidence(std::llround(6.0 * hit * 256.0), std::llround(10.0 * miss * 256.0), 0.0f);
  EXPECT_NEAR(model(cell, 1.0).beams(), 1.25 * 6.0 + 10.0, 0.02);
  for (const double size : {1.0, 2.0, 8.0})  // Beside larger cells, fewer beams end.
    EXPECT_NEAR(model(cell, size).mean(), (1.0 - 0.2 / size) * (7.5 + 0.14) / (17.5 + 0.96), 1e-3);
  OccupancyCell counted;
  counted.set_counts(6, 10);
  EXPECT_NEAR(model(counted, 1.0).beams(), 17.5, 1e-12);
  EXPECT_NEAR(model(counted, 1.0).mean(), 0.85 * 7.516 / 17.526, 1e-12);
  EXPECT_LT(HitRateModel::mean_of(-2.0), HitRateModel::mean_of(3.5));
}

}  // namespace
}  // namespace ndtree::test::test_hit_rate
