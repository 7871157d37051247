// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Free places around a pose of a body, and what is in its way there.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/place_cell.hpp"
#include "ndtree/planning/place_walk.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/collision.hpp"

namespace ndtree::detail {

/// All smallest cells that come within a distance of a point, both in smallest cells.
template <int D>
[[nodiscard]] LatticeBox<D> cells_near(const Vector<D>& at, double reach) {
  LatticeBox<D> box;
  for (std::size_t a = 0; a < D; ++a) {
    box.lower[a] = static_cast<std::int64_t>(std::floor(at[static_cast<int>(a)] - reach)) - 1;
    box.upper[a] = static_cast<std::int64_t>(std::ceil(at[static_cast<int>(a)] + reach)) + 1;
  }
  return box;
}

/// Where a search may begin or end: at a pose, in smallest cells, or, if its cell is not free as a whole, at
/// the nearest places in cells that are. @param goes_to whether the body can go straight to such a place.
template <class Space, class GoesTo>
[[nodiscard]] std::vector<Anchor<Space::D>> anchors_at(Space& space, const Vector<Space::D>& at,
                                                       const GoesTo& goes_to) {
  constexpr int D = Space::D;
  constexpr std::size_t kMost = 16;
  constexpr double kFarthest = 16.0;
  const PlaceCell<D> own = space.cell_at(cell_ahead<D>(at, Vector<D>::Zero()));
  if (own.passage != Passage::blocked) return {{at, own, 0.0}};
  std::vector<Anchor<D>> found;
  for (double reach = 2.0; reach <= kFarthest && found.empty(); reach *= 2.0) {
    std::vector<Anchor<D>> candidates;
    space.for_each_in(cells_near<D>(at, reach), [&](const PlaceCell<D>& cell) {
      const Vector<D> place = nearest_in(common_box(cell, cell), at);
      candidates.push_back({place, cell, (place - at).norm()});
    });
    std::sort(candidates.begin(), candidates.end(), [](const Anchor<D>& a, const Anchor<D>& b) {
      return a.way != b.way ? a.way < b.way : a.cell.number < b.cell.number;
    });
    for (const Anchor<D>& anchor : candidates) {
      if (found.size() == kMost) break;
      if (goes_to(anchor.point)) found.push_back(anchor);
    }
  }
  return found;
}

/// The nearest cell that a body meets at a point. @pre it meets one, or unknown space outside the map.
template <class Map>
[[nodiscard]] std::string obstacle_in_words(const Map& map, const Body<Map::kDim>& body,
                                            const Vector<Map::kDim>& point, UnknownSpace unknown) {
  constexpr int D = Map::kDim;
  Pose<D> pose;
  pose.translation = point;
  RegionStates states;
  states.occupied = true;
  states.unknown = unknown == UnknownSpace::occupied;
  std::optional<std::pair<Box<D>, CellState>> found;
  double least = std::numeric_limits<double>::infinity();
  for (const BodyPart<D>& part : moved(body, pose))
    for_each_leaf_of(map, bounds_of(part), states, [&](const auto& leaf) {
      const Box<D> box = map.tree().box(leaf.index);
      const double squared = box.squared_distance(point);
      if (squared >= least || !touch(part, box)) return;
      least = squared;
      found = {box, leaf.cell().state()};
    });
  if (!found) return "unknown space outside the map";
  return std::string(found->second == CellState::occupied ? "the occupied" : "the unknown") + " cell from " +
         describe_point(found->first.lower) + " to " + describe_point(found->first.upper);
}

}  // namespace ndtree::detail
