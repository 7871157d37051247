// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Child number and Euclidean offset of the N^D children of a node, and the diagonal vertices (Sec. II-A,
/// II-B).
#pragma once

#include <array>
#include <cstdint>

#include "ndtree/core/types.hpp"

namespace ndtree {

/// Euclidean index of a child among its siblings, each component in [0, N).
template <int D>
using Offset = std::array<int, std::size_t{D}>;

/// N to the power of `exponent` >= 0.
[[nodiscard]] constexpr std::int64_t integer_power(std::int64_t base, int exponent) {
  std::int64_t result = 1;
  for (int i = 0; i < exponent; ++i) result *= base;
  return result;
}

/// j = sum over k of offset[k] N^k (Sec. II-A, the paper's axes counted from 0).
template <int N, int D>
[[nodiscard]] constexpr int child_number(const Offset<D>& offset) {
  int number = 0;
  for (int k = D - 1; k >= 0; --k) number = number * N + offset[static_cast<std::size_t>(k)];
  return number;
}

/// Inverse of child_number(): offset[k] = floor(j / N^k) mod N (Sec. II-A).
template <int N, int D>
[[nodiscard]] constexpr Offset<D> child_offset(int number) {
  Offset<D> offset{};
  for (auto& component : offset) {
    component = number % N;
    number /= N;
  }
  return offset;
}

/// The i-th child in an order that begins with one of them; for N = 2 it ends with the one opposite.
template <int N, int D>
[[nodiscard]] constexpr int child_from(int first, int i) {
  return N == 2 ? first ^ i : (first + i) % static_cast<int>(integer_power(N, D));
}

}  // namespace ndtree
