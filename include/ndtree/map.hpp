// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The map alone: options, scans, insertion, state and probability at points. Takes less time to
/// compile than all of ndtree.hpp, with the library ndtree::prebuilt half of it.
#pragma once

#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/version.hpp"
