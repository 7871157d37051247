// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How far apart what threads write must lie.
#pragma once

#include <cstddef>

namespace ndtree {

/// Alignment of objects that one thread writes, each its own, while others work with their neighbours. Caches
/// hand memory from core to core in lines of 64 bytes, and fetch two at a time: if two threads write to the
/// same, each waits for the other, and the farther their cores are from each other, the longer.
inline constexpr std::size_t kCacheLines = 128;

}  // namespace ndtree
