// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Products that no compiler fuses with a sum (FMA): they are rounded first, whatever processor it is.
#pragma once

#include "ndtree/core/simd.hpp"

namespace ndtree {

/// x itself, hiding from the compiler that it was a product. It may else make `a * b + c` one step that
/// rounds once (FMA), and GCC does so unasked for every processor that has such a step: ARM's, and those of
/// `-march=native`. Then cells would not meet at their borders to the last bit, loops of eight would not tell
/// what loops of one do, and a map would depend on the machine. So where a map depends on a sum, it is
/// `unfused(a * b) + c`, which costs no instruction. No flag of the compiler is needed.
template <class Real>
[[nodiscard]] NDTREE_ALWAYS_INLINE Real unfused(Real x) {
#if defined(__x86_64__) && defined(__FMA__) && defined(__GNUC__)
  __asm__("" : "+x"(x));
#elif defined(__aarch64__) && \
    defined(__GNUC__)  // GCC's __builtin_assoc_barrier() is lost in vectors of loops.
  __asm__("" : "+w"(x));
#endif
  return x;
}

}  // namespace ndtree
