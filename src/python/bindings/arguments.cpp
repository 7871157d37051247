// SPDX-License-Identifier: BSD-3-Clause
#include "arguments.hpp"

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/layers/values.hpp"

namespace ndtree::python {

namespace {

// Larger departures are mistakes, smaller ones rounding.
constexpr double kRotationTolerance = 1e-4;
constexpr double kQuaternionTolerance = 1e-3;
constexpr double kBottomTolerance = 1e-9;

}  // namespace

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

namespace {

/// What is wrong with a matrix (dim, dim) as a rotation; empty if nothing. @param step from row to row.
std::string wrong_with_rotation(const double* matrix, int dim, py::ssize_t step) {
  Eigen::MatrixXd rotation(dim, dim);
  for (int row = 0; row < dim; ++row)
    for (int column = 0; column < dim; ++column) rotation(row, column) = matrix[row * step + column];
  const double off =
      (rotation * rotation.transpose() - Eigen::MatrixXd::Identity(dim, dim)).cwiseAbs().maxCoeff();
  if (!(off <= kRotationTolerance))
    return "its rotation is not one: rows must have length 1 and be at right angles, up to " +
           number_text(kRotationTolerance) + ", and are off by " + number_text(off);
  if (!(rotation.determinant() > 0.0))
    return "its rotation is not one: it mirrors, its determinant must be 1 and is -1";
  return {};
}

/// Of one pose, see poses_from(). @throws ValueError that begins with `which`.
class PoseReader {
 public:
  PoseReader(int dim, const py::array& array, py::ssize_t first_axis, const std::string& name) : dim_(dim) {
    const py::ssize_t axes = array.ndim() - first_axis;
    const py::ssize_t last = array.ndim() > 0 ? array.shape(array.ndim() - 1) : 0;
    is_matrix_ = axes == 2 && last == dim + 1 && array.shape(array.ndim() - 2) == dim + 1;
    if (is_matrix_ || (axes == 1 && ((dim == 2 && last == 3) || (dim == 3 && last == 7)))) return;
    const std::string n = first_axis == 1 ? "n, " : "";
    const std::string edge = std::to_string(dim + 1);
    std::string expected = "(" + n + edge + ", " + edge + ")";
    if (dim == 2) expected += ", or (" + n + (n.empty() ? "3,)" : "3)") + " of x, y and yaw";
    if (dim == 3) expected += ", or (" + n + (n.empty() ? "7,)" : "7)") + " of x, y, z, qx, qy, qz and qw";
    throw py::value_error(name + " has shape " + shape_text(array) + ": must be " + expected);
  }
  [[nodiscard]] py::ssize_t numbers() const {
    return is_matrix_ ? (dim_ + 1) * (dim_ + 1) : dim_ == 2 ? 3 : 7;
  }
  /// Adds rotation and translation.
  void read(const double* from, const std::string& which, std::vector<double>& to) const {
    if (!std::all_of(from, from + numbers(), [](double x) { return std::isfinite(x); }))
      throw py::value_error(which + ": must be finite");
    if (is_matrix_)
      matrix(from, which, to);
    else if (dim_ == 2)
      plane(from, which, to);
    else
      quaternion(from, which, to);
  }

 private:
  /// Warns once of yaws beyond two turns, as numbers of degrees are; paths of a body that turns may go beyond
  /// one.
  void plane(const double* from, const std::string& which, std::vector<double>& to) const {
    constexpr double kTwoTurns = 12.566371;
    if (std::abs(from[2]) > kTwoTurns && !has_warned_) {
      has_warned_ = true;
      const std::string said = which + ": a yaw of " + number_text(from[2]) + " rad: is it in degrees?";
      if (PyErr_WarnEx(PyExc_UserWarning, said.c_str(), 2) != 0) throw py::error_already_set();
    }
    to.insert(to.end(), {std::cos(from[2]), -std::sin(from[2]), std::sin(from[2]), std::cos(from[2]), from[0],
                         from[1]});
  }
  void matrix(const double* from, const std::string& which, std::vector<double>& to) const {
    const int edge = dim_ + 1;
    const std::string wrong = wrong_with_rotation(from, dim_, edge);
    if (!wrong.empty()) throw py::value_error(which + ": " + wrong);
    for (int column = 0; column < edge; ++column) {
      const double expected = column == dim_ ? 1.0 : 0.0;
      const double found = from[dim_ * edge + column];
      if (std::abs(found - expected) > kBottomTolerance)
        throw py::value_error(which + ": its last row has " + number_text(found) + " in column " +
                              std::to_string(column) + ": must be " + (column == dim_ ? "1" : "0") +
                              "; is it transposed?");
    }
    for (int row = 0; row < dim_; ++row) to.insert(to.end(), from + row * edge, from + row * edge + dim_);
    for (int row = 0; row < dim_; ++row) to.push_back(from[row * edge + dim_]);
  }
  static void quaternion(const double* from, const std::string& which, std::vector<double>& to) {
    const double* const q = from + 3;
    const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(std::abs(length - 1.0) <= kQuaternionTolerance))
      throw py::value_error(which + ": its quaternion has length " + number_text(length) + ": must be 1");
    const double x = q[0] / length;
    const double y = q[1] / length;
    const double z = q[2] / length;
    const double w = q[3] / length;
    to.insert(to.end(), {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
                         2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                         2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)});
    to.insert(to.end(), from, from + 3);
  }

  mutable bool has_warned_ = false;
  int dim_;
  bool is_matrix_ = false;
};

}  // namespace

Poses poses_from(const py::object& object, int dim, const char* name) {
  const DoubleArray poses = as_doubles(object, name);
  const PoseReader reader(dim, poses, 1, name);
  Poses result{{}, static_cast<std::size_t>(poses.shape(0))};
  result.numbers.reserve(static_cast<std::size_t>(poses.shape(0) * (dim * dim + dim)));
  for (py::ssize_t i = 0; i < poses.shape(0); ++i)
    reader.read(poses.data() + i * reader.numbers(), "pose " + std::to_string(i), result.numbers);
  return result;
}

Poses pose_from(const py::object& object, int dim, const char* name) {
  const DoubleArray pose = as_doubles(object, name);
  const PoseReader reader(dim, pose, 0, name);
  Poses result{{}, 1};
  reader.read(pose.data(), name, result.numbers);
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

py::dict as_dict(const std::vector<LayerKind>& layers) {
  py::dict dict;
  for (const LayerKind& kind : layers) dict[py::str(kind.name)] = kind.rule;
  return dict;
}

py::object as_layer_array(const std::string& rule, std::vector<double> numbers) {
  if (rule == MajorityLabel::rule()) {
    std::vector<std::int64_t> labels(numbers.size(), -1);
    for (std::size_t i = 0; i < numbers.size(); ++i)
      if (!std::isnan(numbers[i])) labels[i] = static_cast<std::int64_t>(numbers[i]);
    return take(std::move(labels));
  }
  if (rule == MeanValue<3>::rule()) return take(std::move(numbers), 3);
  return take(std::move(numbers));
}

LayerArguments::LayerArguments(const py::object& object, py::ssize_t n) {
  if (object.is_none()) return;
  for (const auto& [key, value] : as_layers(object, "arrays")) {
    const auto name = text_of(key);
    const std::string argument = "layers['" + name + "']";
    const py::object mask = py::reinterpret_steal<py::object>(PyObject_GetAttrString(value.ptr(), "mask"));
    if (!mask && PyErr_ExceptionMatches(PyExc_AttributeError) == 0) throw py::error_already_set();
    PyErr_Clear();
    if (mask)
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
