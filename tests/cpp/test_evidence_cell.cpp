// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/tree/node_pool.hpp"
#include "random.hpp"

namespace ndtree::test::test_evidence_cell {
namespace {

constexpr std::uint32_t kMax = 0x1ff;
using Words = std::array<std::uint32_t, 3>;

static_assert(sizeof(EvidenceCell) == 12, "three words");
static_assert(sizeof(Node<EvidenceCell>) == 12, "the link shares the cell's memory");
static_assert(EvidenceCell::kMaxCount == kMax && EvidenceCell::kMaxEvidence == 0xffff);

EvidenceCell random_cell(Random& random) {
  EvidenceCell cell;
  cell.set_counts(static_cast<std::uint32_t>(random.integer(0, kMax)),
                  static_cast<std::uint32_t>(random.integer(0, kMax)));
  cell.set_evidence(random.integer(0, 0xffff), random.integer(0, 0xffff),
                    static_cast<float>(random.uniform(-5.0, 5.0)));
  return cell;
}

TEST(EvidenceCell, StartsAsZerosUnknownAndUnobserved) {
  const EvidenceCell cell;
  EXPECT_EQ(cell.log_odds(), 0.0f);
  EXPECT_EQ(cell.probability(), 0.5);
  EXPECT_EQ(cell.state(), CellState::unknown);
  EXPECT_FALSE(cell.observed());
  EXPECT_EQ(cell.hits(), 0u);
  EXPECT_EQ(cell.misses(), 0u);
  EXPECT_EQ(cell.occupied_evidence(), 0);
  EXPECT_EQ(cell.free_evidence(), 0);
  EXPECT_EQ(cell.words(), (Words{0, 0, 0}));
  EXPECT_EQ(EvidenceCell::from_words({0, 0, 0}), cell);
}

TEST(EvidenceCell, StateFollowsTheSignOfTheLogOdds) {
  struct Row {
    float log_odds;
    CellState state;
  };
  const Row rows[] = {{-2.0f, CellState::free},   {-1e-30f, CellState::free},    {-0.0f, CellState::unknown},
                      {0.0f, CellState::unknown}, {1e-30f, CellState::occupied}, {3.5f, CellState::occupied}};
  for (const Row& row : rows) {
    EvidenceCell cell;
    cell.set_evidence(3, 4, row.log_odds);
    EXPECT_EQ(cell.state(), row.state) << row.log_odds;
    EXPECT_TRUE(cell.observed());
    EXPECT_NEAR(cell.probability(), 1.0 / (1.0 + std::exp(-static_cast<double>(row.log_odds))), 1e-15);
  }
}

TEST(EvidenceCell, CountsAndEvidenceDoNotDisturbEachOther) {
  Random random(125);
  SCOPED_TRACE(random.trace());
  int cases = 0;
  for (; cases < 2000; ++cases) {
    const auto hits = static_cast<std::uint32_t>(random.integer(0, kMax));
    const auto misses = static_cast<std::uint32_t>(random.integer(0, kMax));
    const std::int64_t occupied = random.integer(0, 0xffff);
    const std::int64_t free = random.integer(0, 0xffff);
    const auto log_odds = static_cast<float>(random.uniform(-5.0, 5.0));
    EvidenceCell cell;
    const bool counts_first = random.chance(0.5);
    if (counts_first) cell.set_counts(hits, misses);
    cell.set_evidence(occupied, free, log_odds);
    ASSERT_TRUE(cell.observed());
    if (!counts_first) cell.set_counts(hits, misses);
    ASSERT_TRUE(cell.observed());
    ASSERT_EQ(cell.hits(), hits);
    ASSERT_EQ(cell.misses(), misses);
    ASSERT_EQ(cell.occupied_evidence(), occupied);
    ASSERT_EQ(cell.free_evidence(), free);
    ASSERT_EQ(cell.log_odds(), log_odds);
  }
  EXPECT_EQ(cases, 2000);
  // Counts are set, not added, and alone make a cell observed.
  EvidenceCell cell;
  cell.set_counts(0, 0);
  EXPECT_TRUE(cell.observed());
  cell.set_counts(7, 9);
  cell.set_counts(1, 0);
  EXPECT_EQ(cell.hits(), 1u);
  EXPECT_EQ(cell.misses(), 0u);
}

TEST(EvidenceCell, CountsSaturateWithoutLosingTheirRatio) {
  struct Row {
    std::uint32_t hits, misses, kept_hits, kept_misses;
  };
  const Row rows[] = {{kMax, kMax, kMax, kMax}, {kMax + 1, 0, 0x100, 0},
                      {0, kMax + 1, 0, kMax},   // There is no ratio to keep.
                      {kMax + 1, 1, 0x100, 1},  // A single miss is not forgotten.
                      {1, kMax + 2, 1, 0x101},  {kMax + 1, 100, 0x100, 50},
                      {4 * kMax, 80, kMax, 20}, {4096 * kMax, 4096 * kMax, kMax, kMax}};
  int cases = 0;
  for (const Row& row : rows) {
    SCOPED_TRACE(std::to_string(row.hits) + " hits, " + std::to_string(row.misses) + " misses");
    EvidenceCell cell;
    cell.set_counts(row.hits, row.misses);
    EXPECT_EQ(cell.hits(), row.kept_hits);
    EXPECT_EQ(cell.misses(), row.kept_misses);
    EXPECT_EQ(cell.words()[0] >> 30, 1u);
    ++cases;
  }
  EXPECT_EQ(cases, 8);
}

TEST(EvidenceCell, WordsRoundTripAndAreTheCell) {
  Random random(126);
  SCOPED_TRACE(random.trace());
  int cases = 0;
  for (; cases < 1000; ++cases) {
    const EvidenceCell cell = random_cell(random);
    const auto again = EvidenceCell::from_words(cell.words());
    ASSERT_EQ(again, cell);
    ASSERT_EQ(again.words(), cell.words());
    ASSERT_EQ(again.hits(), cell.hits());
    ASSERT_EQ(again.misses(), cell.misses());
    ASSERT_EQ(again.occupied_evidence(), cell.occupied_evidence());
    ASSERT_EQ(again.free_evidence(), cell.free_evidence());
    ASSERT_EQ(again.log_odds(), cell.log_odds());
    ASSERT_TRUE(again.observed());
    ASSERT_EQ(cell.words()[0] >> 31, 0u);
    std::uint32_t first = 0;
    std::memcpy(&first, &cell, sizeof first);
    ASSERT_EQ(first, cell.words()[0]) << "the first word in memory is the one that a node shares";
  }
  EXPECT_EQ(cases, 1000);
  // What a cell cannot hold is cleared.
  const auto cell = EvidenceCell::from_words({0xffffffffu, 0x3f800000u, 0xffff0001u});
  EXPECT_EQ(cell.words(), (Words{0x4fffffffu, 0x3f800000u, 0xffff0001u}));
  EXPECT_EQ(cell.hits(), kMax);
  EXPECT_EQ(cell.misses(), kMax);
  EXPECT_EQ(cell.log_odds(), 1.0f);
  EXPECT_EQ(cell.occupied_evidence(), 0xffff);
  EXPECT_EQ(cell.free_evidence(), 1);
  EXPECT_EQ(EvidenceCell::from_words({0x40000000u | 3u << 9 | 2u, 0, 0}).hits(), 2u);
  EXPECT_EQ(EvidenceCell::from_words({0x40000000u | 3u << 9 | 2u, 0, 0}).misses(), 3u);
}

TEST(EvidenceCell, EqualityTakesAllOfIt) {
  EvidenceCell a;
  a.set_counts(1, 2);
  a.set_evidence(3, 4, 0.5f);
  const auto differs = [&](std::uint32_t hits, std::uint32_t misses, int occupied, int free, float log_odds) {
    EvidenceCell b;
    b.set_counts(hits, misses);
    b.set_evidence(occupied, free, log_odds);
    EXPECT_NE(a == b, a != b);
    return a != b;
  };
  EXPECT_FALSE(differs(1, 2, 3, 4, 0.5f));
  EXPECT_TRUE(differs(0, 2, 3, 4, 0.5f));
  EXPECT_TRUE(differs(1, 1, 3, 4, 0.5f));
  EXPECT_TRUE(differs(1, 2, 4, 4, 0.5f));
  EXPECT_TRUE(differs(1, 2, 3, 3, 0.5f));
  EXPECT_TRUE(differs(1, 2, 3, 4, 0.25f));
  EXPECT_NE(EvidenceCell::from_words({0x40000000u, 0, 0}), EvidenceCell{});
}

TEST(EvidenceCell, NodeIsALeafOrALinkNeverBoth) {
  Random random(127);
  SCOPED_TRACE(random.trace());
  Node<EvidenceCell> node;
  EXPECT_TRUE(node.is_leaf());
  EXPECT_EQ(node.cell(), EvidenceCell{});
  int cases = 0;
  for (const BlockId id : {0u, 1u, 77u, 0x3fffffffu, 0x40000000u, 0x7ffffffeu})
    for (int i = 0; i < 50; ++i, ++cases) {
      node.become_inner(id);
      ASSERT_FALSE(node.is_leaf());
      ASSERT_EQ(node.children(), id);
      EvidenceCell cell = random_cell(random);
      node.become_leaf(cell);
      ASSERT_TRUE(node.is_leaf());
      ASSERT_EQ(node.cell(), cell);
      // Also after the largest of everything.
      node.cell().set_counts(4096 * kMax, 4096 * kMax);
      node.cell().set_evidence(0xffff, 0xffff, -1.0f);
      ASSERT_TRUE(node.is_leaf());
    }
  EXPECT_EQ(cases, 300);
}

}  // namespace
}  // namespace ndtree::test::test_evidence_cell
