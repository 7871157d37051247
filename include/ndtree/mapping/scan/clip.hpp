// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which of a node's beams cross which of its children: all beams against all planes between them.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/scan/beams.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Hands beams down to children. A beam crosses the plane at p, on an axis, at (p - origin) * inverse: two
/// roundings to float, of a number that depends on the plane and the beam alone. It grows from plane to plane
/// along the beam; so children share their borders to the last bit, and what a beam crosses of a node is the
/// sum of what it crosses of the children, without gap or overlap.
template <int N, int D>
class ChildClip {
 public:
  static constexpr int kNumChildren = static_cast<int>(integer_power(N, D));
  using Lists = SiblingLists<kNumChildren>;

  ChildClip(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams)
      : geometry_(geometry), beams_(beams), width_(beams.width()) {}

  [[nodiscard]] const LatticeGeometry<N, D>& geometry() const { return geometry_; }

  /// Lists for the children, as long as they may get, and empty: each of few children has room for all beams.
  [[nodiscard]] Lists lists_for(const CellIndex<D>& node, const Crossings& list, CrossingStack& stack) const {
    Lists lists;
    std::size_t used = 0;
    if constexpr (kHasRoomForAll) {
      for (std::size_t c = 0; c < lists.last.size(); ++c, used += list.size + Crossings::kSlack)
        lists.first[c] = lists.last[c] = used;
    } else {  // A beam crosses few of many.
      std::array<std::size_t, static_cast<std::size_t>(kNumChildren)> count{};
      for_each_crossing(node, list, [&](std::size_t child, std::uint32_t, float, float) { ++count[child]; });
      for (std::size_t c = 0; c < lists.last.size(); ++c) {
        lists.first[c] = lists.last[c] = used;
        used += count[c] + Crossings::kSlack;
      }
    }
    lists.memory = stack.allocate(used);
    return lists;
  }

  /// Adds a node's beams to the lists of its children, in their order.
  void operator()(const CellIndex<D>& node, const Crossings& list, Lists& children) const {
#ifdef NDTREE_HAS_EIGHTS
    if constexpr (kNumChildren <= kMostAtOnce) {
      if (goes_by_eights()) {
#ifdef NDTREE_HAS_SIXTEENS
        if constexpr (N == 2 && kNumChildren >= 8) {  // Among four, as in the plane, it is no faster.
          if (width_ >= 16 && list.size > 8) {
            sixteen_at_a_time(planes_of(node), list, children);
            return;
          }
        }
#endif
        eight_at_a_time(planes_of(node), list, children);
        return;
      }
    }
#endif
    for_each_crossing(node, list, [&](std::size_t child, std::uint32_t beam, float enter, float exit) {
      const std::size_t place = children.last[child]++;
      children.memory.beam[place] = beam;
      children.memory.enter()[place] = enter;
      children.memory.exit()[place] = exit;
    });
  }

  /// Calls `visit(child, beam, enter, exit)` for each child that each beam crosses.
  template <class Visit>
  void for_each_crossing(const CellIndex<D>& node, const Crossings& list, const Visit& visit) const {
    if (beams_.has_own_origins()) {
      std::array<std::array<double, kPlanes>, std::size_t{D}> borders;
      for (std::size_t a = 0; a < D; ++a)
        for (std::size_t i = 0; i < kPlanes; ++i) borders[a][i] = border(node, a, i);
      for (std::size_t i = 0; i < list.size; ++i) {
        const Vector<D>& origin = beams_.origin(list.beam[i]);
        divide<D - 1>(list.beam[i], list.enter()[i], list.exit()[i], 0, visit,
                      [&](std::size_t a, std::size_t plane) {
                        return static_cast<float>(borders[a][plane] - origin[static_cast<int>(a)]);
                      });
      }
      return;
    }
    const Planes planes = planes_of(node);
    for (std::size_t i = 0; i < list.size; ++i)
      divide<D - 1>(list.beam[i], list.enter()[i], list.exit()[i], 0, visit,
                    [&](std::size_t a, std::size_t plane) { return planes[a][plane]; });
  }
  static constexpr std::size_t kPlanes = N - 1;
  static constexpr int kMostAtOnce = 32;  ///< Children; among more, a beam finds its way faster alone.
  static constexpr bool kHasRoomForAll = kNumChildren <= kMostAtOnce;  ///< Of lists_for().
  using Planes = std::array<std::array<float, kPlanes>, std::size_t{D}>;

  /// Whether eight_beams() may do.
  [[nodiscard]] bool goes_by_eights() const {
    return kNumChildren <= kMostAtOnce && width_ >= 8 && !beams_.has_own_origins();
  }
  /// The planes between children, from the one origin of all beams.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Planes planes_of(const CellIndex<D>& node) const {
    Planes planes;
    for (std::size_t a = 0; a < D; ++a)
      for (std::size_t i = 0; i < kPlanes; ++i)
        planes[a][i] = static_cast<float>(border(node, a, i) - beams_.origin(0)[static_cast<int>(a)]);
    return planes;
  }
