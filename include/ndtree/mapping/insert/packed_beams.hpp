// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The kept beams of a scan, packed: sorted by face and bucket, as rows of tables.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/insert/beam_rows.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// The smallest cell in which a returned beam is a hit: the one right behind its end point. It contains the
/// end point, unless this lies, within rounding, on the border through which the beam leaves the cell: then
/// it is the cell behind. A surface on a border is thus the front of the cell behind it, seen from either
/// side, and mirrored scans make mirrored maps.
template <int N, int D>
[[nodiscard]] Lattice<D> cell_of_hit(const LatticeGeometry<N, D>& geometry, const Beam<D>& beam) {
  Lattice<D> cell = geometry.coordinates(beam.endpoint);
  for (std::size_t a = 0; a < D; ++a) {
    const double x = beam.endpoint[static_cast<int>(a)];
    const double d = beam.displacement[static_cast<int>(a)];
    const double rounding = geometry.rounding_at(x);
    if (d < 0.0 && x - geometry.border(cell[a]) <= rounding)
      --cell[a];
    else if (d > 0.0 && geometry.border(cell[a] + 1) - x <= rounding)
      ++cell[a];
  }
  return cell;
}

/// The kept beams of a scan by number, in two tables: a row of 16 bytes that partitioning reads, a row of 32
/// bytes that leaves near the beam's end read (see beam_rows.hpp; sizes up to 3-D).
///
/// Strategy: beams are numbered in the order of the counting sort, so that a cell samples a prefix of each
/// face's beams, and end_of_fraction() finds the prefix's end by one look-up. Threads write disjoint ranges.
/// Invariants: numbers ascend by face, then by bucket, then in the order of the scan; all rows are written by
/// set() or set_eight(), with the same bits, between resize() and finish(), and are constant afterwards.
/// Distances are in metres from the origin along the beam, as floats: no sensor measures directions to 24
/// bits. Cost: O(1) for each beam; memory 52 bytes for each, more if beams have origins or noise of their
/// own.
template <int D>
class ScanBeams {
 public:
  static constexpr std::size_t kColumnsOfRay = sizeof(BeamRay<D>) / sizeof(float);

  [[nodiscard]] std::size_t size() const { return size_; }
  /// Number of beams that loops take at a time: 1 if there are more beams than vectors of int32 can number.
  [[nodiscard]] int width() const { return size_ <= kMostInLoops ? Simd::width() : 1; }
  static constexpr std::uint32_t kMostInLoops = 0x7fffffff;
  /// Makes room for n beams, whose rows set() or set_eight() writes.
  /// @param faces of the beams, with end_of_beams. Face 0 stands for all faces with a single beam.
  /// @param bucket_begins number of the first beam of each bucket of each face, and behind them n.
  /// @param have_own_origins true if the scan has an origin for each beam.
  /// @param base smallest cell relative to which end cells are stored. @param fit_32_bits see
  /// ends_fit_32_bits().
  /// @param have_own_noise true if the scan has a range_sigma for each beam.
  void resize(std::size_t n, std::vector<CubeFace<D>> faces, std::vector<std::uint32_t> bucket_begins,
              bool have_own_origins, const Lattice<D>& base, bool fit_32_bits, bool have_own_noise) {
    size_ = n;
    faces_ = std::move(faces);
    bucket_begins_ = std::move(bucket_begins);
    rays_.reset(new BeamRay<D>[n]);  // Not initialised; set() writes it.
    ends_.reset(new BeamEnd<D>[n]);
    t_free_.reset(have_own_noise ? new float[n] : nullptr);
    face_numbers_.reset(new std::uint32_t[n]);
    std::uint32_t number = 0;
    for (std::size_t first = 0; number < faces_.size(); first = faces_[number++].end_of_beams)
      std::fill(face_numbers_.get() + first, face_numbers_.get() + faces_[number].end_of_beams, number);
    cells_.reset(fit_32_bits ? nullptr : new Lattice<D>[n]);
    ends_fit_32_bits_ = fit_32_bits;
    has_own_origins_ = have_own_origins;
    origins_.resize(have_own_origins ? n : std::min<std::size_t>(n, 1));
    base_ = base;
  }

