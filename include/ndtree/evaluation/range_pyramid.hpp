// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How far a scan surely saw in each direction: images of ranges on a cube map, at several resolutions.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ndtree/core/rounded.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// What the beams of one origin say about space, by direction.
///
/// A cube around the origin is divided into pixels. Each holds the least and the largest distance up to which
/// its beams surely passed; a pixel of the next level holds those of 2^(D-1) pixels. The finest pixels are
/// about as wide as the beams are apart. A pixel without a beam is a hole: a level takes holes over only
/// where all of its pixel's parts are one, but pixels wider than kWidestGap also where one part is, so that
/// nothing is said across a gap between beams that are far apart, or did not measure.
///
/// A point is in view of a level if beams surround it there: of the 3^(D-1) pixels around its direction, each
/// side has one with a beam, and most have. Then the least of their distances says how far the space around
/// the point was surely passed. Around an edge of the cube, pixels of two faces do not line up, and a beam
/// may be overlooked. Coordinates are relative to any base near the scan [m].
template <int D>
class RangePyramid {
 public:
  using Point = Eigen::Matrix<float, D, 1>;

  /// Starts anew, with another origin.
  void reset(const Point& origin) {
    origin_ = origin;
    beams_.clear();
    farthest_ = 0.0F;
  }

  /// A beam in a direction of any length but zero, which surely passed up to a distance >= 0 [m].
  void add(const Point& direction, float sure) {
    Beam beam;
    beam.face = face_of(direction, beam.place);
    beam.sure = sure;
    beams_.push_back(beam);
    farthest_ = std::max(farthest_, sure);
  }

  /// Ends a scan: answers are about the beams since reset(). O(beams + pixels of the faces with beams).
  void build();

  /// Up to where beams around a point surely passed [m], negative if the point is not surrounded by beams, or
  /// if that is less than `least`.
  /// @param distance of the point from the origin [m]. @param radius of what must be in view around it [m].
  [[nodiscard]] float surely_passed(const Point& point, float distance, float radius, float least) const;

  /// Whether no beam near a ball surely passed farther than `distance` from the origin: nothing can be said
  /// of what is in it. May be false although it is so.
  [[nodiscard]] bool hides(const Point& center, float radius, float distance) const;

 private:
  static constexpr std::size_t kFaces = 2 * D;
  static constexpr std::size_t kAround = D == 3 ? 9 : 3;  // Pixels that surround a direction, with its own.
  static constexpr int kCoarsest = 4;                     // Pixels along a side of a face.
  static constexpr int kFinest = D == 3 ? 512 : 4096;
  static constexpr int kWidestGap = 16;  // As kCoarsest, of the coarsest level that bridges gaps.
  static constexpr int kLeastInView = D == 3 ? 5 : 2;  // Of the pixels that surround a direction.
  static constexpr float kHole = std::numeric_limits<float>::infinity();

  static constexpr std::size_t kSides = D - 1;  // Of a face.
  using Place = std::array<float, kSides>;      // On a face, [0, 1] along each side.
  using Pixel = std::array<int, kSides>;

  struct Beam {
    int face = 0;
    Place place{};
    float sure = 0.0F;
  };
  struct Level {
    int side = 0;              // Pixels along a side of a face.
    std::vector<float> least;  // kHole where there is none.
    std::vector<float> most;   // 0 where there is none.
  };

  [[nodiscard]] static int face_of(const Point& direction, Place& place) {
    int axis = 0;
    float depth = std::abs(direction[0]);
    for (int k = 1; k < D; ++k)
      if (std::abs(direction[k]) > depth) {
        depth = std::abs(direction[k]);
        axis = k;
      }
    const float scale = 0.5F / depth;
    std::size_t i = 0;
    for (int k = 0; k < D; ++k)
      if (k != axis) place[i++] = rounded(direction[k] * scale) + 0.5F;
    return 2 * axis + (direction[axis] < 0.0F ? 1 : 0);
  }
  [[nodiscard]] static int pixel_on_side(float place, int side) {
    return std::clamp(static_cast<int>(place * static_cast<float>(side)), 0, side - 1);
  }
  [[nodiscard]] static std::size_t per_face(int side) {
    std::size_t all = 1;
    for (int k = 1; k < D; ++k) all *= static_cast<std::size_t>(side);
    return all;
  }
  [[nodiscard]] static std::size_t pixel(int face, const Pixel& at, int side) {
    auto index = static_cast<std::size_t>(face);
    for (std::size_t k = 0; k < kSides; ++k)
      index = index * static_cast<std::size_t>(side) + static_cast<std::size_t>(at[k]);
    return index;
  }
  [[nodiscard]] int finest_side() const;
  void coarsen(const Level& fine, Level& coarse) const;
  [[nodiscard]] float around(const Level& level, int face, const Place& place, float wanted,
                             bool& seen) const;
  [[nodiscard]] float least_at(const Level& level, int face, const Pixel& at) const;

