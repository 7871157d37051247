// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Every scan becomes an image: how densely its beams lie, by where they point.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <vector>

#include "ndtree/core/rounded.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// One side of a cube around an origin, through which beams go that point mainly along its axis: laser scans
/// in a plane, depth images, rings of lidars and unordered points, whatever order they come in. Depths are
/// measured along the axis, as in a depth image.
template <int D>
struct CubeFace {
  static constexpr std::size_t kAxes = D - 1;
  static constexpr float kSlack = 1.0f + 1e-5f;  ///< Of depths and of beams, above all rounding.
  static constexpr int kKeyBits = 24;            ///< Of the numbers that sampling_key_of() gives.

  Vector<D> origin;
  int axis = 0;
  bool negative = false;
  std::uint32_t num_beams = 0;
  std::array<float, kAxes> lower;  ///< Where beams meet the face, in [-1, 1] ...
  std::array<float, kAxes> upper;  ///< ... on each of its axes.
  float density = 0.0f;            ///< Places of one beam each, in a row of length 1.
  std::array<float, kAxes> places{};
  int key_shift = kKeyBits;  ///< Bits of a chance that do not count, see bucket_of().
  // After the beams were chosen:
  std::uint32_t end_of_beams = 0;  ///< Number of the one after the last of those that are kept.
  /// From this depth on, a cell takes all of them: one that is learning, or one that knows much [m].
  std::array<float, 2> depth_of_full_sample{};
  std::size_t first_bucket = 0;   ///< Of the beams that are kept, among those of all faces, see BeamBuckets.
  std::uint32_t num_buckets = 0;  ///< Up to that of the largest chance.

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

  /// After the last beam: as many square places as beams, over the part of the face that they go through.
  void divide() {
    if (num_beams == 0) return;
    while (key_shift > 0 && num_beams >> (kKeyBits + 1 - key_shift) != 0) --key_shift;
    constexpr double kNarrowest = 1e-6;
    double area = 1.0;  // Without axes that do not matter.
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
    width = std::max(width, widest / num_beams);  // No more on an axis than beams.
    density = static_cast<float>(1.0 / width);
    for (std::size_t k = 0; k < kAxes; ++k)
      places[k] = static_cast<float>(1.0 + std::floor(extent(k) / width));
  }

  /// At this depth and farther away, a cell of this size expects no more than so many beams [m].
  [[nodiscard]] float depth_for(float beams, float size) const {
    if constexpr (kAxes == 0) return beams >= 1.0f ? 0.0f : std::numeric_limits<float>::infinity();
    return is_single() ? 0.0f
                       : kSlack * size * density /
                             std::pow(beams, 1.0f / static_cast<float>(std::max<std::size_t>(1, kAxes)));
  }
  /// Chances are told apart in steps, a power of two of them, of one to two beams each in the mean: all beams
  /// of a step are in a sample, or none.
  [[nodiscard]] std::uint32_t bucket_of(std::uint32_t key) const { return key >> key_shift; }
  /// How many steps there are from chance 0 to 1.
  [[nodiscard]] float num_all_buckets() const {
    return static_cast<float>(std::uint32_t{1} << (kKeyBits - key_shift));
  }
  /// The share of beams that is below a step.
  [[nodiscard]] float fraction_below(std::uint32_t bucket) const {
    return static_cast<float>(bucket) / num_all_buckets();
  }
  /// Up to that of the largest chance that some cell up to a depth may take, of so many beams for each cell
  /// of the smallest size.
  [[nodiscard]] std::uint32_t buckets_within(float depth, float size, float beams) const {
    // Beams are kept with slack already; with as much again, none is kept that there is no step for.
    const float fraction = beams * (kSlack * kSlack) / expected_beams(depth, size);
    const float buckets = num_all_buckets();
    return fraction < 1.0f ? static_cast<std::uint32_t>(fraction * buckets) + 1
                           : static_cast<std::uint32_t>(buckets);
  }
  [[nodiscard]] float depth_of_full_sample_in_any_cell() const {
    return std::max(depth_of_full_sample[0], depth_of_full_sample[1]);
  }
  /// Beams that cross a cube of this size at a depth, if they are spread evenly over the face; none, so to
  /// speak, if there is but one.
  [[nodiscard]] float expected_beams(float depth, float size) const {
    if (is_single()) return 0.0f;
    const float row = size * density / depth;
    float expected = 1.0f;
    for (const float n : places) expected *= std::min(row, n);
    return expected;
  }
  /// Depth of a cell's centre, or half the cell's edge if that is more [m].
  /// @param near_border, far_border of the cell on the axis of the face [m].
  [[nodiscard]] float depth_of(double near_border, double far_border) const {
    const double half = 0.5 * (far_border - near_border);
    const double centre = rounded(0.5 * (near_border + far_border)) - origin[axis];
    return static_cast<float>(std::max(half, std::abs(centre)));
  }
  /// Edge of the square that a beam stands for at depth 1: its share of the solid angle, but not more than a
  /// tenth. Of a single beam nobody knows it: 0.
  [[nodiscard]] float width_of_beam() const {
    constexpr float kWidest = 0.1f;
    return is_single() ? 0.0f : std::min(kWidest, 1.0f / density);
  }
  [[nodiscard]] bool is_single() const { return num_beams == 1; }

 private:
  [[nodiscard]] double extent(std::size_t k) const {
    return static_cast<double>(upper[k]) - static_cast<double>(lower[k]);
  }
};

/// The faces that beams go through, of cubes around every origin, numbered as they are asked for.
template <int D>
class CubeMap {
 public:
  static constexpr std::uint32_t kNoFace = 0xffffffffu;  ///< No face has this number.

  [[nodiscard]] std::size_t cube_of(const Vector<D>& origin) {
    if (cubes_.empty() || origin != last_origin_) {
      std::array<double, std::size_t{D}> key;
      for (int a = 0; a < D; ++a) key[static_cast<std::size_t>(a)] = origin[a];
      const auto [found, is_new] = cubes_.emplace(key, cubes_.size());
      if (is_new) number_.resize(number_.size() + 2 * D, kNoFace);
      last_origin_ = origin;
      last_cube_ = found->second;
    }
    return last_cube_;
  }
  /// The number of a face of a cube. @param side 2 axis + 1 if negative.
  std::uint32_t face_of(std::size_t cube, const Vector<D>& origin, std::size_t side) {
    std::uint32_t& number = number_[2 * D * cube + side];
    if (number == kNoFace) {
      number = static_cast<std::uint32_t>(faces_.size());
      faces_.emplace_back(origin, static_cast<int>(side / 2), side % 2 != 0);
    }
    return number;
  }
  /// Numbers the faces of the first cube by their sides.
  void add_all_faces(const Vector<D>& origin) {
    const std::size_t cube = cube_of(origin);
    faces_.reserve(2 * D);
    for (std::size_t side = 0; side < 2 * D; ++side) face_of(cube, origin, side);
  }
  [[nodiscard]] std::vector<CubeFace<D>>& faces() { return faces_; }
  [[nodiscard]] const std::vector<CubeFace<D>>& faces() const { return faces_; }
  [[nodiscard]] const CubeFace<D>& face(std::uint32_t number) const { return faces_[number]; }

  /// Adds another image's faces. @returns the numbers that they have here.
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
  std::map<std::array<double, std::size_t{D}>, std::size_t> cubes_;  // By origin.
  std::vector<std::uint32_t> number_;                                // 2 D of each.
  std::vector<CubeFace<D>> faces_;
  Vector<D> last_origin_ = Vector<D>::Zero();
  std::size_t last_cube_ = 0;
};

}  // namespace ndtree
