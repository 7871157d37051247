// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order of a scan's beams, by face and step of chance, found by several threads at once.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <numeric>
#include <vector>

#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/scan/image.hpp"

namespace ndtree {

/// A beam that some cell may take.
struct KeptBeam {
  std::uint32_t face;    ///< By its number, see ScanUpdate.
  std::uint32_t number;  ///< In the scan.
};

/// The steps of all faces' chances, one face after the other (see ScanFace::step_of()): each thread counts
/// what it has for each, then puts its beams where they belong. Of a step, beams stay in the order of the
/// scan.
template <int D>
class BeamSteps {
 public:
  /// @param faces that know how many steps they have; they are told which is their first. They stay where
  ///   they are as long as of() is asked.
  explicit BeamSteps(std::vector<ScanFace<D>>& faces) : faces_(faces) {
    for (ScanFace<D>& face : faces) {
      face.first_step = count_;
      count_ += face.num_steps;
    }
  }

  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t chance) const {
    return faces_[face].first_step + faces_[face].step_of(chance);
  }

  /// Lets each part's beams of a step follow those of the part before.
  /// @param places of each part and step, how many beams; then, where the first of them belongs.
  /// @returns the first beam of each step, and the end of the last.
  [[nodiscard]] std::unique_ptr<std::uint32_t[]> begin(std::vector<std::vector<std::uint32_t>>& places,
                                                       Workers& workers) const {
    std::unique_ptr<std::uint32_t[]> begins(
        new std::uint32_t[count_ + 1]);  // Not initialised: this does that.
    const std::size_t tasks = std::clamp<std::size_t>(count_ / kStepsOfTask, 1, workers.count());
    const auto first = [&](std::size_t task) { return count_ * task / tasks; };
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
      for (std::size_t s = first(task); s < first(task + 1); ++s) {
        begins[s] = begin;
        for (std::vector<std::uint32_t>& of_part : places) {
          const std::uint32_t size = of_part[s];
          of_part[s] = begin;
          begin += size;
        }
      }
      if (task + 1 == tasks) begins[count_] = begin;
    });
    return begins;
  }

 private:
  static constexpr std::size_t kStepsOfTask = 1 << 12;  // So many that it is worth a thread.

  const std::vector<ScanFace<D>>& faces_;
  std::size_t count_ = 0;
};

}  // namespace ndtree
