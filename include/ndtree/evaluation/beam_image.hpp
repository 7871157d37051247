// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beams of one origin by direction: which are beside each other, and how wide what they meet is.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Directions on a cube around an origin: a face, and a place on it.
template <int D>
struct CubeFaces {
  using Point = Eigen::Matrix<float, D, 1>;
  static constexpr std::size_t kFaces = 2 * D;
  static constexpr std::size_t kSides = D - 1;  // Of a face.
  using Place = std::array<float, kSides>;      // On a face, [0, 1] along each side.
  using Pixel = std::array<int, kSides>;

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
      if (k != axis) place[i++] = unfused(direction[k] * scale) + 0.5F;
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
};

/// The beams of one origin, in pixels on a cube around it.
///
/// Two beams are beside each other if one is the nearest in a quarter of the directions around the other: to
/// its right, its left, above or below (in the plane, on one side). Above is along the last axis. So a row of
/// beams is one whether a sensor's beams are as far apart across as upwards, or ten times as far.
///
/// Offsets are between directions of unit length, across and then upwards: times a range, they are metres.
template <int D>
class BeamImage {
 public:
  using Faces = CubeFaces<D>;
  using Point = typename Faces::Point;
  static constexpr std::size_t kSides = Faces::kSides;
  using Offset = std::array<float, kSides>;

  struct Beam {
    Point direction;
    typename Faces::Place place{};
    int face = 0;
    float sure = 0.0F;                              // Up to where it surely passed [m].
    bool returned = true;                           // Whether it ends there on a surface.
    std::int32_t next = -1;                         // In its pixel.
    std::array<std::int32_t, 2 * kSides> beside{};  // Numbers of beams; kNotSought or kNone.
  };

  /// Starts anew.
  void reset() { beams_.clear(); }
  /// A beam in a direction of unit length, which surely passed up to a distance >= 0 [m]. @param returned
  /// whether it ends there on a surface.
  void add(const Point& direction, float sure, bool returned = true) {
    Beam beam;
    beam.direction = direction;
    beam.face = Faces::face_of(direction, beam.place);
    beam.sure = sure;
    beam.returned = returned;
    beam.beside.fill(kNotSought);
    beams_.push_back(beam);
  }
  /// Ends a scan: answers are about the beams since reset(). O(beams + pixels of the faces with beams).
  void build();

  [[nodiscard]] const std::vector<Beam>& beams() const { return beams_; }
  [[nodiscard]] bool has_beams(std::size_t face) const { return has_beams_[face]; }
  /// Pixels along a side of a face: about as wide as beams are apart.
  [[nodiscard]] int side() const { return side_; }

  /// The width and the height of the surface at the end of a beam [m], as far as beams beside each other
  /// tell: from the last that ends on it on one side to the last on the other, and half of the way to the
  /// next. 0 where no neighbour on that axis ends on it: a rod, or a surface so oblique that beams cannot
  /// tell. All are 0 if no beam aslant ends on it, either: two rods that cross.
  /// @param tolerance of ranges of one surface [m], besides its slope.
  /// @param most at which to stop, and how far apart beams on one surface are at most [m].
  [[nodiscard]] Offset size_of_surface(std::size_t beam, float tolerance, float most);

  enum class Seen : std::uint8_t { nothing, end, beside, passed };
  /// The state of a direction whose beams are far apart: `passed` if all within a radius passed farther
  /// than `farther`, and the nearest in each quarter around it by more than a surface recedes up to there;
  /// `beside` if some within the radius passed so far, and none is in a quarter around it, as at the border
  /// of a field of view; `end` if one within the radius ends between, and none before.
  /// @param radius as an offset. @param nearer, farther [m].
  [[nodiscard]] Seen look(const Point& direction, float radius, float nearer, float farther) const;

  /// Whether beams that surely passed farther than `least` are so dense around a direction that each
  /// rectangle of a size holds one of them, if its border is at least `core` away from the direction.
  [[nodiscard]] bool surely_meets(const Point& direction, const Offset& size, const Offset& core,
                                  float least) const;

