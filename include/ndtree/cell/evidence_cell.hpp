// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is known about one cell when the evidence for and against occupied space is kept apart, and its
/// options.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Two options, and constants of the method (kOptionTable says where they come from).
struct EvidenceOptions {
  double sample_beams = 0.5;  ///< A well observed cell samples this many beams of a scan per smallest cell
                              ///< side by side in it, any other cell, and one that the last beams
                              ///< contradict, 5 times as many.
  double evidence_half_life = 0.0;  ///< Scans of a cell after which its evidence has halved; 0: never.

  double evidence_memory = 200.0;  ///< Evidence that a cell remembers at most; older evidence fades [nats].
  double free_memory = 50.0;       ///< Evidence for free space that a cell without other remembers [nats].
  double scan_beams = 64.0;      ///< Beams of one scan that count at most in a cell that all of them passed.
  double known_evidence = 50.0;  ///< A cell with this much evidence is well observed [nats].
  double evidence_prior = 0.5;   ///< Evidence of both kinds that every cell begins with [nats].
  double inherited_beams = 2.0;  ///< Evenly spread beams added to a scan's where a split divides evidence.
  /// A streak of scans less likely than this is a change, in a well observed cell; 0: never.
  double change_probability = 1e-5;
  /// No hit or miss splits a cell into children smaller than this many standard deviations. Coverage may, to
  /// separate seen from unseen space.
  double noise_sigmas = 1.0;
};

/// The evidence of a scan's beams that all passed a cell, or parts of it without return: for free space only.
struct PassedEvidence {
  std::int64_t free = 0;                ///< In units of EvidenceCell::kUnit.
  std::uint32_t misses = 0;             ///< See ScanEvidence.
  std::uint32_t resolvable_misses = 0;  ///< Misses of small noise, see ScanEvidence.

  static constexpr std::uint32_t ends_before = 0;  ///< See ScanEvidence.

  [[nodiscard]] static bool is_free_alone() { return true; }
  [[nodiscard]] bool has_only_passed() const { return misses > 0; }
};

/// The evidence of one scan for one cell: sums, so that the order of beams does not matter.
struct ScanEvidence {
  std::int64_t occupied = 0;  ///< For occupied space, in units of EvidenceCell::kUnit.
  std::int64_t free = 0;      ///< For free space, in the same units.
  std::uint32_t hits = 0;     ///< Beams that ended in the cell.
  std::uint32_t misses = 0;   ///< Beams that passed it, or, without return, the part up to their end.
  // Hits, and misses that are clearly free or without return, of beams for which a child's edge is at least
  // noise_sigmas standard deviations, and of hits the beam's width. A miss within the noise of its end point
  // is not resolvable.
  std::uint32_t resolvable_hits = 0;
  std::uint32_t resolvable_misses = 0;
  /// Hits of small noise that are evidence for a part of the cell only: behind a free way of more than 3
  /// sigma through the cell, or any in a cell with an edge of more than 3 sigma.
  std::uint32_t partial_hits = 0;
  std::uint32_t beams = 0;  ///< Beams with any evidence for the cell.
  /// Other beams that ended before the cell, by less than three standard deviations: it is too coarse to take
  /// their evidence.
  std::uint32_t ends_before = 0;

  /// Whether no beam is evidence for occupied space.
  [[nodiscard]] bool is_free_alone() const { return hits == 0 && occupied == 0; }
  /// Whether beams passed the cell, and none ended in it.
  [[nodiscard]] bool has_only_passed() const { return hits == 0 && misses > 0; }
  /// Adds the evidence of beams that passed the cell.
  void add(const PassedEvidence& passed) {
    free += passed.free;
    misses += passed.misses;
    resolvable_misses += passed.resolvable_misses;
    beams += passed.misses;
  }
  /// Adds the evidence of other beams.
  void add(const ScanEvidence& others) {
    occupied += others.occupied;
    free += others.free;
    hits += others.hits;
    misses += others.misses;
    resolvable_hits += others.resolvable_hits;
    resolvable_misses += others.resolvable_misses;
    partial_hits += others.partial_hits;
    beams += others.beams;
    ends_before += others.ends_before;
  }
  [[nodiscard]] static const ScanEvidence& of(const ScanEvidence& scan) { return scan; }
  [[nodiscard]] static ScanEvidence of(const PassedEvidence& passed) {
    ScanEvidence scan;
    scan.add(passed);
    return scan;
  }
};

