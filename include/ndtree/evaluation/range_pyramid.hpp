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

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/evaluation/beam_image.hpp"

namespace ndtree {

/// What the beams of one origin say about space, by direction.
///
/// A cube around the origin is divided into pixels. Each holds the least and the largest distance up to which
/// its beams surely passed; a pixel of the next level holds those of 2^(D-1) pixels. The finest pixels are
/// about as wide as the beams are apart. A pixel without a beam is a hole: a level takes holes over only
/// where all of its pixel's parts are one, but pixels wider than kWidestGap also where one part is, so that
/// nothing is said across a gap between beams that are far apart, or did not measure.
///
/// A point is in view if beams surround it on the finest level whose pixels are as wide as what must be seen
/// around it: of the 3^(D-1) pixels around its direction, each side has one with a beam, and most have. Then
/// the least of their distances says how far the space around the point was surely passed; where beams are
/// farther apart, BeamImage::look() asks them one by one. Around an edge of the cube, where pixels of two
/// faces do not line up, all that a pixel meets count. Coordinates are relative to any base near the scan
/// [m].
template <int D>
class RangePyramid {
 public:
  using Point = Eigen::Matrix<float, D, 1>;

  /// Of the beams of an origin. O(beams + pixels of the faces with beams).
  void build(const Point& origin, const BeamImage<D>& beams);

  /// What surely_passed() says where beams are farther apart than what must be in view: ask them one by one.
  static constexpr float kSparse = -2.0F;

  /// Up to where beams around a point surely passed [m]; -1 if that is less than `least`, or there are none;
  /// kSparse if pixels as wide as the radius do not surround the point with beams, but wider ones do, or some
  /// of them have beams.
  /// @param distance of the point from the origin [m]. @param radius of what must be in view around it [m].
  [[nodiscard]] float surely_passed(const Point& point, float distance, float radius, float least) const;

#ifdef NDTREE_HAS_EIGHTS
  /// surely_passed() of eight points, with the same bits.
  /// @param points coordinate by coordinate. @param wanted which are asked about: others get negative
  /// numbers.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightFloats
  surely_passed(const std::array<EightFloats, std::size_t{D}>& points, const EightFloats& distance,
                const EightFloats& radius, const EightFloats& least, const EightMask& wanted) const;
  /// hides() of eight balls.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightMask
  hides(const std::array<EightFloats, std::size_t{D}>& centers, const EightFloats& radius,
        const EightFloats& distance) const;
#endif

  /// Whether no beam near a ball surely passed farther than `distance` from the origin: nothing can be said
  /// of what is in it. May be false although it is so.
  [[nodiscard]] bool hides(const Point& center, float radius, float distance) const;

 private:
  using Faces = CubeFaces<D>;
  static constexpr std::size_t kFaces = Faces::kFaces;
  static constexpr std::size_t kAround = D == 3 ? 9 : 3;  // Pixels that surround a direction, with its own.
  static constexpr int kCoarsest = 4;                     // Pixels along a side of a face.
  static constexpr int kWidestGap = 16;  // As kCoarsest, of the coarsest level that bridges gaps.
  static constexpr int kLeastInView = D == 3 ? 5 : 2;  // Of the pixels that surround a direction.
  static constexpr float kHole = std::numeric_limits<float>::infinity();

  static constexpr std::size_t kSides = Faces::kSides;
  using Place = typename Faces::Place;
  using Pixel = typename Faces::Pixel;

  struct Level {
    int side = 0;           // Pixels along a side of a face.
    std::size_t first = 0;  // Of its pixels among those of all levels.
  };

  void coarsen(const Level& fine, const Level& coarse);
  void look_around(const Level& level);
#ifdef NDTREE_HAS_EIGHTS
  static constexpr int kMostOnSide =
      7;  // Pixels that hides() looks at, along a side: 2 reach + 2, and a part.
  struct EightDirections {
    EightFloats depth;  // Along the main axis.
    std::array<EightFloats, kSides> place;
    EightInts face;
    EightMask has_beams;
  };
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightDirections
  directions_of(const std::array<EightFloats, std::size_t{D}>& points) const;
  NDTREE_BY_EIGHTS static void look_around_eight(const float* pixels, int side, float* out);
  bool by_eights_ = Simd::width() >= 8;
#endif
  [[nodiscard]] float around(const Level& level, int face, const Pixel& at) const;
  /// The least of the pixels of other faces that one beside a face meets, and whether the one that its centre
  /// leads to has a beam.
  [[nodiscard]] float least_beside(const Level& level, int face, const Pixel& at, bool& has_beam) const;

