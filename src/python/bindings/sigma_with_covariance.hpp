// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a pose's covariance adds to a scan's noise, without anything of Python's: it takes a compiler long.
#pragma once

#include <Eigen/Core>

#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/insert/pose_covariance.hpp"

namespace ndtree::python {

/// The standard deviations of a scan's ranges, with what the pose's covariance adds, see range_sigma(); none
/// if that is zero.
/// @param pose of the sensor in the map if beams are in its frame, or null. @throws as validate().
template <int D>
[[nodiscard]] Eigen::ArrayXd sigma_with(const PoseCovariance<D>& covariance, const ScanView<D>& scan,
                                        const SensorOptions& sensor, const Pose<D>* pose);

}  // namespace ndtree::python
