// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How fine a map is, and where: the policies that tell an adaptive map from a fixed one.
#pragma once

#include <optional>

#include "ndtree/cell/change_detection.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/merge_rule.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/partial_occupancy.hpp"
#include "ndtree/cell/split_test.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/baseline/beam_update.hpp"
#include "ndtree/mapping/baseline/fixed_update.hpp"
#include "ndtree/mapping/insert/coverage.hpp"
#include "ndtree/mapping/insert/leaf_action.hpp"
#include "ndtree/mapping/insert/scan_update.hpp"
#include "ndtree/mapping/map_options.hpp"

namespace ndtree {

/// Cells start at max_cell_size, split where the counts contradict each other and merge where all agree,
/// exactly as the paper has it (Sec. III-A, III-B).
struct PaperRefinement {
  static constexpr const char* kName = "paper";
  static constexpr bool kAdaptive = true;
  using Cell = OccupancyCell;
  template <class Tree, class Sensor>
  using Update = BeamUpdate<Tree, PaperRefinement, Sensor>;

  ChiSquareSplitTest split_test;
  SameStateMergeRule merge_rule;

  explicit PaperRefinement(const MapOptions& options) : split_test(options), merge_rule(options) {}
  [[nodiscard]] static double least_sigma(const MapOptions&) { return 0.0; }

  /// The level of the largest cells that beams update: 0 where cells adapt, the finest of a fixed map. Larger
  /// leaves are unknown space, and are divided before a beam updates what is in them, which is no split.
  [[nodiscard]] static int coarsest_level(int /*finest_level*/) { return 0; }
  [[nodiscard]] bool splits(const OccupancyCell& cell) const { return split_test(cell); }
  [[nodiscard]] bool may_merge(const OccupancyCell& updated) const { return merge_rule.is_extreme(updated); }
  [[nodiscard]] static bool is_saturated(const OccupancyCell&) { return false; }
  template <class NodeType>
  [[nodiscard]] std::optional<OccupancyCell> merged(const NodeType* siblings, int count) const {
    return merge_rule(siblings, count, split_test);
  }
};

/// Cells start at max_cell_size; a whole scan decides, with the beams that the leaf samples: action() says
/// what it does to a leaf, splits() whether it splits. Children start with a part of their parent's evidence.
/// Siblings merge where next to no information is lost.
struct EvidenceRefinement {
  static constexpr const char* kName = "evidence";
  static constexpr bool kAdaptive = true;
  using Cell = EvidenceCell;
  template <class Tree, class Sensor>
  using Update = ScanUpdate<Tree, EvidenceRefinement, Sensor>;

  EvidenceModel model;
  CoverageModel coverage;
  PartialOccupancySplitTest split_test;
  EvidenceMergeRule merge_rule;
  /// Log-odds that a smallest cell has at least while it is partially occupied; none: all its beams decide.
  std::optional<double> partial_log_odds;

  explicit EvidenceRefinement(const MapOptions& options)
      : model(options, options), coverage(options), split_test(options), merge_rule(options, model) {
    if (options.partial_probability > 0.0) partial_log_odds = log_odds(options.partial_probability);
  }
  /// Surfaces are as thick as a smallest cell, at least: see kThinnestSurface.
  [[nodiscard]] static double least_sigma(const MapOptions& options) {
    return options.min_cell_size / kThinnestSurface;
  }