  Point origin_ = Point::Zero();
  float farthest_ = 0.0F;
  std::array<bool, kFaces> has_beams_{};
  std::vector<Level> levels_;  // From the finest on.
  // Of all levels' pixels, up to where beams surely passed:
  std::vector<float> least_;  // kHole where there is none.
  std::vector<float> most_;   // 0 where there is none.
  // The least of a pixel and all around it, negative (also 0) where they do not surround a direction:
  std::vector<float> around_;
};

template <int D>
void RangePyramid<D>::build(const Point& origin, const BeamImage<D>& beams) {
  origin_ = origin;
  for (std::size_t f = 0; f < kFaces; ++f) has_beams_[f] = beams.has_beams(f);
  levels_.clear();
  std::size_t pixels = 0;
  for (int side = beams.side(); side >= kCoarsest; side /= 2) {
    levels_.push_back({side, pixels});
    pixels += kFaces * Faces::per_face(side);
  }
  least_.resize(pixels);
  most_.resize(pixels);
  around_.resize(pixels);
  const int side = levels_.front().side;
  const std::size_t face = Faces::per_face(side);
  for (std::size_t f = 0; f < kFaces; ++f) {
    if (!has_beams_[f]) continue;
    std::fill_n(least_.begin() + static_cast<std::ptrdiff_t>(f * face), face, kHole);
    std::fill_n(most_.begin() + static_cast<std::ptrdiff_t>(f * face), face, 0.0F);
  }
  farthest_ = 0.0F;
  for (const auto& beam : beams.beams()) {
    Pixel at;
    for (std::size_t k = 0; k < kSides; ++k) at[k] = Faces::pixel_on_side(beam.place[k], side);
    const std::size_t i = Faces::pixel(beam.face, at, side);
    least_[i] = std::min(least_[i], beam.sure);
    most_[i] = std::max(most_[i], beam.sure);
    farthest_ = std::max(farthest_, beam.sure);
  }
  for (std::size_t i = 1; i < levels_.size(); ++i) coarsen(levels_[i - 1], levels_[i]);
  for (const Level& one : levels_) look_around(one);
}

template <int D>
void RangePyramid<D>::coarsen(const Level& fine, const Level& coarse) {
  constexpr int kParts = 1 << (D - 1);
  const bool keeps_holes = coarse.side < kWidestGap;
  Pixel at{};
  for (std::size_t number = 0; number < kFaces; ++number) {
    if (!has_beams_[number]) continue;
    const int face = static_cast<int>(number);
    const std::size_t count = Faces::per_face(coarse.side);
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
        const std::size_t j = fine.first + Faces::pixel(face, inner, fine.side);
        has_hole = has_hole || least_[j] == kHole;
        least = std::min(least, least_[j]);
        most = std::max(most, most_[j]);
      }
      const std::size_t j = coarse.first + number * count + i;
      least_[j] = keeps_holes && has_hole ? kHole : least;
      most_[j] = most;
    }
  }
}

