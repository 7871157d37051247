// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How probable it is that points returned from what moves, by the cells of a map alone.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
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

  /// A smallest cell, since what stands takes the cells of its surface, and the noise of a range.
  template <class Options>
  [[nodiscard]] static MovedMargin of(const Options& options) {
    constexpr double kNoiseSigmas = 3.0;  // One of 370 ranges is farther off.
    constexpr double kRounding = 1e-4;    // Of a cell's log-odds.
    const double thin = options.partial_probability > 0.0 ? options.partial_probability : 0.5;
    return {options.min_cell_size + kNoiseSigmas * options.range_sigma, static_cast<float>(thin - kRounding)};
  }
};

/// Of what nothing can be said.
inline constexpr float kMovedUnknown = 0.5F;

/// Scans in a row whose beams all passed a cell; 0 of one that does not count them.
template <class Cell>
[[nodiscard]] std::uint32_t passing_scans(const Cell& cell) {
  if constexpr (std::is_same_v<Cell, EvidenceCell>) return cell.streak_is_of_hits() ? 0 : cell.streak();
  return 0;
}
/// The probability that a point's own cell is occupied, as probability_moved() takes it: just below 0.5 at
/// least while a cell with evidence remembers a beam that ended in it. Most beams pass a rod's cell, and a
/// larger cell that is free holds rods and edges; counts do not tell these from what left, until the cell has
/// changed. 0.5, whatever is beside it, once more scans in a row than beams that ended there have passed, or
/// three: what is beside it may have left with it.
template <class Cell>
[[nodiscard]] float probability_standing(const Cell& cell) {
  constexpr float kMayHold = 0.49999F;
  constexpr std::uint32_t kMostPasses = 3;  // Some beams of one scan end here, others do not.
  const auto probability = static_cast<float>(cell.probability());
  if constexpr (std::is_same_v<Cell, EvidenceCell>) {
    if (cell.hits() == 0 || probability >= kMovedUnknown) return probability;
    return passing_scans(cell) >= std::min(cell.hits() + 1, kMostPasses) ? kMovedUnknown
                                                                         : std::max(probability, kMayHold);
  }
  return probability;
}
/// The probability that a cell beside a point is occupied: at most 0.5 if the last scan passed all of it,
/// since it may be leaving with what is in the point's cell.
template <class Cell>
[[nodiscard]] float probability_beside(const Cell& cell) {
  const auto probability = static_cast<float>(cell.probability());
  return passing_scans(cell) > 0 ? std::min(probability, kMovedUnknown) : probability;
}

/// Steps to the cells beside a point: of `reach` and of half of it along each axis, both ways, and of half of
/// it to each corner.
template <int D>
[[nodiscard]] std::vector<Vector<D>> steps_beside(double reach) {
  std::vector<Vector<D>> steps;
  for (int axis = 0; axis < D; ++axis)
    for (const double part : {-1.0, -0.5, 0.5, 1.0}) steps.push_back(part * reach * Vector<D>::Unit(axis));
  for (unsigned corner = 0; corner < (1U << D); ++corner) {
    Vector<D> step;
    for (int k = 0; k < D; ++k) step[k] = (corner >> k & 1U) != 0 ? 0.5 * reach : -0.5 * reach;
    steps.push_back(step);
  }
  return steps;
}

/// That what returned at points is not part of what stands: one minus the probability that the point's cell
/// is occupied, or a cell beside it, where that is more: a surface in the next cell explains the point.
/// See steps_beside(), probability_standing(), probability_beside(). Nothing can be said, 0.5, of what is
/// unknown, whatever is beside it, and where the cell or one beside it may hold something thin, if nothing
/// stands there. O(n).
/// @param points D numbers each [m].
/// @param standing_at called as (points, n, out): writes probability_standing() of each.
/// @param beside_at likewise: writes probability_beside() of each.
template <int D, class StandingAt, class BesideAt>
void probability_moved(const double* points, std::size_t n, const MovedMargin& margin,
                       const StandingAt& standing_at, const BesideAt& beside_at, float* out) {
  constexpr std::size_t kAtOnce = 4096;
  constexpr std::size_t kDim = D;
  constexpr float kStands = 0.6F;  // Odds of 3 to 2: what is beside such a cell changes no decision.
  const auto at_least_unknown = [&](float p) { return p >= margin.thin ? std::max(p, kMovedUnknown) : p; };
  const std::vector<Vector<D>> steps = steps_beside<D>(margin.reach);
  std::vector<double> beside;
  std::vector<std::size_t> open;
  std::vector<float> there;
  for (std::size_t first = 0; first < n; first += kAtOnce) {
    checkpoint();
    const std::size_t count = std::min(kAtOnce, n - first);
    const double* const here = points + first * kDim;
    float* const results = out + first;
    standing_at(here, count, results);
    open.clear();
    for (std::size_t i = 0; i < count; ++i) {
      if (results[i] >= kStands || results[i] == kMovedUnknown) continue;
      open.push_back(i);
      results[i] = at_least_unknown(results[i]);
    }
    beside.resize(open.size() * kDim);
    there.resize(open.size());
    for (const Vector<D>& step : steps) {
      for (std::size_t i = 0; i < open.size(); ++i)
        for (std::size_t k = 0; k < kDim; ++k)
          beside[i * kDim + k] = here[open[i] * kDim + k] + step[static_cast<int>(k)];
      beside_at(beside.data(), open.size(), there.data());
      for (std::size_t i = 0; i < open.size(); ++i)
        results[open[i]] = std::max(results[open[i]], at_least_unknown(there[i]));
    }
    for (std::size_t i = 0; i < count; ++i) results[i] = 1.0F - results[i];
  }
}

/// Probability that the end point of each beam of a scan moved; 0.5 for beams that do not return within
/// `max_range`. @param moved_at called as (points, n, out): writes probability_moved() of each.
template <int D, class MovedAt>
std::vector<float> probability_moved(const ScanView<D>& scan, double max_range, const MovedAt& moved_at) {
  std::vector<double> points;
  std::vector<std::size_t> beams;
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned) continue;
    beams.push_back(static_cast<std::size_t>(i));
    points.insert(points.end(), beam.endpoint.data(), beam.endpoint.data() + D);
  }
  std::vector<float> of_returned(beams.size());
  moved_at(points.data(), beams.size(), of_returned.data());
  std::vector<float> moved(static_cast<std::size_t>(scan.size), kMovedUnknown);
  for (std::size_t i = 0; i < beams.size(); ++i) moved[beams[i]] = of_returned[i];
  return moved;
}

}  // namespace ndtree
