// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Boxes and poses that Python hands over, checked.
#pragma once

#include <cstddef>
#include <vector>

#include "map_queries.hpp"
#include "numpy.hpp"

namespace ndtree::python {

/// A box as a (2, dim) array, with a volume.
class BoxArgument {
 public:
  /// @throws ValueError that says what is wrong with it.
  BoxArgument(const py::object& box, int dim, const char* name = "box");
  operator AnyBox() const { return {corners_.data(), corners_.data() + corners_.shape(1)}; }

 private:
  DoubleArray corners_;
};

/// Each a rotation, row by row, and a translation.
struct Poses {
  std::vector<double> numbers;
  std::size_t count;
};

/// From (n, 3) of x, y, yaw, or from (n, dim + 1, dim + 1). @throws ValueError naming the first that is
/// wrong.
Poses poses_from(const py::object& object, int dim, const char* name = "poses");

}  // namespace ndtree::python
