// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Subsampling: drops the beams of a scan that no cell can sample.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/counting_sort.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/insert/survey.hpp"

namespace ndtree {

/// How many beams of a scan a cell can sample: at most `beams` for each smallest cell side by side in it.
struct SubsampleLimits {
  double beams;
  double smallest_cell;  ///< [m]
  double largest_cell;   ///< [m]
};

/// A part of a scan on its way from the survey to the sorted array; one thread handles a part in each step.
///
/// Strategy: survey_beams() surveys the part; keep() compacts keys and faces of the beams that some cell can
/// sample; count() replaces keys by buckets and counts them; scatter() writes the beams' numbers into the
/// sorted array. Between the steps, the caller joins the parts' cube maps and sums up their counts.
/// Invariants: the steps are called once, in this order; kept beams stay in the order of the scan; no beam is
/// dropped that a cell samples; loops over eight beams keep the same beams as loops over one.
/// Cost: O(beams) for each step; memory 16 bytes for each beam.
template <int D, class Sensor>
class alignas(kCacheLines) ScanPart {
  static constexpr std::size_t kAxes = D - 1;

 public:
  /// Surveys the part's beams. @param measurements must live as long as this.
  void survey_beams(const Measurements<D, Sensor>& measurements, const BeamRange& range) {
    measurements_ = &measurements;
    first_ = range.first;
    beams_ = ScanSurveyor<D, Sensor>(measurements, range)();
  }
  [[nodiscard]] const SurveyedBeams<D>& surveyed() const { return beams_; }
  /// @param reach_behind most that noise adds to a beam behind its end [m].
  void set_reach_behind(float reach_behind) { beams_.reach_behind = reach_behind; }
  [[nodiscard]] CubeMap<D>& cube_map() { return beams_.cube_map; }

  /// Drops the beams that no cell can sample. Sampling fractions grow with depth, so it is enough to ask a
  /// smallest cell at the last depth: that of the beam's end with its noise, and half a largest cell.
  /// @param cube_map of the whole scan, after CubeFace::make_pixels(). @param numbers of this part's faces
  /// there.
  void keep(const CubeMap<D>& cube_map, const std::vector<std::uint32_t>& numbers,
            const SubsampleLimits& sampling) {
    const float behind = this->behind(sampling);
    const auto smallest = static_cast<float>(sampling.smallest_cell);
    const auto most = static_cast<float>(sampling.beams) * kSlack;
    const float farthest = this->farthest();
    kept_.reset(new std::uint32_t[beams_.size]);
    kept_of_faces_.assign(numbers.size(), 0);
    std::size_t i = 0;
#ifdef NDTREE_HAS_EIGHTS
    if (Simd::width() >= 8 && numbers.size() <= 2 * D)
      i = keep_by_eights(cube_map, numbers, smallest, most, farthest, behind);
#endif
    for (; i < beams_.size; ++i)
      if (beams_.face[i] != CubeMap<D>::kNoFace &&
          may_be_sampled(cube_map.face(numbers[beams_.face[i]]), beams_.key[i],
                         last_depth(beams_.depth[i], farthest, behind), smallest, most))
        add_kept(i);
  }
  /// The largest depth at which a cell can sample a beam of the part [m].
  [[nodiscard]] float depth_of_kept(const SubsampleLimits& sampling) const {
    return last_depth(beams_.deepest, farthest(), behind(sampling));
  }
  /// Number of kept beams.
  [[nodiscard]] std::size_t num_kept() const { return num_kept_; }
  /// The scan's number of the k-th kept beam; ascending.
  [[nodiscard]] std::uint32_t kept(std::size_t k) const {
    return static_cast<std::uint32_t>(first_) + kept_[k];
  }
  /// The face of the k-th kept beam, by its number in this part.
  [[nodiscard]] std::uint32_t face(std::size_t k) const { return beams_.face[k]; }
  /// The sampling key of the k-th kept beam. @pre before count().
  [[nodiscard]] std::uint32_t key(std::size_t k) const { return beams_.key[k]; }
  /// Number of kept beams of each face of this part.
  [[nodiscard]] const std::vector<std::uint32_t>& kept_of_faces() const { return kept_of_faces_; }

  /// Number of kept beams per bucket, as BeamBuckets::prefix_sum() takes it.
  /// @param numbers of this part's faces in `buckets`.
  [[nodiscard]] std::vector<std::uint32_t> count(const BeamBuckets<D>& buckets,
                                                 const std::vector<std::uint32_t>& numbers) {
    std::vector<std::uint32_t> counts = buckets.counts();
    std::size_t k = 0;
#ifdef NDTREE_HAS_EIGHTS
    if (Simd::width() >= 8 && numbers.size() <= kNone) k = find_buckets_by_eights(buckets, numbers);
#endif
    for (; k < num_kept_; ++k)
      beams_.key[k] = static_cast<std::uint32_t>(buckets.of(numbers[face(k)], key(k)));
    for (k = 0; k < num_kept_; ++k) ++counts[1 + beams_.key[k]];
    return counts;
  }
  /// Writes the kept beams' numbers into the sorted array.
  /// @param indices of the next beam of each bucket, see BeamBuckets::prefix_sum().
  /// @param numbers the sorted array, of all parts.
  void scatter(std::vector<std::uint32_t>& indices, std::uint32_t* numbers) const {
    for (std::size_t k = 0; k < num_kept_; ++k) numbers[indices[1 + beams_.key[k]]++] = kept(k);
  }

