// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The cube map of a scan: how many beams meet each face, and how many a cell there expects.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <vector>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// One side of a cube around an origin, and the beams from this origin that point mainly along its axis.
///
/// Strategy: every scan is treated as a depth image, be it a laser scan in a plane, a depth image, the rings
/// of a lidar or unordered points. The part of the face that its beams pass through is divided into about
/// as many square pixels as there are beams, so that a cell expects as many beams as it covers pixels.
/// Invariants: num_beams, lower and upper do not depend on the order of the beams; make_pixels() is called
/// once, after the last beam; functions that use pixels or buckets are called afterwards; depths are measured
/// along the axis [m]. Cost: a few operations per axis for each function; no memory of its own.
template <int D>
struct CubeFace {
  static constexpr std::size_t kAxes = D - 1;
  static constexpr float kSlack = 1.0f + 1e-5f;  ///< Factor on depths and beams that exceeds all rounding.
  static constexpr int kKeyBits = 24;            ///< Bits of a sampling key, see sampling_key_of().

  Vector<D> origin;
  int axis = 0;
  bool negative = false;
  std::uint32_t num_beams = 0;
  std::array<float, kAxes> lower;  ///< Least coordinate on each axis where a beam meets the face, in [-1, 1].
  std::array<float, kAxes> upper;  ///< The largest.
  float density = 0.0f;            ///< Pixels in a row of length 1; each holds one beam in the mean.
  std::array<float, kAxes> pixels{};  ///< Number of pixels on each axis.
  int key_shift = kKeyBits;           ///< Low bits of a sampling key that bucket_of() leaves out.
  // Set after subsampling:
  std::uint32_t end_of_beams = 0;  ///< One more than the number of the face's last kept beam.
  /// Least depth from which on a cell samples all beams of the face [m]: [0] for cells with the large
  /// sample, [1] for those with the small one, see SamplingRate.
  std::array<float, 2> depth_of_full_sample{};
  std::size_t first_bucket = 0;   ///< Index of the first bucket among those of all faces, see BeamBuckets.
  std::uint32_t num_buckets = 0;  ///< Buckets from key 0 on, enough for all kept beams.

  CubeFace(const Vector<D>& from, int along, bool is_negative)
      : origin(from), axis(along), negative(is_negative) {
    lower.fill(std::numeric_limits<float>::infinity());
    upper.fill(-std::numeric_limits<float>::infinity());
  }

  void add(const CubeFace& other) {
    num_beams += other.num_beams;
    for (std::size_t k = 0; k < kAxes; ++k) {
      lower[k] = std::min(lower[k], other.lower[k]);
      upper[k] = std::max(upper[k], other.upper[k]);
    }
  }

  /// Divides the part of the face that the beams pass through into about num_beams square pixels, and the
  /// keys into buckets. Called after the last beam.
  void make_pixels() {
    if (num_beams == 0) return;
    while (key_shift > 0 && num_beams >> (kKeyBits + 1 - key_shift) != 0) --key_shift;
    constexpr double kNarrowest = 1e-6;
    constexpr float kWidest = 0.1f;  // Width of a beam.
    double area = 1.0;               // Of the axes on which the beams differ.
    double widest = 0.0;
    int axes = 0;
    for (std::size_t k = 0; k < kAxes; ++k) {
      const double extent = this->extent(k);
      widest = std::max(widest, extent);
      if (extent <= kNarrowest) continue;
      area *= extent;
      ++axes;
    }
    double width = axes == 0 ? 1.0 : std::max(kNarrowest, std::pow(area / num_beams, 1.0 / axes));
    width = std::max(width, widest / num_beams);  // At most num_beams pixels on an axis.
    density = static_cast<float>(1.0 / width);
    width_of_beam_ = num_beams == 1 ? 0.0f : std::min(kWidest, static_cast<float>(evenness()) / density);
    for (std::size_t k = 0; k < kAxes; ++k)
      pixels[k] = static_cast<float>(1.0 + std::floor(extent(k) / width));
  }

