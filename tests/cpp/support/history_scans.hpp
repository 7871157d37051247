// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Scans and poses for maps that follow them.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "options.hpp"
#include "random.hpp"
#include "random_rotation.hpp"  // random_pose(), for those who include this.

namespace ndtree::test {

/// Of maps whose root grows several times around scans some metres apart.
inline MapOptions options_of_history(int branching) {
  MapOptions options = spelled_out_options(0.1, 0.1 * std::pow(branching, branching == 2 ? 4 : 2));
  options.range_sigma = 0.02;
  options.sample_beams = 2.0;
  return options;
}

/// Beams to a wall all around, with some that do not return or are not finite.
template <int D>
Scan<D> random_scan(Random& random) {
  Scan<D> scan;
  const int beams = random.integer(5, 60);
  scan.origins = Vector<D>::Zero();
  scan.endpoints.resize(D, beams);
  scan.returned.resize(beams);
  for (int i = 0; i < beams; ++i) {
    Vector<D> direction;
    for (double& x : direction) x = random.uniform(-1.0, 1.0);
    scan.endpoints.col(i) = direction * (random.uniform(0.5, 4.0) / (direction.norm() + 0.01));
    scan.returned[i] = !random.chance(0.1);
    if (random.chance(0.02)) scan.endpoints(0, i) = std::numeric_limits<double>::quiet_NaN();
  }
  if (random.chance(0.2)) scan.range_sigma = Eigen::ArrayXd::Constant(beams, random.uniform(0.01, 0.05));
  if (random.chance(0.2)) {
    scan.origins.resize(D, beams);
    for (Eigen::Index i = 0; i < scan.origins.size(); ++i) scan.origins(i) = random.uniform(-0.2, 0.2);
  }
  return scan;
}

}  // namespace ndtree::test
