// SPDX-License-Identifier: BSD-3-Clause
#include "arguments.hpp"

#include <algorithm>
#include <cmath>
#include <string>

namespace ndtree::python {

BoxArgument::BoxArgument(const py::object& box, int dim, const char* name)
    : corners_(as_corners(box, name, dim)) {
  const AnyBox region = *this;
  for (py::ssize_t a = 0; a < corners_.shape(1); ++a)
    if (!std::isfinite(region.lower[a]) || !std::isfinite(region.upper[a]) ||
        !(region.lower[a] < region.upper[a]))
      throw py::value_error(std::string(name) + ": from " + number_text(region.lower[a]) + " to " +
                            number_text(region.upper[a]) + " m on axis " + std::to_string(a) +
                            ": must be finite, the lower corner first");
}

Poses poses_from(const py::object& object, int dim, const char* name) {
  const DoubleArray poses = as_doubles(object, name);
  const bool is_planar = dim == 2 && poses.ndim() == 2 && poses.shape(1) == 3;
  const bool is_matrix = poses.ndim() == 3 && poses.shape(1) == dim + 1 && poses.shape(2) == dim + 1;
  if (!is_planar && !is_matrix)
    throw py::value_error(std::string(name) + ": shape " + shape_text(poses) + ", expected " +
                          (dim == 2
                               ? "(n, 3), x, y and yaw, or (n, 3, 3)"
                               : "(n, " + std::to_string(dim + 1) + ", " + std::to_string(dim + 1) + ")"));
  Poses result{{}, static_cast<std::size_t>(poses.shape(0))};
  result.numbers.reserve(static_cast<std::size_t>(poses.shape(0) * (dim * dim + dim)));
  for (py::ssize_t i = 0; i < poses.shape(0); ++i) {
    const double* const from = poses.data() + i * (is_planar ? 3 : (dim + 1) * (dim + 1));
    const py::ssize_t numbers = is_planar ? 3 : (dim + 1) * (dim + 1);
    if (!std::all_of(from, from + numbers, [](double x) { return std::isfinite(x); }))
      throw py::value_error("pose " + std::to_string(i) + ": must be finite");
    if (is_planar) {
      const double c = std::cos(from[2]);
      const double s = std::sin(from[2]);
      result.numbers.insert(result.numbers.end(), {c, -s, s, c, from[0], from[1]});
      continue;
    }
    for (int row = 0; row < dim; ++row)
      for (int other = 0; other < dim; ++other) {
        double product = 0.0;
        for (int k = 0; k < dim; ++k) product += from[row * (dim + 1) + k] * from[other * (dim + 1) + k];
        if (std::abs(product - (row == other ? 1.0 : 0.0)) > 1e-4)
          throw py::value_error("pose " + std::to_string(i) + ": its rotation is not one");
      }
    for (int row = 0; row < dim; ++row)
      result.numbers.insert(result.numbers.end(), from + row * (dim + 1), from + row * (dim + 1) + dim);
    for (int row = 0; row < dim; ++row) result.numbers.push_back(from[row * (dim + 1) + dim]);
  }
  return result;
}

namespace {

/// @throws TypeError if it is no dict with str as keys.
py::dict as_layers(const py::object& object, const char* of_values) {
  const std::string expected = std::string("must be a dict of str and ") + of_values;
  if (!py::isinstance<py::dict>(object))
    throw py::type_error("layers = " + py::repr(object).cast<std::string>() + ": " + expected);
  const auto dict = py::reinterpret_borrow<py::dict>(object);
  for (const auto& [key, value] : dict)
    if (!py::isinstance<py::str>(key))
      throw py::type_error("layers: " + py::repr(key).cast<std::string>() + ": " + expected);
  return dict;
}

}  // namespace

std::string text_of(const py::handle& text) {
  // Surrogates, which no UTF-8 has, are written as \\udXXX, so that errors can name them.
  const auto bytes =
      py::reinterpret_steal<py::bytes>(PyUnicode_AsEncodedString(text.ptr(), "utf-8", "backslashreplace"));
  if (!bytes) throw py::error_already_set();
  return bytes;
}

std::vector<LayerKind> layer_kinds(const py::object& object) {
  std::vector<LayerKind> kinds;
  if (object.is_none()) return kinds;
  for (const auto& [key, value] : as_layers(object, "str")) {
    const auto name = text_of(key);
    const auto is_letter = [](char c) {
      return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
    };
    const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
    if (name.empty() || name.size() > 64 || is_digit(name[0]) ||
        !std::all_of(name.begin(), name.end(), [&](char c) { return is_letter(c) || is_digit(c); }))
      throw py::value_error("layers: " + describe_text(name) +
                            ": a name must be letters, digits and _, at most 64, no digit first");
    if (!py::isinstance<py::str>(value))
      throw py::type_error("layers: " + describe_text(name) + ": " + py::repr(value).cast<std::string>() +
                           ": must be 'mean', 'mean3', 'majority' or 'latest'");
    kinds.push_back({name, text_of(value)});
  }
  return kinds;
}

LayerArguments::LayerArguments(const py::object& object, py::ssize_t n) {
  if (object.is_none()) return;
  for (const auto& [key, value] : as_layers(object, "arrays")) {
    const auto name = text_of(key);
    const std::string argument = "layers['" + name + "']";
    if (py::hasattr(value, "mask"))
      throw py::type_error(argument +
                           " is a masked array: must be a plain one, with what is not masked alone");
    const DoubleArray array = as_doubles(py::reinterpret_borrow<py::object>(value), argument.c_str());
    const py::ssize_t last = array.ndim() > 0 ? array.shape(array.ndim() - 1) : 1;
    const py::ssize_t width = array.size() == n && n > 0 ? 1 : last;  // Beams may be a grid, too.
    if (array.ndim() == 0 || array.size() != n * width || (width > 1 && array.ndim() == 1 && n != 1))
      throw py::value_error(argument + " has shape " + shape_text(array) +
                            ": must have one entry for each of " + std::to_string(n) + " points");
    arrays_.push_back(array);
    all_.push_back({name, array.data(), static_cast<std::size_t>(n > 0 || array.ndim() > 1 ? width : 1)});
  }
}

}  // namespace ndtree::python
