// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Small motions of poses, as numbers.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Degrees of freedom of a rigid motion.
template <int D>
inline constexpr int kFreedoms = D == 2 ? 3 : 6;

/// A translation along the map's axes [m], then yaw in the plane, or roll, pitch and yaw about the map's axes
/// in space [rad]; a pose turns about its own place.
template <int D>
using Motion = Eigen::Matrix<double, kFreedoms<D>, 1>;
/// A covariance of a Motion, or its inverse.
template <int D>
using MotionMatrix = Eigen::Matrix<double, kFreedoms<D>, kFreedoms<D>>;

template <int D>
[[nodiscard]] Pose<D> moved(const Pose<D>& pose, const Motion<D>& motion) {
  static_assert(D == 2 || D == 3, "in the plane or in space");
  Pose<D> result;
  result.translation = pose.translation + motion.template head<D>();
  if constexpr (D == 2) {
    result.rotation = Eigen::Rotation2Dd(motion[2]).toRotationMatrix() * pose.rotation;
  } else {
    result.rotation = (Eigen::AngleAxisd(motion[5], Eigen::Vector3d::UnitZ()) *
                       Eigen::AngleAxisd(motion[4], Eigen::Vector3d::UnitY()) *
                       Eigen::AngleAxisd(motion[3], Eigen::Vector3d::UnitX()))
                          .toRotationMatrix() *
                      pose.rotation;
  }
  return result;
}

/// The motion that takes one pose to another; in space the rotation is the one about one axis, which is the
/// same to first order.
template <int D>
[[nodiscard]] Motion<D> motion_between(const Pose<D>& from, const Pose<D>& to) {
  Motion<D> motion;
  motion.template head<D>() = to.translation - from.translation;
  const Eigen::Matrix<double, D, D> turn = to.rotation * from.rotation.transpose();
  if constexpr (D == 2) {
    motion[2] = std::atan2(turn(1, 0), turn(0, 0));
  } else {
    const Eigen::AngleAxisd axis(turn);
    motion.template tail<3>() = axis.angle() * axis.axis();
  }
  return motion;
}

}  // namespace ndtree
