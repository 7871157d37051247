// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What beams without return say in a log: that space is free, or nothing.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <vector>

#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree {

/// What a sample of a log shows of its beams without return.
struct NoReturns {
  static constexpr double kMostWrong = 0.2;    ///< With a larger fraction of wrong ones they say nothing.
  static constexpr double kSure = 3.0;         ///< Standard deviations from there that are no chance.
  static constexpr double kMostErased = 0.02;  ///< Fraction of surfaces that a map may lose.

  std::size_t beams = 0;     ///< Without return, that tell whether they are right.
  double crossing = 0.0;     ///< Fraction of them that crosses surfaces which other scans found.
  double expected = 0.0;     ///< Fraction that would if they were right, by errors of poses and what moves.
  double share = 0.0;        ///< Fraction of beams without return among all of the sample.
  std::size_t surfaces = 0;  ///< Pieces of surface that beams had to meet again.
  double erased = 0.0;       ///< Fraction of them from which fewer returned than did not.

  /// Whether enough of them could be checked to trust them if none crosses a surface.
  [[nodiscard]] bool are_judged() const { return upper_bound(0.0) < kMostWrong; }
  /// Whether they surely mean free space; else they say nothing. An excuse does not make sure: `expected` is
  /// what errors of poses explain, and with such poses what they free may be a wall as well.
  [[nodiscard]] bool are_free() const { return upper_bound(crossing) < kMostWrong && erased <= kMostErased; }
  /// are_free() as options and reports have it.
  [[nodiscard]] const char* choice() const { return are_free() ? "free" : "ignore"; }

  /// What was chosen and why, in one line.
  [[nodiscard]] std::string to_text() const {
    if (share == 0.0) return "every beam of the scans that were looked at returned";
    char begin[80], found[200];
    const bool are_few = share < 0.001;
    std::snprintf(begin, sizeof begin, "beams without return (%s%.1f %%)", are_few ? "less than " : "",
                  are_few ? 0.1 : 100.0 * share);
    if (!are_judged())
      return std::string(begin) +
             " are left out: " + (beams == 0 ? "none" : "only " + std::to_string(beams)) +
             " of them could be checked";
    if (erased > kMostErased)
      std::snprintf(found, sizeof found, "they would erase %.0f %% of %s pieces of surface", 100.0 * erased,
                    describe_count(surfaces).c_str());
    else
      std::snprintf(found, sizeof found,
                    "%.0f %% of %s that were tested go through walls that other scans saw (pose errors would "
                    "explain %.0f %%)",
                    100.0 * crossing, describe_count(beams).c_str(), 100.0 * expected);
    return std::string(begin) + (are_free() ? " mean free space: " : " are left out: ") + found;
  }

 private:
  /// The largest fraction of which `fraction` of the beams is no chance: Wilson's bound, 1 without beams.
  [[nodiscard]] double upper_bound(double fraction) const {
    if (beams == 0) return 1.0;
    const auto n = static_cast<double>(beams);
    const double square = kSure * kSure / n;
    const double spread = std::sqrt(square * (fraction * (1.0 - fraction) + square / 4.0));
    return (fraction + square / 2.0 + spread) / (1.0 + square);
  }
};

namespace detail {

/// Edge of the cells in which surfaces are noted [m].
template <int D>
inline constexpr double kSurfaceCell = D == 2 ? 0.1 : 0.2;

/// Cells of one size that every second scan of a sample hit, each with the first and the last of these scans
/// that did.
template <class Map, int D>
class SampledSurfaces {
 public:
  explicit SampledSurfaces(const std::vector<ScanView<D>>& sample)
      : map_(options()), first_cell_(first_cell(sample)) {
    for (std::size_t i = 0; i < sample.size(); i += 2) note_hits(sample[i], i / 2);
  }

  [[nodiscard]] bool are_none() const { return hits_.empty(); }

  /// Found in a cell.
  struct Hits {
    std::size_t first, last;  ///< Numbers of the first and the last scan that hit it.
    std::vector<Vector<D>> points;
  };
  struct Surface {
    double distance;  ///< Infinite without one [m].
    bool was_there;   ///< Hit both before the ray, or by the first of the two scans that it lies between, and
                      ///< after it.
    const Hits* hits;  ///< Of the cell; null if there are none.
  };
  /// The first surface on a ray of a scan between those with this number and the next.
  /// @param direction of length 1.
  [[nodiscard]] Surface first_on(std::size_t number, const Vector<D>& origin,
                                 const Vector<D>& direction) const {
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    const std::optional<double> at = cast_ray(map_, origin, direction, kInfinity, RayAim::cell);
    if (!at) return {kInfinity, false, nullptr};
    const auto found = hits_.find(key(origin + (*at + kInside * kSurfaceCell<D>)*direction));
    if (found == hits_.end()) return {*at, false, nullptr};
    const Hits& hits = found->second;
    return {*at, hits.first <= number && hits.last > number, &hits};
  }

