// SPDX-License-Identifier: BSD-3-Clause
/// What vectors compute is, for each of their numbers, what is computed for one number, to the last bit.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"
#include "support/random.hpp"

namespace ndtree::test::test_lanes {
namespace {

/// Ordinary numbers, and those at which rules differ.
std::vector<float> some_floats(Random& random) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  std::vector<float> all{0.0f, -0.0f, 1.0f, -1.0f, kInfinity, -kInfinity, std::nanf(""), 0x1p-140f, 1e38f};
  while (all.size() < 64) all.push_back(static_cast<float>(random.uniform(-10.0, 10.0)));
  return all;
}
std::uint32_t word(float x) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  return bits;
}

#ifdef NDTREE_HAS_EIGHTS
using Eight = std::array<float, 8>;
using EightWords = std::array<std::uint32_t, 8>;

/// A rule that uses most of what there is.
template <class Floats>
NDTREE_ALWAYS_INLINE Floats rule(const Floats& a, const Floats& b) {
  const Floats product = unfused(a * b) + 0.5f;
  const Floats nearer = min_of(a, b) - max_of(b, a);
  const Floats chosen = select(a < b, Floats(product / b), Floats(nearer * 3.0f));
  return select((chosen >= product) | (a == b), with_sign(abs_of(chosen), a), chosen);
}
NDTREE_BY_EIGHTS Eight rule_of_eight(const Eight& a, const Eight& b) {
  Eight result;
  rule(EightFloats::load(a.data()), EightFloats::load(b.data())).store(result.data());
  return result;
}

TEST(Lanes, RulesGiveTheSameBitsAtEachWidth) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of eight floats here";
  Random random(811);
  const std::vector<float> numbers = some_floats(random);
  for (const float a : numbers)
    for (std::size_t first = 0; first + 8 <= numbers.size(); first += 8) {
      Eight left;
      left.fill(a);
      Eight right;
      for (std::size_t k = 0; k < 8; ++k) right[k] = numbers[first + k];
      const Eight of_eight = rule_of_eight(left, right);
      for (std::size_t k = 0; k < 8; ++k) {
        const float one = rule(a, right[k]);
        if (std::isnan(one))
          ASSERT_TRUE(std::isnan(of_eight[k])) << a << ", " << right[k];
        else
          ASSERT_EQ(word(of_eight[k]), word(one)) << a << ", " << right[k];
      }
    }
}

template <class Floats>
NDTREE_ALWAYS_INLINE auto whole_number(const Floats& x) {
  const auto words = words_of(x) * 0x9e3779b1u;
  return unsigned_shifted_right(words ^ unsigned_shifted_right(words, 15), 8);
}
NDTREE_BY_EIGHTS EightWords whole_of_eight(const Eight& x) {
  EightWords result;
  whole_number(EightFloats::load(x.data())).store(result.data());
  return result;
}
NDTREE_BY_EIGHTS EightWords rounded_of_eight(const Eight& x, bool nearest) {
  EightWords result;
  const EightFloats eight = EightFloats::load(x.data());
  (nearest ? nearest_integer(eight) : truncated(eight)).store(result.data());
  return result;
}

TEST(Lanes, WholeNumbersAreTheSameAtEachWidth) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of eight floats here";
  Random random(812);
  for (int i = 0; i < 1000; ++i) {
    Eight x;
    for (float& each : x) each = std::round(static_cast<float>(random.uniform(-1e4, 1e4))) / 2.0f;
    const EightWords hashes = whole_of_eight(x);
    const EightWords nearest = rounded_of_eight(x, true);
    const EightWords towards_zero = rounded_of_eight(x, false);
    for (std::size_t k = 0; k < 8; ++k) {
      ASSERT_EQ(hashes[k], whole_number(x[k])) << x[k];
      ASSERT_EQ(static_cast<std::int32_t>(nearest[k]), nearest_integer(x[k])) << x[k];
      ASSERT_EQ(static_cast<std::int32_t>(towards_zero[k]), truncated(x[k])) << x[k];
    }
  }
}

