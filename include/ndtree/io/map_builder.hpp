// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps from cells whose occupancy is known from elsewhere, as from another program's file.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Fills boxes of cells with log-odds, and joins equal siblings in the end. Beams can go on from there.
///
/// Log-odds l are first brought within [log_odds_min, log_odds_max]. An OccupancyCell takes l as it is, and
/// no counts. An EvidenceCell holds sums E+ and E- of which l is log((E+ + prior) / (E- + prior)): it gets
/// the least that gives l, prior (exp|l| - 1) on one side and nothing on the other, in whole units of
/// EvidenceCell::kUnit and at least one, so that the state is always that of l; and no more than the options
/// let it remember. With the default memory, l is met within 0.008 from -4.6 to 5.9.
///
/// A box is looked for from the node that the last one was filled in: in an order in which neighbours follow
/// each other, a box takes O(1), else O(depth), and its cells.
template <class Map>
class MapBuilder {
  using Tree = typename Map::Tree;
  using Cell = typename Map::Cell;
  static constexpr int D = Map::kDim;

 public:
  using Options = typename Map::Options;

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  explicit MapBuilder(const Options& options)
      : options_(validated(options)),
        model_(options, options),
        tree_(options.min_cell_size, options.num_levels(Map::kBranching)),
        coarsest_(Map::RefinementType::coarsest_level(tree_.geometry().finest_level())) {
    tree_.limit_memory(options_.memory_limit());
  }

  /// @param cells of min_cell_size that are going to be filled, no two the same.
  /// @throws MemoryLimitReached if they would surely take more than max_memory: of a map that cannot have
  ///   larger ones.
  void expect_cells(double cells) const {
    if (coarsest_ != tree_.geometry().finest_level()) return;
    const std::size_t limit = options_.memory_limit();
    if (cells * sizeof(typename Tree::NodeType) > static_cast<double>(limit)) throw MemoryLimitReached(limit);
  }

  /// All cells of min_cell_size from `lower` to `upper`, half-open, in units of min_cell_size about 0. What
  /// is filled twice has the second value; a log-odds of 0 is nothing known.
  /// @throws std::invalid_argument if the box is beyond what the lattice can address, MemoryLimitReached.
  void fill(const Lattice<D>& lower, const Lattice<D>& upper, float log_odds) {
    fill_box(lower, upper, [cell = remembered_cell_of(log_odds)](const Cell&) { return cell; });
  }
  /// The same, but what is known already stays where its log-odds are no less.
  void raise(const Lattice<D>& lower, const Lattice<D>& upper, float log_odds) {
    const Cell raised = remembered_cell_of(log_odds);
    fill_box(lower, upper, [&](const Cell& cell) {
      const bool stays = cell.state() != CellState::unknown && cell.log_odds() >= raised.log_odds();
      return stays ? cell : raised;
    });
  }

  [[nodiscard]] Map finish() && {
    join(*tree_.root().node, tree_.root().index.level);
    tree_.limit_memory(kUnlimitedMemory);
    tree_.shrink_to_fit();
    return Map(options_, std::move(tree_), typename Map::Counters{});
  }

 private:
  using Ref = typename Tree::Ref;

  static const Options& validated(const Options& options) {
    options.validate();
    return options;
  }

  [[nodiscard]] Cell cell_of(float log_odds) const {
    Cell cell;
    if (state_of(log_odds) == CellState::unknown) return cell;
    if constexpr (std::is_same_v<Cell, EvidenceCell>) {
      const double nats = options_.evidence_prior * std::expm1(std::abs(static_cast<double>(log_odds)));
      const auto units = static_cast<std::int64_t>(std::clamp(
          std::round(nats / EvidenceCell::kUnit), 1.0, static_cast<double>(EvidenceCell::kMaxEvidence)));
      const bool occupied = log_odds > 0.0f;
      model_.assign(cell, occupied ? units : 0, occupied ? 0 : units);
    } else {
      cell.set_log_odds(std::clamp(log_odds, static_cast<float>(options_.log_odds_min),
                                   static_cast<float>(options_.log_odds_max)));
    }
    return cell;
  }

