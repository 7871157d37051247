// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Scans and poses before their dimension is known.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "ndtree/core/body.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree::python {

/// A view as ScanView, of arrays of any dimension.
struct BeamPointers {
  const double* endpoints = nullptr;
  const double* origins = nullptr;
  const bool* returned = nullptr;
  const double* range_sigma = nullptr;
  Eigen::Index size = 0;
  bool origin_per_beam = false;
  std::optional<std::uint64_t> number;

  template <int D>
  [[nodiscard]] ScanView<D> view() const {
    ScanView<D> scan;
    scan.endpoints = endpoints;
    scan.origins = origins;
    scan.returned = returned;
    scan.range_sigma = range_sigma;
    scan.size = size;
    scan.origin_per_beam = origin_per_beam;
    scan.number = number;
    return scan;
  }
};

/// A pose of the numbers in which it crosses the interface: the rotation row by row, then the translation.
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
