// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Looking over the beams of a scan, and leaving out those that no cell would take.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/cache_lines.hpp"
#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/scan/image.hpp"
#include "ndtree/mapping/scan/measurements.hpp"
#include "ndtree/mapping/scan/order.hpp"

namespace ndtree {

/// A number in [0, 2^24) that seems to be drawn, but depends on the direction and length of a beam alone: the
/// same beams are in a sample, in whatever order they come. A cell that takes a share of a scan's beams takes
/// those whose number is below so much of 2^24.
template <int D>
[[nodiscard]] std::uint32_t chance_of(const std::array<float, std::size_t{D}>& displacement) {
  std::uint32_t hash = 0;
  std::uint32_t factor = 1;
  for (const float component : displacement) {
    std::uint32_t bits = 0;
    std::memcpy(&bits, &component, sizeof bits);
    hash += bits * (factor *= 0x9e3779b1u);
  }
  hash ^= hash >> 15;
  hash *= 0x85ebca77u;
  hash ^= hash >> 13;
  return (hash * 0xc2b2ae3du) >> 8;
}

/// How many beams of a scan a cell may take: fewer than `beams` for each smallest cell that lies side by side
/// in it.
struct Sampling {
  double beams;
  double smallest_cell;  ///< [m]
  double largest_cell;   ///< [m]
};

/// Some beams of a scan, looked over by one thread.
template <int D, class Sensor>
class alignas(kCacheLines) ScanPart {
  static constexpr std::size_t kAxes = D - 1;

 public:
  /// Counts the beams and finds out where they point. @throws as survey_exactly().
  template <class Geometry>
  void look_over(const Measurements<D, Sensor>& measurements, const BeamRange& range, const Sensor& sensor,
                 const Geometry& geometry) {
    measurements_ = &measurements;
    first_ = range.first;
    size_ = static_cast<std::size_t>(range.size());
    depth_.reset(new float[size_]);
    chance_.reset(new std::uint32_t[size_]);
    face_.reset(new std::uint32_t[size_]);
    const ScanView<D>& scan = measurements.scan();
    Eigen::Index i = range.first;
    if (!scan.origin_per_beam && size_ > 0) image_.add_all_faces(scan.origin(0));
#ifdef NDTREE_HAS_EIGHTS
    if (!scan.origin_per_beam && Simd::width() >= 8) i = look_over_by_eights(range);
#endif
    for (; i < range.last; ++i) look_over_one(i);
    if (survey_.num_valid() == 0) return;

    const double reached = std::min(measurements.max_range(), std::sqrt(D) * static_cast<double>(deepest_));
    double sigma = std::max(sensor.sigma(0.0), sensor.sigma(reached));
    bool is_valid = !is_exact_needed_;
    if (scan.range_sigma != nullptr) {
      sigma = 0.0;
      for (Eigen::Index k = range.first; k < range.last; ++k) {
        is_valid = is_valid && kRangeSigmaBounds.contain(scan.range_sigma[k]);
        sigma = std::max(sigma, scan.range_sigma[k]);
      }
    }
    is_valid = is_valid && kRangeSigmaBounds.contain(sigma);
    const double margin =
        rounded(Sensor::kReachSigmas * sigma) + rounded(1e-6 * reached);  // Above all rounding.
    is_valid = is_valid && reached + margin <= kLongestBeam * geometry.unit();
    survey_.reach.lower.array() -= margin;
    survey_.reach.upper.array() += margin;
    if (!is_valid || !geometry.in_reach(survey_.reach.lower) || !geometry.in_reach(survey_.reach.upper))
      survey_ = survey_exactly(geometry, measurements, range);
    reach_behind_ = static_cast<float>(margin);
  }

  [[nodiscard]] const ScanSurvey<D>& survey() const { return survey_; }
  [[nodiscard]] ScanImage<D>& image() { return image_; }

