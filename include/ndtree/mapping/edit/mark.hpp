// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parts of a map get a state that is given.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/cell/child_initialisation.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/forget_rule.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/mapping/edit/forget.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree::detail {

/// @throws std::invalid_argument if cells cannot be marked so.
inline void check_mark(CellState state, int beams) {
  if (state == CellState::unknown)
    throw std::invalid_argument("state = unknown: must be free or occupied; clear() makes cells unknown");
  if (beams < 1 || beams > kMostMarkBeams)
    throw std::invalid_argument("beams = " + std::to_string(beams) + ": must be from 1 to " +
                                std::to_string(kMostMarkBeams));
}

/// Gives the cells that a rule would forget a state, in place of what they hold.
///
/// A smallest cell gets the evidence of `beams` beams. A larger one gets what its smallest cells would have
/// together, k levels above them N^(k (D - 1)) times as much, since a split divides evidence by N^(D-1); what
/// is more than a cell remembers is lost. So that none is lost of an obstacle, occupied cells are no larger
/// than their evidence is remembered; in paper maps, whose splits keep nothing, they are smallest ones.
/// Invariant: siblings that are all marked are one marked cell, if it may be as large; so the result depends
/// on the marked space alone. Cost: O(what is marked before, and cells on the border).
template <class Tree, class Refinement, class IsSaturated, class Rule>
class Marking {
  using Cell = typename Tree::Cell;
  using Ref = typename Tree::Ref;

 public:
  /// @param state, beams checked, see check_mark().
  Marking(Tree& tree, const MapOptions& options, const Refinement& refinement,
          const IsSaturated& is_saturated, const Rule& rule, CellState state, int beams)
      : tree_(tree),
        is_saturated_(is_saturated),
        rule_(rule),
        finest_(tree.geometry().finest_level()),
        coarsest_(finest_) {
    const int coarsest = Refinement::coarsest_level(finest_);
    double worth = beams;
    marks_.push_back(mark(options, refinement, Cell{}, state, worth));
    while (coarsest_ < coarsest) {
      worth *= kChildrenAcross<Tree>;
      if (state == CellState::occupied && !may_be_larger(refinement, Cell{}, worth)) return;
      marks_.push_back(mark(options, refinement, Cell{}, state, worth));
      ++coarsest_;
    }
  }

  /// @pre the tree contains all that the rule would forget. Summaries above what changes become stale.
  void run() { descend(tree_.root()); }

 private:
  /// @returns whether anything changed.
  bool descend(const Ref& ref) {
    pace_.spend();
    const int level = ref.index.level;
    const Fate fate = rule_.fate(tree_.box(ref.index), ref.is_leaf(), level != finest_);
    if (fate == Fate::keep) return false;
    if (fate == Fate::forget && level <= coarsest_) return become(ref);
    const bool was_leaf = ref.is_leaf();
    const Cell before = was_leaf ? ref.cell() : Cell{};
    if (was_leaf) tree_.split_node(*ref.node, without_parts(before));
    bool changed = false;
    bool all_marked = level <= coarsest_;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Ref child = tree_.child(ref, j);
      changed = descend(child) || changed;
      all_marked = all_marked && child.is_leaf() && child.cell() == mark_of(level - 1);
    }
    if (!changed) {  // It is touched but for rounding.
      if (was_leaf) tree_.cut(*ref.node, before);
      return false;
    }
    if (all_marked) return become(ref);
    summarise(tree_, *ref.node, is_saturated_);
    return true;
  }
  bool become(const Ref& ref) {
    const Cell& cell = mark_of(ref.index.level);
    if (ref.is_leaf() && ref.cell() == cell) return false;
    tree_.cut(*ref.node, cell);
    return true;
  }
  /// @pre the level is one of cells that may be marked.
  [[nodiscard]] const Cell& mark_of(int level) const {
    return marks_[static_cast<std::size_t>(level - finest_)];
  }

  // By the kind of cell, which the third argument is of.
  [[nodiscard]] static EvidenceCell mark(const MapOptions& /*options*/, const Refinement& refinement,
                                         const EvidenceCell& /*kind*/, CellState state, double beams) {
    return refinement.model.marked(state, beams);
  }
  [[nodiscard]] static OccupancyCell mark(const MapOptions& options, const Refinement& /*refinement*/,
                                          const OccupancyCell& /*kind*/, CellState state, double beams) {
    const bool is_occupied = state == CellState::occupied;
    const double of_beam = log_odds(is_occupied ? options.probability_max : options.probability_min);
    const auto count =
        static_cast<std::uint32_t>(std::min(beams, static_cast<double>(OccupancyCell::kMaxCount)));
    OccupancyCell cell;
    cell.set_counts(is_occupied ? count : 0, is_occupied ? 0 : count);
    cell.set_log_odds(
        static_cast<float>(std::clamp(beams * of_beam, options.log_odds_min, options.log_odds_max)));
    return cell;
  }
  [[nodiscard]] static bool may_be_larger(const Refinement& refinement, const EvidenceCell& /*kind*/,
                                          double beams) {
    return refinement.model.remembers_hits(beams);
  }
  [[nodiscard]] static bool may_be_larger(const Refinement& /*refinement*/, const OccupancyCell& /*kind*/,
                                          double /*beams*/) {
    return false;
  }

  Tree& tree_;
  const IsSaturated& is_saturated_;
  const Rule& rule_;
  int finest_;
  int coarsest_;             // Level of the largest cells that are marked.
  std::vector<Cell> marks_;  // By level, from the finest.
  Pace pace_;
};

