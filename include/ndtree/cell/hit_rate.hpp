// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The fraction of the beams which reach a cell that end in it, and how well it is known.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/beta.hpp"
#include "ndtree/core/log_odds.hpp"

namespace ndtree {

/// Posterior of a cell's hit rate. Of the beams that reach any cell, at most `most` end in it: of those that
/// meet a surface there, the others end in the cell before or behind, by their noise and that of the poses.
/// The rate is that times a fraction with a Beta distribution, of which beams that ended and beams that
/// passed are the counts. Beams through one cell look alike, and so do scans of one place: as to how well the
/// rate is known, `kBeamsOfOne` of them are worth one.
class HitRate {
 public:
  static constexpr double kBeamsOfOne = 8.0;

  /// Beams that ended in the cell and that passed it, >= 0. @param prior_hits, prior_misses > 0.
  HitRate(double most, double hits, double misses, double prior_hits, double prior_misses)
      : most_(most), hits_(hits), misses_(misses), prior_hits_(prior_hits), prior_misses_(prior_misses) {}

  /// The probability that the next beam which reaches the cell ends in it.
  [[nodiscard]] double mean() const { return most_ * fraction(); }
  /// The mean of the fraction with the Beta distribution.
  [[nodiscard]] double fraction() const {
    const double hits = hits_ + prior_hits_;
    return hits / (hits + misses_ + prior_misses_);
  }
  /// The rate is less than this with a probability in (0, 1), within 1e-9. Some 50 evaluations of the
  /// incomplete beta function.
  [[nodiscard]] double quantile(double probability) const {
    const double a = hits_ / kBeamsOfOne + prior_hits_;
    const double b = misses_ / kBeamsOfOne + prior_misses_;
    const double log_beta = ndtree::log_beta(a, b);
    double below = 0.0;
    double above = 1.0;
    while (above - below > 1e-9) {
      const double middle = 0.5 * (below + above);
      (incomplete_beta(a, b, middle, log_beta) < probability ? below : above) = middle;
    }
    return most_ * 0.5 * (below + above);
  }
  /// What one more beam, independent of those before, says about the rate [bit], in [0, 1]: the mutual
  /// information of its outcome and of the fraction p that has the Beta distribution, which is the entropy of
  /// a beam by the mean of p, less the mean entropy of one whose p is known.
  [[nodiscard]] double bits_of_next() const {
    const double a = hits_ / kBeamsOfOne + prior_hits_;
    const double b = misses_ / kBeamsOfOne + prior_misses_;
    const double n = a + b;
    const double all = digamma(n + 1.0);
    const double nats = a / n * (digamma(a + 1.0) - all - std::log(a / n)) +
                        b / n * (digamma(b + 1.0) - all - std::log(b / n));
    return std::max(0.0, nats) / kNatsOfBit;
  }
  /// Beams that the cell's evidence is worth.
  [[nodiscard]] double beams() const { return hits_ + misses_; }

 private:
  static constexpr double kNatsOfBit = 0.69314718055994531;

  double most_;
  double hits_;
  double misses_;
  double prior_hits_;
  double prior_misses_;
};

/// Reads the counts of a cell of some size, in smallest cells, as a HitRate. The constants below are the
/// likeliest on one half of the logs in tools/truth-table; the other half judges them. @pre of cells:
/// observed.
class HitRateModel {
 public:
  /// Of the beams that meet a surface in a cell of any size, at most this fraction ends in it.
  static constexpr double kMostInAny = 0.85;

  explicit HitRateModel(const SensorOptions& sensor)
      : hits_a_unit_(EvidenceCell::kUnit * kHitsOfOne / log_odds(sensor.probability_max)),
        misses_a_unit_(EvidenceCell::kUnit / -log_odds(sensor.probability_min)) {}

  /// By the sums of evidence, which weigh a beam by its way through the cell: in nats of one hit and one
  /// miss.
  [[nodiscard]] HitRate operator()(const EvidenceCell& cell, double size) const {
    return {1.0 - kScattered / size, static_cast<double>(cell.occupied_evidence()) * hits_a_unit_,
            static_cast<double>(cell.free_evidence()) * misses_a_unit_, 0.14, 0.82};
  }
  /// By the counts, which have any beam that passes. Cells are smaller than those of an adaptive map, and
  /// hold a surface less often.
  [[nodiscard]] HitRate operator()(const OccupancyCell& cell, double /*size*/) const {
    return {kMostInAny, kHitsOfOne * static_cast<double>(cell.hits()), static_cast<double>(cell.misses()),
            0.016, 0.01};
  }
  /// Of a cell that keeps no counts. How well it is known cannot be told.
  [[nodiscard]] static double mean_of(double log_odds) { return probability(1.27 * log_odds - 3.15); }

 private:
  /// Noise scatters a wall's hits over the cells around it; so each is worth a little more than one.
  static constexpr double kHitsOfOne = 1.25;
  /// The fraction of the beams at a surface in a smallest cell that end beside it; less in larger cells, in
  /// proportion.
  static constexpr double kScattered = 0.2;

  double hits_a_unit_;
  double misses_a_unit_;
};

}  // namespace ndtree
