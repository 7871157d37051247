// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "ndtree/cell/occupancy_cell.hpp"
#include "random.hpp"

namespace ndtree::test::test_occupancy_cell {
namespace {

constexpr std::uint32_t kMax = 0x7fff;

TEST(OccupancyCell, StartsUnknownAndUnobserved) {
  const OccupancyCell cell;
  EXPECT_EQ(cell.log_odds(), 0.0f);
  EXPECT_EQ(cell.probability(), 0.5);
  EXPECT_EQ(cell.hits(), 0u);
  EXPECT_EQ(cell.misses(), 0u);
  EXPECT_FALSE(cell.observed());
  EXPECT_EQ(cell.state(), CellState::unknown);
  EXPECT_EQ(cell.words(), (std::array<std::uint32_t, 2>{0, 0}));
  EXPECT_EQ(sizeof(OccupancyCell), 8u);
}

TEST(OccupancyCell, StateFollowsTheSignOfTheLogOdds) {
  struct Row {
    float log_odds;
    CellState state;
  };
  const Row rows[] = {{-2.0f, CellState::free},   {-1e-30f, CellState::free},    {-0.0f, CellState::unknown},
                      {0.0f, CellState::unknown}, {1e-30f, CellState::occupied}, {3.5f, CellState::occupied}};
  for (const Row& row : rows) {
    OccupancyCell cell;
    cell.set_log_odds(row.log_odds);
    EXPECT_EQ(cell.state(), row.state) << row.log_odds;
    EXPECT_TRUE(cell.observed());
    EXPECT_NEAR(cell.probability(), 1.0 / (1.0 + std::exp(-static_cast<double>(row.log_odds))), 1e-15);
  }
}

TEST(OccupancyCell, UpdatesAddUpBetweenTheBounds) {
  Random random(31);
  SCOPED_TRACE(random.trace());
  int clamped_low = 0;
  int clamped_high = 0;
  int cases = 0;
  for (int round = 0; round < 50; ++round) {
    OccupancyCell cell;
    float expected = 0.0f;
    const double bias = random.uniform(-0.8, 0.8);
    for (int i = 0; i < 40; ++i, ++cases) {
      const auto measured = static_cast<float>(random.uniform(-0.6, 0.6) + bias);
      cell.update(measured, -2.0f, 3.5f);
      expected += measured;
      if (expected < -2.0f) expected = -2.0f, ++clamped_low;
      if (expected > 3.5f) expected = 3.5f, ++clamped_high;
      ASSERT_EQ(cell.log_odds(), expected);
      ASSERT_TRUE(cell.observed());
    }
    ASSERT_EQ(cell.hits() + cell.misses(), 0u);
  }
  EXPECT_EQ(cases, 2000);
  EXPECT_GT(clamped_low, 100);
  EXPECT_GT(clamped_high, 100);
}

TEST(OccupancyCell, CountsAreExactUpToTheirLimit) {
  OccupancyCell cell;
  cell.set_log_odds(1.25f);
  for (std::uint32_t i = 1; i <= kMax; ++i) {
    cell.count_hit();
    ASSERT_EQ(cell.hits(), i);
    ASSERT_EQ(cell.misses(), 0u);
  }
  cell.set_counts(0, 5);
  for (std::uint32_t i = 6; i <= kMax; ++i) {
    cell.count_miss();
    ASSERT_EQ(cell.misses(), i);
    ASSERT_EQ(cell.hits(), 0u);
  }
  EXPECT_EQ(cell.log_odds(), 1.25f);
  EXPECT_TRUE(cell.observed());
}

TEST(OccupancyCell, CountsSaturateWithoutLosingTheirRatio) {
  struct Row {
    std::uint32_t hits, misses, kept_hits, kept_misses;
  };
  const Row rows[] = {{kMax, kMax, kMax, kMax},
                      {kMax + 1, 0, 0x4000, 0},
                      {0, kMax + 1, 0, 0x4000},
                      {kMax + 1, 1, 0x4000, 1},  // A single miss is not forgotten.
                      {1, kMax + 2, 1, 0x4001},
                      {kMax + 1, 1000, 0x4000, 500},
                      {4 * kMax, 8000, 0x7ffe / 2 + 0x4000, 2000},
                      {4096 * kMax, 4096 * kMax, kMax, kMax}};
  for (const Row& row : rows) {
    SCOPED_TRACE(std::to_string(row.hits) + " hits, " + std::to_string(row.misses) + " misses");
    OccupancyCell cell;
    cell.set_counts(row.hits, row.misses);
    EXPECT_EQ(cell.hits(), row.kept_hits);
    EXPECT_EQ(cell.misses(), row.kept_misses);
  }
  OccupancyCell cell;
  for (int i = 0; i < 400000; ++i) i % 4 == 0 ? cell.count_hit() : cell.count_miss();
  EXPECT_LE(cell.misses(), kMax);
  EXPECT_GT(cell.misses(), kMax / 2);
  EXPECT_NEAR(static_cast<double>(cell.hits()) / cell.misses(), 1.0 / 3.0, 1e-3);
}

TEST(OccupancyCell, WordsRoundTrip) {
  Random random(32);
  SCOPED_TRACE(random.trace());
  int cases = 0;
  for (; cases < 1000; ++cases) {
    OccupancyCell cell;
    const auto hits = static_cast<std::uint32_t>(random.integer(0, kMax));
    const auto misses = static_cast<std::uint32_t>(random.integer(0, kMax));
    cell.set_counts(hits, misses);
    cell.set_log_odds(static_cast<float>(random.uniform(-5.0, 5.0)));
    const auto again = OccupancyCell::from_words(cell.words());
    ASSERT_EQ(again, cell);
    ASSERT_EQ(again.hits(), hits);
    ASSERT_EQ(again.misses(), misses);
    ASSERT_TRUE(again.observed());
    ASSERT_EQ(cell.words()[0] >> 31, 0u);
    // Nothing else is inside: the two words are the cell.
    std::array<std::uint32_t, 2> words;
    std::memcpy(words.data(), &cell, sizeof words);
    ASSERT_EQ(words, cell.words());
  }
  EXPECT_EQ(cases, 1000);
  const auto cell = OccupancyCell::from_words({0xffffffffu, 0x3f800000u});
  EXPECT_EQ(cell.words()[0], 0x7fffffffu);
  EXPECT_EQ(cell.log_odds(), 1.0f);
  EXPECT_EQ(cell.hits(), kMax);
  EXPECT_EQ(cell.misses(), kMax);
}

TEST(OccupancyCell, EqualityTakesAllOfIt) {
  OccupancyCell a;
  a.set_counts(1, 2);
  a.set_log_odds(0.5f);
  OccupancyCell b = a;
  EXPECT_TRUE(a == b && !(a != b));
  b.set_log_odds(0.25f);
  EXPECT_TRUE(a != b);
  b = a;
  b.count_miss();
  EXPECT_TRUE(a != b);
  EXPECT_NE(OccupancyCell::from_words({0x40000000u, 0u}), OccupancyCell{});
}

}  // namespace
}  // namespace ndtree::test::test_occupancy_cell
