// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Poses in the plane that fit measurements between them best.
#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/core/cancel.hpp"

namespace ndtree {

/// x, y [m] and yaw [rad].
using XyYaw = Eigen::Vector3d;

/// An angle in [-pi, pi].
[[nodiscard]] inline double wrapped(double angle) {
  return std::remainder(angle, 2.0 * 3.14159265358979323846);
}

/// Pose b as seen from pose a.
[[nodiscard]] inline XyYaw between(const XyYaw& a, const XyYaw& b) {
  const double c = std::cos(a[2]);
  const double s = std::sin(a[2]);
  const double x = b[0] - a[0];
  const double y = b[1] - a[1];
  return {c * x + s * y, c * y - s * x, wrapped(b[2] - a[2])};
}

/// A measurement of pose `to` as seen from pose `from`.
struct PoseRelation {
  std::size_t from = 0;
  std::size_t to = 0;
  XyYaw measured;
  Eigen::Matrix3d information;  ///< Inverse covariance, in the frame of `from`.
  /// A Cauchy kernel's scale in standard deviations; 0 for none. Relations that may be wrong have one.
  double kernel = 0.0;
};

/// What a graph's solution costs.
struct PoseGraphReport {
  int iterations = 0;
  double before = 0.0;  ///< Sum of robust squared errors.
  double after = 0.0;
};

/// Moves the poses to a minimum of the sum of squared errors: Levenberg-Marquardt, each step by a sparse
/// Cholesky factorisation (Eigen). The first pose stays where it is.
/// @throws std::invalid_argument if a relation names a pose that is not there, or a number is not finite.
/// Cost: a step O(poses + relations) and the factorisation's fill. The same result on any number of cores.
inline PoseGraphReport solve(std::vector<XyYaw>& poses, const std::vector<PoseRelation>& relations,
                             int most_iterations = 50) {
  for (const XyYaw& pose : poses)
    if (!pose.allFinite()) throw std::invalid_argument("a pose of the graph is not finite");
  for (const PoseRelation& r : relations) {
    if (r.from >= poses.size() || r.to >= poses.size())
      throw std::invalid_argument("relation from " + std::to_string(r.from) + " to " + std::to_string(r.to) +
                                  ": there are " + std::to_string(poses.size()) + " poses");
    if (!r.measured.allFinite() || !r.information.allFinite())
      throw std::invalid_argument("relation from " + std::to_string(r.from) + " to " + std::to_string(r.to) +
                                  ": is not finite");
  }
  const auto error_of = [](const PoseRelation& r, const XyYaw& from, const XyYaw& to) {
    XyYaw error = between(from, to) - r.measured;
    error[2] = wrapped(error[2]);
    return error;
  };
  const auto cost_of = [&](const std::vector<XyYaw>& at) {
    double sum = 0.0;
    for (const PoseRelation& r : relations) {
      const XyYaw error = error_of(r, at[r.from], at[r.to]);
      const double square = error.dot(r.information * error);
      sum += r.kernel > 0.0 ? r.kernel * r.kernel * std::log1p(square / (r.kernel * r.kernel)) : square;
    }
    return sum;
  };
  PoseGraphReport report;
  report.before = report.after = cost_of(poses);
  if (poses.size() < 2) return report;
  const auto size = static_cast<Eigen::Index>(3 * (poses.size() - 1));
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver;
  bool is_analysed = false;
  double damping = 1e-6;
  for (; report.iterations < most_iterations; ++report.iterations) {
    checkpoint();
    std::vector<Eigen::Triplet<double>> entries;
    entries.reserve(relations.size() * 36);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(size);
    const auto add = [&](std::size_t i, std::size_t j, const Eigen::Matrix3d& block) {
      if (i == 0 || j == 0) return;
      for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 3; ++column)
          entries.emplace_back(static_cast<int>(3 * (i - 1)) + row, static_cast<int>(3 * (j - 1)) + column,
                               block(row, column));
    };
    for (const PoseRelation& r : relations) {
      const XyYaw& a = poses[r.from];
      const XyYaw error = error_of(r, a, poses[r.to]);
      const double square = error.dot(r.information * error);
      const double weight = r.kernel > 0.0 ? 1.0 / (1.0 + square / (r.kernel * r.kernel)) : 1.0;
      const double c = std::cos(a[2]);
      const double s = std::sin(a[2]);
      const double x = poses[r.to][0] - a[0];
      const double y = poses[r.to][1] - a[1];
      Eigen::Matrix3d from;
      from << -c, -s, c * y - s * x, s, -c, -s * y - c * x, 0.0, 0.0, -1.0;
      Eigen::Matrix3d to;
      to << c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0;
      const Eigen::Matrix3d information = weight * r.information;
      const Eigen::Matrix3d left = from.transpose() * information;
      const Eigen::Matrix3d right = to.transpose() * information;
      add(r.from, r.from, left * from);
      add(r.from, r.to, left * to);
      add(r.to, r.from, right * from);
      add(r.to, r.to, right * to);
      if (r.from > 0) gradient.segment<3>(static_cast<Eigen::Index>(3 * (r.from - 1))) += left * error;
      if (r.to > 0) gradient.segment<3>(static_cast<Eigen::Index>(3 * (r.to - 1))) += right * error;
    }
    for (int i = 0; i < size; ++i) entries.emplace_back(i, i, 0.0);
    Eigen::SparseMatrix<double> hessian(size, size);
    hessian.setFromTriplets(entries.begin(), entries.end());
    const Eigen::VectorXd diagonal = hessian.diagonal();
    bool is_better = false;
    double largest = 0.0;
    for (int attempt = 0; attempt < 10 && !is_better; ++attempt) {
      Eigen::SparseMatrix<double> damped = hessian;
      for (int i = 0; i < size; ++i) damped.coeffRef(i, i) += damping * (diagonal[i] + 1e-9);
      if (!is_analysed) solver.analyzePattern(damped);
      is_analysed = true;
      solver.factorize(damped);
      if (solver.info() == Eigen::Success) {
        const Eigen::VectorXd change = -solver.solve(gradient);
        std::vector<XyYaw> next = poses;
        for (std::size_t i = 1; i < next.size(); ++i) {
          next[i] += change.segment<3>(static_cast<Eigen::Index>(3 * (i - 1)));
          next[i][2] = wrapped(next[i][2]);
        }
        const double cost = cost_of(next);
        if (std::isfinite(cost) && cost <= report.after) {
          is_better = true;
          largest = change.cwiseAbs().maxCoeff();
          const bool is_flat = report.after - cost <= 1e-9 * (1.0 + cost);
          poses = std::move(next);
          report.after = cost;
          damping = std::max(damping * 0.1, 1e-12);
          if (is_flat) largest = 0.0;
          break;
        }
      }
      damping *= 10.0;
    }
    if (!is_better || largest < 1e-7) break;
  }
  return report;
}

}  // namespace ndtree
