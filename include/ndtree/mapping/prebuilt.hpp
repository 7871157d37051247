// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The usual maps, whose insertion the library ndtree::prebuilt holds compiled: what takes a translation unit
/// longest. Who links it sees NDTREE_PREBUILT, for which occupancy_map.hpp includes this.
#pragma once

#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/occupancy_map.hpp"

/// What is compiled for one shape: here, or, with `extern` as the prefix, elsewhere.
#define NDTREE_PREBUILT_MAPS(prefix, N, D)                                                 \
  prefix template InsertReport AdaptiveMap<N, D>::insert(const ScanView<D>&, double, int); \
  prefix template InsertReport PaperMap<N, D>::insert(const ScanView<D>&, double, int);    \
  prefix template InsertReport FixedMap<N, D>::insert(const ScanView<D>&, double, int)

namespace ndtree {

NDTREE_PREBUILT_MAPS(extern, 2, 2);
NDTREE_PREBUILT_MAPS(extern, 3, 2);
NDTREE_PREBUILT_MAPS(extern, 4, 2);
NDTREE_PREBUILT_MAPS(extern, 2, 3);
NDTREE_PREBUILT_MAPS(extern, 3, 3);
NDTREE_PREBUILT_MAPS(extern, 4, 3);
NDTREE_PREBUILT_MAPS(extern, 2, 4);

}  // namespace ndtree
