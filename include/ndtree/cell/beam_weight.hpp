// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Weighing evidence: what one beam is worth to one cell.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/rounded.hpp"
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

/// A beam's evidence for a cell near its end point is the inverse sensor model's log-odds L that the cell is
/// occupied. It is added to one of the cell's two sums, in whole units so that the order of beams does not
/// matter:
///   L > 0:  E+ += w L,   w the probability that the surface is in the cell in which it was measured;
///   L < 0:  E- += -L.
/// For a cell u standard deviations wide, averaged over where in the cell the surface may be,
///   w = erf(u / sqrt 2) - sqrt(2 / pi) (1 - exp(-u^2 / 2)) / u:   0.54 at u = 5/3, 0.84 at u = 5.
/// Where noise spreads the hits of one wall over several cells, fewer of them then become occupied.
struct BeamWeight {
  /// @param nats the inverse sensor model's log-odds that the cell is occupied, |nats| < 1e6.
  /// @param inside probability_inside() of the cell.
  static void add(ScanEvidence& sum, float nats, float inside) {
    constexpr auto kUnitsPerNat = static_cast<float>(1.0 / EvidenceCell::kUnit);
    const float weight = nats > 0.0f ? inside : 1.0f;
    const std::int64_t units = nearest_integer(weight * nats * kUnitsPerNat);
    sum.occupied += std::max<std::int64_t>(units, 0);
    sum.free -= std::min<std::int64_t>(units, 0);
  }

#ifdef NDTREE_HAS_EIGHTS
  /// What add() adds for eight beams, to the last bit: to E+ if > 0, else its negative to E-.
  NDTREE_BY_EIGHTS [[nodiscard]] static NDTREE_ALWAYS_INLINE __m256i units_of(__m256 nats, __m256 inside) {
    constexpr auto kUnitsPerNat = static_cast<float>(1.0 / EvidenceCell::kUnit);
    const __m256 is_for = _mm256_cmp_ps(nats, _mm256_setzero_ps(), _CMP_GT_OQ);
    const __m256 weight = _mm256_blendv_ps(_mm256_set1_ps(1.0f), inside, is_for);
    return _mm256_cvtps_epi32(_mm256_mul_ps(_mm256_mul_ps(weight, nats), _mm256_set1_ps(kUnitsPerNat)));
  }
#endif

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
