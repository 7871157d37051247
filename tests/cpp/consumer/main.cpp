// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps a wall two metres ahead and asks for it: all that another project needs to use ndtree.
#include <iostream>

#include "ndtree/ndtree.hpp"

int main() {
  ndtree::MapOptions options;
  options.min_cell_size = 0.05;
  options.max_cell_size = 1.6;
  options.range_sigma = 0.03;
  ndtree::AdaptiveMap<2, 3> map(options);

  ndtree::Scan<3> scan;
  scan.origins = Eigen::Vector3d::Zero();
  scan.endpoints.resize(3, 41);
  for (int i = 0; i < 41; ++i) scan.endpoints.col(i) = Eigen::Vector3d(2.02, 0.02 * (i - 20), 0.01);

  for (int repeat = 0; repeat < 10; ++repeat) {
    const ndtree::InsertReport report = map.insert(scan);
    static_cast<void>(report);  // how many beams returned, did not, or were invalid
  }
  std::cout << "ndtree " NDTREE_VERSION ": " << map.stats().observed_leaves << " observed leaves\n";

  const bool wall = ndtree::state(map, Eigen::Vector3d(2.02, 0.0, 0.01)) == ndtree::CellState::occupied;
  const bool path = ndtree::state(map, Eigen::Vector3d(1.5, 0.0, 0.005)) == ndtree::CellState::free;
  const bool behind = ndtree::state(map, Eigen::Vector3d(9.0, 0.0, 0.0)) == ndtree::CellState::unknown;
  return wall && path && behind ? 0 : 1;
}
