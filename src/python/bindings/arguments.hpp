// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Boxes and poses that Python hands over, checked.
#pragma once

#include <cstddef>
#include <vector>

#include "map_layers.hpp"
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

/// From (n, 3) of x, y and yaw in the plane, (n, 7) of x, y, z and a quaternion x, y, z, w in space, or
/// (n, dim + 1, dim + 1) in both: a rotation, a translation, and zeros and a one below.
/// @throws ValueError naming the first that is wrong, what is wrong with it, and what is expected.
Poses poses_from(const py::object& object, int dim, const char* name = "poses");

/// One of them, without the first axis. @throws as poses_from().
Poses pose_from(const py::object& object, int dim, const char* name = "pose");

/// A str as UTF-8, whatever is in it. @pre it is one.
[[nodiscard]] std::string text_of(const py::handle& text);

/// The layers that a map is to have, from a dict of names and rules, or None. @throws ValueError or
/// TypeError.
std::vector<LayerKind> layer_kinds(const py::object& object);

/// Names and rules.
py::dict as_dict(const std::vector<LayerKind>& layers);
/// What cells carry, or beams measured, of a layer with this rule: (n,), (n, 3) for "mean3", labels as int64
/// and -1 where there is none. @param numbers nan where there are none.
py::object as_layer_array(const std::string& rule, std::vector<double> numbers);

/// Measurements of layers, from a dict of names and arrays, or None.
class LayerArguments {
 public:
  /// @param n number of beams: an array has a number, or some, for each. @throws ValueError or TypeError.
  LayerArguments(const py::object& object, py::ssize_t n);
  [[nodiscard]] const std::vector<LayerMeasurements>& all() const { return all_; }

 private:
  std::vector<DoubleArray> arrays_;
  std::vector<LayerMeasurements> all_;
};

}  // namespace ndtree::python
