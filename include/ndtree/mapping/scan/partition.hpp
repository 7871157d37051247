// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which children of a node each beam crosses: all beams against the planes between the children.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/scan/beam_lists.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/mapping/scan/packed_beams.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Partitions a node's beams among its children. A beam crosses a child if it leaves it behind where it
/// enters it, see CellCrossings.
///
/// Strategy. With up to kMostAtOnce children, vectors of 8 or 16 beams are clipped against all N + 1 planes
/// of each axis, and compressed into the list of each child; with more, each beam finds its way from child to
/// child. Invariant: both give the same lists, to the last bit. Cost: O(N D) products for each beam, and
/// O(N^D) stores for each vector.
template <int N, int D>
class ChildPartition {
 public:
  static constexpr int kNumChildren = static_cast<int>(integer_power(N, D));
  using Lists = SiblingLists<kNumChildren>;
  using Planes = typename CellCrossings<N, D>::Planes;

  ChildPartition(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams)
      : geometry_(geometry), beams_(beams), width_(beams.width()) {}

  [[nodiscard]] const LatticeGeometry<N, D>& geometry() const { return geometry_; }

  /// Empty lists for the children: up to kMostAtOnce children have room for all beams, more for those that
  /// cross.
  [[nodiscard]] Lists lists_for(const CellIndex<D>& node, const BeamList& list, ListStack& stack) const {
    Lists lists;
    std::size_t used = 0;
    if constexpr (kHasRoomForAll) {
      for (std::size_t c = 0; c < lists.last.size(); ++c, used += list.size + BeamList::kSlack)
        lists.first[c] = lists.last[c] = used;
    } else {  // A beam crosses few children of many.
      std::array<std::size_t, static_cast<std::size_t>(kNumChildren)> count{};
      for_each_crossing(node, list, [&](std::size_t child, std::uint32_t, float, float) { ++count[child]; });
      for (std::size_t c = 0; c < lists.last.size(); ++c) {
        lists.first[c] = lists.last[c] = used;
        used += count[c] + BeamList::kSlack;
      }
    }
    lists.memory = stack.allocate(used);
    return lists;
  }

  /// Appends a node's beams to the lists of its children, in ascending order, and pads these.
  /// @param planes see planes_of(), of the node, if all beams have one origin.
  void operator()(const CellIndex<D>& node, const Planes& planes, const BeamList& list,
                  Lists& children) const {
#ifdef NDTREE_HAS_EIGHTS
    if constexpr (kNumChildren <= kMostAtOnce) {
      if (goes_by_eights()) {
#ifdef NDTREE_HAS_SIXTEENS
        if constexpr (kHasSixteens) {
          if (width_ >= 16 && list.size > 8) {
            sixteen_at_a_time(planes, list, children);
            return;
          }
        }
#endif
        eight_at_a_time(planes, list, children);
        return;
      }
    }
#endif
    for_each_crossing(node, list, [&](std::size_t child, std::uint32_t beam, float, float) {
      children.memory.beam[children.last[child]++] = beam;
    });
    if (width_ >= 8) children.pad();  // Loops of width 1 read no padding.
  }

