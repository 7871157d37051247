// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "at_a_time.hpp"
#include "ndtree/core/beta.hpp"
#include "random.hpp"

namespace ndtree::test::test_beta {
namespace {

/// log(n!) by adding up, with sixteen more bits than a double.
long double log_factorial(int n) {
  static std::vector<long double> sums{0.0L};
  while (static_cast<int>(sums.size()) <= n)
    sums.push_back(sums.back() + std::log(static_cast<long double>(sums.size())));
  return sums[static_cast<std::size_t>(n)];
}

/// P(at least a of n = a + b - 1 draws): I_x(a, b) for whole a and b.
long double binomial_tail(int a, int b, long double x) {
  const int n = a + b - 1;
  long double sum = 0.0L;
  for (int k = n; k >= a; --k)
    sum += std::exp(log_factorial(n) - log_factorial(k) - log_factorial(n - k) + k * std::log(x) +
                    (n - k) * std::log1p(-x));
  return sum;
}

TEST(LogGamma, IsThatOfTheStandardLibrary) {
  int cases = 0;
  for (double x = 1e-9; x < 1e7; x *= 1.01, ++cases) {
    const double expected = std::lgamma(x);
    ASSERT_NEAR(log_gamma(x), expected, 1e-13 + 1e-14 * std::abs(expected)) << x;
  }
  EXPECT_GT(cases, 3000);
  EXPECT_NEAR(log_gamma(1.0), 0.0, 1e-13);
  EXPECT_NEAR(log_gamma(2.0), 0.0, 1e-13);
  EXPECT_NEAR(log_gamma(6.0), std::log(120.0), 1e-13);
}

TEST(Beta, QuickLogBetaIsLogBeta) {
  int cases = 0;
  for (double a = 1e-6; a < 1e6; a *= 1.3)
    for (double b = 1e-6; b < 1e6; b *= 1.37, ++cases) {
      const double largest = std::max({std::lgamma(a), std::lgamma(b), std::lgamma(a + b)});
      ASSERT_NEAR(quick_log_beta(a, b), log_beta(a, b), 1e-9 + 1e-12 * largest) << a << ", " << b;
    }
  EXPECT_GT(cases, 5000);
}

TEST(Beta, LogBetaIsThatOfFactorials) {
  for (int a = 1; a <= 60; ++a)
    for (int b = 1; b <= 60; ++b) {
      const auto expected =
          static_cast<double>(log_factorial(a - 1) + log_factorial(b - 1) - log_factorial(a + b - 1));
      ASSERT_NEAR(log_beta(a, b), expected, 1e-13 * (1.0 + std::abs(expected))) << a << ", " << b;
    }
  EXPECT_NEAR(log_beta(0.5, 0.5), std::log(std::acos(-1.0)), 1e-14);  // B(1/2, 1/2) = π.
  EXPECT_NEAR(log_beta(0.1, 1.0), std::log(10.0), 1e-14);             // B(a, 1) = 1 / a.
  EXPECT_NEAR(log_beta(5000.0, 5000.0), static_cast<double>(2.0L * log_factorial(4999) - log_factorial(9999)),
              1e-10);
}

TEST(Beta, IncompleteHasItsClosedForms) {
  for (int i = 1; i < 200; ++i) {
    const double x = i / 200.0;
    ASSERT_NEAR(incomplete_beta(1.0, 1.0, x), x, 1e-14);
    // The arcsine law.
    ASSERT_NEAR(incomplete_beta(0.5, 0.5, x), 2.0 / std::acos(-1.0) * std::asin(std::sqrt(x)), 1e-13);
    for (const double c : {0.1, 0.5, 1.5, 2.0, 7.0, 40.0, 333.25}) {
      const double power = std::pow(x, c);
      ASSERT_NEAR(incomplete_beta(c, 1.0, x), power, 1e-12 * power + 1e-16) << c << ", " << x;
      const double rest = -std::expm1(c * std::log1p(-x));
      ASSERT_NEAR(incomplete_beta(1.0, c, x), rest, 1e-12 * rest) << c << ", " << x;
    }
  }
}

TEST(Beta, IncompleteOfWholeNumbersIsABinomialTail) {
  Random random(121);
  int cases = 0;
  for (int a = 1; a <= 12; ++a)
    for (int b = 1; b <= 12; ++b)
      for (const double x : {1e-6, 0.01, 0.05, 0.3, 0.5, 0.77, 0.95, 0.999}) {
        const auto expected = static_cast<double>(binomial_tail(a, b, x));
        ASSERT_NEAR(incomplete_beta(a, b, x), expected, 1e-12 * expected) << a << ", " << b << ", " << x;
        ++cases;
      }
  // Many counts: the logarithms of the factorials have lost digits.
  for (int i = 0; i < 60; ++i, ++cases) {
    const int sum = random.integer(1000, 10000);
    const int a = random.integer(1, sum - 1);
    const double mean = static_cast<double>(a) / sum;
    const double x =
        std::clamp(mean + random.uniform(-5.0, 5.0) * std::sqrt(mean * (1.0 - mean) / sum), 1e-5, 1.0 - 1e-5);
    const auto expected = static_cast<double>(binomial_tail(a, sum - a, x));
    ASSERT_NEAR(incomplete_beta(a, sum - a, x), expected, 1e-10 * expected + 1e-15)
        << a << ", " << sum - a << ", " << x;
  }
  EXPECT_EQ(cases, 12 * 12 * 8 + 60);
}

TEST(Beta, IncompleteIsSymmetricMonotoneAndEndsAt0And1) {
  Random random(122);
  for (int cases = 0; cases < 400; ++cases) {
    const double a = std::exp(random.uniform(-2.0, 9.0));
    const double b = std::exp(random.uniform(-2.0, 9.0));
    EXPECT_EQ(incomplete_beta(a, b, 0.0), 0.0);
    EXPECT_EQ(incomplete_beta(a, b, 1.0), 1.0);
    EXPECT_EQ(incomplete_beta(a, b, -0.5), 0.0);
    EXPECT_EQ(incomplete_beta(a, b, 1.5), 1.0);
    const double mean = a / (a + b);
    const double deviation = std::sqrt(mean * (1.0 - mean) / (a + b + 1.0));
    double before = 0.0;
    for (int i = -12; i <= 12; ++i) {
      const double x = std::clamp(mean + 0.5 * i * deviation, 0.0, 1.0);
      const double value = incomplete_beta(a, b, x);
      ASSERT_GE(value, before - 1e-14) << a << ", " << b << ", " << x;
      ASSERT_LE(value, 1.0 + 1e-14);
      const double from_above = 1.0 - incomplete_beta(b, a, 1.0 - x);
      ASSERT_NEAR(value, from_above, 1e-10) << a << ", " << b << ", " << x;
      before = value;
    }
  }
}

TEST(QuickIncompleteBeta, IsNearlyTheExactOne) {
  Random random(127);
  for (const double x : {0.01, 0.05, 0.2, 0.5, 0.9}) {
    const QuickIncompleteBeta quick(x);
    for (int i = 0; i < 2000; ++i) {
      const double a = 1.0 + random.integer(0, random.chance(0.5) ? 20 : 1000);
      const double b = 1.0 + random.integer(0, random.chance(0.5) ? 20 : 1000);
      const double exact = incomplete_beta(a, b, x);
      ASSERT_NEAR(quick(a, b), exact, 1e-7 * exact + 1e-14) << a << ", " << b << ", " << x;
    }
  }
}

TEST(RateComparison, IsTheSameFourCellsAtATime) {
  Random random(128);
  for (int i = 0; i < 2000; ++i) {
    const double prior = random.chance(0.5) ? 0.1 : 1.0;
    const auto n = static_cast<std::size_t>(random.integer(1, 13));
    std::vector<double> hits;
    std::vector<double> misses;
    for (std::size_t k = 0; k < n; ++k) {
      hits.push_back(random.chance(0.3) ? 0.0 : random.uniform(0.0, random.chance(0.5) ? 8.0 : 300.0));
      misses.push_back(random.chance(0.3) ? 0.0 : random.uniform(0.0, random.chance(0.5) ? 8.0 : 300.0));
    }
    std::vector<double> bits;
    for (const int width : {1, 8}) {
      const AtATime loops(width);
      RateComparison rates(prior);
      rates.add(hits.data(), misses.data(), n);
      bits.push_back(rates.bits_for_many());
    }
    RateComparison one_by_one(prior);
    for (std::size_t k = 0; k < n; ++k) one_by_one.add(hits[k], misses[k]);
    ASSERT_EQ(bits[0], bits[1]) << "to the last bit";
    ASSERT_EQ(bits[0], one_by_one.bits_for_many());
  }
}

/// What EvidenceMergeRule relies on.
TEST(RateComparison, OneRateIsLikelierWhereNothingWasHit) {
  Random random(129);
  for (int i = 0; i < 2000; ++i) {
    RateComparison rates(0.1);
    for (int cell = random.integer(1, 9); cell > 0; --cell)
      rates.add(0.0, random.chance(0.2) ? 0.0 : random.uniform(0.0, 300.0));
    ASSERT_LE(rates.bits_for_many(), 1e-9);
  }
}

/// The probability of each beam, given those before, is a share of the counts so far: Pólya's urn.
TEST(RateComparison, IsThatOfSequencesOfBeams) {
  Random random(125);
  int one = 0;
  for (const double prior : {0.1, 1.0})
    for (int i = 0; i < 2000; ++i) {
      const auto log_probability = [&](int hits, int misses) {
        double sum = 0.0;
        for (int k = 0; k < hits; ++k) sum += std::log((prior + k) / (prior + 1.0 + k));
        for (int k = 0; k < misses; ++k) sum += std::log((1.0 + k) / (prior + 1.0 + hits + k));
        return sum;
      };
      RateComparison rates(prior);
      int hits = 0;
      int misses = 0;
      double apart = 0.0;
      for (int cell = random.integer(1, 9); cell > 0; --cell) {
        const int h = random.integer(0, 20);
        const int m = random.integer(0, random.chance(0.5) ? 3 : 60);
        rates.add(h, m);
        apart += log_probability(h, m);
        hits += h;
        misses += m;
      }
      ASSERT_NEAR(rates.bits_for_many(), (apart - log_probability(hits, misses)) / std::log(2.0), 1e-9);
      one += rates.bits_for_many() < 0.0;
    }
  EXPECT_GT(one, 500);
  EXPECT_LT(one, 3500);
}

}  // namespace
}  // namespace ndtree::test::test_beta
