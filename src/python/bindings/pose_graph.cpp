// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>

#include <Eigen/Core>
#include <cstddef>
#include <utility>
#include <vector>

#include "arguments.hpp"
#include "binders.hpp"
#include "docstrings.hpp"
#include "matching.hpp"
#include "numpy.hpp"
#include "released.hpp"

namespace py = pybind11;
using namespace pybind11::literals;

namespace ndtree::python {
namespace {

py::tuple solve_arrays(const py::object& poses, const py::object& pairs, const py::object& measured,
                       const py::object& information, const py::object& kernels, int iterations) {
  const DoubleArray start = as_points(poses, "poses", 3);
  const DoubleArray relative = as_points(measured, "measured", 3);
  const py::ssize_t count = relative.shape(0);
  const DoubleArray numbers = as_points(pairs, "pairs", 2);
  const DoubleArray matrices = as_doubles(information, "information");
  const DoubleArray scales = as_doubles(kernels, "kernels");
  if (numbers.shape(0) != count || matrices.ndim() != 3 || matrices.shape(0) != count ||
      matrices.shape(1) != 3 || matrices.shape(2) != 3 || scales.ndim() != 1 || scales.shape(0) != count)
    throw py::value_error("pairs " + shape_text(numbers) + ", information " + shape_text(matrices) +
                          " and kernels " + shape_text(scales) + ": must have one for each of measured " +
                          shape_text(relative));
  std::vector<XyYaw> at(static_cast<std::size_t>(start.shape(0)));
  for (std::size_t i = 0; i < at.size(); ++i) at[i] = Eigen::Map<const XyYaw>(start.data() + 3 * i);
  std::vector<PoseRelation> relations(static_cast<std::size_t>(count));
  for (std::size_t i = 0; i < relations.size(); ++i) {
    const double* const pair = numbers.data() + 2 * i;
    if (!(pair[0] >= 0.0) || !(pair[1] >= 0.0)) throw py::value_error("pairs: must be >= 0");
    relations[i].from = static_cast<std::size_t>(pair[0]);
    relations[i].to = static_cast<std::size_t>(pair[1]);
    relations[i].measured = Eigen::Map<const XyYaw>(relative.data() + 3 * i);
    relations[i].information = Eigen::Map<const Eigen::Matrix3d>(matrices.data() + 9 * i);
    relations[i].kernel = scales.data()[i];
  }
  PoseGraphReport report;
  {
    const Released released;
    report = solve_graph(at, relations, iterations);
  }
  std::vector<double> moved;
  moved.reserve(3 * at.size());
  for (const XyYaw& pose : at) moved.insert(moved.end(), pose.data(), pose.data() + 3);
  return py::make_tuple(take(std::move(moved), 3), report.iterations, report.before, report.after);
}

}  // namespace

void bind_pose_graph(py::module_& module) {
  module.def("solve_pose_graph", &solve_arrays, "poses"_a, "pairs"_a, "measured"_a, "information"_a,
             "kernels"_a, py::kw_only(), "iterations"_a = 50, doc::solve_pose_graph);
}

}  // namespace ndtree::python
