// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The walk of a scan as tasks, which threads execute at the same time.
#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <deque>
#include <numeric>
#include <utility>
#include <vector>

#include "ndtree/core/inline.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/insert/task_lists.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// Arenas of nodes, one for each worker; the tree takes them back when this ends, also by an exception.
template <class Tree>
class Arenas {
 public:
  struct alignas(kCacheLines) Lent {
    typename Tree::Arena arena;
  };

  Arenas(Tree& tree, std::size_t count) : tree_(tree), arenas_(count) {
    for (Lent& lent : arenas_) tree_.lend(lent.arena);
  }
  Arenas(const Arenas&) = delete;
  Arenas& operator=(const Arenas&) = delete;
  ~Arenas() {
    for (Lent& lent : arenas_) tree_.absorb(lent.arena);
  }
  [[nodiscard]] std::vector<Lent>& all() { return arenas_; }

 private:
  Tree& tree_;
  std::vector<Lent> arenas_;
};

/// Divides the walk of a scan into tasks, and executes them by all workers.
///
/// Strategy: workers bin parts of the beams by cell of the task level, which ScanUpdate (level 0) and
/// FixedUpdate choose; each cell with beams is a task. A task with so large a part of all beams that other
/// workers would wait for it is subdivided: workers partition its lists, part by part, and its children are
/// tasks. Tasks run the largest first (TaskOrder). Subdivided nodes are finalized at last, children before
/// parents, by one thread.
/// Invariants: tasks are disjoint subtrees; above the task level nothing is merged; a task's lists hold each
/// of its beams once, in ascending order, so that the map does not depend on the number of workers or parts.
/// Cost: beyond that of the walk, copies of the tasks' lists, and O(t log t) for t tasks.
/// Memory: 4 bytes for each crossing of a beam and a task's cell; subdivision adds at most 4 bytes for each
/// of `most_to_subdivide` crossings.
template <class Tree, class Walk>
class ScanTasks {
  static constexpr int D = Tree::kDim;
  using Ref = typename Tree::Ref;

 public:
  /// @param arena from which this thread takes nodes. @param task_level of cells that are tasks.
  /// @param walks one for each worker. @param undo log of the nodes that this thread changes, or null.
  /// @param most_to_subdivide crossings of beams and children that subdivision may write into lists, 4 bytes
  ///   each.
  ScanTasks(Tree& tree, typename Tree::Arena& arena, int task_level, Workers& workers,
            std::vector<Walk>& walks, UndoLog<Tree>* undo,
            std::size_t most_to_subdivide = std::size_t{1} << 24)
      : tree_(tree),
        arena_(arena),
        task_level_(task_level),
        workers_(workers),
        walks_(walks),
        undo_(undo),
        most_to_subdivide_(most_to_subdivide),
        lists_(walks.size()) {}

  /// Updates the tree by all beams. @param beams number of beams, at least 1.
  void run(std::size_t beams) {
    bin(beams);
    subdivide_large();
    std::vector<std::size_t> sizes;
    sizes.reserve(tasks_.size());
    for (const Task& task : tasks_) sizes.push_back(task.beams.size);
    const TaskOrder order(sizes, workers_.count());
    workers_.for_each_task(order.num_large, order.ends, [&](std::size_t worker, std::size_t i) {
      Task& task = tasks_[order.tasks[i]];
      task.changed = walks_[worker].integrate(task.ref, task.beams);
    });
    for (const Task& task : tasks_)
      if (task.subdivided != kNone) subdivided_[task.subdivided].changed |= task.changed;
    for (std::size_t i = subdivided_.size(); i-- > 0;) {
      const Subdivided& node = subdivided_[i];
      const bool changed = walks_.front().finalize(node.ref, node.changed);
      if (node.parent != kNone) subdivided_[node.parent].changed |= changed;
    }
  }

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  struct Task {
    Ref ref;
    TaskCell<D> beams;
    std::size_t subdivided;  // Index of its parent in subdivided_; kNone: a cell of the task level.
    bool changed;
  };
  struct Subdivided {
    Ref ref;
    std::size_t parent;  // As Task::subdivided.
    bool changed;
  };

  /// The lists of one part of the beams in one node, in the order of the tree.
  struct Range {
    const TaskList<D>* first;
    const TaskList<D>* last;
  };

