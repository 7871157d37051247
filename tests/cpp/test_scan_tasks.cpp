// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/scan/tasks.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree::test::test_scan_tasks {
namespace {

using Tree = NdTree<2, 3, EvidenceCell>;
using Ref = Tree::Ref;

/// What was asked of walks, by all threads.
struct Record {
  std::mutex mutex;
  std::size_t made = 0;  // Crossings in lists of children.
  std::vector<CellIndex<3>> run;
  std::vector<CellIndex<3>> closed;
  bool closed_before_run = false;
};

/// A bundle of beams, each of which crosses four children of every node.
struct BundleWalk {
  Tree* tree;
  Record* record;

  void bring(std::size_t first, std::size_t last, std::size_t part, CoarseLists<3>& lists) const {
    ListStack stack;
    BeamList list = stack.allocate(last - first + BeamList::kSlack);
    for (std::size_t i = first; i < last; ++i) list.beam[i - first] = static_cast<std::uint32_t>(i);
    list.size = last - first;
    list.close();
    lists.add(tree->root().index.lower, part, list);
  }
  void open(const CellIndex<3>& node, const CoarseList<3>& beams, CoarseLists<3>& lists) const {
    for (int c = 0; c < 4; ++c)
      lists.add(tree->geometry().child(node, child_offset<2, 3>(c)).lower, beams.part, beams.list);
    const std::lock_guard<std::mutex> lock(record->mutex);
    record->made += 4 * beams.list.size;
  }
  [[nodiscard]] bool run(const Ref& ref, const CoarseCell<3>& beams) const {
    std::uint32_t next = 0;  // All beams, in their order.
    for (const CoarseList<3>* part = beams.first; part != beams.last; ++part)
      for (std::size_t i = 0; i < part->list.size; ++i) EXPECT_EQ(part->list.beam[i], next++);
    EXPECT_EQ(next, beams.size);
    const std::lock_guard<std::mutex> lock(record->mutex);
    record->closed_before_run = record->closed_before_run || !record->closed.empty();
    record->run.push_back(ref.index);
    return true;
  }
  [[nodiscard]] bool close(const Ref& ref, bool changed) const {
    EXPECT_TRUE(changed);
    record->closed.push_back(ref.index);
    return changed;
  }
};

void split_all(Tree& tree, const Ref& ref, int levels) {
  if (levels == 0) return;
  tree.split_node(*ref.node);
  for (int c = 0; c < Tree::kNumChildren; ++c) split_all(tree, tree.child(ref, c), levels - 1);
}

void run_bundle(std::size_t beams, std::size_t threads, std::size_t most_to_open, Record& record) {
  Tree tree(0.1, 5);
  split_all(tree, tree.root(), 4);
  Workers workers(threads);
  std::vector<BundleWalk> walks(threads, BundleWalk{&tree, &record});
  ScanTasks<Tree, BundleWalk>(tree, tree.main_arena(), tree.root().index.level, workers, walks, nullptr,
                              most_to_open)
      .run(beams);
}

TEST(ScanTasks, OpensCellsUntilThereIsWorkForAll) {
  Record record;
  run_bundle(1000, 4, 1000000, record);
  EXPECT_EQ(record.run.size(), 16u);  // Not 256: then all would do the same work, but more of it.
  EXPECT_EQ(record.made, 1000u * (4 + 16));
  ASSERT_EQ(record.closed.size(), 5u);  // The root after its children.
  EXPECT_FALSE(record.closed_before_run);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(record.closed[i].level, record.closed.back().level - 1);
}

TEST(ScanTasks, OpensNothingForFewBeams) {
  for (const std::size_t beams : {2u, 150u}) {
    Record record;
    run_bundle(beams, 4, 1000000, record);
    EXPECT_EQ(record.run.size(), 1u);
    EXPECT_TRUE(record.closed.empty());
  }
}

TEST(ScanTasks, MakesNoMoreListsThanItMay) {
  for (const std::size_t most : {0u, 3999u, 4000u, 19999u, 20000u}) {
    Record record;
    run_bundle(1000, 4, most, record);
    EXPECT_LE(record.made, most);
    EXPECT_EQ(record.run.size(), most < 4000 ? 1u : most < 20000 ? 4u : 16u);
  }
}

}  // namespace
}  // namespace ndtree::test::test_scan_tasks
