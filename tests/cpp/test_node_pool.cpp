// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/tree/node_pool.hpp"
#include "random.hpp"

namespace ndtree::test::test_node_pool {
namespace {

struct WideCell {
  double value = 1.5;
  std::int32_t number = -1;
  friend bool operator==(const WideCell& a, const WideCell& b) {
    return a.value == b.value && a.number == b.number;
  }
};

template <class Cell>
Cell numbered_cell(int number);
template <>
WideCell numbered_cell<WideCell>(int number) {
  return {0.5 * number, number};
}
template <>
OccupancyCell numbered_cell<OccupancyCell>(int number) {
  const float log_odds = 0.25f * static_cast<float>(number);
  std::array<std::uint32_t, 2> words{static_cast<std::uint32_t>(number) & 0x7fffffffu, 0};
  std::memcpy(&words[1], &log_odds, sizeof log_odds);
  return OccupancyCell::from_words(words);
}
template <>
EvidenceCell numbered_cell<EvidenceCell>(int number) {
  const auto word = static_cast<std::uint32_t>(number) & 0x3fffffffu;  // Of log-odds that are a number.
  return EvidenceCell::from_words({word | 0x40000000u, word, ~word});
}
template <>
int numbered_cell<int>(int number) {
  return number;
}

static_assert(sizeof(Node<OccupancyCell>) == 8, "the link shares the cell's memory");
static_assert(sizeof(Node<EvidenceCell>) == 12, "so it does");
static_assert(sizeof(Node<int>) == 12, "link and note stand beside a plain cell");

template <class Cell, int BlockSize>
struct Layout {
  using CellType = Cell;
  static constexpr int kBlockSize = BlockSize;
};
template <class L>
class NodePoolOf : public ::testing::Test {};
using Layouts = ::testing::Types<Layout<OccupancyCell, 4>, Layout<EvidenceCell, 8>, Layout<WideCell, 9>,
                                 Layout<int, 4096>>;
TYPED_TEST_SUITE(NodePoolOf, Layouts);

#define NDTREE_LAYOUT                               \
  using Cell = typename TypeParam::CellType;        \
  constexpr int kBlockSize = TypeParam::kBlockSize; \
  using Pool [[maybe_unused]] = NodePool<Node<Cell>, kBlockSize>

TYPED_TEST(NodePoolOf, NodeIsALeafOrALinkNeverBoth) {
  NDTREE_LAYOUT;
  Node<Cell> node;
  EXPECT_TRUE(node.is_leaf());
  EXPECT_TRUE(node.cell() == Cell{});
  for (const BlockId id : {0u, 1u, 77u, 0x3fffffffu, 0x40000000u, 0x7ffffffeu, 0x7fffffffu}) {
    node.become_inner(id);
    EXPECT_FALSE(node.is_leaf());
    EXPECT_EQ(node.children(), id);
    for (const int number : {0, 5, 0x7fffffff}) {
      node.become_leaf(numbered_cell<Cell>(number));
      EXPECT_TRUE(node.is_leaf());
      EXPECT_TRUE(node.cell() == numbered_cell<Cell>(number));
    }
  }
}

/// Allocates and frees at random beside a list of what each block must hold.
TYPED_TEST(NodePoolOf, BlocksKeepAddressAndContentUntilFreed) {
  NDTREE_LAYOUT;
  Random random(4);
  struct Held {
    Node<Cell>* address;
    int number;
  };
  Pool pool;
  std::map<BlockId, Held> held;
  std::size_t most = 0;
  const int steps = kBlockSize > 1000 ? 60 : 20000;  // Several chunks each.
  for (int step = 0; step < steps; ++step) {
    if (held.empty() || random.chance(0.7)) {
      const BlockId id = pool.allocate();
      ASSERT_LT(id, 0x7fffffffu);
      Node<Cell>* const block = pool.block(id);
      for (int j = 0; j < kBlockSize; ++j) {  // Also where a freed block held something else.
        ASSERT_TRUE(block[j].is_leaf());
        ASSERT_TRUE(block[j].cell() == Cell{});
        block[j].become_leaf(numbered_cell<Cell>(step + j));
      }
      ASSERT_TRUE(held.emplace(id, Held{block, step}).second) << "block " << id << " was given away twice";
      most = std::max(most, held.size());
    } else {
      auto victim = held.lower_bound(static_cast<BlockId>(random.integer(0, static_cast<int>(most))));
      if (victim == held.end()) victim = held.begin();
      pool.free(victim->first);
      held.erase(victim);
    }
    ASSERT_EQ(pool.num_blocks(), held.size());
  }
  EXPECT_LT(held.rbegin()->first, most) << "freed blocks were not used again";
  std::size_t cases = 0;
  for (const auto& [id, content] : held) {
    ASSERT_EQ(pool.block(id), content.address);
    for (int j = 0; j < kBlockSize; ++j, ++cases)
      ASSERT_TRUE(content.address[j].cell() == numbered_cell<Cell>(content.number + j));
  }
  EXPECT_GT(cases, 1000u);
  // What is held is what was needed at most, in chunks of 8 KiB or one block, and their list.
  const std::size_t block_bytes = sizeof(Node<Cell>) * static_cast<std::size_t>(kBlockSize);
  EXPECT_GE(pool.memory_bytes(), most * block_bytes);
  EXPECT_LE(pool.memory_bytes(), most * block_bytes + std::max<std::size_t>(8192, block_bytes) + 4096);
}

TYPED_TEST(NodePoolOf, ThreadsWithArenasDoNotDisturbEachOther) {
  NDTREE_LAYOUT;
  constexpr int kThreads = 4;
  const int steps = kBlockSize > 1000 ? 40 : 4000;
  Pool pool;
  std::vector<BlockId> before;
  for (int i = 0; i < 20; ++i) before.push_back(pool.allocate());
  for (int i = 0; i < 10; ++i) pool.free(before[static_cast<std::size_t>(i)]);
  std::size_t bytes_after_first = 0;
  for (int rounds = 0; rounds < 4; ++rounds) {
    std::vector<typename Pool::Arena> arenas(kThreads);
    std::array<std::vector<BlockId>, kThreads> held;
    std::array<int, kThreads> wrong{};
    for (auto& arena : arenas) pool.lend(arena);
    std::vector<std::thread> threads;
    for (int t = 0; t < kThreads; ++t)
      threads.emplace_back([&, t] {
        const auto k = static_cast<std::size_t>(t);
        Random random(50 + static_cast<std::uint64_t>(t));
        for (int step = 0; step < steps; ++step) {
          if (held[k].empty() || random.chance(0.6)) {
            held[k].push_back(pool.allocate(arenas[k]));
            for (int j = 0; j < kBlockSize; ++j)
              pool.block(held[k].back())[j].become_leaf(numbered_cell<Cell>(1000 * t + j));
          } else {
            const auto last = pool.block(held[k].back());
            for (int j = 0; j < kBlockSize; ++j)
              wrong[k] += !(last[j].cell() == numbered_cell<Cell>(1000 * t + j));
            pool.free(held[k].back(), arenas[k]);
            held[k].pop_back();
          }
        }
      });
    for (std::thread& thread : threads) thread.join();
    for (auto& arena : arenas) pool.absorb(arena);
    std::set<BlockId> all(before.begin() + 10, before.end());
    std::size_t count = all.size();
    for (std::size_t k = 0; k < kThreads; ++k) {
      EXPECT_EQ(wrong[k], 0);
      all.insert(held[k].begin(), held[k].end());
      count += held[k].size();
    }
    EXPECT_EQ(all.size(), count) << "a block was given away twice";
    EXPECT_EQ(pool.num_blocks(), count);
    for (const auto& blocks : held)
      for (const BlockId id : blocks) pool.free(id);
    EXPECT_EQ(pool.num_blocks(), 10u);
    if (rounds == 0) bytes_after_first = pool.memory_bytes();
  }
  // Freed blocks are used again by all threads; a thread's last chunk may be new each time.
  EXPECT_LE(pool.memory_bytes(), 2 * bytes_after_first);
}

TYPED_TEST(NodePoolOf, LastFreedIsUsedFirstAndCostsNoMemory) {
  NDTREE_LAYOUT;
  Pool pool;
  std::vector<BlockId> ids;
  for (int i = 0; i < 10; ++i) ids.push_back(pool.allocate());
  EXPECT_EQ(std::set<BlockId>(ids.begin(), ids.end()).size(), 10u);
  const std::size_t bytes = pool.memory_bytes();
  for (const int i : {2, 7, 4}) pool.free(ids[static_cast<std::size_t>(i)]);
  EXPECT_EQ(pool.num_blocks(), 7u);
  EXPECT_EQ(pool.memory_bytes(), bytes);
  for (const int i : {4, 7, 2}) EXPECT_EQ(pool.allocate(), ids[static_cast<std::size_t>(i)]);
  EXPECT_EQ(pool.memory_bytes(), bytes);
}

TYPED_TEST(NodePoolOf, CopiesAreIndependentAndMovesKeepAddresses) {
  NDTREE_LAYOUT;
  Pool pool;
  const BlockId a = pool.allocate();
  const BlockId b = pool.allocate();
  const BlockId freed = pool.allocate();
  pool.block(a)[1].become_leaf(numbered_cell<Cell>(11));
  pool.block(b)[0].become_inner(a);
  pool.free(freed);

  Pool copy(pool);
  EXPECT_EQ(copy.num_blocks(), 2u);
  EXPECT_NE(copy.block(a), pool.block(a));
  EXPECT_TRUE(copy.block(a)[1].cell() == numbered_cell<Cell>(11));
  EXPECT_EQ(copy.block(b)[0].children(), a);
  copy.block(a)[1].become_leaf(numbered_cell<Cell>(12));
  EXPECT_TRUE(pool.block(a)[1].cell() == numbered_cell<Cell>(11));
  EXPECT_EQ(copy.allocate(), freed);
  EXPECT_EQ(pool.allocate(), freed);
  EXPECT_EQ(copy.num_blocks(), 3u);

  const Node<Cell>* const address = pool.block(a);
  Pool moved(std::move(pool));
  EXPECT_EQ(moved.block(a), address);
  EXPECT_EQ(moved.num_blocks(), 3u);
  moved = copy;
  EXPECT_TRUE(moved.block(a)[1].cell() == numbered_cell<Cell>(12));
  EXPECT_NE(moved.block(a), copy.block(a));
}

TEST(NodePool, EmptyHoldsNothing) {
  const NodePool<Node<int>, 4> pool;
  EXPECT_EQ(pool.num_blocks(), 0u);
  EXPECT_EQ(pool.memory_bytes(), 0u);
}

}  // namespace
}  // namespace ndtree::test::test_node_pool