  Point origin_ = Point::Zero();
  std::vector<Beam> beams_;
  float farthest_ = 0.0F;
  std::array<bool, kFaces> has_beams_{};
  std::vector<Level> levels_;  // From the finest on; the first num_levels_ are in use.
  std::size_t num_levels_ = 0;
};

template <int D>
int RangePyramid<D>::finest_side() const {
  // As wide as beams are apart: from the number of beams for each pixel of a coarse image that has any.
  constexpr int kSide = 64;
  std::vector<std::uint8_t> has_beam(kFaces * per_face(kSide), 0);
  std::size_t filled = 0;
  for (const Beam& beam : beams_) {
    Pixel at;
    for (std::size_t k = 0; k < kSides; ++k) at[k] = pixel_on_side(beam.place[k], kSide);
    std::uint8_t& here = has_beam[pixel(beam.face, at, kSide)];
    filled += here == 0 ? 1 : 0;
    here = 1;
  }
  if (filled == 0) return kCoarsest;
  const double beams_per_pixel = static_cast<double>(beams_.size()) / static_cast<double>(filled);
  const double wanted = kSide * (D == 3 ? std::sqrt(beams_per_pixel) : beams_per_pixel);
  int side = 32;
  while (side < kFinest && 1.4 * side < wanted) side *= 2;
  return side;
}

template <int D>
void RangePyramid<D>::build() {
  has_beams_.fill(false);
  for (const Beam& beam : beams_) has_beams_[static_cast<std::size_t>(beam.face)] = true;
  num_levels_ = 0;
  for (int side = finest_side(); side >= kCoarsest; side /= 2) {
    if (levels_.size() == num_levels_) levels_.emplace_back();
    Level& level = levels_[num_levels_++];
    level.side = side;
    const std::size_t face = per_face(side);
    level.least.resize(kFaces * face);
    level.most.resize(kFaces * face);
    if (num_levels_ > 1) {
      coarsen(levels_[num_levels_ - 2], level);
      continue;
    }
    for (std::size_t f = 0; f < kFaces; ++f) {
      if (!has_beams_[f]) continue;
      std::fill_n(level.least.begin() + static_cast<std::ptrdiff_t>(f * face), face, kHole);
      std::fill_n(level.most.begin() + static_cast<std::ptrdiff_t>(f * face), face, 0.0F);
    }
    for (const Beam& beam : beams_) {
      Pixel at;
      for (std::size_t k = 0; k < kSides; ++k) at[k] = pixel_on_side(beam.place[k], side);
      const std::size_t i = pixel(beam.face, at, side);
      level.least[i] = std::min(level.least[i], beam.sure);
      level.most[i] = std::max(level.most[i], beam.sure);
    }
  }
}

template <int D>
void RangePyramid<D>::coarsen(const Level& fine, Level& coarse) const {
  constexpr int kParts = 1 << (D - 1);
  const bool keeps_holes = coarse.side < kWidestGap;
  Pixel at{};
  for (std::size_t number = 0; number < kFaces; ++number) {
    if (!has_beams_[number]) continue;
    const int face = static_cast<int>(number);
    const std::size_t count = per_face(coarse.side);
    for (std::size_t i = 0; i < count; ++i) {
      std::size_t rest = i;
      for (std::size_t k = kSides; k-- > 0;) {
        at[k] = static_cast<int>(rest % static_cast<std::size_t>(coarse.side));
        rest /= static_cast<std::size_t>(coarse.side);
      }
      float least = kHole;
      float most = 0.0F;
      bool has_hole = false;
      for (int part = 0; part < kParts; ++part) {
        Pixel inner;
        for (std::size_t k = 0; k < kSides; ++k) inner[k] = 2 * at[k] + ((part >> k) & 1);
        const std::size_t j = pixel(face, inner, fine.side);
        has_hole = has_hole || fine.least[j] == kHole;
        least = std::min(least, fine.least[j]);
        most = std::max(most, fine.most[j]);
      }
      const std::size_t j = static_cast<std::size_t>(face) * count + i;
      coarse.least[j] = keeps_holes && has_hole ? kHole : least;
      coarse.most[j] = most;
    }
  }
}

template <int D>
float RangePyramid<D>::least_at(const Level& level, int face, const Pixel& at) const {
  bool inside = true;
  for (std::size_t k = 0; k < kSides; ++k) inside = inside && at[k] >= 0 && at[k] < level.side;
  if (inside) return level.least[pixel(face, at, level.side)];
  // The neighbour is on another face: where the direction of its centre leads.
  Point direction;
  const int axis = face / 2;
  std::size_t i = 0;
  for (int k = 0; k < D; ++k) {
    if (k == axis)
      direction[k] = face % 2 == 1 ? -1.0F : 1.0F;
    else
      direction[k] = 2.0F * ((static_cast<float>(at[i++]) + 0.5F) / static_cast<float>(level.side)) - 1.0F;
  }
  Place place;
  const int other = face_of(direction, place);
  if (!has_beams_[static_cast<std::size_t>(other)]) return kHole;
  Pixel there;
  for (std::size_t k = 0; k < kSides; ++k) there[k] = pixel_on_side(place[k], level.side);
  return level.least[pixel(other, there, level.side)];
}

