// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where beams cross a cell, or the children of a node.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Distances from the origin at which a beam enters and leaves a cell [m].
struct Crossing {
  float enter;
  float exit;
};

#ifdef NDTREE_HAS_EIGHTS
/// Crossings of eight beams.
struct EightCrossings {
  EightFloats enter;
  EightFloats exit;
  EightFloats t_free;  ///< ScanBeams::t_free_of() them.
};
#endif

/// Where beams cross one cell, by the slab test. A beam crosses the plane at p, on an axis, at the distance
/// (p - origin) * inverse direction: rounded twice to float, a function of plane and beam alone that grows
/// from plane to plane along the beam. So neighbouring cells have equal borders to the last bit, and the
/// length of a beam in a node is the sum of its lengths in the children, without gap or overlap. O(D) for
/// each beam. The cell must stay where it is.
template <int N, int D>
class CellCrossings {
 public:
  /// The N + 1 planes of a node, and between its children, on each axis, from the one origin of all beams
  /// [m].
  using Planes = std::array<std::array<float, std::max<std::size_t>(N + 1, 4)>, std::size_t{D}>;

  /// Position of a plane minus an origin [m]. @param coordinate of the plane on the lattice.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static float plane(const LatticeGeometry<N, D>& geometry,
                                                        std::int64_t coordinate, double origin) {
    return static_cast<float>(geometry.border(coordinate) - origin);
  }
  /// Clips a beam between two planes on each axis. Entry is not before exit if the beam does not cross the
  /// cell.
  /// @param lower, upper `(axis)` planes from its origin.
  template <class Lower, class Upper>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Crossing clipped(const BeamRay<D>& ray, const Lower& lower,
                                                             const Upper& upper) {
    Crossing result{0.0f, ray.t_max};
    for (std::size_t a = 0; a < D; ++a) clip(lower(a), upper(a), ray.inverse[a], result.enter, result.exit);
    return result;
  }
  /// The slab test on one axis, of one beam or several.
  template <class Floats>
  NDTREE_ALWAYS_INLINE static void clip(float lower, float upper, const Floats& inverse, Floats& enter,
                                        Floats& exit) {
    const Floats at_lower = unfused(lower * inverse);
    const Floats at_upper = unfused(upper * inverse);
    enter = max_of(enter, min_of(at_lower, at_upper));
    exit = min_of(exit, max_of(at_lower, at_upper));
  }

  NDTREE_ALWAYS_INLINE CellCrossings(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams,
                                     const CellIndex<D>& cell)
      : geometry_(geometry), beams_(beams), cell_(cell) {
    const std::int64_t edge = geometry.edge(cell.level);
    for (std::size_t a = 0; a < D; ++a) {
      const double origin = beams.origin(0)[static_cast<int>(a)];
      lower_[a] = plane(geometry, cell.lower[a], origin);
      upper_[a] = plane(geometry, cell.lower[a] + edge, origin);
    }
  }
  /// For a node's child. @param planes of the node, if all beams have one origin.
  NDTREE_ALWAYS_INLINE CellCrossings(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams,
                                     const CellIndex<D>& cell, const Planes& planes, int child)
      : geometry_(geometry), beams_(beams), cell_(cell) {
    auto left = static_cast<unsigned>(child);
    for (std::size_t a = 0; a < D; ++a, left /= N) {
      lower_[a] = planes[a][left % N];
      upper_[a] = planes[a][left % N + 1];
    }
  }

  /// The crossing of one beam, see clipped().
  [[nodiscard]] NDTREE_ALWAYS_INLINE Crossing of(std::uint32_t beam) const {
    if (beams_.has_own_origins()) {
      const Vector<D>& origin = beams_.origin(beam);
      const auto seen = [&](std::size_t a, std::int64_t edge) {
        return plane(geometry_, cell_.lower[a] + edge, origin[static_cast<int>(a)]);
      };
      return clipped(
          beams_.ray(beam), [&](std::size_t a) { return seen(a, 0); },
          [&](std::size_t a) { return seen(a, geometry_.edge(cell_.level)); });
    }
    return clipped(
        beams_.ray(beam), [&](std::size_t a) { return lower_[a]; }, [&](std::size_t a) { return upper_[a]; });
  }
  /// The beam's way for one metre across the border through which it enters: 1 / cosine of its angle of
  /// incidence. Through an edge or a corner, of the border that it meets at the most grazing angle.
  [[nodiscard]] float slant_at_entry(std::uint32_t beam) const {
    const BeamRay<D>& ray = beams_.ray(beam);
    const Vector<D>& origin = beams_.origin(beam);
    const std::int64_t edge = geometry_.edge(cell_.level);
    float enter = 0.0f;
    float slant = 1.0f;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t border = cell_.lower[a] + (ray.inverse[a] < 0.0f ? edge : 0);
      const float at = plane(geometry_, border, origin[static_cast<int>(a)]) * ray.inverse[a];
      if (at < enter) continue;
      slant = at > enter ? std::abs(ray.inverse[a]) : std::max(slant, std::abs(ray.inverse[a]));
      enter = at;
    }
    return slant;
  }
