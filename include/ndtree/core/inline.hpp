// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What the compiler is told about inlining, and how far apart what threads write must lie.
#pragma once

#include <cstddef>

#if defined(__GNUC__) || defined(__clang__)
/// Of small functions on the way of every beam and cell, whose calls cost as much as what they do.
#define NDTREE_ALWAYS_INLINE inline __attribute__((always_inline))
/// Of large functions with several callers, and of recursions, whose copies are much code and no faster.
#define NDTREE_NEVER_INLINE __attribute__((noinline))
#else
#define NDTREE_ALWAYS_INLINE inline
#define NDTREE_NEVER_INLINE
#endif

namespace ndtree {

/// Alignment of objects that one thread writes, each its own, while others work with their neighbours. Caches
/// hand memory from core to core in lines of 64 bytes, and fetch two at a time: if two threads write to the
/// same, each waits for the other, and the farther their cores are from each other, the longer.
inline constexpr std::size_t kCacheLines = 128;

}  // namespace ndtree
