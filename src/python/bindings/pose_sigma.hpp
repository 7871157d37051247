// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Scans whose poses are unsure: what their beams' standard deviations become.
#pragma once

#include <pybind11/pybind11.h>

#include "ndtree/cell/sensor_model.hpp"
#include "numpy.hpp"

namespace ndtree::python {

/// The `range_sigma` of a scan with what its pose's covariance adds; as it was where that is None or zero.
/// @param covariance None; (3, 3) of x, y, yaw in 2-D; (6, 6) of x, y, z and rotations about x, y, z in both:
///   along and about the axes of the map.
/// @param pose of the sensor in the map, see pose_of(), if beams are in its frame: rotations are then about
///   it, else about the origins of beams.
/// @throws ValueError or TypeError naming what is wrong.
[[nodiscard]] py::object with_pose_covariance(const BeamArrays& beams, const py::object& covariance, int dim,
                                              const SensorOptions& sensor, const double* pose = nullptr);

}  // namespace ndtree::python
