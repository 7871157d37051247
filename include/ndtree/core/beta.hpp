// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beta function and its incomplete form: what counts of two outcomes say about the odds behind them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/quick_log.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

namespace detail {
inline constexpr double kLogSqrt2Pi = 0.91893853320467274;
}  // namespace detail

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
  return (x - 0.5) * std::log(x) - x + detail::kLogSqrt2Pi + series - std::log(product);
}

/// The derivative of log Γ for x > 0, within 1e-13 of 1 or of its value: as log_gamma().
[[nodiscard]] inline double digamma(double x) {
  double below = 0.0;
  for (; x < 10.0; x += 1.0) below += 1.0 / x;
  const double y = 1.0 / (x * x);
  const double series =
      y *
      (1.0 / 12.0 -
       y * (1.0 / 120.0 - y * (1.0 / 252.0 - y * (1.0 / 240.0 - y * (1.0 / 132.0 - y * 691.0 / 32760.0)))));
  return std::log(x) - 0.5 / x - series - below;
}

/// log B(a, b) = log Γ(a) + log Γ(b) - log Γ(a + b), for a, b > 0.
[[nodiscard]] inline double log_beta(double a, double b) {
  return log_gamma(a) + log_gamma(b) - log_gamma(a + b);
}

namespace detail {

/// Factors of the gamma function: Γ(x) = exp(stirling) sqrt(2 π) / product. Stirling's series from 8 on, and
/// the recurrence down from there: Γ(x) = Γ(x + 8) / (x (x + 1) ... (x + 7)).
template <class Doubles>
struct GammaFactors {
  Doubles stirling;
  Doubles product;

  NDTREE_ALWAYS_INLINE explicit GammaFactors(const Doubles& of_x) {
    const auto is_small = of_x < 8.0;
    const Doubles y = unfused(of_x * (of_x + 7.0));
    product = select(is_small, Doubles(y * (y + 6.0) * (y + 10.0) * (y + 12.0)), Doubles(1.0));
    const Doubles x = select(is_small, Doubles(of_x + 8.0), of_x);
    const Doubles inverse = 1.0 / x;
    const Doubles square = inverse * inverse;
    const Doubles series =
        (1.0 / 12.0 -
         unfused(square *
                 (1.0 / 360.0 - unfused(square * (1.0 / 1260.0 - unfused(square * (1.0 / 1680.0))))))) *
        inverse;
    stirling = unfused((x - 0.5) * quick_log(x)) - x + unfused(series);
  }
};

}  // namespace detail

/// log_beta() within 1e-9 or 1e-12 of the largest of the three, in a third of the time; of one or four pairs.
template <class Doubles>
[[nodiscard]] NDTREE_ALWAYS_INLINE Doubles quick_log_beta(const Doubles& a, const Doubles& b) {
  const detail::GammaFactors<Doubles> of_a(a);
  const detail::GammaFactors<Doubles> of_b(b);
  const detail::GammaFactors<Doubles> of_sum(a + b);
  return of_a.stirling + of_b.stirling - of_sum.stirling + detail::kLogSqrt2Pi +
         quick_log(Doubles(of_sum.product / (of_a.product * of_b.product)));
}

namespace detail {

/// The continued fraction DLMF 8.17.22, evaluated forwards with rescaled convergents, until its value changes
/// by no more than the tolerance times it.
[[nodiscard]] inline double incomplete_beta_fraction(double a, double b, double x, double tolerance) {
  // Convergents A_n / B_n of 1 / (1 + d_1 / (1 + d_2 / (1 + ...))), kept near 1 by dividing both by B_n.
  double numerator_before = 0.0;
  double numerator = 1.0;
  double denominator_before = 1.0;
  double denominator = 1.0;
  for (int n = 1; n < 10000; ++n) {
    const double m = n / 2;  // NOLINT(bugprone-integer-division): d_2m and d_2m+1 share their m.
    const double d =
        n % 2 == 0 ? m * (b - m) * x / ((a + unfused(2.0 * m) - 1.0) * (a + unfused(2.0 * m)))
                   : -(a + m) * (a + b + m) * x / ((a + unfused(2.0 * m)) * (a + unfused(2.0 * m) + 1.0));
    const double next_numerator = numerator + unfused(d * numerator_before);
    const double next_denominator = denominator + unfused(d * denominator_before);
    const double value = next_numerator / next_denominator;
    const bool converged =
        std::abs(unfused(value * denominator) - numerator) <= tolerance * std::abs(numerator);
    numerator_before = numerator / next_denominator;
    denominator_before = denominator / next_denominator;
    numerator = value;
    denominator = 1.0;
    if (converged) break;
  }
  return numerator;
}

}  // namespace detail