  /// Writes the rows of a beam of any kind: also one that is cut, ends on a border, or has an origin or noise
  /// of its own, for which set_eight() has no steps.
  /// @param i index of the beam in the scan; a valid beam. @param noise to which the beam's is added.
  template <int N, class Sensor>
  void set(std::size_t number, const LatticeGeometry<N, D>& geometry, const Sensor& sensor,
           const Measurements<D, Sensor>& measurements, Eigen::Index i, BeamNoise& noise) {
    const Beam<D> beam = measurements.beam(i);
    const bool returned = beam.outcome == BeamOutcome::returned;
    float square = 0.0f;
    float depth = 0.0f;
    std::array<float, std::size_t{D}> ray;
    for (std::size_t a = 0; a < D; ++a) {
      ray[a] = static_cast<float>(beam.displacement[static_cast<int>(a)]);
      square += unfused(ray[a] * ray[a]);
      depth = std::max(depth, std::abs(ray[a]));
    }
    // The square exceeds floats for a beam over 3e18 m: it is cut, or made up.
    constexpr auto kMost = static_cast<double>(std::numeric_limits<float>::max());
    const float range = square >= kLeastSquare && square <= kLargestSquare
                            ? std::sqrt(square)
                            : static_cast<float>(std::min(beam.range, kMost));
    float length = range;
    if (!(square <= kLargestSquare)) {
      length = 1.0f;
      depth = 0.0f;
      for (std::size_t a = 0; a < D; ++a) {
        ray[a] = static_cast<float>(beam.displacement[static_cast<int>(a)] / beam.range);
        depth = std::max(depth, std::abs(ray[a]));
      }
    }
    for (std::size_t a = 0; a < D; ++a) {
      const float inverse = std::min(length / std::abs(ray[a]), kSteepest);
      rays_[number].inverse[a] = ray[a] < 0.0f ? -inverse : inverse;
    }
    const float end = beam.t_free < 1.0 ? static_cast<float>(beam.t_free * beam.range) : range;
    const double sigma = measurements.sigma(i, static_cast<double>(end));
    set_range(
        number, returned, end, depth / length, static_cast<float>(sigma),
        returned ? static_cast<float>(sensor.clearly_free_until(static_cast<double>(end), sigma)) : end,
        returned ? static_cast<float>(static_cast<double>(end) + unfused(Sensor::kReachSigmas * sigma)) : end,
        noise);
    const Lattice<D> cell = returned ? cell_of_hit(geometry, beam) : geometry.coordinates(beam.free_end());
    if (!ends_fit_32_bits_) cells_[number] = cell;
    for (std::size_t a = 0; a < D; ++a)
      ends_[number].cell[a] = ends_fit_32_bits_ ? static_cast<std::int32_t>(cell[a] - base_[a]) : 0;
    if (has_own_origins_ || number == 0) origins_[number] = beam.origin;
  }

#ifdef NDTREE_HAS_EIGHTS
  /// Writes the rows of eight beams, with the same bits as set().
  /// @param numbers indices of these beams in the scan. @param returned the set of those that did.
  /// @pre the scan has one origin and no range_sigma, and ends_fit_32_bits().
  /// @returns false, with nothing written, if set() must write them: a beam is cut, or ends on a border.
  template <int N, class Sensor>
  NDTREE_BY_EIGHTS bool set_eight(std::size_t number, const LatticeGeometry<N, D>& geometry,
                                  const Sensor& sensor, const Measurements<D, Sensor>& measurements,
                                  const std::uint32_t* numbers, unsigned returned, BeamNoise& noise) {
    const ScanView<D>& scan = measurements.scan();
    EightFloats ray[std::size_t{D}];
    EightFloats square = 0.0f;
    EightFloats depth = 0.0f;
    FourMask on_border = FourMask::none();
    EightRays<D> rays;
    EightEnds<D> ends;
#pragma GCC unroll 4
    for (int a = 0; a < D; ++a) {
      const double* const from = scan.endpoints + a;
      const FourDoubles low =
          FourDoubles::of(from[D * std::size_t{numbers[0]}], from[D * std::size_t{numbers[1]}],
                          from[D * std::size_t{numbers[2]}], from[D * std::size_t{numbers[3]}]);
      const FourDoubles high =
          FourDoubles::of(from[D * std::size_t{numbers[4]}], from[D * std::size_t{numbers[5]}],
                          from[D * std::size_t{numbers[6]}], from[D * std::size_t{numbers[7]}]);
      const FourDoubles origin = scan.origins[a];
      ray[a] = to_floats(low - origin, high - origin);
      square = square + ray[a] * ray[a];
      depth = max_of(depth, abs_of(ray[a]));
      FourMask low_on_border;
      FourMask high_on_border;
      const FourDoubles base = static_cast<double>(base_[static_cast<std::size_t>(a)]);
      ends.cell[a] = to_ints(geometry.coordinate(low, low_on_border) - base,
                             geometry.coordinate(high, high_on_border) - base);
      on_border = on_border | (low_on_border | high_on_border);
    }
    const EightMask fits = (square >= kLeastSquare) & (square <= kLargestSquare);
    if (on_border.set() != 0 || fits.set() != 0xff) return false;
    const EightFloats range = sqrt_of(square);
    const auto surely_in_range = static_cast<float>(measurements.max_range() * (1.0 - 1e-6));
    if ((range <= surely_in_range).set() != 0xff) return false;
#pragma GCC unroll 4
    for (int a = 0; a < D; ++a)
      rays.inverse[a] =
          with_sign(min_of(range / abs_of(ray[a]), kSteepest), EightFloats(-0.0f) & (ray[a] < 0.0f));
    const EightDoubles of_range = to_doubles(range);
    const FourDoubles low_sigma = measurements.sigma_at(of_range.low);
    const FourDoubles high_sigma = measurements.sigma_at(of_range.high);
    ends.sigma = to_floats(low_sigma, high_sigma);
    const EightMask ends_at_surface = EightMask::of_set(returned);
    ends.clearly_free_until = select(ends_at_surface,
                                     to_floats(sensor.clearly_free_until(of_range.low, low_sigma),
                                               sensor.clearly_free_until(of_range.high, high_sigma)),
                                     range);
    ends.surface = static_cast<float>(kThinnestSurface) * ends.sigma & ends_at_surface;
    ends.range = range;
    ends.slant = depth / range;
    rays.t_max = select(ends_at_surface,
                        to_floats(of_range.low + Sensor::kReachSigmas * low_sigma,
                                  of_range.high + Sensor::kReachSigmas * high_sigma),
                        range);
    noise.add(ends.sigma, rays.t_max, ends.clearly_free_until - ends.surface);
    store(rays, ends, number);
    return true;
  }
  /// The BeamRay rows of eight beams.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE EightRays<D> rays(const std::uint32_t* numbers) const {
    return rays(rays(), numbers);
  }
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static EightRays<D> rays(const BeamRay<D>* of_all,
                                                                               const std::uint32_t* numbers) {
    EightFloats column[kColumnsOfRay];
    load_columns(of_all, numbers, column);
    EightRays<D> rays;
#pragma GCC unroll 8
    for (std::size_t a = 0; a < D; ++a) rays.inverse[a] = column[a];
    rays.t_max = column[D];
    return rays;
  }
  /// The BeamEnd rows of eight beams.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE EightEnds<D> ends(const std::uint32_t* numbers) const {
    EightFloats column[kColumnsOfEnd];
    load_columns(ends_.get(), numbers, column);
    EightEnds<D> ends{column[0], column[1], column[2], column[3], column[4], {}};
