// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where the walk finds the beams of a node's children: in lists, or in a ray packet.
///
/// A source (ListSource, PacketSource) is a node's children with the beams that cross each:
///   crosses(child), in_child(child, ref).
/// Its beams in one child (ListInCell, PacketInCell) answer
///   all_pass()                whether all of them clearly pass the child and every cell in it;
///   evidence(..., beams_end)  of the beams with numbers below `beams_end`, for the child as a leaf;
///   passed()                  evidence() if all_pass(), where that is known without a look at each beam;
///   with_list(use)            calls `use(list)`, for steps that are rare;
///   integrate_below(node)     partitions them among the children of an inner node.
/// Both give the same results, to the last bit.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/inline.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/crossings.hpp"

namespace ndtree {

/// A list of beams that cross a cell.
template <class Walk>
struct ListInCell {
  static constexpr int N = Walk::N;
  static constexpr int D = Walk::D;
  using Ref = typename Walk::Ref;
  static constexpr bool kHasPassingSet = false;  // all_pass() tests every beam.
  Walk& walk;
  const Ref& cell;
  const BeamList list;
  const typename Walk::Planes* planes;  ///< Of the cell's parent; null if the cell was not reached from it.
  int child;                            ///< The cell's number in its parent.

  [[nodiscard]] auto& node() const { return *cell.node; }
  [[nodiscard]] const Ref& ref() const { return cell; }
  [[nodiscard]] const BeamList& crossing() const { return list; }
  [[nodiscard]] std::uint32_t first_beam() const { return list.first_beam(); }
  [[nodiscard]] std::uint32_t last_beam() const { return list.last_beam(); }
  [[nodiscard]] NDTREE_ALWAYS_INLINE CellCrossings<N, D> crossings() const {
    const auto& geometry = walk.tree_.geometry();
    return planes != nullptr ? CellCrossings<N, D>(geometry, walk.beams_, cell.index, *planes, child)
                             : CellCrossings<N, D>(geometry, walk.beams_, cell.index);
  }
  [[nodiscard]] bool all_pass() const { return walk.evidence_.all_pass(crossings(), list); }
  [[nodiscard]] bool is_one() const { return list.size == 1; }
  /// Where the one beam crosses the cell.
  [[nodiscard]] Crossing crossing_of_one() const { return crossings().of(list.first_beam()); }
  [[nodiscard]] NDTREE_ALWAYS_INLINE ScanEvidence evidence(const EvidenceCell& leaf, int level,
                                                           std::uint32_t beams_end) const {
    ScanEvidence scan;
    if (walk.may_stop_early(level, list))
      walk.add_until_split(leaf, cell.index, crossings(), list.part(0, list.find(beams_end)), scan);
    else
      scan = walk.evidence_.of(cell.index, crossings(), list, beams_end, Walk::needs_resolvable_misses(leaf));
    walk.refinement_.model.limit(scan);
    return scan;
  }
  template <class Use>
  bool with_list(const Use& use) const {
    return use(list);
  }
  bool integrate_below(const Ref& inner, const typename Walk::Sampling& sampling) const {
    return walk.integrate_below(inner, list, sampling);
  }
};
/// The children of a node, and lists of the beams that cross each of them.
template <class Walk>
struct ListSource {
  using Ref = typename Walk::Ref;
  static constexpr bool kMayBeAboveCells = true;  // The children may be of the coarsest level or above.
  static constexpr std::size_t kPace = 0;         // partition() spends it.
  Walk& walk;
  const typename Walk::Children children;
  const typename Walk::Planes& planes;  ///< Of the node, if all beams have one origin.
  const typename Walk::Lists& lists;

  [[nodiscard]] bool crosses(int child) const { return !lists.of(child).empty(); }
  /// @param ref of the child, which must stay where it is.
  [[nodiscard]] NDTREE_ALWAYS_INLINE ListInCell<Walk> in_child(int child, const Ref& ref) const {
    return {walk, ref, lists.of(child), &planes, child};
  }
};

#ifdef NDTREE_HAS_EIGHTS
template <class Walk>
struct PacketInCell;
/// The children of a node, and where a ray packet crosses them.
template <class Walk>
struct PacketSource {
  using Ref = typename Walk::Ref;
  using Rays = typename Walk::Rays;
  static constexpr bool kMayBeAboveCells = false;
  static constexpr std::size_t kPace = Rays::kMost;
  Walk& walk;
  const typename Walk::Children children;
  mutable Rays rays;

  PacketSource(Walk& of_walk, const Ref& node, EightBeams<Walk::D>& beams)
      : walk(of_walk), children(of_walk.tree_, node), rays(beams) {}
  [[nodiscard]] bool crosses(int child) const { return rays.set[static_cast<std::size_t>(child)] != 0; }
  [[nodiscard]] PacketInCell<Walk> in_child(int child, const Ref&) const { return {*this, child}; }
};
/// The rays of a packet that cross a node's child.
template <class Walk>
struct PacketInCell {
  using Ref = typename Walk::Ref;
  using Rays = typename Walk::Rays;
  static constexpr bool kHasPassingSet = true;
  const PacketSource<Walk>& source;
  int child;

  [[nodiscard]] auto& node() const { return source.children.node(child); }
  [[nodiscard]] Ref ref() const { return source.children[child]; }
  [[nodiscard]] const PacketInCell& crossing() const { return *this; }
  [[nodiscard]] Rays& rays() const { return source.rays; }
  [[nodiscard]] std::size_t number() const { return static_cast<std::size_t>(child); }
  [[nodiscard]] std::uint32_t set() const { return rays().set[number()]; }
  [[nodiscard]] std::uint32_t first_beam() const { return rays().first_of(set()); }
  [[nodiscard]] std::uint32_t last_beam() const { return rays().last_of(set()); }
  [[nodiscard]] bool all_pass() const { return rays().passing[number()] == set(); }
  [[nodiscard]] bool is_one() const { return (set() & (set() - 1)) == 0; }
  [[nodiscard]] Crossing crossing_of_one() const {
    const auto lane = static_cast<std::size_t>(__builtin_ctz(set()));
    return {rays().enter[number()][lane], rays().exit[number()][lane]};
  }
  /// @pre all_pass().
  [[nodiscard]] PassedEvidence passed() const {
    return source.walk.evidence_.passed(source.children.level(), rays(), number());
  }
  [[nodiscard]] ScanEvidence evidence(const EvidenceCell&, int level, std::uint32_t beams_end) const {
    ScanEvidence scan;
    if (is_one()) {
      if (first_beam() < beams_end)
        typename Walk::OfBeam(source.walk.evidence_, level, first_beam())
            .add(ref().index, crossing_of_one(), scan);
    } else {
      scan = source.walk.evidence_.of(source.children.parent().index, rays(), number(), beams_end);
    }
    if (source.walk.packet_may_exceed_limit_) source.walk.refinement_.model.limit(scan);
    return scan;
  }
  template <class Use>
  bool with_list(const Use& use) const {
    std::array<std::uint32_t, Rays::kMost + BeamList::kSlack> beams{};
    BeamList list{beams.data(), 0};
    for (std::uint32_t left = set(); left != 0; left &= left - 1)
      list.beam[list.size++] = rays().first_of(left);
    return use(list);
  }
  bool integrate_below(const Ref& inner, const typename Walk::Sampling& sampling) const {
    return source.walk.integrate_below(inner, *this, sampling);
  }
};
#endif

}  // namespace ndtree
