// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What updates did to a tree, in numbers.
#pragma once

#include <cstdint>

namespace ndtree {

/// What changed the tree so far; a map keeps these over its life.
struct UpdateCounters {
  /// (beam, leaf) pairs that were added. Default: of sampled beams, at most scan_beams where all passed, in
  /// leaves that changed; of children that re-merged, too. Paper and fixed: all pairs.
  std::uint64_t updates = 0;
  std::uint64_t splits = 0;  ///< Leaves split because the refinement asked for it.
  std::uint64_t merges = 0;  ///< Parents that took the place of their children.
  std::uint64_t scans = 0;   ///< Scans inserted; the number that the next one has, see ScanView::number.

  /// Adds what others changed in the same scans.
  void add(const UpdateCounters& others) {
    updates += others.updates;
    splits += others.splits;
    merges += others.merges;
  }
};

}  // namespace ndtree
