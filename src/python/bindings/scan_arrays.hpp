// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Scans of Python's, as beams without a dimension.
#pragma once

#include <string>
#include <vector>

#include "numpy.hpp"

namespace ndtree::python {

/// The arrays of scans of one dimension, kept alive.
struct ScanArrays {
  std::vector<BeamArrays> beams;
  int dim = 0;  ///< 0 without scans.

  /// @param scans of ndtree.Scan. @throws ValueError naming the scan whose dimension is not that of the
  /// first, or not 2, 3 or 4.
  explicit ScanArrays(const py::iterable& scans) {
    for (const py::handle scan : scans) {
      if (beams.empty()) dim = dim_of(scan, 0);
      try {
        beams.emplace_back(scan.attr("endpoints"), scan.attr("origin"), scan.attr("returned"), dim);
      } catch (const py::value_error& error) {
        throw py::value_error("scan " + std::to_string(beams.size()) + ": " + error.what());
      }
    }
  }

  [[nodiscard]] static int dim_of(const py::handle& scan, std::size_t number) {
    const int dim = scan.attr("dim").cast<int>();
    if (dim < 2 || dim > 4)
      throw py::value_error("scan " + std::to_string(number) + ": dim = " + std::to_string(dim) +
                            ": must be 2, 3 or 4");
    return dim;
  }

  [[nodiscard]] std::vector<BeamPointers> pointers() const {
    std::vector<BeamPointers> pointers;
    pointers.reserve(beams.size());
    for (const BeamArrays& scan : beams) pointers.push_back(scan.pointers());
    return pointers;
  }
};

}  // namespace ndtree::python
