// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which beams a leaf samples: of each cube-map face those in the lowest buckets of sampling keys.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Calls `visit(face, first, last)` for each range [first, last) of a list whose beams belong to one face.
template <int D, class Visit>
void for_each_face(const ScanBeams<D>& beams, const BeamList& list, const Visit& visit) {
  for (std::size_t first = 0; first < list.size;) {
    const CubeFace<D>& face = beams.face_of(list.beam[first]);
    const std::size_t last = list.find(face.end_of_beams, first);
    visit(face, first, last);
    first = last;
  }
}

/// The beams of a face that a leaf samples.
template <int D>
struct FaceSample {
  const CubeFace<D>* face;
  std::uint32_t end;  ///< Beams with smaller numbers are sampled.
  float fraction;     ///< Of all, at most 1.
};

/// Properties of the samples of all leaves in a node.
template <int D>
struct NodeSampling {
  const CubeFace<D>* face = nullptr;  ///< Of all beams; null: several faces, or not determined.
  bool samples_all = false;           ///< Each leaf takes all of them.
};

/// The beams of a list that a leaf samples; all of them by default.
template <int D>
class LeafSample {
 public:
  void clear() {
    is_all_ = false;
    of_faces_.clear();
  }
  /// @pre clear() before the first; faces in ascending order of their beams.
  void add(const FaceSample<D>& of_face) { of_faces_.push_back(of_face); }

  /// Calls `visit(face, fraction, part)` for each sampled part of a list.
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
      if (&of_face == &of_faces_.back()) return;
      from = of_face.end < of_face.face->end_of_beams ? list.find(of_face.face->end_of_beams, to) : to;
      if (from == list.size) return;
    }
  }
  /// Calls `visit(part)` for each sampled part of a list.
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

/// Sampling fractions of leaves. A leaf expects more beams the closer it is to the origin; it samples the
/// fraction that leaves SamplingRate::sample_beams() for each smallest cell side by side in it. Beams are
/// sorted by face and bucket, so that a sample is a range of numbers for each face: a bisection finds it.
/// O(log beams) for each face.
template <int N, int D>
class BeamSampling {
 public:
  BeamSampling(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams, const EvidenceModel& model)
      : geometry_(geometry),
        beams_(beams),
        smallest_size_(static_cast<float>(geometry.cell_size(beams.finest_level()))),
        sample_beams_{static_cast<float>(model.sample_beams(false)),
                      static_cast<float>(model.sample_beams(true))} {}

  /// The fraction of a face's beams that a leaf samples.
  /// @param uses_small_sample true if it is well observed, unless it is saturated and contradicted.
  [[nodiscard]] float of(const CellIndex<D>& leaf, const CubeFace<D>& face, bool uses_small_sample) const {
    return at_depth(depth_of(leaf, face), face, uses_small_sample);
  }
  [[nodiscard]] FaceSample<D> sample_of(const CubeFace<D>& face, float fraction) const {
    return {&face, beams_.end_of_fraction(face, fraction), fraction};
  }
  /// Determines the beams of a list that a leaf samples. Calls `visit(face, fraction, part)` for each face
  /// with sampled beams.
  template <class Visit>
  void take(const CellIndex<D>& leaf, const BeamList& list, bool uses_small_sample, LeafSample<D>& sample,
            const Visit& visit) const {
    sample.clear();
    for_each_face(beams_, list, [&](const CubeFace<D>& face, std::size_t first, std::size_t last) {
      const FaceSample<D> of_face = sample_of(face, of(leaf, face, uses_small_sample));
      const std::size_t end = list.find(of_face.end, first, last);
      sample.add(of_face);
      if (first < end) visit(face, of_face.fraction, list.part(first, end));
    });
  }

  /// Sampled beams that end in a leaf, for each beam that would cross it if beams were spread evenly; sampled
  /// as for a leaf that does not use the small sample.
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

  /// The face of beams that belong to one face; null if they belong to several.
  template <class Beams>
  [[nodiscard]] const CubeFace<D>* only_face_of(const Beams& beams) const {
    const CubeFace<D>& face = beams_.face_of(beams.first_beam());
    return beams.last_beam() < face.end_of_beams ? &face : nullptr;
  }
  /// only_face_of(), which a node above may have determined.
  template <class Beams>
  [[nodiscard]] const CubeFace<D>* only_face_of(const Beams& beams, const NodeSampling<D>& above) const {
    return above.face != nullptr ? above.face : only_face_of(beams);
  }
  /// Properties of the samples in a node with at least one beam. @param above those of a node above.
  template <class Beams>
  [[nodiscard]] NDTREE_ALWAYS_INLINE NodeSampling<D> of_node(const CellIndex<D>& node, const Beams& beams,
                                                             const NodeSampling<D>& above) const {
    if (above.samples_all) return above;
    const CubeFace<D>* const face = only_face_of(beams, above);
    return {face, face != nullptr ? all_sample_all(node, *face) : all_sample_all(node, beams)};
  }
  /// Whether all leaves in a node, those with the small sample or not, sample all beams of a face.
  [[nodiscard]] bool all_sample_all(const CellIndex<D>& node, const CubeFace<D>& face) const {
    const double ahead = border(node, face.axis, face.negative) - face.origin[face.axis];
    return static_cast<float>(face.negative ? -ahead : ahead) >= face.depth_of_full_sample_in_any_cell();
  }
  /// Whether all leaves in a node sample all beams of a list.
  [[nodiscard]] bool all_sample_all(const CellIndex<D>& node, const BeamList& list) const {
    for (std::size_t first = 0; first < list.size;) {
      const CubeFace<D>& face = beams_.face_of(list.beam[first]);
      if (!all_sample_all(node, face)) return false;
      first = list.find(face.end_of_beams, first);
    }
    return true;
  }
  /// Whether all leaves in a node sample all rays of a packet that cross one cell.
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

  /// Index behind the last beam among [first, last) of a list, all of one face, that some leaf in a node may
  /// sample.
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
  /// Factor by which beams get wider if a fraction of them stands for all.
  [[nodiscard]] static float widening(float fraction) {
    if constexpr (D < 2) return 1.0f;
    if constexpr (D == 2) return 1.0f / fraction;
    if constexpr (D == 3) return 1.0f / std::sqrt(fraction);
    return std::pow(fraction, -1.0f / static_cast<float>(D - 1));
  }

  /// Sampling fractions of a node's children for beams of one face: equal in all children at one depth.
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
    [[nodiscard]] FaceSample<D> of(std::size_t child, bool uses_small_sample) const {
      return of_slab(slab_of(child), uses_small_sample);
    }

   private:
    [[nodiscard]] FaceSample<D> of_slab(std::size_t slab, bool uses_small_sample) const {
      return sampling_.sample_of(face_, sampling_.at_depth(depths_[slab], face_, uses_small_sample));
    }
    /// Index of a child on the face's axis.
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
  /// The fraction that a leaf samples at a depth.
  [[nodiscard]] NDTREE_ALWAYS_INLINE float at_depth(float depth, const CubeFace<D>& face,
                                                    bool uses_small_sample) const {
    if (depth >= face.depth_of_full_sample[uses_small_sample]) return 1.0f;
    return std::min(1.0f, sample_beams_[uses_small_sample] / face.expected_beams(depth, smallest_size_));
  }

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const float smallest_size_;
  const std::array<float, 2> sample_beams_;  // Of the large sample, and of the small one.
};

}  // namespace ndtree
