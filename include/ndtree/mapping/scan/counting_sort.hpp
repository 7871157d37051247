// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order of a scan's beams, by face and step of chance, found by several threads at once.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/scan/cube_map.hpp"

namespace ndtree {

/// The steps of all faces' chances, one face after the other (see CubeFace::bucket_of()): each thread counts
/// what it has for each, then puts its beams where they belong. Of a step, beams stay in the order of the
/// scan.
template <int D>
class BeamBuckets {
 public:
  /// @param faces that know how many steps they have; they are told which is their first. They stay where
  ///   they are as long as of() is asked.
  explicit BeamBuckets(std::vector<CubeFace<D>>& faces) : faces_(faces) {
    for (CubeFace<D>& face : faces) {
      face.first_bucket = count_;
      count_ += face.num_buckets;
    }
  }

  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] const CubeFace<D>& face(std::uint32_t number) const { return faces_[number]; }
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t key) const {
    return faces_[face].first_bucket + faces_[face].bucket_of(key);
  }

  /// What a part counts, and where it puts its beams: a number for each step, and one before them, which is
  /// 0.
  [[nodiscard]] std::vector<std::uint32_t> counts() const {
    return std::vector<std::uint32_t>(1 + count_, 0);
  }

  /// Lets each part's beams of a step follow those of the part before.
  /// @param places of each part and step, how many beams; then, where the first of them belongs. When each
  ///   part has put its beams there, one by one, those of the last tell where each step begins, and after
  ///   them where the last ends.
  void begin(std::vector<std::vector<std::uint32_t>>& places, Workers& workers) const {
    const std::size_t tasks = std::clamp<std::size_t>(count_ / kBucketsOfTask, 1, workers.count());
    const auto first = [&](std::size_t task) { return 1 + count_ * task / tasks; };
    std::vector<std::uint32_t> before(tasks, 0);  // Each task, so many beams.
    workers.for_each_task(tasks - 1, [&](std::size_t, std::size_t task) {
      std::uint32_t sum = 0;
      for (const std::vector<std::uint32_t>& of_part : places)
        for (std::size_t s = first(task); s < first(task + 1); ++s) sum += of_part[s];
      before[task + 1] = sum;
    });
    std::partial_sum(before.begin(), before.end(), before.begin());
    workers.for_each_task(tasks, [&](std::size_t, std::size_t task) {
      std::uint32_t begin = before[task];
      if (places.size() == 1) {  // As is most often so: it takes half as long.
        for (std::size_t s = first(task); s < first(task + 1); ++s) begin = begin_of(places[0][s], begin);
        return;
      }
      for (std::size_t s = first(task); s < first(task + 1); ++s)
        for (std::vector<std::uint32_t>& of_part : places) begin = begin_of(of_part[s], begin);
    });
  }

 private:
  static constexpr std::size_t kBucketsOfTask = 1 << 12;  // So many that it is worth a thread.

  /// Puts the place of the first beam where it says how many there are. @returns that behind the last.
  [[nodiscard]] static std::uint32_t begin_of(std::uint32_t& count, std::uint32_t first) {
    return first + std::exchange(count, first);
  }

  const std::vector<CubeFace<D>>& faces_;
  std::size_t count_ = 0;
};

}  // namespace ndtree
