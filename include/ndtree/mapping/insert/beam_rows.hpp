// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The two table rows of a beam, and the rows of eight beams in vectors.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/lanes.hpp"

namespace ndtree {

/// The row that partitioning a list reads: a beam's inverse direction and t_max. 16 bytes up to 3-D.
template <int D>
struct alignas(16) BeamRay {
  /// Range over displacement on each axis: metres along the beam for one metre along the axis.
  std::array<float, std::size_t{D}> inverse;
  float t_max;  ///< The distance at which its evidence ends [m].
};

/// The row that leaves near a beam's end read; distances are along the beam [m]. A row of 32 bytes lies in
/// one cache line.
///
/// A cell that the beam leaves before clearly_free_until, see BeamSensorModel, is clearly free: the beam is a
/// miss of it, and no more. The exit of a cell that is small beside the noise counts as at least `surface`
/// behind its entry. So cells of any size are clearly free that the beam leaves before t_free =
/// clearly_free_until - surface: it clearly passes them.
template <int D>
struct alignas(D <= 3 ? 32 : 16) BeamEnd {
  float range;               ///< Of the end point, or t_free of a beam without return.
  float slant;               ///< Depth over range, in [1 / sqrt D, 1].
  float clearly_free_until;  ///< See above.
  float surface;  ///< Its way through a small cell counts as at least this long. 0: without return.
  float sigma;    ///< Standard deviation of the range.
  /// Smallest cell of its end minus the base, see ScanBeams::ends_fit_32_bits().
  std::array<std::int32_t, std::size_t{D}> cell;

  [[nodiscard]] bool is_returned() const { return surface != 0.0f; }
};

#ifdef NDTREE_HAS_EIGHTS
/// The columns of eight BeamRay rows.
template <int D>
struct EightRays {
  EightFloats inverse[std::size_t{D}];
  EightFloats t_max;
};
/// The columns of eight BeamEnd rows.
template <int D>
struct EightEnds {
  EightFloats range, slant, clearly_free_until, surface, sigma;
  EightInts cell[std::size_t{D}];
};

/// A ray packet: up to eight beams that go down the tree together. Their rows are read once, at its start.
template <int D>
struct EightBeams {
  /// Ascending; elements without a beam hold any valid number.
  alignas(32) std::array<std::uint32_t, 8> number;
  EightRays<D> rays;
  EightFloats t_free;  ///< See ScanBeams::t_free_of().
  EightEnds<D> ends;   ///< Valid if has_ends; ScanBeams::ends_of() reads them.
  bool has_ends = false;
};
#endif

}  // namespace ndtree