/// I_x(a, b) for a, b > 0 and x in [0, 1]: the probability that a rate with the distribution Beta(a, b) is
/// below x. By a continued fraction, on the side of the mean where it converges fast. Relative error below
/// 1e-10 for a + b up to 1e4.
/// @param log_beta that of a and b, or of b and a.
[[nodiscard]] inline double incomplete_beta(double a, double b, double x, double log_beta) {
  if (!(x > 0.0)) return 0.0;
  if (!(x < 1.0)) return 1.0;
  const bool above_mean = x > (a + 1.0) / (a + b + 2.0);
  if (above_mean) {
    std::swap(a, b);
    x = 1.0 - x;
  }
  const double tail = std::exp(a * std::log(x) + b * std::log1p(-x) - log_beta) / a *
                      detail::incomplete_beta_fraction(a, b, x, std::numeric_limits<double>::epsilon());
  return above_mean ? 1.0 - tail : tail;
}
[[nodiscard]] inline double incomplete_beta(double a, double b, double x) {
  return incomplete_beta(a, b, x, log_beta(a, b));
}

/// incomplete_beta() of one x in (0, 1), within 1e-7 of its value or 1e-14, in less than half the time.
class QuickIncompleteBeta {
 public:
  explicit QuickIncompleteBeta(double x) : x_(x), log_x_(std::log(x)), log_rest_(std::log1p(-x)) {}

  [[nodiscard]] double operator()(double a, double b) const { return (*this)(a, b, quick_log_beta(a, b)); }
  /// @param log_beta that of a and b, or of b and a.
  [[nodiscard]] double operator()(double a, double b, double log_beta) const {
    const double power = std::exp(unfused(a * log_x_) + unfused(b * log_rest_) - log_beta);
    constexpr double kTolerance = 1e-9;
    if (x_ > (a + 1.0) / (a + b + 2.0))
      return 1.0 - unfused(power / b * detail::incomplete_beta_fraction(b, a, 1.0 - x_, kTolerance));
    return power / a * detail::incomplete_beta_fraction(a, b, x_, kTolerance);
  }

 private:
  double x_;
  double log_x_;
  double log_rest_;
};

/// Do beams end in several cells with a probability of each cell's own, or with one for all? The Bayes factor
/// of the two, the probabilities being from Beta(prior_hits, 1).
class RateComparison {
 public:
  explicit RateComparison(double prior_hits) : prior_hits_(prior_hits), log_prior_(-std::log(prior_hits)) {}

  /// Another cell's beams; the numbers need not be whole.
  void add(double hits, double misses) { add(&hits, &misses, 1); }
  /// Those of n cells.
  void add(const double* hits, const double* misses, std::size_t n) {
    std::array<double, kAtOnce> evidence;
    for (std::size_t first = 0; first < n; first += kAtOnce) {
      const std::size_t count = std::min(n - first, kAtOnce);
      log_evidences(hits + first, misses + first, count, evidence.data());
      for (std::size_t i = 0; i < count; ++i) {
        many_ += evidence[i];
        hits_ += hits[first + i];
        misses_ += misses[first + i];
      }
    }
  }
  /// log2 of the factor for a probability of each one's own; negative where one for all is likelier.
  [[nodiscard]] double bits_for_many() const {
    return (many_ - log_evidence(hits_, misses_)) / detail::kLog2;  // [nats] / [nats a bit].
  }

 private:
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles log_evidence(const Doubles& hits, const Doubles& misses) const {
    return quick_log_beta(Doubles(hits + prior_hits_), Doubles(misses + 1.0)) - log_prior_;
  }
  static constexpr std::size_t kAtOnce = 4;
  void log_evidences(const double* hits, const double* misses, std::size_t n, double* evidence) const {
#ifdef NDTREE_HAS_EIGHTS
    if (n == kAtOnce && Simd::width() >= 8) return four_log_evidences(hits, misses, evidence);
#endif
    for (std::size_t i = 0; i < n; ++i) evidence[i] = log_evidence(hits[i], misses[i]);
  }
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS void four_log_evidences(const double* hits, const double* misses, double* evidence) const {
    log_evidence(FourDoubles::load(hits), FourDoubles::load(misses)).store(evidence);
  }
#endif

  double prior_hits_;
  double log_prior_;
  double many_ = 0.0;
  double hits_ = 0.0;
  double misses_ = 0.0;
};

}  // namespace ndtree
