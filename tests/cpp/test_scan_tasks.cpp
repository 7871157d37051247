// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <numeric>
#include <set>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/task_lists.hpp"
#include "ndtree/mapping/insert/tasks.hpp"
#include "ndtree/tree/nd_tree.hpp"
#include "random.hpp"

namespace ndtree::test::test_scan_tasks {
namespace {

using Tree = NdTree<2, 3, EvidenceCell>;
using Ref = Tree::Ref;

/// Calls of walks, by all threads.
struct Record {
  std::mutex mutex;
  std::size_t written = 0;  // Crossings that subdivide() wrote into lists.
  std::vector<CellIndex<3>> run;
  std::vector<CellIndex<3>> finalized;
  bool finalized_before_run = false;
};

/// A walk of beams that all cross the same four children of every node.
struct BundleWalk {
  Tree* tree;
  Record* record;

  void bin(std::size_t first, std::size_t last, std::size_t part, TaskLists<3>& lists) const {
    ListStack stack;
    BeamList list = stack.allocate(last - first + BeamList::kSlack);
    for (std::size_t i = first; i < last; ++i) list.beam[i - first] = static_cast<std::uint32_t>(i);
    list.size = last - first;
    list.pad();
    lists.add(tree->root().index.lower, part, list);
  }
  void subdivide(const CellIndex<3>& node, const TaskList<3>& beams, TaskLists<3>& lists) const {
    for (int c = 0; c < 4; ++c)
      lists.add(tree->geometry().child(node, child_offset<2, 3>(c)).lower, beams.part, beams.list);
    const std::lock_guard<std::mutex> lock(record->mutex);
    record->written += 4 * beams.list.size;
  }
  [[nodiscard]] bool integrate(const Ref& ref, const TaskCell<3>& beams) const {
    std::uint32_t next = 0;  // The beams come in ascending order, none is missing.
    for (const TaskList<3>* part = beams.first; part != beams.last; ++part)
      for (std::size_t i = 0; i < part->list.size; ++i) EXPECT_EQ(part->list.beam[i], next++);
    EXPECT_EQ(next, beams.size);
    const std::lock_guard<std::mutex> lock(record->mutex);
    record->finalized_before_run = record->finalized_before_run || !record->finalized.empty();
    record->run.push_back(ref.index);
    return true;
  }
  [[nodiscard]] bool finalize(const Ref& ref, bool changed) const {
    EXPECT_TRUE(changed);
    record->finalized.push_back(ref.index);
    return changed;
  }
};

void split_all(Tree& tree, const Ref& ref, int levels) {
  if (levels == 0) return;
  tree.split_node(*ref.node);
  for (int c = 0; c < Tree::kNumChildren; ++c) split_all(tree, tree.child(ref, c), levels - 1);
}

void run_bundle(std::size_t beams, std::size_t threads, std::size_t most_to_subdivide, Record& record) {
  Tree tree(0.1, 5);
  split_all(tree, tree.root(), 4);
  Workers workers(threads);
  std::vector<BundleWalk> walks(threads, BundleWalk{&tree, &record});
  ScanTasks<Tree, BundleWalk>(tree, tree.main_arena(), tree.root().index.level, workers, walks, nullptr,
                              most_to_subdivide)
      .run(beams);
}

TEST(ScanTasks, SubdividesUntilThereIsWorkForAll) {
  Record record;
  run_bundle(1000, 4, 1000000, record);
  EXPECT_EQ(record.run.size(), 16u);  // Not 256, which would be more work without more parallelism.
  EXPECT_EQ(record.written, 1000u * (4 + 16));
  ASSERT_EQ(record.finalized.size(), 5u);  // Four children, then the root.
  EXPECT_FALSE(record.finalized_before_run);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(record.finalized[i].level, record.finalized.back().level - 1);
}

TEST(ScanTasks, DoesNotSubdivideForFewBeams) {
  for (const std::size_t beams : {2u, 150u}) {
    Record record;
    run_bundle(beams, 4, 1000000, record);
    EXPECT_EQ(record.run.size(), 1u);
    EXPECT_TRUE(record.finalized.empty());
  }
}

TEST(ScanTasks, WritesNoMoreCrossingsThanItMay) {
  for (const std::size_t most : {0u, 3999u, 4000u, 19999u, 20000u}) {
    Record record;
    run_bundle(1000, 4, most, record);
    EXPECT_LE(record.written, most);
    EXPECT_EQ(record.run.size(), most < 4000 ? 1u : most < 20000 ? 4u : 16u);
  }
}

/// Large tasks come first, by size; small ones stay in the order of the tree, with about as much work for
/// each worker.
TEST(TaskOrder, DividesSmallTasksEvenly) {
  Random random(420);
  std::size_t large = 0;
  std::size_t small = 0;
  for (int i = 0; i < 400; ++i) {
    std::vector<std::size_t> sizes(static_cast<std::size_t>(random.integer(0, i % 2 == 0 ? 10 : 2000)));
    for (std::size_t& size : sizes)
      size = static_cast<std::size_t>(std::pow(10.0, random.uniform(0.0, i % 3 == 0 ? 5.0 : 1.0)));
    const auto workers = static_cast<std::size_t>(random.integer(1, 9));
    const TaskOrder order(sizes, workers);
    const std::size_t all = std::accumulate(sizes.begin(), sizes.end(), std::size_t{0});
    const auto size = [&](std::size_t index) { return sizes[order.tasks[index]]; };
    ASSERT_EQ(order.ends.size(), std::clamp<std::size_t>(sizes.size(), 1, workers));
    ASSERT_EQ(order.ends.back(), sizes.size());
    ASSERT_LE(order.num_large, order.ends.front());
    ASSERT_TRUE(std::is_sorted(order.ends.begin(), order.ends.end()));
    std::vector<std::uint32_t> tasks = order.tasks;
    std::sort(tasks.begin(), tasks.end());
    for (std::size_t t = 0; t < sizes.size(); ++t) ASSERT_EQ(tasks[t], t) << "each once";
    const double most_of_small = static_cast<double>(all) / (64.0 * static_cast<double>(order.ends.size()));
    std::size_t all_small = 0;
    for (std::size_t t = 0; t < sizes.size(); ++t) {
      if (t < order.num_large) {
        EXPECT_GT(size(t) + 1, most_of_small);
        if (t > 0) {
          EXPECT_LE(size(t), size(t - 1));
        }
        continue;
      }
      EXPECT_LE(size(t), most_of_small);
      if (t > order.num_large) {
        EXPECT_LT(order.tasks[t - 1], order.tasks[t]);
      }
      all_small += size(t);
    }
    for (std::size_t worker = 0, t = order.num_large; worker < order.ends.size(); ++worker) {
      double of_worker = 0.0;
      for (; t < order.ends[worker]; ++t) of_worker += static_cast<double>(size(t));
      EXPECT_NEAR(of_worker, static_cast<double>(all_small) / static_cast<double>(order.ends.size()),
                  most_of_small + 1.0);
    }
    large += order.num_large;
    small += sizes.size() - order.num_large;
    if (::testing::Test::HasFailure()) return;
  }
  EXPECT_GT(large, 1000u);
  EXPECT_GT(small, 10000u);
}

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
}  // namespace ndtree::test::test_scan_tasks
