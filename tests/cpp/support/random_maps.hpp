// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps of random scans, for what does not depend on how they came about.
#pragma once

#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "random.hpp"

namespace ndtree::test {

/// Beams from one place, within `about` of a centre on each axis, to anywhere within `reach` of it [m].
template <int D>
Scan<D> scan_about(Random& random, double centre, Eigen::Index beams = 40, double about = 1.0,
                   double reach = 2.0) {
  Scan<D> scan;
  scan.origins.resize(D, 1);
  for (int a = 0; a < D; ++a) scan.origins(a, 0) = centre + random.uniform(-about, about);
  scan.endpoints.resize(D, beams);
  for (Eigen::Index i = 0; i < scan.endpoints.size(); ++i)
    scan.endpoints(i) = centre + random.uniform(-reach, reach);
  return scan;
}

/// Scans of 60 beams, each twice, within 2 m of the origin.
template <class Map>
Map random_map(Random& random, const MapOptions& options, int scans) {
  Map map(options);
  for (; scans > 0; --scans) {
    const auto scan = scan_about<Map::kDim>(random, 0.0, 60);
    map.insert(scan);
    map.insert(scan);
  }
  return map;
}

}  // namespace ndtree::test