#pragma GCC unroll 8
    for (std::size_t a = 0; a < D; ++a) ends.cell[a] = bits_of(column[5 + a]);
    return ends;
  }
  /// t_free of eight beams, read from memory if beams have noise of their own.
  /// @param numbers of the beams. @param t_max of these beams [m].
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE EightFloats t_free_of(const std::uint32_t* numbers,
                                                                            const EightFloats& t_max) const {
    if (t_free_ == nullptr) return t_free_at(t_max);
    std::array<float, 8> t_free;
    for (std::size_t i = 0; i < 8; ++i) t_free[i] = t_free_[numbers[i]];
    return EightFloats::load(t_free.data());
  }
  /// Starts a ray packet: reads the rows of eight beams that inner nodes need.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void look_up(const std::uint32_t* numbers,
                                                    EightBeams<D>& beams) const {
    std::copy_n(numbers, beams.number.size(), beams.number.begin());
    beams.rays = rays(numbers);
    beams.t_free = t_free_of(numbers, beams.rays.t_max);
  }
  /// The BeamEnd rows of a ray packet, read when they are first asked for.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE const EightEnds<D>& ends_of(
      EightBeams<D>& beams) const {
    if (!beams.has_ends) beams.ends = ends(beams.number.data());
    beams.has_ends = true;
    return beams.ends;
  }