/// Evidence of one leaf in 12 bytes: log-odds weights of all that was for occupied and of all that was for
/// free, the counts of hits and misses, and for how many scans all beams have said the same. The log-odds is
/// a function of the two sums (see EvidenceMemory) and is kept beside them because queries want nothing else.
/// Invariant: a cell that was never updated is all zeros. One that is but partly seen has no counts and
/// log-odds of 0.
class EvidenceCell {
 public:
  static constexpr bool kLeavesTopBitOfFirstWordClear = true;  // See Node.
  static constexpr int kNumWords = 3;
  static constexpr std::uint32_t kMaxCount = 0x1ff;
  static constexpr std::uint32_t kMaxStreak = 0x1f;
  static constexpr std::uint32_t kMaxKnownLevels = 7;
  /// Evidence is counted in these steps [nats]: whole numbers, so that sums do not depend on their order.
  static constexpr double kUnit = 1.0 / 256.0;
  static constexpr std::int64_t kMaxEvidence = 0xffff;

  [[nodiscard]] float log_odds() const { return log_odds_; }
  [[nodiscard]] double probability() const { return ndtree::probability(static_cast<double>(log_odds_)); }
  [[nodiscard]] CellState state() const { return state_of(log_odds_); }
  [[nodiscard]] bool observed() const { return (counts_ & kObserved) != 0; }
  [[nodiscard]] std::uint32_t hits() const { return counts_ & kMaxCount; }
  [[nodiscard]] std::uint32_t misses() const { return (counts_ >> 9) & kMaxCount; }
  /// Evidence for occupied and for free space, in kUnit.
  [[nodiscard]] std::int64_t occupied_evidence() const { return is_partly_seen() ? 0 : evidence_ >> 16; }
  [[nodiscard]] std::int64_t free_evidence() const { return evidence_ & kMaxEvidence; }

  NDTREE_ALWAYS_INLINE void set_counts(std::uint32_t hits, std::uint32_t misses) {
    if (hits == 0) misses = std::min(misses, kMaxCount);  // There is no ratio to keep.
    halve_to_fit(hits, misses, kMaxCount);
    counts_ = (counts_ & (kStreakBits | kCoverageBits)) | kObserved | misses << 9 | hits;
  }
  /// Consecutive scans whose beams all ended in the cell, or all passed it; up to kMaxStreak.
  [[nodiscard]] std::uint32_t streak() const { return (counts_ >> 18) & kMaxStreak; }
  [[nodiscard]] bool streak_is_of_hits() const { return (counts_ & kStreakOfHits) != 0; }
  NDTREE_ALWAYS_INLINE void count_scan(bool any_hits, bool any_misses) {
    if (!any_hits && !any_misses) return;
    // Without a branch, which would be unpredictable.
    const std::uint32_t kind = any_hits * kStreakOfHits;
    const std::uint32_t goes_on = ((counts_ ^ kind) & kStreakOfHits) - 1;  // Top bit: the kind is the same.
    const std::uint32_t before = counts_ & kLongestStreak & (0u - (goes_on >> 31));
    const std::uint32_t length = std::min(before + kOneScan, kLongestStreak);
    counts_ = (counts_ & ~kStreakBits) | kind | (length & (0u - std::uint32_t{any_hits != any_misses}));
  }
  /// Goes on with another cell's streak of scans that passed it.
  /// @pre observed(), not blank.
  void set_streak_of_passes(std::uint32_t scans) {
    counts_ = (counts_ & ~kStreakBits) | std::min(scans, kMaxStreak) * kOneScan;
  }
  /// Whether beams have passed parts of the cell, but not enough of it: it is not observed yet, and only
  /// keeps which parts were seen, and the evidence for free space in them.
  [[nodiscard]] bool is_partly_seen() const { return (counts_ & kPartlySeen) != 0; }
  /// One bit for each part that was seen. @pre is_partly_seen() or never updated.
  [[nodiscard]] std::uint32_t seen_parts() const { return evidence_ >> 16; }
  /// @param parts the seen ones, maybe none. @param free evidence, in [0, kMaxEvidence].
  /// @pre not observed().
  void set_partly_seen(std::uint32_t parts, std::int64_t free) {
    counts_ = kPartlySeen;
    evidence_ = word_of(parts, free);
  }
  /// Whether the cell is not known to be partly unseen: then its evidence holds for each child. Also true of
  /// cells that coverage was not asked about, as one that a hit observed first.
  [[nodiscard]] bool is_covered() const { return (counts_ & kNotCovered) == 0; }
  /// observed() and is_covered(): coverage has nothing more to say of the cell.
  [[nodiscard]] bool is_fully_observed() const { return (counts_ & (kObserved | kNotCovered)) == kObserved; }
  /// @pre observed(), or is about to be.
  void set_covered(bool is_covered) { counts_ = (counts_ & ~kNotCovered) | (is_covered ? 0u : kNotCovered); }
  /// On how many levels below the cell all descendants were seen: a scan saw all of the cell, or they were
  /// observed before they merged; up to kMaxKnownLevels. 0 of a cell that is not observed.
  [[nodiscard]] std::uint32_t known_levels() const { return (counts_ & kKnownLevels) / kOneKnownLevel; }
  /// @param levels more than kMaxKnownLevels count as that.
  void set_known_levels(std::uint32_t levels) {
    counts_ = (counts_ & ~kKnownLevels) | std::min(levels, kMaxKnownLevels) * kOneKnownLevel;
  }
  /// @pre both are in [0, kMaxEvidence], and log_odds is what the model makes of them.
  void set_evidence(std::int64_t occupied, std::int64_t free, float log_odds) {
    evidence_ = word_of(occupied, free);
    log_odds_ = log_odds;
    counts_ = (counts_ & ~kPartlySeen) | kObserved;
  }

