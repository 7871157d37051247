// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Weighing evidence: what one beam is worth to one cell.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Mean length of the chords that random straight lines cut out of a unit cube of this dimension: for a
/// convex body of volume V and surface S it is D (k_D / k_(D-1)) V / S, k_D being the volume of the unit ball
/// (Cauchy). Pi / 4 in 2-D, 2 / 3 in 3-D. A beam that passes a cell on a way of this length is one miss.
[[nodiscard]] constexpr double mean_chord_of_unit_cube(int dim) {
  constexpr double kPi = 3.14159265358979323846;
  const auto unit_ball = [](int n) {
    double volume = n % 2 == 0 ? 1.0 : 2.0;
    for (int i = n % 2 == 0 ? 2 : 3; i <= n; i += 2) volume *= 2.0 * kPi / i;
    return volume;
  };
  return unit_ball(dim) / (2.0 * unit_ball(dim - 1));
}

/// How many smallest cells before a border the beams of a flat surface parallel to it pass for each cell in
/// which one ends. With the angle of incidence theta, and the surface o cells before the border, a beam goes
/// (1 - o) tan(theta) cells along the row before it ends. A hit in a smallest cell is worth about a miss:
/// above 1, the row is called free.
/// @param slant 1 / cos(theta). @param behind way from the end point to the border [smallest cells], o slant.
[[nodiscard]] inline float cells_passed_per_end(float slant, float behind) {
  const float cosine = 1.0f / slant;
  return std::sqrt(std::max(0.0f, 1.0f - unfused(cosine * cosine))) * (slant - behind);
}

/// A beam's evidence for a cell near its end point is the inverse sensor model's log-odds L that the cell is
/// occupied. It is added to one of the cell's two sums, in whole units so that the order of beams does not
/// matter:
///   L > 0:  E+ += w L,   w the probability that the surface is in the cell in which it was measured;
///   L < 0:  E- += -L.
/// For a cell u standard deviations wide, averaged over where in the cell the surface may be,
///   w = erf(u / sqrt 2) - sqrt(2 / pi) (1 - exp(-u^2 / 2)) / u:   0.54 at u = 5/3, 0.84 at u = 5.
/// Where noise spreads the hits of one wall over several cells, fewer of them then become occupied.
struct BeamWeight {
  /// The units of one beam or eight: added to E+ if > 0, else their negative to E-.
  /// @param nats the inverse sensor model's log-odds that the cell is occupied, |nats| < 1e6.
  /// @param inside probability_inside() of the cell.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static auto units_of(const Floats& nats, const Floats& inside) {
    constexpr auto kUnitsPerNat = static_cast<float>(1.0 / EvidenceCell::kUnit);
    const Floats weight = select(nats > 0.0f, inside, Floats(1.0f));
    return nearest_integer(Floats(weight * nats * kUnitsPerNat));
  }
  /// Adds those of one beam.
  static void add(ScanEvidence& sum, std::int64_t units) {
    sum.occupied += std::max<std::int64_t>(units, 0);
    sum.free -= std::min<std::int64_t>(units, 0);
  }

  /// The part of a wide beam's cross-section that a cell covers, which a hit in the cell is worth: the
  /// surface lies somewhere across the beam. @param width of the beam at its end point [m]; if 0, the part
  /// is 1.
  template <int D, class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats covered_part(float cell, const Floats& width) {
    const Floats on_axis = min_of(cell / width, 1.0f);
    Floats part = 1.0f;
    for (int a = 1; a < D; ++a) part = part * on_axis;
    return part;
  }
  /// The weight w of a hit in a cell u > 0 standard deviations wide.
  [[nodiscard]] static double probability_inside(double u) {
    constexpr double kSqrtHalf = 0.70710678118654752;
    constexpr double kSqrt2OverPi = 0.79788456080286536;
    return std::erf(u * kSqrtHalf) - kSqrt2OverPi * (1.0 - std::exp(-0.5 * u * u)) / u;
  }

  /// probability_inside() of cells at least one standard deviation wide, by 1 / u, within 1e-5.
  [[nodiscard]] static const CubicTable& probability_inside_table() {
    static const CubicTable table(
        1.0, [](double sigmas) { return sigmas == 0.0 ? 1.0 : probability_inside(1.0 / sigmas); });
    return table;
  }
};

}  // namespace ndtree
