// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"
#include "support/random.hpp"

namespace ndtree::test::test_quick_log {
namespace {

constexpr int kNumbers = 200'000;

double some_number(Random& random, int i) {
  const double m = 1.0 + random.uniform();
  if (i % 3 == 0) return 1.0 + (m - 1.5) * 1e-3;  // Near 1, where the logarithm changes its sign.
  return std::ldexp(m, random.integer(-1000, 1000));
}

TEST(QuickLog, IsWithin1em12) {
  Random random(1);
  SCOPED_TRACE(random.trace());
  EXPECT_EQ(quick_log(1.0), 0.0);
  for (const double x : {0.5, 2.0, 1.0 + 0x1p-8, 1.0 - 0x1p-9, 1.999999999, 1.00390625})
    EXPECT_NEAR(quick_log(x), std::log(x), 1e-12) << x;
  for (int i = 0; i < kNumbers; ++i) {
    const double x = some_number(random, i);
    ASSERT_NEAR(quick_log(x), std::log(x), 1e-12 + 3e-16 * std::abs(std::log(x))) << x;
  }
}

#ifdef NDTREE_HAS_EIGHTS
NDTREE_BY_EIGHTS std::array<double, 4> four_logs(const std::array<double, 4>& x) {
  std::array<double, 4> result;
  _mm256_storeu_pd(result.data(), quick_log(_mm256_loadu_pd(x.data())));
  return result;
}

TEST(QuickLog, OfFourIsThatOfEach) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of four doubles here";
  Random random(2);
  SCOPED_TRACE(random.trace());
  for (int i = 0; i < kNumbers; i += 4) {
    std::array<double, 4> x;
    for (int k = 0; k < 4; ++k) x[static_cast<std::size_t>(k)] = some_number(random, i + k);
    const std::array<double, 4> logs = four_logs(x);
    for (std::size_t k = 0; k < 4; ++k) ASSERT_EQ(logs[k], quick_log(x[k])) << x[k];
  }
}
#endif

}  // namespace
}  // namespace ndtree::test::test_quick_log
