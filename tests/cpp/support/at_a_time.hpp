// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "ndtree/core/simd.hpp"

namespace ndtree::test {

/// Sets how many numbers loops take at a time, as long as it lives.
class AtATime {
 public:
  explicit AtATime(int numbers) { Simd::limit(numbers); }
  AtATime(const AtATime&) = delete;
  AtATime& operator=(const AtATime&) = delete;
  ~AtATime() { Simd::limit(Simd::kWidest); }
};

}  // namespace ndtree::test