  /// The depth from which on a cell of this size expects at most `beams` beams [m].
  [[nodiscard]] float depth_for(float beams, float size) const {
    if constexpr (kAxes == 0) return beams >= 1.0f ? 0.0f : std::numeric_limits<float>::infinity();
    return is_single() ? 0.0f
                       : kSlack * size * density /
                             std::pow(beams, 1.0f / static_cast<float>(std::max<std::size_t>(1, kAxes)));
  }
  /// The bucket of a key, in [0, num_all_buckets()). A cell samples all beams of a bucket or none.
  [[nodiscard]] std::uint32_t bucket_of(std::uint32_t key) const { return key >> key_shift; }
  /// Number of buckets of all keys: a power of two, so that a bucket has one to two beams in the mean.
  [[nodiscard]] float num_all_buckets() const {
    return static_cast<float>(std::uint32_t{1} << (kKeyBits - key_shift));
  }
  /// The sampling fraction that ends before a bucket.
  [[nodiscard]] float fraction_below(std::uint32_t bucket) const {
    return static_cast<float>(bucket) / num_all_buckets();
  }
  /// Number of buckets that a cell up to this depth can sample, from key 0 on.
  /// @param beams that a cell samples for each smallest cell side by side in it. @param size of a smallest
  ///   cell [m].
  [[nodiscard]] std::uint32_t buckets_within(float depth, float size, float beams) const {
    // Subsampling keeps beams up to a slack; twice that slack here gives every kept beam a bucket.
    const float fraction = beams * (kSlack * kSlack) / expected_beams(depth, size);
    const float buckets = num_all_buckets();
    return fraction < 1.0f ? static_cast<std::uint32_t>(fraction * buckets) + 1
                           : static_cast<std::uint32_t>(buckets);
  }
  /// The depth from which on every cell samples all beams of the face, well observed or not [m].
  [[nodiscard]] float depth_of_full_sample_in_any_cell() const {
    return std::max(depth_of_full_sample[0], depth_of_full_sample[1]);
  }
  /// Number of beams that cross a cube of this size at a depth, if they are spread evenly over the face. 0 if
  /// the face has a single beam, so that every cell samples it.
  [[nodiscard]] float expected_beams(float depth, float size) const {
    if (is_single()) return 0.0f;
    return expected_beams(size * density / depth, pixels.data());
  }
  /// expected_beams() of one cube or several. @param row pixels side by side in the cube.
  /// @param pixels on each axis of the face.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats expected_beams(const Floats& row, const Floats* pixels) {
    Floats expected = 1.0f;
    for (std::size_t k = 0; k < kAxes; ++k) expected = expected * min_of(row, pixels[k]);
    return expected;
  }
  /// Depth of a cell's centre, or half the cell's edge if that is more [m].
  /// @param near_border, far_border of the cell on the axis of the face [m].
  [[nodiscard]] float depth_of(double near_border, double far_border) const {
    const double half = 0.5 * (far_border - near_border);
    const double centre = unfused(0.5 * (near_border + far_border)) - origin[axis];
    return static_cast<float>(std::max(half, std::abs(centre)));
  }
  /// Edge of the square that a beam stands for at depth 1: that of a pixel, at most 0.1. 0 for a single beam,
  /// whose solid angle is unknown. In a plane it is the width along the axis, see evenness().
  [[nodiscard]] float width_of_beam() const { return width_of_beam_; }
  [[nodiscard]] bool is_single() const { return num_beams == 1; }

 private:
  float width_of_beam_ = 0.0f;

  [[nodiscard]] double extent(std::size_t k) const {
    return static_cast<double>(upper[k]) - static_cast<double>(lower[k]);
  }
  /// In a plane, beams are evenly spaced by angle: on the face, 1 + u² times as far apart at u as in the
  /// middle. This is the mean of its inverse, by Simpson's rule: the same on all machines.
  [[nodiscard]] double evenness() const {
    if constexpr (D != 2) {
      return 1.0;
    } else {
      double sum = 0.0;
      constexpr int kWeights[] = {1, 4, 2, 4, 1};
      for (int i = 0; i < 5; ++i) {
        const double at = static_cast<double>(lower[0]) + unfused(0.25 * i * extent(0));
        sum += kWeights[i] / (1.0 + unfused(at * at));
      }
      return sum / 12.0;
    }
  }
};

