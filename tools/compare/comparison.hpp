// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The same log into several maps: cells, updates, time, memory and truth of each (the paper's Fig. 7,
/// extended).
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "log_input.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/evaluation/claims.hpp"
#include "ndtree/evaluation/held_out_truth.hpp"
#include "ndtree/evaluation/no_returns.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/occupancy_map.hpp"

namespace ndtree {

#ifdef NDTREE_HAVE_OCTOMAP
inline constexpr bool kHaveOctomap = true;
#else
inline constexpr bool kHaveOctomap = false;
#endif

/// Maps that can be compared, by the names that the command line and the reports give them.
inline constexpr const char* kAllMaps[] = {
    "adaptive", "paper", "fixed", "octomap", "octomap-scan", "octomap-scan-lazy", "octomap-scan-discretized"};

struct ComparisonOptions {
  MapOptions map;                      ///< Of all maps; the fixed ones and OctoMap have min_cell_size alone.
  int branching = 2;                   ///< N of our maps: 2, 3 or 4. OctoMap has 2.
  double max_range = kUnlimitedRange;  ///< [m].
  std::size_t held_out = 10;           ///< Every scan of this number is not mapped but asked about; 0: none.
  int repeat = 5;                      ///< Timed runs of each map; they alternate run by run.
  std::vector<std::string> maps;       ///< Of kAllMaps, in the order of the report.
  HeldOutTruthOptions truth;
  ClaimsOptions claims;

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const;
};

/// Leaves of one size.
struct CellSizeCount {
  double size = 0.0;         ///< [m].
  std::size_t observed = 0;  ///< Those that at least one beam updated.
  std::size_t leaves = 0;    ///< All, unknown space included.
};

struct MapResult {
  std::string map;                          ///< One of kAllMaps.
  std::string refinement;                   ///< Policy of our maps; of OctoMap the insertion.
  std::size_t cells = 0;                    ///< Observed leaves; of OctoMap its leaves before pruning.
  std::optional<std::size_t> cells_pruned;  ///< OctoMap's leaves after prune().
  std::size_t leaves = 0;                   ///< As stored.
  std::size_t nodes = 0;
  std::uint64_t updates = 0;
  std::optional<std::uint64_t> splits;  ///< None for OctoMap.
  std::optional<std::uint64_t> merges;
  std::vector<double> seconds;  ///< Insertion of the whole log, one a run.
  std::size_t memory_bytes = 0;
  std::optional<std::size_t> resident_bytes;  ///< Growth of a process that builds only this map.
  HeldOutTruth truth;
  Claims claims;                          ///< About what the mapped scans saw.
  std::vector<CellSizeCount> cell_sizes;  ///< The largest first.
};

struct Comparison {
  std::string log;
  int dim = 0;
  ComparisonOptions options;
  std::size_t scans = 0;
  std::size_t scans_mapped = 0;
  InsertReport beams;  ///< Beams of the mapped scans by outcome.
  std::vector<MapResult> maps;
};

/// What beams without return say, by a sample of the log.
[[nodiscard]] NoReturns judge_no_returns(const Log& log);

/// Told what is going on, and which share of the whole is done.
using Progress = std::function<void(const std::string& what, double done)>;

/// @throws std::invalid_argument if the options are out of bounds. @throws InputError if a scan cannot be
/// mapped.
[[nodiscard]] Comparison compare(const Log& log, const ComparisonOptions& options, const Progress& progress);

}  // namespace ndtree
