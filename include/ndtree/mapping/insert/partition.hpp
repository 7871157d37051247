// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which children of a node each beam crosses: all beams against the planes between the children.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
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

  /// Appends a node's beams to the lists of its children, in ascending order, and pads these but for width 1.
  /// @param planes see planes_of(), of the node, if all beams have one origin.
  void operator()(const CellIndex<D>& node, [[maybe_unused]] const Planes& planes, const BeamList& list,
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

  /// Calls `visit(child, beam, enter, exit)` for each child that each beam crosses. Beam by beam, along the
  /// few of many children that it crosses, and from an origin of its own; vectors clip against all children.
  template <class Visit>
  void for_each_crossing(const CellIndex<D>& node, const BeamList& list, const Visit& visit) const {
    if (beams_.has_own_origins()) {
      std::array<std::array<double, kPlanes>, std::size_t{D}> borders;
      for (std::size_t a = 0; a < D; ++a)
        for (std::size_t i = 0; i < kPlanes; ++i) borders[a][i] = geometry_.border(coordinate(node, a, i));
      for (std::size_t i = 0; i < list.size; ++i) {
        const Vector<D>& origin = beams_.origin(list.beam[i]);
        clip_among_children(list.beam[i], visit, [&](std::size_t a, std::size_t plane) {
          return static_cast<float>(borders[a][plane] - origin[static_cast<int>(a)]);
        });
      }
      return;
    }
    const Planes planes = planes_of(node);
    for (std::size_t i = 0; i < list.size; ++i)
      clip_among_children(list.beam[i], visit,
                          [&](std::size_t a, std::size_t plane) { return planes[a][plane]; });
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
  /// planes_of(), side by side; the same bits.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE Planes planes_by_fours(const CellIndex<D>& node) const {
    if constexpr (kPlanes > 4) return planes_of(node);
    Planes planes;
    const FourDoubles steps =
        FourDoubles::of(0.0, 1.0, 2.0, 3.0) * static_cast<double>(geometry_.edge(node.level - 1));
    const Vector<D>& origin = beams_.origin(0);
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a)
      store_as_floats(
          (static_cast<double>(node.lower[a]) + steps) * geometry_.unit() - origin[static_cast<int>(a)],
          planes[a].data());
    return planes;
  }
  using Packet = RayPacket<D, kNumChildren>;
  /// Clips a packet against the children of a node. @param list of its rays. @pre goes_by_eights().
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void operator()(const CellIndex<D>& node, const BeamList& list,
                                                       Packet& packet) const {
    clip_packet(planes_by_fours(node), 0.0f, packet.beams.rays.t_max & EightMask::first(list.size), packet);
  }
  /// Clips the rays of a packet that cross a child of a node against the child's children.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void operator()(const CellIndex<D>& node, const Packet& above,
                                                       std::size_t child, Packet& packet) const {
    clip_packet(inner_planes_of(node), EightFloats::load(above.enter[child].data()),
                EightFloats::load(above.exit[child].data()), packet);
  }

  /// Where several beams enter and leave the node, before a distance.
  template <class Floats>
  NDTREE_ALWAYS_INLINE static void crossings_of_node(const Planes& plane, const Floats* inverse,
                                                     const Floats& to, Floats& enter, Floats& exit) {
    enter = 0.0f;
    exit = to;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a)
      CellCrossings<N, D>::clip(plane[a][0], plane[a][N], inverse[a], enter, exit);
  }
  /// Where several beams enter and leave each child, between two distances.
  template <class Floats>
  NDTREE_ALWAYS_INLINE static void crossings_of_children(const Planes& plane, const Floats* inverse,
                                                         const Floats& from, const Floats& to, Floats* enter,
                                                         Floats* exit) {
    enter[0] = from;
    exit[0] = to;
    std::size_t made = 1;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a, made *= N) {
      Floats at[kPlanes];
#pragma GCC unroll 8
      for (std::size_t i = 0; i < kPlanes; ++i) at[i] = unfused(plane[a][i] * inverse[a]);
#pragma GCC unroll 8
      for (std::size_t m = 0; m < N; ++m) {  // From the last slab: the first takes the place of its source.
        const std::size_t s = N - 1 - m;
        const Floats before = min_of(at[s], at[s + 1]);
        const Floats behind = max_of(at[s], at[s + 1]);
#pragma GCC unroll 16
        for (std::size_t c = 0; c < made; ++c) {
          enter[s * made + c] = max_of(enter[c], before);
          exit[s * made + c] = min_of(exit[c], behind);
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
    const auto edge = static_cast<double>(geometry_.edge(node.level - 1));
    const Vector<D>& origin = beams_.origin(0);
    Planes planes;
    for (std::size_t a = 0; a < D; ++a) {
      const auto lower = static_cast<double>(node.lower[a]);
      if (first > 0) planes[a][0] = -kNowhere;
      if (last < N) planes[a][N] = kNowhere;
      for (std::size_t i = first; i <= last; ++i)  // As plane_of(): coordinates are exact as doubles.
        planes[a][i] =
            static_cast<float>(unfused((lower + static_cast<double>(i) * edge) * geometry_.unit()) -
                               origin[static_cast<int>(a)]);
    }
    return planes;
  }
  /// Clips one beam against the children. @param plane_of `(axis, number)` planes minus its origin.
  template <class Visit, class PlaneOf>
  void clip_among_children(std::uint32_t beam, const Visit& visit, const PlaneOf& plane_of) const {
    const Crossing whole = CellCrossings<N, D>::clipped(
        beams_.ray(beam), [&](std::size_t a) { return plane_of(a, 0); },
        [&](std::size_t a) { return plane_of(a, N); });
    clip_among_children<D - 1>(beam, whole, 0, visit, plane_of);
  }
  /// Clips one beam against slabs of children, axis by axis.
  template <int Axis, class Visit, class PlaneOf>
  void clip_among_children(std::uint32_t beam, Crossing left, int child, const Visit& visit,
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
                           unfused(plane_of(Axis, static_cast<std::size_t>(up ? slab + 1 : slab)) * inverse));
        if (!(leave > left.enter)) continue;
        clip_among_children<Axis - 1>(beam, {left.enter, leave}, child * N + slab, visit, plane_of);
        left.enter = leave;
      }
    }
  }

  /// With four children, in 2-D, sixteen beams at a time are no faster than eight.
  static constexpr bool kHasSixteens = N == 2 && kNumChildren >= 8;
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void clip_packet(const Planes& planes, const EightFloats& from,
                                                         const EightFloats& to, Packet& packet) const {
    EightFloats enter[std::size_t{kNumChildren}];
    EightFloats exit[std::size_t{kNumChildren}];
    crossings_of_children(planes, packet.beams.rays.inverse, from, to, enter, exit);
#pragma GCC unroll 32
    for (std::size_t c = 0; c < kNumChildren; ++c) {
      enter[c].store(packet.enter[c].data());
      exit[c].store(packet.exit[c].data());
      packet.set[c] = (exit[c] > enter[c]).set();
      packet.passing[c] = packet.set[c] & (exit[c] < packet.beams.t_free).set();
    }
  }
  NDTREE_BY_EIGHTS void eight_at_a_time(const Planes& plane, const BeamList& list, Lists& children) const {
    add_to_lists<EightFloats>(plane, list, children);
  }