  /// No cell takes a beam that none takes at the depth of its end, or behind it by half a cell.
  /// @param image of the whole scan. @param numbers that this part's faces have there.
  void keep(const ScanImage<D>& image, const std::vector<std::uint32_t>& numbers, const Sampling& sampling) {
    const float behind = this->behind(sampling);
    const auto smallest = static_cast<float>(sampling.smallest_cell);
    const auto beams = static_cast<float>(sampling.beams) * kSlack;
    const float farthest = this->farthest();
    kept_.reset(new std::uint32_t[size_]);
    kept_of_faces_.assign(numbers.size(), 0);
    std::size_t i = 0;
#ifdef NDTREE_HAS_EIGHTS
    if (Simd::width() >= 8 && numbers.size() <= 2 * D)
      i = keep_by_eights(image, numbers, smallest, beams, farthest, behind);
#endif
    for (; i < size_; ++i)
      if (face_[i] != ScanImage<D>::kNoFace &&
          may_be_taken(image.face(numbers[face_[i]]), chance_[i], last_depth(depth_[i], farthest, behind),
                       smallest, beams))
        add_kept(i);
  }
  /// The depth up to which cells may take beams.
  [[nodiscard]] float depth_of_kept(const Sampling& sampling) const {
    return last_depth(deepest_, farthest(), behind(sampling));
  }
  /// How many some cell may take, ...
  [[nodiscard]] std::size_t num_kept() const { return num_kept_; }
  /// ... these, in the order of the scan, ...
  [[nodiscard]] std::uint32_t kept(std::size_t k) const {
    return static_cast<std::uint32_t>(first_) + kept_[k];
  }
  /// ... the faces that they go through, by the number that those have in this part, ...
  [[nodiscard]] std::uint32_t face(std::size_t k) const { return face_[k]; }
  /// ... their chances, until count(), ...
  [[nodiscard]] std::uint32_t chance(std::size_t k) const { return chance_[k]; }
  /// ... and how many there are of each face.
  [[nodiscard]] const std::vector<std::uint32_t>& kept_of_faces() const { return kept_of_faces_; }

  /// How many of them each step has. @param numbers that this part's faces have there.
  [[nodiscard]] std::vector<std::uint32_t> count(const BeamSteps<D>& steps,
                                                 const std::vector<std::uint32_t>& numbers) {
    std::vector<std::uint32_t> counts = steps.counts();
    std::size_t k = 0;
#ifdef NDTREE_HAS_EIGHTS
    if (Simd::width() >= 8 && numbers.size() <= kNone) k = find_steps_by_eights(steps, numbers);
#endif
    for (; k < num_kept_; ++k) chance_[k] = static_cast<std::uint32_t>(steps.of(numbers[face(k)], chance(k)));
    for (k = 0; k < num_kept_; ++k) ++counts[1 + chance_[k]];
    return counts;
  }
  /// Puts them where they belong. @param places of the next of each step.
  void put(std::vector<std::uint32_t>& places, std::uint32_t* numbers) const {
    for (std::size_t k = 0; k < num_kept_; ++k) numbers[places[1 + chance_[k]]++] = kept(k);
  }

 private:
  static constexpr float kSlack = ScanFace<D>::kSlack;
  static constexpr float kChanceUnit = 1.0f / (1u << ScanFace<D>::kChanceBits);
  static constexpr float kShortest = 2e-18f;  // Squares of such numbers are floats [m] ...
  static constexpr float kLongest = 1e18f;    // ... and of such.

  /// How far behind its end a beam is asked for [m].
  [[nodiscard]] float behind(const Sampling& sampling) const {
    return reach_behind_ + rounded(0.5f * static_cast<float>(sampling.largest_cell));
  }
  /// Where beams are cut [m].
  [[nodiscard]] float farthest() const {
    return static_cast<float>(
        std::min(measurements_->max_range(), static_cast<double>(std::numeric_limits<float>::max())));
  }

  /// Where a beam that ends at a depth is asked for at last [m].
  [[nodiscard]] static float last_depth(float depth, float farthest, float behind) {
    return rounded(std::min(depth, farthest) * kSlack) + behind;
  }

