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

}  // namespace ndtree::python
