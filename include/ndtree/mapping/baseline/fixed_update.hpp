// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Integration of a scan into cells of one size: each beam steps from cell to cell.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/baseline/beam_evidence.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/insert/task_lists.hpp"
#include "ndtree/mapping/insert/tasks.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// What one worker does of a scan: the beams of a task into its cells of the smallest size.
///
/// Strategy: a task is a node whose smallest cells a table of pointers finds at once, so that a step along a
/// beam costs one division and no descent; they stay in the cache while its beams are integrated.
/// Invariants: a cell gets its beams in the order of the scan, so that the map is that of BeamUpdate, to the
/// last bit, whatever the number of workers. Nodes are divided only on the way to a cell that is updated.
template <class Tree, class Sensor>
class FixedWalk {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  using NodeType = typename Tree::NodeType;
  using Ref = typename Tree::Ref;

 public:
  /// @param task_level of nodes that are tasks. @param undo log of the nodes that this worker changes, or
  ///   null.
  FixedWalk(Tree& tree, typename Tree::Arena& arena, const Measurements<D, Sensor>& measurements,
            const BeamEvidence<Sensor>& evidence, int task_level, UndoLog<Tree>* undo,
            const ChangeWindow<D>& window)
      : tree_(tree),
        arena_(arena),
        measurements_(measurements),
        evidence_(evidence),
        task_level_(task_level),
        undo_(undo),
        window_(window) {}

  [[nodiscard]] const UpdateCounters& counters() const { return counters_; }
  /// The beam of the scan that has number 0 in lists.
  void begin_at(Eigen::Index first) { first_ = first; }

  /// Bins beams [first, last) by the tasks that they cross. The tree stays as it is.
  void bin(std::size_t first, std::size_t last, std::size_t part, TaskLists<D>& lists) {
    std::vector<std::uint32_t> beams;
    beams.reserve(last - first);
    for (std::size_t i = first; i < last; ++i)
      if (beam(i).outcome != BeamOutcome::invalid) beams.push_back(static_cast<std::uint32_t>(i));
    bin(tree_.root().index, beams, part, lists);
  }
  /// Bins the beams of an inner node by its children that they cross. The tree stays as it is.
  void subdivide(const CellIndex<D>& node, const TaskList<D>& beams, TaskLists<D>& lists) {
    const std::vector<std::uint32_t> of_node(beams.list.beam, beams.list.beam + beams.list.size);
    for_each_child(node, of_node, [&](const CellIndex<D>& child, std::vector<std::uint32_t>& of_child) {
      add(child, of_child, beams.part, lists);
    });
  }
  /// Integrates a task's beams. @returns whether a cell changed.
  bool integrate(const Ref& task, const TaskCell<D>& beams) {
    const std::int64_t across = tree_.geometry().edge(task.index.level) / N;  // Nodes with cells, on an axis.
    siblings_.assign(static_cast<std::size_t>(integer_power(std::max<std::int64_t>(across, 1), D)), nullptr);
    const std::uint64_t before = counters_.updates;
    for (const TaskList<D>* list = beams.first; list != beams.last; ++list)
      for (std::size_t i = 0; i < list->list.size; ++i)
        for_each_cell(task.index, list->list.beam[i], [&](const Lattice<D>& cell, double enter, double exit) {
          evidence_.update(this->cell(task, across, cell), enter, exit);
          ++counters_.updates;
        });
    return counters_.updates != before;
  }
  /// Finishes a subdivided node after its children.
  bool finalize(const Ref& ref, bool changed) {
    if (changed) ref.node->set_summary_word(0);  // Until the scan is done.
    return changed;
  }

 private:
  [[nodiscard]] Beam<D> beam(std::size_t number) const {
    return measurements_.beam(first_ + static_cast<Eigen::Index>(number));
  }
  [[nodiscard]] double sigma(std::size_t number, const Beam<D>& beam) const {
    return measurements_.sigma(first_ + static_cast<Eigen::Index>(number), beam);
  }
  /// Calls `visit(lower, t_enter, t_exit)` for each smallest cell in a node that a beam crosses and that may
  /// change; evidence_ is then that of the beam.
  template <class Visit>
  void for_each_cell(const CellIndex<D>& node, std::size_t number, const Visit& visit) {
    const Beam<D> beam = this->beam(number);
    evidence_.begin(beam, sigma(number, beam));
    const BeamStepper<N, D> stepper(tree_.geometry(), beam.origin, beam.displacement);
    double t_enter = 0.0;
    double t_exit = evidence_.t_end();
    if (!stepper.clip(node, t_enter, t_exit)) return;
    std::size_t cells = 0;
    const bool is_everywhere = window_.box == nullptr && window_.cubes == nullptr;
    stepper.for_each_cell(node, 1, t_enter, t_exit, [&](const Lattice<D>& lower, double enter, double exit) {
      ++cells;
      if (is_everywhere || window_.overlaps({lower, tree_.geometry().finest_level()}, 1))
        visit(lower, enter, exit);
    });
    pace_.spend(cells);
  }

