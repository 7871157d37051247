// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The version of ndtree; CMake and the Python build read it from here.
#pragma once

#define NDTREE_VERSION_MAJOR 0
#define NDTREE_VERSION_MINOR 1
#define NDTREE_VERSION_PATCH 0
#define NDTREE_VERSION "0.1.0"