  /// Whether points lie all around a ray: in 2-D on both sides of it, in 3-D in each quadrant across it. Then
  /// it meets the surface that they are of, and does not pass beside its edge.
  [[nodiscard]] static bool are_around(const Hits& hits, const Vector<D>& origin,
                                       const Vector<D>& direction) {
    Eigen::Matrix<double, D, D - 1> across;
    if constexpr (D == 2) {
      across << -direction[1], direction[0];
    } else {
      const Vector<D>& d = direction;
      if (std::abs(d[2]) < 0.9)
        across.col(0) << -d[1], d[0], 0.0;
      else
        across.col(0) << 0.0, -d[2], d[1];
      const auto a = across.col(0);
      across.col(1) << d[1] * a[2] - d[2] * a[1], d[2] * a[0] - d[0] * a[2], d[0] * a[1] - d[1] * a[0];
    }
    unsigned sides = 0;
    for (const Vector<D>& point : hits.points) {
      unsigned side = 0;
      for (int k = 0; k + 1 < D; ++k) {
        const double aside = across.col(k).dot(point - origin);
        if (aside == 0.0) continue;
        side = 2 * side + (aside > 0.0);
      }
      sides |= 1u << side;
    }
    return sides == (D == 2 ? 3u : 15u);
  }

 private:
  using Options = std::decay_t<decltype(std::declval<const Map&>().options())>;
  /// How far inside a cell it is asked which one it is, in cells.
  static constexpr double kInside = 1e-3;
  /// Cells on an axis, around the first scan, that are told apart: the numbers of D axes fit into 64 bits.
  static constexpr std::int64_t kFarthestCell = std::int64_t{1} << 20;

  static Options options() {
    Options options;
    options.min_cell_size = kSurfaceCell<D>;
    options.range_sigma = kSurfaceCell<D> / 4.0;
    return options;
  }

  /// The first origin that is finite, in cells, rounded; zero without one.
  static Vector<D> first_cell(const std::vector<ScanView<D>>& sample) {
    for (std::size_t i = 0; i < sample.size(); i += 2)
      for (Eigen::Index k = 0; k < (sample[i].origin_per_beam ? sample[i].size : 1); ++k)
        if (sample[i].origin(k).allFinite())
          return (sample[i].origin(k) / kSurfaceCell<D>).unaryExpr([](double x) {
            return std::nearbyint(x);
          });
    return Vector<D>::Zero();
  }

  void note_hits(const ScanView<D>& scan, std::size_t number) {
    Scan<D> hits;
    Eigen::Index n = 0;
    for (Eigen::Index i = 0; i < scan.size; ++i) n += scan.is_returned(i);
    if (n == 0) return;
    hits.endpoints.resize(D, n);
    hits.origins.resize(D, scan.origin_per_beam ? n : 1);
    for (Eigen::Index i = 0, k = 0; i < scan.size; ++i) {
      if (!scan.is_returned(i)) continue;
      hits.endpoints.col(k) = scan.endpoint(i);
      hits.origins.col(scan.origin_per_beam ? k : 0) = scan.origin(i);
      ++k;
    }
    try {
      map_.insert(hits);
    } catch (const std::invalid_argument&) {
      return;  // A scan that no map takes is left out here; mapping itself refuses it by name.
    }
    for (Eigen::Index k = 0; k < n; ++k)
      if (hits.endpoints.col(k).allFinite()) {
        Hits& cell = hits_.try_emplace(key(hits.endpoints.col(k)), Hits{number, number, {}}).first->second;
        cell.last = number;
        cell.points.push_back(hits.endpoints.col(k));
      }
  }

  /// One number for each cell near the first scan.
  [[nodiscard]] std::int64_t key(const Vector<D>& point) const {
    constexpr auto kLimit = static_cast<double>(kFarthestCell);
    std::int64_t key = 0;
    for (int a = 0; a < D; ++a) {
      const double step =
          std::clamp(std::floor(point[a] / kSurfaceCell<D>) - first_cell_[a], -kLimit, kLimit - 1.0);
      key = 2 * kFarthestCell * key + static_cast<std::int64_t>(step) + kFarthestCell;
    }
    return key;
  }

  Map map_;
  Vector<D> first_cell_;
  std::unordered_map<std::int64_t, Hits> hits_;
};

/// Beams that tell something, how many of them cross a surface, and the metres that they claim to be free up
/// to it.
struct CrossingCount {
  std::size_t beams = 0;
  std::size_t crossing = 0;
  double metres = 0.0;
  /// How many had to meet a piece of surface, by the piece.
  std::unordered_map<const void*, std::size_t> met;

