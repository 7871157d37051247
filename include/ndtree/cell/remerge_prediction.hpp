// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Predicting re-merge: splits whose children would merge again after the same scan are not made.
#pragma once

#include <cstdint>

#include "ndtree/cell/child_initialisation.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_memory.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Beams through an occupied cell whose parts are alike would split it, and its children would merge again
/// after the same scan. Most such splits are predicted from sums that the leaf has: in an occupied cell that
/// no streak of scans says to have changed, if E- is worth at most twelve beams, and the mean fraction of E+
/// is more than three times what a child may have of E- and of the scan's passes. In free space none is
/// predicted: its children remember where the hit was, see EvidenceRefinement::keep_partial().
struct RemergePrediction {
  /// @pre a split is asked for. @param children_across see kChildrenAcross.
  [[nodiscard]] static bool will_remerge(const EvidenceCell& cell, const ScanEvidence& scan,
                                         const ChildInitialisation& children, const EvidenceMemory& memory,
                                         int children_across) {
    constexpr double kFewMisses = 12.0;
    constexpr double kManyTimes = 3.0;
    if (cell.state() != CellState::occupied || ChangeDetection::may_have_changed(cell)) return false;
    const double mean = 1.0 / children_across;
    const auto occupied = static_cast<double>(cell.occupied_evidence());
    const auto free = static_cast<double>(cell.free_evidence());
    const auto miss = static_cast<double>(memory.miss_evidence());
    const double passes =
        unfused(children.path_fraction(mean, scan.misses, scan.beams) * free) + unfused(miss * scan.misses);
    return free <= kFewMisses * miss && mean * occupied > kManyTimes * passes;
  }

  /// What the cell would be, nearly, after splitting, updating the children and merging them again; but it
  /// keeps all evidence of passes alone (see ScanWalk::split()). The evidence of ways that the scan's beams
  /// did not reach fades as in the children: E- keeps the path fraction with the mean 1, a beam that
  /// ends in the cell reaching a quarter of it. Without this, a cell that is mostly passed on one side is
  /// taken for one that has changed.
  /// @param kept fraction of evidence that any cell keeps from one scan to the next. @param streak of scans
  /// that passed all of the cell, this one with them.
  [[nodiscard]] static EvidenceCell updated_without_split(const EvidenceCell& cell, const ScanEvidence& scan,
                                                          const ChildInitialisation& children,
                                                          const EvidenceMemory& memory, double kept,
                                                          std::uint32_t streak) {
    constexpr double kNotReached = 0.75;  // Of a cell, by a beam that ends in it.
    const double reached = scan.beams - unfused(kNotReached * scan.hits);
    const double kept_free = kept * children.path_fraction(1.0, reached, scan.beams);
    EvidenceCell now;
    now.set_covered(cell.is_covered());
    now.set_known_levels(cell.known_levels());
    memory.assign(now, EvidenceMemory::fraction_of_rounded_up(cell.occupied_evidence(), kept) + scan.occupied,
                  EvidenceMemory::fraction_of_rounded_up(cell.free_evidence(), kept_free) + scan.free);
    const auto hits = static_cast<std::uint32_t>(EvidenceMemory::fraction_of_rounded_up(cell.hits(), kept));
    const auto misses =
        static_cast<std::uint32_t>(EvidenceMemory::fraction_of_rounded_up(cell.misses(), kept_free));
    EvidenceCell with_streak = cell;
    with_streak.set_streak_of_passes(streak);
    memory.set_counts(now, hits + scan.hits, misses + ChangeDetection::counted_misses(with_streak, scan));
    now.set_streak_of_passes(streak);
    return now;
  }
};

}  // namespace ndtree
