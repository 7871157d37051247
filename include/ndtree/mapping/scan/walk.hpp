// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A whole scan into the tree at once: every node hands the beams that cross it down to its children.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/evidence_summary.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/mapping/coverage.hpp"
#include "ndtree/mapping/scan/beams.hpp"
#include "ndtree/mapping/scan/clip.hpp"
#include "ndtree/mapping/scan/coarse_lists.hpp"
#include "ndtree/mapping/scan/coverage.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/mapping/scan/image.hpp"
#include "ndtree/mapping/scan/leaf.hpp"
#include "ndtree/mapping/scan/shares.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// The part of an update that goes down the tree: what one thread does. See ScanUpdate.
template <class Tree, class Refinement, class Sensor>
class alignas(128) ScanWalk {  // Threads, each with its own, share no cache line.
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  static constexpr int kNumChildren = Tree::kNumChildren;

 public:
  using Ref = typename Tree::Ref;

  /// @param arena of the tree, for this thread alone. @param undo where it remembers what it changes, or
  /// null. @param window outside which no cell of the coarsest level changes; null: all may.
  ScanWalk(Tree& tree, typename Tree::Arena& arena, const Refinement& refinement, const Sensor& sensor,
           const ScanBeams<D>& beams, UndoLog<Tree>* undo, const LatticeBox<D>* window = nullptr)
      : tree_(tree),
        arena_(arena),
        undo_(undo),
        window_(window),
        refinement_(refinement),
        beams_(beams),
        clip_(tree.geometry(), beams),
        evidence_(tree.geometry(), beams, refinement.model, sensor),
        coverage_(beams, clip_),
        shares_(tree.geometry(), beams, refinement.model),
        summary_(refinement.model),
        finest_level_(tree.geometry().finest_level()),
        coarsest_level_(Refinement::coarsest_level(finest_level_)),
        few_may_be_too_many_(refinement.model.may_limit(kFewBeams)) {}

  [[nodiscard]] const UpdateCounters& counters() const { return counters_; }

  /// The whole update.
  void run() {
    const Crossings list = beams_from(0, beams_.size());
    if (!list.empty()) descend(tree_.root(), list, false);
  }
  /// Brings the beams from the first to before the last to the cells of the coarsest level. The tree stays as
  /// it is.
  void bring(std::size_t first, std::size_t last, std::size_t part, CoarseLists<D>& lists) {
    const CrossingStack::Mark mark = stack_.mark();
    const Crossings list = beams_from(first, last);
    if (!list.empty()) bring(tree_.root().index, list, false, part, lists);
    stack_.release(mark);
  }
  /// Brings beams from an inner node to its children, as well.
  void open(const CellIndex<D>& node, const CoarseList<D>& beams, CoarseLists<D>& lists) {
    for_each_child(
        node, beams.list, shares_.all_take_all(node, beams.list),
        [&](const CellIndex<D>& child, const Crossings& list) { lists.add(child.lower, beams.part, list); });
  }
  /// What is left to do in one of these cells. @returns whether it changed.
  bool run(const Ref& ref, const CoarseCell<D>& beams) {
    if (beams.last - beams.first == 1) return descend(ref, beams.first->list, false);
    const CrossingStack::Mark mark = stack_.mark();
    Crossings list = stack_.allocate(beams.size + Crossings::kSlack);
    for (const CoarseList<D>* part = beams.first; part != beams.last; ++part) append(part->list, list);
    const bool changed = descend(ref, list, false);
    stack_.release(mark);
    return changed;
  }
  /// What is left to do in a node that was opened, after its children. @param changed whether one of them
  /// did.
  /// @returns whether the node did.
  bool close(const Ref& ref, bool changed) {
    if (!changed && ref.node->note() != 0) return false;
    return finish_children(ref, summary_(&Children(tree_, ref).node(0)), changed, false);
  }