#ifdef NDTREE_HAS_EIGHTS
  /// The crossings of eight beams. @param rays of these beams. @tparam kAlike ScanBeams::are_alike(): loops
  /// are compiled for both values, as the call that beams with own origins need costs registers.
  template <bool kAlike>
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE EightCrossings
  of([[maybe_unused]] const std::uint32_t* beams, const EightRays<D>& rays) const {
    if constexpr (!kAlike)
      if (beams_.has_own_origins()) return of_each(beams, rays.t_max);
    EightCrossings result{0.0f, rays.t_max,
                          kAlike ? beams_.t_free_at(rays.t_max) : beams_.t_free_of(beams, rays.t_max)};
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a)
      clip(lower_[a], upper_[a], rays.inverse[a], result.enter, result.exit);
    return result;
  }
#endif

 private:
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_NEVER_INLINE EightCrossings of_each(const std::uint32_t* beams,
                                                                            const EightFloats& t_max) const {
    std::array<float, 8> enter;
    std::array<float, 8> exit;
    for (std::size_t i = 0; i < 8; ++i) {
      const Crossing crossing = of(beams[i]);
      enter[i] = crossing.enter;
      exit[i] = crossing.exit;
    }
    return {EightFloats::load(enter.data()), EightFloats::load(exit.data()), beams_.t_free_of(beams, t_max)};
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const CellIndex<D>& cell_;
  // Planes of the cell, from the one origin of all beams:
  std::array<float, std::size_t{D}> lower_;
  std::array<float, std::size_t{D}> upper_;
};

/// Largest size of a ray packet. Lists of at most as many beams are not subsampled on the way down.
inline constexpr std::size_t kPacketSize = 8;

#ifdef NDTREE_HAS_EIGHTS
/// A ray packet: where at most eight beams cross the children of a node. Sets of rays are bits, one for each
/// lane.
template <int D, int kCount>
struct RayPacket {
  static constexpr std::size_t kMost = kPacketSize;
  explicit RayPacket(EightBeams<D>& them) : beams(them) {}  // The rest is not initialised.

  EightBeams<D>& beams;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> enter;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> exit;
  std::array<std::uint32_t, std::size_t{kCount}> set;      ///< Rays that cross child c.
  std::array<std::uint32_t, std::size_t{kCount}> passing;  ///< Rays that clearly pass child c.
  // For children that all their rays clearly pass, see LeafEvidence::passed():
  bool has_passed = false;                                  ///< The next two are valid.
  std::array<std::uint32_t, std::size_t{kCount + 3}> free;  ///< Evidence of set[c] if all are misses.
  std::uint32_t resolvable;                                 ///< Rays whose misses are resolvable.

  // Of a set of beams that is not empty:
  [[nodiscard]] std::uint32_t first_of(std::uint32_t set_of_beams) const {
    return beams.number[static_cast<std::size_t>(__builtin_ctz(set_of_beams))];
  }
  [[nodiscard]] std::uint32_t last_of(std::uint32_t set_of_beams) const {
    return beams.number[static_cast<std::size_t>(31 - __builtin_clz(set_of_beams))];
  }
  /// Of all, the set of those with smaller numbers than this.
  NDTREE_BY_EIGHTS [[nodiscard]] std::uint32_t before(std::uint32_t number) const {
    const EightInts numbers = EightInts::load(beams.number.data());
    return ~(unsigned_max_of(numbers, static_cast<std::int32_t>(number)) == numbers).set();
  }
};
#endif

}  // namespace ndtree