  [[nodiscard]] static int coarsest_level(int /*finest_level*/) { return 0; }
  /// Keeps the probability of a smallest cell that would split if it could: something thin may be in it,
  /// however many beams pass beside it. So a cell that was hit once stays apart from its siblings until about
  /// four beams have passed it, and one that is hit again within ten: a rod that few beams meet is not
  /// forgotten. A dozen scans in a row that all pass it end that: what stood there has left. @pre
  /// partial_log_odds. @returns whether the cell changed.
  NDTREE_ALWAYS_INLINE bool keep_partial(EvidenceCell& cell) const {
    return cell.hits() > 0 && static_cast<double>(cell.log_odds()) < *partial_log_odds &&
           !ChangeDetection::is_passed_by_all(cell) && raise_partial(cell);
  }
  /// Whether siblings do not merge since the merged cell's own counts would split it: with
  /// partial_probability, they would else split and merge in turn, and each time lose evidence of passes.
  [[nodiscard]] bool stay_apart(const EvidenceCell& merged) const {
    return partial_log_odds && merged.state() == CellState::occupied &&
           is_partial(merged.hits(), merged.misses());
  }
  /// Whether scans whose beams all pass leave the cell as it is.
  [[nodiscard]] bool is_saturated(const EvidenceCell& cell) const { return model.is_saturated(cell); }
  /// **The leaf decision**: what the evidence of a scan does to a leaf.
  /// - A smallest cell is updated; see is_contradicted().
  /// - A leaf splits if splits() says so, unless its children are predicted to re-merge: then it is updated
  ///   as if they had.
  /// - If beams ended right before an unknown leaf, how they met its border decides: see
  ///   LeafEvidence::any_grazes().
  /// - If beams have only passed a leaf that was never observed, CoverageModel::judge() has the last word. It
  ///   is asked again, about an observed leaf that is not covered, each time the leaf's count of misses
  ///   reaches a power of two, up to what free_memory is worth.
  /// @param scan ScanEvidence, or PassedEvidence if all beams pass the leaf.
  /// @param children_across see kChildrenAcross. @param levels_below the leaf; at most 0: it cannot split.
  template <class Scan>
  [[nodiscard]] NDTREE_ALWAYS_INLINE LeafAction action(const EvidenceCell& leaf, const Scan& scan,
                                                       int children_across, int levels_below) const {
    if (levels_below <= 0) return LeafAction::update;
    if (splits(leaf, scan))
      return model.predicted_to_remerge(leaf, ScanEvidence::of(scan), children_across)
                 ? LeafAction::update_without_split
                 : LeafAction::split;
    if (scan.ends_before > 0 && leaf.state() == CellState::unknown) return LeafAction::judge_ends;
    if (leaf.is_fully_observed() || !coverage.is_on() || !scan.is_free_alone()) return LeafAction::update;
    return !leaf.observed() || model.misses_double(leaf, scan.misses) ? LeafAction::judge_coverage
                                                                      : LeafAction::update;
  }
  /// Whether a scan's beams all passed an occupied cell: then how they passed a smallest one is looked at.
  template <class Scan>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool is_contradicted(const EvidenceCell& leaf, const Scan& scan) {
    return leaf.state() == CellState::occupied && scan.has_only_passed();
  }
  /// **The split criterion**: whether smaller cells would have more information than this one with the scan.
  /// - Free: a resolvable hit splits it, so that smaller cells show where the hit is.
  /// - Unknown: a partial hit splits it: only a part of the cell may be occupied.
  /// - Occupied: it splits if the scan has a resolvable miss or a partial hit, and partial occupancy, with
  ///   the scan's counts added, is more probable than split_probability; there a partial hit is a hit and a
  ///   miss.
  /// Resolvable, partial: see ScanEvidence. Monotone while the cell is free or unknown: more beams never turn
  /// yes to no, see certainly_splits(). CoverageModel::judge() may split a leaf for another reason.
  [[nodiscard]] bool splits(const EvidenceCell& cell, const ScanEvidence& scan) const {
    switch (cell.state()) {
      case CellState::free:
        return scan.resolvable_hits > 0;
      case CellState::unknown:
        return scan.partial_hits > 0;
      case CellState::occupied:
        break;
    }
    if (scan.resolvable_misses + scan.partial_hits == 0) return false;
    return is_partial(cell.hits() + scan.hits, cell.misses() + scan.misses + scan.partial_hits);
  }
  /// splits() for a scan whose beams all passed the cell: as of ScanEvidence::of(passed), in fewer steps.
  [[nodiscard]] bool splits(const EvidenceCell& cell, const PassedEvidence& passed) const {
    return cell.state() == CellState::occupied && passed.resolvable_misses > 0 &&
           is_partial(cell.hits(), cell.misses() + passed.misses);
  }
  /// Whether these counts make it more probable than split_probability that a cell is partially occupied.
  /// Where it is occupied, this decides; also whether a smallest cell that holds something thin is kept, and
  /// stays apart.
  [[nodiscard]] bool is_partial(std::uint32_t hits, std::uint32_t misses) const {
    return split_test(hits, misses);
  }
  /// The last part of keep_partial(), which few cells need.
  NDTREE_NEVER_INLINE bool raise_partial(EvidenceCell& cell) const {
    return is_partial(cell.hits(), cell.misses()) && model.raise(cell, *partial_log_odds);
  }
  /// Whether action() is LeafAction::split whatever evidence the scan's other beams have: while a cell is
  /// free or unknown, more beams never turn splits() to no. Lets the walk stop reading a long list early.
  /// @param scan evidence of some beams.
  [[nodiscard]] bool certainly_splits(const EvidenceCell& leaf, const ScanEvidence& scan) const {
    return leaf.state() != CellState::occupied && splits(leaf, scan);
  }
};

/// Every cell that a beam updates has min_cell_size: the fixed-resolution grid, in the same tree. Beams step
/// from cell to cell (FixedUpdate); the other functions are what BeamUpdate asks, and tests compare with it.
struct FixedRefinement {
  static constexpr const char* kName = "fixed";
  static constexpr bool kAdaptive = false;
  using Cell = OccupancyCell;
  template <class Tree, class Sensor>
  using Update = FixedUpdate<Tree, FixedRefinement, Sensor>;

  explicit FixedRefinement(const MapOptions&) {}
  [[nodiscard]] static double least_sigma(const MapOptions&) { return 0.0; }

  [[nodiscard]] static int coarsest_level(int finest_level) { return finest_level; }
  [[nodiscard]] static bool splits(const OccupancyCell&) { return false; }
  [[nodiscard]] static bool may_merge(const OccupancyCell&) { return false; }
  [[nodiscard]] static bool is_saturated(const OccupancyCell&) { return false; }
  template <class NodeType>
  [[nodiscard]] static std::optional<OccupancyCell> merged(const NodeType*, int) {
    return std::nullopt;
  }
};

}  // namespace ndtree
