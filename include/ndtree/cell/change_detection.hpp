// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Detecting change: a cell whose last scans contradict it for so long that the world must have changed.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_memory.hpp"
#include "ndtree/cell/evidence_options.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// A cell that holds a piece of a surface is both hit and passed, scan by scan. With the fraction rho of hits
/// by the cell's evidence (EvidenceMemory::effective_hits(), half a beam added to hits and to misses), not by
/// its counts, a streak of k scans whose beams all passed the cell has the probability (1 - rho)^k, one whose
/// beams all ended in it rho^k. A streak that contradicts the cell's state and is less likely than
/// change_probability is a change: the cell forgets all but the streak. Beams of a few consecutive scans are
/// correlated, so no streak below kLeastScans counts. O(1).
class ChangeDetection {
 public:
  explicit ChangeDetection(const EvidenceOptions& options) : probability_(options.change_probability) {}

  /// True if a streak that is long enough says the opposite of the cell's state.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool has_contradiction(const EvidenceCell& cell) {
    return cell.streak() >= kLeastScans &&
           cell.state() == (cell.streak_is_of_hits() ? CellState::free : CellState::occupied);
  }
  /// True if at least kLeastBeams beams contradict a streak of at least kLeastScans: they ended in the cell
  /// before, and all later scans passed it, or the other way round. Whether that is enough for a change is
  /// another question.
  [[nodiscard]] static bool is_disputed(const EvidenceCell& cell) {
    return cell.streak() >= kLeastScans &&
           (cell.streak_is_of_hits() ? cell.misses() : cell.hits()) >= kLeastBeams;
  }
  /// True if the streak is so unlikely under the cell's evidence that the world must have changed there.
  [[nodiscard]] bool has_changed(const EvidenceCell& cell, const EvidenceMemory& memory) const {
    if (!has_contradiction(cell) || probability_ == 0.0) return false;
    const bool hit = cell.streak_is_of_hits();
    constexpr double kPriorBeams = 0.5;
    const double hits = memory.effective_hits(cell) + kPriorBeams;
    const double misses = memory.effective_misses(cell) + kPriorBeams;
    return std::pow((hit ? hits : misses) / (hits + misses), cell.streak()) < probability_;
  }
  /// Leaves a cell with one beam's evidence for each scan of its streak, if it has changed. Takes and returns
  /// the cell by value so that callers keep theirs in registers.
  [[nodiscard]] NDTREE_NEVER_INLINE EvidenceCell after_contradiction(EvidenceCell cell,
                                                                     const EvidenceMemory& memory) const {
    if (has_changed(cell, memory)) forget_all_but_streak(cell, memory);
    return cell;
  }

 private:
  static constexpr std::uint32_t kLeastScans = 12;
  static constexpr std::uint32_t kLeastBeams = 2;  // One alone may be an error.

  static void forget_all_but_streak(EvidenceCell& cell, const EvidenceMemory& memory) {
    const bool hit = cell.streak_is_of_hits();
    const std::int64_t one = hit ? memory.hit_evidence() : memory.miss_evidence();
    const std::int64_t evidence = hit ? cell.occupied_evidence() : cell.free_evidence();
    const std::int64_t recent = std::min(evidence, cell.streak() * one);
    memory.assign(cell, hit ? recent : 0, hit ? 0 : recent);
    cell.set_counts(hit ? cell.streak() : 0, hit ? 0 : cell.streak());
  }

  double probability_;
};

}  // namespace ndtree