  void look_over_one(Eigen::Index i) {
    const ScanView<D>& scan = measurements_->scan();
    const Vector<D> origin = scan.origin(i);
    Vector<D> way = scan.endpoint(i) - origin;
    const double length = way.cwiseAbs().maxCoeff();
    const auto place = static_cast<std::size_t>(i - first_);
    if (!(length >= static_cast<double>(kShortest)) || !(length <= static_cast<double>(kLongest)) ||
        !way.allFinite() || !origin.allFinite()) {
      const Beam<D> beam = measurements_->beam(i);
      if (beam.outcome == BeamOutcome::invalid) {
        ++survey_.count(BeamOutcome::invalid);
        face_[place] = ScanImage<D>::kNoFace;
        return;
      }
      if (!(length <= static_cast<double>(kLongest))) {
        is_exact_needed_ = true;
        way = beam.free_end() - origin;
        if (!(way.cwiseAbs().maxCoeff() <= static_cast<double>(kLongest))) way = Vector<D>::Unit(0);
      }
    }
    std::array<float, std::size_t{D}> d;
    std::size_t axis = 0;
    for (std::size_t a = 0; a < D; ++a) {
      d[a] = static_cast<float>(way[static_cast<int>(a)]);
      if (std::abs(d[a]) > std::abs(d[axis])) axis = a;
    }
    const float depth = std::abs(d[axis]);
    ++survey_.count(outcome_of(i, depth));
    const double max_range = measurements_->max_range();
    Vector<D> end = origin;
    for (std::size_t a = 0; a < D; ++a)
      end[static_cast<int>(a)] += std::clamp(static_cast<double>(d[a]), -max_range, max_range);
    survey_.include(end);
    survey_.include(origin);
    const std::uint32_t number =
        image_.face_of(image_.cube_of(origin), origin, 2 * axis + static_cast<std::size_t>(d[axis] < 0.0f));
    ScanFace<D>& face = image_.faces()[number];
    ++face.num_beams;
    for (std::size_t k = 0; k < kAxes; ++k) {
      const float at = d[k + (k >= axis)] / depth;
      face.lower[k] = std::min(face.lower[k], at);
      face.upper[k] = std::max(face.upper[k], at);
    }
    depth_[place] = depth;
    chance_[place] = chance_of<D>(d);
    face_[place] = number;
    deepest_ = std::max(deepest_, depth);
  }

  /// How a valid beam ended. @param depth its length is between this and sqrt(D) times as much, but for
  ///   rounding.
  [[nodiscard]] BeamOutcome outcome_of(Eigen::Index i, float depth) const {
    const ScanView<D>& scan = measurements_->scan();
    if (!scan.is_returned(i)) return BeamOutcome::not_returned;
    const double max_range = measurements_->max_range();
    const auto least = static_cast<double>(depth);
    const bool in_reach =
        least * (std::sqrt(D) * (1.0 + 1e-6)) <= max_range ||
        (least * (1.0 - 1e-6) <= max_range && length_of<D>(scan.endpoint(i) - scan.origin(i)) <= max_range);
    return in_reach ? BeamOutcome::returned : BeamOutcome::beyond_max_range;
  }

