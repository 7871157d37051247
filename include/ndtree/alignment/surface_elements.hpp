// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Surfaces as points with a shape: where end points are, and how sure that is in each direction.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ndtree/alignment/match_options.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Points of surfaces: measured, or the centres of a lattice's cells.
template <int D>
struct SurfacePoints {
  Points<D> points;
  Points<D> sides;       ///< As many, or none: vectors to where each is seen from, or 0 for any side.
  double lattice = 0.0;  ///< Edge of the cells whose centres they are; 0 for points that were measured [m].
  Points<D> open{};      ///< As many, or none: 1 for axes along which what is not flat is told.
};

/// The shape of a surface around a point.
template <int D>
struct SurfaceShape {
  /// Projects onto the directions across: the normal's of a flat piece, of an edge or a post more.
  Eigen::Matrix<double, D, D> across = Eigen::Matrix<double, D, D>::Identity();
  Vector<D> normal = Vector<D>::Zero();  ///< Of a flat piece, to the side that it is seen from; else 0.
  double variance = 0.0;                 ///< Of the points around, along the normal [m²].
  double turn = 0.0;                     ///< Variance of the normal's angle [rad²].
  int axis = 0;                          ///< That the normal is nearest to; of a diagonal, the first.
  int direction = 0;       ///< Of the lattice, that the normal is nearest to: an axis, or a diagonal of two.
  std::int32_t piece = 0;  ///< Points of one piece share its error: see SurfaceElements.
  bool is_flat = false;
  bool has_side = false;
};

/// End points, averaged in cells, each with the shape of the points around it.
///
/// A piece is what errs alike. In a lattice of cells a surface may be anywhere in its row of cells, so the
/// flat pieces of a row, along an axis or a diagonal as their normal says, are one piece. What is not flat is
/// a piece by itself, in space with what is near, and is told along some axes alone, in the plane only if it
/// is single, so that it may be a part of a wall. O(points · points within
/// the radius).
template <int D>
class SurfaceElements {
 public:
  using Matrix = Eigen::Matrix<double, D, D>;

  /// @param options cell_size, radius and noise count.
  SurfaceElements(const SurfacePoints<D>& all, const MatchOptions& options) {
    average(all, options.cell_size);
    shapes.resize(static_cast<std::size_t>(points.cols()));
    // Anywhere in a cell; and in which row it is decided by chance, where noise reaches into more.
    constexpr double kOfNoise = 1.0 / 9.0;
    const double noise = options.noise * options.noise;
    const double in_cell = all.lattice * all.lattice / 12.0;
    if (all.lattice > 0.0) shared = in_cell + kOfNoise * noise;
    const double least = all.lattice > 0.0 ? 0.25 * in_cell : noise;
    const auto is_sparse = [](int count, bool) { return count < kFewest; };
    shape(options.radius, least, [](int, bool) { return true; });
    // Beside corners, a shorter piece is flat.
    if (all.lattice > 0.0)
      shape(kShorter * options.radius, least,
            [&](int count, bool is_flat) { return !is_flat && !is_sparse(count, is_flat); });
    shape(kWider * options.radius, least, is_sparse);
    group(all.lattice, options.radius);
  }

  static constexpr int kDirections = D + D * (D - 1);

  Points<D> points;
  Points<D> sides;  ///< Unit vectors, or 0.
  Points<D> open;   ///< 1 for axes along which what is not flat is told, else 0.
  std::vector<SurfaceShape<D>> shapes;
  std::int32_t num_pieces = 0;
  double shared = 0.0;  ///< Variance of a flat piece's place, which end points on it share [m²].

 private:
  static constexpr int kFewest = 6;           // Points that tell a shape well.
  static constexpr double kShorter = 0.4;     // Radius beside corners,
  static constexpr double kWider = 3.0;       // Radius, where there are fewer.
  static constexpr double kOtherSide = -0.1;  // Cosine: points that are seen from another side are others'.

  using Key = std::array<std::int64_t, std::size_t{D}>;
  struct Keyed {
    Key key;
    Eigen::Index point;
    friend bool operator<(const Keyed& a, const Keyed& b) {
      return a.key != b.key ? a.key < b.key : a.point < b.point;
    }
  };

