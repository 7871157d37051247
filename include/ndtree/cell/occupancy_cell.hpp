// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is known about one cell: log-odds of being occupied, and the histogram of hits and misses (Sec. III).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "ndtree/core/log_odds.hpp"

namespace ndtree {

/// A cell is one of these; `unknown` is no evidence, or evidence that balances exactly.
enum class CellState : std::int8_t { unknown = -1, free = 0, occupied = 1 };

[[nodiscard]] inline CellState state_of(float log_odds) {
  return log_odds > 0.0f ? CellState::occupied : log_odds < 0.0f ? CellState::free : CellState::unknown;
}

/// Counts above max_count are halved together as often as needed: their ratio stays but for rounding, which
/// is upwards, so that what was seen once is never forgotten.
inline void halve_to_fit(std::uint32_t& hits, std::uint32_t& misses, std::uint32_t max_count) {
  while (hits > max_count || misses > max_count) {
    hits = (hits + 1) / 2;
    misses = (misses + 1) / 2;
  }
}

/// Evidence of one leaf in 8 bytes. Invariant: a cell that was never updated has log-odds 0 and no counts.
class OccupancyCell {
 public:
  static constexpr bool kLeavesTopBitOfFirstWordClear = true;  // See Node.
  static constexpr int kNumWords = 2;
  static constexpr std::uint32_t kMaxCount = 0x7fff;

  [[nodiscard]] float log_odds() const { return log_odds_; }
  [[nodiscard]] double probability() const { return ndtree::probability(static_cast<double>(log_odds_)); }
  [[nodiscard]] std::uint32_t hits() const { return counts_ & kMaxCount; }
  [[nodiscard]] std::uint32_t misses() const { return (counts_ >> 15) & kMaxCount; }
  /// At least one beam updated this cell, or a cell that was merged into it.
  [[nodiscard]] bool observed() const { return (counts_ & kObserved) != 0; }
  [[nodiscard]] CellState state() const { return state_of(log_odds_); }

  /// Recursive Bayes update in log-odds, clamped (Sec. III).
  void update(float log_odds_of_measurement, float log_odds_min, float log_odds_max) {
    log_odds_ = std::clamp(log_odds_ + log_odds_of_measurement, log_odds_min, log_odds_max);
    counts_ |= kObserved;
  }
  void count_hit() { set_counts(hits() + 1, misses()); }
  void count_miss() { set_counts(hits(), misses() + 1); }

  void set_counts(std::uint32_t hits, std::uint32_t misses) {
    halve_to_fit(hits, misses, kMaxCount);
    counts_ = kObserved | misses << 15 | hits;
  }
  void set_log_odds(float log_odds) {
    log_odds_ = log_odds;
    counts_ |= kObserved;
  }

  /// The cell as words, for files; from_words() is the inverse and clears what a cell cannot hold.
  [[nodiscard]] std::array<std::uint32_t, kNumWords> words() const {
    std::array<std::uint32_t, kNumWords> words{counts_, 0};
    std::memcpy(&words[1], &log_odds_, sizeof log_odds_);
    return words;
  }
  [[nodiscard]] static OccupancyCell from_words(const std::array<std::uint32_t, kNumWords>& words) {
    OccupancyCell cell;
    cell.counts_ = words[0] & 0x7fffffffu;
    std::memcpy(&cell.log_odds_, &words[1], sizeof cell.log_odds_);
    return cell;
  }

  /// The class invariant: a cell that was never updated is all zeros.
  [[nodiscard]] bool is_consistent() const { return observed() || *this == OccupancyCell{}; }

  friend bool operator==(const OccupancyCell& a, const OccupancyCell& b) {
    return a.counts_ == b.counts_ && a.log_odds_ == b.log_odds_;
  }
  friend bool operator!=(const OccupancyCell& a, const OccupancyCell& b) { return !(a == b); }

 private:
  static constexpr std::uint32_t kObserved = 0x40000000u;
  std::uint32_t counts_ = 0;  // Bit 31 clear, bit 30 observed, 15 bits misses, 15 bits hits.
  float log_odds_ = 0.0f;
};

}  // namespace ndtree