 private:
  [[nodiscard]] Crossings beams_from(std::size_t first, std::size_t last) {
    Crossings list = stack_.allocate(last - first + Crossings::kSlack);
    for (std::size_t i = first; i < last; ++i) {
      list.beam[i - first] = static_cast<std::uint32_t>(i);
      list.enter()[i - first] = 0.0f;
      list.exit()[i - first] = beams_.reach()[i];
    }
    list.size = last - first;
    return list;
  }
  void bring(const CellIndex<D>& node, const Crossings& list, bool takes_all, std::size_t part,
             CoarseLists<D>& lists) {
    if (!may_change(node)) return;
    if (node.level <= coarsest_level_) {
      lists.add(node.lower, part, list);
      return;
    }
    takes_all = takes_all || shares_.all_take_all(node, list);
    for_each_child(node, list, takes_all, [&](const CellIndex<D>& child, const Crossings& beams) {
      bring(child, beams, takes_all, part, lists);
    });
  }
  /// Calls `visit(child, list)` for the children that some of a node's beams cross; the tree stays as it is.
  template <class Visit>
  void for_each_child(const CellIndex<D>& node, const Crossings& list, bool takes_all, const Visit& visit) {
    const CrossingStack::Mark mark = stack_.mark();
    const Lists children = hand_down(node, list, takes_all);
    for (int c = 0; c < kNumChildren; ++c)
      if (!children.of(c).empty()) visit(tree_.geometry().child(node, child_offset<N, D>(c)), children.of(c));
    stack_.release(mark);
  }
  /// Whether a node of the coarsest level or above lies in the window.
  [[nodiscard]] bool may_change(const CellIndex<D>& node) const {
    return window_ == nullptr || window_->overlaps(node, tree_.geometry().edge(node.level));
  }

  using Clip = ChildClip<N, D>;
  using Lists = typename Clip::Lists;

  /// Hands a node's beams to its children, without those that no cell below takes.
  /// @param takes_all BeamShares::all_take_all() of the node.
  Lists hand_down(const CellIndex<D>& node, const Crossings& list, bool takes_all) {
    pace_.spend(list.size);
    Lists children = clip_.lists_for(node, list, stack_);
    if (takes_all || list.size <= kFewBeams)
      clip_(node, list, children);
    else
      hand_down_what_is_taken(node, list, children);
    if (list.size > kMany)
      stack_.shrink(children.memory, children.pack());  // There was room for all in each.
    return children;
  }
  void hand_down_what_is_taken(const CellIndex<D>& node, const Crossings& list, Lists& children) const {
    std::size_t from = 0;  // Of beams that follow each other, and are not handed down yet.
    for_each_face(beams_, list, [&](const ScanFace<D>& face, std::size_t first, std::size_t last) {
      const std::size_t end = shares_.end_of_all_shares(node, face, list, first, last);
      if (end == last) return;
      clip_(node, list.part(from, end), children);
      from = last;
    });
    if (from < list.size) clip_(node, list.part(from, list.size), children);
  }

  /// @param list not empty. @param takes_all whether all leaves in some node above take all of it.
  /// @returns whether a cell changed.
  bool descend(const Ref& ref, const Crossings& list, bool takes_all) {
    if (ref.index.level >= coarsest_level_ && !may_change(ref.index)) return false;
    if (ref.index.level <= coarsest_level_ && ref.is_leaf()) return update_leaf(ref, list, takes_all);
    if (!ref.is_leaf()) {
      if (Summary(ref.node->note()).is_settled() && evidence_.all_pass(list)) return false;
      if (undo_ != nullptr) undo_->keep(tree_, *ref.node);
    } else {
      tree_.split_node(*ref.node, {}, arena_);
    }
    takes_all = takes_all || shares_.all_take_all(ref.index, list);
#ifdef NDTREE_HAS_EIGHTS
    if (are_few(ref, list)) return update_children_of_few(ref, list, takes_all);
#endif
    const CrossingStack::Mark mark = stack_.mark();
    return update_children(ref, hand_down(ref.index, list, takes_all), mark, false, takes_all);
  }

