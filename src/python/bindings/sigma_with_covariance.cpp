// SPDX-License-Identifier: BSD-3-Clause
#include "sigma_with_covariance.hpp"

namespace ndtree::python {

template <int D>
Eigen::ArrayXd sigma_with(const PoseCovariance<D>& covariance, const ScanView<D>& scan,
                          const SensorOptions& sensor, const Pose<D>* pose) {
  validate<D>(covariance);
  if (covariance.isZero(0.0)) return {};
  const BeamSensorModel model(sensor);
  if (pose == nullptr) return range_sigma(scan, covariance, model);
  const Vector<D> here = Vector<D>::Zero();
  return range_sigma(scan, in_frame<D>(covariance, pose->rotation), model, &here);
}

template Eigen::ArrayXd sigma_with<2>(const PoseCovariance<2>&, const ScanView<2>&, const SensorOptions&,
                                      const Pose<2>*);
template Eigen::ArrayXd sigma_with<3>(const PoseCovariance<3>&, const ScanView<3>&, const SensorOptions&,
                                      const Pose<3>*);

}  // namespace ndtree::python
