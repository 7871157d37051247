// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which of many boxes are near.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Boxes, halved again and again at the median of their centres on the axis on which those spread most; each
/// half has the box around its boxes. Immutable.
template <int D>
class BoxTree {
 public:
  /// O(n log n). @pre all are finite, and there are less than 2^32.
  explicit BoxTree(const std::vector<Box<D>>& boxes) : index_(boxes.size()) {
    std::iota(index_.begin(), index_.end(), std::uint32_t{0});
    Pace pace;
    if (!boxes.empty()) build(boxes, 0, static_cast<std::uint32_t>(boxes.size()), pace);
    boxes_.reserve(boxes.size());
    for (const std::uint32_t i : index_) boxes_.push_back(boxes[i]);
  }

  [[nodiscard]] bool empty() const { return boxes_.empty(); }
  /// By the tree's own numbers.
  [[nodiscard]] const Box<D>& box(std::uint32_t number) const { return boxes_[number]; }
  /// Where it was in the vector that the tree was made from.
  [[nodiscard]] std::size_t index(std::uint32_t number) const { return index_[number]; }

  /// Calls `visit(number)` for each box that shares a point with a region, both closed.
  template <class Visit>
  void for_each_touching(const Box<D>& region, const Visit& visit) const {
    if (!empty()) descend(0, region, visit);
  }

  /// Calls `visit(number)` for each box that is at most so far from a region, but for those in a larger box
  /// that by then does not matter any more. What is nearer comes first, more or less.
  /// @param squared distance [m²].
  template <class Matters, class Visit>
  void for_each_within(const Box<D>& region, double squared, const Matters& matters,
                       const Visit& visit) const {
    if (!empty() && region.squared_distance(nodes_[0].bounds) <= squared)
      descend_within(0, region, squared, matters, visit);
  }

  /// Whether some box is at most so far from a region [m].
  [[nodiscard]] bool any_within(const Box<D>& region, double distance) const {
    return !empty() && any_within(0, region, distance * distance);
  }

 private:
  static constexpr std::uint32_t kLeafSize = 4;

  /// A box that holds those of the numbers [first, last). Its halves, if it has any, are the next node, and
  /// that of number `second`. The first node holds all.
  struct Node {
    Box<D> bounds;
    std::uint32_t first = 0;
    std::uint32_t last = 0;
    std::uint32_t second = 0;

    [[nodiscard]] bool is_leaf() const { return second == 0; }
  };

  [[nodiscard]] bool any_within(std::uint32_t id, const Box<D>& region, double squared) const {
    const Node& node = nodes_[id];
    if (region.squared_distance(node.bounds) > squared) return false;
    if (!node.is_leaf())
      return any_within(id + 1, region, squared) || any_within(node.second, region, squared);
    return std::any_of(boxes_.begin() + node.first, boxes_.begin() + node.last,
                       [&](const Box<D>& box) { return region.squared_distance(box) <= squared; });
  }

  template <class Matters, class Visit>
  void descend_within(std::uint32_t id, const Box<D>& region, double squared, const Matters& matters,
                      const Visit& visit) const {
    const Node& node = nodes_[id];
    if (!matters(node.bounds)) return;
    if (node.is_leaf()) {
      for (std::uint32_t i = node.first; i < node.last; ++i)
        if (region.squared_distance(boxes_[i]) <= squared) visit(i);
      return;
    }
    std::array<std::uint32_t, 2> halves{id + 1, node.second};
    std::array<double, 2> distances;
    for (std::size_t i = 0; i < 2; ++i) distances[i] = region.squared_distance(nodes_[halves[i]].bounds);
    const std::size_t first = distances[1] < distances[0] ? 1 : 0;
    for (const std::size_t i : {first, 1 - first})
      if (distances[i] <= squared) descend_within(halves[i], region, squared, matters, visit);
  }

  template <class Visit>
  void descend(std::uint32_t id, const Box<D>& region, const Visit& visit) const {
    const Node& node = nodes_[id];
    if (!region.touches(node.bounds)) return;
    if (!node.is_leaf()) {
      descend(id + 1, region, visit);
      descend(node.second, region, visit);
      return;
    }
    for (std::uint32_t i = node.first; i < node.last; ++i)
      if (region.touches(boxes_[i])) visit(i);
  }

  void build(const std::vector<Box<D>>& boxes, std::uint32_t first, std::uint32_t last, Pace& pace) {
    pace.spend(last - first);
    Box<D> bounds = boxes[index_[first]];
    Box<D> centres{bounds.lower + bounds.upper, bounds.lower + bounds.upper};  // Twice as far from 0.
    for (std::uint32_t i = first + 1; i < last; ++i) {
      const Box<D>& box = boxes[index_[i]];
      bounds = {bounds.lower.cwiseMin(box.lower), bounds.upper.cwiseMax(box.upper)};
      const Vector<D> centre = box.lower + box.upper;
      centres = {centres.lower.cwiseMin(centre), centres.upper.cwiseMax(centre)};
    }
    const std::size_t id = nodes_.size();
    nodes_.push_back({bounds, first, last, 0});
    if (last - first <= kLeafSize) return;
    Eigen::Index axis = 0;
    (centres.upper - centres.lower).maxCoeff(&axis);
    const auto place = [&](std::uint32_t i) { return boxes[i].lower[axis] + boxes[i].upper[axis]; };
    const std::uint32_t middle = first + (last - first) / 2;
    std::nth_element(index_.begin() + first, index_.begin() + middle, index_.begin() + last,
                     [&](std::uint32_t a, std::uint32_t b) { return place(a) < place(b); });
    build(boxes, first, middle, pace);
    nodes_[id].second = static_cast<std::uint32_t>(nodes_.size());
    build(boxes, middle, last, pace);
  }

  std::vector<Node> nodes_;
  std::vector<Box<D>> boxes_;
  std::vector<std::uint32_t> index_;
};

}  // namespace ndtree
