// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A world of solid shapes that answers whether a point is inside one and where a beam ends: exact truth for
/// maps.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/logs/shape.hpp"

namespace ndtree {

/// The union of solid shapes; it does not change once it is built.
/// A binary tree of boxes over the shapes makes both queries logarithmic in their number.
template <int D>
class World {
 public:
  World() = default;

  /// @throws std::invalid_argument if a shape has no extent, or a number that is not finite.
  explicit World(std::vector<Shape<D>> shapes) : shapes_(std::move(shapes)) {
    for (std::size_t i = 0; i < shapes_.size(); ++i) validate(shapes_[i], i);
    if (!shapes_.empty()) build(0, static_cast<std::uint32_t>(shapes_.size()));
  }

  /// In the order of the boxes' tree, not in the order given.
  [[nodiscard]] const std::vector<Shape<D>>& shapes() const { return shapes_; }

  /// Around everything; an empty world has no bounds.
  [[nodiscard]] std::optional<Box<D>> bounds() const {
    if (nodes_.empty()) return std::nullopt;
    return nodes_.front().bounds;
  }

  /// Whether the point is in a shape or on its surface.
  [[nodiscard]] bool contains(const Vector<D>& point) const {
    std::array<std::uint32_t, kMaxDepth> stack;
    std::size_t waiting = 0;
    if (!nodes_.empty()) stack[waiting++] = 0;
    while (waiting > 0) {
      const std::uint32_t id = stack[--waiting];
      const Node& node = nodes_[id];
      if (!node.bounds.touches({point, point})) continue;
      if (node.count == 0) {
        stack[waiting++] = node.first;
        stack[waiting++] = id + 1;
      }
      for (std::uint32_t i = node.first; i < node.first + node.count; ++i)
        if (shapes_[i].contains(point)) return true;
    }
    return false;
  }

  /// Distance to the first surface along a unit direction [m]: 0 from inside a shape, none if there is no
  /// surface up to and including `max_range`.
  [[nodiscard]] std::optional<double> distance(const Vector<D>& origin, const Vector<D>& direction,
                                               double max_range) const {
    struct Waiting {
      std::uint32_t id;
      double enter;
    };
    std::array<Waiting, kMaxDepth> stack;
    std::size_t waiting = 0;
    double nearest = std::numeric_limits<double>::infinity();
    const auto push = [&](std::uint32_t id, double enter) { stack[waiting++] = {id, enter}; };
    if (!nodes_.empty()) push(0, entry(0, origin, direction));
    while (waiting > 0) {
      const Waiting top = stack[--waiting];
      if (!(top.enter <= max_range && top.enter < nearest)) continue;
      const Node& node = nodes_[top.id];
      for (std::uint32_t i = node.first; i < node.first + node.count; ++i)
        if (const std::optional<double> d = shapes_[i].distance(origin, direction))
          nearest = std::min(nearest, *d);
      if (node.count > 0) continue;
      const double left = entry(top.id + 1, origin, direction);
      const double right = entry(node.first, origin, direction);
      if (left <= right) {
        push(node.first, right);
        push(top.id + 1, left);
      } else {
        push(top.id + 1, left);
        push(node.first, right);
      }
    }
    if (!(nearest <= max_range)) return std::nullopt;
    return nearest;
  }

 private:
  static constexpr std::uint32_t kLeafSize = 2;
  static constexpr std::size_t kMaxDepth = 64;  // the tree is balanced: 2^32 shapes are 32 deep

  /// A leaf holds `count` shapes from `first`; an inner node's children are the next node and `first`.
  struct Node {
    Box<D> bounds;
    std::uint32_t first = 0;
    std::uint32_t count = 0;
  };

  static void validate(const Shape<D>& shape, std::size_t i) {
    const bool finite = shape.center.allFinite() && shape.half.allFinite() && shape.heading.allFinite();
    if (!finite || !(shape.half.array() > 0.0).all() || shape.round_axes < 0 || shape.round_axes > D)
      throw std::invalid_argument("shape " + std::to_string(i) +
                                  ": must be finite, with extents > 0 and round_axes from 0 to " +
                                  std::to_string(D));
  }

  /// Where the beam enters a node's box; infinite if it misses it.
  [[nodiscard]] double entry(std::uint32_t id, const Vector<D>& origin, const Vector<D>& direction) const {
    detail::Interval inside{0.0, std::numeric_limits<double>::infinity()};
    const Box<D>& box = nodes_[id].bounds;
    for (int k = 0; k < D; ++k) inside.clip(origin[k], direction[k], box.lower[k], box.upper[k]);
    return inside.enter <= inside.exit ? inside.enter : std::numeric_limits<double>::infinity();
  }

  /// Wider by the rounding errors of a turned shape, so that no point of a shape is outside its box.
  static Box<D> rounded_out(const Box<D>& box) {
    constexpr double rounding = 8.0 * std::numeric_limits<double>::epsilon();
    const Vector<D> margin = rounding * box.lower.cwiseAbs().cwiseMax(box.upper.cwiseAbs());
    return {box.lower - margin, box.upper + margin};
  }

  // Halves [begin, end) at the median centre along the axis on which the centres spread most.
  void build(std::uint32_t begin, std::uint32_t end) {
    const auto id = static_cast<std::uint32_t>(nodes_.size());
    Box<D> bounds = rounded_out(shapes_[begin].bounds());
    Box<D> centers{shapes_[begin].center, shapes_[begin].center};
    for (std::uint32_t i = begin + 1; i < end; ++i) {
      const Box<D> box = rounded_out(shapes_[i].bounds());
      bounds = {bounds.lower.cwiseMin(box.lower), bounds.upper.cwiseMax(box.upper)};
      centers = {centers.lower.cwiseMin(shapes_[i].center), centers.upper.cwiseMax(shapes_[i].center)};
    }
    nodes_.push_back({bounds, begin, end - begin});
    if (end - begin <= kLeafSize) return;
    Eigen::Index axis = 0;
    (centers.upper - centers.lower).maxCoeff(&axis);
    const std::uint32_t middle = begin + (end - begin) / 2;
    std::nth_element(
        shapes_.begin() + begin, shapes_.begin() + middle, shapes_.begin() + end,
        [axis](const Shape<D>& a, const Shape<D>& b) { return a.center[axis] < b.center[axis]; });
    build(begin, middle);
    nodes_[id].count = 0;
    nodes_[id].first = static_cast<std::uint32_t>(nodes_.size());
    build(middle, end);
  }

  std::vector<Shape<D>> shapes_;
  std::vector<Node> nodes_;
};

}  // namespace ndtree
