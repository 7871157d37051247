// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A scan before its dimension is known.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "ndtree/core/scan.hpp"

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

}  // namespace ndtree::python
