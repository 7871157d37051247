// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How costs grow: with the beams of a scan, with the range over the cell size, with the size of the map.
#pragma once

#include "ndtree/mapping/map_options.hpp"

namespace ndtree {

/// Registers benchmarks of the adaptive map. @param most_leaves of the largest map; ten times fewer each,
/// down to a hundred thousand, for the others.
void add_growth(const MapOptions& options, double most_leaves);

}  // namespace ndtree