  /// Along an axis, beside a direction: how far away the nearest beam is, and how far apart are those on both
  /// sides, as offsets; infinite where there is none.
  struct Beside {
    float nearest;
    float gap;
  };
  /// Where beams that surely passed farther than `least` went past a direction, axis by axis. Only beams that
  /// are at most `core` or `radius` away along the other axis count. Sought until there is one on both sides,
  /// up to the size at most.
  [[nodiscard]] std::array<Beside, kSides> beside(const Point& direction, const Offset& size,
                                                  const Offset& core, float least, float radius) const;

 private:
  static constexpr std::int32_t kNotSought = -2;
  static constexpr std::int32_t kNone = -1;
  static constexpr int kFinest = D == 3 ? 512 : 4096;
  static constexpr float kFarthest = 12.0F;  // Pixels: neighbours are not sought farther away.
  static constexpr float kSlope = 2.0F;      // Of range by width, of surfaces that count: 63 degrees,
  // but, where beams are far apart, so much less that of neighbours that end anywhere up to a beam's range no
  // larger fraction passes for its surface.
  static constexpr float kMistaken = 0.15F;
  // Of range by width, of a surface between beams: one side of a right angle is no steeper.
  static constexpr float kSteepest = 1.0F;
  static constexpr int kMostSteps = 16;  // Along one side of a surface.

  struct Frame {
    Point forward;
    std::array<Point, kSides> sides;
  };

  [[nodiscard]] static float dot(const Point& a, const Point& b) {
    float sum = 0.0F;
    for (int k = 0; k < D; ++k) sum = unfused(a[k] * b[k]) + sum;
    return sum;
  }
  [[nodiscard]] static Frame frame_of(const Point& direction);
  [[nodiscard]] static Offset offset(const Frame& frame, const Point& direction) {
    Offset found;
    for (std::size_t k = 0; k < kSides; ++k) found[k] = dot(frame.sides[k], direction);
    return found;
  }
  /// The width of a pixel as an offset, where pixels are widest.
  [[nodiscard]] float pixel_width() const { return 2.0F / static_cast<float>(side_); }
  [[nodiscard]] int finest_side() const;
  /// Calls `use(number, offset)` for beams whose offsets from a direction are at most `reach` on each axis.
  template <class Use>
  void for_each_near(const Frame& frame, float reach, const Use& use) const;
  void find_beside(std::size_t beam);
  /// The beam beside another one that ends on the same surface; kNone, also if it is more than `most` away.
  [[nodiscard]] std::int32_t beside_on_surface(std::int32_t beam, std::size_t sector, float tolerance,
                                               float most);
  /// Beams around a direction, so few that each is compared with each.
  struct FewOffsets {
    static constexpr std::size_t kMost = 64;
    std::array<Offset, kMost> all;
    std::size_t count = 0;  ///< More than kMost: some were left out.

    void add(const Offset& one) {
      if (count < kMost) all[count] = one;
      ++count;
    }
    [[nodiscard]] bool is_complete() const { return count <= kMost; }
    [[nodiscard]] const Offset* begin() const { return all.data(); }
    [[nodiscard]] const Offset* end() const { return all.data() + std::min(count, kMost); }
  };
  [[nodiscard]] static bool is_without(const FewOffsets& points, const Offset& size, const Offset& core);

  std::vector<Beam> beams_;
  std::array<bool, Faces::kFaces> has_beams_{};
  int side_ = 1;
  std::vector<std::int32_t> heads_;  // The first beam of each pixel of faces with beams.
};

template <int D>
int BeamImage<D>::finest_side() const {
  // As wide as beams are apart: from the number of beams for each pixel of a coarse image that has any.
  constexpr int kSide = 64;
  std::vector<std::uint8_t> has_beam(Faces::kFaces * Faces::per_face(kSide), 0);
  std::size_t filled = 0;
  for (const Beam& beam : beams_) {
    typename Faces::Pixel at;
    for (std::size_t k = 0; k < kSides; ++k) at[k] = Faces::pixel_on_side(beam.place[k], kSide);
    std::uint8_t& here = has_beam[Faces::pixel(beam.face, at, kSide)];
    filled += here == 0 ? 1 : 0;
    here = 1;
  }
  if (filled == 0) return 4;
  const double beams_per_pixel = static_cast<double>(beams_.size()) / static_cast<double>(filled);
  const double wanted = kSide * (D == 3 ? std::sqrt(beams_per_pixel) : beams_per_pixel);
  int side = 32;
  while (side < kFinest && 1.4 * side < wanted) side *= 2;
  return side;
}

