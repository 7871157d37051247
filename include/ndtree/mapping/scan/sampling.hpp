// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What share of a scan's beams counts in a leaf: of each face those of the lowest steps of chance.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/scan/beam_lists.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/mapping/scan/cube_map.hpp"
#include "ndtree/mapping/scan/packed_beams.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Calls `visit(face, first, last)` for each part of a list whose beams are of one face.
template <int D, class Visit>
void for_each_face(const ScanBeams<D>& beams, const BeamList& list, const Visit& visit) {
  for (std::size_t first = 0; first < list.size;) {
    const CubeFace<D>& face = beams.face_of(list.beam[first]);
    const std::size_t last = list.find(face.end_of_beams, first);
    visit(face, first, last);
    first = last;
  }
}

/// Of a face's beams, those that count in a leaf.
template <int D>
struct FaceSample {
  const CubeFace<D>* face;
  std::uint32_t end;  ///< Number of the one after the last.
  float fraction;     ///< Of all, at most 1.
};

/// What is known of all leaves in a node, by what they take of its beams.
template <int D>
struct NodeSampling {
  const CubeFace<D>* face = nullptr;  ///< Of all beams; null: of several, or nobody asked.
  bool samples_all = false;           ///< Each leaf takes all of them.
};

/// Which of a list's beams count in a leaf: all of them, until it is told of which faces how many.
template <int D>
class LeafSample {
 public:
  void clear() {
    is_all_ = false;
    of_faces_.clear();
  }
  /// @pre clear() before the first; in the order of the faces' beams.
  void add(const FaceSample<D>& of_face) { of_faces_.push_back(of_face); }

  /// Calls `visit(face, share, list)` for the parts of a list that are in the sample.
  template <class Visit>
  void for_each_fraction(const ScanBeams<D>& beams, const BeamList& list, const Visit& visit) const {
    if (is_all_) {
      for_each_face(beams, list, [&](const CubeFace<D>& face, std::size_t first, std::size_t last) {
        visit(face, 1.0f, list.part(first, last));
      });
      return;
    }
    std::size_t from = 0;
    for (const FaceSample<D>& of_face : of_faces_) {
      const std::size_t to = list.find(of_face.end, from);
      if (from < to) visit(*of_face.face, of_face.fraction, list.part(from, to));
      from = of_face.end < of_face.face->end_of_beams ? list.find(of_face.face->end_of_beams, to) : to;
      if (from == list.size) return;
    }
  }
  /// The same whatever faces they are of. Calls `visit(list)`.
  template <class Visit>
  void for_each_part(const ScanBeams<D>& beams, const BeamList& list, const Visit& visit) const {
    if (is_all_)
      visit(list);
    else
      for_each_fraction(beams, list, [&](const CubeFace<D>&, float, const BeamList& part) { visit(part); });
  }

 private:
  bool is_all_ = true;
  std::vector<FaceSample<D>> of_faces_;
};

/// Tells leaves what they take of a scan. Lists are sorted by face and step of chance.
template <int N, int D>
class BeamSampling {
 public:
  BeamSampling(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams, const EvidenceModel& model)
      : geometry_(geometry),
        beams_(beams),
        smallest_size_(static_cast<float>(geometry.unit())),
        sample_beams_{static_cast<float>(model.sample_beams(false)),
                      static_cast<float>(model.sample_beams(true))} {}

  /// The share of a face's beams that count in a leaf: so many for each smallest cell side by side in it.
  [[nodiscard]] float of(const CellIndex<D>& leaf, const CubeFace<D>& face, bool is_well_observed) const {
    return at_depth(depth_of(leaf, face), face, is_well_observed);
  }
  [[nodiscard]] FaceSample<D> sample_of(const CubeFace<D>& face, float fraction) const {
    return {&face, beams_.end_of_fraction(face, fraction), fraction};
  }
  /// Finds out which beams of a list count in a leaf. Calls `visit(face, share, list)` for those of each
  /// face, if there are any.
  template <class Visit>
  void take(const CellIndex<D>& leaf, const BeamList& list, bool is_well_observed, LeafSample<D>& sample,
            const Visit& visit) const {
    sample.clear();
    for_each_face(beams_, list, [&](const CubeFace<D>& face, std::size_t first, std::size_t last) {
      const FaceSample<D> of_face = sample_of(face, of(leaf, face, is_well_observed));
      const std::size_t end = list.find(of_face.end, first, last);
      sample.add(of_face);
      if (first < end) visit(face, of_face.fraction, list.part(first, end));
    });
  }

