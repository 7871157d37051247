// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The children of a node, and the evidence that those of a leaf that splits begin with.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/coverage.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/sampling.hpp"

namespace ndtree {

/// Finds nodes of children in O(1) and their cells in O(D). The parent must stay where it is, and an inner
/// node.
template <class Tree>
class NodeChildren {
 public:
  using Ref = typename Tree::Ref;

  NDTREE_ALWAYS_INLINE NodeChildren(Tree& tree, const Ref& parent)
      : parent_(parent),
        nodes_(tree.children(*parent.node)),
        edge_(tree.geometry().edge(parent.index.level - 1)) {}

  [[nodiscard]] const Ref& parent() const { return parent_; }
  /// Level of the children.
  [[nodiscard]] int level() const { return parent_.index.level - 1; }
  [[nodiscard]] typename Tree::NodeType& node(int number) const { return nodes_[number]; }
  /// Node and cell of a child.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Ref operator[](int number) const {
    Ref child{nodes_ + number, {parent_.index.lower, level()}};
    auto left = static_cast<unsigned>(number);
    for (std::size_t a = 0; a < Tree::kDim; ++a, left /= Tree::kBranching)
      child.index.lower[a] += static_cast<std::int64_t>(left % Tree::kBranching) * edge_;
    return child;
  }

 private:
  const Ref& parent_;
  typename Tree::NodeType* nodes_;
  std::int64_t edge_;
};

/// Initialises the children of a leaf that splits with parts of its evidence, see ChildInitialisation. A
/// child's part depends on how many of the leaf's sampled beams passed the child, see has_passed(). Cost:
/// O(sampled beams) for each child.
template <class Tree>
class ChildrenInitialiser {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  static constexpr int kNumChildren = Tree::kNumChildren;
  using NodeType = typename Tree::NodeType;
  using Planes = typename CellCrossings<N, D>::Planes;

 public:
  ChildrenInitialiser(const LatticeGeometry<N, D>& geometry, const EvidenceModel& model,
                      const ScanBeams<D>& beams)
      : geometry_(geometry), model_(model), beams_(beams), width_(beams.width()) {}

  /// @param leaf before the split. @pre EvidenceModel::has_evidence_for_children().
  /// @param sample the beams of its list that it sampled.
  /// @param lists of its children. @param planes of the leaf, if all beams have one origin.
  void initialise(const EvidenceCell& leaf, const CellIndex<D>& index, const LeafSample<D>& sample,
                  const BeamList& list, const SiblingLists<kNumChildren>& lists, const Planes& planes,
                  NodeType* children) const {
    const bool is_finest = index.level - 1 <= beams_.finest_level();
    std::size_t beams = 0;
    sample.for_each_part(beams_, list, [&](const BeamList& part) { beams += part.size; });
    for (std::size_t j = 0; j < kNumChildren; ++j) {
      const auto child = static_cast<int>(j);
      const CellIndex<D> at = geometry_.child(index, child_offset<N, D>(child));
      const CellCrossings<N, D> crossings(geometry_, beams_, at, planes, child);
      children[j].cell() =
          initial_child(leaf, count_passed(crossings, lists.of(child), sample), beams, j, is_finest);
    }
  }

#ifdef NDTREE_HAS_EIGHTS
  /// Initialises the children of a leaf that a ray packet crosses. @pre as above.
  /// @param sample set of the rays that it sampled.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void initialise(const EvidenceCell& leaf, int level,
                                                       std::uint32_t sample,
                                                       RayPacket<D, kNumChildren>& packet,
                                                       NodeType* children) const {
    const bool are_finest = level - 1 <= beams_.finest_level();
    const EightEnds<D>& ends = beams_.ends_of(packet.beams);
    for (std::size_t j = 0; j < kNumChildren; ++j) {
      const std::uint32_t set =
          has_passed(EightFloats::load(packet.exit[j].data()), ends.clearly_free_until, ends.surface).set() &
          packet.set[j];
      children[j].cell() = initial_child(leaf, count(set & sample), count(sample), j, are_finest);
    }
  }
  /// The sampled beams of a packet's list as a set of its rays.
  [[nodiscard]] std::uint32_t set_of(const LeafSample<D>& sample, const BeamList& list) const {
    std::uint32_t set = 0;
    sample.for_each_part(beams_, list, [&](const BeamList& part) {
      set |= ((1u << part.size) - 1) << (part.beam - list.beam);
    });
    return set;
  }
#endif

 private:
  /// @param passed beams that passed the child. @param beams that the leaf sampled.
  [[nodiscard]] EvidenceCell initial_child(const EvidenceCell& leaf, std::size_t passed, std::size_t beams,
                                           std::size_t child, bool is_finest) const {
    const int part = CellParts<N, D>::of_child(static_cast<int>(child));
    return model_.initial_child(leaf, kChildrenAcross<Tree>, passed, beams, part,
                                CellParts<N, D>::num_children(part) == 1, is_finest);
  }
  [[nodiscard]] std::size_t count_passed(const CellCrossings<N, D>& crossings, const BeamList& list,
                                         const LeafSample<D>& sample) const {
    std::size_t n = 0;
    sample.for_each_part(beams_, list, [&](const BeamList& part) { n += count_passed(crossings, part); });
    return n;
  }
  [[nodiscard]] std::size_t count_passed(const CellCrossings<N, D>& crossings, const BeamList& list) const {
#ifdef NDTREE_HAS_EIGHTS
    if (width_ >= 8)
      return beams_.are_alike() ? count_passed_by_eights<true>(crossings, list)
                                : count_passed_by_eights<false>(crossings, list);
#endif
    std::size_t n = 0;  // Rows of eight beams are read by functions that are compiled for the processor.
    for (std::size_t i = 0; i < list.size; ++i) {
      const BeamEnd<D>& end = beams_.end(list.beam[i]);
      n += static_cast<std::size_t>(
          has_passed(crossings.of(list.beam[i]).exit, end.clearly_free_until, end.surface));
    }
    return n;
  }
#ifdef NDTREE_HAS_EIGHTS
  template <bool kAlike>
  NDTREE_BY_EIGHTS [[nodiscard]] std::size_t count_passed_by_eights(const CellCrossings<N, D>& crossings,
                                                                    const BeamList& list) const {
    std::size_t n = 0;
    for (std::size_t i = 0; i < list.size; i += 8) {
      const std::uint32_t* const beam = list.beam + i;
      const EightFloats exit = crossings.template of<kAlike>(beam, beams_.rays(beam)).exit;
      const EightEnds<D> ends = beams_.ends(beam);
      n +=
          (has_passed(exit, ends.clearly_free_until, ends.surface) & EightMask::first(list.size - i)).count();
    }
    return n;
  }
#endif
  /// Whether one beam or several passed a cell: they leave it before clearly_free_until, or are without
  /// return. Unlike in LeafEvidence, the exit of a small cell counts as it is. Without a branch, which would
  /// be unpredictable.
  /// @param clearly_free_until, surface see BeamEnd.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static auto has_passed(const Floats& exit,
                                                            const Floats& clearly_free_until,
                                                            const Floats& surface) {
    return (exit < clearly_free_until) | (surface == 0.0f);
  }
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS [[nodiscard]] static std::size_t count(std::uint32_t set) {
    return static_cast<std::size_t>(__builtin_popcount(set));
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const EvidenceModel& model_;
  const ScanBeams<D>& beams_;
  const int width_;
};

}  // namespace ndtree
