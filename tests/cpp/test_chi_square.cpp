// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>

#include "ndtree/core/chi_square.hpp"

namespace ndtree::test::test_chi_square {
namespace {

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
}  // namespace ndtree::test::test_chi_square
