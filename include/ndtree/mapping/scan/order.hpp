// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order of a scan's beams, by face and chance, found by several threads at once.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace ndtree {

/// A beam that some cell may take.
struct KeptBeam {
  std::uint32_t chance;  ///< See chance_of().
  std::uint32_t face;    ///< By its number, see ScanUpdate.
  std::uint32_t number;  ///< In the scan.

  /// In the order of beams; some may share one.
  [[nodiscard]] std::uint64_t place() const { return std::uint64_t{face} << 32 | chance; }
  [[nodiscard]] friend bool operator<(const KeptBeam& a, const KeptBeam& b) { return a.place() < b.place(); }
};

/// Buckets of beams of one face and similar chances, in the order of beams: each thread counts what it has
/// for each, then puts its beams where they belong, and only buckets must be sorted. Most hold a
/// few, so that sorting moves none far.
class BeamBuckets {
 public:
  /// @param ends_of_faces up to each face, how many beams there are. @param largest chance; of dense scans,
  /// only small ones are kept.
  BeamBuckets(const std::vector<std::uint32_t>& ends_of_faces, std::uint32_t largest) {
    int bits = 0;
    while (largest >> bits != 0) ++bits;
    faces_.reserve(ends_of_faces.size());
    std::size_t first = 0;
    std::uint32_t begin = 0;
    for (const std::uint32_t end : ends_of_faces) {
      const std::uint32_t beams = end - std::exchange(begin, end);
      int shift = bits;
      while (shift > 0 && (std::size_t{largest} >> (shift - 1)) < beams / 2) --shift;
      faces_.push_back({first, shift});
      first += beams == 0 ? 0 : (largest >> shift) + 1;
    }
    begins_.assign(first + 1, 0);
  }

  [[nodiscard]] std::size_t count() const { return begins_.size() - 1; }
  /// @param face with some beams.
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t chance) const {
    return faces_[face].first + (chance >> faces_[face].shift);
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
      most_in_bucket_ = std::max(most_in_bucket_, begin - begins_[b]);
    }
    begins_.back() = begin;
  }

  /// The first beam of the first bucket that begins at this beam or behind it.
  [[nodiscard]] std::size_t next_begin(std::size_t beam) const {
    return *std::lower_bound(begins_.begin(), begins_.end(), beam);
  }
  /// Sorts beams from the begin of one bucket to that of another.
  void sort(KeptBeam* beams, std::size_t first, std::size_t last) const {
    if (most_in_bucket_ > kMostToInsert) {
      sort_buckets(beams, first, last);
      return;
    }
    for (std::size_t i = first + 1; i < last; ++i) {
      if (!(beams[i] < beams[i - 1])) continue;
      const KeptBeam beam = beams[i];
      std::size_t to = i;
      do {
        beams[to] = beams[to - 1];
      } while (--to > first && beam < beams[to - 1]);
      beams[to] = beam;
    }
  }

 private:
  static constexpr std::uint32_t kMostToInsert = 32;  // Beams, one by one, where they belong in a bucket.
  struct Face {
    std::size_t first;  // Of its buckets.
    int shift;          // Of chances.
  };

  void sort_buckets(KeptBeam* beams, std::size_t first, std::size_t last) const {
    auto begin = std::lower_bound(begins_.begin(), begins_.end(), first);
    for (; first < last; first = *begin) {
      ++begin;
      if (*begin - first > 1) std::sort(beams + first, beams + *begin);
    }
  }

  std::vector<Face> faces_;
  std::vector<std::uint32_t> begins_;  // Of each bucket, and the end of the last.
  std::uint32_t most_in_bucket_ = 0;
};

}  // namespace ndtree