template <int D>
float RangePyramid<D>::least_beside(const Level& level, int face, const Pixel& at, bool& has_beam) const {
  // The pixel is beside the face, on its plane: its centre and its corners lead to pixels of other faces.
  const auto leads_to = [&](const std::array<float, kSides>& within, Pixel& there) {
    Point direction;
    const int axis = face / 2;
    std::size_t i = 0;
    for (int k = 0; k < D; ++k) {
      if (k == axis) {
        direction[k] = face % 2 == 1 ? -1.0F : 1.0F;
      } else {
        direction[k] =
            2.0F * ((static_cast<float>(at[i]) + within[i]) / static_cast<float>(level.side)) - 1.0F;
        ++i;
      }
    }
    Place place;
    const int other = Faces::face_of(direction, place);
    for (std::size_t k = 0; k < kSides; ++k) there[k] = Faces::pixel_on_side(place[k], level.side);
    return other;
  };
  std::array<float, kSides> within;
  within.fill(0.5F);
  Pixel first{};
  const int other = leads_to(within, first);
  Pixel last = first;
  float least = kHole;
  has_beam = has_beams_[static_cast<std::size_t>(other)] &&
             least_[level.first + Faces::pixel(other, first, level.side)] != kHole;
  for (unsigned corner = 0; corner < (1U << kSides); ++corner) {
    for (std::size_t k = 0; k < kSides; ++k) within[k] = (corner >> k & 1U) != 0 ? 1.0F : 0.0F;
    Pixel there{};
    const int at_corner = leads_to(within, there);
    if (at_corner == other) {
      for (std::size_t k = 0; k < kSides; ++k) {
        first[k] = std::min(first[k], there[k]);
        last[k] = std::max(last[k], there[k]);
      }
    } else if (has_beams_[static_cast<std::size_t>(at_corner)]) {
      least = std::min(least, least_[level.first + Faces::pixel(at_corner, there, level.side)]);
    }
  }
  if (!has_beams_[static_cast<std::size_t>(other)]) return least;
  Pixel there{};
  for (there[0] = first[0]; there[0] <= last[0]; ++there[0])
    for (there[kSides - 1] = D == 3 ? first[kSides - 1] : there[0];
         there[kSides - 1] <= (D == 3 ? last[kSides - 1] : there[0]); ++there[kSides - 1]) {
      least = std::min(least, least_[level.first + Faces::pixel(other, there, level.side)]);
      if (D == 2) break;
    }
  return least;
}

template <int D>
float RangePyramid<D>::around(const Level& level, int face, const Pixel& at) const {
  float least = kHole;
  unsigned filled = 0;
  int count = 0;
  bool is_inside = true;
  for (std::size_t k = 0; k < kSides; ++k) is_inside = is_inside && at[k] > 0 && at[k] + 1 < level.side;
  const float* const middle = least_.data() + level.first + Faces::pixel(face, at, level.side);
  for (std::size_t i = 0; i < kAround; ++i) {
    const int row = D == 3 ? static_cast<int>(i / 3) - 1 : 0;
    const int column = static_cast<int>(D == 3 ? i % 3 : i) - 1;
    float here = kHole;
    bool has_beam = false;
    Pixel there = at;
    there[0] += row;
    there[kSides - 1] += column;
    bool is_on_face = is_inside;
    if (!is_inside) {
      is_on_face = true;
      for (std::size_t k = 0; k < kSides; ++k)
        is_on_face = is_on_face && there[k] >= 0 && there[k] < level.side;
    }
    if (is_on_face) {
      here = middle[row * level.side + column];
      has_beam = here != kHole;
    } else {
      here = least_beside(level, face, there, has_beam);
    }
    least = std::min(least, here);
    if (!has_beam) continue;
    filled |= 1U << i;
    ++count;
  }
  bool is_seen = count >= kLeastInView;
  if constexpr (D == 3) {
    for (const unsigned side : {0007U, 0700U, 0111U, 0444U}) is_seen = is_seen && (filled & side) != 0;
  } else {
    is_seen = is_seen && (filled & 1U) != 0 && (filled & 4U) != 0;
  }
  return is_seen ? least : -least;
}

template <int D>
void RangePyramid<D>::look_around(const Level& level) {
  const int side = level.side;
  const std::size_t rows = Faces::per_face(side) / static_cast<std::size_t>(side);
  for (std::size_t number = 0; number < kFaces; ++number) {
    if (!has_beams_[number]) continue;
    const int face = static_cast<int>(number);
    for (std::size_t row = 0; row < rows; ++row) {
      Pixel at{};
      if constexpr (D == 3) at[0] = static_cast<int>(row);
      int& column = at[kSides - 1];
      float* const out = around_.data() + level.first + Faces::pixel(face, at, side);
#ifdef NDTREE_HAS_EIGHTS
      const bool is_inner = D == 2 || (row > 0 && row + 1 < rows);
      if (by_eights_ && is_inner && side >= 16) {
        out[0] = around(level, face, at);
        column = 1;
        for (; column + 8 < side; column += 8)
          look_around_eight(least_.data() + level.first + Faces::pixel(face, at, side), side, out + column);
      }
#endif
      for (; column < side; ++column) out[column] = around(level, face, at);
    }
  }
}

