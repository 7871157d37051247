// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// One beam into the tree: Bayes update and counts leaf by leaf, splits on the way, merges on the way back.
#pragma once

#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/rounded.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/scan/measurements.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// Visitor that integrates one beam (Sec. III). Three kinds of leaves:
/// - the one that the end point of a returned beam lies in counts a hit; if the beam only touches that cell
///   in a corner, the next one along the beam does;
/// - those before it count a miss, and so does every leaf that a beam without return passes as a whole;
/// - those behind it, up to range + 3 sigma, count neither, but get their part of the Bayes update.
template <class Tree, class Refinement, class Sensor>
class BeamUpdate : public BeamVisitor {
  static constexpr int D = Tree::kDim;

 public:
  BeamUpdate(Tree& tree, const Refinement& refinement, const Sensor& sensor, const MapOptions& options,
             UpdateCounters& counters)
      : tree_(tree),
        refinement_(refinement),
        sensor_(sensor),
        log_odds_min_(static_cast<float>(options.log_odds_min)),
        log_odds_max_(static_cast<float>(options.log_odds_max)),
        finest_level_(tree.geometry().finest_level()),
        coarsest_level_(Refinement::coarsest_level(finest_level_)),
        counters_(counters) {}

  /// One beam after the other.
  [[nodiscard]] static std::size_t most_workers(Eigen::Index /*beams*/) { return 1; }

  /// Surveys a scan, which must stay where it is until finish() is done; the tree stays as it is.
  /// @throws as survey_exactly().
  ScanSurvey<D> survey(const Measurements<D, Sensor>& measurements, Workers& /*workers*/) {
    measurements_ = &measurements;
    return survey_exactly(tree_.geometry(), measurements, measurements.all());
  }

  /// Integrates beam after beam. @pre the tree contains what the survey reaches.
  /// @param undo gets one log; null if none is to be kept.
  /// @param window outside which no cell of the coarsest level changes.
  void finish(Workers& /*workers*/, std::vector<UndoLog<Tree>>* undo = nullptr,
              const ChangeWindow<D>& window = {}) {
    window_ = window;
    if (undo != nullptr) undo->resize(1);
    undo_ = undo == nullptr ? nullptr : undo->data();
    for (Eigen::Index i = 0; i < measurements_->scan().size; ++i) {
      const Beam<D> beam = measurements_->beam(i);
      if (beam.outcome != BeamOutcome::invalid) add(beam, measurements_->sigma(i, beam.range));
    }
  }

  template <class Ref>
  bool passes_over(const Ref& parent) {
    if (is_outside(parent)) return false;        // Its leaves may yet hold the end of the beam.
    if (parent.node->note() == 0) return false;  // It was split by this scan, or has been here.
    if (undo_ != nullptr) undo_->keep(tree_, *parent.node);
    parent.node->set_note(0);  // Until the scan is done.
    return false;
  }

  template <class Ref>
  void enter(const Ref& leaf) {
    if (leaf.index.level > coarsest_level_ && !is_outside(leaf)) tree_.split(leaf);
  }

  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    pace_.spend();
    if (is_outside(leaf)) return pass_outside(t_exit);
    auto& cell = leaf.cell();
    if (t_exit < t_clearly_free_) {
      cell.update(sensor_.log_odds_free(), log_odds_min_, log_odds_max_);
      cell.count_miss();
    } else if (returned_) {
      const double cdf_entry =
          t_enter == t_known_ ? cdf_known_ : Sensor::cdf(rounded(t_enter * range_), range_, sigma_);
      t_known_ = t_exit;
      cdf_known_ = Sensor::cdf(rounded(t_exit * range_), range_, sigma_);
      cell.update(sensor_.log_odds(cdf_entry, cdf_known_), log_odds_min_, log_odds_max_);
      if (!hit_counted_ && t_exit >= t_hit_) {
        cell.count_hit();
        hit_counted_ = true;
      } else if (!hit_counted_) {
        cell.count_miss();
      }
    } else {  // A beam without return passes every leaf up to where it ends.
      cell.update(sensor_.log_odds_free(), log_odds_min_, log_odds_max_);
      cell.count_miss();
    }
    ++counters_.updates;
    if (leaf.index.level > finest_level_ && refinement_.splits(cell)) {
      tree_.split(leaf);
      ++counters_.splits;
    } else if (refinement_.may_merge(cell)) {
      try_merge_ = true;
    }
    return true;
  }

  template <class Ref>
  void leave(const Ref& parent) {
    if (!try_merge_) return;
    try_merge_ = false;  // A sibling that stays divided forbids the merge one level up, too.
    if (parent.index.level > coarsest_level_ || is_outside(parent)) return;
    const auto merged = refinement_.merged(tree_.children(*parent.node), Tree::kNumChildren);
    if (!merged) return;
    tree_.merge(*parent.node, *merged);
    ++counters_.merges;
    try_merge_ = true;
  }

 private:
  /// A leaf that ends at the end point, within rounding, lies before the surface: the next one counts the
  /// hit.
  static constexpr double kBehindEnd = 1.0 + 1e-12;

  /// @param sigma of the range [m]. @pre the beam is valid, and the tree contains it up to t_end().
  void add(const Beam<D>& beam, double sigma) {
    range_ = beam.range;
    returned_ = beam.outcome == BeamOutcome::returned;
    hit_counted_ = false;
    try_merge_ = false;
    t_known_ = -1.0;
    sigma_ = sigma;
    t_clearly_free_ = returned_ ? sensor_.clearly_free_until(range_, sigma_) / range_ : beam.t_free;
    const double t_end = Sensor::t_end(beam, sigma);
    t_hit_ = std::min(kBehindEnd, t_end);
    traverse_beam(tree_, beam.origin, beam.displacement, 0.0, t_end, *this);
  }

  /// Whether nothing of a node is to change.
  template <class Ref>
  [[nodiscard]] bool is_outside(const Ref& ref) const {
    return !window_.overlaps(ref.index, tree_.geometry().edge(ref.index.level));
  }
  /// A leaf that only may take the hit, which others then do not.
  bool pass_outside(double t_exit) {
    if (t_exit < t_clearly_free_) return true;
    if (returned_) hit_counted_ = hit_counted_ || t_exit >= t_hit_;
    return true;
  }

  Tree& tree_;
  const Refinement& refinement_;
  const Sensor& sensor_;
  const float log_odds_min_;
  const float log_odds_max_;
  const int finest_level_;
  const int coarsest_level_;
  UpdateCounters& counters_;
  const Measurements<D, Sensor>* measurements_ = nullptr;

  // Of the beam being integrated:
  double range_ = 0.0;
  double sigma_ = 0.0;
  double t_clearly_free_ = 0.0;
  double t_hit_ = 0.0;     // The first leaf that ends there, or behind, counts the hit.
  double t_known_ = -1.0;  // The last leaf's exit, where cdf_known_ holds.
  double cdf_known_ = 0.0;
  bool returned_ = false;
  bool hit_counted_ = false;
  bool try_merge_ = false;  // A child of the node being left could take part in a merge.

  UndoLog<Tree>* undo_ = nullptr;
  ChangeWindow<D> window_;
  Pace pace_;
};

}  // namespace ndtree
