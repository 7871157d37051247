// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which thread begins with which tasks of a scan.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace ndtree {

/// Tasks in the order in which they are begun, see Workers::for_each_task(): the largest come first, for
/// whoever is free. Of the others each worker gets those that lie side by side in the tree: so a beam's row
/// in the table is mostly read by one of them, and as long as the system puts threads where they were, a cell
/// is mostly changed by the core that has changed it with the last scan. Where cores are far from each other,
/// what one has in its cache takes the other long to get.
struct TaskOrder {
  std::vector<std::uint32_t> tasks;
  std::size_t num_large;
  std::vector<std::size_t> ends;  ///< Of each worker's share of the others.

  /// @param sizes of the tasks, in the order of the tree. @param workers at least 1.
  TaskOrder(const std::vector<std::size_t>& sizes, std::size_t workers) : tasks(sizes.size()) {
    constexpr std::size_t kSmallOfWorker = 64;  // Or more, to be shared out evenly.
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
