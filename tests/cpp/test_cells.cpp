// SPDX-License-Identifier: BSD-3-Clause
// What cells hold in their words: log-odds, counts, and evidence.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "random.hpp"

namespace ndtree::test::test_cells {
namespace {

static_assert(sizeof(OccupancyCell) == 8 && sizeof(EvidenceCell) == 12, "two words, and three");
static_assert(EvidenceCell::kMaxCount == 0x1ff && EvidenceCell::kMaxEvidence == 0xffff);

template <class Cell>
constexpr std::uint32_t kMax = 0x7fff;  // A count.
template <>
constexpr std::uint32_t kMax<EvidenceCell> = 0x1ff;

void set_log_odds(OccupancyCell& cell, float log_odds) { cell.set_log_odds(log_odds); }
void set_log_odds(EvidenceCell& cell, float log_odds) { cell.set_evidence(3, 4, log_odds); }

template <class Cell>
class Cells : public ::testing::Test {};
using Kinds = ::testing::Types<OccupancyCell, EvidenceCell>;
TYPED_TEST_SUITE(Cells, Kinds);

TYPED_TEST(Cells, StartAsZerosUnknownAndUnobserved) {
  const TypeParam cell;
  EXPECT_EQ(cell.log_odds(), 0.0f);
  EXPECT_EQ(cell.probability(), 0.5);
  EXPECT_EQ(cell.state(), CellState::unknown);
  EXPECT_FALSE(cell.observed());
  EXPECT_EQ(cell.hits() + cell.misses(), 0u);
  EXPECT_EQ(cell.words(), (decltype(cell.words()){}));
  EXPECT_EQ(TypeParam::from_words({}), cell);
  EXPECT_NE(TypeParam::from_words({0x40000000u}), cell);
}

TYPED_TEST(Cells, StateFollowsTheSignOfTheLogOdds) {
  struct Row {
    float log_odds;
    CellState state;
  };
  const Row rows[] = {{-2.0f, CellState::free},   {-1e-30f, CellState::free},    {-0.0f, CellState::unknown},
                      {0.0f, CellState::unknown}, {1e-30f, CellState::occupied}, {3.5f, CellState::occupied}};
  for (const Row& row : rows) {
    TypeParam cell;
    set_log_odds(cell, row.log_odds);
    EXPECT_EQ(cell.state(), row.state) << row.log_odds;
    EXPECT_TRUE(cell.observed());
    EXPECT_NEAR(cell.probability(), 1.0 / (1.0 + std::exp(-static_cast<double>(row.log_odds))), 1e-15);
  }
}

TYPED_TEST(Cells, CountsSaturateWithoutLosingTheirRatio) {
  constexpr std::uint32_t kMost = kMax<TypeParam>;
  constexpr std::uint32_t kHalf = (kMost + 1) / 2;
  struct Row {
    std::uint32_t hits, misses, kept_hits, kept_misses;
  };
  const Row rows[] = {{kMost, kMost, kMost, kMost}, {kMost + 1, 0, kHalf, 0},
                      {kMost + 1, 1, kHalf, 1},  // A single miss is not forgotten.
                      {1, kMost + 2, 1, kHalf + 1}, {kMost + 1, 100, kHalf, 50},
                      {4 * kMost, 80, kMost, 20},   {4096 * kMost, 4096 * kMost, kMost, kMost}};
  for (const Row& row : rows) {
    SCOPED_TRACE(std::to_string(row.hits) + " hits, " + std::to_string(row.misses) + " misses");
    TypeParam cell;
    cell.set_counts(row.hits, row.misses);
    EXPECT_EQ(cell.hits(), row.kept_hits);
    EXPECT_EQ(cell.misses(), row.kept_misses);
    EXPECT_TRUE(cell.observed());
  }
}

/// All that a cell holds.
struct Content {
  std::uint32_t hits, misses;
  std::int64_t occupied, free;
  float log_odds;
};
OccupancyCell cell_of(const Content& content, const OccupancyCell& /*kind*/) {
  OccupancyCell cell;
  cell.set_counts(content.hits, content.misses);
  cell.set_log_odds(content.log_odds);
  return cell;
}
EvidenceCell cell_of(const Content& content, const EvidenceCell& /*kind*/, bool counts_first = true) {
  EvidenceCell cell;
  if (counts_first) cell.set_counts(content.hits, content.misses);
  cell.set_evidence(content.occupied, content.free, content.log_odds);
  if (!counts_first) cell.set_counts(content.hits, content.misses);
  return cell;
}

TYPED_TEST(Cells, HoldWhatTheyAreToldAndWordsAreTheCell) {
  Random random(126);
  for (int cases = 0; cases < 2000; ++cases) {
    constexpr int kMost = kMax<TypeParam>;
    const Content content{static_cast<std::uint32_t>(random.integer(0, kMost)),
                          static_cast<std::uint32_t>(random.integer(0, kMost)), random.integer(0, 0xffff),
                          random.integer(0, 0xffff), static_cast<float>(random.uniform(-5.0, 5.0))};
    const TypeParam cell = cell_of(content, TypeParam());
    for (const TypeParam& same : {cell, TypeParam::from_words(cell.words())}) {
      ASSERT_TRUE(same == cell && !(same != cell));
      ASSERT_EQ(same.hits(), content.hits);
      ASSERT_EQ(same.misses(), content.misses);
      ASSERT_EQ(same.log_odds(), content.log_odds);
      ASSERT_TRUE(same.observed());
      if constexpr (std::is_same_v<TypeParam, EvidenceCell>) {
        ASSERT_EQ(same.occupied_evidence(), content.occupied);
        ASSERT_EQ(same.free_evidence(), content.free);
        ASSERT_EQ(cell_of(content, same, false), same) << "in any order";
      }
    }
    ASSERT_EQ(cell.words()[0] >> 31, 0u);
    std::uint32_t first = 0;
    std::memcpy(&first, &cell, sizeof first);
    ASSERT_EQ(first, cell.words()[0]) << "the first word in memory is the one that a node shares";
    // Whatever differs makes cells different.
    for (int part = 0; part < (std::is_same_v<TypeParam, EvidenceCell> ? 5 : 3); ++part) {
      Content other = content;
      if (part == 0) other.hits ^= 1u;
      if (part == 1) other.misses ^= 1u;
      if (part == 2) other.log_odds += 0.25f;
      if (part == 3) other.occupied ^= 1;
      if (part == 4) other.free ^= 1;
      ASSERT_TRUE(cell_of(other, TypeParam()) != cell && !(cell_of(other, TypeParam()) == cell)) << part;
    }
  }
}

TEST(OccupancyCell, UpdatesAddUpBetweenTheBounds) {
  Random random(31);
  int clamped_low = 0;
  int clamped_high = 0;
  for (int round = 0; round < 50; ++round) {
    OccupancyCell cell;
    float expected = 0.0f;
    const double bias = random.uniform(-0.8, 0.8);
    for (int i = 0; i < 40; ++i) {
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
  EXPECT_GT(clamped_low, 100);
  EXPECT_GT(clamped_high, 100);
}

TEST(OccupancyCell, CountsAreExactUpToTheirLimitAndKeepTheirRatio) {
  OccupancyCell cell;
  for (std::uint32_t i = 1; i <= kMax<OccupancyCell>; ++i) {
    cell.count_hit();
    ASSERT_EQ(cell.hits(), i);
    ASSERT_EQ(cell.misses(), 0u);
  }
  cell.set_counts(0, 5);
  for (std::uint32_t i = 6; i <= kMax<OccupancyCell>; ++i) {
    cell.count_miss();
    ASSERT_EQ(cell.misses(), i);
    ASSERT_EQ(cell.hits(), 0u);
  }
  for (int i = 0; i < 400000; ++i) i % 4 == 0 ? cell.count_hit() : cell.count_miss();
  EXPECT_LE(cell.misses(), kMax<OccupancyCell>);
  EXPECT_GT(cell.misses(), kMax<OccupancyCell> / 2);
  EXPECT_NEAR(static_cast<double>(cell.hits()) / cell.misses(), 1.0 / 3.0, 1e-3);
}

TEST(Cells, OfWordsOfAFileTakeWhatTheyCanHold) {
  const auto occupancy = OccupancyCell::from_words({0xffffffffu, 0x3f800000u});
  EXPECT_EQ(occupancy.words()[0], 0x7fffffffu);
  EXPECT_EQ(occupancy.log_odds(), 1.0f);
  EXPECT_EQ(occupancy.hits(), kMax<OccupancyCell>);
  EXPECT_EQ(occupancy.misses(), kMax<OccupancyCell>);
  OccupancyCell many;
  many.set_counts(0, 0x8000);
  EXPECT_EQ(many.misses(), 0x4000u);
  const auto evidence = EvidenceCell::from_words({0xffffffffu, 0x3f800000u, 0xffff0001u});
  EXPECT_EQ(evidence.words(), (std::array<std::uint32_t, 3>{0x4fffffffu, 0x3f800000u, 0xffff0001u}));
  EXPECT_EQ(evidence.hits(), kMax<EvidenceCell>);
  EXPECT_EQ(evidence.misses(), kMax<EvidenceCell>);
  EXPECT_EQ(evidence.occupied_evidence(), 0xffff);
  EXPECT_EQ(evidence.free_evidence(), 1);
  EXPECT_EQ(EvidenceCell::from_words({0x40000000u | 3u << 9 | 2u, 0, 0}).hits(), 2u);
  EXPECT_EQ(EvidenceCell::from_words({0x40000000u | 3u << 9 | 2u, 0, 0}).misses(), 3u);
  EvidenceCell passed;
  passed.set_counts(0, kMax<EvidenceCell> + 1);
  EXPECT_EQ(passed.misses(), kMax<EvidenceCell>) << "there is no ratio to keep";
  EXPECT_EQ(passed.words()[0] >> 30, 1u);
}

}  // namespace
}  // namespace ndtree::test::test_cells
