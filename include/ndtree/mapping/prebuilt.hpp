// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The usual maps, whose making and insertion the library ndtree::prebuilt holds compiled: what takes a
/// translation unit longest. Its users have NDTREE_PREBUILT defined, for which occupancy_map.hpp includes
/// this.
#pragma once

#include <optional>

#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/occupancy_map.hpp"

/// What is compiled for one shape: here, or, with `extern` as the prefix, elsewhere.
#define NDTREE_PREBUILT_MAPS(prefix, N, D)                            \
  prefix template NDTREE_INSERT_OF(AdaptiveMap, N, D);                \
  prefix template NDTREE_INSERT_OF(PaperMap, N, D);                   \
  prefix template NDTREE_INSERT_OF(FixedMap, N, D);                   \
  prefix template AdaptiveMap<N, D>::OccupancyMap(const MapOptions&); \
  prefix template PaperMap<N, D>::OccupancyMap(const MapOptions&);    \
  prefix template FixedMap<N, D>::OccupancyMap(const MapOptions&)
#define NDTREE_INSERT_OF(Map, N, D)                                                                \
  InsertReport Map<N, D>::integrate(const ScanView<D>&, double, int, const std::optional<Box<D>>&, \
                                    const CubeSet<D>*, Box<D>*)

namespace ndtree {

NDTREE_PREBUILT_MAPS(extern, 2, 2);
NDTREE_PREBUILT_MAPS(extern, 3, 2);
NDTREE_PREBUILT_MAPS(extern, 4, 2);
NDTREE_PREBUILT_MAPS(extern, 2, 3);
NDTREE_PREBUILT_MAPS(extern, 3, 3);
NDTREE_PREBUILT_MAPS(extern, 4, 3);
NDTREE_PREBUILT_MAPS(extern, 2, 4);

}  // namespace ndtree