#endif

  /// Called after the last beam. @param noise of all beams. @param finest_level see finest_level().
  void finish(const BeamNoise& noise, int finest_level) {
    finest_level_ = finest_level;
    smallest_sigma_ = noise.smallest();
    largest_sigma_ = noise.largest();
    margin_ = noise.margin();
  }
  /// Level of the cells that the scan does not split: they are smallest cells, or children would be smaller
  /// than its noise.
  [[nodiscard]] int finest_level() const { return finest_level_; }
  /// The smallest standard deviation of a beam's range [m].
  [[nodiscard]] float smallest_sigma() const { return smallest_sigma_; }
  /// The largest [m].
  [[nodiscard]] float largest_sigma() const { return largest_sigma_; }

  /// True if each beam has an origin of its own.
  [[nodiscard]] bool has_own_origins() const { return has_own_origins_; }
  /// True if no beam has an origin or noise of its own.
  [[nodiscard]] bool are_alike() const { return !has_own_origins_ && t_free_ == nullptr; }
  [[nodiscard]] const Vector<D>& origin(std::size_t number) const {
    return origins_[has_own_origins_ ? number : 0];
  }
  [[nodiscard]] const CubeFace<D>& face_of(std::size_t number) const { return faces_[face_numbers_[number]]; }
  /// Numbers of the first beams of a face's buckets, and of the one after its last beam.
  [[nodiscard]] const std::uint32_t* bucket_begins(const CubeFace<D>& face) const {
    return bucket_begins_.data() + face.first_bucket;
  }
  /// One more than the number of the last beam of the sample that is this fraction of a face's beams. O(1).
  [[nodiscard]] NDTREE_ALWAYS_INLINE std::uint32_t end_of_fraction(const CubeFace<D>& face,
                                                                   float fraction) const {
    if (!(fraction < 1.0f)) return face.end_of_beams;
    const float buckets = fraction * face.num_all_buckets();
    auto num_buckets = static_cast<std::uint32_t>(buckets);
    num_buckets += static_cast<float>(num_buckets) < buckets;
    return bucket_begins(face)[std::min(num_buckets, face.num_buckets)];
  }
  /// The smallest cell that a beam ends in: for returned beams cell_of_hit().
  [[nodiscard]] Lattice<D> end_cell(std::size_t number) const {
    if (!ends_fit_32_bits_) return cells_[number];
    Lattice<D> cell = base_;
    for (std::size_t a = 0; a < D; ++a) cell[a] += ends_[number].cell[a];
    return cell;
  }

  /// The rows of all beams, by number.
  [[nodiscard]] const BeamRay<D>* rays() const { return rays_.get(); }
  [[nodiscard]] const BeamRay<D>& ray(std::size_t number) const { return rays_[number]; }
  [[nodiscard]] const BeamEnd<D>& end(std::size_t number) const { return ends_[number]; }
  /// t_free of one beam: it has passed all cells, of any size, that it leaves before this distance.
  [[nodiscard]] float t_free_of(std::uint32_t number) const {
    return t_free_ != nullptr ? t_free_[number] : t_free_at(rays_[number].t_max);
  }
  /// t_free of one beam or several, from t_max with one margin for all beams, which saves reading another
  /// number for each. @pre no beam has noise of its own.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats t_free_at(const Floats& t_max) const {
    return t_max - (margin_.fixed + unfused(unfused(margin_.growth * t_max) * t_max));
  }

  /// Prefetches the rows of a list's beams, all at once, since another core may have written them.
  void fetch(const std::uint32_t* numbers, std::size_t count) const {
    for (std::size_t i = 0; i < count; ++i) {
      prefetch<1>(&rays_[numbers[i]]);
      prefetch<1>(&ends_[numbers[i]]);
    }
  }

  /// True if all end cells are at most kNearby smallest cells from the base on each axis.
  [[nodiscard]] bool ends_fit_32_bits() const { return ends_fit_32_bits_; }
  [[nodiscard]] const Lattice<D>& base() const { return base_; }
  static constexpr std::int64_t kNearby = std::int64_t{1} << 29;

 private:
  static constexpr float kSteepest = 1e12f;  // Stands for 1 / 0; its product with 0 is not NaN.
  static constexpr float kLeastSquare = 1e-36f;
  static constexpr float kLargestSquare = 1e37f;

  /// Writes a beam's distances and noise. @param t_max, clearly_free_until see beam_rows.hpp [m].
  void set_range(std::size_t number, bool returned, float end, float slant, float sigma,
                 float clearly_free_until, float t_max, BeamNoise& noise) {
    const float surface = returned ? unfused(static_cast<float>(kThinnestSurface) * sigma) : 0.0f;
    noise.add(sigma, t_max, clearly_free_until - surface);
    if (t_free_ != nullptr) t_free_[number] = clearly_free_until - surface;
    rays_[number].t_max = t_max;
    BeamEnd<D>& of_end = ends_[number];
    of_end.range = end;
    of_end.slant = slant;
    of_end.clearly_free_until = clearly_free_until;
    of_end.surface = surface;
    of_end.sigma = sigma;
  }