  /// Calls `visit(child, beam, enter, exit)` for each child that each beam crosses.
  template <class Visit>
  void for_each_crossing(const CellIndex<D>& node, const BeamList& list, const Visit& visit) const {
    if (beams_.has_own_origins()) {
      std::array<std::array<double, kPlanes>, std::size_t{D}> borders;
      for (std::size_t a = 0; a < D; ++a)
        for (std::size_t i = 0; i < kPlanes; ++i) borders[a][i] = geometry_.border(coordinate(node, a, i));
      for (std::size_t i = 0; i < list.size; ++i) {
        const Vector<D>& origin = beams_.origin(list.beam[i]);
        divide(list.beam[i], visit, [&](std::size_t a, std::size_t plane) {
          return static_cast<float>(borders[a][plane] - origin[static_cast<int>(a)]);
        });
      }
      return;
    }
    const Planes planes = planes_of(node);
    for (std::size_t i = 0; i < list.size; ++i)
      divide(list.beam[i], visit, [&](std::size_t a, std::size_t plane) { return planes[a][plane]; });
  }
  /// Where one beam enters and leaves a node.
  [[nodiscard]] Crossing crossing(const CellIndex<D>& node, std::uint32_t beam) const {
    return CellCrossings<N, D>::clipped(
        beams_.ray(beam), [&](std::size_t a) { return plane_of(node, a, 0, beam); },
        [&](std::size_t a) { return plane_of(node, a, N, beam); });
  }
  /// Of each child, on each axis.
  static constexpr auto kOffsets = [] {
    std::array<std::array<std::size_t, std::size_t{D}>, std::size_t{kNumChildren}> offsets{};
    for (int c = 0; c < kNumChildren; ++c)
      for (std::size_t a = 0; a < D; ++a)
        offsets[static_cast<std::size_t>(c)][a] = static_cast<std::size_t>(child_offset<N, D>(c)[a]);
    return offsets;
  }();
  static constexpr std::size_t kPlanes = N + 1;  ///< On an axis: those between children, and the outer ones.
  static constexpr int kMostAtOnce = 32;         ///< Children; with more, single beams are faster.
  static constexpr bool kHasRoomForAll = kNumChildren <= kMostAtOnce;  ///< Of lists_for().
  /// Whether vector loops are used.
  [[nodiscard]] bool goes_by_eights() const {
    return kNumChildren <= kMostAtOnce && width_ >= 8 && !beams_.has_own_origins();
  }
  /// Position of a plane minus a beam's origin.
  [[nodiscard]] NDTREE_ALWAYS_INLINE float plane_of(const CellIndex<D>& node, std::size_t axis,
                                                    std::size_t plane, std::uint32_t beam) const {
    return CellCrossings<N, D>::plane(geometry_, coordinate(node, axis, plane),
                                      beams_.origin(beam)[static_cast<int>(axis)]);
  }
  /// The planes of a node and between its children, from the one origin of all beams.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Planes planes_of(const CellIndex<D>& node) const {
    return planes_of(node, 0, N);
  }
  /// planes_of() for beams that are clipped to the node already: its outer planes are infinitely far away.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Planes inner_planes_of(const CellIndex<D>& node) const {
    return planes_of(node, 1, N - 1);
  }
#ifdef NDTREE_HAS_EIGHTS
  using Packet = RayPacket<D, kNumChildren>;
  /// Clips a packet against the children of a node. @param list of its rays. @pre goes_by_eights().
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void operator()(const CellIndex<D>& node, const BeamList& list,
                                                       Packet& packet) const {
    const __m256 live = _mm256_castsi256_ps(detail::first_of_eight(list.size));
    clip_packet(planes_of(node), _mm256_setzero_ps(), _mm256_and_ps(packet.beams.rays.t_max, live), packet);
  }
  /// Clips the rays of a packet that cross a child of a node against the child's children.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void operator()(const CellIndex<D>& node, const Packet& above,
                                                       std::size_t child, Packet& packet) const {
    clip_packet(inner_planes_of(node), _mm256_load_ps(above.enter[child].data()),
                _mm256_load_ps(above.exit[child].data()), packet);
  }

  /// Where eight beams enter and leave the node, before a distance.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE static void eight_crossings(const Planes& plane,
                                                                    const EightRays<D>& rays, __m256 to,
                                                                    __m256& enter, __m256& exit) {
    enter = _mm256_setzero_ps();
    exit = to;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a) {
      const __m256 at_lower = _mm256_mul_ps(_mm256_set1_ps(plane[a][0]), rays.inverse[a]);
      const __m256 at_upper = _mm256_mul_ps(_mm256_set1_ps(plane[a][N]), rays.inverse[a]);
      enter = _mm256_max_ps(enter, _mm256_min_ps(at_lower, at_upper));
      exit = _mm256_min_ps(exit, _mm256_max_ps(at_lower, at_upper));
    }
  }
  /// Where eight beams enter and leave each child, between two distances.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void eight_beams(const Planes& plane, const EightRays<D>& rays,
                                                         __m256 from, __m256 to, __m256* enter,
                                                         __m256* exit) const {
    enter[0] = from;
    exit[0] = to;
    std::size_t made = 1;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a, made *= N) {
      __m256 at[kPlanes];
#pragma GCC unroll 8
      for (std::size_t i = 0; i < kPlanes; ++i)
        at[i] = _mm256_mul_ps(_mm256_set1_ps(plane[a][i]), rays.inverse[a]);
#pragma GCC unroll 8
      for (std::size_t m = 0; m < N; ++m) {  // From the last slab: the first takes the place of its source.
        const std::size_t s = N - 1 - m;
        const __m256 before = _mm256_min_ps(at[s], at[s + 1]);
        const __m256 behind = _mm256_max_ps(at[s], at[s + 1]);
#pragma GCC unroll 16
        for (std::size_t c = 0; c < made; ++c) {
          enter[s * made + c] = _mm256_max_ps(enter[c], before);
          exit[s * made + c] = _mm256_min_ps(exit[c], behind);
        }
      }
    }
  }
