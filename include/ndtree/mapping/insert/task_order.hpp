// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order in which threads begin the tasks of a scan.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace ndtree {

/// The order in which workers begin tasks, see Workers::for_each_task().
///
/// Strategy: large tasks come first, the largest before all others; each goes to the next idle worker.
/// The small ones stay in the order of the tree and are divided into one range per worker, of about equal
/// size. So mostly one worker reads a beam's table rows, and as long as threads stay on their cores, a
/// cell is mostly changed by the core that changed it in the scan before: between distant cores, cache
/// lines move slowly.
/// Invariants: `tasks` holds each task once; a small task is at most 1 / 64 of a worker's part of the
/// work.
/// Cost: O(n log n) for n tasks.
struct TaskOrder {
  std::vector<std::uint32_t> tasks;  ///< Large ones, then small ones.
  std::size_t num_large;
  std::vector<std::size_t> ends;  ///< Where the range of each worker's small tasks ends in `tasks`.

  /// @param sizes of the tasks, in the order of the tree. @param workers at least 1.
  TaskOrder(const std::vector<std::size_t>& sizes, std::size_t workers) : tasks(sizes.size()) {
    constexpr std::size_t kSmallOfWorker = 64;  // Or more, so that ranges have about equal sizes.
    workers = std::clamp<std::size_t>(sizes.size(), 1, workers);
    const std::size_t all = std::accumulate(sizes.begin(), sizes.end(), std::size_t{0});
    const std::size_t large = all / (kSmallOfWorker * workers);
    std::iota(tasks.begin(), tasks.end(), 0u);
    const auto small = std::stable_partition(tasks.begin(), tasks.end(),
                                             [&](std::uint32_t task) { return sizes[task] > large; });
    std::stable_sort(tasks.begin(), small,
                     [&](std::uint32_t a, std::uint32_t b) { return sizes[a] > sizes[b]; });
    num_large = static_cast<std::size_t>(small - tasks.begin());
    const std::size_t all_small =
        std::accumulate(small, tasks.end(), std::size_t{0},
                        [&](std::size_t sum, std::uint32_t task) { return sum + sizes[task]; });
    std::size_t before = 0;
    for (auto task = small; task != tasks.end(); ++task) {
      before += sizes[*task];
      while (before * workers > all_small * (ends.size() + 1))
        ends.push_back(static_cast<std::size_t>(task - tasks.begin()));
    }
    ends.resize(workers, tasks.size());
  }
};

}  // namespace ndtree
