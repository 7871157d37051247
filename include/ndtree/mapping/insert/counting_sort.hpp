// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Counting sort of a scan's beams by face and bucket, by several threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"

namespace ndtree {

/// A parallel counting sort of a scan's beams by face and bucket (see CubeFace::bucket_of()).
///
/// Strategy: the buckets of all faces are numbered one face after the other. Each part of the scan counts its
/// beams per bucket; prefix_sum() turns counts into the indices at which each part's beams of each bucket
/// begin in the sorted array; each part then writes its beams there, without another thread in its way.
/// Invariants: the sort is stable: within a bucket, beams stay in the order of the scan. So the result does
/// not depend on the number of parts. A sample of a face is a prefix of the face's beams.
/// Cost: O(beams + parts * buckets); memory 4 bytes per part and bucket.
template <int D>
class BeamBuckets {
 public:
  /// Sets `first_bucket` of each face.
  /// @param faces with `num_buckets` set. They must stay where they are as long as this lives.
  explicit BeamBuckets(std::vector<CubeFace<D>>& faces) : faces_(faces) {
    for (CubeFace<D>& face : faces) {
      face.first_bucket = count_;
      count_ += face.num_buckets;
    }
  }

  /// Number of buckets of all faces.
  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] const CubeFace<D>& face(std::uint32_t number) const { return faces_[number]; }
  /// The bucket of a beam, in [0, count()) if the beam's key is in one of the face's `num_buckets`.
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t key) const {
    return faces_[face].first_bucket + faces_[face].bucket_of(key);
  }

  /// Zeros for a part's counts. Index 1 + b is bucket b's; index 0 stays 0.
  [[nodiscard]] std::vector<std::uint32_t> counts() const {
    return std::vector<std::uint32_t>(1 + count_, 0);
  }

  /// Turns the counts of all parts into indices of the sorted array: within a bucket, the beams of a part
  /// follow those of the part before.
  /// @param indices [part][1 + bucket]: number of beams; on return, the index of the first of them. A part
  ///   adds 1 for each beam that it writes there. After all parts have written their beams, element b of the
  ///   last part is the begin of bucket b, and its last element the number of all beams.
  void prefix_sum(std::vector<std::vector<std::uint32_t>>& indices, Workers& workers) const {
    const std::size_t tasks = std::clamp<std::size_t>(count_ / kBucketsOfTask, 1, workers.count());
    const auto first = [&](std::size_t task) { return 1 + count_ * task / tasks; };
    std::vector<std::uint32_t> before(tasks, 0);  // Beams in the buckets of the tasks before.
    workers.for_each_task(tasks - 1, [&](std::size_t, std::size_t task) {
      std::uint32_t sum = 0;
      for (const std::vector<std::uint32_t>& of_part : indices)
        for (std::size_t b = first(task); b < first(task + 1); ++b) sum += of_part[b];
      before[task + 1] = sum;
    });
    std::partial_sum(before.begin(), before.end(), before.begin());
    workers.for_each_task(tasks, [&](std::size_t, std::size_t task) {
      std::uint32_t begin = before[task];
      if (indices.size() == 1) {  // The most frequent case, in half the time.
        for (std::size_t b = first(task); b < first(task + 1); ++b) begin = begin_of(indices[0][b], begin);
        return;
      }
      for (std::size_t b = first(task); b < first(task + 1); ++b)
        for (std::vector<std::uint32_t>& of_part : indices) begin = begin_of(of_part[b], begin);
    });
  }

 private:
  static constexpr std::size_t kBucketsOfTask = 1 << 12;  // The least that is worth a thread.

  /// Replaces a number of beams by the index of the first of them. @returns the index after the last.
  [[nodiscard]] static std::uint32_t begin_of(std::uint32_t& count, std::uint32_t first) {
    return first + std::exchange(count, first);
  }

  const std::vector<CubeFace<D>>& faces_;
  std::size_t count_ = 0;
};

}  // namespace ndtree
