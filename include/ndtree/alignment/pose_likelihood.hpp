// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a scan says of its pose near one: the likelihood's gradient and information, with errors that end
/// points share.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ndtree/alignment/match_options.hpp"
#include "ndtree/alignment/rigid_motion.hpp"
#include "ndtree/alignment/surface_elements.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Of a point's place, by a Motion of its scan's pose. @param turned from the scan's origin.
template <int D>
[[nodiscard]] Eigen::Matrix<double, D, kFreedoms<D>> jacobian_of(const Vector<D>& turned) {
  Eigen::Matrix<double, D, kFreedoms<D>> jacobian;
  jacobian.template leftCols<D>().setIdentity();
  if constexpr (D == 2) {
    jacobian.col(2) << -turned[1], turned[0];
  } else {
    jacobian.template rightCols<3>() << 0.0, turned[2], -turned[1],  //
        -turned[2], 0.0, turned[0],                                  //
        turned[1], -turned[0], 0.0;
  }
  return jacobian;
}

/// Normal equations of a pose, point by point; see "Poses" in docs/derivation.md.
///
/// Strategy: residuals e = n·(x - p) of end points x from flat pieces of surface have the covariance
/// S = diag(own variances) + B P B': each piece of a row shifts and tilts as a whole, each side of walls
/// shifts as a whole, and in space all does. Woodbury's identity reduces J' S^-1 J to sums over each piece,
/// so that nothing larger than a Motion is inverted. Where n is not sure, J seems to vary at random: the
/// information of that is known, and directions in which there is no more say nothing. A Cauchy kernel
/// weighs outliers. O(points).
template <int D>
class PoseLikelihood {
 public:
  static constexpr int K = kFreedoms<D>;

  PoseLikelihood(const SurfaceElements<D>& surface, const MatchOptions& options)
      : surface_(surface),
        noise_(options.noise * options.noise),
        shared_(surface.shared),
        loose_(options.cell_size * options.cell_size),
        slots_(static_cast<std::size_t>(2 * surface.num_pieces), kNone) {}

  /// Begins anew, for a pose.
  void begin(const Pose<D>& pose) {
    for (const Piece& piece : pieces_) slots_[piece.slot] = kNone;
    pieces_.clear();
    pose_ = pose;
    information_.setZero();
    by_chance_.setZero();
    gradient_.setZero();
    squares_ = weights_ = 0.0;
    inliers_ = 0;
  }
  /// @param turned a point from the scan's origin, along the map's axes. @param nearest element to it.
  void add(const Vector<D>& turned, std::size_t nearest) {
    const SurfaceShape<D>& shape = surface_.shapes[nearest];
    const Vector<D> place = surface_.points.col(static_cast<Eigen::Index>(nearest));
    const Vector<D> error = turned + pose_.translation - place;
    const Eigen::Matrix<double, D, K> jacobian = jacobian_of<D>(turned);
    if (!shape.is_flat) {
      const double weight = weighed((shape.across * error).squaredNorm() / (loose_ + noise_));
      Piece& piece = piece_of(2 * static_cast<std::size_t>(shape.piece), shape);
      piece.weight += weight;
      piece.jacobian += weight * shape.across * jacobian;
      piece.error += weight * shape.across * error;
      return;
    }
    const bool is_behind = shape.normal.dot(turned) > 0.0;
    if (shape.has_side && is_behind) return;  // Its other side.
    const Vector<D> normal = is_behind ? Vector<D>(-shape.normal) : shape.normal;
    const double distance = normal.dot(error);
    const double variance = std::max(shape.variance, noise_ + shared_);
    const double weight = weighed(distance * distance / (variance + shared_)) / variance;
    const Motion<D> row = jacobian.transpose() * normal;
    by_chance_ += weight * shape.turn * (jacobian.transpose() * jacobian - row * row.transpose());
    if (shared_ == 0.0) {
      information_ += weight * row * row.transpose();
      gradient_ += weight * distance * row;
      return;
    }
    const std::size_t side = normal[shape.axis] > 0.0 ? 1 : 0;
    Piece& piece = piece_of(2 * static_cast<std::size_t>(shape.piece) + side, shape);
    Vector<D> basis = place - pose_.translation;  // 1, and the place along the piece.
    basis[shape.axis] = 1.0;
    piece.lower = piece.lower.cwiseMin(basis);
    piece.upper = piece.upper.cwiseMax(basis);
    piece.jj += weight * row * row.transpose();
    piece.jb += weight * row * basis.transpose();
    piece.bb += weight * basis * basis.transpose();
    piece.je += weight * distance * row;
    piece.be += weight * distance * basis;
  }

