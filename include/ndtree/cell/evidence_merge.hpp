// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// When N^D siblings become one cell because that loses next to no information (Sec. V).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <type_traits>

#include "ndtree/cell/change_detection.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/beta.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

struct EvidenceMergeOptions {
  double merge_loss = 4.0;  ///< Siblings merge if that loses at most this for each cell that it saves [bits].
};

/// Siblings merge where one cell has nearly the information of N^D cells. Two things are lost, in bits:
/// - about beams to come: each cell's beams end in it with a rate of its own, or all with the same. The loss
///   is the logarithm of the ratio of the two evidences (a Bayes factor), beta-binomial with the prior
///   Beta(0.1, 1), most space being free; none where the one explains the beams better.
/// - about occupancy: the Kullback-Leibler divergence of each sibling's occupancy from the parent's, 1/2
///   being that of a cell never observed.
///
/// While mapping, occupied siblings merge only if one rate for all is likelier by 1 bit under a uniform
/// prior: beside a surface cells do differ. Free ones merge only if all are clearly free, with log-odds of at
/// most -0.5: a cell between the states would split again at the next hit. Siblings of different states never
/// merge, as young evidence cannot tell them apart, nor do siblings that were not all observed: unknown space
/// must not become free or occupied.
class EvidenceMergeRule {
 public:
  EvidenceMergeRule(const EvidenceMergeOptions& options, const EvidenceModel& model)
      : max_loss_(options.merge_loss), model_(model) {}

  /// What siblings, all leaves, become together, and what that loses.
  struct Joined {
    EvidenceCell cell;
    double loss = 0.0;           ///< [bits], >= 0.
    int observed = 0;            ///< Siblings that were observed.
    bool mixes_unknown = false;  ///< Some were observed, and others were not.
  };

  /// @param siblings nodes; they merge only if all are leaves.
  /// @param children_across see kChildrenAcross. A merge of equal cells is the inverse of child
  /// initialisation.
  /// @returns the parent's cell, or none if the siblings stay. O(siblings).
  template <class NodeType>
  [[nodiscard]] std::optional<EvidenceCell> operator()(const NodeType* siblings, int count,
                                                       int children_across) const {
    const CellState state = siblings[0].is_leaf() ? siblings[0].cell().state() : CellState::unknown;
    if (state == CellState::unknown) return std::nullopt;
    for (int j = 1; j < count; ++j)
      if (!siblings[j].is_leaf() || siblings[j].cell().state() != state) return std::nullopt;
    return of_one_state(siblings, count, children_across);
  }
  /// What siblings become that are all leaves of one state, free or occupied; none if they stay.
  template <class NodeType>
  [[nodiscard]] std::optional<EvidenceCell> of_one_state(const NodeType* siblings, int count,
                                                         int children_across) const {
    const CellState state = siblings[0].cell().state();
    const bool alike = state == CellState::free
                           ? all_clearly_free(siblings, count)
                           : bits_for_many(siblings, count, 1.0) <= -kLeastBitsForOneSurface;
    if (!alike) return std::nullopt;
    const double most = max_loss_ * (count - 1);
    const Joined joined = join(siblings, count, children_across, most);
    if (joined.loss > most || joined.cell.state() != state) return std::nullopt;
    return joined.cell;
  }

  /// Merges siblings of any evidence. Children that were never observed bring none, but become known.
  /// @param most loss that matters: of more, not all may be counted, and there is no cell [bits].
  /// @pre all are leaves.
  template <class NodeType>
  [[nodiscard]] Joined join(const NodeType* siblings, int count, int children_across,
                            double most = std::numeric_limits<double>::infinity()) const {
    Joined joined;
    std::int64_t occupied = 0;
    std::int64_t free = 0;
    std::int64_t hits = 0;
    std::int64_t misses = 0;
    bool are_covered = true;
    std::uint32_t known_levels = EvidenceCell::kMaxKnownLevels;
    std::uint32_t streak = EvidenceCell::kMaxStreak;  // Of scans that passed each of them.
    for (int j = 0; j < count; ++j) {
      const EvidenceCell& cell = siblings[j].cell();
      joined.observed += cell.observed();
      if (!cell.observed()) continue;
      occupied += cell.occupied_evidence();
      free += cell.free_evidence();
      hits += cell.hits();
      misses += cell.misses();
      are_covered = are_covered && cell.is_covered();
      known_levels = std::min(known_levels, cell.known_levels());
      streak = std::min(streak, ChangeDetection::doubting_scans(cell));
    }
    if (joined.observed == 0) return joined;
    joined.mixes_unknown = joined.observed < count;
    // Where no beam ended, one rate for all explains that better than several.
    if (occupied > 0) joined.loss = std::max(0.0, bits_for_many(siblings, count, kMostSpaceIsFree));
    if (joined.loss > most) return joined;
    model_.assign(joined.cell, scaled(occupied, children_across, count),
                  scaled(free, children_across, count));
    joined.cell.set_counts(static_cast<std::uint32_t>(scaled(hits, children_across, count)),
                           static_cast<std::uint32_t>(scaled(misses, children_across, count)));
    joined.cell.set_covered(are_covered && !joined.mixes_unknown);
    if (!joined.mixes_unknown) joined.cell.set_known_levels(known_levels + 1);
    joined.cell.set_streak_of_passes(streak);
    joined.loss += std::max(0.0, divergence(siblings, count, joined.cell) / detail::kLog2);
    return joined;
  }