  bool update_leaf(const Ref& leaf, const Crossings& list, bool takes_all) {
    bool is_known = refinement_.model.is_known(leaf.cell());
    if (is_known && refinement_.model.is_settled(leaf.cell())) {
      if (evidence_.all_pass(list)) return false;
      is_known = !is_contradicted(leaf.index, list);
    }
    if (!takes_all && !shares_.takes_all(leaf.index, list, is_known))
      return update_by_sample(leaf, list, is_known);
    ScanEvidence scan;
    evidence_.add(leaf.index, list, scan);
    refinement_.model.limit(scan);
    return may_divide(leaf.cell(), leaf.index.level, scan) ? divide(leaf, list, all_, scan, takes_all)
                                                           : update(leaf.cell(), scan);
  }
  bool update_by_sample(const Ref& leaf, const Crossings& list, bool is_known) {
    ScanEvidence scan;
    shares_.take(leaf.index, list, is_known, sample_, [&](const ScanFace<D>&, float, const Crossings& part) {
      evidence_.add(leaf.index, part, scan);
    });
    refinement_.model.limit(scan);
    return may_divide(leaf.cell(), leaf.index.level, scan) ? divide(leaf, list, sample_, scan, false)
                                                           : update(leaf.cell(), scan);
  }
  /// Whether a leaf may have to split.
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool may_divide(const EvidenceCell& leaf, int level,
                                                     const ScanEvidence& scan) const {
    return level != finest_level_ && (is_unseen(leaf, scan) || refinement_.splits(leaf, scan));
  }
  /// Whether beams have only passed a leaf that was never observed. Those that are were seen before; hits
  /// speak for themselves.
  [[nodiscard]] bool is_unseen(const EvidenceCell& leaf, const ScanEvidence& scan) const {
    return !leaf.observed() && scan.hits == 0 && scan.occupied == 0 && refinement_.coverage.is_on();
  }
  bool divide(const Ref& leaf, const Crossings& list, const LeafSample<D>& sample, const ScanEvidence& scan,
              bool takes_all) {
    if (scan.beams == 0) return false;
    return is_unseen(leaf.cell(), scan) ? update_unseen(leaf, list, sample, scan, takes_all)
                                        : split(leaf, list, sample, takes_all);
  }
  /// A leaf that was never observed, and that beams have only passed.
  bool update_unseen(const Ref& leaf, const Crossings& list, const LeafSample<D>& sample,
                     const ScanEvidence& scan, bool takes_all) {
    const CoverageVerdict seen = look_at_coverage(leaf, list, sample);
    if (seen.shows_more) return split(leaf, list, sample, takes_all);
    if (!seen.is_enough) return counted(refinement_.model.remember(leaf.cell(), seen.parts, scan), scan);
    return update(leaf.cell(), scan);
  }
  bool update(EvidenceCell& cell, const ScanEvidence& scan) {
    return scan.beams > 0 && counted(refinement_.model.update(cell, scan), scan);
  }
  bool counted(bool changed, const ScanEvidence& scan) {
    counters_.updates += changed ? scan.beams : 0;
    return changed;
  }

  bool split(const Ref& leaf, const Crossings& list, const LeafSample<D>& sample, bool takes_all) {
    const CrossingStack::Mark mark = stack_.mark();
    const EvidenceCell parent = leaf.cell();
    ++counters_.splits;
#ifdef NDTREE_HAS_EIGHTS
    if (are_few(leaf, list)) {
      tree_.split_node(*leaf.node, {}, arena_);
      const Heritage heritage{parent, places_of(sample, list)};
      return update_children_of_few(leaf, list, takes_all, &heritage);
    }
#endif
    const Lists lists = hand_down(leaf.index, list, takes_all);
    tree_.split_node(*leaf.node, {}, arena_);
    if (EvidenceModel::has_heirs(parent)) share_out(parent, tree_.children(*leaf.node), lists, list, sample);
    return update_children(leaf, lists, mark, true, takes_all);
  }