/// Space to be marked: the cells that a rule would forget, and a box of smallest cells that has them all.
template <int D, class Rule>
struct MarkedSpace {
  Rule rule;
  LatticeBox<D> cells;
};

/// @throws std::invalid_argument if a part of a box lies where no cell can be.
template <int N, int D>
void require_markable(const LatticeGeometry<N, D>& geometry, const Box<D>& box) {
  if (!geometry.in_reach(box.lower) || !geometry.in_reach(box.upper))
    throw std::invalid_argument("marked space from " + describe_point(box.lower) + " to " +
                                describe_point(box.upper) + " m: must be within " +
                                describe_number(geometry.reach()) + " m of 0");
}
/// The space in a box. @throws as require_markable().
template <int N, int D>
[[nodiscard]] MarkedSpace<D, ClearRule<D>> marked_space(const LatticeGeometry<N, D>& geometry,
                                                        const Box<D>& box) {
  require_markable(geometry, box);
  return {ClearRule<D>{geometry.on_borders(box)}, geometry.cells_in(box, geometry.finest_level())};
}
/// The space that a body takes. @pre it has parts, all finite. @throws as require_markable().
template <int N, int D>
[[nodiscard]] MarkedSpace<D, ShapeRule<D>> marked_space(const LatticeGeometry<N, D>& geometry,
                                                        const ShapeRule<D>& rule) {
  Box<D> around = bounds_of(rule.body.front());
  for (const BodyPart<D>& part : rule.body) {
    const Box<D> bounds = bounds_of(part);
    around = {around.lower.cwiseMin(bounds.lower), around.upper.cwiseMax(bounds.upper)};
  }
  require_markable(geometry, around);
  LatticeBox<D> cells;  // All that share a point with the box, or would without rounding.
  for (int a = 0; a < D; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    const double beside = 2.0 * kOnBorder * geometry.unit();  // See ShapeRule.
    const double lower = around.lower[a], upper = around.upper[a];
    cells.lower[axis] = geometry.coordinate(lower - geometry.rounding_at(lower) - beside);
    cells.upper[axis] = geometry.coordinate(upper + geometry.rounding_at(upper) + beside) + 1;
  }
  return {rule, cells};
}

/// A tree as Marking leaves it, grown around the space, with its summaries.
/// @param bytes_beside that the map holds beside its tree, and that count for its max_memory.
/// @throws as check_mark(), and MemoryLimitReached, std::bad_alloc, Cancelled.
template <class Tree, class Rule, class Refinement, class IsSaturated>
[[nodiscard]] Tree marked(const Tree& tree, const MarkedSpace<Tree::kDim, Rule>& space, CellState state,
                          int beams, const MapOptions& options, const Refinement& refinement,
                          const IsSaturated& is_saturated, std::size_t bytes_beside) {
  check_mark(state, beams);
  Tree changed = tree;
  changed.limit_memory(options.memory_limit(), bytes_beside);
  grow_around(changed, space.cells);
  Marking<Tree, Refinement, IsSaturated, Rule>(changed, options, refinement, is_saturated, space.rule, state,
                                               beams)
      .run();
  changed.limit_memory(kUnlimitedMemory);
  summarise_stale(changed, *changed.root().node, is_saturated);
  changed.shrink_if_half_empty();
  return changed;
}

}  // namespace ndtree::detail
