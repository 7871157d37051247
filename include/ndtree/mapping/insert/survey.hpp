// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The survey of a scan: face, depth and sampling key of each beam, numbers of outcomes, and how far the scan
/// reaches. join_surveys() of its parts is in subsample.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/measurements.hpp"

namespace ndtree {

/// The summand of a scan's number in the hash of its sampling keys.
[[nodiscard]] inline std::uint32_t key_of_scan(std::uint64_t number) {
  return static_cast<std::uint32_t>(number) * 0x7feb352du;
}

/// Sampling key of a beam: a hash in [0, 2^24) of its displacement and the scan's number. A cell that samples
/// a fraction of a scan's beams samples the beams with keys below this fraction of 2^24, rounded up to the
/// end of a bucket (ScanBeams::end_of_fraction()). A key does not depend on the order of the beams. Equal
/// beams of two scans have independent keys, so that of a sensor that stands still each beam is sampled in
/// some scan. Displacements count in steps of a millimetre: a shift far below leaves nearly all keys, and so
/// the sample, as they are.
/// @param displacement D components of one beam, or of eight.
template <int D, class Floats>
[[nodiscard]] NDTREE_ALWAYS_INLINE auto sampling_key_at(const Floats* displacement,
                                                        std::uint64_t scan_number) {
  constexpr float kSteps = 1024.0f;      // For a metre: a power of two, so that the product is exact.
  constexpr float kToWhole = 0x1.8p23f;  // Sums with it are rounded to whole numbers up to 4 km.
  std::uint32_t factor = 0x9e3779b1u;
  auto hash = words_of(Floats(displacement[0] * kSteps + kToWhole)) * factor + key_of_scan(scan_number);
#pragma GCC unroll 4
  for (std::size_t a = 1; a < D; ++a)
    hash = hash + words_of(Floats(displacement[a] * kSteps + kToWhole)) * (factor *= 0x9e3779b1u);
  hash = hash ^ unsigned_shifted_right(hash, 15);
  hash = hash * 0x85ebca77u;
  hash = hash ^ unsigned_shifted_right(hash, 13);
  return unsigned_shifted_right(hash * 0xc2b2ae3du, 8);
}
template <int D>
[[nodiscard]] std::uint32_t sampling_key_of(const std::array<float, std::size_t{D}>& displacement,
                                            std::uint64_t scan_number = 0) {
  return sampling_key_at<D>(displacement.data(), scan_number);
}

/// The survey's result for a part of a scan. Arrays are indexed by the beam's position in the part.
template <int D>
struct SurveyedBeams {
  ScanSurvey<D> survey;  ///< Its reach is that of the end points, without the noise behind them.
  CubeMap<D> cube_map;
  float deepest = 0.0f;          ///< The largest depth of a beam [m].
  double sigma = 0.0;            ///< The largest standard deviation that the scan itself has [m].
  bool is_exact_needed = false;  ///< A beam is too long for float, or its noise out of bounds.
  float reach_behind = 0.0f;     ///< Most that noise adds to a beam behind its end [m]; join_surveys() in
                                 ///< subsample.hpp sets it.
  std::size_t size = 0;
  std::unique_ptr<std::uint32_t[]> face;  ///< Face numbers; CubeMap::kNoFace: invalid beam.
  std::unique_ptr<float[]> depth;         ///< Along the face's axis [m]; of valid beams.
  std::unique_ptr<std::uint32_t[]> key;   ///< See sampling_key_of(); of valid beams.

  SurveyedBeams() = default;
  explicit SurveyedBeams(std::size_t n)
      : size(n), face(new std::uint32_t[n]), depth(new float[n]), key(new std::uint32_t[n]) {}
};

/// Surveys a part of a scan, in one thread.
///
/// Strategy: each beam is read once. Its displacement as float gives face, depth, key and its position on the
/// face; bounds of the reach are the extremes of all displacements.
/// Invariants: the bounds contain the end points; outcomes are exact; bounds, faces, depths and keys have the
/// same bits at every width.
/// Cost: O(beams), about one read of their end points from memory.
template <int D, class Sensor>
class ScanSurveyor {
  static constexpr std::size_t kAxes = D - 1;

