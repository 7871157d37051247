// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The pose of a scan in a map.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ndtree/alignment/matcher.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"

namespace ndtree {

/// Points that fill boxes with a spacing of at most a cell: the centres of equal parts.
template <int D>
class PointsOfBoxes {
 public:
  explicit PointsOfBoxes(double cell_size) : cell_size_(cell_size) {}

  void add(const Box<D>& box) {
    std::array<std::size_t, std::size_t{D}> count;
    std::size_t total = 1;
    for (int a = 0; a < D; ++a) {
      const double parts = std::ceil((box.upper[a] - box.lower[a]) / cell_size_ - kOnBorder);
      total *= count[static_cast<std::size_t>(a)] = static_cast<std::size_t>(std::max(1.0, parts));
    }
    for (std::size_t i = 0; i < total; ++i) {
      std::size_t rest = i;
      for (int a = 0; a < D; ++a) {
        const std::size_t parts = count[static_cast<std::size_t>(a)];
        const double place = (static_cast<double>(rest % parts) + 0.5) / static_cast<double>(parts);
        numbers_.push_back(box.lower[a] + place * (box.upper[a] - box.lower[a]));
        rest /= parts;
      }
    }
  }
  [[nodiscard]] Points<D> points() const {
    return Eigen::Map<const Points<D>>(numbers_.data(), D, static_cast<Eigen::Index>(numbers_.size()) / D);
  }

 private:
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

/// A matcher of the occupied cells of a map that share a point with a box; for many scans it is made once.
/// O(leaves in the box + occupied space in it).
/// @throws std::invalid_argument as Matcher.
template <class Map>
[[nodiscard]] Matcher<Map::kDim> matcher(const Map& map, const Box<Map::kDim>& box,
                                         const MatchOptions& options = {}) {
  options.validate();
  RegionStates occupied;
  occupied.occupied = true;
  PointsOfBoxes<Map::kDim> surface(options.cell_size);
  for_each_leaf_of(map, box, occupied, [&](const auto& leaf) { surface.add(map.tree().box(leaf.index)); });
  return Matcher<Map::kDim>(surface.points(), options);
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