#endif

 private:
  /// Lattice coordinate of a plane of a node.
  [[nodiscard]] NDTREE_ALWAYS_INLINE std::int64_t coordinate(const CellIndex<D>& node, std::size_t axis,
                                                             std::size_t plane) const {
    return node.lower[axis] + static_cast<std::int64_t>(plane) * geometry_.edge(node.level - 1);
  }
  [[nodiscard]] NDTREE_ALWAYS_INLINE Planes planes_of(const CellIndex<D>& node, std::size_t first,
                                                      std::size_t last) const {
    constexpr float kNowhere = std::numeric_limits<float>::infinity();
    Planes planes;
    for (std::size_t a = 0; a < D; ++a) {
      planes[a].front() = -kNowhere;
      planes[a].back() = kNowhere;
      for (std::size_t i = first; i <= last; ++i) planes[a][i] = plane_of(node, a, i, 0);
    }
    return planes;
  }
  /// Clips one beam against the children. @param plane_of `(axis, number)` planes minus its origin.
  template <class Visit, class PlaneOf>
  void divide(std::uint32_t beam, const Visit& visit, const PlaneOf& plane_of) const {
    const Crossing whole = CellCrossings<N, D>::clipped(
        beams_.ray(beam), [&](std::size_t a) { return plane_of(a, 0); },
        [&](std::size_t a) { return plane_of(a, N); });
    divide<D - 1>(beam, whole, 0, visit, plane_of);
  }
  /// Clips one beam against slabs of children, axis by axis.
  template <int Axis, class Visit, class PlaneOf>
  void divide(std::uint32_t beam, Crossing left, int child, const Visit& visit,
              const PlaneOf& plane_of) const {
    if constexpr (Axis < 0) {
      visit(static_cast<std::size_t>(child), beam, left.enter, left.exit);
    } else {
      const float inverse = beams_.ray(beam).inverse[Axis];
      const bool up = inverse > 0.0f;
      for (int s = 0; s < N && left.exit > left.enter; ++s) {
        const int slab = up ? s : N - 1 - s;  // In the order of the beam.
        float leave = left.exit;
        if (s < N - 1)
          leave = std::min(left.exit,
                           rounded(plane_of(Axis, static_cast<std::size_t>(up ? slab + 1 : slab)) * inverse));
        if (!(leave > left.enter)) continue;
        divide<Axis - 1>(beam, {left.enter, leave}, child * N + slab, visit, plane_of);
        left.enter = leave;
      }
    }
  }

  /// With four children, in 2-D, sixteen beams at a time are no faster than eight.
  static constexpr bool kHasSixteens = N == 2 && kNumChildren >= 8;
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void clip_packet(const Planes& planes, __m256 from, __m256 to,
                                                         Packet& packet) const {
    __m256 enter[std::size_t{kNumChildren}];
    __m256 exit[std::size_t{kNumChildren}];
    eight_beams(planes, packet.beams.rays, from, to, enter, exit);
#pragma GCC unroll 32
    for (std::size_t c = 0; c < kNumChildren; ++c) {
      _mm256_store_ps(packet.enter[c].data(), enter[c]);
      _mm256_store_ps(packet.exit[c].data(), exit[c]);
      packet.set[c] =
          static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_cmp_ps(exit[c], enter[c], _CMP_GT_OQ)));
      packet.passing[c] = packet.set[c] & static_cast<std::uint32_t>(_mm256_movemask_ps(
                                              _mm256_cmp_ps(exit[c], packet.beams.t_free, _CMP_LT_OQ)));
    }
  }
  NDTREE_BY_EIGHTS void eight_at_a_time(const Planes& plane, const BeamList& list, Lists& children) const {
    // Copies, as stores through `to` might alias the members.
    const BeamList from = list;
    std::uint32_t* const to = children.memory.beam;
    const BeamRay<D>* const rows = beams_.rays();
    std::array<std::size_t, std::size_t{kNumChildren}> last = children.last;
    for (std::size_t i = 0; i < from.size; i += 8) {
      const __m256i live = detail::first_of_eight(from.size - i);
      const __m256i beam = detail::load(from.beam + i);
      const EightRays<D> rays = ScanBeams<D>::rays(rows, from.beam + i);
      __m256 enter[std::size_t{kNumChildren}];
      __m256 exit[std::size_t{kNumChildren}];
      eight_beams(plane, rays, _mm256_setzero_ps(), _mm256_and_ps(rays.t_max, _mm256_castsi256_ps(live)),
                  enter, exit);
#pragma GCC unroll 32
      for (std::size_t c = 0; c < kNumChildren; ++c) {
        const auto set =
            static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(exit[c], enter[c], _CMP_GT_OQ)));
        const std::size_t place = last[c];
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(to + place),
                            _mm256_permutevar8x32_epi32(beam, detail::packing(set)));
        last[c] = place + static_cast<std::size_t>(__builtin_popcount(set));
      }
    }
    children.last = last;
    children.pad();
  }
