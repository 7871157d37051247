// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Signed distance to obstacles on a grid of points, exact for cells of any size.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

/// Signed distances [m] at the centres of equal cells that fill a box: positive outside obstacles, up to
/// max_distance; negative inside, where it is the distance to the nearest space that is none, down to
/// -max_distance; 0 on a border.
template <int D>
class DistanceField {
 public:
  using Shape = std::array<std::size_t, D>;

  /// @param lower corner of the grid. @param shape cells on each axis.
  DistanceField(const Vector<D>& lower, double cell_size, const Shape& shape, double max_distance)
      : lower_(lower), cell_size_(cell_size), shape_(shape), max_distance_(max_distance) {
    std::size_t n = 1;
    for (const std::size_t count : shape) n *= count;
    values_.assign(n, static_cast<float>(max_distance));
  }

  [[nodiscard]] const Vector<D>& lower() const { return lower_; }
  [[nodiscard]] double cell_size() const { return cell_size_; }
  [[nodiscard]] const Shape& shape() const { return shape_; }
  [[nodiscard]] double max_distance() const { return max_distance_; }
  /// Coordinate of the centre of the i-th cell along an axis [m].
  [[nodiscard]] double center(std::size_t axis, std::size_t i) const {
    return lower_[static_cast<int>(axis)] + (static_cast<double>(i) + 0.5) * cell_size_;
  }
  /// Where the value of a cell is.
  [[nodiscard]] std::size_t index(const Shape& cell) const {
    std::size_t at = 0;
    for (std::size_t a = 0; a < D; ++a) at = at * shape_[a] + cell[a];
    return at;
  }
  /// In the order of a C array: the last axis varies fastest.
  [[nodiscard]] const std::vector<float>& values() const { return values_; }
  [[nodiscard]] std::vector<float>& values() { return values_; }

  /// Between the centres of cells, linear on each axis; NaN outside the grid, and constant towards its border
  /// from the last centres on.
  [[nodiscard]] double distance(const Vector<D>& point) const {
    Corners corners;
    return find(point, corners) ? sum(corners, -1) : std::numeric_limits<double>::quiet_NaN();
  }
  /// Of distance(); towards free space.
  [[nodiscard]] Vector<D> gradient(const Vector<D>& point) const {
    Corners corners;
    if (!find(point, corners)) return Vector<D>::Constant(std::numeric_limits<double>::quiet_NaN());
    Vector<D> result;
    for (int a = 0; a < D; ++a) result[a] = sum(corners, a) / cell_size_;
    return result;
  }

 private:
  struct Corners {
    std::array<std::size_t, D> first;
    std::array<std::size_t, D> second;  // The same at the border.
    std::array<double, D> share;        // Of the second.
  };

  [[nodiscard]] bool find(const Vector<D>& point, Corners& corners) const {
    for (std::size_t a = 0; a < D; ++a) {
      const double place = (point[static_cast<int>(a)] - lower_[static_cast<int>(a)]) / cell_size_;
      const auto count = static_cast<double>(shape_[a]);
      if (!(place >= 0.0) || !(place <= count)) return false;
      const double centre = std::clamp(place - 0.5, 0.0, count - 1.0);
      corners.first[a] = std::min(static_cast<std::size_t>(centre), shape_[a] - 1);
      corners.second[a] = std::min(corners.first[a] + 1, shape_[a] - 1);
      corners.share[a] = centre - static_cast<double>(corners.first[a]);
    }
    return true;
  }
  /// The value, or, for an axis, its difference from one centre to the next.
  [[nodiscard]] double sum(const Corners& corners, int along) const {
    double total = 0.0;
    for (unsigned corner = 0; corner < 1u << D; ++corner) {
      double weight = 1.0;
      Shape cell;
      for (std::size_t a = 0; a < D; ++a) {
        const bool is_second = (corner >> a & 1u) != 0;
        cell[a] = is_second ? corners.second[a] : corners.first[a];
        if (static_cast<int>(a) == along)
          weight *= is_second ? 1.0 : -1.0;
        else
          weight *= is_second ? corners.share[a] : 1.0 - corners.share[a];
      }
      total += weight * static_cast<double>(values_[index(cell)]);
    }
    return total;
  }

