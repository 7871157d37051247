// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A cell's two sums of evidence: their log-odds, and how much of them a cell remembers.
#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/shared_table.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// log(evidence + prior) less a constant, for evidence in [0, EvidenceCell::kMaxEvidence]: one by one up to
/// 64 nats, else at every 16th. One table of 76 kB for all models of a prior. Larger
/// evidence has a larger one, however little larger, and differences are within 1e-6 where the prior is at
/// least 0.01 nats. (For less, within 2e-6 where one of the two is no evidence.)
class EvidenceLogs {
 public:
  /// @param prior > 0, in EvidenceCell::kUnit.
  explicit EvidenceLogs(double prior) {
    const double inverse = 1.0 / std::max(prior, kMuch);
    for (std::size_t i = 0; i < logs_.size(); ++i)
      logs_[i] = static_cast<float>(quick_log((static_cast<double>(i) + prior) * inverse));
    for (std::size_t i = 0; i < of_many_.size(); ++i) {
      // Between two points of a logarithm a straight line is too low by up to an eighth of this, squared.
      const double evidence = static_cast<double>(kInTable + static_cast<std::int64_t>(i) * kStep) + prior;
      const double bend = kStep / evidence;
      of_many_[i] = static_cast<float>(quick_log(evidence * inverse) + bend * bend / 16.0);
    }
  }
  [[nodiscard]] static std::shared_ptr<const EvidenceLogs> of_prior(double prior) {
    return shared_table<const EvidenceLogs>(prior,
                                            [&] { return std::make_shared<const EvidenceLogs>(prior); });
  }

  /// @pre evidence is in [0, EvidenceCell::kMaxEvidence].
  [[nodiscard]] NDTREE_ALWAYS_INLINE float operator[](std::int64_t evidence) const {
    assert(evidence >= 0 && evidence <= EvidenceCell::kMaxEvidence);
    return evidence < kInTable ? logs_[static_cast<std::size_t>(evidence)] : of_many(evidence);
  }

 private:
  // The logarithms of much evidence, which are closest together, are near 0, and so told apart best.
  static constexpr double kMuch = 16.0 / EvidenceCell::kUnit;
  static constexpr std::int64_t kInTable = 1 << 14;
  static constexpr std::int64_t kStep = 16;  // Of larger evidence; in between, straight lines within 1e-7.

  [[nodiscard]] NDTREE_ALWAYS_INLINE float of_many(std::int64_t evidence) const {
    const auto step = static_cast<std::size_t>((evidence - kInTable) / kStep);
    const float below = of_many_[step];
    return below +
           unfused(static_cast<float>(evidence % kStep) * (1.0f / kStep) * (of_many_[step + 1] - below));
  }

  std::array<float, std::size_t{kInTable}> logs_;
  std::array<float, std::size_t{(EvidenceCell::kMaxEvidence + 1 - kInTable) / kStep + 1}> of_many_;
};

/// Turns a cell's evidence E+ (for occupied) and E- (for free) into log-odds,
///   log((E+ + prior) / (E- + prior)), within [log_odds_min, log_odds_max],
/// and limits both to what a cell remembers: together to evidence_memory nats, by fading both alike, so that
/// the ratio stays and the oldest evidence is forgotten first; E- alone to free_memory nats.
///
/// A recursive Bayes update adds up E+ - E-, and must clamp the sum so that a cell can change its state; the
/// clamp forgets how *often* a cell was passed and hit, and then a few grazing beams or wrong hits tip it.
/// The ratio keeps the fraction of beams that end in the cell, the posterior mean of rho under a Beta prior
/// (see PartialOccupancyModel), and its logarithm is 0 where the unclamped sum is 0: the same sensor model,
/// without loss of memory. All evidence is in EvidenceCell::kUnit. Every function is O(1).
class EvidenceMemory {
 public:
  EvidenceMemory(const EvidenceOptions& options, const SensorOptions& sensor)
      : log_odds_min_(static_cast<float>(sensor.log_odds_min)),
        log_odds_max_(static_cast<float>(sensor.log_odds_max)),
        odds_min_(std::exp(sensor.log_odds_min)),
        odds_max_(std::exp(sensor.log_odds_max)),
        prior_(options.evidence_prior / EvidenceCell::kUnit),
        logs_(EvidenceLogs::of_prior(prior_)),
        hit_nats_(ndtree::log_odds(sensor.probability_max)),
        miss_units_(units(-ndtree::log_odds(sensor.probability_min))),
        memory_(units(options.evidence_memory)),
        free_memory_(units(std::min(options.free_memory, options.evidence_memory))),
        free_memory_beams_(static_cast<std::uint32_t>(
            std::clamp<std::int64_t>(free_memory_ / miss_units_, 1, EvidenceCell::kMaxCount))) {}

