// SPDX-License-Identifier: BSD-3-Clause
#include "numpy.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "ndtree/core/option.hpp"

namespace ndtree::python {

std::string number_text(double value) { return py::repr(py::float_(value)).cast<std::string>(); }

py::array_t<double> matrix_of(const std::vector<double>& numbers, int dim) {
  py::array_t<double> matrix({dim + 1, dim + 1});
  for (int row = 0; row < dim; ++row) {
    for (int column = 0; column < dim; ++column)
      matrix.mutable_at(row, column) = numbers[static_cast<std::size_t>(row * dim + column)];
    matrix.mutable_at(row, dim) = numbers[static_cast<std::size_t>(dim * dim + row)];
  }
  for (int column = 0; column <= dim; ++column) matrix.mutable_at(dim, column) = column == dim ? 1.0 : 0.0;
  return matrix;
}

std::string shape_text(const py::array& array) {
  std::string text = "(";
  for (py::ssize_t i = 0; i < array.ndim(); ++i) text += (i ? ", " : "") + std::to_string(array.shape(i));
  return text + (array.ndim() == 1 ? ",)" : ")");
}

namespace {

/// @param type of the elements, or null: the object's own. @param flags of NumPy.
py::object converted(const py::object& object, PyObject* type, int flags) {
  const auto& numpy = py::detail::npy_api::get();
  return py::reinterpret_steal<py::object>(
      numpy.PyArray_FromAny_(object.ptr(), type, 0, 0, numpy.NPY_ARRAY_ENSUREARRAY_ | flags, nullptr));
}

}  // namespace

py::array as_array(const py::object& object, const std::string& what_is_wrong) {
  const py::object array = converted(object, nullptr, 0);
  if (array) return py::reinterpret_borrow<py::array>(array);
  const PyObject* const type = PyErr_Occurred();
  if (type == PyExc_TypeError ||
      type == PyExc_ValueError)  // Not of a kind derived from them: those are others'.
    py::raise_from(PyExc_TypeError, what_is_wrong.c_str());
  throw py::error_already_set();
}

DoubleArray as_doubles(const py::object& object, const char* name) {
  const py::array array = as_array(object, std::string(name) + ": must be an array of numbers");
  const char kind = array.dtype().kind();
  const bool empty_list = array.size() == 0;
  if (kind != 'f' && kind != 'i' && kind != 'u' && !empty_list)
    throw py::type_error(std::string(name) + " has dtype " + py::str(array.dtype()).cast<std::string>() +
                         ": must be an array of real numbers");
  constexpr int kPlain = py::array::c_style | py::array::forcecast | py::detail::npy_api::NPY_ARRAY_ALIGNED_;
  const py::object doubles = converted(array, py::dtype::of<double>().release().ptr(), kPlain);
  if (!doubles) throw py::error_already_set();
  return py::reinterpret_borrow<DoubleArray>(doubles);
}

DoubleArray as_points(const py::object& object, const char* name, int dim) {
  DoubleArray array = as_doubles(object, name);
  if (array.ndim() != 2 || array.shape(1) != dim)
    throw py::value_error(std::string(name) + " has shape " + shape_text(array) + ": must be (n, " +
                          std::to_string(dim) + ")");
  return array;
}

DoubleArray as_corners(const py::object& object, const char* name, int dim) {
  DoubleArray corners = as_doubles(object, name);
  if (corners.ndim() != 2 || corners.shape(0) != 2 || corners.shape(1) != dim)
    throw py::value_error(std::string(name) + " has shape " + shape_text(corners) + ": must be (2, " +
                          std::to_string(dim) + "), the lower and the upper corner");
  return corners;
}

DoubleArray as_points_or_one(const py::object& object, const char* name, int dim, py::ssize_t n) {
  DoubleArray array = as_doubles(object, name);
  const bool one = array.ndim() == 1 && array.shape(0) == dim;
  const bool each = array.ndim() == 2 && array.shape(0) == n && array.shape(1) == dim;
  if (!one && !each)
    throw py::value_error(std::string(name) + " has shape " + shape_text(array) + ": must be (" +
                          std::to_string(dim) + ",), one for all, or (" + std::to_string(n) + ", " +
                          std::to_string(dim) + "), one each");
  return array;
}

py::object as_mask(const py::object& object, const char* name, py::ssize_t n) {
  if (object.is_none()) return py::none();
  const std::string expected = std::string(name) + ": must be an array of bool, or None";
  const py::array array = as_array(object, expected);
  if (array.dtype().kind() != 'b') throw py::type_error(expected);
  if (array.ndim() != 1 || array.shape(0) != n)
    throw py::value_error(std::string(name) + " has shape " + shape_text(array) + ": must be (" +
                          std::to_string(n) + ",), one for each point");
  return BoolArray(array);
}

py::object as_one_each(const py::object& object, const char* name, py::ssize_t n) {
  if (object.is_none()) return py::none();
  DoubleArray array = as_doubles(object, name);
  if (array.ndim() != 1 || array.shape(0) != n)
    throw py::value_error(std::string(name) + " has shape " + shape_text(array) + ": must be (" +
                          std::to_string(n) + ",), one for each point");
  return py::object(std::move(array));
}

BeamArrays::BeamArrays(const py::object& points, const py::object& origin, const py::object& mask,
                       int dimension, const py::object& sigma)
    : endpoints(as_points(points, "points", dimension)),
      origins(as_points_or_one(origin, "origin", dimension, endpoints.shape(0))),
      returned(as_mask(mask, "returned", endpoints.shape(0))),
      range_sigma(as_one_each(sigma, "range_sigma", endpoints.shape(0))) {}

void BeamArrays::set_number(const std::optional<std::int64_t>& given) {
  if (!given) return;
  if (*given < 0) throw py::value_error("number = " + std::to_string(*given) + ": must be at least 0");
  number = static_cast<std::uint64_t>(*given);
}

void BeamArrays::require_scale(double cell_size, double max_range) const {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  if (max_range < kInfinity) return;  // Who says so means it.
  const double limit = kMostCells * cell_size;
  const py::ssize_t n = endpoints.shape(0);
  const py::ssize_t dim = endpoints.shape(1);
  const py::ssize_t step = origins.ndim() == 2 ? dim : 0;
  py::ssize_t far = 0;
  py::ssize_t finite = 0;
  std::string first;
  for (py::ssize_t i = 0; i < n; ++i) {
    double longest = 0.0;  // Along an axis.
    bool is_finite = true;
    for (py::ssize_t a = 0; a < dim; ++a) {
      const double along = std::abs(endpoints.data()[i * dim + a] - origins.data()[i * step + a]);
      is_finite = is_finite && std::isfinite(along);
      longest = std::max(longest, along);
    }
    if (!is_finite) continue;
    ++finite;
    if (longest > limit && far++ == 0)
      first = "beam " + std::to_string(i) + " is " + describe_number(longest) + " m long, " +
              describe_count(static_cast<std::size_t>(std::min(longest / cell_size, 1e18))) +
              " of the smallest cells";
  }
  if (far == 0) return;
  const bool are_most = 2 * far > finite;
  const std::string text = first + (are_most ? "; most beams are that long" : "") +
                           ": expected metres, and an origin in the frame of the points; if it is right, "
                           "set max_range";
  if (are_most) throw py::value_error(text);
  constexpr int kCaller = 2;  // Of the method that checks signatures.
  if (PyErr_WarnEx(PyExc_UserWarning, text.c_str(), kCaller) != 0) throw py::error_already_set();
}

BeamPointers BeamArrays::pointers() const {
  BeamPointers pointers;
  pointers.endpoints = endpoints.data();
  pointers.origins = origins.data();
  if (!returned.is_none()) pointers.returned = py::reinterpret_borrow<BoolArray>(returned).data();
  if (!range_sigma.is_none()) pointers.range_sigma = py::reinterpret_borrow<DoubleArray>(range_sigma).data();
  pointers.size = endpoints.shape(0);
  pointers.origin_per_beam = origins.ndim() == 2;
  pointers.number = number;
  return pointers;
}

}  // namespace ndtree::python
