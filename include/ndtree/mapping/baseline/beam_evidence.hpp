// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The evidence of one beam for each cell that it crosses: Bayes update and counts (Sec. III).
#pragma once

#include <algorithm>
#include <limits>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/inline.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/map_options.hpp"

namespace ndtree {

/// The evidence of one beam for the cells that it crosses. Three kinds of cells:
/// - the one right behind the end point of a returned beam counts a hit: the cell that the point lies in, or,
///   if it lies on a border, the next one along the beam;
/// - those before it count a miss, and so does every cell of a beam without return, up to where it is cut;
/// - those behind it, up to range + 3 sigma, count neither, but get their part of the Bayes update.
/// Invariant: what a cell gets depends on the beam and on its entry and exit alone.
template <class Sensor>
class BeamEvidence {
 public:
  BeamEvidence(const Sensor& sensor, const MapOptions& options)
      : sensor_(&sensor),
        log_odds_min_(static_cast<float>(options.log_odds_min)),
        log_odds_max_(static_cast<float>(options.log_odds_max)) {}

  /// Goes on with another beam. @param sigma of its range [m]. @pre the beam is valid.
  template <int D>
  void begin(const Beam<D>& beam, double sigma) {
    range_ = beam.range;
    returned_ = beam.outcome == BeamOutcome::returned;
    sigma_ = sigma;
    t_known_ = -1.0;
    t_clearly_free_ = returned_ ? sensor_->clearly_free_until(range_, sigma_) / range_ : kAlways;
    t_end_ = Sensor::t_end(beam, sigma);
    t_hit_ = std::min(kBehindEnd, t_end_);  // Some cell counts it, however small sigma is.
  }
  /// The t of the last point for which the beam has evidence.
  [[nodiscard]] double t_end() const { return t_end_; }

  /// Updates a cell that the beam crosses from t_enter to t_exit.
  template <class Cell>
  NDTREE_ALWAYS_INLINE void update(Cell& cell, double t_enter, double t_exit) {
    if (t_exit < t_clearly_free_) {
      cell.update(sensor_->log_odds_free(), log_odds_min_, log_odds_max_);
      cell.count_miss();
    } else {
      update_near_end(cell, t_enter, t_exit);
    }
  }

 private:
  /// A cell that ends at the end point, within rounding, lies before the surface: the next one counts the
  /// hit.
  static constexpr double kBehindEnd = 1.0 + 1e-12;
  static constexpr double kAlways = std::numeric_limits<double>::infinity();

  template <class Cell>
  void update_near_end(Cell& cell, double t_enter, double t_exit) {
    const double cdf_entry =
        t_enter == t_known_ ? cdf_known_ : Sensor::cdf(unfused(t_enter * range_), range_, sigma_);
    t_known_ = t_exit;
    cdf_known_ = Sensor::cdf(unfused(t_exit * range_), range_, sigma_);
    cell.update(sensor_->log_odds(cdf_entry, cdf_known_), log_odds_min_, log_odds_max_);
    if (t_exit < t_hit_) {
      cell.count_miss();
    } else if (t_enter < t_hit_) {
      cell.count_hit();
    }
  }

  const Sensor* sensor_;
  float log_odds_min_;
  float log_odds_max_;

  // Of the beam:
  double range_ = 0.0;
  double sigma_ = 0.0;
  double t_clearly_free_ = 0.0;
  double t_end_ = 0.0;
  double t_hit_ = 0.0;     // The first cell that ends there, or behind, counts the hit.
  double t_known_ = -1.0;  // The last cell's exit, where cdf_known_ holds.
  double cdf_known_ = 0.0;
  bool returned_ = false;
};

}  // namespace ndtree
