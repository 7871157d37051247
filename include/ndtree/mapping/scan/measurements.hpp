// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beams of a scan as a map takes them: with their noise, cut at the range that counts, and looked over.
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
#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// So many of the smallest cells a beam may pass, what noise leaves open behind it included. Distances along
/// it have the 24 bits of a float: until here, where it crosses a border is known within a 16th of such a
/// cell. At 5 cm that is 52 km, at 1 mm 1 km. More can only be a mistake, and would take minutes and
/// gigabytes.
inline constexpr double kLongestBeam = 0x1p20;

/// Beams of a scan, from the first to before the last.
struct BeamRange {
  Eigen::Index first = 0;
  Eigen::Index last = 0;
  [[nodiscard]] Eigen::Index size() const { return last - first; }
};

/// A scan, the range up to which its beams count, and how noisy they are. The scan must stay where it is.
template <int D, class Sensor>
class Measurements {
 public:
  /// @param scan_number of the scan among those of its map, see ScanView::number.
  Measurements(const ScanView<D>& scan, double max_range, const Sensor& sensor, std::uint64_t scan_number = 0)
      : scan_(scan), max_range_(max_range), sensor_(&sensor), scan_number_(scan_number) {}

  [[nodiscard]] const ScanView<D>& scan() const { return scan_; }
  [[nodiscard]] double max_range() const { return max_range_; }
  [[nodiscard]] std::uint64_t scan_number() const { return scan_number_; }
  [[nodiscard]] BeamRange all() const { return {0, scan_.size}; }
  /// About as many beams in each of some parts.
  [[nodiscard]] BeamRange part(std::size_t number, std::size_t parts) const {
    const auto n = static_cast<std::size_t>(scan_.size);
    return {static_cast<Eigen::Index>(n * number / parts),
            static_cast<Eigen::Index>(n * (number + 1) / parts)};
  }
  [[nodiscard]] Beam<D> beam(Eigen::Index i) const {
    return Beam<D>(scan_.origin(i), scan_.endpoint(i), scan_.is_returned(i), max_range_);
  }
  /// Standard deviation of the i-th beam's range [m].
  [[nodiscard]] double sigma(Eigen::Index i, double range) const {
    return scan_.range_sigma == nullptr ? sensor_->sigma(range) : scan_.range_sigma[i];
  }

 private:
  ScanView<D> scan_;
  double max_range_;
  const Sensor* sensor_;
  std::uint64_t scan_number_;
};

/// What the beams of a scan reach, and how they ended.
template <int D>
struct ScanSurvey {
  Box<D> reach{Vector<D>::Constant(std::numeric_limits<double>::infinity()),
               Vector<D>::Constant(-std::numeric_limits<double>::infinity())};
  std::array<std::uint64_t, 4> outcomes{};  ///< How many, by BeamOutcome.

  [[nodiscard]] std::uint64_t& count(BeamOutcome outcome) {
    return outcomes[static_cast<std::size_t>(outcome)];
  }
  [[nodiscard]] std::uint64_t num(BeamOutcome outcome) const {
    return outcomes[static_cast<std::size_t>(outcome)];
  }
  /// Beams that say anything.
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

/// Looks over every beam of a range, to the last bit.
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
    const double sigma = measurements.sigma(i, beam.range);
    require_within(("range_sigma of beam " + std::to_string(i)).c_str(), sigma, kRangeSigmaBounds);
    const double t_end = Sensor::t_end(beam, sigma);
    for (const Vector<D>& point : {beam.origin, beam.point(t_end), beam.free_end()}) {
      if (!geometry.in_reach(point)) {
        std::string text;
        for (int a = 0; a < D; ++a) text += (a ? ", " : "") + describe_number(point[a]);
        throw std::invalid_argument("beam " + std::to_string(i) + " reaches (" + text +
                                    ") m: with cells of " + describe_number(geometry.unit()) +
                                    " m every component must be within " + describe_number(geometry.reach()) +
                                    " m of 0");
      }
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