 private:
  static constexpr float kSlack = CubeFace<D>::kSlack;
  static constexpr float kKeyUnit = 1.0f / (1u << CubeFace<D>::kKeyBits);

  /// How far behind a beam's end a cell's centre can lie that the beam crosses [m].
  [[nodiscard]] float behind(const SubsampleLimits& sampling) const {
    return beams_.reach_behind + unfused(0.5f * static_cast<float>(sampling.largest_cell));
  }
  /// The length at which beams are cut, max_range as float [m].
  [[nodiscard]] float farthest() const {
    return static_cast<float>(
        std::min(measurements_->max_range(), static_cast<double>(std::numeric_limits<float>::max())));
  }

  /// The largest depth at which a cell can sample a beam that ends at a depth [m].
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats last_depth(const Floats& depth, float farthest,
                                                              float behind) {
    return unfused(min_of(depth, farthest) * kSlack) + behind;
  }

  /// True if a smallest cell at this depth can sample a beam with this key. By the face itself, of any
  /// number; eight beams look up the few numbers of their faces in registers.
  [[nodiscard]] static bool may_be_sampled(const CubeFace<D>& face, std::uint32_t key, float depth,
                                           float smallest, float beams) {
    return face.fraction_below(face.bucket_of(key)) * face.expected_beams(depth, smallest) < beams;
  }
  void add_kept(std::size_t index) {
    kept_[num_kept_] = static_cast<std::uint32_t>(index);
    beams_.key[num_kept_] = beams_.key[index];
    beams_.face[num_kept_++] = beams_.face[index];
    ++kept_of_faces_[beams_.face[index]];
  }

#ifdef NDTREE_HAS_EIGHTS
  static constexpr std::size_t kNone = 2 * D;  // Stands for CubeMap::kNoFace.
  using OfFaces = std::array<float, std::max<std::size_t>(kNone + 1, 8)>;
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static EightFloats of_face(const OfFaces& values,
                                                                                 const EightInts& faces) {
    if constexpr (kNone < 8) {
      return one_of_eight(values.data(), faces);
    } else {
      const Offsets at(faces);
      const std::array<float, 8> eight{values[at[0]], values[at[1]], values[at[2]], values[at[3]],
                                       values[at[4]], values[at[5]], values[at[6]], values[at[7]]};
      return EightFloats::load(eight.data());
    }
  }
  /// Does keep()'s work for eight beams at a time. @pre at most 2 D faces.
  /// @returns the index of the first beam that is left.
  NDTREE_BY_EIGHTS std::size_t keep_by_eights(const CubeMap<D>& cube_map,
                                              const std::vector<std::uint32_t>& numbers, float smallest,
                                              float beams, float farthest, float behind) {
    OfFaces row;
    OfFaces key_masks;  // Bits of a key that its bucket keeps.
    std::array<OfFaces, kAxes> pixels_of_faces;
    row.fill(0.0f);
    key_masks.fill(0.0f);
    for (auto& of_axis : pixels_of_faces) of_axis.fill(0.0f);
    for (std::size_t f = 0; f < numbers.size(); ++f) {
      const CubeFace<D>& face = cube_map.face(numbers[f]);
      row[f] = face.is_single() ? 0.0f : smallest * face.density;
      const std::uint32_t bits = ~std::uint32_t{0} << face.key_shift;
      std::memcpy(&key_masks[f], &bits, sizeof bits);
      for (std::size_t k = 0; k < kAxes; ++k) pixels_of_faces[k][f] = face.pixels[k];
    }
    std::array<std::uint32_t, kNone + 1> kept_of_faces{};  // The last: of invalid beams.
    std::size_t i = 0;
    for (; i + 8 <= beams_.size; i += 8) {
      const EightInts face =
          unsigned_min_of(EightInts::load(beams_.face.get() + i), static_cast<std::uint32_t>(kNone));
      const EightFloats depth = last_depth(EightFloats::load(beams_.depth.get() + i), farthest, behind);
      EightFloats pixels[std::max<std::size_t>(kAxes, 1)];
      for (std::size_t k = 0; k < kAxes; ++k) pixels[k] = of_face(pixels_of_faces[k], face);
      const EightFloats expected =
          CubeFace<D>::expected_beams(EightFloats(of_face(row, face) / depth), pixels);
      const EightInts number = EightInts::load(beams_.key.get() + i);
      const EightInts bucket = number & bits_of(of_face(key_masks, face));
      const EightMask is_kept = (to_floats(bucket) * kKeyUnit * expected < beams) &
                                (EightInts(static_cast<std::uint32_t>(kNone)) > face);
      const unsigned set = is_kept.set();
      for (unsigned left = 0xff; left != 0;) {  // Adjacent beams mostly have the same face.
        const std::uint32_t one = std::min(beams_.face[i + static_cast<std::size_t>(__builtin_ctz(left))],
                                           static_cast<std::uint32_t>(kNone));
        const unsigned same = (face == EightInts(one)).set();
        kept_of_faces[one] += static_cast<std::uint32_t>(__builtin_popcount(same & set));
        left &= ~same;
      }
      const EightInts order = packing(set);
      (EightInts(static_cast<std::uint32_t>(i)) + order).store(kept_.get() + num_kept_);
      in_order(number, order).store(beams_.key.get() + num_kept_);
      in_order(face, order).store(beams_.face.get() + num_kept_);
      num_kept_ += static_cast<std::size_t>(__builtin_popcount(set));
    }
    std::copy_n(kept_of_faces.begin(), kept_of_faces_.size(), kept_of_faces_.begin());
    return i;
  }

