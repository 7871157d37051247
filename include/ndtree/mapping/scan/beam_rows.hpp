// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What nodes and leaves ask of a beam: two rows of a table, and the same of eight beams.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Where a beam goes: what handing it down asks.
template <int D>
struct alignas(16) BeamRay {
  /// Range over displacement on an axis: how far it goes for a metre along it.
  std::array<float, std::size_t{D}> inverse;
  float t_max;  ///< The last distance that it says anything about [m].
};

/// What cells near its end ask of it, in metres along it. Rows of 32 bytes lie in one cache line each.
template <int D>
struct alignas(D <= 3 ? 32 : 16) BeamEnd {
  float range;    ///< Of the end point, or of the end of what was seen free.
  float slant;    ///< How much of its way it goes along the axis of its face, in [1 / sqrt D, 1].
  float clear;    ///< Cells that end before this distance were passed ...
  float surface;  ///< ... small ones only if they end by so much before it. 0: without return.
  float sigma;    ///< Standard deviation of the range.
  std::array<std::int32_t, std::size_t{D}> cell;  ///< That it ends in, from the base; see ends_nearby().

  [[nodiscard]] bool is_returned() const { return surface != 0.0f; }
};

#ifdef NDTREE_HAS_EIGHTS
/// The same of eight beams.
template <int D>
struct EightRays {
  __m256 inverse[std::size_t{D}];
  __m256 t_max;
};
template <int D>
struct EightEnds {
  __m256 range, slant, clear, surface, sigma;
  __m256i cell[std::size_t{D}];
};

/// Up to eight beams on their way down to the leaves together: what is known of them is looked up once.
template <int D>
struct EightBeams {
  alignas(32) std::array<std::uint32_t, 8> number;  ///< Ascending, where a beam is.
  EightRays<D> rays;
  __m256 t_free;      ///< ScanBeams::t_free_of() of them.
  EightEnds<D> ends;  ///< If they were asked for, see ScanBeams::ends_of().
  bool has_ends = false;
};
#endif

}  // namespace ndtree
