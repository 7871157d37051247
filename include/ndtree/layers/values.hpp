// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What cells may carry beside their occupancy: means, labels and times, each with a rule for splitting and
/// merging.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <utility>

#include "ndtree/core/option.hpp"

namespace ndtree {

// A value for Layer is any type that is trivially copyable, that is empty when it is made, and has
//   using Measurement, the number or numbers of one beam;
//   static void check(const Measurement&), which throws std::invalid_argument for what cannot be added;
//   bool is_empty() const;
//   void add(const Measurement&);
//   void join(const Value&): merging of two cells;
//   Value part(int divisor) const: splitting, the value of one of `divisor` children;
//   static std::string rule(), its name in files;
//   kNumWords, words(), from_words(): it as 32-bit words, of which the first is 0 if the value is empty, and
//     else neither 0 nor more than 2^31 - 1;
//   if it has one, using Packed, a smaller type than Measurement that holds all that check() accepts.

/// The mean of K numbers, as of a colour, with the weight of beams that it is the mean of.
template <int K>
class MeanValue {
  static_assert(K >= 1);

 public:
  using Measurement = std::array<float, std::size_t{K}>;
  static constexpr int kNumWords = 1 + K;
  /// The weight of a mean never exceeds this: from then on the oldest beams slowly fade.
  static constexpr float kMostWeight = 65536.0f;

  static void check(const Measurement& measurement) {
    for (const float x : measurement)
      if (!std::isfinite(x))
        throw std::invalid_argument(describe_number(static_cast<double>(x)) + ": must be finite");
  }
  [[nodiscard]] bool is_empty() const { return weight_ == 0.0f; }
  [[nodiscard]] float weight() const { return weight_; }
  /// @pre not is_empty().
  [[nodiscard]] const Measurement& mean() const { return mean_; }

  void add(const Measurement& measurement) {
    weight_ = std::min(weight_ + 1.0f, kMostWeight);
    const double fraction = 1.0 / static_cast<double>(weight_);
    for (std::size_t i = 0; i < K; ++i) mean_[i] = between(mean_[i], measurement[i], fraction);
  }
  void join(const MeanValue& other) {
    if (other.is_empty()) return;
    if (is_empty()) {
      *this = other;
      return;
    }
    const float sum = weight_ + other.weight_;
    const double all = static_cast<double>(weight_) + static_cast<double>(other.weight_);
    for (std::size_t i = 0; i < K; ++i)
      mean_[i] =
          static_cast<float>((static_cast<double>(weight_) * static_cast<double>(mean_[i]) +
                              static_cast<double>(other.weight_) * static_cast<double>(other.mean_[i])) /
                             all);
    weight_ = std::min(sum, kMostWeight);
  }
  [[nodiscard]] MeanValue part(int divisor) const {
    MeanValue part = *this;
    part.weight_ /= static_cast<float>(divisor);
    return part.weight_ < kLeastWeight ? MeanValue{} : part;
  }

  [[nodiscard]] static std::string rule() { return K == 1 ? "mean" : "mean" + std::to_string(K); }
  [[nodiscard]] std::array<std::uint32_t, std::size_t{kNumWords}> words() const {
    std::array<std::uint32_t, std::size_t{kNumWords}> words{};
    std::memcpy(&words[0], &weight_, sizeof weight_);
    std::memcpy(&words[1], mean_.data(), sizeof mean_);
    return words;
  }
  /// @throws std::invalid_argument if no value has these words.
  [[nodiscard]] static MeanValue from_words(const std::array<std::uint32_t, std::size_t{kNumWords}>& words) {
    MeanValue value;
    std::memcpy(&value.weight_, &words[0], sizeof value.weight_);
    std::memcpy(value.mean_.data(), &words[1], sizeof value.mean_);
    if (!(value.weight_ >= kLeastWeight && value.weight_ <= kMostWeight))
      throw std::invalid_argument("a mean with the weight " +
                                  describe_number(static_cast<double>(value.weight_)));
    check(value.mean_);
    return value;
  }

 private:
  static constexpr float kLeastWeight = 1e-6f;  // What is due to less is forgotten.

  /// from + fraction * (to - from), in double, which holds all differences of floats.
  static float between(float from, float to, double fraction) {
    const auto begin = static_cast<double>(from);
    return static_cast<float>(begin + (static_cast<double>(to) - begin) * fraction);
  }

  float weight_ = 0.0f;
  Measurement mean_{};
};

/// The label that most beams gave, with counts of up to four: one that more than a fifth of all gave is
/// among them (Misra and Gries, *Finding repeated elements*, 1982; merged as in Agarwal et al., *Mergeable
/// summaries*, 2012).
class MajorityLabel {
 public:
  using Measurement = std::int64_t;
  using Packed = std::uint16_t;
  static constexpr int kNumWords = 4;
  static constexpr std::int64_t kMaxLabel = 0xffff;
  static constexpr std::uint32_t kMaxCount = 0x7fff;

  /// A label and how many beams gave it, at least; none if the count is 0.
  struct Counted {
    std::uint16_t label = 0;
    std::uint16_t count = 0;
  };

  static void check(Measurement label) {
    if (label < 0 || label > kMaxLabel)
      throw std::invalid_argument(std::to_string(label) + ": must be a whole number in [0, " +
                                  std::to_string(kMaxLabel) + "]");
  }
  [[nodiscard]] bool is_empty() const { return counted_[0].count == 0; }
  /// The most frequent first; of equal ones, the smallest.
  [[nodiscard]] const std::array<Counted, kNumWords>& counted() const { return counted_; }
  /// @pre not is_empty().
  [[nodiscard]] std::uint16_t label() const { return counted_[0].label; }