  /// Whether a cell of the smallest size may take a beam at this depth.
  [[nodiscard]] static bool may_be_taken(const ScanFace<D>& face, std::uint32_t chance, float depth,
                                         float smallest, float beams) {
    return face.share_below(face.step_of(chance)) * face.expected_beams(depth, smallest) < beams;
  }
  void add_kept(std::size_t place) {
    kept_[num_kept_] = static_cast<std::uint32_t>(place);
    chance_[num_kept_] = chance_[place];
    face_[num_kept_++] = face_[place];
    ++kept_of_faces_[face_[place]];
  }

#ifdef NDTREE_HAS_EIGHTS
  static constexpr std::size_t kNone = 2 * D;  // Beams that say nothing go through no face.
  static constexpr Eigen::Index kAhead = 176;  // Beams: memory is read a page ahead, which processors do not.
  using OfFaces = std::array<float, std::max<std::size_t>(kNone + 1, 8)>;
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static __m256 of_face(const OfFaces& values,
                                                                            __m256i faces) {
    if constexpr (kNone < 8) {
      return _mm256_permutevar8x32_ps(_mm256_loadu_ps(values.data()), faces);
    } else {
      const detail::Offsets at(faces);
      return _mm256_setr_ps(values[at[0]], values[at[1]], values[at[2]], values[at[3]], values[at[4]],
                            values[at[5]], values[at[6]], values[at[7]]);
    }
  }
  /// Beams of few faces. @returns the place of the first that is left.
  NDTREE_BY_EIGHTS std::size_t keep_by_eights(const ScanImage<D>& image,
                                              const std::vector<std::uint32_t>& numbers, float smallest,
                                              float beams, float farthest, float behind) {
    OfFaces row;
    OfFaces counts;  // Bits of a chance that count.
    std::array<OfFaces, kAxes> places;
    row.fill(0.0f);
    counts.fill(0.0f);
    for (auto& of_axis : places) of_axis.fill(0.0f);
    for (std::size_t f = 0; f < numbers.size(); ++f) {
      const ScanFace<D>& face = image.face(numbers[f]);
      row[f] = face.is_lone() ? 0.0f : smallest * face.density;
      const std::uint32_t bits = ~std::uint32_t{0} << face.chance_shift;
      std::memcpy(&counts[f], &bits, sizeof bits);
      for (std::size_t k = 0; k < kAxes; ++k) places[k][f] = face.places[k];
    }
    std::array<std::uint32_t, kNone + 1> kept_of_faces{};  // And of none.
    std::size_t i = 0;
    for (; i + 8 <= size_; i += 8) {
      const __m256i face =
          _mm256_min_epu32(detail::load(face_.get() + i), _mm256_set1_epi32(static_cast<int>(kNone)));
      const __m256 depth = _mm256_add_ps(
          _mm256_mul_ps(_mm256_min_ps(_mm256_loadu_ps(depth_.get() + i), _mm256_set1_ps(farthest)),
                        _mm256_set1_ps(kSlack)),
          _mm256_set1_ps(behind));
      const __m256 in_row = _mm256_div_ps(of_face(row, face), depth);
      __m256 expected = _mm256_set1_ps(1.0f);
      for (std::size_t k = 0; k < kAxes; ++k)
        expected = _mm256_mul_ps(expected, _mm256_min_ps(in_row, of_face(places[k], face)));
      const __m256i number = detail::load(chance_.get() + i);
      const __m256i step = _mm256_and_si256(number, _mm256_castps_si256(of_face(counts, face)));
      const __m256 chance = _mm256_mul_ps(_mm256_cvtepi32_ps(step), _mm256_set1_ps(kChanceUnit));
      const __m256 is_kept = _mm256_and_ps(
          _mm256_cmp_ps(_mm256_mul_ps(chance, expected), _mm256_set1_ps(beams), _CMP_LT_OQ),
          _mm256_castsi256_ps(_mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<int>(kNone)), face)));
      const auto set = static_cast<unsigned>(_mm256_movemask_ps(is_kept));
      for (unsigned left = 0xff; left != 0;) {  // Most go through one face, be they kept or not.
        const std::uint32_t one = std::min(face_[i + static_cast<std::size_t>(__builtin_ctz(left))],
                                           static_cast<std::uint32_t>(kNone));
        const __m256i is_one = _mm256_cmpeq_epi32(face, _mm256_set1_epi32(static_cast<int>(one)));
        const auto same = static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(is_one)));
        kept_of_faces[one] += static_cast<std::uint32_t>(__builtin_popcount(same & set));
        left &= ~same;
      }
      const __m256i order = detail::packing(set);
      const auto put = [this](std::unique_ptr<std::uint32_t[]>& column) {
        return reinterpret_cast<__m256i*>(column.get() + num_kept_);
      };
      _mm256_storeu_si256(put(kept_), _mm256_add_epi32(_mm256_set1_epi32(static_cast<int>(i)), order));
      _mm256_storeu_si256(put(chance_), _mm256_permutevar8x32_epi32(number, order));
      _mm256_storeu_si256(put(face_), _mm256_permutevar8x32_epi32(face, order));
      num_kept_ += static_cast<std::size_t>(__builtin_popcount(set));
    }
    std::copy_n(kept_of_faces.begin(), kept_of_faces_.size(), kept_of_faces_.begin());
    return i;
  }

  /// Finds the steps of those that are kept, of few faces. @returns the first that is left.
  NDTREE_BY_EIGHTS std::size_t find_steps_by_eights(const BeamSteps<D>& steps,
                                                    const std::vector<std::uint32_t>& numbers) {
    OfFaces first;
    OfFaces shift;
    first.fill(0.0f);
    shift.fill(0.0f);
    for (std::size_t f = 0; f < numbers.size(); ++f) {
      const ScanFace<D>& face = steps.face(numbers[f]);
      const auto first_step = static_cast<std::uint32_t>(face.first_step);
      std::memcpy(&first[f], &first_step, sizeof first_step);
      std::memcpy(&shift[f], &face.chance_shift, sizeof face.chance_shift);
    }
    std::size_t k = 0;
    for (; k + 8 <= num_kept_; k += 8) {
      const __m256i face = detail::load(face_.get() + k);
      auto* const chance = reinterpret_cast<__m256i*>(chance_.get() + k);
      const __m256i step =
          _mm256_srlv_epi32(detail::load(chance_.get() + k), _mm256_castps_si256(of_face(shift, face)));
      _mm256_storeu_si256(chance, _mm256_add_epi32(step, _mm256_castps_si256(of_face(first, face))));
    }
    return k;
  }

  /// look_over_one() for beams of one origin. @returns the first that is left.
  NDTREE_BY_EIGHTS Eigen::Index look_over_by_eights(const BeamRange& range) {
    const ScanView<D>& scan = measurements_->scan();
    const Vector<D> origin = scan.origin(0);
    const double max_range = measurements_->max_range();
    const double longest = std::min(max_range, 2.0 * static_cast<double>(kLongest));
    const auto cut = _mm256_set1_ps(static_cast<float>(longest));
    // Up to this depth a beam is shorter than that, with all rounding.
    const auto in_reach = _mm256_set1_ps(static_cast<float>(longest / (std::sqrt(D) * (1.0 + 1e-5))));
    const __m256 sign = _mm256_set1_ps(-0.0f);
    const __m256 infinity = _mm256_set1_ps(std::numeric_limits<float>::infinity());
    struct Extent {
      __m256 lower, upper;
    };
    std::array<std::array<Extent, kAxes>, std::size_t{2 * D}> extents;
    for (auto& of_side : extents) of_side.fill({infinity, _mm256_sub_ps(_mm256_setzero_ps(), infinity)});
    std::array<std::uint32_t, std::size_t{2 * D}> count{};
    std::array<Extent, std::size_t{D}> reach;
    reach.fill({_mm256_setzero_ps(), _mm256_setzero_ps()});
    __m256 deepest = _mm256_setzero_ps();
    Eigen::Index i = range.first;
    std::uint64_t valid = 0;
    for (; i + 8 <= range.last; i += 8) {
      prefetch<8 * D>(scan.endpoints + D * std::min(i + kAhead, scan.size - 8));
      __m256 d[std::size_t{D}];
      __m256 depth = _mm256_setzero_ps();
      __m256i axis = _mm256_setzero_si256();
      __m256 finite = _mm256_castsi256_ps(_mm256_set1_epi32(-1));
#pragma GCC unroll 4
      for (int a = 0; a < D; ++a) {
        const double* const from = scan.endpoints + i * D + a;
        const __m256d o = _mm256_set1_pd(origin[a]);
        const __m128 low =
            _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_setr_pd(from[0], from[D], from[2 * D], from[3 * D]), o));
        const __m128 high = _mm256_cvtpd_ps(
            _mm256_sub_pd(_mm256_setr_pd(from[4 * D], from[5 * D], from[6 * D], from[7 * D]), o));
        const auto k = static_cast<std::size_t>(a);
        d[k] = detail::joined(low, high);
        const __m256 length = _mm256_andnot_ps(sign, d[k]);
        const __m256 longer = _mm256_cmp_ps(length, depth, _CMP_GT_OQ);
        axis = _mm256_blendv_epi8(axis, _mm256_set1_epi32(2 * a), _mm256_castps_si256(longer));
        depth = _mm256_max_ps(length, depth);
        finite = _mm256_and_ps(finite, _mm256_cmp_ps(length, _mm256_set1_ps(kLongest), _CMP_LE_OQ));
      }
      const __m256 fits = _mm256_and_ps(finite, _mm256_cmp_ps(depth, _mm256_set1_ps(kShortest), _CMP_GE_OQ));
      if (_mm256_movemask_ps(fits) != 0xff) {
        for (Eigen::Index k = 0; k < 8; ++k) look_over_one(i + k);
        continue;
      }
      // Where it meets the face: the other axes, in their order.
      __m256 main = d[0];
      __m256 at[kAxes + 1];
