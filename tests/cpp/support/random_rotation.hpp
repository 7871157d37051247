// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Rotations and poses for tests.
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "ndtree/core/body.hpp"
#include "random.hpp"

namespace ndtree::test {

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
  for (double& x : pose.translation) x = random.uniform(-reach, reach);
  return pose;
}

}  // namespace ndtree::test
