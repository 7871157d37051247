// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How true a map is on beams that were held out from mapping: counts that add up over scans.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree {

/// The distances that decide what is counted as true.
struct HeldOutTruthOptions {
  double sample_spacing = 0.10;   ///< A beam's free space is sampled at the multiples of this [m]
  double sample_margin = 0.10;    ///< that lie at least this far before its end point [m].
  double endpoint_radius = 0.05;  ///< An end point is found if an occupied cell is this near [m].
  double cast_tolerance = 0.10;   ///< A ray cast is right if it ends this near to the measured range [m].
  double cast_overshoot = 10.0;   ///< A ray cast is given up this far behind the end point [m].
  /// Probabilities are taken for no less than this and no more than 1 minus this: one cell that is surely
  /// wrong does not decide the log score.
  double probability_clip = 0.02;

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    require_option(sample_spacing > 0.0 && std::isfinite(sample_spacing), "sample_spacing", sample_spacing,
                   "> 0 m and finite");
    require_option(sample_margin >= 0.0, "sample_margin", sample_margin, ">= 0 m");
    require_option(endpoint_radius >= 0.0, "endpoint_radius", endpoint_radius, ">= 0 m");
    require_option(cast_tolerance >= 0.0, "cast_tolerance", cast_tolerance, ">= 0 m");
    require_option(cast_overshoot >= 0.0, "cast_overshoot", cast_overshoot, ">= 0 m");
    require_option(probability_clip > 0.0 && probability_clip < 0.5, "probability_clip", probability_clip,
                   "in (0, 0.5)");
  }
};

/// What a map said about held-out beams, as counts; of beams that returned from within the maximum range.
/// Shares are none where nothing was counted.
struct HeldOutTruth {
  std::uint64_t free = 0;                ///< Samples of free space that the map calls free,
  std::uint64_t occupied = 0;            ///< occupied,
  std::uint64_t unknown = 0;             ///< or unknown.
  std::uint64_t endpoints = 0;           ///< End points.
  std::uint64_t endpoints_near = 0;      ///< End points with an occupied cell within endpoint_radius.
  std::uint64_t casts_within = 0;        ///< Ray casts that end within cast_tolerance of the measured range.
  std::uint64_t surfaces_within = 0;     ///< Casts that aim at the surface and end within cast_tolerance.
  double free_log_likelihood = 0.0;      ///< Sum of log(1 - p) over the samples of free space [nats].
  double endpoint_log_likelihood = 0.0;  ///< Sum of log p over the end points [nats].
  std::vector<double>
      cast_errors;  ///< |cast - measured range|, one a ray cast; infinite if it finds nothing.
  std::vector<double> surface_errors;  ///< As cast_errors, of casts that aim at the surface.

  [[nodiscard]] std::uint64_t samples() const { return free + occupied + unknown; }
  [[nodiscard]] std::uint64_t casts() const { return cast_errors.size(); }

  [[nodiscard]] std::optional<double> free_share() const { return share(free, samples()); }
  [[nodiscard]] std::optional<double> occupied_share() const { return share(occupied, samples()); }
  [[nodiscard]] std::optional<double> unknown_share() const { return share(unknown, samples()); }
  [[nodiscard]] std::optional<double> endpoints_near_share() const {
    return share(endpoints_near, endpoints);
  }
  [[nodiscard]] std::optional<double> casts_within_share() const { return share(casts_within, casts()); }
  [[nodiscard]] std::optional<double> surfaces_within_share() const {
    return share(surfaces_within, casts());
  }

  /// Mean of the fractions of free space called free and of end points found.
  [[nodiscard]] std::optional<double> balanced_accuracy() const {
    if (samples() == 0 || endpoints == 0) return std::nullopt;
    return 0.5 * (*free_share() + *endpoints_near_share());
  }
  /// Mean log-likelihood of what the beams found under the map's probabilities [nats], free samples and end
  /// points weighted equally: a proper score, the higher the better, at most 0.
  [[nodiscard]] std::optional<double> log_score() const {
    if (samples() == 0 || endpoints == 0) return std::nullopt;
    return 0.5 * (free_log_likelihood / static_cast<double>(samples()) +
                  endpoint_log_likelihood / static_cast<double>(endpoints));
  }

  /// Exact median of cast_errors [m], of an even number the mean of the middle two; infinite if as many casts
  /// find nothing. O(casts).
  [[nodiscard]] std::optional<double> median_cast_error() const { return median(cast_errors); }
  /// Median of surface_errors [m].
  [[nodiscard]] std::optional<double> median_surface_error() const { return median(surface_errors); }