  /// Adds every `stride`-th beam of a scan that returned, or did not. Left out are beams whose first surface
  /// had left by then, or came later, or was not looked at again.
  template <class Map, int D>
  void add(const SampledSurfaces<Map, D>& surfaces, std::size_t number, const ScanView<D>& scan,
           bool returned, std::size_t stride) {
    /// How far before its own end a beam may touch a surface, in cells.
    constexpr double kMargin = 3.0;
    std::size_t beam = 0;
    for (Eigen::Index i = 0; i < scan.size; ++i) {
      if (scan.is_returned(i) != returned) continue;
      const Vector<D> origin = scan.origin(i);
      const Vector<D> way = scan.endpoint(i) - origin;
      double square = 0.0;
      for (const double x : way) square += x * x;
      const double length = std::sqrt(square);
      if (!(std::isfinite(length) && length > 0.0)) continue;
      if (beam++ % stride != 0) continue;
      const double end = std::max(length - kMargin * kSurfaceCell<D>, 0.0);
      const auto [first, was_there, hits] = surfaces.first_on(number, origin, way / length);
      const bool crosses = first < end;
      if (was_there && crosses != returned && first < length + kMargin * kSurfaceCell<D> &&
          surfaces.are_around(*hits, origin, way / length))
        ++met[hits];
      if (crosses && !was_there) continue;
      ++beams;
      crossing += crosses;
      metres += std::min(first, end);
    }
  }
};

}  // namespace detail

/// Decides from a sample of a log, see log_sample.hpp, what its beams without return say.
///
/// Every second scan's returned beams make a map of cells of one size, and the beams of the others are held
/// against it. A beam without return that crosses an occupied cell, more than three cells before its end,
/// claims free space where others found a surface, if that was there: hit both before the beam and after it.
/// Where the first surface on its way came later or had left, a beam is not judged.
///
/// Beams that returned cross surfaces, too, where poses are wrong or things moved: how often they do in a
/// metre says how many of the others would if each of them were right. Where it is not sure that fewer than a
/// fifth cross, the sensor may say "no return" of surfaces as well, as for glass and dark ones, and its
/// no-returns say nothing.
///
/// In the open most of these beams meet nothing, whatever the few surfaces do to them. So the surfaces are
/// asked, too: of each piece, whether fewer beams that had to meet it returned from it than did not. A map
/// would lose these; if they are more than 2 %, no-returns say nothing. A beam has to meet a piece where hits
/// lie all around it, and not beside its edge.
///
/// @tparam Map of cells of one size: FixedMap<2, D>. Nothing of it is left.
/// @param sample in the order of the log. In other than 2 or 3 dimensions no beam is judged.
/// O(beams log cells).
template <class Map, int D>
[[nodiscard]] NoReturns judge_no_returns(const std::vector<ScanView<D>>& sample) {
  /// Beams of each kind that are looked at.
  constexpr std::size_t kMostBeams = 100'000;
  std::size_t beams = 0, without_return = 0, others = 0;
  for (std::size_t i = 0; i < sample.size(); ++i) {
    const ScanView<D>& scan = sample[i];
    beams += static_cast<std::size_t>(scan.size);
    if (i % 2 == 1) others += static_cast<std::size_t>(scan.size);
    for (Eigen::Index k = 0; k < scan.size; ++k)
      without_return += !scan.is_returned(k) && scan.endpoint(k).allFinite();
  }
  NoReturns found;
  if (without_return == 0) return found;
  found.share = static_cast<double>(without_return) / static_cast<double>(beams);
  if constexpr (D == 2 || D == 3) {
    const detail::SampledSurfaces<Map, D> surfaces(sample);
    const std::size_t stride = std::max<std::size_t>(1, (others + kMostBeams - 1) / kMostBeams);
    detail::CrossingCount silent, returned;
    for (std::size_t i = 1; i < sample.size(); i += 2) {
      returned.add(surfaces, i / 2, sample[i], true, stride);
      silent.add(surfaces, i / 2, sample[i], false, stride);
    }
    if (silent.beams == 0 || surfaces.are_none()) return found;  // There is nothing to cross.
    const auto judged = static_cast<double>(silent.beams);
    const double rate =
        returned.metres > 0.0 ? static_cast<double>(returned.crossing) / returned.metres : 0.0;
    found.beams = silent.beams;
    found.crossing = static_cast<double>(silent.crossing) / judged;
    found.expected = 1.0 - std::exp(-rate * silent.metres / judged);
    std::size_t erased = 0;
    for (const auto& [piece, count] : silent.met) {
      const auto others_met = returned.met.find(piece);
      const bool is_new = others_met == returned.met.end();
      erased += is_new || count > others_met->second;
      found.surfaces += is_new;
    }
    found.surfaces += returned.met.size();
    if (found.surfaces > 0) found.erased = static_cast<double>(erased) / static_cast<double>(found.surfaces);
  }
  return found;
}

}  // namespace ndtree
