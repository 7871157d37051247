// SPDX-License-Identifier: BSD-3-Clause
// Memory of lists of beams; what is in them is tested by the maps that they make.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <set>

#include "ndtree/mapping/insert/beam_lists.hpp"

namespace ndtree::test::test_scan_lists {
namespace {

TEST(ListStack, GivesBackWhatWasAllocatedLast) {
  ListStack stack;
  const BeamList first = stack.allocate(10);
  const ListStack::Mark mark = stack.mark();
  std::set<const std::uint32_t*> places{first.beam};
  for (const std::size_t n : {100u, 16000u, 100000u, 5u}) {  // In blocks of their own, if need be.
    const BeamList list = stack.allocate(n);
    list.beam[n - 1] = 7;
    EXPECT_TRUE(places.insert(list.beam).second);
  }
  stack.release(mark);
  const BeamList again = stack.allocate(100);
  EXPECT_EQ(again.beam, first.beam + 10);
  EXPECT_EQ(stack.allocate(10).beam, first.beam + 110);
}

TEST(ListStack, FreesFromAListOnIfItIsItsOwn) {
  ListStack stack;
  ListStack other;
  other.free_from(stack.allocate(10));
  const BeamList first = stack.allocate(50);
  const BeamList second = stack.allocate(60);
  stack.free_from(other.allocate(10));
  EXPECT_EQ(stack.allocate(10).beam, second.beam + 60);
  stack.free_from(second);
  EXPECT_EQ(stack.allocate(10).beam, second.beam);
  stack.free_from(first);
  EXPECT_EQ(stack.allocate(10).beam, first.beam);
}

}  // namespace
}  // namespace ndtree::test::test_scan_lists