  /// Bins all beams by cell of the task level, and makes a task of each.
  void bin(std::size_t beams) {
    // Parts take unequal times: up to two for each worker, unless their lists would be short.
    constexpr std::size_t kBeamsOfPart = 4096;
    const std::size_t workers = workers_.count();
    const std::size_t parts = std::min(std::clamp(beams / kBeamsOfPart, workers, 2 * workers), beams);
    std::vector<std::vector<TaskList<D>>> binned(parts);
    workers_.for_each_task(parts, [&](std::size_t worker, std::size_t part) {
      walks_[worker].bin(beams * part / parts, beams * (part + 1) / parts, part, lists_[worker]);
      lists_[worker].move_to(binned[part]);
    });
    std::vector<Range> ranges;
    std::size_t count = 0;
    for (const std::vector<TaskList<D>>& of_part : binned) {
      ranges.push_back({of_part.data(), of_part.data() + of_part.size()});
      count += of_part.size();
    }
    joined_.emplace_back().reserve(count);  // Tasks point into it: it must not move.
    if (count > 0) add_tasks(tree_.root(), ranges);
  }
  /// Makes a task of each cell of the lists below a node; adds nodes that are missing.
  /// @param parts lists of each part in this node; at least one list.
  void add_tasks(const Ref& ref, const std::vector<Range>& parts) {
    if (ref.index.level == task_level_) {
      tasks_.push_back({ref, joined(ref.index.lower, parts), kNone, false});
      return;
    }
    if (ref.is_leaf())
      tree_.split_node(*ref.node, {}, arena_);
    else
      before_change_below(tree_, *ref.node, undo_);
    std::vector<Range> in_child = parts;
    for (Range& range : in_child) range.last = range.first;
    std::size_t left = 0;  // Lists of children that are still to come.
    for (const Range& part : parts) left += static_cast<std::size_t>(part.last - part.first);
    for (int c = 0; c < Tree::kNumChildren && left > 0; ++c) {
      const Ref child = tree_.child(ref, c);
      const std::size_t before = left;
      for (std::size_t p = 0; p < parts.size(); ++p) {
        Range& range = in_child[p];
        range.first = range.last;
        while (range.last != parts[p].last && tree_.geometry().contains(child.index, range.last->cell))
          ++range.last;
        left -= static_cast<std::size_t>(range.last - range.first);
      }
      if (left < before) add_tasks(child, in_child);
    }
    assert(left == 0);
  }
  /// Appends the lists of all parts for one cell to the last of joined_.
  [[nodiscard]] TaskCell<D> joined(const Lattice<D>& cell, const std::vector<Range>& parts) {
    std::vector<TaskList<D>>& lists = joined_.back();
    const TaskList<D>* const first = lists.data() + lists.size();
    std::size_t size = 0;
    for (const Range& part : parts)
      for (const TaskList<D>* list = part.first; list != part.last; ++list) {
        lists.push_back(*list);
        size += list->list.size;
      }
    return {cell, first, lists.data() + lists.size(), size};
  }

  /// The cells of all lists that workers made since the last call, sorted.
  [[nodiscard]] std::vector<TaskCell<D>> cells_of_lists() {
    std::vector<TaskList<D>>& lists = joined_.emplace_back();
    for (TaskLists<D>& of_worker : lists_) of_worker.move_to(lists);
    return join(lists);
  }