#endif
#ifdef NDTREE_HAS_SIXTEENS
  // GCC warns of uninitialised parts in the intrinsics without a mask.
  NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE static __m512 larger(__m512 a, __m512 b) {
    return _mm512_maskz_max_ps(0xffff, a, b);
  }
  NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE static __m512 smaller(__m512 a, __m512 b) {
    return _mm512_maskz_min_ps(0xffff, a, b);
  }
  /// As eight_beams(), of all that lies before the beams' reach.
  /// @param way ScanBeams::kColumnsOfWay of sixteen beams.
  NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE static void sixteen_beams(const Planes& plane, const __m512* ray,
                                                                    __m512* enter, __m512* exit) {
    enter[0] = _mm512_setzero_ps();
    exit[0] = ray[D];
    std::size_t made = 1;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a, made *= N) {
      __m512 at[kPlanes];
#pragma GCC unroll 8
      for (std::size_t i = 0; i < kPlanes; ++i) at[i] = _mm512_mul_ps(_mm512_set1_ps(plane[a][i]), ray[a]);
#pragma GCC unroll 8
      for (std::size_t m = 0; m < N; ++m) {
        const std::size_t s = N - 1 - m;
        const __m512 before = smaller(at[s], at[s + 1]);
        const __m512 behind = larger(at[s], at[s + 1]);
#pragma GCC unroll 16
        for (std::size_t c = 0; c < made; ++c) {
          enter[s * made + c] = larger(enter[c], before);
          exit[s * made + c] = smaller(exit[c], behind);
        }
      }
    }
  }
  NDTREE_BY_SIXTEENS void sixteen_at_a_time(const Planes& plane, const BeamList& list,
                                            Lists& children) const {
    static_assert(BeamList::kSlack == 16, "all of a vector is written, and read");
    const BeamList from = list;  // As in eight_at_a_time().
    std::uint32_t* const to = children.memory.beam;
    const BeamRay<D>* const rows = beams_.rays();
    std::array<std::size_t, std::size_t{kNumChildren}> last = children.last;
    for (std::size_t i = 0; i < from.size; i += 16) {
      const std::size_t left = std::min<std::size_t>(from.size - i, 16);
      const auto live = static_cast<__mmask16>((1u << left) - 1);
      const __m512i beam = _mm512_maskz_loadu_epi32(live, from.beam + i);
      __m512 ray[ScanBeams<D>::kColumnsOfRay];
      ScanBeams<D>::rays(rows, from.beam + i, ray);
      __m512 enter[std::size_t{kNumChildren}];
      __m512 exit[std::size_t{kNumChildren}];
      sixteen_beams(plane, ray, enter, exit);
#pragma GCC unroll 32
      for (std::size_t c = 0; c < kNumChildren; ++c) {
        // Compressed in registers: straight to memory takes some processors a hundred cycles.
        const __mmask16 set = _mm512_mask_cmp_ps_mask(live, exit[c], enter[c], _CMP_GT_OQ);
        const std::size_t place = last[c];
        _mm512_storeu_si512(to + place, _mm512_maskz_compress_epi32(set, beam));
        last[c] = place + static_cast<std::size_t>(__builtin_popcount(set));
      }
    }
    children.last = last;
    children.pad();
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  int width_;
};

}  // namespace ndtree
