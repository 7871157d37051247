// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Detecting change: a cell whose last scans contradict it for so long that the world must have changed.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_memory.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// A cell that holds a piece of a surface is both hit and passed, scan by scan. Let rho be the fraction of
/// its beams that end in it. A streak of k scans whose beams all passed the cell has the probability (1 -
/// rho)^k, one whose beams all ended in it rho^k. A streak that contradicts the cell's state and is too
/// unlikely is a change: the cell forgets all but the streak.
/// - Passes of an occupied cell: rho is that of the beams before the streak, by the counts, half a beam added
///   to hits and to misses; of a streak, each scan after the first counts as one miss. What little evidence
///   says is given up as easily: with the part q = min(1, E+ / known_evidence) of what a well observed cell
///   has, a streak of at least 12 q scans, and 3, is a change if it is less likely than
///   change_probability^q.
/// - Hits in a free cell: rho is by the cell's evidence (EvidenceMemory::effective_hits()), half a beam added
///   to both. A streak of at least kLeastScans, as beams of a few consecutive ones are correlated, is a
///   change if it is less likely than change_probability.
/// O(1).
class ChangeDetection {
 public:
  ChangeDetection(const EvidenceOptions& options, const EvidenceMemory& memory)
      : surprise_(options.change_probability > 0.0 ? -std::log(options.change_probability)
                                                   : std::numeric_limits<double>::infinity()),
        known_(std::min(options.known_evidence, options.evidence_memory) / EvidenceCell::kUnit),
        memory_(memory) {}

  /// Whether the last scans' beams all passed an occupied cell: it needs a large sample.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool is_doubted(const EvidenceCell& cell) {
    return cell.streak() > 0 && !cell.streak_is_of_hits() && cell.state() == CellState::occupied;
  }
  /// Scans in a row that passed an occupied cell. Its children go on with them, and siblings that merge have
  /// the least of theirs.
  [[nodiscard]] static std::uint32_t doubting_scans(const EvidenceCell& cell) {
    return is_doubted(cell) ? cell.streak() : 0;
  }
  /// Whether a dozen scans in a row passed all of a cell, whatever its state: nothing is in it.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool is_passed_by_all(const EvidenceCell& cell) {
    return cell.streak() >= kLeastScans && !cell.streak_is_of_hits();
  }
  [[nodiscard]] static bool may_have_changed(const EvidenceCell& cell) {
    return doubting_scans(cell) >= kLeastPasses;
  }
  /// Misses of a scan that an updated cell counts: one if the scan goes on with a streak of passes through an
  /// occupied cell, so that the counts tell what was before.
  /// @param cell its streak is that with the scan, its state that without it.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static std::uint32_t counted_misses(const EvidenceCell& cell,
                                                                         const ScanEvidence& scan) {
    const bool goes_on = cell.streak() > 1 && is_doubted(cell) && scan.hits == 0;
    return goes_on ? std::min(scan.misses, 1u) : scan.misses;
  }

  /// True if a streak that is long enough says the opposite of the cell's state.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool has_contradiction(const EvidenceCell& cell) {
    return cell.streak_is_of_hits() ? cell.streak() >= kLeastScans && cell.state() == CellState::free
                                    : cell.streak() >= kLeastPasses && cell.state() == CellState::occupied;
  }
  /// True if at least kLeastBeams beams contradict a streak of at least kLeastScans: they ended in the cell
  /// before, and all later scans passed it, or the other way round. Whether that is enough for a change is
  /// another question.
  [[nodiscard]] static bool is_disputed(const EvidenceCell& cell) {
    return cell.streak() >= kLeastScans &&
           (cell.streak_is_of_hits() ? cell.misses() : cell.hits()) >= kLeastBeams;
  }
  /// True if the streak is so unlikely that the world must have changed in the cell.
  [[nodiscard]] bool has_changed(const EvidenceCell& cell) const {
    if (!has_contradiction(cell)) return false;
    constexpr double kPriorBeams = 0.5;
    if (cell.streak_is_of_hits()) {
      const double hits = memory_.effective_hits(cell) + kPriorBeams;
      const double misses = memory_.effective_misses(cell) + kPriorBeams;
      return cell.streak() * std::log((hits + misses) / hits) > surprise_;
    }
    const double hits = cell.hits() + kPriorBeams;
    const double misses = std::max(cell.misses(), cell.streak()) - cell.streak() + kPriorBeams;
    const double known = std::min(1.0, static_cast<double>(cell.occupied_evidence()) / known_);
    return cell.streak() >= kLeastScans * known &&
           cell.streak() * std::log((hits + misses) / misses) > surprise_ * known;
  }
  /// Leaves a cell with one beam's evidence for each scan of its streak, if it has changed. Takes and returns
  /// the cell by value so that callers keep theirs in registers.
  [[nodiscard]] NDTREE_NEVER_INLINE EvidenceCell after_contradiction(EvidenceCell cell) const {
    if (has_changed(cell)) forget_all_but_streak(cell);
    return cell;
  }

 private:
  static constexpr std::uint32_t kLeastScans = 12;
  static constexpr std::uint32_t kLeastPasses = 3;
  static constexpr std::uint32_t kLeastBeams = 2;  // One alone may be an error.

  void forget_all_but_streak(EvidenceCell& cell) const {
    const bool hit = cell.streak_is_of_hits();
    const std::int64_t one = hit ? memory_.hit_evidence() : memory_.miss_evidence();
    const std::int64_t evidence = hit ? cell.occupied_evidence() : cell.free_evidence();
    const std::int64_t recent = std::min(evidence, cell.streak() * one);
    memory_.assign(cell, hit ? recent : 0, hit ? 0 : recent);
    cell.set_counts(hit ? cell.streak() : 0, hit ? 0 : cell.streak());
  }

  double surprise_;  // Of a well observed cell [nats].
  double known_;     // In EvidenceCell::kUnit.
  EvidenceMemory memory_;
};

}  // namespace ndtree
