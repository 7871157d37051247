// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps of random scans, for what does not depend on how they came about.
#pragma once

#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "random.hpp"

namespace ndtree::test {

/// Scans of 60 beams, each twice, within 2 m of the origin.
template <class Map>
Map random_map(Random& random, const MapOptions& options, int scans) {
  constexpr int D = Map::kDim;
  Map map(options);
  for (; scans > 0; --scans) {
    Scan<D> scan;
    scan.origins.resize(D, 1);
    for (int a = 0; a < D; ++a) scan.origins(a, 0) = random.uniform(-1.0, 1.0);
    scan.endpoints.resize(D, 60);
    for (Eigen::Index i = 0; i < 60; ++i)
      for (int a = 0; a < D; ++a) scan.endpoints(a, i) = random.uniform(-2.0, 2.0);
    map.insert(scan);
    map.insert(scan);
  }
  return map;
}

}  // namespace ndtree::test
