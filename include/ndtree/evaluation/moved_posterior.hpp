// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How probable it is that what returned from a cell moved, by the scans that saw through it and that did
/// not.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/beta.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// How sure a scan must be that a place is empty.
struct MovedOptions {
  double cell_size = 0.05;             ///< Points of one cell have one answer [m].
  double range_sigma = 0.03;           ///< Standard deviation of a range r is this [m],
  double range_sigma_quadratic = 0.0;  ///< plus this times r² [1/m].
  double place_sigma = 0.0;            ///< Of how a scan lies to another one, on each axis [m],
  double turn_sigma = 0.0;             ///< and of how it is turned, about each [rad].
  double noise_sigmas = 2.0;           ///< Of a range, that a point and a beam each may be wrong by.
  double error_rate = 0.2;             ///< Fraction of the scans that see through what stands, at most.
  int most_scans = 12;                 ///< Scans in a row that outweigh any before that said otherwise.

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    require_option(cell_size > 0.0 && std::isfinite(cell_size), "cell_size", cell_size, "> 0 m and finite");
    require_option(range_sigma >= 0.0 && std::isfinite(range_sigma), "range_sigma", range_sigma,
                   ">= 0 m and finite");
    require_option(range_sigma_quadratic >= 0.0 && std::isfinite(range_sigma_quadratic),
                   "range_sigma_quadratic", range_sigma_quadratic, ">= 0 1/m and finite");
    require_option(place_sigma >= 0.0 && std::isfinite(place_sigma), "place_sigma", place_sigma,
                   ">= 0 m and finite");
    require_option(turn_sigma >= 0.0 && turn_sigma <= 1.0, "turn_sigma", turn_sigma, "in [0, 1] rad");
    require_option(noise_sigmas > 0.0 && noise_sigmas <= 100.0, "noise_sigmas", noise_sigmas, "in (0, 100]");
    require_option(error_rate >= 1e-3 && error_rate < 0.5, "error_rate", error_rate, "in [0.001, 0.5)");
    require_option(most_scans >= 1 && most_scans <= 1000, "most_scans", most_scans, "in [1, 1000]");
  }
};

/// What scans said of a cell.
struct MovedTally {
  std::uint32_t through = 0;   ///< Scans that saw through it,
  std::uint32_t found = 0;     ///< and scans that found a surface there,
  std::uint32_t stays = 0;     ///< in how many rows without one that saw through.
  std::int32_t streak = 0;     ///< The last scans in a row: that saw through, negative that found a surface.
  std::uint32_t unsure = 0;    ///< Scans that passed it with beams too far apart to surely meet it.
  std::uint32_t own_scan = 0;  ///< The last with a beam that ended in it.
  /// Logarithm of the odds, by where those that saw through passed it, that something thin stands there:
  /// along the axes across beams, see MovedPosterior::odds_of_thin().
  std::array<float, 2> thin{};

  void find() {
    stays += found == 0 || streak > 0 ? 1 : 0;
    ++found;
    streak = std::min(streak, 0) - 1;
  }
};

/// Let v scans have seen through a cell, and h found a surface there, in r rows of scans between which others
/// saw through. If something stands there, mostly a fraction of the scans of at most e = error_rate sees
/// through it, but of a part t of what stands any fraction does: fences, foliage, glass. Places and beams
/// change little from scan to scan, so that any number of rows is as probable. What moved was there without a
/// break, and after a stay comes back with a probability of q. With both equally likely before, and fractions
/// uniform,
///
///     P(moved) = m / (m + s),  m = (1 - I_e(v + 1, h + 1)) / (1 - e) q^(r - 1),
///     s = ((1 - t) I_e(v + 1, h + 1) / e + t) / min(h, v + 1),
///
/// I being the incomplete beta function. That is 1/2 without any scan, less without one that saw through, and
/// less the more found it or the more often it was found again.
///
/// Once `most_scans` in a row have seen through, h counts for no more than these outweigh: what stood for
/// long and left goes. What as many in a row found last is not said to have moved: it came, and stands.
class MovedPosterior {
 public:
  /// @throws std::invalid_argument as MovedOptions::validate().
  explicit MovedPosterior(const MovedOptions& options)
      : error_rate_(validated(options).error_rate), most_scans_(options.most_scans), below_(error_rate_) {
    while (operator()(static_cast<std::uint32_t>(most_scans_), outweighed_ + 1, 1) > 0.5F) ++outweighed_;
  }

