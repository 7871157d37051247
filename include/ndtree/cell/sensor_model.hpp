// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The analytic inverse sensor model: how likely a cell is occupied, given one range measurement (Sec. III).
#pragma once

#include <cmath>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Standard deviations of a range that can be mapped.
inline constexpr OptionBounds kRangeSigmaBounds{1e-9, 1e6, " m"};

/// A surface is at least this thick, in standard deviations of a range, and as thick as a smallest cell: what
/// passes a smallest cell within that before its end says nothing, as the surface may be anywhere in its row.
inline constexpr double kThinnestSurface = 5.0 / 3.0;

struct SensorOptions {
  double range_sigma = 0.03;           ///< Standard deviation of a range at the sensor [m].
  double range_sigma_quadratic = 0.0;  ///< Its growth with the squared range, for depth cameras [1/m].
  /// Full angle of the cone somewhere across which the surface lies that a beam meets [rad]; sonar: 0.2 to
  /// 0.6.
  double beam_divergence = 0.0;
  double probability_min = 0.4;  ///< The inverse sensor model's least probability,
  double probability_max = 0.7;  ///< and its largest.
  double log_odds_min = -2.0;    ///< A cell's log-odds stay above this,
  double log_odds_max = 3.5;     ///< and below this, so that a change can be seen.
};

/// Whether a sensor's noise is a template on its numbers, so that beams are packed eight at a time.
template <class Sensor, class = void>
inline constexpr bool kPacksByEights = false;
#ifdef NDTREE_HAS_EIGHTS
template <class Sensor>
inline constexpr bool kPacksByEights<
    Sensor,
    std::enable_if_t<std::is_same_v<decltype(std::declval<const Sensor&>().clearly_free_until(
                                        FourDoubles(), std::declval<const Sensor&>().sigma(FourDoubles()))),
                                    FourDoubles>>> = true;
#endif

/// p(n|z) for a beam that enters cell n at one distance and leaves it at another.
///
/// The obstacle's distance x is N(range, sigma²). The cell is occupied if x falls inside it, free if x falls
/// behind it, and nothing is known, 1/2, if x falls before it:
///   p(n|z) = F(exit) - F(entry) + F(entry) / 2 = F(exit; range, sigma²) - F(entry; range, sigma²) / 2.
/// The paper prints its two distances in the other order; so read, p would be negative before the end point.
class BeamSensorModel {
 public:
  /// The traversal goes on to range + kReachSigmas * sigma.
  static constexpr double kReachSigmas = 3.0;

  explicit BeamSensorModel(const SensorOptions& options)
      : options_(options),
        cone_per_range_(static_cast<float>(2.0 * std::tan(0.5 * options.beam_divergence))),
        z_min_(normal_quantile(options.probability_min)),
        probability_min_(static_cast<float>(options.probability_min)),
        probability_max_(static_cast<float>(options.probability_max)),
        log_odds_free_(static_cast<float>(ndtree::log_odds(options.probability_min))),
        log_odds_occupied_(static_cast<float>(ndtree::log_odds(options.probability_max))) {}

  // Of one number, or of several side by side: see lanes.hpp.

  /// Standard deviation of a measured range [m].
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles sigma(const Doubles& range) const {
    return options_.range_sigma + unfused(options_.range_sigma_quadratic * range * range);
  }
  /// Whether beams are cones: see cone_width().
  [[nodiscard]] bool has_cone() const { return cone_per_range_ > 0.0f; }
  /// Width of a beam at a distance [m].
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats cone_width(const Floats& distance) const {
    return cone_per_range_ * distance;
  }
  /// Cells that end before this distance [m] get log_odds_free(): F(exit) alone is below probability_min.
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles clearly_free_until(const Doubles& range,
                                                                const Doubles& sigma) const {
    return range + unfused(z_min_ * sigma);
  }
  /// log_odds() from a probability within 5e-5, for a cell whose entry and exit are these distances behind
  /// the end point, in standard deviations.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats quick_log_odds(const Floats& entry, const Floats& exit) const {
    const Floats p = 0.25f + (upper_cdf(exit) - unfused(0.5f * upper_cdf(entry)));
    const Floats clamped = min_of(max_of(p, probability_min_), probability_max_);
    return rough_log(Floats(clamped / (1.0f - clamped)));
  }

  /// The t of the last point for which a beam has evidence.
  /// @param sigma of the beam's range [m].
  template <int D>
  [[nodiscard]] static double t_end(const Beam<D>& beam, double sigma) {
    if (beam.outcome != BeamOutcome::returned) return beam.t_free;
    return 1.0 + kReachSigmas * sigma / beam.range;
  }

  /// The model as derived, not clamped; entry and exit in metres from the sensor.
  [[nodiscard]] static double probability(double entry, double exit, double range, double sigma) {
    return cdf(exit, range, sigma) - unfused(0.5 * cdf(entry, range, sigma));
  }

  /// F(distance; range, sigma²). Neighbours along a beam share it: one's exit is the other's entry.
  [[nodiscard]] static double cdf(double distance, double range, double sigma) {
    return normal_cdf((distance - range) / sigma);
  }

  /// Log-odds of probability(), clamped to [probability_min, probability_max], from cdf() of entry and exit.
  [[nodiscard]] float log_odds(double cdf_entry, double cdf_exit) const {
    const double p = cdf_exit - unfused(0.5 * cdf_entry);
    if (p <= options_.probability_min) return log_odds_free_;
    if (p >= options_.probability_max) return log_odds_occupied_;
    return static_cast<float>(ndtree::log_odds(p));
  }

  /// The log-odds of probability_min, for a cell that a beam passed.
  [[nodiscard]] float log_odds_free() const { return log_odds_free_; }

 private:
  /// normal_cdf() - 1/2 within 3.5e-5.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats upper_cdf(const Floats& x) const {
    return with_sign((*upper_cdf_)(abs_of(x)), x);
  }
  [[nodiscard]] static const CubicTable& upper_cdf_table() {
    static const CubicTable table(4.25, [](double x) { return normal_cdf(x) - 0.5; });
    return table;
  }

  SensorOptions options_;
  float cone_per_range_;
  double z_min_;
  float probability_min_;
  float probability_max_;
  float log_odds_free_;
  float log_odds_occupied_;
  const CubicTable* upper_cdf_ = &upper_cdf_table();  // One of all models.
};

}  // namespace ndtree