  /// How many beams end in a leaf that is learning, of a sample, for each that would cross it if beams were
  /// spread evenly.
  [[nodiscard]] double ends_per_expected_beam(const CellIndex<D>& leaf, const BeamList& list,
                                              LeafSample<D>& sample) const {
    double sum = 0.0;
    take(leaf, list, false, sample, [&](const CubeFace<D>& face, float fraction, const BeamList& part) {
      std::size_t ends = 0;
      for (std::size_t i = 0; i < part.size; ++i) {
        const std::uint32_t beam = part.beam[i];
        ends += beams_.end(beam).is_returned() && geometry_.contains(leaf, beams_.end_cell(beam));
      }
      float expected = 1.0f;
      if (!face.is_single() && ends > 0) expected = std::max(1.0f, fraction * expected_beams(leaf, face));
      sum += static_cast<double>(ends) / static_cast<double>(expected);
    });
    return sum;
  }

  /// The face of beams that are all of one, as most are; else null.
  template <class Beams>
  [[nodiscard]] const CubeFace<D>* only_face_of(const Beams& beams) const {
    const CubeFace<D>& face = beams_.face_of(beams.first_beam());
    return beams.last_beam() < face.end_of_beams ? &face : nullptr;
  }
  /// The same, where a node above may have told it.
  template <class Beams>
  [[nodiscard]] const CubeFace<D>* only_face_of(const Beams& beams, const NodeSampling<D>& above) const {
    return above.face != nullptr ? above.face : only_face_of(beams);
  }
  /// What is known of a node whose beams are not none. @param above of its parent, or of nodes above that.
  template <class Beams>
  [[nodiscard]] NDTREE_ALWAYS_INLINE NodeSampling<D> of_node(const CellIndex<D>& node, const Beams& beams,
                                                             const NodeSampling<D>& above) const {
    if (above.samples_all) return above;
    const CubeFace<D>* const face = only_face_of(beams, above);
    return {face, face != nullptr ? all_sample_all(node, *face) : all_sample_all(node, beams)};
  }
  /// Whether all leaves in a node, whatever they know, take all beams of a face, ...
  [[nodiscard]] bool all_sample_all(const CellIndex<D>& node, const CubeFace<D>& face) const {
    const double ahead = border(node, face.axis, face.negative) - face.origin[face.axis];
    return static_cast<float>(face.negative ? -ahead : ahead) >= face.depth_of_full_sample_in_any_cell();
  }
  /// ... of a list, ...
  [[nodiscard]] bool all_sample_all(const CellIndex<D>& node, const BeamList& list) const {
    for (std::size_t first = 0; first < list.size;) {
      const CubeFace<D>& face = beams_.face_of(list.beam[first]);
      if (!all_sample_all(node, face)) return false;
      first = list.find(face.end_of_beams, first);
    }
    return true;
  }
  /// ... or of a ray packet: of what crosses one cell.
  template <class PacketInCell>
  [[nodiscard]] bool all_sample_all(const CellIndex<D>& node, const PacketInCell& packet) const {
    for (std::uint32_t left = packet.set(); left != 0;) {
      const CubeFace<D>& face = beams_.face_of(packet.rays().first_of(left));
      if (!all_sample_all(node, face)) return false;
      if (packet.last_beam() < face.end_of_beams) return true;
      while (left != 0 && packet.rays().first_of(left) < face.end_of_beams) left &= left - 1;
    }
    return true;
  }