  struct Result {
    MotionMatrix<D> information;
    Motion<D> gradient;
    double spread = 1.0;  ///< Mean square of the weighed errors over their variances, at least 1.
    int inliers = 0;
  };
  [[nodiscard]] Result result() {
    std::array<Side, std::size_t{2 * SurfaceElements<D>::kDirections}> sides;
    for (const Piece& piece : pieces_) {
      if (piece.shape->is_flat)
        add_row(piece, sides[static_cast<std::size_t>(2 * piece.shape->direction) + piece.slot % 2]);
      else
        add_loose(piece);
    }
    for (const Side& side : sides) {
      const double denominator = 1.0 / (kSide * shared_) + side.ones;
      if (side.ones == 0.0) continue;
      information_ -= side.jacobian * side.jacobian.transpose() / denominator;
      gradient_ -= side.jacobian * (side.error / denominator);
    }
    if (D == 3 && shared_ > 0.0) share_shift();
    Result result{information_, gradient_, weights_ > 0.0 ? std::max(squares_ / weights_, 1.0) : 1.0,
                  inliers_};
    leave_out_chance(result);
    return result;
  }

 private:
  static constexpr std::int32_t kNone = -1;
  static constexpr double kKernel = 2.0;  // Standard deviations from which on a point counts half, and less.
  static constexpr double kTilt = 0.5;    // Variance of a piece's ends against each other, of its own.
  static constexpr double kSide = 0.35;   // Variance of all that faces one way, of that of a piece.
  static constexpr double kChance = 2.0;  // Information by chance that there may be in a direction.
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  struct Piece {
    std::size_t slot = 0;
    const SurfaceShape<D>* shape = nullptr;
    // Of what is not flat.
    double weight = 0.0;
    Eigen::Matrix<double, D, K> jacobian = Eigen::Matrix<double, D, K>::Zero();
    Vector<D> error = Vector<D>::Zero();
    // Of flat ones: products of the Jacobians j, the basis b of what is shared, and the errors e.
    MotionMatrix<D> jj = MotionMatrix<D>::Zero();
    Eigen::Matrix<double, K, D> jb = Eigen::Matrix<double, K, D>::Zero();
    Eigen::Matrix<double, D, D> bb = Eigen::Matrix<double, D, D>::Zero();
    Motion<D> je = Motion<D>::Zero();
    Vector<D> be = Vector<D>::Zero();
    Vector<D> lower = Vector<D>::Constant(kInfinity);
    Vector<D> upper = Vector<D>::Constant(-kInfinity);
  };
  /// Sums over all pieces that face one way, after what each shares.
  struct Side {
    Motion<D> jacobian = Motion<D>::Zero();
    double ones = 0.0;
    double error = 0.0;
  };

