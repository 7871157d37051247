// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where known free space ends and nobody has looked further.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"

namespace ndtree {

/// Free cells beside each other that border on unknown space.
template <int D>
struct Frontier {
  std::vector<Box<D>> cells;                ///< The free ones, of any size.
  double area = 0.0;                        ///< Of the border: [m] in 2-D, [m²] in 3-D.
  Vector<D> center = Vector<D>::Zero();     ///< Of the border [m].
  Vector<D> direction = Vector<D>::Zero();  ///< Into the unknown, of length 1; 0 if it is on all sides.
};

namespace detail {

/// The face that two boxes share, if they do not overlap and it has an area.
template <int D>
struct SharedFace {
  double area = 0.0;
  Vector<D> center = Vector<D>::Zero();
  int axis = 0;
  bool is_upper = false;  ///< Of the first.

  SharedFace(const Box<D>& box, const Box<D>& other) {
    int touching = 0;
    double product = 1.0;
    for (int a = 0; a < D; ++a) {
      const double lower = std::max(box.lower[a], other.lower[a]);
      const double upper = std::min(box.upper[a], other.upper[a]);
      center[a] = 0.5 * (lower + upper);
      if (upper > lower) {
        product *= upper - lower;
        continue;
      }
      ++touching;
      axis = a;
      is_upper = other.lower[a] >= box.upper[a];
    }
    if (touching == 1) area = product;
  }
};

/// Sets that grow together.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n) : parent_(n) {
    std::iota(parent_.begin(), parent_.end(), std::size_t{0});
  }
  [[nodiscard]] std::size_t find(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  /// The one with the lower number stands for both.
  void join(std::size_t a, std::size_t b) {
    a = find(a);
    b = find(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::size_t> parent_;
};

/// @param least area of a frontier.
template <int D>
[[nodiscard]] std::vector<Frontier<D>> frontiers_between(const std::vector<Box<D>>& free,
                                                         const std::vector<Box<D>>& unknown, double least) {
  struct Border {
    std::size_t cell;
    double area = 0.0;
    Vector<D> center = Vector<D>::Zero();  // Times the area, as the direction.
    Vector<D> direction = Vector<D>::Zero();
  };
  const BoxTree<D> beyond(unknown);
  std::vector<Border> borders;
  std::vector<Box<D>> boxes;
  constexpr std::size_t kSteps = 32;  // Of a cell's surroundings.
  for_each_paced(free.size(), kSteps, [&](std::size_t i) {
    Border border{i};
    beyond.for_each_touching(free[i], [&](std::uint32_t number) {
      const SharedFace<D> face(free[i], beyond.box(number));
      if (!(face.area > 0.0)) return;
      border.area += face.area;
      border.center += face.area * face.center;
      border.direction[face.axis] += face.is_upper ? face.area : -face.area;
    });
    if (!(border.area > 0.0)) return;
    borders.push_back(border);
    boxes.push_back(free[i]);
  });
  const BoxTree<D> places(boxes);
  DisjointSets sets(borders.size());
  for_each_paced(borders.size(), kSteps, [&](std::size_t i) {
    places.for_each_touching(boxes[i], [&](std::uint32_t number) { sets.join(i, places.index(number)); });
  });
  std::vector<Frontier<D>> all(borders.size());
  for (std::size_t i = 0; i < borders.size(); ++i) {
    Frontier<D>& frontier = all[sets.find(i)];
    frontier.cells.push_back(boxes[i]);
    frontier.area += borders[i].area;
    frontier.center += borders[i].center;
    frontier.direction += borders[i].direction;
  }
  all.erase(std::remove_if(all.begin(), all.end(),
                           [least](const Frontier<D>& f) { return f.cells.empty() || f.area < least; }),
            all.end());
  for (Frontier<D>& frontier : all) {
    frontier.center /= frontier.area;
    const double length = frontier.direction.norm();
    if (length > 1e-9 * frontier.area)
      frontier.direction /= length;
    else
      frontier.direction.setZero();
  }
  std::stable_sort(all.begin(), all.end(),
                   [](const Frontier<D>& a, const Frontier<D>& b) { return a.area > b.area; });
  return all;
}

}  // namespace detail

/// Where free cells border on unknown space, outside the map too; the largest first. Cells that share a
/// point belong together.
/// @param box free cells that share a point with it count; none: all.
/// @param min_cells frontiers whose border is smaller than so many faces of smallest cells are left out.
/// @throws std::invalid_argument if the box is upside down or min_cells negative. O(cells log cells).
template <class Map>
[[nodiscard]] std::vector<Frontier<Map::kDim>> frontiers(
    const Map& map, const std::optional<Box<Map::kDim>>& box = std::nullopt, double min_cells = 8.0) {
  constexpr int D = Map::kDim;
  if (!(min_cells >= 0.0))
    throw std::invalid_argument("min_cells = " + describe_number(min_cells) + ": must be >= 0");
  if (box && !(box->lower.array() <= box->upper.array()).all())
    throw std::invalid_argument("box: its lower corner must not lie above the upper one");
  const auto& tree = map.tree();
  const double smallest = tree.geometry().unit();
  const Box<D> root = tree.box(tree.root().index);
  RegionStates is_free;
  is_free.free = true;
  RegionStates is_unknown;
  is_unknown.unknown = true;
  const std::vector<Box<D>> free = boxes_of(map, box ? *box : root, is_free);
  Box<D> around = root;
  if (!free.empty()) around = free.front();
  for (const Box<D>& cell : free)
    around = {around.lower.cwiseMin(cell.lower), around.upper.cwiseMax(cell.upper)};
  around.lower.array() -= smallest;
  around.upper.array() += smallest;
  const double least = min_cells * std::pow(smallest, D - 1) * (1.0 - 1e-9);
  return detail::frontiers_between(free, boxes_of(map, around, is_unknown), least);
}

}  // namespace ndtree
