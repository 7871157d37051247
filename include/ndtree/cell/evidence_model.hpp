// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How the beams of a scan change a cell with evidence: the parts of cell/ put together.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/cell/beam_weight.hpp"
#include "ndtree/cell/change_detection.hpp"
#include "ndtree/cell/child_initialisation.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_memory.hpp"
#include "ndtree/cell/remerge_prediction.hpp"
#include "ndtree/cell/sampling_rate.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// What a scan does to one cell. Each decision stands in a part, beside its derivation:
/// - log-odds of evidence, and its fading: EvidenceMemory;
/// - how many beams of a scan count: SamplingRate;
/// - whether the world has changed in the cell: ChangeDetection;
/// - what children start with: ChildInitialisation;
/// - whether a split would be undone after the same scan: RemergePrediction.
/// What a beam is worth to a cell is computed before, see LeafEvidence; whether a cell splits at all is
/// EvidenceRefinement's question. Every function is O(1) and const.
class EvidenceModel {
 public:
  EvidenceModel(const EvidenceOptions& options, const SensorOptions& sensor)
      : memory_(options, sensor),
        sampling_(options, memory_),
        change_(options, memory_),
        children_(options),
        noise_sigmas_(options.noise_sigmas),
        kept_(options.evidence_half_life > 0.0 ? std::exp2(-1.0 / options.evidence_half_life) : 1.0),
        saturated_(make_saturated()) {}

