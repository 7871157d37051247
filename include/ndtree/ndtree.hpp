// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// All of ndtree but the log readers and simulated worlds.
#pragma once

#include "ndtree/evaluation/claims.hpp"
#include "ndtree/evaluation/held_out_truth.hpp"
#include "ndtree/io/dense_grid.hpp"
#include "ndtree/io/layer_file.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/io/map_server.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "ndtree/io/ply.hpp"
#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/query/distance_field.hpp"
#include "ndtree/query/frontiers.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/nearest_boxes.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "ndtree/query/region.hpp"
#include "ndtree/query/transform.hpp"
#include "ndtree/version.hpp"