#pragma GCC unroll 4
      for (std::size_t k = 0; k < kAxes; ++k) {
        const __m256i this_axis = _mm256_set1_epi32(static_cast<int>(2 * (k + 1)));
        const __m256 is_behind = _mm256_castsi256_ps(_mm256_cmpgt_epi32(this_axis, axis));  // Axes after it.
        at[k] = _mm256_blendv_ps(d[k], d[k + 1], is_behind);
        main = _mm256_blendv_ps(main, d[k + 1], _mm256_castsi256_ps(_mm256_cmpeq_epi32(this_axis, axis)));
      }
      const __m256i side = _mm256_sub_epi32(axis, _mm256_srai_epi32(_mm256_castps_si256(main), 31));
#pragma GCC unroll 4
      for (std::size_t k = 0; k < kAxes; ++k) at[k] = _mm256_div_ps(at[k], depth);

      __m256i hash = _mm256_setzero_si256();
      std::uint32_t factor = 1;
#pragma GCC unroll 4
      for (std::size_t a = 0; a < D; ++a) {
        factor *= 0x9e3779b1u;
        hash = _mm256_add_epi32(
            hash, _mm256_mullo_epi32(_mm256_castps_si256(d[a]), _mm256_set1_epi32(static_cast<int>(factor))));
      }
      hash = _mm256_xor_si256(hash, _mm256_srli_epi32(hash, 15));
      hash = _mm256_mullo_epi32(hash, _mm256_set1_epi32(static_cast<int>(0x85ebca77u)));
      hash = _mm256_xor_si256(hash, _mm256_srli_epi32(hash, 13));
      hash = _mm256_srli_epi32(_mm256_mullo_epi32(hash, _mm256_set1_epi32(static_cast<int>(0xc2b2ae3du))), 8);

      const auto place = static_cast<std::size_t>(i - first_);
      _mm256_storeu_ps(depth_.get() + place, depth);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(chance_.get() + place), hash);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(face_.get() + place), side);
      deepest = _mm256_max_ps(deepest, depth);
      for (std::size_t a = 0; a < D; ++a) {
        reach[a].lower = _mm256_min_ps(reach[a].lower, _mm256_max_ps(d[a], _mm256_xor_ps(cut, sign)));
        reach[a].upper = _mm256_max_ps(reach[a].upper, _mm256_min_ps(d[a], cut));
      }
      unsigned left = 0xff;
      do {  // Most beams side by side go through the same face.
        const std::uint32_t one = face_[place + static_cast<std::size_t>(__builtin_ctz(left))];
        const __m256 same =
            _mm256_castsi256_ps(_mm256_cmpeq_epi32(side, _mm256_set1_epi32(static_cast<int>(one))));
        const auto set = static_cast<unsigned>(_mm256_movemask_ps(same));
        for (std::size_t k = 0; k < kAxes; ++k) {
          Extent& extent = extents[one][k];
          extent.lower = _mm256_min_ps(extent.lower, _mm256_blendv_ps(infinity, at[k], same));
          extent.upper = _mm256_max_ps(extent.upper, _mm256_blendv_ps(extent.upper, at[k], same));
        }
        count[one] += static_cast<std::uint32_t>(__builtin_popcount(set));
        left &= ~set;
      } while (left != 0);
      valid += 8;
      count_outcomes(i, depth, in_reach);
    }
    join_sides(count, extents);
    if (valid > 0) {
      Vector<D> lower = origin;
      Vector<D> upper = origin;
      for (std::size_t a = 0; a < D; ++a) {
        lower[static_cast<int>(a)] += static_cast<double>(least_of(reach[a].lower));
        upper[static_cast<int>(a)] += static_cast<double>(most_of(reach[a].upper));
      }
      survey_.include(lower);
      survey_.include(upper);
      deepest_ = std::max(deepest_, most_of(deepest));
    }
    return i;
  }
  /// Adds the beams of each side to its face, which has the same number.
  template <class Extents>
  NDTREE_BY_EIGHTS void join_sides(const std::array<std::uint32_t, std::size_t{2 * D}>& count,
                                   const Extents& extents) {
    for (std::size_t side = 0; side < 2 * D; ++side) {
      if (count[side] == 0) continue;
      ScanFace<D>& face = image_.faces()[side];
      face.num_beams += count[side];
      for (std::size_t k = 0; k < kAxes; ++k) {
        face.lower[k] = std::min(face.lower[k], least_of(extents[side][k].lower));
        face.upper[k] = std::max(face.upper[k], most_of(extents[side][k].upper));
      }
    }
  }
  /// The set of those of eight beams that returned.
  NDTREE_BY_EIGHTS [[nodiscard]] unsigned returned_of_eight(Eigen::Index first) const {
    const bool* const returned = measurements_->scan().returned;
    if (returned == nullptr) return 0xff;
    const __m128i flags = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(returned + first));
    return ~static_cast<unsigned>(_mm_movemask_epi8(_mm_cmpeq_epi8(flags, _mm_setzero_si128()))) & 0xff;
  }
  /// @param in_reach depths up to which all that return count.
  NDTREE_BY_EIGHTS void count_outcomes(Eigen::Index first, __m256 depths, __m256 in_reach) {
    if (_mm256_movemask_ps(_mm256_cmp_ps(depths, in_reach, _CMP_LE_OQ)) == 0xff) {
      const auto returned = static_cast<unsigned>(__builtin_popcount(returned_of_eight(first)));
      survey_.count(BeamOutcome::returned) += returned;
      survey_.count(BeamOutcome::not_returned) += 8 - returned;
      return;
    }
    std::array<float, 8> depth;
    _mm256_storeu_ps(depth.data(), depths);
    for (std::size_t k = 0; k < 8; ++k)
      ++survey_.count(outcome_of(first + static_cast<Eigen::Index>(k), depth[k]));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static float least_of(__m256 v) {
    std::array<float, 8> values;
    _mm256_storeu_ps(values.data(), v);
    return *std::min_element(values.begin(), values.end());
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static float most_of(__m256 v) {
    std::array<float, 8> values;
    _mm256_storeu_ps(values.data(), v);
    return *std::max_element(values.begin(), values.end());
  }
#endif

  const Measurements<D, Sensor>* measurements_ = nullptr;
  Eigen::Index first_ = 0;
  ScanSurvey<D> survey_;
  ScanImage<D> image_;
  float deepest_ = 0.0f;
  float reach_behind_ = 0.0f;     // The end of a beam, at most [m].
  bool is_exact_needed_ = false;  // Some beam is too long for float.
  std::size_t size_ = 0;          // Beams.
  // Of each, not initialised; kNoFace of those that say nothing:
  std::unique_ptr<float[]> depth_;
  std::unique_ptr<std::uint32_t[]>
      chance_;                             // Then of those that are kept alone, and then their steps instead.
  std::unique_ptr<std::uint32_t[]> face_;  // Then of those that are kept alone.
  std::unique_ptr<std::uint32_t[]> kept_;  // Places of those that some cell may take, in their order.
  std::size_t num_kept_ = 0;
  std::vector<std::uint32_t> kept_of_faces_;
};

}  // namespace ndtree