#ifdef NDTREE_HAS_EIGHTS
  using Few = FewCrossings<D, kNumChildren>;
  /// Clips at most Few::kMost beams, without lists for the children. @pre goes_by_eights().
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void operator()(const CellIndex<D>& node, const Crossings& list,
                                                        Few& few) const {
    few_beams(node, _mm256_loadu_ps(list.enter()), _mm256_loadu_ps(list.exit()),
              _mm256_castsi256_ps(detail::first_of_eight(list.size)), few);
  }
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void operator()(const CellIndex<D>& node,
                                                        const FewOfChild<D, kNumChildren>& beams,
                                                        Few& few) const {
    const __m256 enter = _mm256_load_ps(beams.of.enter[beams.child].data());
    const __m256 exit = _mm256_load_ps(beams.of.exit[beams.child].data());
    few_beams(node, enter, exit, _mm256_cmp_ps(exit, enter, _CMP_GT_OQ), few);
  }
  /// Whether the children of a node, between one plane on each axis, fit the lanes of a vector.
  static constexpr bool kFitLanes = N == 2 && kNumChildren <= static_cast<int>(LoneCrossing::kMostChildren);
  /// Clips one beam, against all children at once. @pre kFitLanes && goes_by_eights().
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void operator()(const CellIndex<D>& node, const BeamWay<D>& way,
                                                        float from, float to, LoneCrossing& lone) const {
    const Planes planes = planes_of(node);
    const __m256 t0 = _mm256_set1_ps(from);
    const __m256 t1 = _mm256_set1_ps(to);
    __m256 enter = t0;
    __m256 exit = t1;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a) {
      const __m256 inverse = _mm256_set1_ps(way.inverse[a]);
      const __m256 plane = _mm256_mul_ps(_mm256_set1_ps(planes[a][0]), inverse);
      // The sign bit of the children that the beam crosses behind the plane.
      const __m256i upper =
          _mm256_slli_epi32(_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7), 31 - static_cast<int>(a));
      const __m256 is_behind = _mm256_xor_ps(_mm256_castsi256_ps(upper), inverse);
      enter = _mm256_max_ps(enter, _mm256_blendv_ps(t0, plane, is_behind));
      exit = _mm256_min_ps(exit, _mm256_blendv_ps(plane, t1, is_behind));
    }
    _mm256_store_ps(lone.enter.data(), enter);
    _mm256_store_ps(lone.exit.data(), exit);
    lone.set = static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_cmp_ps(exit, enter, _CMP_GT_OQ))) &
               ((1u << kNumChildren) - 1);
  }
  /// Writes those that cross a child, in their order.
  NDTREE_BY_EIGHTS static void write(const FewOfChild<D, kNumChildren>& few, Crossings& list) {
    const __m256i order = detail::packing(few.set());
    const __m256i beam = _mm256_load_si256(reinterpret_cast<const __m256i*>(few.of.beams.number.data()));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(list.beam), _mm256_permutevar8x32_epi32(beam, order));
    _mm256_storeu_ps(list.enter(),
                     _mm256_permutevar8x32_ps(_mm256_load_ps(few.of.enter[few.child].data()), order));
    _mm256_storeu_ps(list.exit(),
                     _mm256_permutevar8x32_ps(_mm256_load_ps(few.of.exit[few.child].data()), order));
    list.size = few.size();
  }

  /// Where eight beams enter and leave each child: those that cross it leave behind where they enter.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void eight_beams(const Planes& plane, const EightWays<D>& ways,
                                                         __m256 t0, __m256 t1, __m256* enter,
                                                         __m256* exit) const {
    enter[0] = t0;
    exit[0] = t1;
    int made = 1;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a) {
      const __m256 inv = ways.inverse[a];
      __m256 from[std::size_t{N}];
      __m256 to[std::size_t{N}];
      from[0] = t0;
      to[N - 1] = t1;
      // Slab s lies between the planes s - 1 and s: a beam upwards enters it by the first.
#pragma GCC unroll 8
      for (std::size_t s = 0; s < N; ++s) {
        const __m256 before = s == 0 ? t0 : _mm256_mul_ps(_mm256_set1_ps(plane[a][s == 0 ? 0 : s - 1]), inv);
        const __m256 behind =
            s == N - 1 ? t0 : _mm256_mul_ps(_mm256_set1_ps(plane[a][s == N - 1 ? 0 : s]), inv);
        const __m256 from_up = s == 0 ? t0 : _mm256_max_ps(before, t0);
        const __m256 to_up = s == N - 1 ? t1 : _mm256_min_ps(behind, t1);
        const __m256 from_down = s == N - 1 ? t0 : _mm256_max_ps(behind, t0);
        const __m256 to_down = s == 0 ? t1 : _mm256_min_ps(before, t1);
        from[s] = _mm256_blendv_ps(from_up, from_down, inv);
        to[s] = _mm256_blendv_ps(to_up, to_down, inv);
      }
#pragma GCC unroll 8
      for (int m = 0; m < N; ++m) {  // From the last slab: the first takes the place of what it is made of.
        const int s = N - 1 - m;
#pragma GCC unroll 16
        for (int c = 0; c < made; ++c) {
          const auto source = static_cast<std::size_t>(c);
          const auto target = static_cast<std::size_t>(s * made + c);
          const auto slab = static_cast<std::size_t>(s);
          enter[target] = a == 0 ? from[slab] : _mm256_max_ps(enter[source], from[slab]);
          exit[target] = a == 0 ? to[slab] : _mm256_min_ps(exit[source], to[slab]);
        }
      }
      made *= N;
    }
  }