  /// Replaces the kept beams' keys by buckets, eight at a time. Two loops, as for keep(): one asks its face,
  /// of any number; eight look their 2 D faces up in registers. @pre at most 2 D faces.
  /// @returns the first kept beam that is left.
  NDTREE_BY_EIGHTS std::size_t find_buckets_by_eights(const BeamBuckets<D>& buckets,
                                                      const std::vector<std::uint32_t>& numbers) {
    OfFaces first;
    OfFaces shift;
    first.fill(0.0f);
    shift.fill(0.0f);
    for (std::size_t f = 0; f < numbers.size(); ++f) {
      const CubeFace<D>& face = buckets.face(numbers[f]);
      const auto first_bucket = static_cast<std::uint32_t>(face.first_bucket);
      std::memcpy(&first[f], &first_bucket, sizeof first_bucket);
      std::memcpy(&shift[f], &face.key_shift, sizeof face.key_shift);
    }
    std::size_t k = 0;
    for (; k + 8 <= num_kept_; k += 8) {
      const EightInts face = EightInts::load(beams_.face.get() + k);
      std::uint32_t* const key = beams_.key.get() + k;
      const EightInts bucket = unsigned_shifted_right(EightInts::load(key), bits_of(of_face(shift, face)));
      (bucket + bits_of(of_face(first, face))).store(key);
    }
    return k;
  }
#endif

  const Measurements<D, Sensor>* measurements_ = nullptr;
  Eigen::Index first_ = 0;
  // After keep(), `face` and `key` begin with the kept beams' values; after count(), `key` holds buckets.
  SurveyedBeams<D> beams_;
  std::unique_ptr<std::uint32_t[]> kept_;  // Indices of the kept beams in the part, ascending.
  std::size_t num_kept_ = 0;
  std::vector<std::uint32_t> kept_of_faces_;
};

/// The survey of a whole scan, from those of its parts: with the largest noise as a margin behind the ends of
/// beams, which parts need, too. Only if that is more than the map can address, or a beam is too long for
/// float, survey_exactly() decides. The result is the same however the scan is divided, and contains the
/// exact reach.
/// @throws as survey_exactly().
template <class Geometry, int D, class Sensor>
[[nodiscard]] ScanSurvey<D> join_surveys(const Geometry& geometry, const Sensor& sensor,
                                         const Measurements<D, Sensor>& measurements,
                                         std::vector<ScanPart<D, Sensor>>& parts) {
  ScanSurvey<D> whole;
  float deepest = 0.0f;
  double sigma = 0.0;
  bool is_valid = true;
  for (const ScanPart<D, Sensor>& part : parts) {
    const SurveyedBeams<D>& beams = part.surveyed();
    whole.add(beams.survey);
    deepest = std::max(deepest, beams.deepest);
    sigma = std::max(sigma, beams.sigma);
    is_valid = is_valid && !beams.is_exact_needed;
  }
  if (whole.num_valid() == 0) return whole;
  const double reached = std::min(measurements.max_range(), std::sqrt(D) * static_cast<double>(deepest));
  if (measurements.scan().range_sigma == nullptr) sigma = std::max(sensor.sigma(0.0), sensor.sigma(reached));
  sigma = measurements.at_least(sigma);
  is_valid = is_valid && kRangeSigmaBounds.contain(sigma);
  const double margin =
      unfused(Sensor::kReachSigmas * sigma) + unfused(1e-6 * reached);  // Exceeds all rounding.
  is_valid = is_valid && reached + margin <= kLongestBeam * geometry.unit();
  whole.reach.lower.array() -= margin;
  whole.reach.upper.array() += margin;
  for (ScanPart<D, Sensor>& part : parts) part.set_reach_behind(static_cast<float>(margin));
  if (is_valid && geometry.in_reach(whole.reach.lower) && geometry.in_reach(whole.reach.upper)) return whole;
  return survey_exactly(geometry, measurements, measurements.all());
}

}  // namespace ndtree
