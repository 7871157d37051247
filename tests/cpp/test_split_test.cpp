// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include "ndtree/cell/split_test.hpp"
#include "options.hpp"

namespace ndtree::test::test_split_test {
namespace {

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
  int cases = 0;
  for (const Row& row : rows) {
    SplitOptions options;
    options.miss_given_occupied = row.miss_given_occupied;
    options.hit_given_free = row.hit_given_free;
    options.significance = row.significance;
    const ChiSquareSplitTest splits(options);
    EXPECT_NEAR(splits.critical_value(), row.critical, 1e-11 * row.critical);
    int yes = 0;
    for (std::uint32_t hits = 0; hits <= 120; ++hits)
      for (std::uint32_t misses = 0; misses <= 120; ++misses, ++cases) {
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
  EXPECT_EQ(cases, 6 * 121 * 121);
}

TEST(ChiSquare, QuantileInvertsTheDistribution) {
  int cases = 0;
  for (double significance = 1.0 / 256; significance < 1.0; significance += 1.0 / 256, ++cases) {
    const double quantile = chi_square_quantile(significance);
    EXPECT_NEAR(std::erf(std::sqrt(0.5 * quantile)), significance, 1e-13);
  }
  EXPECT_EQ(cases, 255);
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
}  // namespace ndtree::test::test_split_test