  /// @param lists of the children, allocated after the mark.
  bool update_children(const Ref& ref, const Lists& lists, const CrossingStack::Mark& mark, bool was_split,
                       bool takes_all) {
    const bool are_cells = ref.index.level <= coarsest_level_;
    bool changed = was_split;
    const Children children(tree_, ref);
#ifdef __GNUC__
#pragma GCC unroll 8
#endif
    for (int c = 0; c < kNumChildren; ++c) {
      const Crossings list = lists.of(c);
      if (list.empty()) continue;
      const Ref child = children[c];
      const bool child_changed = are_cells && child.is_leaf() ? update_leaf(child, list, takes_all)
                                                              : descend(child, list, takes_all);
      changed = child_changed || changed;
    }
    stack_.release(mark);
    if (!changed && ref.node->note() != 0) return false;
    return finish_children(ref, summary_(&children.node(0)), changed, was_split);
  }
#ifdef NDTREE_HAS_EIGHTS
  using Few = FewCrossings<D, kNumChildren>;
  using FewBeams = FewOfChild<D, kNumChildren>;
  using OfBeam = typename LeafEvidence<N, D, Sensor>::OfBeam;

  /// Whether a node's children are cells, or nodes of cells, and its list needs none for them.
  [[nodiscard]] bool are_few(const Ref& ref, const Crossings& list) const {
    return list.size <= Few::kMost && ref.index.level <= coarsest_level_ && clip_.goes_by_eights() &&
           evidence_.takes_few(ref.index.level);
  }
  /// What a leaf that was split knew, and which of its few beams counted in it.
  struct Heritage {
    const EvidenceCell& cell;
    std::uint32_t sample;
  };
  [[nodiscard]] std::uint32_t places_of(const LeafSample<D>& sample, const Crossings& list) const {
    std::uint32_t set = 0;
    sample.for_each_part(beams_, list, [&](const Crossings& part) {
      set |= ((1u << part.size) - 1) << (part.beam - list.beam);
    });
    return set;
  }
  [[nodiscard]] static bool has_heirs(const Heritage* heritage) {
    return heritage != nullptr && EvidenceModel::has_heirs(heritage->cell);
  }
  /// update_children() of few beams, not none.
  /// @param heritage of a node that was split; else null.
  NDTREE_BY_EIGHTS bool update_children_of_few(const Ref& ref, const Crossings& list, bool takes_all,
                                               const Heritage* heritage = nullptr) {
    if constexpr (Clip::kFitLanes) {
      if (list.size == 1) {
        const LoneBeam beam = lone_beam(list.beam[0], list.enter()[0], list.exit()[0]);
        return update_children_of_one(ref, beam, takes_all, heritage);
      }
    }
    EightBeams<D> beams;
    beams_.look_up(detail::load_live(list.beam, detail::first_of_eight(list.size)), beams);
    return update_children_of_few(ref, list, beams, takes_all, heritage);
  }
  /// @param crossings Crossings or FewBeams, of these beams.
  template <class SomeCrossings>
  NDTREE_BY_EIGHTS bool update_children_of_few(const Ref& ref, const SomeCrossings& crossings,
                                               EightBeams<D>& beams, bool takes_all,
                                               const Heritage* heritage = nullptr) {
    pace_.spend(Few::kMost);
    Few few(beams);
    clip_(ref.index, crossings, few);
    if (has_heirs(heritage)) share_out(*heritage, few, tree_.children(*ref.node));
    const bool was_split = heritage != nullptr;
    typename LeafEvidence<N, D, Sensor>::FewEvidence evidence(evidence_, ref.index, few);
    const Children children(tree_, ref);
    const EvidenceModel& model = refinement_.model;
    std::optional<typename BeamShares<N, D>::Children> shares;
    if (!takes_all) shares.emplace(shares_, ref.index, crossings);
    bool changed = was_split;
#pragma GCC unroll 1
    for (int c = 0; c < kNumChildren; ++c) {
      const FewBeams of_child{few, static_cast<std::size_t>(c)};
      if (of_child.set() == 0) continue;
      auto& node = children.node(c);
      if (!node.is_leaf()) {
        if (Summary(node.note()).is_settled() && of_child.all_pass()) continue;
        changed = descend(children[c], of_child, takes_all) || changed;
        continue;
      }
      EvidenceCell& cell = node.cell();
      const bool is_known = model.is_known(cell);
      if (is_known && model.is_settled(cell)) {
        if (of_child.all_pass()) continue;
      } else if (takes_all ||
                 (shares->face() != nullptr ? shares->takes_all(of_child.child, is_known)
                                            : shares_.takes_all(children[c].index, of_child, is_known))) {
        ScanEvidence scan;
        if (of_child.is_one())
          OfBeam(evidence_, ref.index.level - 1, of_child.first_beam())
              .add(children[c].index, of_child.enter_of_first(), of_child.exit_of_first(), scan);
        else
          evidence.add(of_child.child, scan);
        if (few_may_be_too_many_) model.limit(scan);
        changed = (may_divide(cell, ref.index.level - 1, scan)
                       ? divide(children[c], of_child, scan, takes_all)
                       : scan.beams > 0 && counted(model.update(cell, scan), scan)) ||
                  changed;
        continue;
      } else if (const ScanFace<D>* const face = shares_.only_face_of(of_child)) {
        changed = update_by_sample(ref.index, children[c], of_child, *face, is_known) || changed;
        continue;
      }
      changed = update_leaf(children[c], of_child, takes_all) || changed;
    }
    if (!changed && ref.node->note() != 0) return false;
    return finish_children(ref, summary_.by_eights(&children.node(0)), changed, was_split);
  }
  bool descend(const Ref& inner, const FewBeams& beams, bool takes_all) {
    if constexpr (Clip::kFitLanes) {
      if (beams.is_one())
        return descend(inner, lone_beam(beams.first_beam(), beams.enter_of_first(), beams.exit_of_first()),
                       takes_all);
    }
    if (undo_ != nullptr) undo_->keep(tree_, *inner.node);
    return update_children_of_few(inner, beams, beams.of.beams,
                                  takes_all || shares_.all_take_all(inner.index, beams));
  }
  /// A leaf that takes a sample of few beams, all of one face. @param node the leaf's parent.
  NDTREE_NEVER_INLINE bool update_by_sample(const CellIndex<D>& node, const Ref& leaf, const FewBeams& beams,
                                            const ScanFace<D>& face, bool is_known) {
    const float share = shares_.of(leaf.index, face, is_known);
    std::uint32_t set = beams.set();
    std::uint32_t end = face.end_of_beams;
    if (share < 1.0f)  // The least chance comes first.
      for (; set != 0 && !(beams_.chance()[beams.of.last_of(set)] < share); set = beams.of.without_last(set))
        end = beams.of.last_of(set);
    ScanEvidence scan;
    if (set != 0) evidence_.add(node, beams.of, beams.child, set, scan);
    refinement_.model.limit(scan);
    if (!may_divide(leaf.cell(), leaf.index.level, scan)) return update(leaf.cell(), scan);
    return with_list(beams, [&](const Crossings& list) {
      return divide_by_share(leaf, list, {&face, end, share}, scan);
    });
  }
  bool divide_by_share(const Ref& leaf, const Crossings& list, const FaceShare<D>& share,
                       const ScanEvidence& scan) {
    sample_.clear();
    sample_.add(share);
    return divide(leaf, list, sample_, scan, false);
  }
  /// A beam that is alone in a node, and so in all nodes below; distances as in Crossings.
  struct LoneBeam {
    std::uint32_t number;
    const ScanFace<D>& face;
    float enter;
    float exit;
  };
  [[nodiscard]] LoneBeam lone_beam(std::uint32_t number, float enter, float exit) const {
    return {number, beams_.face_of(number), enter, exit};
  }
  NDTREE_BY_EIGHTS bool update_children_of_one(const Ref& ref, const LoneBeam& beam, bool takes_all,
                                               const Heritage* heritage = nullptr) {
    pace_.spend(1);
    const BeamWay<D>& way = beams_.way(beam.number);
    LoneCrossing lone;
    clip_(ref.index, way, beam.enter, beam.exit, lone);
    if (has_heirs(heritage)) share_out(*heritage, beam.number, lone, tree_.children(*ref.node));
    const bool was_split = heritage != nullptr;
    const OfBeam evidence(evidence_, ref.index.level - 1, beam.number);
    const Children children(tree_, ref);
    const EvidenceModel& model = refinement_.model;
    bool changed = was_split;
    for (std::uint32_t left = lone.set; left != 0; left &= left - 1) {
      const auto c = static_cast<std::size_t>(__builtin_ctz(left));
      const Ref child = children[static_cast<int>(c)];
      const LoneBeam in_child{beam.number, beam.face, lone.enter[c], lone.exit[c]};
      const bool passes = in_child.exit < way.pass;
      if (!child.is_leaf()) {
        if (Summary(child.node->note()).is_settled() && passes) continue;
        changed = descend(child, in_child, takes_all) || changed;
        continue;
      }
      EvidenceCell& cell = child.cell();
      const bool is_known = model.is_known(cell);
      if (is_known && model.is_settled(cell)) {
        if (!passes) changed = update_leaf(child, in_child, takes_all) || changed;
        continue;
      }
      const float share = takes_all ? 1.0f : shares_.of(child.index, beam.face, is_known);
      if (share < 1.0f && !(beams_.chance()[beam.number] < share)) continue;
      ScanEvidence scan;
      evidence.add(child.index, in_child.enter, in_child.exit, scan);
      if (few_may_be_too_many_) model.limit(scan);
      changed = (may_divide(cell, child.index.level, scan)
                     ? divide(child, in_child, share, scan, takes_all)
                     : scan.beams > 0 && counted(model.update(cell, scan), scan)) ||
                changed;
    }
    if (!changed && ref.node->note() != 0) return false;
    return finish_children(ref, summary_.by_eights(&children.node(0)), changed, was_split);
  }
  bool descend(const Ref& inner, const LoneBeam& beam, bool takes_all) {
    if (undo_ != nullptr) undo_->keep(tree_, *inner.node);
    return update_children_of_one(inner, beam, takes_all || shares_.all_take_all(inner.index, beam.face));
  }
  /// share_out() to the children that few beams cross ...
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void share_out(const Heritage& heritage, const Few& few,
                                                      typename Tree::NodeType* children) const {
    const std::uint32_t sample = heritage.sample;
    const EightEnds<D>& ends = beams_.ends_of(few.beams);
    const __m256 no_return = _mm256_cmp_ps(ends.surface, _mm256_setzero_ps(), _CMP_EQ_OQ);
    for (std::size_t j = 0; j < kNumChildren; ++j) {
      const __m256 is_clear = _mm256_cmp_ps(_mm256_load_ps(few.exit[j].data()), ends.clear, _CMP_LT_OQ);
      const auto passed = static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_or_ps(is_clear, no_return)));
      children[j].cell() = inherited(heritage.cell, count(few.set[j] & sample & passed), count(sample), j);
    }
  }
  /// ... or one.
  NDTREE_NEVER_INLINE void share_out(const Heritage& heritage, std::uint32_t beam, const LoneCrossing& lone,
                                     typename Tree::NodeType* children) const {
    const BeamEnd<D>& end = beams_.end(beam);
    for (std::size_t j = 0; j < kNumChildren; ++j) {
      const bool passed = (lone.set >> j & 1u) != 0 && (!end.is_returned() || lone.exit[j] < end.clear);
      children[j].cell() = inherited(heritage.cell, passed, count(heritage.sample), j);
    }
  }
  [[nodiscard]] static std::size_t count(std::uint32_t set) {
    return static_cast<std::size_t>(__builtin_popcount(set));
  }
  // What few beams rarely do:
  template <class Beams>
  bool update_leaf(const Ref& leaf, const Beams& beams, bool takes_all) {
    return with_list(beams, [&](const Crossings& list) { return update_leaf(leaf, list, takes_all); });
  }
  bool divide(const Ref& leaf, const FewBeams& beams, const ScanEvidence& scan, bool takes_all) {
    return with_list(beams, [&](const Crossings& list) { return divide(leaf, list, all_, scan, takes_all); });
  }
  NDTREE_NEVER_INLINE bool divide(const Ref& leaf, const LoneBeam& beam, float share,
                                  const ScanEvidence& scan, bool takes_all) {
    return with_list(beam, [&](const Crossings& list) {
      return share < 1.0f ? divide_by_share(leaf, list, {&beam.face, beam.face.end_of_beams, share}, scan)
                          : divide(leaf, list, all_, scan, takes_all);
    });
  }
  /// Calls `use(list)` with the beams in a list.
  template <class Beams, class Use>
  bool with_list(const Beams& beams, const Use& use) {
    const CrossingStack::Mark mark = stack_.mark();
    Crossings list = stack_.allocate(Few::kMost + Crossings::kSlack);
    write(beams, list);
    const bool result = use(list);
    stack_.release(mark);
    return result;
  }
  void write(const FewBeams& beams, Crossings& list) const { clip_.write(beams, list); }
  void write(const LoneBeam& beam, Crossings& list) const {
    list.beam[0] = beam.number;
    list.enter()[0] = beam.enter;
    list.exit()[0] = beam.exit;
    list.size = 1;
  }