  /// Counts a point. @returns its weight.
  double weighed(double square) {
    const double weight = 1.0 / (1.0 + square / (kKernel * kKernel));
    squares_ += weight * square;
    weights_ += weight;
    if (square < 2.0 * kKernel * kKernel) ++inliers_;
    return weight;
  }
  Piece& piece_of(std::size_t slot, const SurfaceShape<D>& shape) {
    std::int32_t& number = slots_[slot];
    if (number == kNone) {
      number = static_cast<std::int32_t>(pieces_.size());
      pieces_.emplace_back();
      pieces_.back().slot = slot;
      pieces_.back().shape = &shape;
    }
    return pieces_[static_cast<std::size_t>(number)];
  }
  void add_loose(const Piece& piece) {
    if (piece.weight <= 0.0) return;
    const Eigen::Matrix<double, D, K> jacobian = piece.jacobian / piece.weight;
    const Vector<D> error = piece.error / piece.weight;
    const double information = std::min(1.0, piece.weight) / (noise_ / piece.weight + loose_);
    information_ += information * jacobian.transpose() * jacobian;
    gradient_ += information * jacobian.transpose() * error;
  }
  void add_row(const Piece& piece, Side& side) {
    // The basis is 1 and places along the piece, from -1 at one end to 1 at the other.
    const int axis = piece.shape->axis;
    Eigen::Matrix<double, D, D> change = Eigen::Matrix<double, D, D>::Identity();
    Vector<D> precision = Vector<D>::Constant(1.0 / (kTilt * shared_));
    precision[axis] = 1.0 / shared_;
    for (int a = 0; a < D; ++a) {
      if (a == axis) continue;
      const double half = std::max(0.5 * (piece.upper[a] - piece.lower[a]), std::sqrt(loose_));
      change(a, a) = 1.0 / half;
      change(axis, a) = -0.5 * (piece.upper[a] + piece.lower[a]) / half;
    }
    const Eigen::Matrix<double, K, D> jb = piece.jb * change;
    const Eigen::Matrix<double, D, D> bb = change.transpose() * piece.bb * change;
    const Vector<D> be = change.transpose() * piece.be;
    Eigen::Matrix<double, D, D> inner = bb;
    inner.diagonal() += precision;
    const Eigen::Matrix<double, D, D> inverse = inner.inverse();
    information_ += piece.jj - jb * inverse * jb.transpose();
    gradient_ += piece.je - jb * (inverse * be);
    side.jacobian += jb.col(axis) - jb * (inverse * bb.col(axis));
    side.ones += bb(axis, axis) - bb.col(axis).dot(inverse * bb.col(axis));
    side.error += be[axis] - bb.col(axis).dot(inverse * be);
  }
  /// Lets all surfaces lie beside their places by one shift, with the variance of a piece on each axis.
  void share_shift() {
    Eigen::Matrix<double, D, D> inner = information_.template topLeftCorner<D, D>();
    inner.diagonal().array() += 1.0 / shared_;
    const Eigen::Matrix<double, K, D> columns = information_.template leftCols<D>();
    const Eigen::Matrix<double, K, D> share = columns * inner.inverse();
    gradient_ -= share * gradient_.template head<D>().eval();
    information_ -= share * columns.transpose();
  }
  /// Takes what the normals' errors alone would give off the information, direction by direction.
  void leave_out_chance(Result& result) const {
    using Matrix = SmallMatrix<kFreedoms<3>>;
    constexpr double kLeast = 1e-9;  // Keeps a scan without points solvable.
    Matrix information = result.information;
    information.diagonal().array() += kLeast;
    const Eigen::LLT<Matrix> factor(information);
    if (factor.info() != Eigen::Success) return;
    Matrix chance = factor.matrixL().solve(Matrix(by_chance_));
    chance = factor.matrixL().solve(Matrix(chance.transpose()));
    const Eigen::SelfAdjointEigenSolver<Matrix> solver(chance);
    const Matrix root = Matrix(factor.matrixL()) * solver.eigenvectors();
    const Eigen::Matrix<double, K, 1> kept = (1.0 - kChance * solver.eigenvalues().array()).max(0.0).min(1.0);
    const Motion<D> direct =
        solver.eigenvectors().transpose() * factor.matrixL().solve(Matrix(result.gradient));
    result.information = root * kept.asDiagonal() * root.transpose();
    result.gradient = root * Motion<D>(kept.cwiseProduct(direct));
  }

  const SurfaceElements<D>& surface_;
  double noise_;
  double shared_;
  double loose_;
  Pose<D> pose_;
  std::vector<std::int32_t> slots_;
  std::vector<Piece> pieces_;
  MotionMatrix<D> information_ = MotionMatrix<D>::Zero();
  MotionMatrix<D> by_chance_ = MotionMatrix<D>::Zero();
  Motion<D> gradient_ = Motion<D>::Zero();
  double squares_ = 0.0;
  double weights_ = 0.0;
  int inliers_ = 0;
};

}  // namespace ndtree