  Vector<D> lower_;
  double cell_size_;
  Shape shape_;
  double max_distance_;
  std::vector<float> values_;
};

namespace detail {

/// Whether something holds for some place of a block, which is not empty: from the first to before the last
/// on each axis, of which the last varies fastest.
template <class Shape, class Holds>
bool any_place(const Shape& first, const Shape& last, const Holds& holds) {
  Shape at = first;
  for (;;) {
    if (holds(at)) return true;
    std::size_t a = at.size();
    for (; a > 0 && ++at[a - 1] == last[a - 1]; --a) at[a - 1] = first[a - 1];
    if (a == 0) return false;
  }
}

/// Distances from all points of a grid to the nearest of many boxes. Blocks of points are halved, each with
/// those boxes and groups of boxes of which one may be the nearest to one of its points: a group goes as soon
/// as something is surely nearer to all of them. What is left for a block of some dozens of points is looked
/// at one by one.
template <int D>
class NearestBoxes {
 public:
  using Shape = typename DistanceField<D>::Shape;

  NearestBoxes(const DistanceField<D>& field, const BoxTree<D>& boxes)
      : field_(field), boxes_(boxes), limit_(field.max_distance() * field.max_distance()) {}

  /// Calls `visit(index, squared_distance)` for each point for which something is at most max_distance away.
  /// @param wants says of a block, by its first point and the one after its last on each axis, whether any of
  ///   its points is asked for.
  template <class Wants, class Visit>
  void run(const Wants& wants, const Visit& visit) const {
    if (boxes_.empty()) return;
    Block all;
    all.last = field_.shape();
    Pace pace;
    halve(all, {{0, kNotOne}}, wants, visit, pace);
  }

 private:
  static constexpr std::uint32_t kNotOne = 0xffffffffu;
  static constexpr std::size_t kSide = D == 2 ? 8 : 4;  // Of the smallest blocks, in points.

  struct Block {
    Shape first{};
    Shape last{};
  };
  /// A node of the tree of boxes, or one box.
  struct Candidate {
    std::uint32_t node;
    std::uint32_t box;
  };

  /// Around the points.
  [[nodiscard]] Box<D> box_of(const Block& block) const {
    Box<D> box;
    for (std::size_t a = 0; a < D; ++a) {
      box.lower[static_cast<int>(a)] = field_.center(a, block.first[a]);
      box.upper[static_cast<int>(a)] = field_.center(a, block.last[a] - 1);
    }
    return box;
  }
  [[nodiscard]] const Box<D>& bounds(const Candidate& candidate) const {
    return candidate.box == kNotOne ? boxes_.nodes()[candidate.node].bounds : boxes_.box(candidate.box);
  }
  /// No point of one is nearer to a point of the other.
  [[nodiscard]] static double least(const Box<D>& points, const Box<D>& box) {
    return (box.lower - points.upper).cwiseMax(points.lower - box.upper).cwiseMax(0.0).squaredNorm();
  }
  /// From each point something of the candidate is at most so far away.
  [[nodiscard]] double most(const Box<D>& points, const Candidate& candidate) const {
    const Box<D>& box = bounds(candidate);
    if (candidate.box != kNotOne)
      return (box.lower - points.lower).cwiseMax(points.upper - box.upper).cwiseMax(0.0).squaredNorm();
    return (box.upper - points.lower).cwiseMax(points.upper - box.lower).squaredNorm();
  }