#ifdef NDTREE_HAS_EIGHTS
template <int D>
NDTREE_BY_EIGHTS void RangePyramid<D>::look_around_eight(const float* pixels, int side, float* out) {
  EightFloats least = kHole;
  EightInts count = 0;
  EightMask lower = EightMask::none();
  EightMask upper = EightMask::none();
  EightMask left = EightMask::none();
  EightMask right = EightMask::none();
  for (int i = D == 3 ? -1 : 0; i <= (D == 3 ? 1 : 0); ++i)
    for (int j = -1; j <= 1; ++j) {
      const EightFloats one = EightFloats::load(pixels + i * side + j);
      const EightMask has = one < kHole;
      least = min_of(least, one);
      count = count - EightInts::minus_one_where(has);
      if (i < 0) lower = lower | has;
      if (i > 0) upper = upper | has;
      if (j < 0) left = left | has;
      if (j > 0) right = right | has;
    }
  EightMask is_seen = left & right & (count > kLeastInView - 1);
  if constexpr (D == 3) is_seen = is_seen & lower & upper;
  select(is_seen, least, float_of(bits_of(least) | bits_of(EightFloats(-0.0F)))).store(out);
}
#endif

template <int D>
float RangePyramid<D>::surely_passed(const Point& point, float distance, float radius, float least) const {
  if (!(distance > radius)) return -1.0F;
  Place place;
  const Point way = point - origin_;
  const int face = Faces::face_of(way, place);
  if (!has_beams_[static_cast<std::size_t>(face)]) return -1.0F;
  // Along a side: then a pixel is as wide as the radius, at the point's depth.
  const float most_pixels = 2.0F * std::abs(way[face / 2]) / radius;
  bool is_sparse = false;
  bool has_near = false;
  for (const Level& level : levels_) {
    if (static_cast<float>(level.side) > most_pixels) continue;
    Pixel at;
    for (std::size_t k = 0; k < kSides; ++k) at[k] = Faces::pixel_on_side(place[k], level.side);
    const float found = around_[level.first + Faces::pixel(face, at, level.side)];
    if (!is_sparse && std::abs(found) < least) return -1.0F;
    if (!std::signbit(found)) return is_sparse ? kSparse : found;
    has_near = is_sparse ? has_near : found > -kHole;
    if (level.side <= kWidestGap) return has_near ? kSparse : -1.0F;
    is_sparse = true;
  }
  return -1.0F;
}

#ifdef NDTREE_HAS_EIGHTS
template <int D>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE typename RangePyramid<D>::EightDirections
RangePyramid<D>::directions_of(const std::array<EightFloats, std::size_t{D}>& points) const {
  // As Faces::face_of().
  std::array<EightFloats, std::size_t{D}> way;
  for (std::size_t k = 0; k < D; ++k) way[k] = points[k] - origin_[static_cast<int>(k)];
  EightDirections to;
  EightInts axis = 0;
  to.depth = abs_of(way[0]);
  EightFloats along = way[0];
  for (std::size_t k = 1; k < D; ++k) {
    const EightFloats size = abs_of(way[k]);
    const EightMask is_larger = size > to.depth;
    axis = select(is_larger, static_cast<std::int32_t>(k), axis);
    to.depth = select(is_larger, size, to.depth);
    along = select(is_larger, way[k], along);
  }
  const EightFloats scale = 0.5F / to.depth;
  for (std::size_t k = 0; k < kSides; ++k)  // The axes before the main one, and then those behind it.
    to.place[k] = unfused(select(axis > static_cast<std::int32_t>(k), way[k], way[k + 1]) * scale) + 0.5F;
  to.face = shifted_left(axis, 1) - EightInts::minus_one_where(along < 0.0F);
  std::array<float, 8> has_beams{};
  for (std::size_t f = 0; f < kFaces; ++f) has_beams[f] = has_beams_[f] ? 1.0F : 0.0F;
  to.has_beams = one_of_eight(has_beams.data(), to.face) > 0.0F;
  return to;
}