#endif

 private:
  [[nodiscard]] double border(const CellIndex<D>& node, std::size_t axis, std::size_t plane) const {
    return geometry_.border(node.lower[axis] +
                            static_cast<std::int64_t>(plane + 1) * geometry_.edge(node.level - 1));
  }
  /// Divides a beam's way among slabs of children, axis by axis.
  template <int Axis, class Visit, class PlaneOf>
  void divide(std::uint32_t beam, float enter, float exit, int child, const Visit& visit,
              const PlaneOf& plane_of) const {
    if constexpr (Axis < 0) {
      visit(static_cast<std::size_t>(child), beam, enter, exit);
    } else {
      const float inverse = beams_.way(beam).inverse[Axis];
      const bool up = inverse > 0.0f;
      for (int s = 0; s < N && exit > enter; ++s) {
        const int slab = up ? s : N - 1 - s;  // In the order of the beam.
        float leave = exit;
        if (s < N - 1)
          leave = std::min(exit, plane_of(Axis, static_cast<std::size_t>(up ? slab : slab - 1)) * inverse);
        if (!(leave > enter)) continue;
        divide<Axis - 1>(beam, enter, leave, child * N + slab, visit, plane_of);
        enter = leave;
      }
    }
  }

#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void few_beams(const CellIndex<D>& node, __m256 t0, __m256 t1,
                                                       __m256 live, Few& few) const {
    __m256 enter[std::size_t{kNumChildren}];
    __m256 exit[std::size_t{kNumChildren}];
    eight_beams(planes_of(node), few.beams.ways, t0, _mm256_blendv_ps(t0, t1, live), enter, exit);
#pragma GCC unroll 32
    for (std::size_t c = 0; c < kNumChildren; ++c) {
      _mm256_store_ps(few.enter[c].data(), enter[c]);
      _mm256_store_ps(few.exit[c].data(), exit[c]);
      few.set[c] =
          static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_cmp_ps(exit[c], enter[c], _CMP_GT_OQ)));
      few.passing[c] = few.set[c] & static_cast<std::uint32_t>(_mm256_movemask_ps(
                                        _mm256_cmp_ps(exit[c], few.beams.ways.pass, _CMP_LT_OQ)));
    }
  }
  NDTREE_BY_EIGHTS void eight_at_a_time(const Planes& plane, const Crossings& list, Lists& children) const {
    // Compilers take what is stored for anything: copies stay in registers.
    const Crossings from = list;
    const Crossings to = children.memory;
    float* const to_enter = to.enter();
    float* const to_exit = to.exit();
    const BeamWay<D>* const rows = beams_.ways();
    std::array<std::size_t, std::size_t{kNumChildren}> last = children.last;
    for (std::size_t i = 0; i < from.size; i += 8) {
      const __m256i live = detail::first_of_eight(from.size - i);
      const __m256i beam = detail::load_live(from.beam + i, live);
      const __m256 t0 = _mm256_loadu_ps(from.enter() + i);
      const __m256 t1 = _mm256_blendv_ps(t0, _mm256_loadu_ps(from.exit() + i), _mm256_castsi256_ps(live));
      __m256 enter[std::size_t{kNumChildren}];
      __m256 exit[std::size_t{kNumChildren}];
      eight_beams(plane, ScanBeams<D>::ways(rows, beam), t0, t1, enter, exit);
#pragma GCC unroll 32
      for (std::size_t c = 0; c < kNumChildren; ++c) {
        const auto set =
            static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(exit[c], enter[c], _CMP_GT_OQ)));
        const __m256i order = detail::packing(set);
        const std::size_t place = last[c];
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(to.beam + place),
                            _mm256_permutevar8x32_epi32(beam, order));
        _mm256_storeu_ps(to_enter + place, _mm256_permutevar8x32_ps(enter[c], order));
        _mm256_storeu_ps(to_exit + place, _mm256_permutevar8x32_ps(exit[c], order));
        last[c] = place + static_cast<std::size_t>(__builtin_popcount(set));
      }
    }
    children.last = last;
  }