template <int D>
void BeamImage<D>::build() {
  has_beams_.fill(false);
  for (const Beam& beam : beams_) has_beams_[static_cast<std::size_t>(beam.face)] = true;
  side_ = finest_side();
  const std::size_t face = Faces::per_face(side_);
  heads_.resize(Faces::kFaces * face);
  for (std::size_t f = 0; f < Faces::kFaces; ++f)
    if (has_beams_[f]) std::fill_n(heads_.begin() + static_cast<std::ptrdiff_t>(f * face), face, kNone);
  for (std::size_t i = 0; i < beams_.size(); ++i) {
    typename Faces::Pixel at;
    for (std::size_t k = 0; k < kSides; ++k) at[k] = Faces::pixel_on_side(beams_[i].place[k], side_);
    std::int32_t& head = heads_[Faces::pixel(beams_[i].face, at, side_)];
    beams_[i].next = head;
    head = static_cast<std::int32_t>(i);
  }
}

template <int D>
typename BeamImage<D>::Frame BeamImage<D>::frame_of(const Point& direction) {
  Frame frame;
  frame.forward = direction;
  if constexpr (D == 2) {
    frame.sides[0] = Point(-direction[1], direction[0]);
  } else {
    const float x = direction[0];
    const float y = direction[1];
    const float z = direction[2];
    const float flat = std::sqrt(unfused(x * x) + unfused(y * y));
    const float cosine = flat > 0.0F ? x / flat : 1.0F;
    const float sine = flat > 0.0F ? y / flat : 0.0F;
    frame.sides[0] = Point(-sine, cosine, 0.0F);
    frame.sides[1] = Point(-z * cosine, -z * sine, flat);
  }
  return frame;
}

template <int D>
template <class Use>
void BeamImage<D>::for_each_near(const Frame& frame, float reach, const Use& use) const {
  const float radius = reach * (D == 3 ? 1.42F : 1.0F);
  for (std::size_t number = 0; number < Faces::kFaces; ++number) {
    if (!has_beams_[number]) continue;
    const int face = static_cast<int>(number);
    const int axis = face / 2;
    const float depth = face % 2 == 1 ? -frame.forward[axis] : frame.forward[axis];
    if (depth <= radius) continue;
    // The cap of directions, on the plane of the face: its middle, and how far it reaches at most.
    typename Faces::Pixel first{};
    typename Faces::Pixel last{};
    bool is_beside = false;
    std::size_t i = 0;
    for (int k = 0; k < D; ++k) {
      if (k == axis) continue;
      const float low =
          (frame.forward[k] - radius) / (frame.forward[k] > radius ? depth + radius : depth - radius);
      const float high =
          (frame.forward[k] + radius) / (frame.forward[k] < -radius ? depth + radius : depth - radius);
      is_beside = is_beside || low > 1.0F || high < -1.0F;
      first[i] = Faces::pixel_on_side(std::max(0.0F, unfused(0.5F * low) + 0.5F), side_);
      last[i] = Faces::pixel_on_side(std::min(1.0F, unfused(0.5F * high) + 0.5F), side_);
      ++i;
    }
    if (is_beside) continue;
    const int rows_end = D == 3 ? last[0] : 0;
    for (int row = D == 3 ? first[0] : 0; row <= rows_end; ++row) {
      typename Faces::Pixel at{};
      if constexpr (D == 3) at[0] = row;
      for (at[kSides - 1] = first[kSides - 1]; at[kSides - 1] <= last[kSides - 1]; ++at[kSides - 1])
        for (std::int32_t b = heads_[Faces::pixel(face, at, side_)]; b != kNone;
             b = beams_[static_cast<std::size_t>(b)].next) {
          const Offset to = offset(frame, beams_[static_cast<std::size_t>(b)].direction);
          bool is_near = true;
          for (const float one : to) is_near = is_near && std::abs(one) <= reach;
          if (is_near) use(b, to);
        }
    }
  }
}