  /// A smallest cell of a task. @param across nodes with cells on an axis of the task's.
  [[nodiscard]] NDTREE_ALWAYS_INLINE auto& cell(const Ref& task, std::int64_t across,
                                                const Lattice<D>& lower) {
    std::size_t place = 0;
    std::size_t number = 0;
    for (std::size_t a = D; a-- > 0;) {
      const auto offset = static_cast<std::uint64_t>(lower[a] - task.index.lower[a]);
      place = place * static_cast<std::uint64_t>(across) + offset / N;
      number = number * N + offset % N;
    }
    NodeType*& siblings = siblings_[place];
    if (siblings == nullptr) siblings = find_siblings(task, lower);
    return siblings[number].cell();
  }
  /// The first of the cells beside a cell of a task; nodes that are missing are added.
  NDTREE_NEVER_INLINE NodeType* find_siblings(const Ref& task, const Lattice<D>& lower) {
    Ref ref = task;
    while (ref.index.level > tree_.geometry().finest_level() + 1) {
      enter(*ref.node);
      ref = tree_.child_towards(ref, lower);
    }
    if (ref.index.level == tree_.geometry().finest_level()) return ref.node;  // The task is one cell.
    enter(*ref.node);
    return tree_.children(*ref.node);
  }
  /// Before something below a node changes.
  void enter(NodeType& node) {
    if (node.is_leaf()) {
      tree_.split_node(node, {}, arena_);
    } else {
      before_change_below(tree_, node, undo_);
    }
  }

  void bin(const CellIndex<D>& node, std::vector<std::uint32_t>& beams, std::size_t part,
           TaskLists<D>& lists) {
    if (beams.empty() || !window_.overlaps(node, tree_.geometry().edge(node.level))) return;
    if (node.level <= task_level_) {
      add(node, beams, part, lists);
      return;
    }
    for_each_child(node, beams, [&](const CellIndex<D>& child, std::vector<std::uint32_t>& of_child) {
      bin(child, of_child, part, lists);
    });
  }
  /// Adds a list of the beams that may change a cell of a node: with a window not all of them do, and the
  /// tree must not be divided where nothing changes.
  void add(const CellIndex<D>& node, std::vector<std::uint32_t>& beams, std::size_t part,
           TaskLists<D>& lists) {
    if (window_.box != nullptr || window_.cubes != nullptr)
      beams.erase(std::remove_if(beams.begin(), beams.end(),
                                 [&](std::uint32_t number) {
                                   bool changes = false;
                                   for_each_cell(node, number,
                                                 [&](const Lattice<D>&, double, double) { changes = true; });
                                   return !changes;
                                 }),
                  beams.end());
    if (!beams.empty()) lists.add(node.lower, part, {beams.data(), beams.size()});
  }
  /// Calls `visit(child, beams)` for each child of a node that some of its beams cross, with these.
  template <class Visit>
  void for_each_child(const CellIndex<D>& node, const std::vector<std::uint32_t>& beams, const Visit& visit) {
    pace_.spend(Tree::kNumChildren + 4 * beams.size());
    std::vector<std::vector<std::uint32_t>> of_children(Tree::kNumChildren);
    for (const std::uint32_t number : beams) {
      const Beam<D> beam = this->beam(number);
      const BeamStepper<N, D> stepper(tree_.geometry(), beam.origin, beam.displacement);
      double t_enter = 0.0;
      double t_exit = Sensor::t_end(beam, sigma(number, beam));
      if (!stepper.clip(node, t_enter, t_exit)) continue;
      stepper.for_each_child(node, t_enter, t_exit, [&](int child, const CellIndex<D>&, double, double) {
        of_children[static_cast<std::size_t>(child)].push_back(number);
        return true;
      });
    }
    for (int c = 0; c < Tree::kNumChildren; ++c) {
      auto& of_child = of_children[static_cast<std::size_t>(c)];
      if (!of_child.empty()) visit(tree_.geometry().child(node, child_offset<N, D>(c)), of_child);
      of_child = {};
    }
  }

  Tree& tree_;
  typename Tree::Arena& arena_;
  const Measurements<D, Sensor>& measurements_;
  BeamEvidence<Sensor> evidence_;
  int task_level_;
  Eigen::Index first_ = 0;
  UndoLog<Tree>* undo_;
  ChangeWindow<D> window_;
  std::vector<NodeType*> siblings_;  // Of a task: the first of each N^D cells; null: not looked for yet.
  UpdateCounters counters_;
  Pace pace_;
};