template <int D>
float RangePyramid<D>::around(const Level& level, int face, const Place& place, float wanted,
                              bool& seen) const {
  Pixel at;
  bool inside = true;
  for (std::size_t k = 0; k < kSides; ++k) {
    at[k] = pixel_on_side(place[k], level.side);
    inside = inside && at[k] > 0 && at[k] + 1 < level.side;
  }
  const float middle = level.least[pixel(face, at, level.side)];
  if (middle < wanted) return middle;  // Most are hidden: one look is enough.
  std::array<float, kAround> found;
  if constexpr (D == 3) {
    for (int i = 0; i < 3; ++i) {
      if (inside) {
        const float* const row = &level.least[pixel(face, {at[0] + i - 1, at[1] - 1}, level.side)];
        for (int j = 0; j < 3; ++j) found[static_cast<std::size_t>(3 * i + j)] = row[j];
        continue;
      }
      for (int j = 0; j < 3; ++j)
        found[static_cast<std::size_t>(3 * i + j)] = least_at(level, face, {at[0] + i - 1, at[1] + j - 1});
    }
  } else {
    for (int i = 0; i < 3; ++i) found[i] = least_at(level, face, {at[0] + i - 1});
  }
  float least = kHole;
  unsigned filled = 0;
  int count = 0;
  for (std::size_t i = 0; i < kAround; ++i) {
    const float here = found[i];
    least = std::min(least, here);
    if (here == kHole) continue;
    filled |= 1U << i;
    ++count;
  }
  if constexpr (D == 3) {
    constexpr unsigned kUpper = 0007, kLower = 0700, kLeft = 0111, kRight = 0444;
    seen = (filled & kUpper) != 0 && (filled & kLower) != 0 && (filled & kLeft) != 0 &&
           (filled & kRight) != 0 && count >= kLeastInView;
  } else {
    seen = (filled & 1U) != 0 && (filled & 4U) != 0 && count >= kLeastInView;
  }
  return least;
}

template <int D>
float RangePyramid<D>::surely_passed(const Point& point, float distance, float radius, float least) const {
  if (!(distance > radius)) return -1.0F;
  Place place;
  const Point way = point - origin_;
  const int face = face_of(way, place);
  if (!has_beams_[static_cast<std::size_t>(face)]) return -1.0F;
  // Along a side: then a pixel is as wide as the radius, at the point's depth.
  const float most_pixels = 2.0F * std::abs(way[face / 2]) / radius;
  for (std::size_t i = 0; i < num_levels_; ++i) {
    const Level& level = levels_[i];
    if (static_cast<float>(level.side) > most_pixels) continue;
    bool seen = false;
    const float passed = around(level, face, place, least, seen);
    if (passed < least) return -1.0F;  // Coarser levels see no farther.
    if (seen) return passed;
    if (level.side <= kWidestGap) return -1.0F;
  }
  return -1.0F;
}

template <int D>
bool RangePyramid<D>::hides(const Point& center, float radius, float distance) const {
  if (distance > farthest_) return true;
  const Point way = center - origin_;
  Place place;
  const int face = face_of(way, place);
  const float depth = std::abs(way[face / 2]);
  if (!(depth > 2.0F * radius)) return false;
  // On the face, of half its side: generous, as the ball is nearer there than its centre is.
  const float reach = 0.75F * radius / (depth - radius);
  std::size_t i = 0;
  while (i + 1 < num_levels_ && reach * static_cast<float>(levels_[i].side) > 1.0F) ++i;
  const Level& level = levels_[i];
  const auto side = static_cast<float>(level.side);
  if (reach * side > 2.0F) return false;
  Pixel first;
  Pixel last;
  for (std::size_t k = 0; k < kSides; ++k) {
    // One pixel more on each side: these surround what is in the ball.
    const float lower = (place[k] - reach) * side - 1.0F;
    const float upper = (place[k] + reach) * side + 1.0F;
    if (lower < 0.0F || upper >= side) return false;
    first[k] = static_cast<int>(lower);
    last[k] = static_cast<int>(upper);
  }
  if (!has_beams_[static_cast<std::size_t>(face)]) return true;
  Pixel at = first;
  for (;;) {
    if (level.most[pixel(face, at, level.side)] > distance) return false;
    std::size_t k = 0;
    while (k < kSides && at[k] == last[k]) {
      at[k] = first[k];
      ++k;
    }
    if (k == kSides) return true;
    ++at[k];
  }
}

}  // namespace ndtree
