// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

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
  SCOPED_TRACE(random.trace());
  int cases = 0;
  for (; cases < 2000; ++cases) {
    const double p = random.uniform(1e-6, 1.0 - 1e-6);
    const double q = random.uniform(1e-6, 1.0 - 1e-6);
    ASSERT_NEAR(probability(log_odds(p)), p, 1e-12);
    // The recursive update as the paper prints it (Sec. III).
    const double posterior = 1.0 - 1.0 / (1.0 + p / (1.0 - p) * q / (1.0 - q));
    ASSERT_NEAR(probability(log_odds(p) + log_odds(q)), posterior, 1e-9);
  }
  EXPECT_EQ(cases, 2000);
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

}  // namespace
}  // namespace ndtree::test::test_log_odds
