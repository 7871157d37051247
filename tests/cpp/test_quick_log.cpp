// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

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
  quick_log(FourDoubles::load(x.data())).store(result.data());
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

float some_float(Random& random, int i) {
  const auto m = static_cast<float>(1.0 + random.uniform());
  if (i % 3 == 0) return 1.0f + (m - 1.5f) * 1e-3f;
  return std::ldexp(m, random.integer(-126, 126));
}

TEST(RoughLog, IsWithinItsError) {
  Random random(3);
  SCOPED_TRACE(random.trace());
  EXPECT_EQ(rough_log(1.0f), 0.0f);
  const double root_half = std::sqrt(0.5);  // About there, m begins anew.
  for (const double x : {0.5, 2.0, root_half, root_half * (1.0 + 1e-6), root_half * (1.0 - 1e-6), 1e-6, 1e6})
    EXPECT_NEAR(static_cast<double>(rough_log(static_cast<float>(x))), std::log(x), 2e-5) << x;
  for (const float x : {std::numeric_limits<float>::min(), std::numeric_limits<float>::max()})
    EXPECT_NEAR(rough_log(x), std::log(x), 3e-5f) << x;
  for (int i = 0; i < kNumbers; ++i) {
    const float x = some_float(random, i);
    const double log = std::log(static_cast<double>(x));
    ASSERT_NEAR(static_cast<double>(rough_log(x)), log, 1.1e-5 + 2e-7 * std::abs(log)) << x;
  }
}

#ifdef NDTREE_HAS_EIGHTS
NDTREE_BY_EIGHTS std::array<float, 8> eight_logs(const std::array<float, 8>& x) {
  std::array<float, 8> result;
  rough_log(EightFloats::load(x.data())).store(result.data());
  return result;
}

TEST(RoughLog, OfEightIsThatOfEach) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of eight floats here";
  Random random(4);
  SCOPED_TRACE(random.trace());
  for (int i = 0; i < kNumbers; i += 8) {
    std::array<float, 8> x;
    for (int k = 0; k < 8; ++k) x[static_cast<std::size_t>(k)] = some_float(random, i + k);
    const std::array<float, 8> logs = eight_logs(x);
    for (std::size_t k = 0; k < 8; ++k) ASSERT_EQ(logs[k], rough_log(x[k])) << x[k];
  }
}
#endif

}  // namespace
}  // namespace ndtree::test::test_quick_log