  /// Adds the joint evidence of a scan. @returns true if the cell changed.
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const ScanEvidence& scan) const {
    return scan.is_free_alone() && keeps_only_free_evidence(cell) ? update_free(cell, scan.free, scan.misses)
                                                                  : update_any(cell, scan);
  }
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const PassedEvidence& passed) const {
    return keeps_only_free_evidence(cell) ? update_free(cell, passed.free, passed.misses)
                                          : update_any(cell, ScanEvidence::of(passed));
  }
  /// update() of an occupied cell that all beams passed. @param clearly whether it looks empty; only such
  /// scans count as a streak.
  /// @returns true if the cell changed.
  bool update_passed(EvidenceCell& cell, const ScanEvidence& scan, bool clearly) const {
    return update_any(cell, scan, clearly);
  }
  /// update() of a cell that was to split but is predicted to re-merge, see RemergePrediction, or did
  /// re-merge. @param streak of scans that passed each part of it, this one with them.
  /// @returns true if the cell changed.
  bool update_without_split(EvidenceCell& cell, const ScanEvidence& scan, std::uint32_t streak = 0) const {
    return replace(cell,
                   RemergePrediction::updated_without_split(cell, scan, children_, memory_, kept_, streak));
  }
  /// update() of a cell that is only partly seen: keeps the seen parts and the evidence for free space in
  /// them. @returns true if the cell changed.
  bool update_partly_seen(EvidenceCell& cell, std::uint32_t parts, const ScanEvidence& scan) const {
    const EvidenceCell before = cell;
    cell.set_partly_seen(parts, free_with(cell, scan));
    return cell != before;
  }
  /// True if a partly seen cell has as much evidence for free space as scans like this one can give it.
  [[nodiscard]] bool remembers_no_more(const EvidenceCell& cell, const ScanEvidence& scan) const {
    return scan.free > 0 && free_with(cell, scan) <= cell.free_evidence();
  }

  /// True if scans whose beams all pass the cell leave it as it is: its evidence for free space and its count
  /// of misses are at their caps, and it has no other evidence, no hits and no streak.
  [[nodiscard]] bool is_saturated(const EvidenceCell& cell) const {
    return cell.is_as_free_as(saturated_) && forgets_nothing();
  }
  /// What is_saturated() compares with; its log-odds (log_odds_min) mean nothing. With evidence_half_life no
  /// cell is saturated.
  [[nodiscard]] const EvidenceCell& saturated() const { return saturated_; }
  [[nodiscard]] bool forgets_nothing() const { return kept_ == 1.0; }

  /// Takes away so much evidence for free space that the log-odds is at least this, if evidence for occupied
  /// space is there. @returns whether the cell changed.
  bool raise(EvidenceCell& cell, double log_odds) const {
    if (static_cast<double>(cell.log_odds()) >= log_odds || cell.occupied_evidence() == 0) return false;
    const double most =
        (static_cast<double>(cell.occupied_evidence()) + memory_.prior()) * std::exp(-log_odds) -
        memory_.prior();
    const auto free = static_cast<std::int64_t>(std::max(0.0, most));
    if (free >= cell.free_evidence()) return false;
    memory_.assign(cell, cell.occupied_evidence(), free);
    return true;
  }
  /// Whether a cell's count of misses reaches a new power of two with a scan.
  [[nodiscard]] bool misses_double(const EvidenceCell& cell, std::uint32_t misses) const {
    const std::uint32_t after = std::min(cell.misses() + misses, memory_.free_memory_beams());
    return (cell.misses() ^ after) > cell.misses() && after > cell.misses();
  }

  // SamplingRate, ChangeDetection
  [[nodiscard]] bool uses_small_sample(const EvidenceCell& cell) const {
    return sampling_.is_well_observed(cell) && !ChangeDetection::is_doubted(cell);
  }
  [[nodiscard]] double sample_beams(bool uses_small_sample) const {
    return sampling_.sample_beams(uses_small_sample);
  }
  NDTREE_ALWAYS_INLINE void limit(ScanEvidence& scan) const { sampling_.limit(scan); }
  [[nodiscard]] bool may_limit(std::uint32_t beams) const { return sampling_.may_limit(beams); }

  // ChangeDetection
  [[nodiscard]] bool has_changed(const EvidenceCell& cell) const { return change_.has_changed(cell); }

  // ChildInitialisation. @param children_across see kChildrenAcross.
  [[nodiscard]] static bool has_evidence_for_children(const EvidenceCell& parent) {
    return ChildInitialisation::has_evidence(parent);
  }
  [[nodiscard]] EvidenceCell initial_child(const EvidenceCell& parent, int children_across,
                                           std::size_t passed, std::size_t beams, int cell_part = 0,
                                           bool part_is_child = true, bool is_finest = true) const {
    return children_.child_of(parent, memory_, children_across, passed, beams, cell_part, part_is_child,
                              is_finest);
  }
  [[nodiscard]] EvidenceCell part_of(const EvidenceCell& cell, int children_across, int cell_part) const {
    return ChildInitialisation::even_part_of(cell, memory_, children_across, cell_part);
  }

  // RemergePrediction
  [[nodiscard]] bool predicted_to_remerge(const EvidenceCell& cell, const ScanEvidence& scan,
                                          int children_across) const {
    return RemergePrediction::will_remerge(cell, scan, children_, memory_, children_across);
  }

  // EvidenceMemory
  [[nodiscard]] std::int64_t miss_evidence() const { return memory_.miss_evidence(); }
  [[nodiscard]] NDTREE_ALWAYS_INLINE float log_odds_of(std::int64_t occupied, std::int64_t free) const {
    return memory_.log_odds_of(occupied, free);
  }
  [[nodiscard]] double odds_of(const EvidenceCell& cell) const { return memory_.odds_of(cell); }
  NDTREE_ALWAYS_INLINE void assign(EvidenceCell& cell, std::int64_t occupied, std::int64_t free) const {
    memory_.assign(cell, occupied, free);
  }
  [[nodiscard]] double beams_of(std::int64_t free) const { return memory_.beams_of(free); }
  [[nodiscard]] double effective_hits(const EvidenceCell& cell) const { return memory_.effective_hits(cell); }
  [[nodiscard]] double effective_misses(const EvidenceCell& cell) const {
    return memory_.effective_misses(cell);
  }

  [[nodiscard]] double noise_sigmas() const { return noise_sigmas_; }

  /// The evidence of two cells of one place, neither of them blank. Their streaks end.
  /// @param parts the seen ones, if neither cell was observed and they are still not enough.
  [[nodiscard]] EvidenceCell joined(const EvidenceCell& one, const EvidenceCell& other,
                                    const std::optional<std::uint32_t>& parts) const {
    EvidenceCell both;
    const std::int64_t free = one.free_evidence() + other.free_evidence();
    if (parts) {
      both.set_partly_seen(*parts, std::min(free, memory_.free_memory()));
      return both;
    }
    memory_.assign(both, one.occupied_evidence() + other.occupied_evidence(), free);
    memory_.set_counts(both, one.hits() + other.hits(), one.misses() + other.misses());
    both.set_covered((one.observed() && one.is_covered()) || (other.observed() && other.is_covered()));
    both.set_known_levels(std::max(one.known_levels(), other.known_levels()));
    return both;
  }
  /// A cell whose state was given: as if n beams had certainly ended in it, or passed it, and no others, as
  /// far as a cell remembers them. All of it counts as seen.
  /// @param state free or occupied. @param beams n > 0.
  [[nodiscard]] EvidenceCell marked(CellState state, double beams) const {
    const bool is_occupied = state == CellState::occupied;
    const double of_beam =
        static_cast<double>(is_occupied ? memory_.hit_evidence() : memory_.miss_evidence());
    const auto evidence = static_cast<std::int64_t>(
        std::clamp(beams * of_beam, 1.0, static_cast<double>(EvidenceCell::kMaxEvidence)));
    const auto count =
        static_cast<std::uint32_t>(std::clamp(beams, 1.0, static_cast<double>(EvidenceCell::kMaxCount)));
    EvidenceCell cell;
    memory_.assign(cell, is_occupied ? evidence : 0, is_occupied ? 0 : evidence);
    memory_.set_counts(cell, is_occupied ? count : 0, is_occupied ? 0 : count);
    return cell;
  }
  /// Whether a cell remembers the evidence of this many beams that ended in it.
  [[nodiscard]] bool remembers_hits(double beams) const {
    return beams * static_cast<double>(memory_.hit_evidence()) <= static_cast<double>(memory_.memory());
  }
  /// A cell of a model with other options, limited to what this one remembers. With equal options it is the
  /// same cell.
  [[nodiscard]] EvidenceCell adopted(EvidenceCell cell) const {
    if (cell.observed())
      memory_.assign(cell, cell.occupied_evidence(), cell.free_evidence());
    else if (cell.is_partly_seen())
      cell.set_partly_seen(cell.seen_parts(), std::min(cell.free_evidence(), memory_.free_memory()));
    return cell;
  }

 private:
  /// Evidence for free space that a cell without other has after a scan.
  [[nodiscard]] std::int64_t free_with(const EvidenceCell& cell, const ScanEvidence& scan) const {
    return std::min(EvidenceMemory::fraction_of(cell.free_evidence(), kept_) + scan.free,
                    memory_.free_memory());
  }
  /// True if update_free() is enough for a scan whose beams all pass the cell.
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool keeps_only_free_evidence(const EvidenceCell& cell) const {
    return cell.has_only_free_evidence() && forgets_nothing();
  }
  /// update() of most cells, for which update_any() does the same.
  NDTREE_ALWAYS_INLINE bool update_free(EvidenceCell& cell, std::int64_t free, std::uint32_t misses) const {
    EvidenceCell now = cell;
    const std::int64_t all = std::min(cell.free_evidence() + free, memory_.free_memory());
    now.set_free(all, std::min(cell.misses() + misses, memory_.free_memory_beams()),
                 memory_.log_odds_of(0, all));
    return replace(cell, now);
  }
  /// update() of any cell: detects change, fades, adds, fades to what the cell remembers.
  /// @param counts_scan whether the scan goes on with a streak, or ends it.
  NDTREE_ALWAYS_INLINE bool update_any(EvidenceCell& cell, const ScanEvidence& scan,
                                       bool counts_scan = true) const {
    EvidenceCell now = cell;
    if (counts_scan) now.count_scan(scan.hits > 0, scan.misses > 0);
    if (ChangeDetection::has_contradiction(now)) now = change_.after_contradiction(now);
    std::int64_t occupied = now.occupied_evidence();
    std::int64_t free = now.free_evidence();
    if (!forgets_nothing()) {
      occupied = EvidenceMemory::fraction_of(occupied, kept_);
      free = EvidenceMemory::fraction_of(free, kept_);
    }
    occupied += scan.occupied;
    free += scan.free;
    memory_.fade(occupied, free);
    const std::uint32_t hits = now.hits() + scan.hits;
    const std::uint32_t misses = now.misses() + ChangeDetection::counted_misses(now, scan);
    const float log_odds = memory_.log_odds_of(occupied, free);
    if (occupied > 0 || scan.hits > 0) {
      now.set_evidence(occupied, free, log_odds);
      now.set_counts(hits, misses);
    } else {
      now.set_free(free, std::min(misses, memory_.free_memory_beams()), log_odds);
    }
    return replace(cell, now);
  }
  /// @returns true if the new cell differs.
  NDTREE_ALWAYS_INLINE static bool replace(EvidenceCell& cell, const EvidenceCell& now) {
    const EvidenceCell before = cell;
    cell = now;
    if (!now.has_same_evidence(before)) return true;
    return now.log_odds() != before.log_odds();  // A file may have others than those of its evidence.
  }
  [[nodiscard]] EvidenceCell make_saturated() const {
    EvidenceCell cell;
    cell.set_evidence(0, memory_.free_memory(), memory_.log_odds_min());
    cell.set_counts(0, memory_.free_memory_beams());
    return cell;
  }

  EvidenceMemory memory_;
  SamplingRate sampling_;
  ChangeDetection change_;
  ChildInitialisation children_;
  double noise_sigmas_;
  double kept_;  // Fraction of evidence kept from one scan to the next.
  EvidenceCell saturated_;
};

}  // namespace ndtree
