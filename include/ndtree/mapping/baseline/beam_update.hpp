// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// One beam into the tree: Bayes update and counts leaf by leaf, splits on the way, merges on the way back.
#pragma once

#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/baseline/beam_evidence.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// Visitor that integrates one beam: each leaf on its way is updated (see BeamEvidence), and may split or
/// merge.
template <class Tree, class Refinement, class Sensor>
class BeamUpdate : public BeamVisitor {
  static constexpr int D = Tree::kDim;

 public:
  BeamUpdate(Tree& tree, const Refinement& refinement, const Sensor& sensor, const MapOptions& options,
             UpdateCounters& counters)
      : tree_(tree),
        refinement_(refinement),
        evidence_(sensor, options),
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
  /// @param window nodes of the coarsest level that do not overlap it stay as they are, with all below them.
  void finish(Workers& /*workers*/, std::vector<UndoLog<Tree>>* undo = nullptr,
              const ChangeWindow<D>& window = {}) {
    window_ = window;
    if (undo != nullptr) undo->resize(1);
    undo_ = undo == nullptr ? nullptr : undo->data();
    for (Eigen::Index i = 0; i < measurements_->scan().size; ++i) {
      const Beam<D> beam = measurements_->beam(i);
      if (beam.outcome != BeamOutcome::invalid) add(beam, measurements_->sigma(i, beam));
    }
  }

  template <class Ref>
  bool passes_over(const Ref& parent) {
    if (is_outside(parent)) return true;
    before_change_below(tree_, *parent.node, undo_);
    return false;
  }

  template <class Ref>
  void enter(const Ref& leaf) {
    if (leaf.index.level > coarsest_level_ && !is_outside(leaf)) tree_.split(leaf);
  }

  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    pace_.spend();
    if (is_outside(leaf)) return true;
    auto& cell = leaf.cell();
    evidence_.update(cell, t_enter, t_exit);
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
  /// @param sigma of the range [m]. @pre the beam is valid, and the tree contains it up to t_end().
  void add(const Beam<D>& beam, double sigma) {
    try_merge_ = false;
    evidence_.begin(beam, sigma);
    traverse_beam(tree_, beam.origin, beam.displacement, 0.0, evidence_.t_end(), *this);
  }

  /// Whether nothing of a node is to change.
  template <class Ref>
  [[nodiscard]] bool is_outside(const Ref& ref) const {
    return !window_.overlaps(ref.index, tree_.geometry().edge(ref.index.level));
  }

  Tree& tree_;
  const Refinement& refinement_;
  BeamEvidence<Sensor> evidence_;
  const int finest_level_;
  const int coarsest_level_;
  UpdateCounters& counters_;
  const Measurements<D, Sensor>* measurements_ = nullptr;

  bool try_merge_ = false;  // A child of the node being left could take part in a merge.

  UndoLog<Tree>* undo_ = nullptr;
  ChangeWindow<D> window_;
  Pace pace_;
};

}  // namespace ndtree
