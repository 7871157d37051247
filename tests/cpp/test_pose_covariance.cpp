// SPDX-License-Identifier: BSD-3-Clause
// Standard deviations of beams from a pose's covariance, against ends under random poses, and J C Jᵀ.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>

#include "ndtree/mapping/insert/pose_covariance.hpp"
#include "ndtree/ndtree.hpp"

namespace ndtree {
namespace pose_covariance {

template <int D>
constexpr int kSize = D == 2 ? 3 : 6;
template <int D>
using Numbers = Eigen::Matrix<double, kSize<D>, 1>;

template <class Random>
double uniform(Random& random, double from, double to) {
  return std::uniform_real_distribution<double>(from, to)(random);
}

/// Positive definite, with all correlations.
template <int D>
PoseCovariance<D> random_covariance(std::mt19937_64& random, double place, double turn) {
  PoseCovariance<D> root;
  for (int i = 0; i < kSize<D>; ++i)
    for (int j = 0; j < kSize<D>; ++j) root(i, j) = (i < D ? place : turn) * uniform(random, -1.0, 1.0);
  return root * root.transpose();
}

template <int D>
Vector<D> random_point(std::mt19937_64& random, double most) {
  Vector<D> point;
  for (int a = 0; a < D; ++a) point[a] = uniform(random, -most, most);
  return point;
}

/// The point after an error of the pose, exactly: no first order.
template <int D>
Vector<D> displaced(const Vector<D>& point, const Vector<D>& place, const Numbers<D>& error) {
  const Vector<D> seen = point - place;
  if constexpr (D == 2) {
    return place + error.template head<2>() + Eigen::Rotation2Dd(error[2]).toRotationMatrix() * seen;
  } else {
    const Eigen::Vector3d turn = error.template tail<3>();
    const double angle = turn.norm();
    const Eigen::Vector3d axis = angle > 0.0 ? Eigen::Vector3d(turn / angle) : Eigen::Vector3d::UnitX();
    return place + error.template head<3>() + Eigen::AngleAxisd(angle, axis).toRotationMatrix() * seen;
  }
}

/// d end / d pose by its definition: columns of axes and cross products.
template <int D>
Eigen::Matrix<double, D, kSize<D>> jacobian(const Vector<D>& seen) {
  Eigen::Matrix<double, D, kSize<D>> j = Eigen::Matrix<double, D, kSize<D>>::Zero();
  j.template leftCols<D>().setIdentity();
  if constexpr (D == 2) {
    j.col(2) = Vector<2>(-seen[1], seen[0]);
  } else {
    for (int a = 0; a < 3; ++a) j.col(3 + a) = Eigen::Vector3d::Unit(a).cross(seen);
  }
  return j;
}

template <int D>
void agrees_with_the_jacobian() {
  std::mt19937_64 random(1);
  for (int cases = 0; cases < 2000; ++cases) {
    const PoseCovariance<D> covariance = random_covariance<D>(random, 0.1, 0.05);
    const Vector<D> way = random_point<D>(random, 20.0);
    const Vector<D> seen = cases % 2 == 0 ? way : Vector<D>(way + random_point<D>(random, 2.0));
    const auto j = jacobian<D>(seen);
    const Eigen::Matrix<double, D, D> s = j * covariance * j.transpose();
    const Vector<D> u = way.normalized();
    const EndVariance end = end_variance<D>(covariance, seen, way);
    ASSERT_NEAR(end.along, u.dot(s * u), 1e-12 * s.trace()) << cases;
    ASSERT_NEAR(end.across, (s.trace() - u.dot(s * u)) / (D - 1), 1e-12 * s.trace()) << cases;
  }
}
TEST(PoseCovariance, IsJTimesCovarianceTimesJTransposed) {
  agrees_with_the_jacobian<2>();
  agrees_with_the_jacobian<3>();
}

template <int D>
void agrees_with_random_poses() {
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  constexpr int kDraws = 40000;
  for (int cases = 0; cases < 6; ++cases) {
    const PoseCovariance<D> covariance = random_covariance<D>(random, 0.05, 0.01);
    const PoseCovariance<D> root = covariance.llt().matrixL();
    const Vector<D> place = random_point<D>(random, 3.0);
    const Vector<D> origin = place + random_point<D>(random, 0.5);
    const Vector<D> point = origin + random_point<D>(random, 10.0);
    const Vector<D> u = (point - origin).normalized();
    double along = 0.0;
    double across = 0.0;
    for (int i = 0; i < kDraws; ++i) {
      Numbers<D> error;
      for (int a = 0; a < kSize<D>; ++a) error[a] = normal(random);
      const Vector<D> off = displaced<D>(point, place, root * error) - point;
      along += off.dot(u) * off.dot(u) / kDraws;
      across += (off - off.dot(u) * u).squaredNorm() / (D - 1) / kDraws;
    }
    const EndVariance end = end_variance<D>(covariance, point - place, point - origin);
    EXPECT_NEAR(end.along / along, 1.0, 0.04) << cases;
    EXPECT_NEAR(end.across / across, 1.0, 0.04) << cases;

    Scan<D> scan;
    scan.endpoints = point;
    scan.origins = origin;
    const BeamSensorModel sensor{SensorOptions{}};
    const double range = (point - origin).norm();
    const double own = sensor.sigma(range);
    EXPECT_NEAR(range_sigma(scan.view(), covariance, sensor, &place)[0] /
                    std::sqrt(own * own + along + kAcrossWeight * across),
                1.0, 0.02);
  }
}
TEST(PoseCovariance, IsThatOfEndsUnderRandomPoses) {
  agrees_with_random_poses<2>();
  agrees_with_random_poses<3>();
}

template <int D>
void does_not_depend_on_the_frame() {
  std::mt19937_64 random(3);
  for (int i = 0; i < 100; ++i) {
    const PoseCovariance<D> covariance = random_covariance<D>(random, 0.1, 0.05);
    Eigen::Matrix<double, D, D> rotation;
    if constexpr (D == 2) {
      rotation = Eigen::Rotation2Dd(uniform(random, -3.0, 3.0)).toRotationMatrix();
    } else {
      rotation = Eigen::Quaterniond::UnitRandom().toRotationMatrix();
    }
    const Vector<D> seen = random_point<D>(random, 10.0);
    const Vector<D> way = random_point<D>(random, 10.0);
    const EndVariance here = end_variance<D>(covariance, seen, way);
    const EndVariance there = end_variance<D>(in_frame<D>(covariance, rotation), rotation.transpose() * seen,
                                              rotation.transpose() * way);
    ASSERT_NEAR(here.along, there.along, 1e-10);
    ASSERT_NEAR(here.across, there.across, 1e-10);
  }
}
TEST(PoseCovariance, TurnsWithItsFrame) {
  does_not_depend_on_the_frame<2>();
  does_not_depend_on_the_frame<3>();
}

TEST(PoseCovariance, AddsToTheNoiseThatABeamHas) {
  Scan<2> scan;
  scan.endpoints.resize(2, 4);
  scan.endpoints << 3.0, 0.0, std::numeric_limits<double>::quiet_NaN(), 1.0, 0.0, 4.0, 0.0, 1.0;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.range_sigma.resize(4);
  scan.range_sigma << 0.3, 0.05, 0.2, -1.0;
  PoseCovariance<2> covariance = PoseCovariance<2>::Zero();
  covariance(0, 0) = 0.16;
  const BeamSensorModel sensor{SensorOptions{}};
  const Eigen::ArrayXd sigma = range_sigma(scan.view(), covariance, sensor);
  EXPECT_NEAR(sigma[0], 0.5, 1e-12);                              // Along.
  EXPECT_NEAR(sigma[1], std::sqrt(0.0025 + 0.25 * 0.16), 1e-12);  // Across, at its weight.
  EXPECT_EQ(sigma[2], 0.2);                                       // An invalid beam.
  EXPECT_EQ(sigma[3], -1.0);                                      // What insertion refuses.
  scan.range_sigma.resize(0);
  EXPECT_NEAR(range_sigma(scan.view(), covariance, sensor)[0], std::sqrt(0.03 * 0.03 + 0.16), 1e-12);
}

std::string error_of(const PoseCovariance<3>& covariance) {
  try {
    validate<3>(covariance);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}
TEST(PoseCovariance, RefusesWhatIsNone) {
  PoseCovariance<3> covariance = PoseCovariance<3>::Identity();
  EXPECT_EQ(error_of(covariance), "");
  EXPECT_EQ(error_of(PoseCovariance<3>::Zero()), "");
  std::mt19937_64 random(7);
  for (int i = 0; i < 20; ++i) EXPECT_EQ(error_of(random_covariance<3>(random, 0.1, 0.05)), "");
  covariance(1, 2) = 0.5;
  EXPECT_EQ(error_of(covariance), "pose_covariance[2, 1] = 0.0 and [1, 2] = 0.5: must be symmetric");
  covariance(1, 2) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(error_of(covariance), "pose_covariance[1, 2] = nan: must be finite");
  covariance = PoseCovariance<3>::Identity();
  covariance(4, 4) = -0.25;
  EXPECT_EQ(error_of(covariance), "pose_covariance has the eigenvalue -0.25: all must be >= 0");
}

/// A wall is thicker where the poses that saw it were less sure.
TEST(PoseCovariance, MakesAMapLessSure) {
  Scan<2> scan;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, 400);
  for (int i = 0; i < 400; ++i) scan.endpoints.col(i) = Vector<2>(4.0, -2.0 + 0.01 * i);
  PoseCovariance<2> covariance = PoseCovariance<2>::Zero();
  covariance(0, 0) = 0.2 * 0.2;
  const MapOptions options;
  AdaptiveMap<2, 2> sure(options);
  AdaptiveMap<2, 2> unsure(options);
  sure.insert(scan);
  scan.range_sigma = range_sigma(scan.view(), covariance, BeamSensorModel(options));
  unsure.insert(scan);
  const Vector<2> behind(4.3, 0.0);
  EXPECT_EQ(probability(sure, behind), 0.5);
  EXPECT_GT(probability(unsure, behind), 0.5);
  EXPECT_LT(unsure.stats().observed_leaves, sure.stats().observed_leaves);
}

}  // namespace pose_covariance
}  // namespace ndtree
