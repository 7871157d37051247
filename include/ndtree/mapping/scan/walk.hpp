// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A whole scan into the tree at once: every node hands the beams that cross it down to its children.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <optional>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/evidence_summary.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cache_lines.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/mapping/coverage.hpp"
#include "ndtree/mapping/scan/beam_lists.hpp"
#include "ndtree/mapping/scan/beams.hpp"
#include "ndtree/mapping/scan/clip.hpp"
#include "ndtree/mapping/scan/coarse_lists.hpp"
#include "ndtree/mapping/scan/coverage.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/mapping/scan/image.hpp"
#include "ndtree/mapping/scan/inheritance.hpp"
#include "ndtree/mapping/scan/leaf.hpp"
#include "ndtree/mapping/scan/shares.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// The part of an update that goes down the tree: what one thread does. See ScanUpdate.
template <class Tree, class Refinement, class Sensor>
class alignas(kCacheLines) ScanWalk {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  static constexpr int kNumChildren = Tree::kNumChildren;
  using Clip = ChildClip<N, D>;
  using Lists = typename Clip::Lists;
  using Planes = typename Clip::Planes;
  using Shares = NodeShares<D>;
  using ChildrenShares = typename BeamShares<N, D>::Children;
  using SharesOfAll = typename ChildrenShares::All;

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
        inheritance_(tree.geometry(), refinement.model, beams),
        summary_(refinement.model),
        finest_level_(tree.geometry().finest_level()),
        coarsest_level_(Refinement::coarsest_level(finest_level_)),
        few_may_be_too_many_(refinement.model.may_limit(kFewBeams)) {}

  [[nodiscard]] const UpdateCounters& counters() const { return counters_; }