  /// Subdivides tasks with more than a fraction of all crossings, again and again, up to most_to_subdivide_.
  void subdivide_large() {
    constexpr std::size_t kFewestBeams = 200;  // Of a task that is worth it.
    constexpr std::size_t kTasksOfWorker = 2;
    constexpr std::size_t kMostChildren = 1 + D * (Tree::kBranching - 1);  // Children that one beam crosses.
    std::size_t all = crossings();
    for (std::size_t made = 0;;) {
      const std::size_t large = std::max(kFewestBeams, all / (kTasksOfWorker * workers_.count()));
      std::size_t to_subdivide = 0;
      for (const Task& task : tasks_)
        if (is_to_subdivide(task, large)) to_subdivide += task.beams.size;
      if (to_subdivide == 0 || made + kMostChildren * to_subdivide > most_to_subdivide_) return;
      subdivide(large);
      const std::size_t others = all - to_subdivide;
      all = crossings();
      made += all - others;
    }
  }
  /// True if a task has children, and more beams than `large`.
  static bool is_to_subdivide(const Task& task, std::size_t large) {
    return task.beams.size > large && !task.ref.is_leaf();
  }
  /// Number of crossings of a beam and a task's cell.
  [[nodiscard]] std::size_t crossings() const {
    return std::accumulate(tasks_.begin(), tasks_.end(), std::size_t{0},
                           [](std::size_t sum, const Task& task) { return sum + task.beams.size; });
  }
  /// Replaces tasks with more beams than `large` by tasks of their nodes' children.
  void subdivide(std::size_t large) {
    std::vector<std::pair<const Task*, const TaskList<D>*>> parts;
    for (const Task& task : tasks_)
      if (is_to_subdivide(task, large))
        for (const TaskList<D>* part = task.beams.first; part != task.beams.last; ++part)
          parts.emplace_back(&task, part);
    workers_.for_each_task(parts.size(), [&](std::size_t worker, std::size_t p) {
      walks_[worker].subdivide(parts[p].first->ref.index, *parts[p].second, lists_[worker]);
    });
    const std::vector<TaskCell<D>> cells = cells_of_lists();
    std::vector<Task> tasks;
    tasks.reserve(tasks_.size() + cells.size());
    for (const Task& task : tasks_) {
      if (!is_to_subdivide(task, large)) {
        tasks.push_back(task);
        continue;
      }
      if (undo_ != nullptr && task.ref.node->summary_word() != 0) undo_->keep(tree_, *task.ref.node);
      for (int c = 0; c < Tree::kNumChildren; ++c) {
        const Ref child = tree_.child(task.ref, c);
        const auto cell =
            std::lower_bound(cells.begin(), cells.end(), child.index.lower,
                             [](const TaskCell<D>& a, const Lattice<D>& b) { return a.lower < b; });
        if (cell != cells.end() && cell->lower == child.index.lower)
          tasks.push_back({child, *cell, subdivided_.size(), false});
      }
      subdivided_.push_back({task.ref, task.subdivided, false});
    }
    tasks_ = std::move(tasks);
  }

  Tree& tree_;
  typename Tree::Arena& arena_;
  int task_level_;
  Workers& workers_;
  std::vector<Walk>& walks_;
  UndoLog<Tree>* undo_;
  std::size_t most_to_subdivide_;
  std::vector<Task> tasks_;
  std::vector<Subdivided> subdivided_;           // A node comes before those below it.
  std::vector<TaskLists<D>> lists_;              // Memory of the tasks' lists, one for each worker.
  std::deque<std::vector<TaskList<D>>> joined_;  // Lists sorted by cell, to which tasks point.
};

/// A walk for each worker, with an arena and an undo log of its own, and the tasks that they execute.
template <class Tree, class Walk>
class ScanWalks {
 public:
  /// @param undo is resized to 1 + workers.count() logs of changed nodes: of this thread alone, and of each
  ///   worker; null: nothing is logged.
  /// @param make `(walks, arena, log)` appends a walk; `log` is null if nothing is logged.
  template <class Make>
  ScanWalks(Tree& tree, Workers& workers, std::vector<UndoLog<Tree>>* undo, const Make& make)
      : tree_(tree), workers_(workers), arenas_(tree, workers.count()) {
    if (undo != nullptr) undo->resize(1 + workers.count());
    const auto log = [&](std::size_t number) { return undo == nullptr ? nullptr : undo->data() + number; };
    undo_ = log(0);
    walks_.reserve(arenas_.all().size());  // They stay where they are made.
    for (auto& lent : arenas_.all()) make(walks_, lent.arena, log(1 + walks_.size()));
  }
  [[nodiscard]] std::vector<Walk>& all() { return walks_; }
  /// Updates the tree by beams [0, beams) of the walks. @param level of cells that are tasks.
  void run(int level, std::size_t beams) {
    ScanTasks<Tree, Walk>(tree_, arenas_.all().front().arena, level, workers_, walks_, undo_).run(beams);
  }
  /// Adds what all walks did.
  void add_to(UpdateCounters& counters) const {
    for (const Walk& walk : walks_) counters.add(walk.counters());
  }

 private:
  Tree& tree_;
  Workers& workers_;
  Arenas<Tree> arenas_;
  UndoLog<Tree>* undo_ = nullptr;
  std::vector<Walk> walks_;
};

}  // namespace ndtree
