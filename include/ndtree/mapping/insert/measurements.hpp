// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beams of a scan with their noise, cut at max_range, and the exact survey of them.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>

#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// The longest beam, with the noise behind its end, in smallest cells. Distances along a beam have the 24
/// bits of a float: up to this length, a border is crossed at a distance that is exact to a 16th of a
/// smallest cell. With cells of 5 cm that is 52 km, with cells of 1 mm 1 km. A longer beam is a mistake, and
/// would take minutes and gigabytes.
inline constexpr double kLongestBeam = 0x1p20;

/// The beams [first, last) of a scan.
struct BeamRange {
  Eigen::Index first = 0;
  Eigen::Index last = 0;
  [[nodiscard]] Eigen::Index size() const { return last - first; }
};

/// A scan with max_range and the noise of its beams.
/// Invariants: it refers to the arrays of the scan and to the sensor, which must outlive it.
/// Cost: O(1) each.
template <int D, class Sensor>
class Measurements {
 public:
  /// @param least_sigma a smaller standard deviation counts as this [m]; see kThinnestSurface.
  /// @param scan_number of the scan in its map, see ScanView::number.
  Measurements(const ScanView<D>& scan, double max_range, const Sensor& sensor, double least_sigma = 0.0,
               std::uint64_t scan_number = 0)
      : scan_(scan),
        max_range_(max_range),
        sensor_(&sensor),
        least_sigma_(least_sigma),
        scan_number_(scan_number) {}

  [[nodiscard]] const ScanView<D>& scan() const { return scan_; }
  [[nodiscard]] double max_range() const { return max_range_; }
  [[nodiscard]] std::uint64_t scan_number() const { return scan_number_; }
  [[nodiscard]] BeamRange all() const { return {0, scan_.size}; }
  /// Part `number` of `parts` parts, whose sizes differ by at most one beam.
  [[nodiscard]] BeamRange part(std::size_t number, std::size_t parts) const {
    const auto n = static_cast<std::size_t>(scan_.size);
    return {static_cast<Eigen::Index>(n * number / parts),
            static_cast<Eigen::Index>(n * (number + 1) / parts)};
  }
  /// The i-th beam, cut at max_range.
  [[nodiscard]] Beam<D> beam(Eigen::Index i) const {
    return Beam<D>(scan_.origin(i), scan_.endpoint(i), scan_.is_returned(i), max_range_);
  }
  /// Standard deviation of the i-th beam's range [m]: the scan's own, else that of the sensor at this range.
  [[nodiscard]] double sigma(Eigen::Index i, double range) const {
    return scan_.range_sigma == nullptr ? sigma_at(range) : at_least(scan_.range_sigma[i]);
  }
  /// The least that any beam's may be [m]. O(1), or O(beams) if they have noise of their own.
  [[nodiscard]] double least_sigma() const {
    if (scan_.range_sigma == nullptr) return sigma_at(0.0);
    double least = std::numeric_limits<double>::infinity();
    for (Eigen::Index i = 0; i < scan_.size; ++i)
      if (scan_.range_sigma[i] < least) least = scan_.range_sigma[i];
    return at_least(least);
  }
  /// Of the sensor at a range, or at several side by side.
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles sigma_at(const Doubles& range) const {
    return at_least(Doubles(sensor_->sigma(range)));
  }
  /// What a standard deviation counts as; NaN stays.
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles at_least(const Doubles& sigma) const {
    return max_of(Doubles(least_sigma_), sigma);
  }
  /// Of the i-th beam at its length after the cut at max_range.
  [[nodiscard]] double sigma(Eigen::Index i, const Beam<D>& beam) const {
    return sigma(i, beam.t_free * beam.range);
  }

 private:
  ScanView<D> scan_;
  double max_range_;
  const Sensor* sensor_;
  double least_sigma_;
  std::uint64_t scan_number_;
};

/// Result of a survey: a box that contains all that the beams reach [m], and the number of each outcome.
template <int D>
struct ScanSurvey {
  Box<D> reach{Vector<D>::Constant(std::numeric_limits<double>::infinity()),
               Vector<D>::Constant(-std::numeric_limits<double>::infinity())};
  std::array<std::uint64_t, 4> outcomes{};  ///< Number of beams, by BeamOutcome.

  [[nodiscard]] std::uint64_t& count(BeamOutcome outcome) {
    return outcomes[static_cast<std::size_t>(outcome)];
  }
  [[nodiscard]] std::uint64_t num(BeamOutcome outcome) const {
    return outcomes[static_cast<std::size_t>(outcome)];
  }
  /// Number of beams with any evidence.
  [[nodiscard]] std::uint64_t num_valid() const {
    return num(BeamOutcome::returned) + num(BeamOutcome::not_returned) + num(BeamOutcome::beyond_max_range);
  }
  void include(const Vector<D>& point) {
    reach.lower = reach.lower.cwiseMin(point);
    reach.upper = reach.upper.cwiseMax(point);
  }
  void add(const ScanSurvey& other) {
    reach.lower = reach.lower.cwiseMin(other.reach.lower);
    reach.upper = reach.upper.cwiseMax(other.reach.upper);
    for (std::size_t i = 0; i < outcomes.size(); ++i) outcomes[i] += other.outcomes[i];
  }
};

/// Surveys each beam of a range exactly, including the noise behind its end. Takes longer than ScanSurveyor.
/// @throws std::invalid_argument naming the first beam that reaches beyond what the lattice can address, is
///   longer than kLongestBeam, or whose noise is out of kRangeSigmaBounds.
template <class Geometry, int D, class Sensor>
ScanSurvey<D> survey_exactly(const Geometry& geometry, const Measurements<D, Sensor>& measurements,
                             const BeamRange& range) {
  ScanSurvey<D> survey;
  for (Eigen::Index i = range.first; i < range.last; ++i) {
    const Beam<D> beam = measurements.beam(i);
    ++survey.count(beam.outcome);
    if (beam.outcome == BeamOutcome::invalid) continue;
    const double sigma = measurements.sigma(i, beam);
    const auto* const own = measurements.scan().range_sigma;
    require_within(("range_sigma of beam " + std::to_string(i)).c_str(), own == nullptr ? sigma : own[i],
                   kRangeSigmaBounds);
    const double t_end = Sensor::t_end(beam, sigma);
    for (const Vector<D>& point : {beam.origin, beam.point(t_end), beam.free_end()}) {
      if (!geometry.in_reach(point))
        throw std::invalid_argument("beam " + std::to_string(i) + " reaches " + describe_point(point) +
                                    " m: with cells of " + describe_number(geometry.unit()) +
                                    " m every component must be within " + describe_number(geometry.reach()) +
                                    " m of 0");
      survey.include(point);
    }
    if (!(t_end * beam.range <= kLongestBeam * geometry.unit()))
      throw std::invalid_argument(
          "beam " + std::to_string(i) + " passes " + describe_number(t_end * beam.range) +
          " m of cells, to the end of its noise (range " + describe_number(beam.range) + " m, range_sigma " +
          describe_number(sigma) + " m): with cells of " + describe_number(geometry.unit()) + " m at most " +
          describe_number(kLongestBeam * geometry.unit()) + " m; set max_range, or a larger min_cell_size");
  }
  return survey;
}

}  // namespace ndtree
