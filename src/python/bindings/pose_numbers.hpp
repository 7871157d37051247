// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Poses as the numbers in which they cross the interface: the rotation row by row, then the translation.
#pragma once

#include <Eigen/Core>

#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree::python {

/// @param numbers D * D + D.
template <int D>
[[nodiscard]] Pose<D> pose_of(const double* numbers) {
  Pose<D> pose;
  for (int row = 0; row < D; ++row)
    for (int column = 0; column < D; ++column) pose.rotation(row, column) = numbers[row * D + column];
  pose.translation = Eigen::Map<const Vector<D>>(numbers + D * D);
  return pose;
}

}  // namespace ndtree::python