  /// Whether a cell that is observed or blank has no evidence for occupied space, and no hits.
  [[nodiscard]] bool has_only_free_evidence() const {
    return (counts_ & (kPartlySeen | kMaxCount)) == 0 && evidence_ <= kMaxEvidence;
  }
  /// Sets evidence for free space only: no streak could contradict it. @pre misses <= kMaxCount; else as
  /// set_evidence().
  void set_free(std::int64_t free, std::uint32_t misses, float log_odds) {
    counts_ = (counts_ & kCoverageBits) | kObserved | misses << 9;
    evidence_ = static_cast<std::uint32_t>(free);
    log_odds_ = log_odds;
  }

  /// The cell as words, for files; from_words() is the inverse and clears what a cell cannot hold.
  [[nodiscard]] std::array<std::uint32_t, kNumWords> words() const {
    std::array<std::uint32_t, kNumWords> words{counts_, 0, evidence_};
    std::memcpy(&words[1], &log_odds_, sizeof log_odds_);
    return words;
  }
  [[nodiscard]] static EvidenceCell from_words(const std::array<std::uint32_t, kNumWords>& words) {
    EvidenceCell cell;
    cell.counts_ =
        words[0] & (kObserved | kPartlySeen | kCoverageBits | kStreakBits | kMaxCount << 9 | kMaxCount);
    if (cell.observed()) cell.counts_ &= ~kPartlySeen;
    std::memcpy(&cell.log_odds_, &words[1], sizeof cell.log_odds_);
    cell.evidence_ = words[2];
    return cell;
  }

  /// The class invariant: of a cell that was not observed, nothing is known but what was seen of it.
  [[nodiscard]] bool is_consistent() const {
    if (observed()) return !is_partly_seen();
    return (counts_ & ~kPartlySeen) == 0 && log_odds_ == 0.0f && (is_partly_seen() || evidence_ == 0);
  }

  /// Equal but for the log-odds, which follows from the rest.
  [[nodiscard]] bool has_same_evidence(const EvidenceCell& other) const {
    return counts_ == other.counts_ && evidence_ == other.evidence_;
  }

  /// Whether both cells are equal but for log-odds and coverage.
  [[nodiscard]] bool is_as_free_as(const EvidenceCell& other) const {
    return ((counts_ ^ other.counts_) & kComparedBits) == 0 && evidence_ == other.evidence_;
  }
  /// The first word without what is_as_free_as() does not compare.
  static constexpr std::uint32_t kComparedBits = ~0x0f000000u;

  friend bool operator==(const EvidenceCell& a, const EvidenceCell& b) {
    return a.has_same_evidence(b) && a.log_odds_ == b.log_odds_;
  }
  friend bool operator!=(const EvidenceCell& a, const EvidenceCell& b) { return !(a == b); }

 private:
  [[nodiscard]] static std::uint32_t word_of(std::int64_t upper, std::int64_t lower) {
    return static_cast<std::uint32_t>(upper) << 16 | static_cast<std::uint32_t>(lower);
  }

  static constexpr std::uint32_t kObserved = 0x40000000u;
  static constexpr std::uint32_t kPartlySeen = 0x20000000u;
  static constexpr std::uint32_t kNotCovered = 0x01000000u;
  static constexpr std::uint32_t kOneKnownLevel = 0x02000000u;
  static constexpr std::uint32_t kKnownLevels = kMaxKnownLevels * kOneKnownLevel;
  static constexpr std::uint32_t kCoverageBits = ~kComparedBits;
  static constexpr std::uint32_t kStreakOfHits = 0x00800000u;
  static constexpr std::uint32_t kOneScan = 1u << 18;  // Of a streak.
  static constexpr std::uint32_t kLongestStreak = kMaxStreak * kOneScan;
  static constexpr std::uint32_t kStreakBits = kStreakOfHits | kLongestStreak;
  // From bit 0: 9 bits hits, 9 bits misses, 5 bits streak, 1 bit kind of streak, 1 bit not covered, 3 bits
  // known levels; bit 29 partly seen, bit 30 observed, never both.
  std::uint32_t counts_ = 0;
  float log_odds_ = 0.0f;
  // Upper half for occupied space, or the parts that were seen, as long as it is partly seen; lower for free.
  std::uint32_t evidence_ = 0;
};

}  // namespace ndtree