/// Integrates a scan into cells of one size, by tasks (see ScanTasks and FixedWalk): the map that
/// BeamUpdate makes beam by beam, to the last bit. For n beams of k cells: O(n k), parallel.
template <class Tree, class Refinement, class Sensor>
class FixedUpdate {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  using Walk = FixedWalk<Tree, Sensor>;

 public:
  /// @param most_crossings of beams and tasks that lists may hold at a time, 4 bytes each.
  FixedUpdate(Tree& tree, const Refinement&, const Sensor& sensor, const MapOptions& options,
              UpdateCounters& counters, double most_crossings = 0x1p24)
      : tree_(tree), evidence_(sensor, options), counters_(counters), most_crossings_(most_crossings) {}

  /// Number of workers that a scan of this many beams is worth.
  [[nodiscard]] static std::size_t most_workers(Eigen::Index beams) {
    constexpr Eigen::Index kBeamsOfWorker = 100;
    return static_cast<std::size_t>(std::max<Eigen::Index>(1, beams / kBeamsOfWorker));
  }

  /// Surveys a scan, which must stay where it is until finish() is done; the tree stays as it is.
  /// @throws as survey_exactly().
  ScanSurvey<D> survey(const Measurements<D, Sensor>& measurements, Workers& workers) {
    measurements_ = &measurements;
    std::vector<ScanSurvey<D>> parts(workers.count());
    workers.for_each_task(parts.size(), [&](std::size_t, std::size_t p) {
      parts[p] = survey_exactly(tree_.geometry(), measurements, measurements.part(p, parts.size()));
    });
    for (std::size_t p = 1; p < parts.size(); ++p) parts.front().add(parts[p]);
    longest_ = (parts.front().reach.upper - parts.front().reach.lower).norm();
    return parts.front();
  }

  /// Integrates all beams. @pre the tree contains what the survey reaches.
  /// @param undo gets logs of changed nodes, see ScanWalks; null: nothing is logged.
  /// @param window outside which no cell changes.
  void finish(Workers& workers, std::vector<UndoLog<Tree>>* undo = nullptr,
              const ChangeWindow<D>& window = {}) {
    const int level = task_level();
    ScanWalks<Tree, Walk> walks(tree_, workers, undo, [&](auto& all, auto& arena, UndoLog<Tree>* log) {
      all.emplace_back(tree_, arena, *measurements_, evidence_, level, log, window);
    });
    for (Eigen::Index first = 0, last; first < measurements_->scan().size; first = last) {
      last = end_of_piece(first, level);
      for (Walk& walk : walks.all()) walk.begin_at(first);
      walks.run(level, static_cast<std::size_t>(last - first));
    }
    walks.add_to(counters_);
  }

 private:
  /// Of tasks: the largest nodes whose table of siblings stays in the first cache.
  [[nodiscard]] int task_level() const {
    constexpr std::int64_t kMostSiblings = 1024;
    const auto fits = [&](int level) {
      return integer_power(tree_.geometry().edge(level) / N, D) <= kMostSiblings;
    };
    int level = tree_.geometry().finest_level();
    while (level < tree_.root().index.level && fits(level + 1)) ++level;
    return level;
  }
  /// Up to where beams from the first one on have lists that surely fit in memory, at least one.
  [[nodiscard]] Eigen::Index end_of_piece(Eigen::Index first, int level) const {
    const double cell_size = tree_.geometry().cell_size(level);
    const auto fit = [&](double beams, double metres) {
      return most_crossings<D>(beams, metres, cell_size) < most_crossings_;
    };
    const Eigen::Index size = measurements_->scan().size;
    const auto left = static_cast<double>(size - first);
    if (fit(left, left * longest_)) return size;
    double beams = 0.0;
    double metres = 0.0;
    Eigen::Index last = first;
    for (; last < size && fit(beams, metres); ++last) {
      const Beam<D> beam = measurements_->beam(last);
      if (beam.outcome == BeamOutcome::invalid) continue;
      beams += 1.0;
      metres += Sensor::t_end(beam, measurements_->sigma(last, beam)) * beam.range;
    }
    return last;
  }

  Tree& tree_;
  BeamEvidence<Sensor> evidence_;
  UpdateCounters& counters_;
  const Measurements<D, Sensor>* measurements_ = nullptr;
  double most_crossings_;
  double longest_ = 0.0;  // No beam is longer, to the end of its noise [m].
};

}  // namespace ndtree
