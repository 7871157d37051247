// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where beams cross a cell, or the children of a node.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/scan/packed_beams.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Where a beam enters a cell, and where it leaves it; distances from the origin [m].
struct Crossing {
  float enter;
  float exit;
};

#ifdef NDTREE_HAS_EIGHTS
/// The same of eight beams.
struct EightCrossings {
  __m256 enter;
  __m256 exit;
  __m256 t_free;  ///< ScanBeams::t_free_of() them.
};
#endif

/// Where beams cross one cell. A beam crosses the plane at p, on an axis, at (p - origin) * inverse: two
/// roundings to float, of a number that depends on the plane and the beam alone, and grows from plane to
/// plane along the beam. So cells share their borders to the last bit, and what a beam crosses of a node is
/// the sum of what it crosses of the children, without gap or overlap. The cell must stay where it is.
template <int N, int D>
class CellCrossings {
 public:
  /// The planes of a node, and between its children, on each axis, from the one origin of all beams [m].
  using Planes = std::array<std::array<float, std::size_t{N} + 1>, std::size_t{D}>;

  /// Where a plane lies, seen from an origin. @param coordinate of it on the lattice.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static float plane(const LatticeGeometry<N, D>& geometry,
                                                        std::int64_t coordinate, double origin) {
    return static_cast<float>(geometry.border(coordinate) - origin);
  }
  /// What is left of a beam's way between two planes on each axis: where it enters and leaves a cell. Empty,
  /// or with its ends turned, if it does not cross the cell.
  /// @param lower, upper `(axis)` planes from its origin.
  template <class Lower, class Upper>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Crossing clipped(const BeamRay<D>& ray, const Lower& lower,
                                                             const Upper& upper) {
    Crossing result{0.0f, ray.t_max};
    for (std::size_t a = 0; a < D; ++a) {
      const float at_lower = rounded(lower(a) * ray.inverse[a]);
      const float at_upper = rounded(upper(a) * ray.inverse[a]);
      result.enter = std::max(result.enter, std::min(at_lower, at_upper));
      result.exit = std::min(result.exit, std::max(at_lower, at_upper));
    }
    return result;
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
  /// The same of a node's child. @param planes of the node, if all beams have one origin.
  NDTREE_ALWAYS_INLINE CellCrossings(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams,
                                     const CellIndex<D>& cell, const Planes& planes, int child)
      : geometry_(geometry), beams_(beams), cell_(cell) {
    auto left = static_cast<unsigned>(child);
    for (std::size_t a = 0; a < D; ++a, left /= N) {
      lower_[a] = planes[a][left % N];
      upper_[a] = planes[a][left % N + 1];
    }
  }

  /// See clipped().
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
#ifdef NDTREE_HAS_EIGHTS
  /// The same of eight. @param ways of these beams. @tparam kAlike ScanBeams::are_alike(): loops are
  /// compiled for both, as the call that others need costs registers.
  template <bool kAlike>
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE EightCrossings
  of([[maybe_unused]] const std::uint32_t* beams, const EightRays<D>& rays) const {
    if constexpr (!kAlike)
      if (beams_.has_own_origins()) return of_each(beams, rays.t_max);
    EightCrossings result{_mm256_setzero_ps(), rays.t_max,
                          kAlike ? beams_.t_free_of(rays.t_max) : beams_.t_free_of(beams, rays.t_max)};
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a) {
      const __m256 at_lower = _mm256_mul_ps(_mm256_set1_ps(lower_[a]), rays.inverse[a]);
      const __m256 at_upper = _mm256_mul_ps(_mm256_set1_ps(upper_[a]), rays.inverse[a]);
      result.enter = _mm256_max_ps(result.enter, _mm256_min_ps(at_lower, at_upper));
      result.exit = _mm256_min_ps(result.exit, _mm256_max_ps(at_lower, at_upper));
    }
    return result;
  }
#endif

 private:
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_NEVER_INLINE EightCrossings of_each(const std::uint32_t* beams,
                                                                            __m256 reach) const {
    alignas(32) std::array<float, 8> enter;
    alignas(32) std::array<float, 8> exit;
    for (std::size_t i = 0; i < 8; ++i) {
      const Crossing crossing = of(beams[i]);
      enter[i] = crossing.enter;
      exit[i] = crossing.exit;
    }
    return {_mm256_load_ps(enter.data()), _mm256_load_ps(exit.data()), beams_.t_free_of(beams, reach)};
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const CellIndex<D>& cell_;
  // Planes of the cell, from the one origin of all beams:
  std::array<float, std::size_t{D}> lower_;
  std::array<float, std::size_t{D}> upper_;
};

/// So few beams fit one vector, and are not worth telling apart by what cells below take.
inline constexpr std::size_t kPacketSize = 8;

#ifdef NDTREE_HAS_EIGHTS
/// Where at most eight beams cross the children of a node: so few need no lists. Those that cross a child are
/// a set of bits, of their places among the eight.
template <int D, int kCount>
struct RayPacket {
  static constexpr std::size_t kMost = kPacketSize;
  explicit RayPacket(EightBeams<D>& them) : beams(them) {}  // The rest is not initialised.

  EightBeams<D>& beams;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> enter;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> exit;
  std::array<std::uint32_t, std::size_t{kCount}> set;      ///< Those that cross each child, and of these
  std::array<std::uint32_t, std::size_t{kCount}> passing;  ///< those that clearly pass it.
  // What those that cross each child say as misses, if it was asked for: see LeafEvidence::passed().
  bool has_passed = false;
  std::array<std::uint32_t, std::size_t{kCount + 3}> free;  ///< Evidence for free space.
  std::uint32_t resolvable;                                 ///< The set of those with little noise.

  // Of a set of beams that is not empty:
  [[nodiscard]] std::uint32_t first_of(std::uint32_t set_of_beams) const {
    return beams.number[static_cast<std::size_t>(__builtin_ctz(set_of_beams))];
  }
  [[nodiscard]] std::uint32_t last_of(std::uint32_t set_of_beams) const {
    return beams.number[static_cast<std::size_t>(31 - __builtin_clz(set_of_beams))];
  }
  /// Of all, the set of those with smaller numbers than this.
  NDTREE_BY_EIGHTS [[nodiscard]] std::uint32_t before(std::uint32_t number) const {
    const __m256i numbers = _mm256_load_si256(reinterpret_cast<const __m256i*>(beams.number.data()));
    const __m256i larger = _mm256_max_epu32(numbers, _mm256_set1_epi32(static_cast<int>(number)));
    return ~static_cast<std::uint32_t>(
        _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(larger, numbers))));
  }
};
#endif

}  // namespace ndtree