#endif
#ifdef NDTREE_HAS_SIXTEENS
  NDTREE_BY_SIXTEENS void sixteen_at_a_time(const Planes& plane, const BeamList& list,
                                            Lists& children) const {
    add_to_lists<SixteenFloats>(plane, list, children);
  }
#endif
#ifdef NDTREE_HAS_EIGHTS
  /// Appends beams to the lists of the children that they cross, several at a time.
  template <class Floats>
  NDTREE_ALWAYS_INLINE void add_to_lists(const Planes& plane, const BeamList& list, Lists& children) const {
    static_assert(BeamList::kSlack >= Floats::kWidth, "all of a vector is written, and read");
    // Copies, as stores through `to` might alias the members.
    const BeamList from = list;
    std::uint32_t* const to = children.memory.beam;
    const BeamRay<D>* const rows = beams_.rays();
    std::array<std::size_t, std::size_t{kNumChildren}> last = children.last;
    for (std::size_t i = 0; i < from.size; i += Floats::kWidth) {
      const auto live = Floats::Mask::first(from.size - i);
      const auto beam = Floats::Ints::load(from.beam + i);
      Floats ray[ScanBeams<D>::kColumnsOfRay];
      load_columns_once(rows, from.beam + i, ray);
      Floats enter[std::size_t{kNumChildren}];
      Floats exit[std::size_t{kNumChildren}];
      crossings_of_children<Floats>(plane, ray, 0.0f, ray[D] & live, enter, exit);
#pragma GCC unroll 32
      for (std::size_t c = 0; c < kNumChildren; ++c)
        last[c] += store_packed(beam, exit[c] > enter[c], to + last[c]);
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