  void add(Measurement label) {
    MajorityLabel one;
    one.counted_[0] = {static_cast<std::uint16_t>(label), 1};
    join(one);
  }
  void join(const MajorityLabel& other) {
    std::array<Both, 2 * kNumWords> both{};
    std::size_t n = 0;
    for (const MajorityLabel* const value : {static_cast<const MajorityLabel*>(this), &other}) {
      for (const Counted& one : value->counted_) {
        if (one.count == 0) break;
        std::size_t i = 0;
        while (i < n && both[i].label != one.label) ++i;
        both[i].label = one.label;
        both[i].count += one.count;
        n = std::max(n, i + 1);
      }
    }
    for (std::size_t i = 1; i < n; ++i)  // Faster than std::sort with so few.
      for (std::size_t k = i; k > 0 && MoreFrequent{}(both[k], both[k - 1]); --k)
        std::swap(both[k], both[k - 1]);
    const std::uint32_t fifth = both[kNumWords].count;  // Each pair of different labels cancels out.
    std::uint32_t most = both[0].count - fifth;
    int halvings = 0;
    for (; most > kMaxCount; most /= 2) ++halvings;
    for (std::size_t i = 0; i < kNumWords; ++i) {
      const std::uint32_t count = both[i].count > fifth ? (both[i].count - fifth) >> halvings : 0;
      counted_[i] = count > 0 ? Counted{both[i].label, static_cast<std::uint16_t>(count)} : Counted{};
    }
    std::sort(counted_.begin(), counted_.end(), MoreFrequent{});  // Halving may have made some equal.
  }
  [[nodiscard]] MajorityLabel part(int divisor) const {
    MajorityLabel part;
    if (is_empty()) return part;
    for (std::size_t i = 0; i < kNumWords; ++i) {
      const int least = i == 0 ? 1 : 0;  // The label stays.
      const int count = std::max(least, counted_[i].count / divisor);
      if (count > 0) part.counted_[i] = {counted_[i].label, static_cast<std::uint16_t>(count)};
    }
    if (part.counted_[0].count == part.counted_[1].count && part.counted_[0].count < kMaxCount)
      ++part.counted_[0].count;  // So that it stays ahead of what it was more frequent than.
    return part;
  }

  [[nodiscard]] static std::string rule() { return "majority"; }
  [[nodiscard]] std::array<std::uint32_t, std::size_t{kNumWords}> words() const {
    std::array<std::uint32_t, std::size_t{kNumWords}> words{};
    for (std::size_t i = 0; i < kNumWords; ++i)
      words[i] = static_cast<std::uint32_t>(counted_[i].count) << 16 | counted_[i].label;
    return words;
  }
  /// @throws std::invalid_argument if no value has these words.
  [[nodiscard]] static MajorityLabel from_words(
      const std::array<std::uint32_t, std::size_t{kNumWords}>& words) {
    MajorityLabel value;
    for (std::size_t i = 0; i < kNumWords; ++i) {
      value.counted_[i] = {static_cast<std::uint16_t>(words[i] & 0xffff),
                           static_cast<std::uint16_t>(words[i] >> 16)};
      if (words[i] >> 16 > kMaxCount || (i > 0 && words[i] >> 16 > words[i - 1] >> 16) ||
          (words[i] != 0 && words[i] >> 16 == 0))
        throw std::invalid_argument("labels with counts that no cell has");
    }
    if (value.is_empty()) throw std::invalid_argument("labels without a count");
    return value;
  }

 private:
  struct Both {
    std::uint16_t label = 0;
    std::uint32_t count = 0;
  };
  struct MoreFrequent {
    template <class T>
    bool operator()(const T& a, const T& b) const {
      return a.count != b.count ? a.count > b.count : a.label < b.label;
    }
  };

  std::array<Counted, kNumWords> counted_{};
};

/// The latest time [s].
class LatestStamp {
 public:
  using Measurement = double;
  static constexpr int kNumWords = 3;

  static void check(Measurement stamp) {
    if (!std::isfinite(stamp)) throw std::invalid_argument(describe_number(stamp) + ": must be finite");
  }
  [[nodiscard]] bool is_empty() const { return has_stamp_ == 0; }
  /// @pre not is_empty().
  [[nodiscard]] double stamp() const { return stamp_; }

  void add(Measurement stamp) {
    stamp_ = is_empty() ? stamp : std::max(stamp_, stamp);
    has_stamp_ = 1;
  }
  void join(const LatestStamp& other) {
    if (!other.is_empty()) add(other.stamp_);
  }
  [[nodiscard]] LatestStamp part(int /*divisor*/) const { return *this; }

  [[nodiscard]] static std::string rule() { return "latest"; }
  [[nodiscard]] std::array<std::uint32_t, std::size_t{kNumWords}> words() const {
    std::array<std::uint32_t, std::size_t{kNumWords}> words{has_stamp_};
    if (!is_empty()) std::memcpy(&words[1], &stamp_, sizeof stamp_);
    return words;
  }
  /// @throws std::invalid_argument if no value has these words.
  [[nodiscard]] static LatestStamp from_words(
      const std::array<std::uint32_t, std::size_t{kNumWords}>& words) {
    if (words[0] != 1) throw std::invalid_argument("a time that no cell has");
    double stamp = 0.0;
    std::memcpy(&stamp, &words[1], sizeof stamp);
    check(stamp);
    LatestStamp value;
    value.add(stamp);
    return value;
  }

 private:
  double stamp_ = 0.0;
  std::uint32_t has_stamp_ = 0;
};

}  // namespace ndtree