/// The cube-map faces of a scan's beams, with one cube around each origin.
///
/// Strategy: a map finds an origin's cube by its coordinates; the last origin is remembered, since successive
/// beams mostly have the same. A face is added when its first beam asks for it.
/// Invariants: a face keeps its number; faces are numbered in the order in which they were added.
/// Cost: O(1) for a beam that starts where the one before did, else O(log n) for n origins.
template <int D>
class CubeMap {
 public:
  static constexpr std::uint32_t kNoFace = 0xffffffffu;  ///< No face has this number.

  /// The number of the cube around an origin, which is added if it is missing.
  [[nodiscard]] std::size_t cube_of(const Vector<D>& origin) {
    if (cubes_.empty() || origin != last_origin_) {
      std::array<double, std::size_t{D}> key;
      for (int a = 0; a < D; ++a) key[static_cast<std::size_t>(a)] = origin[a];
      const auto [found, is_new] = cubes_.emplace(key, cubes_.size());
      if (is_new) numbers_.resize(numbers_.size() + 2 * D, kNoFace);
      last_origin_ = origin;
      last_cube_ = found->second;
    }
    return last_cube_;
  }
  /// The number of a face of a cube; the face is added if it is missing.
  /// @param side 2 axis, plus 1 for beams along the negative axis.
  std::uint32_t face_of(std::size_t cube, const Vector<D>& origin, std::size_t side) {
    std::uint32_t& number = numbers_[2 * D * cube + side];
    if (number == kNoFace) {
      number = static_cast<std::uint32_t>(faces_.size());
      faces_.emplace_back(origin, static_cast<int>(side / 2), side % 2 != 0);
    }
    return number;
  }
  /// Adds all faces of the cube around an origin. @pre no face was added: a face's number is its side.
  void add_all_faces(const Vector<D>& origin) {
    const std::size_t cube = cube_of(origin);
    faces_.reserve(2 * D);
    for (std::size_t side = 0; side < 2 * D; ++side) face_of(cube, origin, side);
  }
  [[nodiscard]] std::vector<CubeFace<D>>& faces() { return faces_; }
  [[nodiscard]] const std::vector<CubeFace<D>>& faces() const { return faces_; }
  [[nodiscard]] const CubeFace<D>& face(std::uint32_t number) const { return faces_[number]; }

  /// Adds the beams of another cube map, face by face. @returns here the numbers of its faces, in its order.
  std::vector<std::uint32_t> join(const CubeMap& other) {
    std::vector<std::uint32_t> numbers;
    numbers.reserve(other.faces_.size());
    faces_.reserve(std::max(faces_.capacity(), other.faces_.size()));
    for (const CubeFace<D>& face : other.faces_) {
      numbers.push_back(face_of(cube_of(face.origin), face.origin,
                                2 * static_cast<std::size_t>(face.axis) + face.negative));
      faces_[numbers.back()].add(face);
    }
    return numbers;
  }

 private:
  std::map<std::array<double, std::size_t{D}>, std::size_t> cubes_;  // Cube numbers by origin.
  std::vector<std::uint32_t> numbers_;                               // Face numbers, 2 D for each cube.
  std::vector<CubeFace<D>> faces_;
  Vector<D> last_origin_ = Vector<D>::Zero();
  std::size_t last_cube_ = 0;
};

}  // namespace ndtree
