// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How likely a cell is entirely free, entirely occupied, or partially occupied (Sec. III-A and V).
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

#include "ndtree/cell/split_test.hpp"
#include "ndtree/core/beta.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/shared_table.hpp"

namespace ndtree {

/// Probabilities of what a cell may be; they add up to 1.
struct OccupancyHypotheses {
  double free = 0.0;
  double occupied = 0.0;
  double partial = 0.0;
};

/// Posterior of the three hypotheses, given how many beams ended in the cell and how many passed it.
///
/// Beams that reach the cell end in it with an unknown probability rho, independently of each other. The cell
/// is entirely free if rho is at most hit_given_free, entirely occupied if it is at least
/// 1 - miss_given_occupied, and partially occupied between; the three are equally likely beforehand, and rho
/// is uniform within each. The evidence of an interval [u, v] is then
///   (1 / (v - u)) * integral of rho^h (1 - rho)^m over [u, v], proportional to
///   (I_v(h + 1, m + 1) - I_u(h + 1, m + 1)) / (v - u),
/// I being the incomplete beta function: beta-binomial evidence, truncated. Unlike a point hypothesis, an
/// interval does not reject counts that are cleaner than the error rates predict.
///
/// Where in the cell a beam ended enters through the counts: a partial hit, see ScanEvidence, counts as a hit
/// and as a miss, since a part of the cell is probably free.
class PartialOccupancyModel {
 public:
  /// @throws std::invalid_argument if the error rates leave no room for partially occupied cells.
  explicit PartialOccupancyModel(const SplitOptions& options)
      : free_until_(options.hit_given_free),
        occupied_from_(1.0 - options.miss_given_occupied),
        below_(free_until_),
        above_(1.0 - occupied_from_) {
    if (!(free_until_ < occupied_from_))
      throw OptionError("hit_given_free", describe_number(options.hit_given_free), "less than 1 - ",
                        "miss_given_occupied");
  }

  [[nodiscard]] OccupancyHypotheses operator()(std::uint32_t hits, std::uint32_t misses) const {
    const double a = hits + 1.0;
    const double b = misses + 1.0;
    const double log_beta = quick_log_beta(a, b);
    const double below = below_(a, b, log_beta);
    const double above = above_(b, a, log_beta);  // 1 - I, without cancellation.
    OccupancyHypotheses evidence;
    evidence.free = below / free_until_;
    evidence.occupied = above / (1.0 - occupied_from_);
    evidence.partial = std::max(0.0, 1.0 - below - above) / (occupied_from_ - free_until_);
    const double sum = evidence.free + evidence.occupied + evidence.partial;
    return {evidence.free / sum, evidence.occupied / sum, evidence.partial / sum};
  }

  /// Of the beams that reach a free cell, at most this fraction ends there.
  [[nodiscard]] double free_until() const { return free_until_; }

 private:
  double free_until_;
  double occupied_from_;
  QuickIncompleteBeta below_;
  QuickIncompleteBeta above_;
};

/// Whether an occupied cell is one that splits: if partial occupancy is more probable than
/// `split_probability`. Answers are
/// remembered, because cells at a surface ask for the same counts again and again; maps of the same options
/// remember them together.
class PartialOccupancySplitTest {
 public:
  /// @throws as PartialOccupancyModel.
  explicit PartialOccupancySplitTest(const SplitOptions& options)
      : model_(options), split_probability_(options.split_probability), answers_(answers_for(options)) {}

  /// @returns the same from any thread, at any time.
  [[nodiscard]] bool operator()(std::uint32_t hits, std::uint32_t misses) const {
    if (hits >= kRemembered || misses >= kRemembered) return ask(hits, misses);
    const std::uint32_t place = hits * kRemembered + misses;
    std::atomic<std::uint8_t>& answers = (*answers_)[place / kInByte];
    const std::uint32_t shift = place % kInByte * kBits;
    const unsigned known = unsigned{answers.load(std::memory_order_relaxed)} >> shift & kMask;
    if (known != kNotAsked) return known == kYes;
    const bool splits = ask(hits, misses);
    answers.fetch_or(static_cast<std::uint8_t>((splits ? kYes : kNo) << shift), std::memory_order_relaxed);
    return splits;
  }
  [[nodiscard]] const PartialOccupancyModel& model() const { return model_; }

 private:
  static constexpr std::uint32_t kRemembered = 512;  // Hits, and misses, as many as cells count: 64 kB.
  static constexpr std::uint32_t kBits = 2;          // Of an answer.
  static constexpr std::uint32_t kInByte = 8 / kBits;
  static constexpr unsigned kMask = 3;
  enum Answer : std::uint8_t { kNotAsked, kYes, kNo };
  using Answers = std::array<std::atomic<std::uint8_t>, std::size_t{kRemembered} * kRemembered / kInByte>;

  [[nodiscard]] bool ask(std::uint32_t hits, std::uint32_t misses) const {
    return model_(hits, misses).partial > split_probability_;
  }
  [[nodiscard]] static std::shared_ptr<Answers> answers_for(const SplitOptions& options) {
    return shared_table<Answers>(
        std::array<double, 3>{options.hit_given_free, options.miss_given_occupied, options.split_probability},
        [] { return std::make_shared<Answers>(); });
  }

  PartialOccupancyModel model_;
  double split_probability_;
  std::shared_ptr<Answers> answers_;
};

}  // namespace ndtree