 private:
  static constexpr double kMostSpaceIsFree = 0.1;
  static constexpr double kLeastBitsForOneSurface = 1.0;
  static constexpr float kClearlyFree = -0.5f;  // Log-odds.

  template <class NodeType>
  [[nodiscard]] static bool all_clearly_free(const NodeType* siblings, int count) {
    return std::all_of(siblings, siblings + count,
                       [](const NodeType& sibling) { return sibling.cell().log_odds() <= kClearlyFree; });
  }
  /// Evidence [bits] for a rate of hits of each observed cell's own, against one for all.
  template <class NodeType>
  [[nodiscard]] double bits_for_many(const NodeType* siblings, int count, double prior_hits) const {
    constexpr std::size_t kAtOnce = 8;
    RateComparison rates(prior_hits);
    std::array<double, kAtOnce> hits;
    std::array<double, kAtOnce> misses;
    std::size_t n = 0;
    for (int j = 0; j < count; ++j) {
      const EvidenceCell& cell = siblings[j].cell();
      hits[n] = model_.effective_hits(cell);
      misses[n] = model_.effective_misses(cell);
      n += cell.observed();
      if (n < kAtOnce && j + 1 < count) continue;
      rates.add(hits.data(), misses.data(), n);
      n = 0;
    }
    return rates.bits_for_many();
  }
  /// The sum of the Kullback-Leibler divergences of siblings' occupancies from their parent's [nats]. With
  /// the odds o = p / (1 - p), each is
  ///   p log(p / q) + (1 - p) log((1 - p) / (1 - q)) = p (log o_p - log o_q) + log((1 + o_q) / (1 + o_p)).
  template <class NodeType>
  [[nodiscard]] double divergence(const NodeType* siblings, int count, const EvidenceCell& parent) const {
    constexpr double kLarge = 1e200;
    const double of_parent = 1.0 + model_.odds_of(parent);
    double sum = 0.0;
    double ratio = 1.0;  // The product of all the quotients.
    for (int j = 0; j < count; ++j) {
      const EvidenceCell& cell = siblings[j].cell();
      const double odds = model_.odds_of(cell);
      sum += unfused(odds / (1.0 + odds) *
                     (static_cast<double>(cell.log_odds()) - static_cast<double>(parent.log_odds())));
      ratio *= of_parent / (1.0 + odds);
      if (ratio > kLarge || ratio < 1.0 / kLarge) {
        sum += quick_log(ratio);
        ratio = 1.0;
      }
    }
    return sum + quick_log(ratio);
  }

  /// Rounded up, so that what was seen once is not forgotten.
  [[nodiscard]] static std::int64_t scaled(std::int64_t sum, std::int64_t times, std::int64_t over) {
    return (sum * times + over - 1) / over;
  }

  double max_loss_;
  EvidenceModel model_;
};

/// What siblings become together by a refinement's rule; none if they stay.
template <class Tree, class Refinement>
[[nodiscard]] std::optional<typename Tree::Cell> merged_siblings(const Refinement& refinement,
                                                                 const typename Tree::NodeType* siblings) {
  if constexpr (std::is_same_v<typename Tree::Cell, EvidenceCell>)
    return refinement.merge_rule(siblings, Tree::kNumChildren, kChildrenAcross<Tree>);
  else
    return refinement.merged(siblings, Tree::kNumChildren);
}

}  // namespace ndtree