NDTREE_BY_EIGHTS std::size_t pack(const EightWords& numbers, unsigned set, EightWords& packed) {
  return store_packed(EightInts::load(numbers.data()), EightMask::of_set(set), packed.data());
}
NDTREE_BY_EIGHTS std::array<bool, 4> relations(unsigned a, unsigned b) {
  const EightMask x = EightMask::of_set(a);
  const EightMask y = EightMask::of_set(b);
  return {x.is_within(y), x.overlaps(y), x.without(y).set() == (a & ~b),
          (x & y).count() + (x | y).count() == x.count() + y.count()};
}

TEST(Lanes, MasksAreSets) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of eight floats here";
  const EightWords numbers{10, 11, 12, 13, 14, 15, 16, 17};
  for (unsigned set = 0; set < 256; ++set) {
    EightWords packed;
    const std::size_t count = pack(numbers, set, packed);
    std::size_t n = 0;
    for (unsigned k = 0; k < 8; ++k)
      if ((set >> k & 1u) != 0) {
        ASSERT_EQ(packed[n++], 10 + k) << set;
      }
    ASSERT_EQ(count, n);
    for (const unsigned other : {0u, 0xffu, set, set ^ 0xffu, 0x5au}) {
      const auto [is_within, overlaps, without, counts] = relations(set, other);
      ASSERT_EQ(is_within, (set & ~other) == 0) << set << ", " << other;
      ASSERT_EQ(overlaps, (set & other) != 0) << set << ", " << other;
      ASSERT_TRUE(without && counts) << set << ", " << other;
    }
  }
}

struct alignas(16) Row {
  std::array<float, 4> at;
};
NDTREE_BY_EIGHTS std::array<Eight, 4> columns_of(const Row* table, const std::uint32_t* rows) {
  EightFloats columns[4];
  load_columns(table, rows, columns);
  std::array<Eight, 4> result;
  for (std::size_t a = 0; a < 4; ++a) columns[a].store(result[a].data());
  return result;
}
NDTREE_BY_EIGHTS void copy_rows(const Row* from, const std::uint32_t* rows, Row* to) {
  EightFloats columns[4];
  load_columns(from, rows, columns);
  store_columns(columns, to);
}

TEST(Lanes, RowsAreTurnedIntoColumnsAndBack) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of eight floats here";
  std::vector<Row> table(20);
  for (std::size_t i = 0; i < table.size(); ++i)
    for (std::size_t a = 0; a < 4; ++a) table[i].at[a] = static_cast<float>(10 * i + a);
  const EightWords rows{3, 19, 0, 7, 7, 12, 1, 18};
  const auto columns = columns_of(table.data(), rows.data());
  std::array<Row, 8> copies;
  copy_rows(table.data(), rows.data(), copies.data());
  for (std::size_t k = 0; k < 8; ++k)
    for (std::size_t a = 0; a < 4; ++a) {
      EXPECT_EQ(columns[a][k], table[rows[k]].at[a]);
      EXPECT_EQ(copies[k].at[a], table[rows[k]].at[a]);
    }
}
#endif

TEST(Lanes, RoundToTheNearestAndTheEven) {
  const std::pair<float, std::int32_t> rows[] = {{0.5f, 0},   {1.5f, 2},    {2.5f, 2},         {-0.5f, 0},
                                                 {-1.5f, -2}, {2.4999f, 2}, {1e9f, 1000000000}};
  for (const auto& [x, expected] : rows) {
    EXPECT_EQ(nearest_integer(x), expected) << x;
  }
  EXPECT_TRUE(Simd::width() == 1 || Simd::width() == 8 || Simd::width() == Simd::kWidest);
}

constexpr int kNumbers = 200'000;

double some_number(Random& random, int i) {
  const double m = 1.0 + random.uniform();
  if (i % 3 == 0) return 1.0 + (m - 1.5) * 1e-3;  // Near 1, where the logarithm changes its sign.
  return std::ldexp(m, random.integer(-1000, 1000));
}

TEST(QuickLog, IsWithin1em12) {
  Random random(1);
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
  for (int i = 0; i < kNumbers; i += 8) {
    std::array<float, 8> x;
    for (int k = 0; k < 8; ++k) x[static_cast<std::size_t>(k)] = some_float(random, i + k);
    const std::array<float, 8> logs = eight_logs(x);
    for (std::size_t k = 0; k < 8; ++k) ASSERT_EQ(logs[k], rough_log(x[k])) << x[k];
  }
}
#endif

}  // namespace
}  // namespace ndtree::test::test_lanes
