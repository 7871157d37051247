// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How probable it is that points returned from what moves, by the cells of a map alone.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <type_traits>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// How far a surface may be from a point that it returned, and from which probability on a cell may hold
/// something thinner than it, see SplitOptions::partial_probability.
struct MovedMargin {
  double reach;  ///< [m].
  float thin;

  /// Half a smallest cell, since a surface is somewhere in its cell, and the noise of a range.
  template <class Options>
  [[nodiscard]] static MovedMargin of(const Options& options) {
    constexpr double kNoiseSigmas = 3.0;  // One of 370 ranges is farther off.
    constexpr double kRounding = 1e-4;    // Of a cell's log-odds.
    const double thin = options.partial_probability > 0.0 ? options.partial_probability : 0.5;
    return {0.5 * options.min_cell_size + kNoiseSigmas * options.range_sigma,
            static_cast<float>(thin - kRounding)};
  }
};

/// The probability that a point's own cell is occupied, as probability_moved() takes it: at least 0.5 while a
/// cell with evidence remembers a beam that ended in it. Most beams pass a rod's cell, and a larger cell that
/// is free holds rods and edges; counts do not tell these from what left, until the cell has changed.
template <class Cell>
[[nodiscard]] float probability_standing(const Cell& cell) {
  const auto probability = static_cast<float>(cell.probability());
  if constexpr (std::is_same_v<Cell, EvidenceCell>)
    if (cell.hits() > 0) return std::max(probability, 0.5F);
  return probability;
}

/// That what returned at points is not part of what stands: one minus the probability that the point's cell
/// is occupied, or a cell beside it, where that is more. Beside it are the cells at a distance of `reach` and
/// of half of it along each axis, both ways. Of what is unknown, and of a cell that may hold something thin,
/// nothing can be said, whatever is beside it: 0.5. O(n).
/// @param points D numbers each [m].
/// @param standing_at called as (points, n, out): writes probability_standing() of each.
/// @param probability_at likewise: writes the probability that each is occupied.
template <int D, class StandingAt, class ProbabilityAt>
void probability_moved(const double* points, std::size_t n, const MovedMargin& margin,
                       const StandingAt& standing_at, const ProbabilityAt& probability_at, float* out) {
  constexpr std::size_t kAtOnce = 4096;
  constexpr std::size_t kDim = D;
  std::vector<double> beside;
  std::vector<std::size_t> free;
  std::vector<float> there;
  for (std::size_t first = 0; first < n; first += kAtOnce) {
    checkpoint();
    const std::size_t count = std::min(kAtOnce, n - first);
    const double* const here = points + first * kDim;
    float* const results = out + first;
    standing_at(here, count, results);
    free.clear();
    for (std::size_t i = 0; i < count; ++i) {
      if (results[i] < margin.thin) {
        free.push_back(i);
      } else {
        results[i] = std::max(results[i], 0.5F);
      }
    }
    beside.resize(free.size() * kDim);
    there.resize(free.size());
    for (std::size_t axis = 0; axis < kDim; ++axis)
      for (const double step : {-margin.reach, -0.5 * margin.reach, 0.5 * margin.reach, margin.reach}) {
        for (std::size_t i = 0; i < free.size(); ++i) {
          std::copy_n(here + free[i] * kDim, kDim, beside.data() + i * kDim);
          beside[i * kDim + axis] += step;
        }
        probability_at(beside.data(), free.size(), there.data());
        for (std::size_t i = 0; i < free.size(); ++i) results[free[i]] = std::max(results[free[i]], there[i]);
      }
    for (std::size_t i = 0; i < count; ++i) results[i] = 1.0F - results[i];
  }
}

/// Probability that the end point of each beam of a scan moved; 0.5 for beams that do not return within
/// `max_range`.
template <int D, class StandingAt, class ProbabilityAt>
std::vector<float> probability_moved(const ScanView<D>& scan, double max_range, const MovedMargin& margin,
                                     const StandingAt& standing_at, const ProbabilityAt& probability_at) {
  std::vector<double> points;
  std::vector<std::size_t> beams;
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned) continue;
    beams.push_back(static_cast<std::size_t>(i));
    points.insert(points.end(), beam.endpoint.data(), beam.endpoint.data() + D);
  }
  std::vector<float> of_returned(beams.size());
  probability_moved<D>(points.data(), beams.size(), margin, standing_at, probability_at, of_returned.data());
  std::vector<float> moved(static_cast<std::size_t>(scan.size), 0.5F);
  for (std::size_t i = 0; i < beams.size(); ++i) moved[beams[i]] = of_returned[i];
  return moved;
}

}  // namespace ndtree