template <int D>
void BeamImage<D>::find_beside(std::size_t beam) {
  const Frame frame = frame_of(beams_[beam].direction);
  std::array<std::int32_t, 2 * kSides> found;
  for (float reach = 1.5F; reach <= kFarthest; reach *= 2.0F) {
    found.fill(kNone);
    std::array<float, 2 * kSides> nearest;
    nearest.fill(reach * pixel_width());
    for_each_near(frame, reach * pixel_width(), [&](std::int32_t other, const Offset& to) {
      std::size_t axis = 0;
      float most = std::abs(to[0]);
      if (kSides == 2 && std::abs(to[kSides - 1]) > most) {
        axis = 1;
        most = std::abs(to[kSides - 1]);
      }
      const std::size_t sector = 2 * axis + (to[axis] > 0.0F ? 1 : 0);
      // Of beams as near, the one with the smallest number, whatever order they are in.
      if (most == 0.0F || other == static_cast<std::int32_t>(beam)) return;
      if (most < nearest[sector] || (most == nearest[sector] && other < found[sector])) {
        nearest[sector] = most;
        found[sector] = other;
      }
    });
    if (std::find(found.begin(), found.end(), kNone) == found.end()) break;
  }
  beams_[beam].beside = found;
}

template <int D>
std::int32_t BeamImage<D>::beside_on_surface(std::int32_t beam, std::size_t sector, float tolerance,
                                             float most) {
  const auto index = static_cast<std::size_t>(beam);
  if (beams_[index].beside[sector] == kNotSought) find_beside(index);
  const std::int32_t other = beams_[index].beside[sector];
  if (other == kNone) return kNone;
  const Beam& one = beams_[index];
  const Beam& two = beams_[static_cast<std::size_t>(other)];
  const float apart = (two.direction - one.direction).norm() * std::min(one.sure, two.sure);
  const float largest = std::max(tolerance, 0.5F * kMistaken * std::min(one.sure, two.sure));
  const bool is_one = one.returned && two.returned && apart <= most &&
                      std::abs(one.sure - two.sure) <= std::min(tolerance + kSlope * apart, largest);
  return is_one ? other : kNone;
}

template <int D>
typename BeamImage<D>::Offset BeamImage<D>::size_of_surface(std::size_t beam, float tolerance, float most) {
  Offset size{};
  const Frame frame = frame_of(beams_[beam].direction);
  const float range = beams_[beam].sure;
  std::array<std::int32_t, 2 * kSides> first;
  for (std::size_t sector = 0; sector < 2 * kSides; ++sector)
    first[sector] = beside_on_surface(static_cast<std::int32_t>(beam), sector, tolerance, most);
  if constexpr (D == 3) {
    bool is_area = false;
    for (const std::size_t i : {0U, 1U})
      for (const std::size_t j : {2U, 3U})
        is_area = is_area || (first[i] != kNone && beside_on_surface(first[i], j, tolerance, most) != kNone);
    if (!is_area) return size;
  }
  for (std::size_t sector = 0; sector < 2 * kSides; ++sector) {
    std::int32_t last = first[sector];
    float width = 0.0F;
    float step = 0.0F;
    for (int steps = 0; last != kNone && steps < kMostSteps && width < most; ++steps) {
      const float now =
          std::abs(offset(frame, beams_[static_cast<std::size_t>(last)].direction)[sector / 2]) * range;
      step = now - width;
      width = now;
      last = beside_on_surface(last, sector, tolerance, most);
    }
    size[sector / 2] += width + 0.25F * step;
  }
  return size;
}

template <int D>
typename BeamImage<D>::Seen BeamImage<D>::look(const Point& direction, float radius, float nearer,
                                               float farther) const {
  const Frame frame = frame_of(direction);
  constexpr float kNoBeam = std::numeric_limits<float>::infinity();
  float least = kNoBeam;  // Of the beams within the radius.
  for (float pixels = 1.5F; pixels <= kFarthest; pixels *= 2.0F) {
    const float reach = std::max(pixels * pixel_width(), radius);
    std::array<float, 2 * kSides> nearest;
    nearest.fill(kNoBeam);
    std::array<float, 2 * kSides> sure{};
    for_each_near(frame, reach, [&](std::int32_t beam, const Offset& to) {
      const float passed = beams_[static_cast<std::size_t>(beam)].sure;
      const std::size_t axis = kSides == 2 && std::abs(to[kSides - 1]) > std::abs(to[0]) ? 1 : 0;
      float square = 0.0F;
      for (const float one : to) square = unfused(one * one) + square;
      if (square < radius * radius) least = std::min(least, passed);
      const std::size_t sector = 2 * axis + (to[axis] > 0.0F ? 1 : 0);
      const float beyond = passed - kSteepest * farther * std::sqrt(square);
      if (square < nearest[sector] || (square == nearest[sector] && beyond < sure[sector])) {
        nearest[sector] = square;
        sure[sector] = beyond;
      }
    });
    if (least < nearer) return Seen::nothing;
    if (least <= farther) return Seen::end;
    if (*std::max_element(nearest.begin(), nearest.end()) > reach * reach) continue;
    return *std::min_element(sure.begin(), sure.end()) > farther ? Seen::passed : Seen::nothing;
  }
  return least < kNoBeam ? Seen::beside : Seen::nothing;
}

