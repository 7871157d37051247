// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beta function and its incomplete form: what counts of two outcomes say about the odds behind them.
#pragma once

#include <cmath>
#include <limits>
#include <utility>

#include "ndtree/core/quick_log.hpp"

namespace ndtree {

/// log of the gamma function for x > 0, within 1e-13 or 1e-14 of its value: Stirling's series from 10 on, and
/// the recurrence down from there. std::lgamma() also writes a global variable, which threads must not.
[[nodiscard]] inline double log_gamma(double x) {
  double product = 1.0;
  for (; x < 10.0; x += 1.0) product *= x;
  const double y = 1.0 / (x * x);
  const double series =
      (1.0 / 12.0 -
       y * (1.0 / 360.0 -
            y * (1.0 / 1260.0 - y * (1.0 / 1680.0 - y * (1.0 / 1188.0 - y * 691.0 / 360360.0))))) /
      x;
  return (x - 0.5) * std::log(x) - x + 0.91893853320467274 + series - std::log(product);
}

/// log B(a, b) = log Γ(a) + log Γ(b) - log Γ(a + b), for a, b > 0.
[[nodiscard]] inline double log_beta(double a, double b) {
  return log_gamma(a) + log_gamma(b) - log_gamma(a + b);
}

namespace detail {

/// Factors of the gamma function: Γ(x) = exp(stirling) sqrt(2 π) / product. Stirling's series from 8 on, and
/// the recurrence down from there.
struct GammaFactors {
  double stirling;
  double product = 1.0;

  explicit GammaFactors(double x) {
    if (x < 8.0) {  // Γ(x) = Γ(x + 8) / (x (x + 1) ... (x + 7))
      const double y = x * (x + 7.0);
      product = y * (y + 6.0) * (y + 10.0) * (y + 12.0);
      x += 8.0;
    }
    const double inverse = 1.0 / x;
    const double y = inverse * inverse;
    const double series =
        (1.0 / 12.0 - y * (1.0 / 360.0 - y * (1.0 / 1260.0 - y * (1.0 / 1680.0)))) * inverse;
    stirling = (x - 0.5) * quick_log(x) - x + series;
  }
};

}  // namespace detail

/// log_beta() within 1e-9 or 1e-12 of the largest of the three, in a third of the time.
[[nodiscard]] inline double quick_log_beta(double a, double b) {
  constexpr double kLogSqrt2Pi = 0.91893853320467274;
  const detail::GammaFactors of_a(a);
  const detail::GammaFactors of_b(b);
  const detail::GammaFactors of_sum(a + b);
  return of_a.stirling + of_b.stirling - of_sum.stirling + kLogSqrt2Pi +
         quick_log(of_sum.product / (of_a.product * of_b.product));
}

/// I_x(a, b) for a, b > 0 and x in [0, 1]: the probability that a share with the distribution Beta(a, b) is
/// below x. By the continued fraction DLMF 8.17.22, evaluated forwards with rescaled convergents, on the side
/// of the mean where it converges fast. Relative error below 1e-10 for a + b up to 1e4.
[[nodiscard]] inline double incomplete_beta(double a, double b, double x) {
  if (!(x > 0.0)) return 0.0;
  if (!(x < 1.0)) return 1.0;
  const bool above_mean = x > (a + 1.0) / (a + b + 2.0);
  if (above_mean) {
    std::swap(a, b);
    x = 1.0 - x;
  }
  // Convergents A_n / B_n of 1 / (1 + d_1 / (1 + d_2 / (1 + ...))), kept near 1 by dividing both by B_n.
  double numerator_before = 0.0;
  double numerator = 1.0;
  double denominator_before = 1.0;
  double denominator = 1.0;
  for (int n = 1; n < 10000; ++n) {
    const double m = n / 2;  // NOLINT(bugprone-integer-division): d_2m and d_2m+1 share their m.
    const double d = n % 2 == 0 ? m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m))
                                : -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
    const double next_numerator = numerator + d * numerator_before;
    const double next_denominator = denominator + d * denominator_before;
    const double value = next_numerator / next_denominator;
    const bool converged = std::abs(value * denominator - numerator) <=
                           std::numeric_limits<double>::epsilon() * std::abs(numerator);
    numerator_before = numerator / next_denominator;
    denominator_before = denominator / next_denominator;
    numerator = value;
    denominator = 1.0;
    if (converged) break;
  }
  const double tail = std::exp(a * std::log(x) + b * std::log1p(-x) - log_beta(a, b)) / a * numerator;
  return above_mean ? 1.0 - tail : tail;
}

/// Do beams end in several cells with a probability of each cell's own, or with one for all? The Bayes factor
/// of the two, the probabilities being from Beta(prior_hits, 1).
class RateComparison {
 public:
  explicit RateComparison(double prior_hits) : prior_hits_(prior_hits), log_prior_(-std::log(prior_hits)) {}

  /// Another cell's beams; the numbers need not be whole.
  void add(double hits, double misses) {
    many_ += log_evidence(hits, misses);
    hits_ += hits;
    misses_ += misses;
  }
  /// log2 of the factor for a probability of each one's own; negative where one for all is likelier.
  [[nodiscard]] double bits_for_many() const {
    constexpr double kNatsPerBit = 0.69314718055994531;
    return (many_ - log_evidence(hits_, misses_)) / kNatsPerBit;
  }

 private:
  [[nodiscard]] double log_evidence(double hits, double misses) const {
    return quick_log_beta(hits + prior_hits_, misses + 1.0) - log_prior_;
  }

  double prior_hits_;
  double log_prior_;
  double many_ = 0.0;
  double hits_ = 0.0;
  double misses_ = 0.0;
};

}  // namespace ndtree