 public:
  ScanSurveyor(const Measurements<D, Sensor>& measurements, const BeamRange& range)
      : measurements_(measurements), range_(range), beams_(static_cast<std::size_t>(range.size())) {}

  /// Surveys the part; the surveyor is used up.
  [[nodiscard]] SurveyedBeams<D> operator()() && {
    const ScanView<D>& scan = measurements_.scan();
    Eigen::Index i = range_.first;
    if (!scan.origin_per_beam && beams_.size > 0) beams_.cube_map.add_all_faces(scan.origin(0));
#ifdef NDTREE_HAS_EIGHTS
    if (!scan.origin_per_beam && Simd::width() >= 8) i = survey_by_eights();
#endif
    for (; i < range_.last; ++i) survey_one(i);
    if (scan.range_sigma != nullptr && beams_.survey.num_valid() > 0) {
      for (Eigen::Index k = range_.first; k < range_.last; ++k) {
        if (!kRangeSigmaBounds.contain(scan.range_sigma[k])) beams_.is_exact_needed = true;
        beams_.sigma = std::max(beams_.sigma, scan.range_sigma[k]);
      }
    }
    return std::move(beams_);
  }

 private:
  // Squares of lengths in [kShortest, kLongest] are normal floats [m].
  static constexpr float kShortest = 2e-18f;
  static constexpr float kLongest = 1e18f;

  /// Any beam: of an origin of its own, invalid, or too long for float, for which eight have no steps.
  void survey_one(Eigen::Index i) {
    const ScanView<D>& scan = measurements_.scan();
    const Vector<D> origin = scan.origin(i);
    Vector<D> ray = scan.endpoint(i) - origin;
    const double length = ray.cwiseAbs().maxCoeff();
    const auto index = static_cast<std::size_t>(i - range_.first);
    if (!(length >= static_cast<double>(kShortest)) || !(length <= static_cast<double>(kLongest)) ||
        !ray.allFinite() || !origin.allFinite()) {
      const Beam<D> beam = measurements_.beam(i);
      if (beam.outcome == BeamOutcome::invalid) {
        ++beams_.survey.count(BeamOutcome::invalid);
        beams_.face[index] = CubeMap<D>::kNoFace;
        return;
      }
      if (!(length <= static_cast<double>(kLongest))) {
        beams_.is_exact_needed = true;
        ray = beam.free_end() - origin;
        if (!(ray.cwiseAbs().maxCoeff() <= static_cast<double>(kLongest))) ray = Vector<D>::Unit(0);
      }
    }
    std::array<float, std::size_t{D}> d;
    std::size_t axis = 0;
    for (std::size_t a = 0; a < D; ++a) {
      d[a] = static_cast<float>(ray[static_cast<int>(a)]);
      if (std::abs(d[a]) > std::abs(d[axis])) axis = a;
    }
    const float depth = std::abs(d[axis]);
    ++beams_.survey.count(outcome_of(i, depth));
    const float cut = this->cut();
    Vector<D> end = origin;
    for (std::size_t a = 0; a < D; ++a)
      end[static_cast<int>(a)] += static_cast<double>(std::clamp(d[a], -cut, cut));
    beams_.survey.include(end);
    beams_.survey.include(origin);
    const std::uint32_t number = beams_.cube_map.face_of(beams_.cube_map.cube_of(origin), origin,
                                                         2 * axis + static_cast<std::size_t>(d[axis] < 0.0f));
    CubeFace<D>& face = beams_.cube_map.faces()[number];
    ++face.num_beams;
    for (std::size_t k = 0; k < kAxes; ++k) {
      const float at = d[k + (k >= axis)] / depth;
      face.lower[k] = std::min(face.lower[k], at);
      face.upper[k] = std::max(face.upper[k], at);
    }
    beams_.depth[index] = depth;
    beams_.key[index] = sampling_key_of<D>(d, measurements_.scan_number());
    beams_.face[index] = number;
    beams_.deepest = std::max(beams_.deepest, depth);
  }