  [[nodiscard]] static std::vector<Keyed> sorted(const Points<D>& of, double size) {
    std::vector<Keyed> keyed(static_cast<std::size_t>(of.cols()));
    for (Eigen::Index i = 0; i < of.cols(); ++i) {
      Keyed& one = keyed[static_cast<std::size_t>(i)];
      one.point = i;
      for (int a = 0; a < D; ++a)
        one.key[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(std::floor(of(a, i) / size));
    }
    std::sort(keyed.begin(), keyed.end());
    return keyed;
  }

  void average(const SurfacePoints<D>& all, double cell_size) {
    const std::vector<Keyed> keyed = sorted(all.points, cell_size);
    points.resize(D, all.points.cols());
    sides = Points<D>::Zero(D, all.points.cols());
    open = Points<D>::Constant(D, all.points.cols(), all.open.cols() > 0 ? 0.0 : 1.0);
    Eigen::Index count = 0;
    for (std::size_t i = 0; i < keyed.size(); ++count) {
      Vector<D> sum = Vector<D>::Zero();
      std::size_t j = i;
      for (; j < keyed.size() && keyed[j].key == keyed[i].key; ++j) {
        sum += all.points.col(keyed[j].point);
        if (all.sides.cols() > 0) sides.col(count) += all.sides.col(keyed[j].point);
        if (all.open.cols() > 0) open.col(count) = open.col(count).cwiseMax(all.open.col(keyed[j].point));
      }
      points.col(count) = sum / static_cast<double>(j - i);
      const double length = sides.col(count).norm();
      if (length > 0.0) sides.col(count) /= length;
      i = j;
    }
    points.conservativeResize(D, count);
    sides.conservativeResize(D, count);
    open.conservativeResize(D, count);
  }

  /// Shapes of the points around points. @param least variance. @param wants whether a point's is looked for,
  /// by how many points were around it before, and whether these were flat.
  template <class Wants>
  void shape(double radius, double least, const Wants& wants) {
    const std::vector<Keyed> keyed = sorted(points, radius);
    const auto row_of = [&](Key key, std::int64_t last_axis_step) {
      key[D - 1] += last_axis_step;
      return std::lower_bound(keyed.begin(), keyed.end(), Keyed{key, -1});
    };
    counts_.resize(shapes.size());
    Pace pace;
    for (const Keyed& one : keyed) {
      pace.spend();
      int& count = counts_[static_cast<std::size_t>(one.point)];
      if (!wants(count, shapes[static_cast<std::size_t>(one.point)].is_flat)) continue;
      const Vector<D> centre = points.col(one.point);
      const Vector<D> side = sides.col(one.point);
      Vector<D> sum = Vector<D>::Zero();
      Matrix squares = Matrix::Zero();
      count = 0;
      // Rows of three cells around, which lie side by side in the order of the keys.
      constexpr int kRows = D == 2 ? 3 : 9;
      for (int row = 0; row < kRows; ++row) {
        Key key = one.key;
        int rest = row;
        for (std::size_t a = 0; a + 1 < std::size_t{D}; ++a) {
          key[a] += rest % 3 - 1;
          rest /= 3;
        }
        for (auto at = row_of(key, -1), end = row_of(key, 2); at != end; ++at) {
          pace.spend();
          const Vector<D> away = points.col(at->point) - centre;
          if (away.squaredNorm() > radius * radius) continue;
          if (side.dot(sides.col(at->point)) < kOtherSide) continue;
          sum += away;
          squares += away * away.transpose();
          ++count;
        }
      }
      SurfaceShape<D>& found = shapes[static_cast<std::size_t>(one.point)];
      found = shape_of(sum, squares, count, side, least);
      // In the plane, what is not flat is a corner or a thing, if its shape is known.
      if (!found.is_flat && (D == 3 || count <= D))
        found.across = open.col(one.point).asDiagonal() * found.across;
    }
  }

  [[nodiscard]] static SurfaceShape<D> shape_of(const Vector<D>& sum, const Matrix& squares, int count,
                                                const Vector<D>& side, double least) {
    constexpr double kFlat = 0.1;  // Of the thickness, as variances.
    SurfaceShape<D> shape;
    if (count < D + 1) return shape;
    const Matrix covariance = squares / count - sum * sum.transpose() / (static_cast<double>(count) * count);
    Eigen::SelfAdjointEigenSolver<Matrix> solver;
    solver.computeDirect(covariance);
    const Vector<D> values = solver.eigenvalues().cwiseMax(least);
    // Along a flat piece, a point may be anywhere: where the piece ends, another one begins.
    for (int a = 1; a < D; ++a)
      if (values[0] < kFlat * values[a])
        shape.across -= solver.eigenvectors().col(a) * solver.eigenvectors().col(a).transpose();
    shape.is_flat = values[0] < kFlat * values[1];
    if (!shape.is_flat) return shape;
    shape.normal = solver.eigenvectors().col(0);
    shape.normal.cwiseAbs().maxCoeff(&shape.axis);
    const double cosine = shape.normal.dot(side);
    shape.has_side = cosine != 0.0;
    if (cosine < 0.0) shape.normal = -shape.normal;
    shape.variance = values[0];
    const double gap = values[1] - values[0];
    shape.turn = values[0] * values[1] / (gap * gap * count);
    return shape;
  }

  /// Gives pieces their numbers. @param row of cells [m]; 0: flat pieces share nothing and all have 0, and
  /// what is not flat is apart, as in the plane. @param radius of what is not flat and errs alike [m].
  void group(double row, double radius) {
    num_pieces = 0;
    Key last{};
    for (const Keyed& one : sorted(points, radius)) {
      SurfaceShape<D>& loose = shapes[static_cast<std::size_t>(one.point)];
      if (loose.is_flat) continue;
      if (D == 2 || row == 0.0 || num_pieces == 0 || one.key != last) ++num_pieces;
      loose.piece = num_pieces;
      last = one.key;
    }
    ++num_pieces;
    std::vector<std::pair<std::pair<int, std::int64_t>, std::size_t>> rows;
    for (std::size_t i = 0; row > 0.0 && i < shapes.size(); ++i) {
      if (!shapes[i].is_flat) continue;
      rows.push_back({{0, row_of(points.col(static_cast<Eigen::Index>(i)), row, shapes[i])}, i});
      rows.back().first.first = shapes[i].direction;
    }
    std::sort(rows.begin(), rows.end());
    for (std::size_t i = 0; i < rows.size(); ++i) {
      if (i > 0 && rows[i].first != rows[i - 1].first) ++num_pieces;
      shapes[rows[i].second].piece = num_pieces;
    }
    ++num_pieces;
  }

  /// The number of a point's row across the direction of the lattice that is nearest to its normal, which is
  /// set.
  [[nodiscard]] static std::int64_t row_of(const Vector<D>& point, double row, SurfaceShape<D>& shape) {
    constexpr double kBetween = 0.41421356;  // Tangent of half the way from an axis to a diagonal.
    const int first = shape.axis;
    int second = first == 0 ? 1 : 0;
    for (int a = 0; a < D; ++a)
      if (a != first && std::abs(shape.normal[a]) > std::abs(shape.normal[second])) second = a;
    shape.direction = first;
    if (std::abs(shape.normal[second]) < kBetween * std::abs(shape.normal[first]))
      return static_cast<std::int64_t>(std::floor(point[first] / row));
    const bool is_same = (shape.normal[first] > 0.0) == (shape.normal[second] > 0.0);
    shape.axis = std::min(first, second);
    const int last = std::max(first, second);
    shape.direction = D + 2 * (shape.axis + last - 1) + (is_same ? 1 : 0);
    const double sum = point[shape.axis] + (is_same ? point[last] : -point[last]);
    return static_cast<std::int64_t>(std::floor(sum / row + 0.5));
  }

  std::vector<int> counts_;  // Points around, by which a shape was told.
};

}  // namespace ndtree
