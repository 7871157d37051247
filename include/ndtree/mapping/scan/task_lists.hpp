// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beams of a scan, part by part, brought to cells that threads share out.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include "ndtree/core/cache_lines.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/scan/beam_lists.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Some beams of a scan that cross a cell.
template <int D>
struct TaskList {
  Lattice<D> cell;   ///< Its lower corner.
  std::size_t part;  ///< Of the scan; beams of a part come after those of the parts before.
  BeamList list;     ///< Not empty.
};

/// Lists of the beams of some parts of a scan, which one thread has made.
template <int D>
class alignas(kCacheLines) TaskLists {
 public:
  /// Keeps a copy of a list.
  void add(const Lattice<D>& cell, std::size_t part, const BeamList& list) {
    BeamList copy = memory_.allocate(list.size + BeamList::kSlack);
    append(list, copy);
    copy.pad();
    lists_.push_back({cell, part, copy});
  }
  /// Moves what was added since the last time to others. The lists last as long as this.
  void move_to(std::vector<TaskList<D>>& lists) {
    lists.insert(lists.end(), lists_.begin(), lists_.end());
    lists_.clear();
  }

 private:
  ListStack memory_;
  std::vector<TaskList<D>> lists_;
};

/// Beams that cross a cell: lists of parts, one after the other.
template <int D>
struct TaskCell {
  Lattice<D> lower;
  const TaskList<D>* first;
  const TaskList<D>* last;
  std::size_t size;  ///< Of all of them.
};

/// The cells that lists are of, which this sorts, and which must stay there.
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

}  // namespace ndtree
