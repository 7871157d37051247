// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What the compiler is told about inlining.
#pragma once

#if defined(__GNUC__) || defined(__clang__)
/// Of small functions on the way of every beam and cell, whose calls cost as much as what they do.
#define NDTREE_ALWAYS_INLINE inline __attribute__((always_inline))
/// Of large functions with several callers, and of recursions, whose copies are much code and no faster.
#define NDTREE_NEVER_INLINE __attribute__((noinline))
#else
#define NDTREE_ALWAYS_INLINE inline
#define NDTREE_NEVER_INLINE
#endif