  /// Evidence for free space from a beam that passed a cell on a way of mean length.
  [[nodiscard]] std::int64_t miss_evidence() const { return miss_units_; }
  /// Evidence for occupied space from a beam that certainly ended in the cell.
  [[nodiscard]] std::int64_t hit_evidence() const { return units(hit_nats_); }
  [[nodiscard]] double prior() const { return prior_; }
  /// Evidence that a cell remembers at most.
  [[nodiscard]] std::int64_t memory() const { return memory_; }
  /// Evidence for free space that a cell remembers at most while it has no other.
  [[nodiscard]] std::int64_t free_memory() const { return free_memory_; }
  /// The misses that are worth free_memory(), at most EvidenceCell::kMaxCount.
  [[nodiscard]] std::uint32_t free_memory_beams() const { return free_memory_beams_; }
  [[nodiscard]] float log_odds_min() const { return log_odds_min_; }

  /// @pre both are in [0, EvidenceCell::kMaxEvidence].
  [[nodiscard]] NDTREE_ALWAYS_INLINE float log_odds_of(std::int64_t occupied, std::int64_t free) const {
    return std::clamp((*logs_)[occupied] - (*logs_)[free], log_odds_min_, log_odds_max_);
  }
  /// The odds that a cell is occupied: exp(log-odds), but for rounding. 1 if it was never observed.
  [[nodiscard]] double odds_of(const EvidenceCell& cell) const {
    if (!cell.observed()) return 1.0;
    return std::clamp((static_cast<double>(cell.occupied_evidence()) + prior_) /
                          (static_cast<double>(cell.free_evidence()) + prior_),
                      odds_min_, odds_max_);
  }
  /// Beams that pass a cell that are worth this evidence for free space.
  [[nodiscard]] double beams_of(std::int64_t free) const {
    return static_cast<double>(free) / static_cast<double>(miss_units_);
  }
  /// Beams that a cell's evidence is worth: ending in it, and passing it.
  [[nodiscard]] double effective_hits(const EvidenceCell& cell) const {
    return static_cast<double>(cell.occupied_evidence()) * EvidenceCell::kUnit / hit_nats_;
  }
  [[nodiscard]] double effective_misses(const EvidenceCell& cell) const {
    return beams_of(cell.free_evidence());
  }

  /// Fades evidence to what a cell remembers: the ratio stays, but for rounding down.
  NDTREE_ALWAYS_INLINE void fade(std::int64_t& occupied, std::int64_t& free) const {
    if (occupied == 0) free = std::min(free, free_memory_);
    const std::int64_t sum = occupied + free;
    if (sum <= memory_) return;
    occupied = faded(occupied, memory_, sum);
    free = faded(free, memory_, sum);
  }
  /// Sets a cell's evidence, faded to what it remembers, and its log-odds.
  NDTREE_ALWAYS_INLINE void assign(EvidenceCell& cell, std::int64_t occupied, std::int64_t free) const {
    fade(occupied, free);
    cell.set_evidence(occupied, free, log_odds_of(occupied, free));
  }
  /// Sets the counts of a cell whose evidence is set: without evidence for occupied space it keeps no hits.
  NDTREE_ALWAYS_INLINE void set_counts(EvidenceCell& cell, std::uint32_t hits, std::uint32_t misses) const {
    if (cell.occupied_evidence() > 0)
      cell.set_counts(hits, misses);
    else
      cell.set_counts(0, std::min(misses, free_memory_beams_));
  }

  /// A fraction in [0, 1] of evidence or counts, rounded down.
  [[nodiscard]] static std::int64_t fraction_of(std::int64_t whole, double fraction) {
    return static_cast<std::int64_t>(static_cast<double>(whole) * fraction);
  }
  /// The fraction rounded up: what was seen once is not forgotten.
  [[nodiscard]] static std::int64_t fraction_of_rounded_up(std::int64_t whole, double fraction) {
    return whole - fraction_of(whole, 1.0 - fraction);
  }
  [[nodiscard]] static std::int64_t units(double nats) { return std::llround(nats / EvidenceCell::kUnit); }

 private:
  /// part * whole / sum, rounded down: evidence that nothing is added to fades to 0. Exact below 2^53, as
  /// quotients are then farther from whole numbers than their rounding error.
  [[nodiscard]] static std::int64_t faded(std::int64_t part, std::int64_t whole, std::int64_t sum) {
    return static_cast<std::int64_t>(static_cast<double>(part * whole) / static_cast<double>(sum));
  }

  float log_odds_min_;
  float log_odds_max_;
  double odds_min_;
  double odds_max_;
  double prior_;
  std::shared_ptr<const EvidenceLogs> logs_;
  double hit_nats_;  // [nats]
  std::int64_t miss_units_;
  std::int64_t memory_;
  std::int64_t free_memory_;
  std::uint32_t free_memory_beams_;
};

}  // namespace ndtree