  template <class Wants, class Visit>
  void halve(const Block& block, const std::vector<Candidate>& above, const Wants& wants, const Visit& visit,
             Pace& pace) const {
    if (!wants(block.first, block.last)) return;
    const Box<D> points = box_of(block);
    std::size_t longest = 0;
    for (std::size_t a = 1; a < D; ++a)
      if (block.last[a] - block.first[a] > block.last[longest] - block.first[longest]) longest = a;
    const bool is_small = block.last[longest] - block.first[longest] <= kSide;
    const double extent = is_small ? -1.0 : (points.upper - points.lower).maxCoeff();

    double nearest = limit_;
    for (const Candidate& candidate : above) nearest = std::min(nearest, most(points, candidate));
    std::vector<Candidate> candidates;
    std::vector<Candidate> open = above;
    while (!open.empty()) {
      const Candidate candidate = open.back();
      open.pop_back();
      pace.spend();
      const Box<D>& box = bounds(candidate);
      if (least(points, box) > nearest) continue;
      if (candidate.box != kNotOne || (box.upper - box.lower).maxCoeff() <= extent) {
        candidates.push_back(candidate);
        continue;
      }
      const auto add = [&](const Candidate& part) {
        nearest = std::min(nearest, most(points, part));
        open.push_back(part);
      };
      const auto& node = boxes_.nodes()[candidate.node];
      if (node.is_leaf()) {
        for (std::uint32_t i = node.first; i < node.last; ++i) add({0, i});
      } else {
        add({candidate.node + 1, kNotOne});
        add({node.second, kNotOne});
      }
    }
    candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                    [&](const Candidate& c) { return least(points, bounds(c)) > nearest; }),
                     candidates.end());
    if (candidates.empty()) return;
    if (is_small) {
      pace.spend(candidates.size() * static_cast<std::size_t>(integer_power(kSide, D)));
      look_at_all(block, candidates, visit);
      return;
    }
    Block half = block;
    half.last[longest] = block.first[longest] + (block.last[longest] - block.first[longest]) / 2;
    halve(half, candidates, wants, visit, pace);
    half.first[longest] = half.last[longest];
    half.last[longest] = block.last[longest];
    halve(half, candidates, wants, visit, pace);
  }

  template <class Visit>
  void look_at_all(const Block& block, const std::vector<Candidate>& candidates, const Visit& visit) const {
    constexpr auto kPoints = static_cast<std::size_t>(integer_power(kSide, D));
    std::array<double, kPoints> squared;
    squared.fill(std::numeric_limits<double>::infinity());
    for (const Candidate& candidate : candidates) {
      const Box<D>& box = boxes_.box(candidate.box);
      std::array<std::array<double, kSide>, D> across{};  // Squared distance on each axis alone.
      for (std::size_t a = 0; a < D; ++a)
        for (std::size_t i = 0; i < block.last[a] - block.first[a]; ++i) {
          const double at = field_.center(a, block.first[a] + i);
          const double d =
              std::max({box.lower[static_cast<int>(a)] - at, at - box.upper[static_cast<int>(a)], 0.0});
          across[a][i] = d * d;
        }
      add_up<0>(across, 0.0, 0, squared);
    }
    any_place(block.first, block.last, [&](const Shape& at) {
      std::size_t in_block = 0;
      for (std::size_t a = 0; a < D; ++a) in_block = in_block * kSide + (at[a] - block.first[a]);
      if (squared[in_block] <= limit_) visit(field_.index(at), squared[in_block]);
      return false;
    });
  }
  template <std::size_t A, class Across, class Squared>
  static void add_up(const Across& across, double sum, std::size_t at, Squared& squared) {
    for (std::size_t i = 0; i < kSide; ++i) {
      if constexpr (A + 1 < D)
        add_up<A + 1>(across, sum + across[A][i], (at + i) * kSide, squared);
      else
        squared[at + i] = std::min(squared[at + i], sum + across[A][i]);
    }
  }

  const DistanceField<D>& field_;
  const BoxTree<D>& boxes_;
  double limit_;
};

}  // namespace detail

