// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where beams cross a cell, or the children of a node.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/scan/beams.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Where a beam enters a cell, and where it leaves it; distances from the origin [m].
struct Crossing {
  float enter;
  float exit;
};

/// The planes that bound a node and its children on each axis, from one origin [m].
template <int N, int D>
using NodePlanes = std::array<std::array<float, std::size_t{N} + 1>, std::size_t{D}>;

/// Where beams cross one cell. A beam crosses the plane at p, on an axis, at (p - origin) * inverse: two
/// roundings to float, of a number that depends on the plane and the beam alone, and grows from plane to
/// plane along the beam. So cells share their borders to the last bit, and what a beam crosses of a node is
/// the sum of what it crosses of the children, without gap or overlap. The cell must stay where it is.
template <int N, int D>
class CellCrossings {
 public:
  NDTREE_ALWAYS_INLINE CellCrossings(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams,
                                     const CellIndex<D>& cell)
      : geometry_(geometry), beams_(beams), cell_(cell) {
    for (std::size_t a = 0; a < D; ++a) plane_[a] = planes(a, beams.origin(0));
  }
  /// The same of a node's child. @param planes of the node, from the one origin of all beams, if there is
  /// one.
  NDTREE_ALWAYS_INLINE CellCrossings(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams,
                                     const CellIndex<D>& cell, const NodePlanes<N, D>& planes, int child)
      : geometry_(geometry), beams_(beams), cell_(cell) {
    auto left = static_cast<unsigned>(child);
    for (std::size_t a = 0; a < D; ++a, left /= N) plane_[a] = {planes[a][left % N], planes[a][left % N + 1]};
  }

  /// @returns an interval that is empty, or has its ends turned, where the beam does not cross the cell.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Crossing of(std::uint32_t beam) const {
    const BeamWay<D>& way = beams_.way(beam);
    Crossing result{0.0f, way.reach};
    for (std::size_t a = 0; a < D; ++a) {
      const Planes plane = beams_.has_own_origins() ? planes(a, beams_.origin(beam)) : plane_[a];
      const float lower = plane.lower * way.inverse[a];
      const float upper = plane.upper * way.inverse[a];
      result.enter = std::max(result.enter, std::min(lower, upper));
      result.exit = std::min(result.exit, std::max(lower, upper));
    }
    return result;
  }
#ifdef NDTREE_HAS_EIGHTS
  /// The same of eight. @param ways of these beams.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void of(__m256i beams, const EightWays<D>& ways, __m256& enter,
                                                __m256& exit) const {
    if (beams_.has_own_origins()) return of_each(beams, enter, exit);
    enter = _mm256_setzero_ps();
    exit = ways.reach;
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a) {
      const __m256 lower = _mm256_mul_ps(_mm256_set1_ps(plane_[a].lower), ways.inverse[a]);
      const __m256 upper = _mm256_mul_ps(_mm256_set1_ps(plane_[a].upper), ways.inverse[a]);
      enter = _mm256_max_ps(enter, _mm256_min_ps(lower, upper));
      exit = _mm256_min_ps(exit, _mm256_max_ps(lower, upper));
    }
  }
#endif

 private:
  /// Of a cell on one axis, from an origin [m].
  struct Planes {
    float lower;
    float upper;
  };
  [[nodiscard]] NDTREE_ALWAYS_INLINE Planes planes(std::size_t axis, const Vector<D>& origin) const {
    const double from = origin[static_cast<int>(axis)];
    const std::int64_t lower = cell_.lower[axis];
    const std::int64_t upper = lower + geometry_.edge(cell_.level);
    return {static_cast<float>(geometry_.border(lower) - from),
            static_cast<float>(geometry_.border(upper) - from)};
  }
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void of_each(__m256i beams, __m256& enter, __m256& exit) const {
    alignas(32) std::array<std::uint32_t, 8> number;
    alignas(32) std::array<float, 8> from;
    alignas(32) std::array<float, 8> to;
    _mm256_store_si256(reinterpret_cast<__m256i*>(number.data()), beams);
    for (std::size_t i = 0; i < 8; ++i) {
      const Crossing crossing = of(number[i]);
      from[i] = crossing.enter;
      to[i] = crossing.exit;
    }
    enter = _mm256_load_ps(from.data());
    exit = _mm256_load_ps(to.data());
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const CellIndex<D>& cell_;
  std::array<Planes, std::size_t{D}> plane_;  // From the one origin of all beams, if there is one.
};

/// So few beams fit one vector, and are not worth telling apart by what cells below take.
inline constexpr std::size_t kFewBeams = 8;

#ifdef NDTREE_HAS_EIGHTS
/// Where at most eight beams cross the children of a node: so few need no lists. Those that cross a child are
/// a set of bits, of their places among the eight.
template <int D, int kCount>
struct FewCrossings {
  static constexpr std::size_t kMost = kFewBeams;
  explicit FewCrossings(EightBeams<D>& them) : beams(them) {}  // The rest is not initialised.

  EightBeams<D>& beams;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> enter;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> exit;
  std::array<std::uint32_t, std::size_t{kCount}> set;      ///< Those that cross each child, and of these
  std::array<std::uint32_t, std::size_t{kCount}> passing;  ///< those that clearly pass it.

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

/// Those of few beams that cross one child.
template <int D, int kCount>
struct FewOfChild {
  const FewCrossings<D, kCount>& of;
  std::size_t child;

  [[nodiscard]] std::uint32_t set() const { return of.set[child]; }
  [[nodiscard]] bool all_pass() const { return of.passing[child] == of.set[child]; }
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(__builtin_popcount(set())); }
  [[nodiscard]] std::uint32_t first_beam() const { return of.first_of(set()); }
  [[nodiscard]] std::uint32_t last_beam() const { return of.last_of(set()); }
  [[nodiscard]] bool is_one() const { return (set() & (set() - 1)) == 0; }
  [[nodiscard]] Crossing crossing_of_first() const {
    const auto place = static_cast<std::size_t>(__builtin_ctz(set()));
    return {of.enter[child][place], of.exit[child][place]};
  }
};

/// Where one beam crosses the children of a node, by their numbers; those that it crosses are a set of bits.
struct LoneCrossing {
  static constexpr std::size_t kMostChildren = 8;
  alignas(32) std::array<float, kMostChildren> enter;
  alignas(32) std::array<float, kMostChildren> exit;
  std::uint32_t set;
};
#endif

}  // namespace ndtree
