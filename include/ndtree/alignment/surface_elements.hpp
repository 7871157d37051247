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
#include <vector>

#include "ndtree/core/types.hpp"

namespace ndtree {

/// End points, averaged in cells, each with the inverse of the covariance of the points around it: small
/// along a wall, large across it, so that distances in this metric are distances from the wall.
template <int D>
struct SurfaceElements {
  using Matrix = Eigen::Matrix<double, D, D>;

  Points<D> points;
  std::vector<Matrix> information;  ///< [1/m²].

  /// @param cell_size each point is the mean of a cell of this size [m]. @param radius of points that shape
  /// an element [m].
  /// @param sigma least standard deviation across a surface [m].
  SurfaceElements(const Points<D>& all, double cell_size, double radius, double sigma) {
    average(all, cell_size);
    shape(radius, sigma);
  }

 private:
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

  void average(const Points<D>& all, double cell_size) {
    const std::vector<Keyed> keyed = sorted(all, cell_size);
    points.resize(D, all.cols());
    Eigen::Index count = 0;
    for (std::size_t i = 0; i < keyed.size();) {
      Vector<D> sum = Vector<D>::Zero();
      std::size_t j = i;
      for (; j < keyed.size() && keyed[j].key == keyed[i].key; ++j) sum += all.col(keyed[j].point);
      points.col(count++) = sum / static_cast<double>(j - i);
      i = j;
    }
    points.conservativeResize(D, count);
  }

  void shape(double radius, double sigma) {
    const std::vector<Keyed> keyed = sorted(points, radius);
    information.assign(static_cast<std::size_t>(points.cols()), Matrix::Zero());
    const auto row_of = [&](Key key, std::int64_t last_axis_step) {
      key[D - 1] += last_axis_step;
      return std::lower_bound(keyed.begin(), keyed.end(), Keyed{key, -1});
    };
    for (std::size_t i = 0; i < keyed.size(); ++i) {
      const Vector<D> centre = points.col(keyed[i].point);
      Vector<D> sum = Vector<D>::Zero();
      Matrix squares = Matrix::Zero();
      int count = 0;
      // Rows of three cells around, which lie side by side in the order of the keys.
      constexpr int kRows = D == 2 ? 3 : 9;
      for (int row = 0; row < kRows; ++row) {
        Key key = keyed[i].key;
        int rest = row;
        for (std::size_t a = 0; a + 1 < std::size_t{D}; ++a) {
          key[a] += rest % 3 - 1;
          rest /= 3;
        }
        for (auto at = row_of(key, -1), end = row_of(key, 2); at != end; ++at) {
          const Vector<D> away = points.col(at->point) - centre;
          if (away.squaredNorm() > radius * radius) continue;
          sum += away;
          squares += away * away.transpose();
          ++count;
        }
      }
      information[static_cast<std::size_t>(keyed[i].point)] =
          information_of(sum, squares, count, radius, sigma);
    }
  }

  [[nodiscard]] static Matrix information_of(const Vector<D>& sum, const Matrix& squares, int count,
                                             double radius, double sigma) {
    const double loose = 0.25 * radius * radius;
    if (count < D + 1) return Matrix::Identity() / loose;
    const Matrix covariance = squares / count - sum * sum.transpose() / (static_cast<double>(count) * count);
    Eigen::SelfAdjointEigenSolver<Matrix> solver;
    solver.computeDirect(covariance);
    // Along a flat piece, a point may be anywhere: where the piece ends, another one begins.
    constexpr double kFlat = 0.1;   // Of the thickness, as variances.
    constexpr double kAlong = 1.0;  // [m²]
    Vector<D> values = solver.eigenvalues().cwiseMax(sigma * sigma);
    for (int a = 1; a < D; ++a)
      if (values[0] < kFlat * values[a]) values[a] = kAlong;
    values = values.cwiseInverse();
    return solver.eigenvectors() * values.asDiagonal() * solver.eigenvectors().transpose();
  }
};

}  // namespace ndtree
