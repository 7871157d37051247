// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The map alone: options, scans, insertion, state and probability at points. Takes half as long to compile
/// as all of ndtree.hpp.
#pragma once

#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/version.hpp"
