// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <utility>

#include "ndtree/tree/child_index.hpp"

namespace ndtree::test::test_child_index {
namespace {

constexpr int kMaxChildren = 4096;

std::int64_t power(int base, int exponent) {
  std::int64_t result = 1;
  while (exponent-- > 0) result *= base;
  return result;
}

/// Largest N with N^D <= 4096, or 64 for D = 1.
constexpr int largest_branching(int dim) {
  for (int n = 64; n > 1; --n) {
    std::int64_t children = 1;
    for (int i = 0; i < dim && children <= kMaxChildren; ++i) children *= n;
    if (children <= kMaxChildren) return n;
  }
  return 1;
}

template <int D>
struct Maps {
  int (*number)(const Offset<D>&);
  Offset<D> (*offset)(int);
};

template <int D, int... I>
constexpr std::array<Maps<D>, sizeof...(I)> all_maps(std::integer_sequence<int, I...>) {
  return {{{&child_number<I + 2, D>, &child_offset<I + 2, D>}...}};
}

/// Checks each child of each N against the sums and quotients of Sec. II-A.
/// @returns how many children were checked.
template <int D>
std::int64_t check_dimension() {
  constexpr int kLargest = largest_branching(D);
  static const auto kMaps = all_maps<D>(std::make_integer_sequence<int, kLargest - 1>{});
  std::int64_t checked = 0;
  for (int n = 2; n <= kLargest; ++n) {
    const Maps<D>& maps = kMaps[static_cast<std::size_t>(n - 2)];
    const std::int64_t children = power(n, D);
    std::int64_t wrong = 0;
    for (int j = 0; j < children; ++j, ++checked) {
      const Offset<D> offset = maps.offset(j);
      std::int64_t sum = 0;
      for (int k = 1; k <= D; ++k) {
        const int i = offset[static_cast<std::size_t>(k - 1)];
        wrong += i != j / power(n, k - 1) % n;
        sum += i * power(n, k - 1);
      }
      wrong += sum != j || maps.number(offset) != j;
    }
    EXPECT_EQ(wrong, 0) << "N = " << n << ", D = " << D;
    EXPECT_LE(children, kMaxChildren);
  }
  EXPECT_TRUE(D == 1 || power(kLargest + 1, D) > kMaxChildren);
  return checked;
}

template <int... I>
std::int64_t check_dimensions(std::integer_sequence<int, I...>) {
  return (check_dimension<I + 1>() + ...);
}

TEST(ChildIndex, MapsAreThePapersAndInverseForEveryShape) {
  EXPECT_EQ(check_dimensions(std::make_integer_sequence<int, 12>{}), 138348);
}

TEST(ChildIndex, ByHand) {
  EXPECT_EQ((child_number<3, 2>({2, 1})), 5);
  EXPECT_EQ((child_number<2, 3>({0, 0, 1})), 4);
  EXPECT_EQ((child_offset<5, 2>(23)), (Offset<2>{3, 4}));
  static_assert(child_number<2, 2>(Offset<2>{1, 0}) == 1, "the first axis counts single children");
}

TEST(ChildIndex, IntegerPower) {
  EXPECT_EQ(integer_power(7, 0), 1);
  EXPECT_EQ(integer_power(3, 4), 81);
  EXPECT_EQ(integer_power(2, 40), 1099511627776);
}

}  // namespace
}  // namespace ndtree::test::test_child_index