/// What distance_field() of any map works on.
/// @param obstacles boxes, as far as max_distance around the field. @param others gives those of what is no
///   obstacle; it is asked only if a point lies in an obstacle.
template <int D, class Others>
void fill(DistanceField<D>& field, const std::vector<Box<D>>& obstacles, const Others& others) {
  std::vector<float>& values = field.values();
  const BoxTree<D> tree(obstacles);
  detail::NearestBoxes<D>(field, tree)
      .run([](const auto&, const auto&) { return true; },
           [&](std::size_t i, double squared) { values[i] = static_cast<float>(std::sqrt(squared)); });
  if (std::find(values.begin(), values.end(), 0.0f) == values.end()) return;
  const auto any_inside = [&](const auto& first, const auto& last) {
    return detail::any_place(first, last, [&](const auto& at) { return values[field.index(at)] <= 0.0f; });
  };
  std::vector<float> inside(values.size(), static_cast<float>(field.max_distance()));
  const BoxTree<D> rest(others());
  detail::NearestBoxes<D>(field, rest).run(any_inside, [&](std::size_t i, double squared) {
    inside[i] = static_cast<float>(std::sqrt(squared));
  });
  for (std::size_t i = 0; i < values.size(); ++i)
    if (values[i] == 0.0f) values[i] = -inside[i];
}

/// Signed Euclidean distance to the nearest obstacle, at the centres of cells of `cell_size` that fill a box:
/// exact, whatever the sizes of the map's cells and of these.
/// @param box is rounded up to whole cells, from its lower corner on.
/// @param max_distance that matters, > 0 [m]. @param unknown an obstacle or not.
/// @throws std::invalid_argument if the box is empty or not finite, or a size not > 0 and finite.
/// O((cells of the field + map cells around it) log).
template <class Map>
[[nodiscard]] DistanceField<Map::kDim> distance_field(const Map& map, const Box<Map::kDim>& box,
                                                      double cell_size, double max_distance,
                                                      UnknownSpace unknown = UnknownSpace::free) {
  constexpr int D = Map::kDim;
  const auto require = [](bool holds, const char* name, double value, const char* what) {
    if (!holds)
      throw std::invalid_argument(std::string(name) + " = " + describe_number(value) + " m: " + what);
  };
  require(cell_size > 0.0 && std::isfinite(cell_size), "cell_size", cell_size, "must be > 0 and finite");
  require(max_distance > 0.0 && std::isfinite(max_distance), "max_distance", max_distance,
          "must be > 0 and finite");
  typename DistanceField<D>::Shape shape;
  double cells = 1.0;
  for (int a = 0; a < D; ++a) {
    const double extent = box.upper[a] - box.lower[a];
    require(extent > 0.0 && std::isfinite(extent), "extent of the box", extent, "must be > 0 and finite");
    const double count = std::max(1.0, std::ceil(extent / cell_size - 1e-9));
    cells *= count;
    require(cells <= 4e9, "cell_size", cell_size, "the box has more than 4e9 such cells");
    shape[static_cast<std::size_t>(a)] = static_cast<std::size_t>(count);
  }
  DistanceField<D> field(box.lower, cell_size, shape, max_distance);
  Box<D> around = box;
  for (int a = 0; a < D; ++a)
    around.upper[a] = box.lower[a] + static_cast<double>(shape[static_cast<std::size_t>(a)]) * cell_size;
  around.lower.array() -= max_distance;
  around.upper.array() += max_distance;
  RegionStates obstacles;
  obstacles.occupied = true;
  obstacles.unknown = unknown == UnknownSpace::occupied;
  RegionStates others;
  others.free = true;
  others.unknown = !obstacles.unknown;
  fill(field, boxes_of(map, around, obstacles), [&] { return boxes_of(map, around, others); });
  return field;
}

}  // namespace ndtree
