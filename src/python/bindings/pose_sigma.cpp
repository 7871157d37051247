// SPDX-License-Identifier: BSD-3-Clause
#include "pose_sigma.hpp"

#include <array>
#include <optional>
#include <string>

#include "beam_pointers.hpp"
#include "binders.hpp"
#include "docstrings.hpp"
#include "python_map.hpp"
#include "sigma_with_covariance.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// x, y and yaw of a pose in space.
constexpr std::array<int, 3> kPlanar{0, 1, 5};
constexpr int kOfSpace = 6;

template <int D>
PoseCovariance<D> covariance_of(const DoubleArray& array) {
  constexpr int kSize = PoseCovariance<D>::RowsAtCompileTime;
  const bool is_square = array.ndim() == 2 && array.shape(0) == array.shape(1);
  if (!is_square || (array.shape(0) != kSize && array.shape(0) != kOfSpace))
    throw py::value_error(
        "pose_covariance has shape " + shape_text(array) + ": must be " +
        (D == 2 ? "(3, 3), of x, y and yaw, or (6, 6)" : "(6, 6), of x, y, z and rotations about x, y, z"));
  PoseCovariance<D> covariance;
  const bool is_part = array.shape(0) != kSize;
  for (int i = 0; i < kSize; ++i)
    for (int j = 0; j < kSize; ++j) {
      const int row = is_part ? kPlanar.at(static_cast<std::size_t>(i)) : i;
      const int column = is_part ? kPlanar.at(static_cast<std::size_t>(j)) : j;
      covariance(i, j) = array.at(row, column);
    }
  return covariance;
}

template <int D>
py::object widened(const BeamArrays& beams, const DoubleArray& array, const SensorOptions& options,
                   const double* pose) {
  std::optional<Pose<D>> in_map;
  if (pose != nullptr) in_map = pose_of<D>(pose);
  const Eigen::ArrayXd sigma = sigma_with<D>(covariance_of<D>(array), beams.pointers().view<D>(), options,
                                             in_map ? &*in_map : nullptr);
  if (sigma.size() == 0) return beams.range_sigma;  // A pose that is sure.
  return DoubleArray(sigma.size(), sigma.data());
}

}  // namespace

py::object with_pose_covariance(const BeamArrays& beams, const py::object& covariance, int dim,
                                const SensorOptions& sensor, const double* pose) {
  if (covariance.is_none()) return beams.range_sigma;
  const DoubleArray array = as_doubles(covariance, "pose_covariance");
  if (dim == 2) return widened<2>(beams, array, sensor, pose);
  if (dim == 3) return widened<3>(beams, array, sensor, pose);
  throw py::value_error("pose_covariance: the map has dim = " + std::to_string(dim) + ", must be 2 or 3");
}

void bind_pose_sigma(py::module_& module) {
  const SensorOptions defaults;
  module.def(
      "pose_range_sigma",
      [](const py::object& points, const py::object& origin, const py::object& covariance,
         const py::object& own, double sigma, double quadratic) {
        const DoubleArray any = as_doubles(points, "points");
        const int dim = any.ndim() == 2 && any.shape(1) == 3 ? 3 : 2;
        MapOptions sensor;
        sensor.range_sigma = sigma;
        sensor.range_sigma_quadratic = quadratic;
        sensor.validate();
        return with_pose_covariance(BeamArrays(points, origin, py::none(), dim, own), covariance, dim,
                                    sensor);
      },
      "points"_a, "origin"_a, "pose_covariance"_a, py::kw_only(), "own"_a = py::none(),
      "range_sigma"_a = defaults.range_sigma, "range_sigma_quadratic"_a = defaults.range_sigma_quadratic,
      doc::pose_range_sigma);
}

}  // namespace ndtree::python