  /// Of a part of a list, of one face, where those end that some leaf in a node may take.
  [[nodiscard]] std::size_t end_of_sampled(const CellIndex<D>& node, const CubeFace<D>& face,
                                           const BeamList& list, std::size_t first, std::size_t last) const {
    const double behind = std::abs(border(node, face.axis, !face.negative) - face.origin[face.axis]);
    const auto farthest = static_cast<float>(std::max(behind, 0.5 * geometry_.cell_size(node.level)));
    if (farthest >= face.depth_of_full_sample[0]) return last;
    constexpr float kSlack = CubeFace<D>::kSlack;
    const float expected = face.expected_beams(farthest * kSlack, smallest_size_);
    return list.find(beams_.end_of_fraction(face, sample_beams_[0] * kSlack / expected), first, last);
  }

  /// Beams of a face that would cross a leaf if they were spread evenly.
  [[nodiscard]] float expected_beams(const CellIndex<D>& leaf, const CubeFace<D>& face) const {
    return face.expected_beams(depth_of(leaf, face), static_cast<float>(geometry_.cell_size(leaf.level)));
  }
  /// How much wider beams get if only a share of them is left.
  [[nodiscard]] static float widening(float fraction) {
    if constexpr (D < 2) return 1.0f;
    if constexpr (D == 2) return 1.0f / fraction;
    if constexpr (D == 3) return 1.0f / std::sqrt(fraction);
    return std::pow(fraction, -1.0f / static_cast<float>(D - 1));
  }

  /// What children of a node take of its beams, where those are of one face: the same in all children side
  /// by side.
  class Children {
   public:
    NDTREE_ALWAYS_INLINE Children(const BeamSampling& sampling, const CellIndex<D>& node,
                                  const CubeFace<D>& face)
        : sampling_(sampling), face_(face) {
      const LatticeGeometry<N, D>& geometry = sampling.geometry_;
      const std::int64_t edge = geometry.edge(node.level - 1);
      std::int64_t at = node.lower[static_cast<std::size_t>(face_.axis)];
      double lower = geometry.border(at);
      for (float& depth : depths_) {
        const double upper = geometry.border(at += edge);
        depth = face_.depth_of(lower, upper);
        lower = upper;
      }
    }
    [[nodiscard]] FaceSample<D> of(std::size_t child, bool is_well_observed) const {
      return of_slab(slab_of(child), is_well_observed);
    }

   private:
    [[nodiscard]] FaceSample<D> of_slab(std::size_t slab, bool is_well_observed) const {
      return sampling_.sample_of(face_, sampling_.at_depth(depths_[slab], face_, is_well_observed));
    }
    /// On the face's axis.
    [[nodiscard]] std::size_t slab_of(std::size_t child) const {
      if constexpr (N == 2) return child >> face_.axis & 1u;
      for (int a = 0; a < face_.axis; ++a) child /= N;
      return child % N;
    }
    const BeamSampling& sampling_;
    const CubeFace<D>& face_;
    std::array<float, std::size_t{N}> depths_;  // Of the children, slab by slab.
  };

 private:
  [[nodiscard]] double border(const CellIndex<D>& cell, int axis, bool upper) const {
    return geometry_.border(cell.lower[static_cast<std::size_t>(axis)] +
                            (upper ? geometry_.edge(cell.level) : 0));
  }
  [[nodiscard]] float depth_of(const CellIndex<D>& cell, const CubeFace<D>& face) const {
    return face.depth_of(border(cell, face.axis, false), border(cell, face.axis, true));
  }
  /// The share that counts in a leaf at a depth.
  [[nodiscard]] NDTREE_ALWAYS_INLINE float at_depth(float depth, const CubeFace<D>& face,
                                                    bool is_well_observed) const {
    if (depth >= face.depth_of_full_sample[is_well_observed]) return 1.0f;
    return std::min(1.0f, sample_beams_[is_well_observed] / face.expected_beams(depth, smallest_size_));
  }

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const float smallest_size_;
  const std::array<float, 2> sample_beams_;  // Of leaves that are learning, and that know much.
};

}  // namespace ndtree
