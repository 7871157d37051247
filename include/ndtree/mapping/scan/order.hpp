// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order of a scan's beams, by face and chance, found by several threads at once.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace ndtree {

/// A beam that some cell may take.
struct KeptBeam {
  std::uint32_t face;    ///< By its number, see ScanUpdate.
  std::uint32_t chance;  ///< See chance_of().
  std::uint32_t number;  ///< In the scan.

  [[nodiscard]] friend bool operator<(const KeptBeam& a, const KeptBeam& b) {
    return a.face != b.face ? a.face < b.face : a.chance < b.chance;
  }
};

/// Buckets of beams of one face and similar chances, in the order of beams: each thread counts what it has
/// for each, then puts its beams where they belong, and only buckets must be sorted.
class BeamBuckets {
 public:
  /// @param num_faces not more than one more than `beams`. @param largest chance; of dense scans, only small
  /// ones are kept.
  BeamBuckets(std::size_t num_faces, std::size_t beams, std::uint32_t largest) {
    constexpr std::size_t kBeamsOfBucket = 4;
    while ((num_faces << (bits_ + 1)) * kBeamsOfBucket <= beams) ++bits_;
    while ((largest >> shift_) >> bits_ != 0) ++shift_;
    begins_.assign((num_faces << bits_) + 1, 0);
  }

  [[nodiscard]] std::size_t count() const { return begins_.size() - 1; }
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t chance) const {
    return (static_cast<std::size_t>(face) << bits_) + (chance >> shift_);
  }

  /// Lets each part's beams of a bucket follow those of the part before.
  /// @param places of each part and bucket, how many beams; then, where the first of them belongs.
  void begin(std::vector<std::vector<std::uint32_t>>& places) {
    std::uint32_t begin = 0;
    for (std::size_t b = 0; b < count(); ++b) {
      begins_[b] = begin;
      for (std::vector<std::uint32_t>& of_part : places) {
        const std::uint32_t size = of_part[b];
        of_part[b] = begin;
        begin += size;
      }
    }
    begins_.back() = begin;
  }

  /// The first beam of the first bucket that begins at this beam or behind it.
  [[nodiscard]] std::size_t next_begin(std::size_t beam) const {
    return *std::lower_bound(begins_.begin(), begins_.end(), beam);
  }
  /// Sorts beams from the begin of one bucket to that of another.
  void sort(std::vector<KeptBeam>& beams, std::size_t first, std::size_t last) const {
    auto begin = std::lower_bound(begins_.begin(), begins_.end(), first);
    for (; first < last; first = *begin) {
      ++begin;
      if (*begin - first > 1)
        std::sort(beams.begin() + static_cast<std::ptrdiff_t>(first), beams.begin() + *begin);
    }
  }

 private:
  int bits_ = 0;
  int shift_ = 0;
  std::vector<std::uint32_t> begins_;  // Of each bucket, and the end of the last.
};

}  // namespace ndtree