template <int D>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightMask
RangePyramid<D>::hides(const std::array<EightFloats, std::size_t{D}>& centers, const EightFloats& radius,
                       const EightFloats& distance) const {
  const EightDirections to = directions_of(centers);
  EightMask hidden = distance > farthest_;
  EightMask open = (to.depth > 2.0F * radius).without(hidden);
  const EightFloats reach = 0.75F * radius / (to.depth - radius);
  for (const Level& level : levels_) {
    const auto side = static_cast<float>(level.side);
    EightMask here = open;
    if (&level != &levels_.back()) here = here & (reach * side <= 1.0F);
    if (here.set() == 0) continue;
    open = open.without(here);
    here = here & (reach * side <= 2.0F);
    std::array<EightInts, kSides> first;
    std::array<EightInts, kSides> last;
    for (std::size_t k = 0; k < kSides; ++k) {
      const EightFloats lower = (to.place[k] - reach) * side - 1.0F;
      const EightFloats upper = (to.place[k] + reach) * side + 1.0F;
      here = here & (lower >= 0.0F) & (upper < side);
      first[k] = truncated(lower);
      last[k] = truncated(upper);
    }
    hidden = hidden | here.without(to.has_beams);
    here = here & to.has_beams;
    const float* const most = most_.data() + level.first;
    EightMask passed = EightMask::none();
    for (int i = 0; i < kMostOnSide; ++i) {
      const EightInts row = first[0] + i;
      EightMask in_row = here.without(passed).without(row > last[0]);
      if (in_row.set() == 0) break;
      if constexpr (D == 2) {
        passed = passed | (in_row & (gathered(most, to.face * level.side + row, in_row) > distance));
      } else {
        const EightInts begin = (to.face * level.side + row) * level.side;
        for (int j = 0; j < kMostOnSide; ++j) {
          const EightInts column = first[1] + j;
          in_row = in_row.without(column > last[1]);
          if (in_row.set() == 0) break;
          passed = passed | (in_row & (gathered(most, begin + column, in_row) > distance));
        }
      }
    }
    hidden = hidden | here.without(passed);
  }
  return hidden;
}

template <int D>
NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightFloats RangePyramid<D>::surely_passed(
    const std::array<EightFloats, std::size_t{D}>& points, const EightFloats& distance,
    const EightFloats& radius, const EightFloats& least, const EightMask& wanted) const {
  const EightDirections to = directions_of(points);
  const EightInts& face = to.face;
  EightMask open = wanted & (distance > radius) & to.has_beams;
  EightMask sparse = EightMask::none();
  EightMask near = EightMask::none();
  EightFloats passed = -1.0F;
  const EightFloats most_pixels = 2.0F * to.depth / radius;
  for (const Level& level : levels_) {
    const EightMask here = open & (EightFloats(static_cast<float>(level.side)) <= most_pixels);
    if (here.set() == 0) continue;
    EightInts pixel = face;
    for (std::size_t k = 0; k < kSides; ++k) {
      const EightInts at = truncated(to.place[k] * static_cast<float>(level.side));
      pixel = pixel * level.side + select(at > level.side - 1, level.side - 1, max_of(at, 0));
    }
    const EightFloats found = gathered(around_.data() + level.first, pixel, here);
    const EightMask is_beyond = here & (sparse | (abs_of(found) >= least));
    const EightMask is_seen = bits_of(found) > -1;
    passed = select(is_beyond & is_seen, select(sparse, kSparse, found), passed);
    const EightMask is_unseen = is_beyond.without(is_seen);
    near = near | (is_unseen & (abs_of(found) < kHole)).without(sparse);
    if (level.side <= kWidestGap) passed = select(is_unseen & near, kSparse, passed);
    sparse = sparse | is_unseen;
    open = level.side <= kWidestGap ? open.without(here) : open.without(here.without(is_unseen));
  }
  return passed;
}
#endif

template <int D>
bool RangePyramid<D>::hides(const Point& center, float radius, float distance) const {
  if (distance > farthest_) return true;
  const Point way = center - origin_;
  Place place;
  const int face = Faces::face_of(way, place);
  const float depth = std::abs(way[face / 2]);
  if (!(depth > 2.0F * radius)) return false;
  // On the face, of half its side: generous, as the ball is nearer there than its centre is.
  const float reach = 0.75F * radius / (depth - radius);
  std::size_t i = 0;
  while (i + 1 < levels_.size() && reach * static_cast<float>(levels_[i].side) > 1.0F) ++i;
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
    if (most_[level.first + Faces::pixel(face, at, level.side)] > distance) return false;
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
