// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Lists of a scan's beams by part and cell: the input of tasks; and the order in which these begin.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <tuple>
#include <vector>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/tree/lattice.hpp"

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

/// The beams of one part of a scan that cross a cell.
template <int D>
struct TaskList {
  Lattice<D> cell;   ///< Its lower corner.
  std::size_t part;  ///< Of the scan. A part's beam numbers are above those of the parts before.
  BeamList list;     ///< Not empty.
};

/// Lists that one thread makes, with the memory that holds them.
/// Invariants: lists are not empty and padded; their memory is freed with this.
/// Cost: one copy of each list.
template <int D>
class alignas(kCacheLines) TaskLists {
 public:
  /// Adds a copy of a list, padded.
  void add(const Lattice<D>& cell, std::size_t part, const BeamList& list) {
    BeamList copy = memory_.allocate(list.size + BeamList::kSlack);
    append(list, copy);
    copy.pad();
    lists_.push_back({cell, part, copy});
  }
  /// Appends the lists that were added since the last call. Their beams stay in the memory of this.
  void move_to(std::vector<TaskList<D>>& lists) {
    lists.insert(lists.end(), lists_.begin(), lists_.end());
    lists_.clear();
  }

 private:
  ListStack memory_;
  std::vector<TaskList<D>> lists_;
};

/// The beams that cross a cell: lists [first, last), one of each part with such beams, in the order of parts.
template <int D>
struct TaskCell {
  Lattice<D> lower;
  const TaskList<D>* first;
  const TaskList<D>* last;
  std::size_t size;  ///< Number of beams in all lists.
};

/// Sorts lists by cell and part. @returns the cells, sorted, which point into `lists`. O(n log n).
template <int D>
[[nodiscard]] std::vector<TaskCell<D>> join(std::vector<TaskList<D>>& lists) {
  std::sort(lists.begin(), lists.end(), [](const TaskList<D>& a, const TaskList<D>& b) {
    return std::tie(a.cell, a.part) < std::tie(b.cell, b.part);
  });
  std::vector<TaskCell<D>> cells;
  for (const TaskList<D>& list : lists) {
    if (cells.empty() || cells.back().lower != list.cell) cells.push_back({list.cell, &list, &list, 0});
    ++cells.back().last;
    cells.back().size += list.list.size;
  }
  return cells;
}

/// Most crossings of beams and cells: a beam crosses at most one cell more than planes between cells.
/// @param metres that all beams have together. @param cell_size of the cells [m].
template <int D>
[[nodiscard]] double most_crossings(double beams, double metres, double cell_size) {
  return beams * (1.0 + D) + metres * (std::sqrt(D) / cell_size);
}

}  // namespace ndtree