#ifdef NDTREE_HAS_EIGHTS
  static constexpr std::size_t kColumnsOfEnd = sizeof(BeamEnd<D>) / sizeof(float);

  /// Writes the rows of beams [number, number + 8).
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE void store(const EightRays<D>& rays, const EightEnds<D>& ends,
                                                   std::size_t number) {
    EightFloats ray[kColumnsOfRay];
    EightFloats end[kColumnsOfEnd];
#pragma GCC unroll 8
    for (EightFloats& column : ray) column = 0.0f;
#pragma GCC unroll 8
    for (EightFloats& column : end) column = 0.0f;
    end[0] = ends.range;
    end[1] = ends.slant;
    end[2] = ends.clearly_free_until;
    end[3] = ends.surface;
    end[4] = ends.sigma;
#pragma GCC unroll 8
    for (std::size_t a = 0; a < D; ++a) {
      ray[a] = rays.inverse[a];
      end[5 + a] = float_of(ends.cell[a]);
    }
    ray[D] = rays.t_max;
    store_columns(ray, rays_.get() + number);
    store_columns(end, ends_.get() + number);
  }
#endif

  std::size_t size_ = 0;
  std::unique_ptr<BeamRay<D>[]> rays_;
  std::unique_ptr<BeamEnd<D>[]> ends_;
  std::unique_ptr<float[]> t_free_;  // See t_free_of(); null if no beam has noise of its own.
  std::unique_ptr<std::uint32_t[]> face_numbers_;
  std::unique_ptr<Lattice<D>[]> cells_;  // End cells; null if ends_fit_32_bits_.
  std::vector<CubeFace<D>> faces_;
  std::vector<std::uint32_t> bucket_begins_;  // And the number of beams.
  std::vector<Vector<D>> origins_;            // One, or one for each beam.
  Lattice<D> base_{};
  bool has_own_origins_ = false;
  bool ends_fit_32_bits_ = true;
  int finest_level_ = 0;
  float smallest_sigma_ = std::numeric_limits<float>::infinity();
  float largest_sigma_ = 0.0f;
  FreeMargin margin_;
};

}  // namespace ndtree
