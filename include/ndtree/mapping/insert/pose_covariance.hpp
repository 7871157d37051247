// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How sure the beams of a scan are whose pose is not: a standard deviation for each.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Covariance of a sensor's pose, along and about the fixed axes of the scan's frame [m², m rad, rad²]: x, y,
/// yaw in 2-D; x, y, z and small rotations about x, y, z in 3-D, as in ROS' PoseWithCovariance.
template <int D>
using PoseCovariance = Eigen::Matrix<double, D == 2 ? 3 : 6, D == 2 ? 3 : 6>;

/// What the variance across a beam counts beside the one along it. A surface that a beam meets at an angle a
/// from its normal is found too near or too far by tan(a) times the error across; a quarter is tan² of 27
/// degrees. Chosen on simulated worlds: with 0, walls met at an angle stay thick; with 1, they are smeared.
inline constexpr double kAcrossWeight = 0.25;

/// Rounding that is forgiven, of the largest entry.
inline constexpr double kCovarianceRounding = 1e-6;

/// @throws std::invalid_argument unless it is finite, symmetric, and without a negative eigenvalue.
template <int D>
void validate(const PoseCovariance<D>& covariance) {
  constexpr Eigen::Index kSize = PoseCovariance<D>::RowsAtCompileTime;
  const auto entry = [&](Eigen::Index i, Eigen::Index j) {
    return "[" + std::to_string(i) + ", " + std::to_string(j) + "] = " + describe_number(covariance(i, j));
  };
  for (Eigen::Index i = 0; i < kSize; ++i)
    for (Eigen::Index j = 0; j < kSize; ++j)
      if (!std::isfinite(covariance(i, j)))
        throw std::invalid_argument("pose_covariance" + entry(i, j) + ": must be finite");
  const double rounding = kCovarianceRounding * covariance.cwiseAbs().maxCoeff();
  for (Eigen::Index i = 0; i < kSize; ++i)
    for (Eigen::Index j = 0; j < i; ++j)
      if (!(std::abs(covariance(i, j) - covariance(j, i)) <= rounding))
        throw std::invalid_argument("pose_covariance" + entry(i, j) + " and " + entry(j, i) +
                                    ": must be symmetric");
  const Eigen::SelfAdjointEigenSolver<SmallMatrix<6>> solver(SmallMatrix<6>(covariance),
                                                             Eigen::EigenvaluesOnly);
  const double least = solver.eigenvalues().minCoeff();
  if (!(least >= -rounding))
    throw std::invalid_argument("pose_covariance has the eigenvalue " + describe_number(least) +
                                ": all must be >= 0");
}

/// The same covariance along and about the axes of a frame that is turned. @param rotation of that frame.
template <int D>
[[nodiscard]] PoseCovariance<D> in_frame(const PoseCovariance<D>& covariance,
                                         const Eigen::Matrix<double, D, D>& rotation) {
  PoseCovariance<D> turn = PoseCovariance<D>::Identity();
  turn.template topLeftCorner<D, D>() = rotation.transpose();
  if constexpr (D == 3) turn.template bottomRightCorner<D, D>() = rotation.transpose();
  return turn * covariance * turn.transpose();
}

/// Variances of a beam's end point [m²], to the first order.
struct EndVariance {
  double along;   ///< The beam.
  double across;  ///< It: in 3-D the mean of two directions.
};

/// Of an end point under the errors of its sensor's pose.
///
/// With an error t of the place and w of the rotation, the end point is off by t + w × v, where v is where it
/// is seen from the pose. Along the beam, whose direction is u, that is u·t + (v × u)·w, with the variance
/// qᵀ C q of q = (u, v × u). The variances of all axes together are, of the covariance's blocks T, R and X
/// between them, tr T + 2 v·g + |v|² tr R - vᵀ R v, where g is the expectation of t × w. So S = J C Jᵀ is
/// never made. Across, the mean and not the largest counts: how the surface lies is not known, and of all
/// ways the mean is the expectation. O(1).
template <int D>
[[nodiscard]] EndVariance end_variance(const PoseCovariance<D>& c, const Vector<D>& seen,
                                       const Vector<D>& way) {
  static_assert(D == 2 || D == 3, "poses are of the plane or of space");
  constexpr int kSize = PoseCovariance<D>::RowsAtCompileTime;
  double squared_length = 0.0;
  for (int a = 0; a < D; ++a) squared_length += unfused(way[a] * way[a]);
  const double length = std::sqrt(squared_length);
  Eigen::Matrix<double, kSize, 1> q;
  for (int a = 0; a < D; ++a) q[a] = way[a] / length;
  double all = 0.0;
  for (int a = 0; a < D; ++a) all += c(a, a);
  if constexpr (D == 2) {
    q[2] = unfused(seen[0] * q[1]) - unfused(seen[1] * q[0]);
    all += unfused(2.0 * (unfused(seen[0] * c(1, 2)) - unfused(seen[1] * c(0, 2))));
    all += unfused((unfused(seen[0] * seen[0]) + unfused(seen[1] * seen[1])) * c(2, 2));
  } else {
    for (int a = 0; a < D; ++a) {
      const int b = (a + 1) % D;
      const int d = (a + 2) % D;
      q[D + a] = unfused(seen[b] * q[d]) - unfused(seen[d] * q[b]);
      all += unfused(2.0 * seen[a] * (c(b, D + d) - c(d, D + b)));
      all += unfused(seen[a] * seen[a] * (c(D + b, D + b) + c(D + d, D + d)));
      all -= unfused(2.0 * seen[b] * seen[d] * c(D + b, D + d));
    }
  }
  double along = 0.0;
  for (int i = 0; i < kSize; ++i) {
    double row = 0.0;
    for (int j = 0; j < kSize; ++j) row += unfused(c(i, j) * q[j]);
    along += unfused(q[i] * row);
  }
  along = std::max(along, 0.0);
  return {along, std::max(all - along, 0.0) / (D - 1)};
}

/// Standard deviations of a scan's ranges [m], with what its pose's covariance adds to the sensor's noise (or
/// to the scan's own range_sigma): sqrt(sigma² + along² + kAcrossWeight · across²). Invalid beams keep the
/// sensor's, and values of range_sigma that no map takes stay as they are, so that insertion names them.
/// @param covariance valid. @param place of the pose in the scan's frame; none: rotations are about the
/// origin of each beam. O(beams).
template <class Sensor, int D>
[[nodiscard]] Eigen::ArrayXd range_sigma(const ScanView<D>& scan, const PoseCovariance<D>& covariance,
                                         const Sensor& sensor, const Vector<D>* place = nullptr) {
  Eigen::ArrayXd result(scan.size);
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Vector<D> origin = scan.origin(i);
    const Vector<D> way = scan.endpoint(i) - origin;
    double squared = 0.0;
    for (int a = 0; a < D; ++a) squared += unfused(way[a] * way[a]);
    const double range = std::sqrt(squared);
    const bool is_valid = std::isfinite(range) && range > 0.0;
    const double own =
        scan.range_sigma != nullptr ? scan.range_sigma[i] : sensor.sigma(is_valid ? range : 0.0);
    result[i] = own;
    if (!is_valid || !kRangeSigmaBounds.contain(own)) continue;
    const Vector<D> seen = place == nullptr ? way : Vector<D>(scan.endpoint(i) - *place);
    const EndVariance end = end_variance<D>(covariance, seen, way);
    result[i] = std::sqrt(unfused(own * own) + end.along + unfused(kAcrossWeight * end.across));
  }
  return result;
}

}  // namespace ndtree