  /// The counts of other beams join these.
  void add(const HeldOutTruth& other) {
    free += other.free;
    occupied += other.occupied;
    unknown += other.unknown;
    endpoints += other.endpoints;
    endpoints_near += other.endpoints_near;
    casts_within += other.casts_within;
    surfaces_within += other.surfaces_within;
    free_log_likelihood += other.free_log_likelihood;
    endpoint_log_likelihood += other.endpoint_log_likelihood;
    cast_errors.insert(cast_errors.end(), other.cast_errors.begin(), other.cast_errors.end());
    surface_errors.insert(surface_errors.end(), other.surface_errors.begin(), other.surface_errors.end());
  }

 private:
  [[nodiscard]] static std::optional<double> share(std::uint64_t part, std::uint64_t whole) {
    if (whole == 0) return std::nullopt;
    return static_cast<double>(part) / static_cast<double>(whole);
  }
  [[nodiscard]] static std::optional<double> median(std::vector<double> errors) {
    if (errors.empty()) return std::nullopt;
    const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
    std::nth_element(errors.begin(), middle, errors.end());
    if (errors.size() % 2 == 1) return *middle;
    return 0.5 * (*std::max_element(errors.begin(), middle) + *middle);
  }
};

/// Calls `visit(name, value)` for each figure of a report, in its order: counts, and then numbers that are
/// none where nothing was counted.
template <class Visit>
void for_each_figure(const HeldOutTruth& truth, Visit&& visit) {
  visit("free", truth.free);
  visit("occupied", truth.occupied);
  visit("unknown", truth.unknown);
  visit("samples", truth.samples());
  visit("endpoints_near", truth.endpoints_near);
  visit("endpoints", truth.endpoints);
  visit("casts_within", truth.casts_within);
  visit("surfaces_within", truth.surfaces_within);
  visit("casts", truth.casts());
  visit("balanced_accuracy", truth.balanced_accuracy());
  visit("log_score", truth.log_score());
  visit("median_error", truth.median_cast_error());
  visit("surface_error", truth.median_surface_error());
}

/// Asks the map about each beam of a scan that was not mapped, and adds what it says to `truth`.
/// @param map any type for which `probability(map, point)`, `state(map, point)`,
///   `occupied_within(map, point, radius)` and `cast_ray(map, origin, direction, max_range, aim)` are found,
///   in ndtree or in the map's own namespace.
/// @param max_range [m] longer beams, and beams that did not return, are not asked about.
/// @throws std::invalid_argument if max_range is not > 0, or a beam is too long to be sampled.
template <class Map, int D>
void evaluate(const Map& map, const ScanView<D>& scan, double max_range, HeldOutTruth& truth,
              const HeldOutTruthOptions& options = {}) {
  options.validate();
  constexpr double kMaxSamples = 1e7;
  constexpr std::size_t kSteps = 16;  // Of a sample.
  if (!(max_range > 0.0))
    throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
  const auto clipped = [&](double p) {
    return std::clamp(p, options.probability_clip, 1.0 - options.probability_clip);
  };
  Pace pace;
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned) continue;
    if (!(beam.range / options.sample_spacing < kMaxSamples))
      throw std::invalid_argument("beam " + std::to_string(i) + " is " + describe_number(beam.range) +
                                  " m long: expected less than " + describe_number(kMaxSamples) +
                                  " samples; give a max_range");

    for (std::int64_t k = 1;; ++k) {
      const double distance = static_cast<double>(k) * options.sample_spacing;
      if (!(distance <= beam.range - options.sample_margin)) break;
      pace.spend(kSteps);
      const Vector<D> point = beam.point(distance / beam.range);
      const CellState found = state(map, point);
      ++(found == CellState::free       ? truth.free
         : found == CellState::occupied ? truth.occupied
                                        : truth.unknown);
      truth.free_log_likelihood += std::log1p(-clipped(probability(map, point)));
    }

    ++truth.endpoints;
    truth.endpoint_log_likelihood += std::log(clipped(probability(map, beam.endpoint)));
    if (occupied_within(map, beam.endpoint, options.endpoint_radius)) ++truth.endpoints_near;

    const auto cast = [&](RayAim aim, std::vector<double>& errors) {
      const std::optional<double> at =
          cast_ray(map, beam.origin, beam.displacement, beam.range + options.cast_overshoot, aim);
      errors.push_back(at ? std::abs(*at - beam.range) : std::numeric_limits<double>::infinity());
      return errors.back() <= options.cast_tolerance;
    };
    truth.casts_within += cast(RayAim::cell, truth.cast_errors);
    truth.surfaces_within += cast(RayAim::surface, truth.surface_errors);
  }
}

}  // namespace ndtree