template <int D>
bool BeamImage<D>::is_without(const FewOffsets& points, const Offset& size, const Offset& core) {
  constexpr std::size_t kUp = kSides - 1;
  // Each rectangle that is as far to the left as possible, or has a point on its left border.
  for (std::size_t i = 0; i <= (D == 3 ? points.count : 0); ++i) {
    const float left = i < points.count && D == 3 ? points.all[i][0] : core[0] - size[0];
    if (left > -core[0]) continue;
    float above = size[kUp] - core[kUp];
    float below = -above;
    for (const Offset& point : points) {
      if (D == 3 && (point[0] <= left || point[0] >= left + size[0])) continue;
      if (point[kUp] >= -core[kUp]) above = std::min(above, point[kUp]);
      if (point[kUp] <= core[kUp]) below = std::max(below, point[kUp]);
    }
    if (above >= core[kUp] && below <= -core[kUp] && above - below >= size[kUp]) return true;
  }
  return false;
}

template <int D>
bool BeamImage<D>::surely_meets(const Point& direction, const Offset& size, const Offset& core,
                                float least) const {
  for (const float one : size)
    if (!(one > 0.0F)) return false;
  const float largest = *std::max_element(size.begin(), size.end());
  const Frame frame = frame_of(direction);
  for (float reach = 2.0F * pixel_width();; reach *= 1.5F) {
    FewOffsets passing;
    bool is_in_core = false;
    for_each_near(frame, std::min(reach, largest), [&](std::int32_t beam, const Offset& to) {
      if (!(beams_[static_cast<std::size_t>(beam)].sure > least)) return;
      bool is_inside = true;
      bool is_central = true;
      for (std::size_t k = 0; k < kSides; ++k) {
        is_inside = is_inside && std::abs(to[k]) < size[k] - core[k];
        is_central = is_central && std::abs(to[k]) < core[k];
      }
      is_in_core = is_in_core || is_central;
      if (is_inside) passing.add(to);
    });
    if (is_in_core) return true;
    if (passing.is_complete() && !is_without(passing, size, core)) return true;
    if (!passing.is_complete() || reach >= largest) return false;
  }
}

template <int D>
auto BeamImage<D>::beside(const Point& direction, const Offset& size, const Offset& core, float least,
                          float radius) const -> std::array<Beside, kSides> {
  constexpr float kNoBeam = std::numeric_limits<float>::infinity();
  const Frame frame = frame_of(direction);
  const float largest = *std::max_element(size.begin(), size.end());
  for (float reach = 2.0F * pixel_width();; reach *= 1.5F) {
    std::array<std::array<float, 2>, kSides> nearest;  // On each side.
    for (auto& sides : nearest) sides.fill(kNoBeam);
    for_each_near(frame, std::min(reach, largest), [&](std::int32_t beam, const Offset& to) {
      if (!(beams_[static_cast<std::size_t>(beam)].sure > least)) return;
      for (std::size_t k = 0; k < kSides; ++k) {
        const std::size_t other = kSides - 1 - k;
        if (other != k && std::abs(to[other]) > std::max(core[other], radius)) continue;
        float& side = nearest[k][to[k] < 0.0F ? 0 : 1];
        side = std::min(side, std::abs(to[k]));
      }
    });
    std::array<Beside, kSides> found;
    bool is_complete = true;
    for (std::size_t k = 0; k < kSides; ++k) {
      found[k] = {std::min(nearest[k][0], nearest[k][1]), nearest[k][0] + nearest[k][1]};
      is_complete = is_complete && found[k].gap < kNoBeam;
    }
    if (is_complete || reach >= largest) return found;
  }
}

}  // namespace ndtree
