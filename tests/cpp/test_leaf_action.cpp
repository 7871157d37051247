// SPDX-License-Identifier: BSD-3-Clause
// The leaf decision of the default refinement: what the evidence of a scan does to a leaf.
#include <gtest/gtest.h>

#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/mapping/insert/leaf_action.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/refinement.hpp"
#include "random.hpp"

namespace ndtree::test::test_leaf_action {
namespace {

constexpr int kChildrenAcross = 4;  // N = 2, D = 3.
constexpr int kLevels = 3;          // Below the leaf.

/// Some beams that pass, and some that end in the cell.
ScanEvidence random_scan(Random& random, int most) {
  ScanEvidence scan;
  scan.misses = static_cast<std::uint32_t>(random.integer(0, most));
  scan.resolvable_misses = static_cast<std::uint32_t>(random.integer(0, static_cast<int>(scan.misses)));
  scan.hits = random.chance(0.5) ? static_cast<std::uint32_t>(random.integer(0, most)) : 0;
  scan.resolvable_hits = static_cast<std::uint32_t>(random.integer(0, static_cast<int>(scan.hits)));
  scan.partial_hits = static_cast<std::uint32_t>(random.integer(0, static_cast<int>(scan.hits)));
  scan.beams = scan.misses + scan.hits;
  scan.free = 104 * static_cast<std::int64_t>(scan.misses);
  scan.occupied = static_cast<std::int64_t>(random.integer(0, 217)) * static_cast<std::int64_t>(scan.hits);
  return scan;
}

EvidenceCell random_cell(Random& random, const EvidenceModel& model) {
  EvidenceCell cell;
  for (int scans = random.integer(0, 6); scans > 0; --scans)
    (void)model.update(cell, random_scan(random, random.chance(0.5) ? 3 : 100));
  return cell;
}

TEST(LeafAction, IsTheSameOfBeamsThatAllPassedHoweverTheyWereAddedUp) {
  const EvidenceRefinement refinement{MapOptions()};
  Random random(2);
  int others = 0;
  for (int i = 0; i < 5000; ++i) {
    const EvidenceCell cell = random_cell(random, refinement.model);
    PassedEvidence passed;
    passed.misses = static_cast<std::uint32_t>(random.integer(1, 8));
    passed.resolvable_misses = random.chance(0.5) ? passed.misses : 0;
    passed.free = 104 * static_cast<std::int64_t>(passed.misses);
    const LeafAction action = refinement.action(cell, passed, kChildrenAcross, kLevels);
    ASSERT_EQ(action, refinement.action(cell, ScanEvidence::of(passed), kChildrenAcross, kLevels));
    others += action != LeafAction::update;
  }
  EXPECT_GT(others, 100);
}

// What allows a walk to stop adding up a leaf's evidence early.
TEST(LeafAction, MoreBeamsNeverRevokeAnEarlySplit) {
  const EvidenceRefinement refinement{MapOptions()};
  Random random(3);
  int early = 0;
  for (int i = 0; i < 20000; ++i) {
    const EvidenceCell cell = random_cell(random, refinement.model);
    ScanEvidence scan = random_scan(random, 6);
    const auto splits = [&] { return refinement.certainly_splits(cell, scan); };
    if (!splits()) continue;
    ++early;
    for (int more = 0; more < 4; ++more) {
      scan.add(random_scan(random, 60));
      ASSERT_TRUE(splits()) << "case " << i;
      ASSERT_EQ(refinement.action(cell, scan, kChildrenAcross, kLevels), LeafAction::split);
    }
  }
  EXPECT_GT(early, 1000);
}

}  // namespace
}  // namespace ndtree::test::test_leaf_action
