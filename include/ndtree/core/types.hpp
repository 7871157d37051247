// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Points, boxes and lattice coordinates in D dimensions.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

namespace ndtree {

/// A point or direction in the map frame [m].
template <int D>
using Vector = Eigen::Matrix<double, D, 1>;

/// Bulk points: one column each, so that memory equals a C-contiguous (n, D) array.
template <int D>
using Points = Eigen::Matrix<double, D, Eigen::Dynamic>;

/// A matrix of at most Size rows and columns, to be decomposed. Its size is not the compiler's to know: where
/// it is, Eigen unrolls every step, which takes half of the time and memory of compiling a matcher.
template <int Size>
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, Size, Size>;

/// Integer coordinates on the lattice whose unit is the smallest cell of a tree.
template <int D>
using Lattice = std::array<std::int64_t, std::size_t{D}>;

/// A corner of a box as near as this to a border of cells, in cells, is meant to lie on it.
inline constexpr double kOnBorder = 1e-6;

/// Axis-aligned, half-open box [lower, upper).
template <int D>
struct Box {
  Vector<D> lower;
  Vector<D> upper;

  [[nodiscard]] bool contains(const Vector<D>& p) const {
    return (p.array() >= lower.array()).all() && (p.array() < upper.array()).all();
  }
  /// Closed boxes share at least one point.
  [[nodiscard]] bool touches(const Box& other) const {
    return (lower.array() <= other.upper.array()).all() && (other.lower.array() <= upper.array()).all();
  }
  /// The boxes share a volume, and not only a border.
  [[nodiscard]] bool overlaps(const Box& other) const {
    return (lower.array() < other.upper.array()).all() && (other.lower.array() < upper.array()).all();
  }
  /// All of the other closed box lies in this one.
  [[nodiscard]] bool encloses(const Box& other) const {
    return (other.lower.array() >= lower.array()).all() && (other.upper.array() <= upper.array()).all();
  }
  /// The same, larger by so much on each side [m].
  [[nodiscard]] Box inflated(double by) const { return {lower.array() - by, upper.array() + by}; }
  /// Squared distance between the closed boxes [m²]; 0 if they share a point.
  [[nodiscard]] double squared_distance(const Box& other) const {
    return (other.lower - upper).cwiseMax(lower - other.upper).cwiseMax(0.0).squaredNorm();
  }
  /// Squared distance from p to the closed box [m²]; 0 inside.
  [[nodiscard]] double squared_distance(const Vector<D>& p) const {
    return (p.array().max(lower.array()).min(upper.array()) - p.array()).square().sum();
  }
};

}  // namespace ndtree