  /// cell_of(), computed once for values that come again.
  [[nodiscard]] const Cell& remembered_cell_of(float log_odds) {
    Remembered& last = last_[log_odds > 0.0f ? 1 : 0];
    if (!(last.log_odds == log_odds)) last = {log_odds, cell_of(log_odds)};
    return last.cell;
  }

  template <class Changed>
  void fill_box(const Lattice<D>& lower, const Lattice<D>& upper, const Changed& changed) {
    for (std::size_t a = 0; a < D; ++a)
      if (upper[a] <= lower[a]) return;
    while (!path_.empty() && !contains(path_.back(), lower, upper)) path_.pop_back();
    if (path_.empty()) {
      grow_to(lower, upper);
      path_.push_back(tree_.root());
    }
    for (;;) {  // Down to the smallest node that contains the box.
      pace_.spend();
      const Ref ref = path_.back();
      if (ref.is_leaf()) break;
      const Ref child = tree_.child_towards(ref, lower);
      if (!contains(child, lower, upper)) break;
      path_.push_back(child);
    }
    fill_node(path_.back(), lower, upper, changed);
  }
  [[nodiscard]] bool contains(const Ref& ref, const Lattice<D>& lower, const Lattice<D>& upper) const {
    const std::int64_t edge = tree_.geometry().edge(ref.index.level);
    bool all = true;
    for (std::size_t a = 0; a < D; ++a)
      all = all && ref.index.lower[a] <= lower[a] && upper[a] <= ref.index.lower[a] + edge;
    return all;
  }
  void grow_to(const Lattice<D>& lower, const Lattice<D>& upper) {
    Vector<D> first, last;
    for (int a = 0; a < D; ++a) {
      first[a] = tree_.geometry().border(lower[static_cast<std::size_t>(a)]);
      last[a] = tree_.geometry().border(upper[static_cast<std::size_t>(a)] - 1);
    }
    tree_.grow_to_contain(first);
    tree_.grow_to_contain(last);
  }
  /// @param changed what a cell becomes: Cell(const Cell&).
  template <class Changed>
  void fill_node(const Ref& ref, const Lattice<D>& lower, const Lattice<D>& upper, const Changed& changed) {
    pace_.spend();
    const std::int64_t edge = tree_.geometry().edge(ref.index.level);
    bool inside = ref.index.level <= coarsest_;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t begin = ref.index.lower[a];
      if (begin >= upper[a] || begin + edge <= lower[a]) return;
      inside = inside && lower[a] <= begin && begin + edge <= upper[a];
    }
    if (ref.is_leaf()) {
      const Cell before = ref.cell();
      const Cell cell = changed(before);
      if (before == cell) return;
      if (inside) {
        ref.cell() = cell;
        return;
      }
      tree_.split(ref, before);
    }
    for (int j = 0; j < Tree::kNumChildren; ++j) fill_node(tree_.child(ref, j), lower, upper, changed);
  }

  /// Siblings that are leaves and alike become one, as far up as the map has observed cells; unknown space to
  /// the top.
  void join(typename Tree::NodeType& parent, int level) {
    if (parent.is_leaf()) return;
    pace_.spend(Tree::kNumChildren);
    auto* const children = tree_.children(parent);
    bool alike = true;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      join(children[j], level - 1);
      alike = alike && children[j].is_leaf() && children[j].cell() == children[0].cell();
    }
    if (!alike) return;
    const Cell cell = children[0].cell();
    if (level <= coarsest_ || !cell.observed()) tree_.merge(parent, cell);
  }

  struct Remembered {
    float log_odds = 0.0f;
    Cell cell{};
  };

  Options options_;
  EvidenceModel model_;
  Tree tree_;
  int coarsest_;
  std::vector<Ref> path_;             // From the root to the node that the last box was filled in.
  std::array<Remembered, 2> last_{};  // Of what is free, and of what is occupied.
  Pace pace_;
};

}  // namespace ndtree