  /// The whole update.
  void run() {
    const BeamList list = beams_from(0, beams_.size());
    if (!list.empty()) descend(tree_.root(), list, {});
  }
  /// Brings the beams from the first to before the last to the cells of the coarsest level. The tree stays as
  /// it is.
  void bring(std::size_t first, std::size_t last, std::size_t part, CoarseLists<D>& lists) {
    const ListStack::Mark mark = stack_.mark();
    const BeamList list = beams_from(first, last);
    if (!list.empty()) bring(tree_.root().index, list, {}, part, lists);
    stack_.release(mark);
  }
  /// Brings beams from an inner node to its children, as well.
  void open(const CellIndex<D>& node, const CoarseList<D>& beams, CoarseLists<D>& lists) {
    for_each_child(
        node, beams.list, shares_.of_node(node, beams.list, {}),
        [&](const CellIndex<D>& child, const BeamList& list) { lists.add(child.lower, beams.part, list); });
  }
  /// What is left to do in one of these cells. @returns whether it changed.
  bool run(const Ref& ref, const CoarseCell<D>& beams) {
    const ListStack::Mark mark = stack_.mark();
    const BeamList list = beams.last - beams.first == 1 ? beams.first->list : joined(beams);
    if (list.size <= kFetched) beams_.fetch(list.beam, list.size);
    const bool changed = descend(ref, list, {});
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
  [[nodiscard]] BeamList beams_from(std::size_t first, std::size_t last) {
    BeamList list = stack_.allocate(last - first + BeamList::kSlack);
    list.size = last - first;
    std::iota(list.beam, list.beam + list.size, static_cast<std::uint32_t>(first));
    list.close();
    return list;
  }
  [[nodiscard]] BeamList joined(const CoarseCell<D>& beams) {
    BeamList list = stack_.allocate(beams.size + BeamList::kSlack);
    for (const CoarseList<D>* part = beams.first; part != beams.last; ++part) append(part->list, list);
    list.close();
    return list;
  }
  void bring(const CellIndex<D>& node, const BeamList& list, const Shares& above, std::size_t part,
             CoarseLists<D>& lists) {
    if (!may_change(node)) return;
    if (node.level <= coarsest_level_) {
      lists.add(node.lower, part, list);
      return;
    }
    const Shares shares = shares_.of_node(node, list, above);
    for_each_child(node, list, shares, [&](const CellIndex<D>& child, const BeamList& beams) {
      bring(child, beams, shares, part, lists);
    });
  }
  /// Calls `visit(child, list)` for the children that some of a node's beams cross; the tree stays as it is.
  template <class Visit>
  void for_each_child(const CellIndex<D>& node, const BeamList& list, const Shares& shares,
                      const Visit& visit) {
    const ListStack::Mark mark = stack_.mark();
    const Lists children = hand_down(node, clip_.planes_of(node), list, shares, true);
    for (int c = 0; c < kNumChildren; ++c)
      if (!children.of(c).empty()) visit(tree_.geometry().child(node, child_offset<N, D>(c)), children.of(c));
    stack_.release(mark);
  }
  /// Whether a node of the coarsest level or above lies in the window.
  [[nodiscard]] bool may_change(const CellIndex<D>& node) const {
    return window_ == nullptr || window_->overlaps(node, tree_.geometry().edge(node.level));
  }

  /// Hands a node's beams to its children, without those that no cell below takes.
  /// @param replaces whether long lists of the children take the place of the node's own, which is then gone.
  /// @pre if so, nothing that is still in use was allocated after it.
  Lists hand_down(const CellIndex<D>& node, const Planes& planes, const BeamList& list, const Shares& shares,
                  bool replaces) {
    pace_.spend(list.size);
    if (Clip::kHasRoomForAll && list.size > kPiece)
      return hand_down_in_pieces(node, planes, list, shares, replaces);
    Lists children = clip_.lists_for(node, list, stack_);
    for_each_taken(node, list, shares, [&](const BeamList& taken) { clip_(node, planes, taken, children); });
    return children;
  }
  NDTREE_NEVER_INLINE Lists hand_down_in_pieces(const CellIndex<D>& node, const Planes& planes,
                                                const BeamList& list, const Shares& shares, bool replaces) {
    for_each_taken(node, list, shares, [&](const BeamList& taken) {
      for (std::size_t first = 0; first < taken.size; first += kPiece) {
        const BeamList part = taken.part(first, std::min(first + kPiece, taken.size));
        Lists children = clip_.lists_for(node, part, pieces_.memory());
        clip_(node, planes, part, children);
        pieces_.add(children);
      }
    });
    if (replaces) stack_.free_from(list);
    return pieces_.join(stack_);
  }
  /// Calls `visit(part)` for those parts of a list that some cell in a node takes.
  template <class Visit>
  void for_each_taken(const CellIndex<D>& node, const BeamList& list, const Shares& shares,
                      const Visit& visit) const {
    if (shares.takes_all || list.size <= kFewBeams) return visit(list);
    if (shares.face != nullptr) {
      const std::size_t end = shares_.end_of_all_shares(node, *shares.face, list, 0, list.size);
      if (end > 0) visit(list.part(0, end));
      return;
    }
    std::size_t from = 0;  // Of beams that follow each other, and were not visited yet.
    for_each_face(beams_, list, [&](const ScanFace<D>& face, std::size_t first, std::size_t last) {
      const std::size_t end = shares_.end_of_all_shares(node, face, list, first, last);
      if (end == last) return;
      if (from < end) visit(list.part(from, end));
      from = last;
    });
    if (from < list.size) visit(list.part(from, list.size));
  }

  /// @param list not empty. @param above what is known of a node above.
  /// @returns whether a cell changed.
  bool descend(const Ref& ref, const BeamList& list, const Shares& above) {
    if (ref.index.level >= coarsest_level_ && !may_change(ref.index)) return false;
    if (ref.index.level <= coarsest_level_ && ref.is_leaf()) return update_leaf(ref, list, above);
    if (!ref.is_leaf()) {
      if (Summary(ref.node->note()).is_saturated() && all_pass(ref, list)) return false;
      if (undo_ != nullptr) undo_->keep(tree_, *ref.node);
    } else {
      tree_.split_node(*ref.node, {}, arena_);
    }
    const Shares shares = shares_.of_node(ref.index, list, above);
#ifdef NDTREE_HAS_EIGHTS
    if (are_few(ref, list)) return update_children_of_few(ref, list, shares);
#endif
    const ListStack::Mark mark = stack_.mark();
    const Planes planes = clip_.planes_of(ref.index);
    return update_children(ref, planes, hand_down(ref.index, planes, list, shares, true), mark, false,
                           shares);
  }

  [[nodiscard]] CellCrossings<N, D> crossings_of(const CellIndex<D>& cell) const {
    return {tree_.geometry(), beams_, cell};
  }
  [[nodiscard]] NDTREE_NEVER_INLINE bool all_pass(const Ref& ref, const BeamList& list) const {
    return evidence_.all_pass(crossings_of(ref.index), list);
  }
  NDTREE_NEVER_INLINE bool update_leaf(const Ref& leaf, const BeamList& list, const Shares& shares) {
    return update_leaf(leaf, crossings_of(leaf.index), list, shares);
  }
  NDTREE_NEVER_INLINE bool update_leaf(const Ref& leaf, const CellCrossings<N, D>& crossings,
                                       const BeamList& list, const Shares& shares) {
    bool is_well_observed = refinement_.model.is_well_observed(leaf.cell());
    if (is_well_observed && refinement_.model.is_saturated(leaf.cell())) {
      if (evidence_.all_pass(crossings, list)) return false;
      // Unless more end in it than the sensor's errors explain: then it learns anew.
      is_well_observed = shares_.ends_for_each_expected(leaf.index, list, sample_) <=
                         refinement_.split_test.model().free_until();
    }
    if (!shares.takes_all) {
      const ScanFace<D>* const face = shares_.only_face_of(list, shares);
      if (face == nullptr) return update_by_sample(leaf, crossings, list, is_well_observed);
      return update_by_share(leaf, crossings, list,
                             shares_.share_of(*face, shares_.of(leaf.index, *face, is_well_observed)));
    }
    ScanEvidence scan = evidence_of(leaf, crossings, list);
    refinement_.model.limit(scan);
    return update_or_divide(leaf, scan,
                            [&](const ScanEvidence& all) { return divide(leaf, list, all_, all, shares); });
  }
  /// The same of a node's child. @param of_siblings what its children take; null if nobody knows.
  bool update_leaf(const Ref& leaf, const CellCrossings<N, D>& crossings, const BeamList& list,
                   const Shares& shares, int child, const SharesOfAll* of_siblings) {
    const bool is_well_observed = refinement_.model.is_well_observed(leaf.cell());
    if (of_siblings == nullptr || (is_well_observed && refinement_.model.is_saturated(leaf.cell())))
      return update_leaf(leaf, crossings, list, shares);
    return update_by_share(leaf, crossings, list,
                           of_siblings->of(static_cast<std::size_t>(child), is_well_observed));
  }
  bool update_by_sample(const Ref& leaf, const CellCrossings<N, D>& crossings, const BeamList& list,
                        bool is_well_observed) {
    ScanEvidence scan;
    shares_.take(leaf.index, list, is_well_observed, sample_,
                 [&](const ScanFace<D>&, float, const BeamList& part) {
                   if (is_worth_asking(leaf, part))
                     scan = some_at_once(leaf, crossings, part, scan);
                   else
                     scan.add(evidence_.of(leaf.index, crossings, part));
                 });
    refinement_.model.limit(scan);
    return update_or_divide(leaf, scan,
                            [&](const ScanEvidence& all) { return divide(leaf, list, sample_, all, {}); });
  }
  /// The same of a list of one face.
  NDTREE_ALWAYS_INLINE bool update_by_share(const Ref& leaf, const CellCrossings<N, D>& crossings,
                                            const BeamList& list, const FaceShare<D>& of_face) {
    ScanEvidence scan = evidence_of(leaf, crossings, list, of_face.end);
    refinement_.model.limit(scan);
    return update_or_divide(
        leaf, scan, [&](const ScanEvidence& all) { return divide_by_share(leaf, list, of_face, all); });
  }
  bool divide_by_share(const Ref& leaf, const BeamList& list, const FaceShare<D>& share,
                       const ScanEvidence& scan) {
    sample_.clear();
    sample_.add(share);
    return divide(leaf, list, sample_, scan, {share.face, false});
  }
  /// What beams say about a leaf, until it is certain that it splits: then they are its children's.
  /// @param end number of the one after the last that counts.
  [[nodiscard]] NDTREE_ALWAYS_INLINE ScanEvidence evidence_of(const Ref& leaf,
                                                              const CellCrossings<N, D>& crossings,
                                                              const BeamList& list,
                                                              std::uint32_t end = BeamList::kAll) const {
    return is_worth_asking(leaf, list) ? some_at_once(leaf, crossings, list.part(0, list.find(end)), {})
                                       : evidence_.of(leaf.index, crossings, list, end);
  }
  /// Whether so many may tell that a leaf splits that it is asked before all have been looked at.
  [[nodiscard]] bool is_worth_asking(const Ref& leaf, const BeamList& list) const {
    return list.size > kToSplit && leaf.index.level != finest_level_;
  }
  /// @param scan what others say. @returns the sum.
  [[nodiscard]] NDTREE_NEVER_INLINE ScanEvidence some_at_once(const Ref& leaf,
                                                              const CellCrossings<N, D>& crossings,
                                                              const BeamList& list, ScanEvidence scan) const {
    for (std::size_t first = 0; first < list.size; first += kToSplit) {
      if (refinement_.splits_anyway(leaf.cell(), scan) &&
          !predicted_to_remerge(leaf.cell(), leaf.index.level, scan))
        break;
      scan.add(evidence_.of(leaf.index, crossings, list.part(first, std::min(first + kToSplit, list.size))));
    }
    return scan;
  }
  /// Updates a leaf, or calls `divide(scan)` if it may have to split, and not in vain.
  template <class Scan, class Divide>
  NDTREE_ALWAYS_INLINE bool update_or_divide(EvidenceCell& leaf, int level, const Scan& scan,
                                             const Divide& divide) {
    if (!may_divide(leaf, level, scan)) return update(leaf, scan);
    const ScanEvidence& all = ScanEvidence::of(scan);  // Lives as long as the name.
    return predicted_to_remerge(leaf, level, all) ? update_without_split(leaf, all) : divide(all);
  }
  template <class Divide>
  bool update_or_divide(const Ref& leaf, const ScanEvidence& scan, const Divide& divide) {
    return update_or_divide(leaf.cell(), leaf.index.level, scan, divide);
  }
  [[nodiscard]] bool predicted_to_remerge(const EvidenceCell& leaf, int level,
                                          const ScanEvidence& scan) const {
    return refinement_.model.predicted_to_remerge(leaf, scan, kChildrenAcross<Tree>, level - finest_level_);
  }
  bool update_without_split(EvidenceCell& leaf, const ScanEvidence& scan) {
    return counted(refinement_.model.update_without_split(leaf, scan), scan.beams);
  }
  /// Whether a leaf may have to split.
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool may_divide(const EvidenceCell& leaf, int level,
                                                     const ScanEvidence& scan) const {
    return level != finest_level_ && (is_unseen(leaf, scan) || refinement_.splits(leaf, scan));
  }
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool may_divide(const EvidenceCell& leaf, int level,
                                                     const PassedEvidence& passed) const {
    return level != finest_level_ && (is_unseen(leaf) || refinement_.splits(leaf, passed));
  }
  /// Whether beams have only passed a leaf that was never observed. Those that are were seen before; hits
  /// speak for themselves.
  [[nodiscard]] bool is_unseen(const EvidenceCell& leaf, const ScanEvidence& scan) const {
    return scan.hits == 0 && scan.occupied == 0 && is_unseen(leaf);
  }
  [[nodiscard]] bool is_unseen(const EvidenceCell& leaf) const {
    return !leaf.observed() && refinement_.coverage.is_on();
  }
  bool divide(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample, const ScanEvidence& scan,
              const Shares& shares) {
    if (scan.beams == 0) return false;
    return is_unseen(leaf.cell(), scan) ? update_unseen(leaf, list, sample, scan, shares)
                                        : split(leaf, list, sample, scan, shares);
  }
  /// A leaf that was never observed, and that beams have only passed.
  bool update_unseen(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample,
                     const ScanEvidence& scan, const Shares& shares) {
    EvidenceCell& cell = leaf.cell();
    const CoverageVerdict seen =
        coverage_.judge(leaf.index, cell, list, sample, refinement_.coverage,
                        refinement_.model.beams_of(cell.free_evidence() + scan.free));
    if (seen.shows_more) return split(leaf, list, sample, scan, shares);
    if (!seen.is_enough)
      return counted(refinement_.model.update_partly_seen(cell, seen.parts, scan), scan.beams);
    const bool changed = update(cell, scan);
    cell.set_covered(seen.is_covered);
    return changed;
  }
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const ScanEvidence& scan) {
    return scan.beams > 0 && counted(refinement_.model.update(cell, scan), scan.beams);
  }
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const PassedEvidence& passed) {
    return counted(refinement_.model.update(cell, passed), passed.misses);
  }
  bool counted(bool changed, std::uint32_t beams) {
    counters_.updates += changed ? beams : 0;
    return changed;
  }

  /// Splits a leaf and integrates its beams into the children. If they join again, and the scan's beams have
  /// only passed, the leaf is updated as if it had not split: what passes say adds up, scan by scan, however
  /// often.
  bool split(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample, const ScanEvidence& scan,
             const Shares& shares) {
    const EvidenceCell parent = leaf.cell();
    const bool changed = split(leaf, list, sample, shares);
    if (leaf.is_leaf() && parent.observed() && scan.hits == 0 && scan.occupied == 0) {
      leaf.cell() = parent;
      (void)refinement_.model.update_without_split(leaf.cell(), scan);
    }
    return changed;
  }
  bool split(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample, const Shares& shares) {
    const ListStack::Mark mark = stack_.mark();
    const EvidenceCell parent = leaf.cell();
    ++counters_.splits;
#ifdef NDTREE_HAS_EIGHTS
    if (are_few(leaf, list)) {
      tree_.split_node(*leaf.node, {}, arena_);
      const HeritageOfFew heritage = inheritance_.of_few(parent, leaf.index.level, sample, list);
      return update_children_of_few(leaf, list, shares, &heritage);
    }
#endif
    const Planes planes = clip_.planes_of(leaf.index);
    const Lists lists = hand_down(leaf.index, planes, list, shares, false);
    tree_.split_node(*leaf.node, {}, arena_);
    inheritance_.share_out(parent, leaf.index, sample, list, lists, planes, tree_.children(*leaf.node));
    return update_children(leaf, planes, lists, mark, true, shares);
  }

  /// @param lists of the children, allocated after the mark.
  bool update_children(const Ref& ref, const Planes& planes, const Lists& lists, const ListStack::Mark& mark,
                       bool was_split, const Shares& shares) {
    const bool are_cells = ref.index.level <= coarsest_level_;
    bool changed = was_split;
    const Children children(tree_, ref);
    const bool have_shares = kAskTogether && shares.face != nullptr && !shares.takes_all;
    std::optional<SharesOfAll> of_leaves;  // For the first of them.
#ifdef __GNUC__
#pragma GCC unroll 8
#endif
    for (int c = 0; c < kNumChildren; ++c) {
      const BeamList list = lists.of(c);
      if (list.empty()) continue;
      const Ref child = children[c];
      if (!are_cells || !child.is_leaf()) {
        changed = descend(child, list, shares) || changed;
        continue;
      }
      if (have_shares && !of_leaves) of_leaves.emplace(shares_, ref.index, *shares.face);
      changed = update_leaf(child, {tree_.geometry(), beams_, child.index, planes, c}, list, shares, c,
                            have_shares ? &*of_leaves : nullptr) ||
                changed;
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
  [[nodiscard]] bool are_few(const Ref& ref, const BeamList& list) const {
    return list.size <= Few::kMost && ref.index.level <= coarsest_level_ && clip_.goes_by_eights() &&
           evidence_.takes_few(ref.index.level);
  }
  // Few beams, and those that are alone. Defined in walk_few.hpp, which whoever calls run() includes.
  using HeritageOfFew = typename Inheritance<Tree>::OfFew;
  /// A beam that is alone in a node, and so in all nodes below.
  struct LoneBeam {
    std::uint32_t number;
    const ScanFace<D>& face;
    Crossing crossing;
  };
  [[nodiscard]] LoneBeam lone_beam(std::uint32_t number, const Crossing& crossing) const {
    return {number, beams_.face_of(number), crossing};
  }
  NDTREE_BY_EIGHTS bool update_children_of_few(const Ref& ref, const BeamList& list, const Shares& shares,
                                               const HeritageOfFew* heritage = nullptr);
  template <class SomeBeams>
  NDTREE_BY_EIGHTS bool update_children_of_few(const Ref& ref, const SomeBeams& list, EightBeams<D>& beams,
                                               const Shares& shares, const HeritageOfFew* heritage = nullptr);
  NDTREE_BY_EIGHTS bool update_children_of_one(const Ref& ref, const LoneBeam& beam, bool takes_all,
                                               const HeritageOfFew* heritage = nullptr);
  bool descend(const Ref& inner, const FewBeams& beams, const Shares& above);
  bool descend(const Ref& inner, const LoneBeam& beam, bool takes_all);
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE bool update_by_share(const CellIndex<D>& node, const Ref& leaf,
                                                            const FewBeams& beams,
                                                            const FaceShare<D>& of_face);
  template <class Beams>
  bool update_leaf(const Ref& leaf, const Beams& beams, const Shares& shares);
  bool divide(const Ref& leaf, const FewBeams& beams, const ScanEvidence& scan, const Shares& shares);
  NDTREE_NEVER_INLINE bool divide(const Ref& leaf, const LoneBeam& beam, float share,
                                  const ScanEvidence& scan, bool takes_all);
  template <class Beams, class Use>
  bool with_list(const Beams& beams, const Use& use);
  void write(const FewBeams& beams, BeamList& list) const;
  void write(const LoneBeam& beam, BeamList& list) const;
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
      auto left = static_cast<unsigned>(number);
      for (std::size_t a = 0; a < D; ++a, left /= N)
        child.index.lower[a] += static_cast<std::int64_t>(left % N) * edge_;
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
        refinement_.merge_rule.of_one_state(tree_.children(*ref.node), kNumChildren, kChildrenAcross<Tree>);
    if (!merged) return false;
    tree_.merge(*ref.node, *merged, arena_);
    if (was_split)
      --counters_.splits;
    else
      ++counters_.merges;
    return true;
  }

  static constexpr bool kAskTogether = kNumChildren >= 8;  // So many leaves that it is worth it for them.
  static constexpr std::size_t kToSplit = 32;  // Beams, of which some are likely to tell that a leaf splits.
  static constexpr std::size_t kPiece = 2048;  // Beams at once, while each child has room for all of them.
  static constexpr std::size_t kFetched = 1024;  // Beams that the nearest cache has room for.

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
  const Inheritance<Tree> inheritance_;
  const EvidenceSummary<kNumChildren> summary_;
  const int finest_level_;
  const int coarsest_level_;
  const bool few_may_be_too_many_;  // That so few beams count in a leaf.
  UpdateCounters counters_;
  Pace pace_;
  ListStack stack_;  // Of the nodes on the path from the root, the deepest last.
  PiecewiseLists<kNumChildren> pieces_;
  const LeafSample<D> all_;
  LeafSample<D> sample_;  // Of the leaf that is looked at, until its children are.
};

}  // namespace ndtree
