// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "ndtree/cell/split_test.hpp"
#include "ndtree/core/log_odds.hpp"
#include "random.hpp"

namespace ndtree::test::test_log_odds {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(LogOdds, KnownValues) {
  struct Row {
    double probability, log_odds;
  };
  const Row rows[] = {{0.5, 0.0},
                      {0.75, 1.0986122886681098},  // ln 3
                      {0.25, -1.0986122886681098},
                      {0.7, 0.8472978603872037},
                      {0.4, -0.4054651081081644},
                      {0.99, 4.595119850134589}};
  for (const Row& row : rows) {
    EXPECT_NEAR(log_odds(row.probability), row.log_odds, 1e-14);
    EXPECT_NEAR(probability(row.log_odds), row.probability, 1e-15);
  }
  EXPECT_EQ(probability(0.0), 0.5);
  EXPECT_EQ(probability(1000.0), 1.0);
  EXPECT_EQ(probability(-1000.0), 0.0);
}

TEST(LogOdds, AreInverseAndAddUpToBayes) {
  Random random(30);
  for (int cases = 0; cases < 2000; ++cases) {
    const double p = random.uniform(1e-6, 1.0 - 1e-6);
    const double q = random.uniform(1e-6, 1.0 - 1e-6);
    ASSERT_NEAR(probability(log_odds(p)), p, 1e-12);
    // The recursive update as the paper prints it (Sec. III).
    const double posterior = 1.0 - 1.0 / (1.0 + p / (1.0 - p) * q / (1.0 - q));
    ASSERT_NEAR(probability(log_odds(p) + log_odds(q)), posterior, 1e-9);
  }
}

TEST(NormalCdf, KnownValues) {
  struct Row {
    double x, cdf;
  };
  const Row rows[] = {{0.0, 0.5},
                      {1.0, 0.8413447460685429},
                      {-1.0, 0.15865525393145707},
                      {1.959963984540054, 0.975},
                      {-3.0, 0.0013498980316300933},
                      {-10.0, 7.61985302416047e-24},
                      {-37.0, 5.725571222524e-300}};
  for (const Row& row : rows) EXPECT_NEAR(normal_cdf(row.x), row.cdf, 1e-11 * row.cdf) << row.x;
  EXPECT_EQ(normal_cdf(kInfinity), 1.0);
  EXPECT_EQ(normal_cdf(-kInfinity), 0.0);
}

TEST(NormalQuantile, InvertsTheDistributionFromTailToTail) {
  int cases = 0;
  for (double exponent = -300.0; exponent < -0.31; exponent += 0.37, ++cases) {
    const double p = std::pow(10.0, exponent);
    const double x = normal_quantile(p);
    ASSERT_LT(x, 0.0) << "p = " << p;
    ASSERT_NEAR(normal_cdf(x) / p, 1.0, 1e-12 * (1.0 + x * x)) << "p = " << p;
  }
  for (double x = -8.0; x <= 8.0; x += 0.03125, ++cases)  // 1 - p loses bits on the upper side.
    ASSERT_NEAR(normal_quantile(normal_cdf(x)), x, 1e-14 + 2e-16 * std::exp(0.5 * x * x)) << "x = " << x;
  for (double p = 0.0009765625; p < 0.5; p += 0.0009765625, ++cases)
    ASSERT_EQ(normal_quantile(1.0 - p), -normal_quantile(p));
  EXPECT_EQ(cases, 810 + 513 + 511);
}

TEST(NormalQuantile, KnownValuesAndEnds) {
  EXPECT_NEAR(normal_quantile(0.5), 0.0, 1e-15);
  EXPECT_NEAR(normal_quantile(0.975), 1.959963984540054, 1e-14);
  EXPECT_NEAR(normal_quantile(0.0025), -2.8070337683438042, 1e-14);
  EXPECT_NEAR(normal_quantile(0.4), -0.2533471031357997, 1e-15);
  EXPECT_EQ(normal_quantile(0.0), -kInfinity);
  EXPECT_EQ(normal_quantile(-1.0), -kInfinity);
  EXPECT_EQ(normal_quantile(1.0), kInfinity);
  EXPECT_EQ(normal_quantile(2.0), kInfinity);
  EXPECT_TRUE(std::isfinite(normal_quantile(std::numeric_limits<double>::min())));
}

constexpr double kCritical95 = 3.841458820694124;
constexpr double kCritical995 = 7.879438576622417;
constexpr double kCritical999 = 10.827566170662733;

/// The paper's formulas term by term (Sec. III-A).
bool reference(double hits, double misses, double miss_given_occupied, double hit_given_free,
               double critical) {
  const double n = hits + misses;
  const double hits_occ = n * (1.0 - miss_given_occupied);
  const double misses_occ = n * miss_given_occupied;
  const double hits_free = n * hit_given_free;
  const double misses_free = n * (1.0 - hit_given_free);
  if (n == 0.0 || misses <= misses_occ || hits <= hits_free) return false;  // Cleaner than expected.
  const double chi_occ = (hits - hits_occ) * (hits - hits_occ) / hits_occ +
                         (misses - misses_occ) * (misses - misses_occ) / misses_occ;
  const double chi_free = (hits - hits_free) * (hits - hits_free) / hits_free +
                          (misses - misses_free) * (misses - misses_free) / misses_free;
  return std::min(chi_occ, chi_free) > critical;
}

TEST(SplitTest, AgreesWithThePapersFormulas) {
  struct Row {
    double miss_given_occupied, hit_given_free, significance, critical;
  };
  const Row rows[] = {{0.05, 0.01, 0.995, kCritical995}, {0.01, 0.05, 0.995, kCritical995},
                      {0.2, 0.1, 0.95, kCritical95},     {0.3, 0.02, 0.999, kCritical999},
                      {0.02, 0.3, 0.999, kCritical999},  {0.5, 0.5, 0.95, kCritical95}};
  for (const Row& row : rows) {
    SplitOptions options;
    options.miss_given_occupied = row.miss_given_occupied;
    options.hit_given_free = row.hit_given_free;
    options.significance = row.significance;
    const ChiSquareSplitTest splits(options);
    EXPECT_NEAR(splits.critical_value(), row.critical, 1e-11 * row.critical);
    int yes = 0;
    for (std::uint32_t hits = 0; hits <= 120; ++hits)
      for (std::uint32_t misses = 0; misses <= 120; ++misses) {
        const bool expected =
            reference(hits, misses, row.miss_given_occupied, row.hit_given_free, row.critical);
        ASSERT_EQ(splits(hits, misses), expected) << hits << " hits, " << misses << " misses";
        OccupancyCell cell;
        cell.set_counts(hits, misses);
        ASSERT_EQ(splits(cell), expected);
        yes += expected;
      }
    EXPECT_EQ(yes > 0, row.miss_given_occupied < 0.5);
  }
}

TEST(ChiSquare, QuantileInvertsTheDistribution) {
  for (double significance = 1.0 / 256; significance < 1.0; significance += 1.0 / 256) {
    const double quantile = chi_square_quantile(significance);
    EXPECT_NEAR(std::erf(std::sqrt(0.5 * quantile)), significance, 1e-13);
  }
}

TEST(ChiSquare, StatisticByHand) {
  struct Row {
    double hits, misses, expected_hits, expected_misses, statistic;
  };
  const Row rows[] = {{5, 5, 5, 5, 0},
                      {7, 3, 5, 5, 1.6},
                      {0, 10, 2, 8, 2.5},
                      {10, 0, 9.5, 0.5, 10.0 / 19.0},
                      {1, 1, 1.9, 0.1, 8.526315789473684}};
  for (const Row& row : rows)
    EXPECT_NEAR(chi_square_statistic(row.hits, row.misses, row.expected_hits, row.expected_misses),
                row.statistic, 1e-13)
        << row.hits << " " << row.misses;
}

}  // namespace
}  // namespace ndtree::test::test_log_odds