#endif
#ifdef NDTREE_HAS_SIXTEENS
  // Those without a mask are written so that GCC takes part of them for not initialised, and warns of it.
  NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE static __m512 larger(__m512 a, __m512 b) {
    return _mm512_maskz_max_ps(0xffff, a, b);
  }
  NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE static __m512 smaller(__m512 a, __m512 b) {
    return _mm512_maskz_min_ps(0xffff, a, b);
  }
  /// As eight_beams(), where one plane on each axis divides the node.
  NDTREE_BY_SIXTEENS NDTREE_ALWAYS_INLINE static void sixteen_beams(const Planes& plane,
                                                                    const __m512* inverse, __m512 t0,
                                                                    __m512 t1, __m512* enter, __m512* exit) {
    enter[0] = t0;
    exit[0] = t1;
    std::size_t made = 1;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a, made *= 2) {
      const __m512 inv = inverse[a];
      const __mmask16 is_down = _mm512_movepi32_mask(_mm512_castps_si512(inv));
      const __m512 at = _mm512_mul_ps(_mm512_set1_ps(plane[a][0]), inv);
      const __m512 behind = larger(at, t0);
      const __m512 before = smaller(at, t1);
      const __m512 from_lower = _mm512_mask_blend_ps(is_down, t0, behind);
      const __m512 to_lower = _mm512_mask_blend_ps(is_down, before, t1);
      const __m512 from_upper = _mm512_mask_blend_ps(is_down, behind, t0);
      const __m512 to_upper = _mm512_mask_blend_ps(is_down, t1, before);
#pragma GCC unroll 16
      for (std::size_t c = 0; c < made; ++c) {
        enter[made + c] = larger(enter[c], from_upper);
        exit[made + c] = smaller(exit[c], to_upper);
        enter[c] = larger(enter[c], from_lower);
        exit[c] = smaller(exit[c], to_lower);
      }
    }
  }
  NDTREE_BY_SIXTEENS void sixteen_at_a_time(const Planes& plane, const Crossings& list,
                                            Lists& children) const {
    static_assert(Crossings::kSlack >= 16, "all of a vector is written");
    const Crossings from = list;  // As in eight_at_a_time().
    const Crossings to = children.memory;
    float* const to_enter = to.enter();
    float* const to_exit = to.exit();
    const BeamWay<D>* const rows = beams_.ways();
    std::array<std::size_t, std::size_t{kNumChildren}> last = children.last;
    const __m512i places = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    for (std::size_t i = 0; i < from.size; i += 16) {
      const std::size_t left = std::min<std::size_t>(from.size - i, 16);
      const auto live = static_cast<__mmask16>((1u << left) - 1);
      // All sixteen are loaded: with a mask, processors do not find what was just stored.
      const __m512i beam = _mm512_maskz_mov_epi32(live, _mm512_loadu_si512(from.beam + i));
      const __m512 t0 = _mm512_loadu_ps(from.enter() + i);
      const __m512 t1 = _mm512_mask_mov_ps(t0, live, _mm512_loadu_ps(from.exit() + i));
      __m512 inverse[ScanBeams<D>::kColumnsOfWay];
      ScanBeams<D>::inverses(rows, beam, inverse);
      __m512 enter[std::size_t{kNumChildren}];
      __m512 exit[std::size_t{kNumChildren}];
      sixteen_beams(plane, inverse, t0, t1, enter, exit);
#pragma GCC unroll 32
      for (std::size_t c = 0; c < kNumChildren; ++c) {
        // Compressed in registers: straight to memory takes some processors a hundred cycles.
        const __mmask16 set = _mm512_cmp_ps_mask(exit[c], enter[c], _CMP_GT_OQ);
        const std::size_t place = last[c];
        const __m512i order = _mm512_maskz_compress_epi32(set, places);
        _mm512_storeu_si512(to.beam + place, _mm512_maskz_permutexvar_epi32(0xffff, order, beam));
        _mm512_storeu_ps(to_enter + place, _mm512_maskz_permutexvar_ps(0xffff, order, enter[c]));
        _mm512_storeu_ps(to_exit + place, _mm512_maskz_permutexvar_ps(0xffff, order, exit[c]));
        last[c] = place + static_cast<std::size_t>(__builtin_popcount(set));
      }
    }
    children.last = last;
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  int width_;
};

}  // namespace ndtree
