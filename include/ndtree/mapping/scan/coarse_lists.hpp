// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beams of a scan, part by part, brought to the cells of the coarsest level: what threads share out.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Some beams of a scan that cross a cell.
template <int D>
struct CoarseList {
  Lattice<D> cell;  ///< Its lower corner.
  Crossings list;   ///< Not empty.
};

/// Lists of the beams of one part of a scan.
template <int D>
class CoarseLists {
 public:
  /// Keeps a copy of a list.
  void add(const Lattice<D>& cell, const Crossings& list) {
    Crossings copy = memory_.allocate(list.size + Crossings::kSlack);
    append(list, copy);
    lists_.push_back({cell, copy});
  }
  [[nodiscard]] const std::vector<CoarseList<D>>& all() const { return lists_; }

 private:
  CrossingStack memory_;
  std::vector<CoarseList<D>> lists_;
};

/// Beams that cross a cell: lists of parts, one after the other.
template <int D>
struct CoarseCell {
  Lattice<D> lower;
  const CoarseList<D>* first;
  const CoarseList<D>* last;
  std::size_t size;  ///< Of all of them.
};

/// The cells that lists are of. @param parts that follow each other. @param lists where theirs go, which must
///   stay there.
template <int D>
[[nodiscard]] std::vector<CoarseCell<D>> join(const std::vector<CoarseLists<D>>& parts,
                                              std::vector<CoarseList<D>>& lists) {
  for (const CoarseLists<D>& part : parts) lists.insert(lists.end(), part.all().begin(), part.all().end());
  std::stable_sort(lists.begin(), lists.end(), [](const auto& a, const auto& b) { return a.cell < b.cell; });
  std::vector<CoarseCell<D>> cells;
  for (const CoarseList<D>& list : lists) {
    if (cells.empty() || cells.back().lower != list.cell) cells.push_back({list.cell, &list, &list, 0});
    ++cells.back().last;
    cells.back().size += list.list.size;
  }
  return cells;
}

}  // namespace ndtree