  /// Of a cell that `through` scans saw through, and in which `found` found a surface, in `stays` rows of
  /// scans without one that saw through. @pre stays <= found, and > 0 if found > 0.
  [[nodiscard]] float operator()(std::uint32_t through, std::uint32_t found, std::uint32_t stays) const {
    if (through == 0 && found == 0) return 0.5F;
    const double below = std::clamp(below_(through + 1.0, found + 1.0), 0.0, 1.0);
    double moved = (1.0 - below) / (1.0 - error_rate_);
    double stands = (1.0 - kThin) * below / error_rate_ + kThin;
    if (found > 0) {
      moved *= std::pow(kReturns, stays - 1.0);
      stands /= std::min(found, through + 1);
    }
    return static_cast<float>(moved / (moved + stands));
  }
  /// At least 0.5, so that nothing is said, where more scans passed with beams too far apart than may see
  /// through what stands. 0.5 at most unless beams passed through the places of the cell and those around it,
  /// not beside: they go past a rod on both sides, and through any place that is empty. Passes of one scan
  /// are correlated, so that these odds keep a point, but do not say that it stands.
  /// @param thin logarithm of the odds of something thin, of the cell and those around it.
  [[nodiscard]] float operator()(const MovedTally& tally, float thin) const {
    float probability = operator()(tally.through, tally.found, tally.stays);
    if (!(thin < 0.0F) || tally.streak <= -most_scans_) probability = std::min(probability, 0.5F);
    const bool is_open = tally.unsure > error_rate_ * (static_cast<double>(tally.unsure) + tally.found);
    return is_open ? std::max(probability, 0.5F) : probability;
  }
  /// How much more probable it is, as a logarithm, that beams pass a place as they do if something thin
  /// stands there. Of beams `gap` apart, one passes an empty place within `kRod` with a probability of 2 kRod
  /// / gap, and a rod a fraction kMistaken as often: not its middle is known, but a mean of points.
  /// @param nearest of them @param gap between those on both sides [m]; infinite where there is none.
  [[nodiscard]] static float odds_of_thin(float nearest, float gap) {
    const bool is_through = nearest < kRod;
    const float chance = std::isfinite(gap) ? std::min(1.0F, 2.0F * kRod / gap) : is_through ? 1.0F : 0.0F;
    return (is_through ? kLogMistaken : 0.0F) + unfused((1.0F - kMistaken) * chance);
  }
  /// Counts a scan that saw through.
  void pass(MovedTally& tally) const {
    ++tally.through;
    tally.streak = std::max(tally.streak, 0) + 1;
    if (tally.streak < most_scans_) return;
    tally.found = std::min(tally.found, outweighed_);
    tally.stays = std::min(tally.stays, outweighed_);
  }

  static constexpr float kRod = 0.01F;  ///< Half the width of the thinnest rods, legs and twigs [m].

 private:
  static constexpr float kMistaken = 0.25F;  // Measured in railings: 0.1 to 0.2; of what moved 0.95 to 1.05.
  static constexpr float kLogMistaken = -1.38629436F;
  // Fitted by tools/bench/moved-fit on simulated worlds in which nothing moves, or one thing does:
  static constexpr double kThin = 0.2;      // Of what stands, that any fraction of scans sees through.
  static constexpr double kReturns = 0.15;  // Of stays in a cell, that another one follows.

  static const MovedOptions& validated(const MovedOptions& options) {
    options.validate();
    return options;
  }

  double error_rate_;
  std::int32_t most_scans_;
  QuickIncompleteBeta below_;     // Of error_rate.
  std::uint32_t outweighed_ = 0;  // Scans that found a surface, by most_scans that saw through.
};

}  // namespace ndtree
