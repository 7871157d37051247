// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A node's list of beams becomes the lists of its children.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/partition.hpp"
#include "ndtree/mapping/insert/sampling.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Strategy: each beam is clipped against the planes between the children (ChildPartition). Beams that no
/// leaf below the node samples are dropped before: of each cube-map face, the beams behind a bucket.
///
/// Long lists are partitioned in pieces of kPiece beams: every child has room for all beams of a piece, so
/// that its list needs no bound, and the pieces' lists are joined at the end. Memory is then that of the
/// beams which cross each child, not of all beams for each child.
///
/// Invariant: beams stay in ascending order, and every list is padded but for width 1. Cost: O(beams (N D +
/// children crossed)).
template <int N, int D>
class ListPartition {
 public:
  using Partition = ChildPartition<N, D>;
  using Lists = typename Partition::Lists;
  using Planes = typename Partition::Planes;

  ListPartition(const Partition& partition, const ScanBeams<D>& beams, const BeamSampling<N, D>& sampling)
      : partition_(partition), beams_(beams), sampling_(sampling) {}

  /// @param planes of the node, if all beams have one origin. @param sampling of the leaves below the node.
  /// @param stack where the lists are allocated. @param replaces the node's own list is not needed
  /// afterwards: long lists of the children take its memory. @pre if so, nothing that was allocated after it
  /// is in use.
  Lists operator()(const CellIndex<D>& node, const Planes& planes, const BeamList& list,
                   const NodeSampling<D>& sampling, bool replaces, ListStack& stack) {
    if (Partition::kHasRoomForAll && list.size > kPiece)
      return in_pieces(node, planes, list, sampling, replaces, stack);
    Lists children = partition_.lists_for(node, list, stack);
    for_each_sampled(node, list, sampling,
                     [&](const BeamList& sampled) { partition_(node, planes, sampled, children); });
    return children;
  }

 private:
  static constexpr std::size_t kPiece = 2048;

  NDTREE_NEVER_INLINE Lists in_pieces(const CellIndex<D>& node, const Planes& planes, const BeamList& list,
                                      const NodeSampling<D>& sampling, bool replaces, ListStack& stack) {
    for_each_sampled(node, list, sampling, [&](const BeamList& sampled) {
      for (std::size_t first = 0; first < sampled.size; first += kPiece) {
        const BeamList piece = sampled.part(first, std::min(first + kPiece, sampled.size));
        Lists children = partition_.lists_for(node, piece, pieces_.memory());
        partition_(node, planes, piece, children);
        pieces_.add(children);
      }
    });
    if (replaces) stack.free_from(list);
    return pieces_.join(stack);
  }
  /// Calls `visit(part)` for the parts of a list that some leaf below a node samples.
  template <class Visit>
  void for_each_sampled(const CellIndex<D>& node, const BeamList& list, const NodeSampling<D>& sampling,
                        const Visit& visit) const {
    if (sampling.samples_all || list.size <= kPacketSize) return visit(list);
    if (sampling.face != nullptr) {
      const std::size_t end = sampling_.end_of_sampled(node, *sampling.face, list, 0, list.size);
      if (end > 0) visit(list.part(0, end));
      return;
    }
    std::size_t from = 0;  // Beams [from, first) are sampled, and not visited yet.
    for_each_face(beams_, list, [&](const CubeFace<D>& face, std::size_t first, std::size_t last) {
      const std::size_t end = sampling_.end_of_sampled(node, face, list, first, last);
      if (end == last) return;
      if (from < end) visit(list.part(from, end));
      from = last;
    });
    if (from < list.size) visit(list.part(from, list.size));
  }

  const Partition& partition_;
  const ScanBeams<D>& beams_;
  const BeamSampling<N, D>& sampling_;
  PiecewiseLists<Partition::kNumChildren> pieces_;
};

}  // namespace ndtree