  /// Where beams are cut [m]: max_range, if it is a normal float.
  [[nodiscard]] double longest() const {
    return std::min(measurements_.max_range(), 2.0 * static_cast<double>(kLongest));
  }
  [[nodiscard]] float cut() const { return static_cast<float>(longest()); }
  /// Outcome of a valid beam.
  /// @param depth of the beam [m]; but for rounding, its length is in [depth, sqrt(D) depth].
  [[nodiscard]] BeamOutcome outcome_of(Eigen::Index i, float depth) const {
    const ScanView<D>& scan = measurements_.scan();
    if (!scan.is_returned(i)) return BeamOutcome::not_returned;
    const double max_range = measurements_.max_range();
    const auto least = static_cast<double>(depth);
    const bool in_reach =
        least * (std::sqrt(D) * (1.0 + 1e-6)) <= max_range ||
        (least * (1.0 - 1e-6) <= max_range && length_of<D>(scan.endpoint(i) - scan.origin(i)) <= max_range);
    return in_reach ? BeamOutcome::returned : BeamOutcome::beyond_max_range;
  }

#ifdef NDTREE_HAS_EIGHTS
  static constexpr Eigen::Index kAhead = 176;  // Beams: a page ahead, where processors do not prefetch.

  /// Surveys beams of one origin, eight at a time, as survey_one() does.
  /// @returns the first beam that is not surveyed.
  NDTREE_BY_EIGHTS Eigen::Index survey_by_eights() {
    const ScanView<D>& scan = measurements_.scan();
    const Vector<D> origin = scan.origin(0);
    const double longest = this->longest();
    const float most = this->cut();
    const EightFloats cut = most;
    // A beam up to this depth is at most `longest` long, whatever the rounding.
    const auto in_reach = static_cast<float>(longest / (std::sqrt(D) * (1.0 + 1e-5)));
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    struct Extent {
      EightFloats lower, upper;
    };
    std::array<std::array<Extent, kAxes>, std::size_t{2 * D}> extents;
    for (auto& of_side : extents) of_side.fill({kInfinity, -kInfinity});
    std::array<std::uint32_t, std::size_t{2 * D}> count{};
    std::array<Extent, std::size_t{D}> reach;
    reach.fill({0.0f, 0.0f});
    EightFloats deepest = 0.0f;
    Eigen::Index i = range_.first;
    std::uint64_t valid = 0;
    for (; i + 8 <= range_.last; i += 8) {
      prefetch<8 * D>(scan.endpoints + D * std::min(i + kAhead, scan.size - 8));
      EightFloats d[std::size_t{D}];
      EightFloats depth = 0.0f;
      EightInts axis = 0;  // Twice the number of the longest.
      EightMask fits = EightMask::all();
#pragma GCC unroll 4
      for (int a = 0; a < D; ++a) {
        const double* const from = scan.endpoints + i * D + a;
        const FourDoubles o = origin[a];
        const auto k = static_cast<std::size_t>(a);
        d[k] = to_floats(FourDoubles::of(from[0], from[D], from[2 * D], from[3 * D]) - o,
                         FourDoubles::of(from[4 * D], from[5 * D], from[6 * D], from[7 * D]) - o);
        const EightFloats length = abs_of(d[k]);
        axis = select(length > depth, EightInts(2 * a), axis);
        depth = max_of(length, depth);
        fits = fits & (length <= kLongest);
      }
      fits = fits & (depth >= kShortest);
      if (fits.set() != 0xff) {
        for (Eigen::Index k = 0; k < 8; ++k) survey_one(i + k);
        continue;
      }
      // Coordinates on the face: those of the other axes, in their order.
      EightFloats main = d[0];
      EightFloats at[kAxes + 1];
#pragma GCC unroll 4
      for (std::size_t k = 0; k < kAxes; ++k) {
        const EightInts this_axis = static_cast<std::int32_t>(2 * (k + 1));
        at[k] = select(this_axis > axis, d[k + 1], d[k]);  // Axes after the face's axis.
        main = select(this_axis == axis, d[k + 1], main);
      }
      const EightInts side = axis - shifted_right(bits_of(main), 31);  // One more if it is negative.
#pragma GCC unroll 4
      for (std::size_t k = 0; k < kAxes; ++k) at[k] = at[k] / depth;
      const EightInts key = sampling_key_at<D>(&d[0], measurements_.scan_number());

      const auto index = static_cast<std::size_t>(i - range_.first);
      depth.store(beams_.depth.get() + index);
      key.store(beams_.key.get() + index);
      side.store(beams_.face.get() + index);
      deepest = max_of(deepest, depth);
      for (std::size_t a = 0; a < D; ++a) {
        reach[a].lower = min_of(reach[a].lower, max_of(d[a], -most));
        reach[a].upper = max_of(reach[a].upper, min_of(d[a], cut));
      }
      unsigned left = 0xff;
      do {  // Adjacent beams mostly have the same face.
        const std::uint32_t one = beams_.face[index + static_cast<std::size_t>(__builtin_ctz(left))];
        const EightMask same = side == static_cast<std::int32_t>(one);
        for (std::size_t k = 0; k < kAxes; ++k) {
          Extent& extent = extents[one][k];
          extent.lower = min_of(extent.lower, select(same, at[k], EightFloats(kInfinity)));
          extent.upper = max_of(extent.upper, select(same, at[k], extent.upper));
        }
        count[one] += same.count();
        left &= ~same.set();
      } while (left != 0);
      valid += 8;
      count_outcomes(i, depth, in_reach);
    }
    add_sides(count, extents);
    if (valid > 0) {
      Vector<D> lower = origin;
      Vector<D> upper = origin;
      for (std::size_t a = 0; a < D; ++a) {
        lower[static_cast<int>(a)] += static_cast<double>(least_of(reach[a].lower));
        upper[static_cast<int>(a)] += static_cast<double>(largest_of(reach[a].upper));
      }
      beams_.survey.include(lower);
      beams_.survey.include(upper);
      beams_.deepest = std::max(beams_.deepest, largest_of(deepest));
    }
    return i;
  }
  /// Adds numbers and extents of the beams of each side to the side's face. @pre face numbers are sides.
  template <class Extents>
  NDTREE_BY_EIGHTS void add_sides(const std::array<std::uint32_t, std::size_t{2 * D}>& count,
                                  const Extents& extents) {
    for (std::size_t side = 0; side < 2 * D; ++side) {
      if (count[side] == 0) continue;
      CubeFace<D>& face = beams_.cube_map.faces()[side];
      face.num_beams += count[side];
      for (std::size_t k = 0; k < kAxes; ++k) {
        face.lower[k] = std::min(face.lower[k], least_of(extents[side][k].lower));
        face.upper[k] = std::max(face.upper[k], largest_of(extents[side][k].upper));
      }
    }
  }
  /// Bit k is set if beam first + k returned, for eight beams.
  NDTREE_BY_EIGHTS [[nodiscard]] unsigned returned_of_eight(Eigen::Index first) const {
    const bool* const returned = measurements_.scan().returned;
    if (returned == nullptr) return 0xff;
    return set_of_eight(returned + first);
  }
  /// Counts the outcomes of eight valid beams.
  /// @param in_reach depth up to which every beam is within max_range [m].
  NDTREE_BY_EIGHTS void count_outcomes(Eigen::Index first, const EightFloats& depths, float in_reach) {
    if ((depths <= in_reach).set() == 0xff) {
      const auto returned = static_cast<unsigned>(__builtin_popcount(returned_of_eight(first)));
      beams_.survey.count(BeamOutcome::returned) += returned;
      beams_.survey.count(BeamOutcome::not_returned) += 8 - returned;
      return;
    }
    std::array<float, 8> depth;
    depths.store(depth.data());
    for (std::size_t k = 0; k < 8; ++k)
      ++beams_.survey.count(outcome_of(first + static_cast<Eigen::Index>(k), depth[k]));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static float least_of(const EightFloats& eight) {
    std::array<float, 8> values;
    eight.store(values.data());
    return *std::min_element(values.begin(), values.end());
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static float largest_of(const EightFloats& eight) {
    std::array<float, 8> values;
    eight.store(values.data());
    return *std::max_element(values.begin(), values.end());
  }
#endif

  const Measurements<D, Sensor>& measurements_;
  const BeamRange range_;
  SurveyedBeams<D> beams_;
};

}  // namespace ndtree
