// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The pose of a scan in a map.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/alignment/match_options.hpp"
#include "ndtree/alignment/matcher.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/alignment/surface_elements.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/point.hpp"

namespace ndtree {

/// The surfaces of occupied boxes: the centres of their outermost cells beside which there is free space. It
/// is from there that beams came; cells behind were never reached, or by noise.
///
/// What is not flat is told along axes with free space on both sides, in space on one where something is
/// above or below: rings on the ground end where beams do, and not where the ground ends.
///
/// Boxes are added; then the states of their neighbours are asked for, at the centres that `beside()`
/// returns, 2 D for each candidate. A lattice of cells has no better estimate of where the surface is than
/// its cells' centres: see "Poses" in docs/derivation.md.
template <int D>
class SurfaceOfBoxes {
 public:
  explicit SurfaceOfBoxes(double cell_size) : cell_size_(cell_size) {}

  /// O(cells on the box's sides).
  void add(const Box<D>& box) {
    std::array<std::int64_t, std::size_t{D}> count;
    std::array<std::int64_t, std::size_t{D}> at{};
    for (int a = 0; a < D; ++a) {
      const double parts = std::ceil((box.upper[a] - box.lower[a]) / cell_size_ - kOnBorder);
      count[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(std::max(1.0, parts));
    }
    const auto is_outermost = [&](std::size_t a) { return at[a] == 0 || at[a] == count[a] - 1; };
    for (bool is_left = true; is_left;) {
      bool is_inside = true;
      for (std::size_t a = 0; a < std::size_t{D}; ++a) is_inside = is_inside && !is_outermost(a);
      if (!is_inside)
        for (int a = 0; a < D; ++a) {
          const auto axis = static_cast<std::size_t>(a);
          const double place = (static_cast<double>(at[axis]) + 0.5) / static_cast<double>(count[axis]);
          numbers_.push_back(box.lower[a] + place * (box.upper[a] - box.lower[a]));
        }
      // The next, the last axis first; over the inside in one step.
      is_left = false;
      for (std::size_t a = std::size_t{D}; a-- > 0;) {
        bool is_row_inside = a == std::size_t{D} - 1 && at[a] == 0;
        for (std::size_t b = 0; b < a; ++b) is_row_inside = is_row_inside && !is_outermost(b);
        at[a] = is_row_inside ? std::max<std::int64_t>(count[a] - 1, 1) : at[a] + 1;
        if (at[a] < count[a]) {
          is_left = true;
          break;
        }
        at[a] = 0;
      }
    }
  }
  /// (D, 2 D n): below and above on each axis.
  [[nodiscard]] Points<D> beside() const {
    const Points<D> all = candidates();
    Points<D> beside(D, 2 * D * all.cols());
    for (Eigen::Index i = 0; i < beside.cols(); ++i) {
      beside.col(i) = all.col(i / (2 * D));
      beside(i / 2 % D, i) += i % 2 == 0 ? -cell_size_ : cell_size_;
    }
    return beside;
  }
  /// @param states of beside(). Where there is no free space at all, every candidate is a surface of any
  /// side.
  [[nodiscard]] SurfacePoints<D> surface(const std::vector<std::int8_t>& states) const {
    SurfacePoints<D> surface{candidates(), {}, cell_size_, {}};
    surface.sides = surface.open = Points<D>::Zero(D, surface.points.cols());
    Eigen::Index count = 0;
    for (Eigen::Index i = 0; i < surface.points.cols(); ++i) {
      Vector<D> side = Vector<D>::Zero();
      Vector<D> open = Vector<D>::Zero();
      bool stands = false;
      for (int k = 0; k < 2 * D; ++k) {
        const auto beside = static_cast<CellState>(states[static_cast<std::size_t>(2 * D * i + k)]);
        if (k >= 4 && beside == CellState::occupied) stands = true;
        if (beside != CellState::free) continue;
        side[k / 2] += k % 2 == 0 ? -1.0 : 1.0;
        open[k / 2] += 1.0;
      }
      if (open.isZero()) continue;
      const double least = D == 3 && stands ? 1.0 : 2.0;  // Free sides of what is told along an axis.
      surface.points.col(count) = surface.points.col(i);
      surface.open.col(count) = (open.array() >= least).template cast<double>();
      surface.sides.col(count++) = side;
    }
    surface.open.conservativeResize(D, count);
    if (count == 0) return surface;
    surface.points.conservativeResize(D, count);
    surface.sides.conservativeResize(D, count);
    return surface;
  }

 private:
  [[nodiscard]] Points<D> candidates() const {
    return Eigen::Map<const Points<D>>(numbers_.data(), D, static_cast<Eigen::Index>(numbers_.size()) / D);
  }

  double cell_size_;
  std::vector<double> numbers_;
};

/// All places that a scan's points may have in a window, and what lies near.
template <int D>
[[nodiscard]] Box<D> reach_of(const Points<D>& points, const Pose<D>& guess, const Motion<D>& half) {
  double farthest = 0.0;
  for (Eigen::Index i = 0; i < points.cols(); ++i)
    if (points.col(i).allFinite()) farthest = std::max(farthest, points.col(i).norm());
  const Vector<D> reach = half.template head<D>().array() + farthest + 1.0;
  return {guess.translation - reach, guess.translation + reach};
}

/// A matcher of the surfaces of a map in a box; for many scans it is made once. O(leaves in the box +
/// surfaces).
/// @throws std::invalid_argument as Matcher.
template <class Map>
[[nodiscard]] Matcher<Map::kDim> matcher(const Map& map, const Box<Map::kDim>& box,
                                         const MatchOptions& options = {}) {
  options.validate();
  RegionStates occupied;
  occupied.occupied = true;
  SurfaceOfBoxes<Map::kDim> boxes(map.options().min_cell_size);
  for_each_leaf_of(map, box, occupied, [&](const auto& leaf) { boxes.add(map.tree().box(leaf.index)); });
  const Points<Map::kDim> beside = boxes.beside();
  std::vector<std::int8_t> states(static_cast<std::size_t>(beside.cols()));
  for (std::size_t i = 0; i < states.size(); ++i)
    states[i] = static_cast<std::int8_t>(state<Map>(map, beside.col(static_cast<Eigen::Index>(i))));
  return Matcher<Map::kDim>(boxes.surface(states), options);
}

/// The pose of a scan in a map, the best of a window around a guess. @param points in the sensor's frame.
/// @throws std::invalid_argument as Matcher and Matcher::match().
template <class Map>
[[nodiscard]] Match<Map::kDim> match(const Map& map, const Points<Map::kDim>& points,
                                     const Pose<Map::kDim>& guess, const MatchWindow<Map::kDim>& window,
                                     const MatchOptions& options = {}) {
  return matcher(map, reach_of(points, guess, window.half), options).match(points, guess, window);
}

}  // namespace ndtree
