// SPDX-License-Identifier: BSD-3-Clause
// Points of messages of sensors: pixels to points, and points to the map, in one pass each. Terms are added
// in the order of axes, each rounded, so that the last bits of a map are the same on all machines.
#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "binders.hpp"
#include "docstrings.hpp"
#include "ndtree/core/simd.hpp"
#include "numpy.hpp"
#include "released.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style>;

/// Calls `use(array)` with an array of float where that is its type, else of double.
template <class Use>
auto as_floating(const py::object& object, const char* name, const Use& use) {
  const py::array array = as_array(object, std::string(name) + ": must be an array of numbers");
  if (py::isinstance<py::array_t<float>>(array)) return use(Array<float>(array));
  return use(as_doubles(object, name));
}

py::array_t<double> moved_points(const py::object& points, const py::object& rotation,
                                 const py::object& position) {
  const DoubleArray turn = as_points(rotation, "rotation", 3);
  const DoubleArray move = as_doubles(position, "position");
  if (turn.shape(0) != 3 || move.size() != 3)
    throw py::value_error("rotation and position have shapes " + shape_text(turn) + " and " +
                          shape_text(move) + ": must be (3, 3) and (3,)");
  return as_floating(points, "points", [&](const auto& array) {
    if (array.ndim() != 2 || array.shape(1) != 3)
      throw py::value_error("points has shape " + shape_text(array) + ": must be (n, 3)");
    const py::ssize_t n = array.shape(0);
    py::array_t<double> moved({n, py::ssize_t{3}});
    const auto* from = array.data();
    double* to = moved.mutable_data();
    std::array<double, 9> r{};
    std::array<double, 3> p{};
    for (std::size_t k = 0; k < 9; ++k) r[k] = turn.data()[k];
    for (std::size_t k = 0; k < 3; ++k) p[k] = move.data()[k];
    const Released released;
    for (py::ssize_t i = 0; i < n; ++i, from += 3, to += 3) {
      const std::array<double, 3> own{double{from[0]}, double{from[1]}, double{from[2]}};
      for (std::size_t a = 0; a < 3; ++a)
        to[a] = unfused(own[0] * r[3 * a]) + unfused(own[1] * r[3 * a + 1]) + unfused(own[2] * r[3 * a + 2]) +
                p[a];
    }
    return moved;
  });
}

template <class T>
std::vector<double> points_of_depths(const Array<T>& image, const double* x, const double* y, double z,
                                     const std::vector<double>& no_depth) {
  const py::ssize_t rows = image.shape(0);
  const py::ssize_t columns = image.shape(1);
  const T* value = image.data();
  std::vector<double> points(static_cast<std::size_t>(3 * rows * columns));
  double* to = points.data();
  for (py::ssize_t row = 0; row < rows; ++row) {
    for (py::ssize_t column = 0; column < columns; ++column, ++value) {
      const auto depth = static_cast<double>(*value);
      if (!(depth > 0.0) || !std::isfinite(depth)) continue;
      bool has_depth = true;
      for (const double none : no_depth) has_depth &= depth != none;
      if (!has_depth) continue;
      to[0] = x[column] * depth;
      to[1] = y[row] * depth;
      to[2] = z * depth;
      to += 3;
    }
  }
  points.resize(static_cast<std::size_t>(to - points.data()));
  return points;
}

py::array_t<double> depth_points(const py::object& image, const py::object& x, const py::object& y, double z,
                                 const std::vector<double>& no_depth) {
  const DoubleArray right = as_doubles(x, "x");
  const DoubleArray down = as_doubles(y, "y");
  const auto made = [&](const auto& values) {
    if (values.ndim() != 2 || right.size() != values.shape(1) || down.size() != values.shape(0))
      throw py::value_error("image, x and y have shapes " + shape_text(values) + ", " + shape_text(right) +
                            " and " + shape_text(down) + ": must be (rows, columns), (columns,) and (rows,)");
    const double* const at_x = right.data();
    const double* const at_y = down.data();
    std::vector<double> points;
    {
      const Released released;
      points = points_of_depths(values, at_x, at_y, z, no_depth);
    }
    return take(std::move(points), 3);
  };
  const py::array array = as_array(image, "image: must be an array of numbers");
  if (py::isinstance<py::array_t<std::uint16_t>>(array)) return made(Array<std::uint16_t>(array));
  return as_floating(image, "image", made);
}

/// Positions of the points (n, dim) that are nearer than a distance to their origin, (dim,) or (n, dim).
template <class T>
std::vector<std::int64_t> near_points(const Array<T>& points, const DoubleArray& origin, T distance) {
  const py::ssize_t dim = points.shape(1);
  const py::ssize_t step = origin.ndim() == 2 ? dim : 0;
  const T* at = points.data();
  const double* from = origin.data();
  std::vector<std::int64_t> near;
  for (std::int64_t i = 0; i < points.shape(0); ++i, at += dim, from += step) {
    T sum = 0;
    for (py::ssize_t a = 0; a < dim; ++a) {
      const T way = at[a] - static_cast<T>(from[a]);
      sum += unfused(way * way);
    }
    if (sum < distance * distance) near.push_back(i);
  }
  return near;
}

py::array_t<std::int64_t> points_within(const py::object& points, const py::object& origin, double distance) {
  return as_floating(points, "points", [&](const auto& array) {
    using T = std::decay_t<decltype(*array.data())>;
    const DoubleArray from = as_doubles(origin, "origin");
    const bool is_one = from.ndim() == 1 && array.ndim() == 2 && from.shape(0) == array.shape(1);
    const bool are_each = from.ndim() == 2 && array.ndim() == 2 && from.shape(0) == array.shape(0) &&
                          from.shape(1) == array.shape(1);
    if (!is_one && !are_each)
      throw py::value_error("points and origin have shapes " + shape_text(array) + " and " +
                            shape_text(from) + ": must be (n, dim), and (dim,) or (n, dim)");
    std::vector<std::int64_t> near;
    {
      const Released released;
      near = near_points<T>(array, from, static_cast<T>(distance));
    }
    return take(std::move(near));
  });
}

}  // namespace

void bind_points(py::module_& module) {
  module.def("moved_points", &moved_points, "points"_a, "rotation"_a, "position"_a, doc::moved_points);
  module.def("depth_points", &depth_points, "image"_a, "x"_a, "y"_a, "z"_a, "no_depth"_a, doc::depth_points);
  module.def("points_within", &points_within, "points"_a, "origin"_a, "distance"_a, doc::points_within);
}

}  // namespace ndtree::python
