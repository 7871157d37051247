// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The walk of few beams: what a node of few, or of one, does without lists of its own.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/mapping/scan/walk.hpp"

namespace ndtree {

#ifdef NDTREE_HAS_EIGHTS

/// update_children() of few beams, not none.
/// @param heritage of a node that was split; else null.
template <class Tree, class Refinement, class Sensor>
NDTREE_BY_EIGHTS inline bool ScanWalk<Tree, Refinement, Sensor>::update_children_of_few(
    const Ref& ref, const BeamList& list, const Shares& shares, const HeritageOfFew* heritage) {
  if constexpr (Clip::kFitLanes) {
    if (list.size == 1) {
      const LoneBeam beam = lone_beam(list.beam[0], crossings_of(ref.index).of(list.beam[0]));
      return update_children_of_one(ref, beam, shares.takes_all, heritage);
    }
  }
  EightBeams<D> beams;
  beams_.look_up(list.beam, beams);
  return update_children_of_few(ref, list, beams, shares, heritage);
}

/// @param list BeamList or FewBeams, of these beams.
template <class Tree, class Refinement, class Sensor>
template <class SomeBeams>
NDTREE_BY_EIGHTS inline bool ScanWalk<Tree, Refinement, Sensor>::update_children_of_few(
    const Ref& ref, const SomeBeams& list, EightBeams<D>& beams, const Shares& above,
    const HeritageOfFew* heritage) {
  pace_.spend(Few::kMost);
  Few few(beams);
  clip_(ref.index, list, few);
  if (heritage != nullptr) inheritance_.share_out(*heritage, few, tree_.children(*ref.node));
  const bool was_split = heritage != nullptr;
  typename LeafEvidence<N, D, Sensor>::FewEvidence evidence(evidence_, ref.index, few);
  const Children children(tree_, ref);
  const EvidenceModel& model = refinement_.model;
  const int level = ref.index.level - 1;  // Of the children.
  const bool takes_all = above.takes_all;
  const Shares below{takes_all ? above.face : shares_.only_face_of(list, above), takes_all};
  std::optional<ChildrenShares> shares;
  if (!takes_all && below.face != nullptr) shares.emplace(shares_, ref.index, *below.face);
  bool changed = was_split;
#pragma GCC unroll 1
  for (int c = 0; c < kNumChildren; ++c) {
    const FewBeams of_child{few, static_cast<std::size_t>(c)};
    if (of_child.set() == 0) continue;
    auto& node = children.node(c);
    if (!node.is_leaf()) {
      if (Summary(node.note()).is_saturated() && of_child.all_pass()) continue;
      changed = descend(children[c], of_child, below) || changed;
      continue;
    }
    EvidenceCell& cell = node.cell();
    const bool all_pass = of_child.all_pass();
    const bool is_well_observed = model.is_well_observed(cell);
    if (is_well_observed && model.is_saturated(cell)) {
      if (all_pass) continue;
    } else if (takes_all || (shares ? shares->takes_all(of_child.child, is_well_observed)
                                    : shares_.takes_all(children[c].index, of_child, is_well_observed))) {
      const auto divide_it = [&](const ScanEvidence& scan) {
        return divide(children[c], of_child, scan, below);
      };
      if (all_pass && !few_may_be_too_many_) {
        const PassedEvidence passed = evidence.passed(of_child.child);
        changed = update_or_divide(cell, level, passed, divide_it) || changed;
        continue;
      }
      ScanEvidence scan;
      if (of_child.is_one())
        OfBeam(evidence_, level, of_child.first_beam())
            .add(children[c].index, of_child.crossing_of_first(), scan);
      else
        scan = evidence.of(of_child.child);
      if (few_may_be_too_many_) model.limit(scan);
      changed = update_or_divide(cell, level, scan, divide_it) || changed;
      continue;
    } else if (shares) {
      changed =
          update_by_share(ref.index, children[c], of_child, shares->of(of_child.child, is_well_observed)) ||
          changed;
      continue;
    }
    changed = update_leaf(children[c], of_child, below) || changed;
  }
  if (!changed && ref.node->note() != 0) return false;
  return finish_children(ref, summary_.by_eights(&children.node(0)), changed, was_split);
}

template <class Tree, class Refinement, class Sensor>
NDTREE_ALWAYS_INLINE bool ScanWalk<Tree, Refinement, Sensor>::descend(const Ref& inner, const FewBeams& beams,
                                                                      const Shares& above) {
  if constexpr (Clip::kFitLanes) {
    if (beams.is_one())
      return descend(inner, lone_beam(beams.first_beam(), beams.crossing_of_first()), above.takes_all);
  }
  if (undo_ != nullptr) undo_->keep(tree_, *inner.node);
  return update_children_of_few(inner, beams, beams.of.beams, shares_.of_node(inner.index, beams, above));
}

/// A leaf that takes a share of few beams, all of one face. @param node the leaf's parent.
template <class Tree, class Refinement, class Sensor>
NDTREE_BY_EIGHTS bool ScanWalk<Tree, Refinement, Sensor>::update_by_share(const CellIndex<D>& node,
                                                                          const Ref& leaf,
                                                                          const FewBeams& beams,
                                                                          const FaceShare<D>& of_face) {
  const std::uint32_t set = beams.set() & beams.of.before(of_face.end);
  ScanEvidence scan;
  if (set != 0) scan = evidence_.of(node, beams.of, beams.child, set);
  if (few_may_be_too_many_) refinement_.model.limit(scan);
  return update_or_divide(leaf, scan, [&](const ScanEvidence& all) {
    return with_list(beams, [&](const BeamList& list) { return divide_by_share(leaf, list, of_face, all); });
  });
}

template <class Tree, class Refinement, class Sensor>
NDTREE_BY_EIGHTS inline bool ScanWalk<Tree, Refinement, Sensor>::update_children_of_one(
    const Ref& ref, const LoneBeam& beam, bool takes_all, const HeritageOfFew* heritage) {
  pace_.spend(1);
  const BeamWay<D>& way = beams_.way(beam.number);
  const float pass = beams_.pass_of(beam.number);
  LoneCrossing lone;
  clip_(ref.index, way, beam.crossing, lone);
  if (heritage != nullptr) inheritance_.share_out(*heritage, beam.number, lone, tree_.children(*ref.node));
  const bool was_split = heritage != nullptr;
  const int level = ref.index.level - 1;  // Of the children.
  const OfBeam evidence(evidence_, level, beam.number);
  const Children children(tree_, ref);
  const EvidenceModel& model = refinement_.model;
  bool changed = was_split;
  for (std::uint32_t left = lone.set; left != 0; left &= left - 1) {
    const auto c = static_cast<std::size_t>(__builtin_ctz(left));
    const auto child = [&] { return children[static_cast<int>(c)]; };  // Many are not asked where they are.
    auto& node = children.node(static_cast<int>(c));
    const LoneBeam in_child{beam.number, beam.face, {lone.enter[c], lone.exit[c]}};
    const bool passes = in_child.crossing.exit < pass;
    if (!node.is_leaf()) {
      if (Summary(node.note()).is_saturated() && passes) continue;
      changed = descend(child(), in_child, takes_all) || changed;
      continue;
    }
    EvidenceCell& cell = node.cell();
    const bool is_well_observed = model.is_well_observed(cell);
    if (is_well_observed && model.is_saturated(cell)) {
      if (!passes) changed = update_leaf(child(), in_child, {&beam.face, takes_all}) || changed;
      continue;
    }
    const float share = takes_all ? 1.0f : shares_.of(child().index, beam.face, is_well_observed);
    if (!(beam.number < beams_.end_of_share(beam.face, share))) continue;
    const auto divide_it = [&](const ScanEvidence& scan) {
      return divide(child(), in_child, share, scan, takes_all);
    };
    if (passes && !few_may_be_too_many_) {
      const PassedEvidence passed = evidence.passed(in_child.crossing);
      changed = update_or_divide(cell, level, passed, divide_it) || changed;
      continue;
    }
    ScanEvidence scan;
    evidence.add(child().index, in_child.crossing, scan);
    if (few_may_be_too_many_) model.limit(scan);
    changed = update_or_divide(cell, level, scan, divide_it) || changed;
  }
  if (!changed && ref.node->note() != 0) return false;
  return finish_children(ref, summary_.by_eights(&children.node(0)), changed, was_split);
}

template <class Tree, class Refinement, class Sensor>
NDTREE_ALWAYS_INLINE bool ScanWalk<Tree, Refinement, Sensor>::descend(const Ref& inner, const LoneBeam& beam,
                                                                      bool takes_all) {
  if (undo_ != nullptr) undo_->keep(tree_, *inner.node);
  return update_children_of_one(inner, beam, takes_all || shares_.all_take_all(inner.index, beam.face));
}

// What few beams rarely do.
template <class Tree, class Refinement, class Sensor>
template <class Beams>
inline bool ScanWalk<Tree, Refinement, Sensor>::update_leaf(const Ref& leaf, const Beams& beams,
                                                            const Shares& shares) {
  return with_list(beams, [&](const BeamList& list) { return update_leaf(leaf, list, shares); });
}

template <class Tree, class Refinement, class Sensor>
inline bool ScanWalk<Tree, Refinement, Sensor>::divide(const Ref& leaf, const FewBeams& beams,
                                                       const ScanEvidence& scan, const Shares& shares) {
  return with_list(beams, [&](const BeamList& list) { return divide(leaf, list, all_, scan, shares); });
}

template <class Tree, class Refinement, class Sensor>
bool ScanWalk<Tree, Refinement, Sensor>::divide(const Ref& leaf, const LoneBeam& beam, float share,
                                                const ScanEvidence& scan, bool takes_all) {
  return with_list(beam, [&](const BeamList& list) {
    return share < 1.0f ? divide_by_share(leaf, list, {&beam.face, beam.face.end_of_beams, share}, scan)
                        : divide(leaf, list, all_, scan, {&beam.face, takes_all});
  });
}

/// Calls `use(list)` with the beams in a list.
template <class Tree, class Refinement, class Sensor>
template <class Beams, class Use>
inline bool ScanWalk<Tree, Refinement, Sensor>::with_list(const Beams& beams, const Use& use) {
  const ListStack::Mark mark = stack_.mark();
  BeamList list = stack_.allocate(Few::kMost + BeamList::kSlack);
  write(beams, list);
  list.close();
  const bool result = use(list);
  stack_.release(mark);
  return result;
}

template <class Tree, class Refinement, class Sensor>
inline void ScanWalk<Tree, Refinement, Sensor>::write(const FewBeams& beams, BeamList& list) const {
  clip_.write(beams, list);
}
template <class Tree, class Refinement, class Sensor>
inline void ScanWalk<Tree, Refinement, Sensor>::write(const LoneBeam& beam, BeamList& list) const {
  list.beam[0] = beam.number;
  list.size = 1;
}
#endif

}  // namespace ndtree
