// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a map holds, whatever its rules: cells, options and counters. Queries need no more.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/nd_tree.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// The size of a map and what happened to it since it was made.
struct MapStats {
  std::size_t leaves = 0;           ///< All leaves, unknown space included.
  std::size_t observed_leaves = 0;  ///< Leaves that at least one beam updated: the cells that results count.
  std::size_t nodes = 0;            ///< Leaves and inner nodes.
  std::uint64_t scans = 0;          ///< Scans inserted; the number of the next one.
  std::uint64_t updates = 0;        ///< As in InsertReport, over the map's life.
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  std::size_t memory_bytes = 0;  ///< Bytes held, used or not.
};

/// The cells of a map, which its rules change and all queries read. Queries of `map.cells()` are compiled
/// once for maps whose rules alone differ, such as PaperMap and FixedMap.
template <int N, int D, class CellType>
class MapCells {
 public:
  static constexpr int kBranching = N;
  static constexpr int kDim = D;
  using Options = MapOptions;
  using Counters = UpdateCounters;
  using Cell = CellType;
  using Tree = NdTree<N, D, Cell>;

  [[nodiscard]] const Tree& tree() const { return tree_; }
  [[nodiscard]] const MapOptions& options() const { return options_; }
  [[nodiscard]] const UpdateCounters& counters() const { return counters_; }
  /// Level of the largest cells that a beam may update.
  [[nodiscard]] int coarsest_level() const { return coarsest_level_; }
  /// Level of the smallest cells that scans make if their noise is that of the options: below, an adaptive
  /// map does not split. See ScanBeams::finest_level().
  [[nodiscard]] int finest_level() const {
    const auto& geometry = tree_.geometry();
    if constexpr (!std::is_same_v<Cell, EvidenceCell>) return geometry.finest_level();
    return geometry.level_of(options_.noise_sigmas * options_.range_sigma);
  }
  /// Their edge [m].
  [[nodiscard]] double smallest_cell() const { return tree_.geometry().cell_size(finest_level()); }
  /// The edge of a level's cells in theirs, at least 1.
  [[nodiscard]] double edge_in_smallest(int level) const {
    return tree_.geometry().edge_in(level, finest_level());
  }
  [[nodiscard]] const MapCells& cells() const { return *this; }
  /// The cells as they are now. Takes microseconds for each megabyte.
  [[nodiscard]] MapCells snapshot() const { return *this; }

 protected:
  MapCells(const MapOptions& options, Tree tree, const UpdateCounters& counters, int coarsest_level)
      : options_(options), tree_(std::move(tree)), counters_(counters), coarsest_level_(coarsest_level) {}

  /// All but the bytes. O(leaves).
  [[nodiscard]] MapStats count() const {
    MapStats stats;
    stats.leaves = tree_.num_leaves();
    for_each_leaf(tree_, [&](const auto& leaf) { stats.observed_leaves += leaf.cell().observed(); });
    stats.nodes = tree_.num_nodes();
    stats.updates = counters_.updates;
    stats.splits = counters_.splits;
    stats.merges = counters_.merges;
    stats.scans = counters_.scans;
    return stats;
  }

  MapOptions options_;
  Tree tree_;
  UpdateCounters counters_;
  int coarsest_level_;
};

}  // namespace ndtree