#endif
  /// The children of an inner node, by their numbers.
  class Children {
   public:
    NDTREE_ALWAYS_INLINE Children(Tree& tree, const Ref& parent)
        : parent_(parent),
          nodes_(tree.children(*parent.node)),
          edge_(tree.geometry().edge(parent.index.level - 1)) {}
    [[nodiscard]] auto& node(int number) const { return nodes_[number]; }
    [[nodiscard]] NDTREE_ALWAYS_INLINE Ref operator[](int number) const {
      Ref child{nodes_ + number, {parent_.index.lower, parent_.index.level - 1}};
      for (std::size_t a = 0; a < D; ++a, number /= N) child.index.lower[a] += number % N * edge_;
      return child;
    }

   private:
    const Ref& parent_;
    typename Tree::NodeType* nodes_;
    std::int64_t edge_;
  };
  /// Writes the note of a node after its children's update, or merges them.
  /// @param all what they say together.
  NDTREE_ALWAYS_INLINE bool finish_children(const Ref& ref, const SummaryOfSiblings& all, bool changed,
                                            bool was_split) {
    if (changed && ref.index.level <= coarsest_level_ && all.are_leaves && all.summary.is_uniform() &&
        merge_children(ref, was_split))
      return true;
    ref.node->set_note(all.summary.word());
    return changed;
  }
  bool merge_children(const Ref& ref, bool was_split) {
    const auto merged =
        refinement_.merge_rule.of_one_state(tree_.children(*ref.node), kNumChildren, kShareDivisor<Tree>);
    if (!merged) return false;
    tree_.merge(*ref.node, *merged, arena_);
    if (was_split)
      --counters_.splits;
    else
      ++counters_.merges;
    return true;
  }

  /// Gives children what is due to them of what their parent knew.
  void share_out(const EvidenceCell& parent, typename Tree::NodeType* children, const Lists& lists,
                 const Crossings& list, const LeafSample<D>& sample) const {
    std::size_t beams = 0;
    sample.for_each_part(beams_, list, [&](const Crossings& part) { beams += part.size; });
    for (std::size_t j = 0; j < kNumChildren; ++j)
      children[j].cell() = inherited(parent, count_passed(lists.of(static_cast<int>(j)), sample), beams, j);
  }
  /// @param passed of so many beams.
  [[nodiscard]] EvidenceCell inherited(const EvidenceCell& parent, std::size_t passed, std::size_t beams,
                                       std::size_t child) const {
    return refinement_.model.inherited(parent, kShareDivisor<Tree>, passed, beams,
                                       CellParts<N, D>::of_child(static_cast<int>(child)));
  }
  /// Those at whose exit the beam has clearly not met anything.
  [[nodiscard]] std::size_t count_passed(const Crossings& list, const LeafSample<D>& sample) const {
    std::size_t n = 0;
    sample.for_each_part(beams_, list, [&](const Crossings& part) {
      for (std::size_t i = 0; i < part.size; ++i) {
        const std::uint32_t beam = part.beam[i];
        const BeamEnd<D>& end = beams_.end(beam);
        n += !end.is_returned() || part.exit()[i] < end.clear;
      }
    });
    return n;
  }

  /// Whether more beams end in a leaf that knows as much free space as it can than the sensor's errors
  /// explain, of those of a sample that would cross it if they were spread evenly.
  [[nodiscard]] bool is_contradicted(const CellIndex<D>& leaf, const Crossings& list) {
    double blocked = 0.0;
    shares_.take(
        leaf, list, false, sample_, [&](const ScanFace<D>& face, float share, const Crossings& part) {
          std::size_t ends = 0;
          for (std::size_t i = 0; i < part.size; ++i) {
            const std::uint32_t beam = part.beam[i];
            ends += beams_.end(beam).is_returned() && tree_.geometry().contains(leaf, beams_.end_cell(beam));
          }
          float expected = 1.0f;
          if (!face.is_lone() && ends > 0)
            expected = std::max(1.0f, share * shares_.expected_beams(leaf, face));
          blocked += static_cast<double>(ends) / static_cast<double>(expected);
        });
    return blocked > refinement_.split_test.model().free_until();
  }

  /// Whether enough of a leaf was seen to update it as a whole.
  [[nodiscard]] CoverageVerdict look_at_coverage(const Ref& leaf, const Crossings& list,
                                                 const LeafSample<D>& sample) const {
    const float per_child = 1.0f / static_cast<float>(tree_.geometry().cell_size(leaf.index.level - 1));
    ScanCoverage<N, D> coverage;
    sample.for_each_share(beams_, list, [&](const ScanFace<D>& face, float share, const Crossings& part) {
      // Those of a sample stand for those that are not in it, too.
      const BeamWidths widths{face.width_of_beam() * shares_.widening(share) * per_child,
                              static_cast<float>(tree_.geometry().unit()) * per_child};
      coverage_(leaf.index, part, per_child, widths, coverage);
    });
    const EvidenceCell& cell = leaf.cell();
    const std::uint32_t seen_before = cell.is_partly_seen() ? cell.seen_parts() : 0;
    return refinement_.coverage.judge(coverage, seen_before,
                                      tree_.geometry().cell_size(leaf.index.level) / tree_.geometry().unit());
  }
  static constexpr std::size_t kMany = 8000;  // Beams: where their lists lie apart, caches lack room.

  Tree& tree_;
  typename Tree::Arena& arena_;
  UndoLog<Tree>* undo_;
  const LatticeBox<D>* window_;
  const Refinement& refinement_;
  const ScanBeams<D>& beams_;
  const ChildClip<N, D> clip_;
  const LeafEvidence<N, D, Sensor> evidence_;
  const LeafCoverage<N, D> coverage_;
  const BeamShares<N, D> shares_;
  const EvidenceSummary<kNumChildren> summary_;
  const int finest_level_;
  const int coarsest_level_;
  const bool few_may_be_too_many_;  // That so few beams count in a leaf.
  UpdateCounters counters_;
  Pace pace_;
  CrossingStack stack_;  // Of the nodes on the path from the root, the deepest last.
  const LeafSample<D> all_;
  LeafSample<D> sample_;  // Of the leaf that is looked at, until its children are.
};

}  // namespace ndtree
