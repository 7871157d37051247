// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Points, rotations and poses for tests.
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "ndtree/core/body.hpp"
#include "random.hpp"

namespace ndtree::test {

/// Within `reach` of 0 on each axis; with a `unit`, one coordinate in five is a multiple of it [m].
template <int D>
Vector<D> random_vector(Random& random, double reach, double unit = 0.0) {
  Vector<D> point;
  for (double& x : point) {
    x = random.uniform(-reach, reach);
    if (unit > 0.0 && random.chance(0.2)) x = std::round(x / unit) * unit;
  }
  return point;
}

/// One after the other in each plane of two axes, by any angle.
template <int D>
Eigen::Matrix<double, D, D> random_rotation(Random& random) {
  Eigen::Matrix<double, D, D> rotation = Eigen::Matrix<double, D, D>::Identity();
  for (int a = 0; a < D; ++a) {
    for (int b = a + 1; b < D; ++b) {
      const double angle = random.uniform(-3.14159265358979, 3.14159265358979);
      for (int column = 0; column < D; ++column) {
        const double x = rotation(a, column);
        const double y = rotation(b, column);
        rotation(a, column) = std::cos(angle) * x - std::sin(angle) * y;
        rotation(b, column) = std::sin(angle) * x + std::cos(angle) * y;
      }
    }
  }
  return rotation;
}

/// Any rotation, and a place within `reach` of the origin on each axis [m].
template <int D>
Pose<D> random_pose(Random& random, double reach) {
  Pose<D> pose;
  pose.rotation = random_rotation<D>(random);
  pose.translation = random_vector<D>(random, reach);
  return pose;
}

}  // namespace ndtree::test
