// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which of many points is nearest.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

#include "ndtree/core/types.hpp"

namespace ndtree {

/// Points, halved again and again at the median of the axis on which they spread most. They do not change.
/// Answers equal those of a look at every point: of equally near ones the one with the lowest index.
template <int D>
class KdTree {
 public:
  struct Neighbor {
    Eigen::Index index = 0;  ///< Column of the points.
    double squared_distance = 0.0;
  };

  /// O(n log n). @pre all points are finite, and there are less than 2^32.
  explicit KdTree(const Points<D>& points) : index_(static_cast<std::size_t>(points.cols())) {
    std::iota(index_.begin(), index_.end(), std::uint32_t{0});
    if (!index_.empty()) build(points, 0, static_cast<std::uint32_t>(index_.size()));
    points_.resize(D, points.cols());
    place_.resize(index_.size());
    for (std::uint32_t i = 0; i < index_.size(); ++i) {
      points_.col(i) = points.col(index_[i]);
      place_[index_[i]] = i;
    }
    if (!index_.empty()) bounds_ = {points_.rowwise().minCoeff(), points_.rowwise().maxCoeff()};
  }

  [[nodiscard]] Eigen::Index size() const { return points_.cols(); }

  /// @param max_distance points exactly as far away count; >= 0, or infinite.
  /// @returns none if no point is so near.
  [[nodiscard]] std::optional<Neighbor> nearest(const Vector<D>& query, double max_distance) const {
    const double limit = max_distance * max_distance;
    if (index_.empty() || bounds_.squared_distance(query) > limit) return std::nullopt;
    return search(query, limit, [](std::uint32_t /*place*/) { return true; });
  }

  /// Of all points but the `index`-th the one that is nearest to it, at any distance; none if there is no
  /// other. Another point in the same place is at distance 0.
  [[nodiscard]] std::optional<Neighbor> nearest_other(Eigen::Index index) const {
    const std::uint32_t own = place_[static_cast<std::size_t>(index)];
    return search(points_.col(own), std::numeric_limits<double>::infinity(),
                  [own](std::uint32_t place) { return place != own; });
  }

 private:
  static constexpr std::uint32_t kLeafSize = 8;
  static constexpr std::size_t kMaxDepth = 64;  // The tree is balanced: 2^32 points are 32 deep.

  /// A leaf holds `count` points from `first`. The children of an inner node, with a count of 0, are the next
  /// node, of points at most `split` on `axis`, and `first`, of points at least that.
  struct Node {
    double split = 0.0;
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    Eigen::Index axis = 0;
  };

  template <class Counts>
  [[nodiscard]] std::optional<Neighbor> search(const Vector<D>& query, double limit,
                                               const Counts& counts) const {
    struct Waiting {
      std::uint32_t id;
      double squared_distance;  // No point of the node is nearer.
    };
    std::array<Waiting, kMaxDepth> stack;
    std::size_t waiting = 0;
    std::optional<Neighbor> best;
    stack[waiting++] = {0, 0.0};
    while (waiting > 0) {
      const Waiting top = stack[--waiting];
      if (top.squared_distance > limit) continue;
      std::uint32_t id = top.id;
      while (nodes_[id].count == 0) {
        const Node& node = nodes_[id];
        const double beyond = query[node.axis] - node.split;
        const bool left_first = beyond < 0.0;
        stack[waiting++] = {left_first ? node.first : id + 1,
                            std::max(top.squared_distance, beyond * beyond)};
        id = left_first ? id + 1 : node.first;
      }
      const Node& leaf = nodes_[id];
      for (std::uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i) {
        const double squared = (points_.col(i) - query).squaredNorm();
        if (!(squared <= limit) || !counts(i)) continue;
        const auto index = static_cast<Eigen::Index>(index_[i]);
        if (best && squared == best->squared_distance && index > best->index) continue;
        best = Neighbor{index, squared};
        limit = squared;
      }
    }
    return best;
  }

  void build(const Points<D>& points, std::uint32_t begin, std::uint32_t end) {
    const auto id = static_cast<std::uint32_t>(nodes_.size());
    nodes_.push_back({0.0, begin, end - begin, 0});
    if (end - begin <= kLeafSize) return;
    Vector<D> lower = points.col(index_[begin]);
    Vector<D> upper = lower;
    for (std::uint32_t i = begin + 1; i < end; ++i) {
      lower = lower.cwiseMin(points.col(index_[i]));
      upper = upper.cwiseMax(points.col(index_[i]));
    }
    Eigen::Index axis = 0;
    (upper - lower).maxCoeff(&axis);
    const std::uint32_t middle = begin + (end - begin) / 2;
    std::nth_element(index_.begin() + begin, index_.begin() + middle, index_.begin() + end,
                     [&](std::uint32_t a, std::uint32_t b) { return points(axis, a) < points(axis, b); });
    const double split = points(axis, index_[middle]);
    build(points, begin, middle);
    nodes_[id] = {split, static_cast<std::uint32_t>(nodes_.size()), 0, axis};
    build(points, middle, end);
  }

  Points<D> points_;                  // In the order of the leaves.
  std::vector<std::uint32_t> index_;  // The column in which each point was given.
  std::vector<std::uint32_t> place_;  // Where the point of each column is.
  std::vector<Node> nodes_;
  Box<D> bounds_;
};

}  // namespace ndtree
