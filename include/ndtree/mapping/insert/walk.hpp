// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The descent of a whole scan through the tree: every node partitions its beams among its children, leaves
/// are updated or split, siblings merge on the way back.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <optional>
#include <type_traits>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/evidence_summary.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/inline.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/beam_sources.hpp"
#include "ndtree/mapping/insert/child_initialiser.hpp"
#include "ndtree/mapping/insert/coverage.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/leaf_action.hpp"
#include "ndtree/mapping/insert/leaf_coverage.hpp"
#include "ndtree/mapping/insert/leaf_evidence.hpp"
#include "ndtree/mapping/insert/list_partition.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/partition.hpp"
#include "ndtree/mapping/insert/sampling.hpp"
#include "ndtree/mapping/insert/task_lists.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// Integrates lists of beams into subtrees; one for each thread, see ScanUpdate.
///
/// Strategy. A node's list of beams is partitioned among its children, down to the leaves. At most eight
/// beams become a ray packet, which keeps distances and sets of rays instead of lists. A leaf adds up the
/// evidence of the beams that it samples and is updated, or splits. Then it passes on its list, not only its
/// sample (without beams that no leaf below can sample), and each child samples that again. On the way back
/// siblings merge, or their parent's summary is updated.
///
/// Where to read: update_children() integrates beams into a node's children, whatever their source. For a
/// leaf it goes on with
///   update_leaf()
///     -> evidence() of the source (beam_sources.hpp)
///     -> update_unless_split() -> EvidenceRefinement::action(), whose split criterion is splits();
///        if the leaf is not updated: split_or_judge() -> split() -> update_children().
///
/// What writes a cell:
/// - EvidenceModel::update(), with a leaf's evidence: nearly always;
/// - EvidenceModel::update_without_split(), where a split is predicted to re-merge, or its children did;
/// - EvidenceModel::update_passed(), where all beams passed an occupied smallest cell;
/// - EvidenceModel::update_partly_seen(), where too little of a cell was seen; set_covered(), which stores
///   whether all was;
/// - EvidenceRefinement::keep_partial(), if partial_probability is set;
/// - split(), which puts a leaf back whose children re-merged;
/// - ChildrenInitialiser, in split_and_descend(), and EvidenceMergeRule, in merge_children();
/// - UndoLog, if a scan fails.
///
/// Invariants, and the test that notices when one is broken (tests/cpp):
/// - A list holds ascending beam numbers and, but for width 1, BeamList::kSlack valid ones behind its end:
///   vector loops read there. Memory of lists is released in the opposite order of its allocation.
///   (test_scan_update; in debug builds unwritten entries hold a number that no beam has)
/// - A plane has one distance (float) on a beam, wherever it is computed: nodes, children and packets have
///   equal borders to the last bit. Products are rounded before they are added, never contracted.
///   (test_scan_update: widths 1, 8 and 16, equal maps for lists and packets)
/// - Evidence is a sum of integers: neither the order of beams nor of threads matters. (test_scan_update:
///   permuted scans, any number of threads)
/// - A node drops only beams that no leaf below it samples. (test_scan_update: the flat oracle has all beams)
/// - A leaf may split before all its beams have been added up, since more beams never revoke
///   EvidenceRefinement::certainly_splits(). (test_leaf_action)
///   The early stop comes before EvidenceModel::limit(), which leaves scans with hits as they are.
/// - Beams that all clearly pass have the same effect as PassedEvidence and as ScanEvidence.
///   (test_leaf_action: the decision; test_scan_update: the cell)
/// - A saturated subtree that all beams clearly pass stays as it is, bit for bit.
///   (test_scan_update, test_summary)
/// - partition() with `replaces` uses up the memory of a list: one that is needed afterwards, as by a leaf
///   that splits, is partitioned with `replaces` = false. All samples use `sample_`, which the next leaf
///   overwrites. (test_scan_update)
/// - A summary of 0 is stale: it is computed before it is used. (test_summary)
/// - A node's block of children is kept in the undo log before one of them changes for the first time in a
///   scan. (test_limits, alone/test_scarce_memory)
/// - Outside the window no cell changes, and in it each becomes what it would without a window. (test_adopt)
/// - Above the coarsest level nothing merges. (check_invariants() of the map)
/// - With partial_probability, a smallest cell that holds something thin keeps that probability, and occupied
///   siblings stay apart that would split again. (test_scan_update, worlds/test_thin_things,
///   worlds/test_passing_beams)
///
/// Cost: O(beams that cross a node) for each node with beams, plus O(N^D) for its children.
template <class Tree, class Refinement, class Sensor>
class alignas(kCacheLines) ScanWalk {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  static constexpr int kNumChildren = Tree::kNumChildren;
  using Partition = ChildPartition<N, D>;
  using Lists = typename Partition::Lists;
  using Planes = typename Partition::Planes;
  using Sampling = NodeSampling<D>;
  using ChildFractions = typename BeamSampling<N, D>::Children;
  using Children = NodeChildren<Tree>;

 public:
  using Ref = typename Tree::Ref;

  /// @param arena of the tree, for this thread alone. @param undo log of what it changes, or null.
  /// @param window nodes of the coarsest level that do not overlap it stay as they are, with all below them.
  ScanWalk(Tree& tree, typename Tree::Arena& arena, const Refinement& refinement, const Sensor& sensor,
           const ScanBeams<D>& beams, UndoLog<Tree>* undo, const ChangeWindow<D>& window = {})
      : tree_(tree),
        arena_(arena),
        undo_(undo),
        window_(window),
        refinement_(refinement),
        beams_(beams),
        partition_(tree.geometry(), beams),
        evidence_(tree.geometry(), beams, refinement.model, sensor),
        coverage_(beams, partition_, refinement.coverage, refinement.model.miss_evidence(),
                  sensor.cone_width(1.0f)),
        sampling_(tree.geometry(), beams, refinement.model),
        list_partition_(partition_, beams, sampling_),
        initialiser_(tree.geometry(), refinement.model, beams),
        summary_(refinement.model),
        finest_level_(beams.finest_level()),
        coarsest_level_(Refinement::coarsest_level(tree.geometry().finest_level())),
        packet_may_exceed_limit_(refinement.model.may_limit(kPacketSize)) {}

  [[nodiscard]] const UpdateCounters& counters() const { return counters_; }

  /// Integrates all beams into the whole tree.
  void run() {
    const BeamList list = beams_from(0, beams_.size());
    if (!list.empty()) integrate(tree_.root(), list);
  }
  /// Bins beams [first, last) by the cells of the coarsest level that they cross. The tree stays as it is.
  void bin(std::size_t first, std::size_t last, std::size_t part, TaskLists<D>& lists) {
    const ListScope scope(stack_);
    const BeamList list = beams_from(first, last);
    if (!list.empty()) bin(tree_.root().index, list, {}, part, lists);
  }
  /// Bins the beams of an inner node by its children that they cross. The tree stays as it is.
  void subdivide(const CellIndex<D>& node, const TaskList<D>& beams, TaskLists<D>& lists) {
    for_each_child(
        node, beams.list, sampling_.of_node(node, beams.list, {}),
        [&](const CellIndex<D>& child, const BeamList& list) { lists.add(child.lower, beams.part, list); });
  }
  // Of the functions below, integrate() takes a node of any level, leaf or not, and its task or list;
  // descend() an inner node, which it may skip; integrate_below() its children, by a list or a packet.

  /// Integrates a cell's beams into its subtree. @returns whether a cell changed.
  bool integrate(const Ref& ref, const TaskCell<D>& beams) {
    const ListScope scope(stack_);
    const BeamList list = beams.last - beams.first == 1 ? beams.first->list : joined(beams);
    if (list.size <= kFetched) beams_.fetch(list.beam, list.size);
    return integrate(ref, list);
  }
  /// Finishes a subdivided node after its children: merges them or updates its summary.
  /// @param changed whether a child changed. @returns whether the node or a cell below it changed.
  bool finalize(const Ref& ref, bool changed) {
    if (!changed && ref.node->summary_word() != 0) return false;
    return finish_children(ref, summary_(&Children(tree_, ref).node(0)), changed, false);
  }

 private:
  [[nodiscard]] BeamList beams_from(std::size_t first, std::size_t last) {
    BeamList list = stack_.allocate(last - first + BeamList::kSlack);
    list.size = last - first;
    std::iota(list.beam, list.beam + list.size, static_cast<std::uint32_t>(first));
    list.pad();
    return list;
  }
  [[nodiscard]] BeamList joined(const TaskCell<D>& beams) {
    BeamList list = stack_.allocate(beams.size + BeamList::kSlack);
    for (const TaskList<D>* part = beams.first; part != beams.last; ++part) append(part->list, list);
    list.pad();
    return list;
  }
  void bin(const CellIndex<D>& node, const BeamList& list, const Sampling& above, std::size_t part,
           TaskLists<D>& lists) {
    if (!may_change(node)) return;
    if (node.level <= coarsest_level_) {
      lists.add(node.lower, part, list);
      return;
    }
    const Sampling sampling = sampling_.of_node(node, list, above);
    for_each_child(node, list, sampling, [&](const CellIndex<D>& child, const BeamList& beams) {
      bin(child, beams, sampling, part, lists);
    });
  }
  /// Calls `visit(child, list)` for each child that beams of a node cross. The tree stays as it is.
  template <class Visit>
  void for_each_child(const CellIndex<D>& node, const BeamList& list, const Sampling& sampling,
                      const Visit& visit) {
    const ListScope scope(stack_);
    const Lists children = partition(node, partition_.planes_of(node), list, sampling, true);
    for (int c = 0; c < kNumChildren; ++c)
      if (!children.of(c).empty()) visit(tree_.geometry().child(node, child_offset<N, D>(c)), children.of(c));
  }
  /// Whether a node of the coarsest level or above lies in the window.
  [[nodiscard]] bool may_change(const CellIndex<D>& node) const {
    return window_.overlaps(node, tree_.geometry().edge(node.level));
  }

  Lists partition(const CellIndex<D>& node, const Planes& planes, const BeamList& list,
                  const Sampling& sampling, bool replaces) {
    pace_.spend(list.size);
    return list_partition_(node, planes, list, sampling, replaces, stack_);
  }

  // Beam sources, see beam_sources.hpp.
  template <class>
  friend struct ndtree::ListInCell;
  template <class>
  friend struct ndtree::ListSource;
  using ListInCell = ndtree::ListInCell<ScanWalk>;
  using ListSource = ndtree::ListSource<ScanWalk>;
#ifdef NDTREE_HAS_EIGHTS
  template <class>
  friend struct ndtree::PacketSource;
  template <class>
  friend struct ndtree::PacketInCell;
  using PacketSource = ndtree::PacketSource<ScanWalk>;
  using PacketInCell = ndtree::PacketInCell<ScanWalk>;
  using Rays = RayPacket<D, kNumChildren>;
  using OfBeam = typename LeafEvidence<N, D, Sensor>::OfBeam;

  /// Whether a list is short enough for a packet, and the node is of the coarsest level or below.
  [[nodiscard]] bool fits_packet(const Ref& ref, const BeamList& list) const {
    return list.size <= Rays::kMost && ref.index.level <= coarsest_level_ && partition_.goes_by_eights() &&
           evidence_.takes_packets(ref.index.level);
  }
#endif

  /// Integrates a list into a node of any level, a leaf or not. @returns whether a cell changed.
  bool integrate(const ListInCell& beams, const Sampling& above) {
    const Ref& ref = beams.ref();
    if (ref.index.level >= coarsest_level_ && !may_change(ref.index)) return false;
    if (!ref.is_leaf()) return descend(beams, above);
    if (ref.index.level <= coarsest_level_)
      return update_leaf(ref.cell(), ref.index.level, beams, above, nullptr);
    tree_.split_node(*ref.node, {}, arena_);
    return integrate_below(ref, beams.list, sampling_.of_node(ref.index, beams.list, above));
  }
  bool integrate(const Ref& ref, const BeamList& list) {
    return integrate(ListInCell{*this, ref, list, nullptr, 0}, {});
  }
  /// Integrates beams into the subtree of an inner node. A saturated subtree that all of them clearly
  /// pass stays as it is.
  template <class Beams>
  NDTREE_ALWAYS_INLINE bool descend(const Beams& beams, const Sampling& above) {
    if (Summary(beams.node().summary_word()).is_saturated() && beams.all_pass()) return false;
    const Ref inner = beams.ref();
    if (undo_ != nullptr) undo_->keep(tree_, *inner.node);
    return beams.integrate_below(inner, sampling_.of_node(inner.index, beams.crossing(), above));
  }
  /// Integrates a list into the children of a node.
  bool integrate_below(const Ref& node, const BeamList& list, const Sampling& sampling) {
#ifdef NDTREE_HAS_EIGHTS
    if (fits_packet(node, list)) {
      EightBeams<D> beams;
      beams_.look_up(list.beam, beams);
      const PacketSource packet(*this, node, beams);
      partition_(node.index, list, packet.rays);
      return update_children(node, packet, sampling, false);
    }
#endif
    const ListScope scope(stack_);
    const Planes planes = partition_.planes_of(node.index);
    const Lists lists = partition(node.index, planes, list, sampling, true);
    return update_children(node, ListSource{*this, {tree_, node}, planes, lists}, sampling, false);
  }
#ifdef NDTREE_HAS_EIGHTS
  /// Integrates a packet's rays that cross a node into its children.
  bool integrate_below(const Ref& node, const PacketInCell& beams, const Sampling& sampling) {
    const PacketSource packet(*this, node, beams.rays().beams);
    partition_(node.index, beams.rays(), beams.number(), packet.rays);
    return update_children(node, packet, sampling, false);
  }
#endif

  /// Updates the children of a node that beams of a source cross, then the node: it merges, or its summary
  /// changes.
  /// @param was_split the node was a leaf until now. @returns whether a cell changed.
  template <class Source>
  bool update_children(const Ref& node, const Source& source, const Sampling& sampling, bool was_split) {
    pace_.spend(Source::kPace);
    std::optional<ChildFractions> of_children;  // For the first leaf.
    const bool have_fractions = sampling.face != nullptr && !sampling.samples_all;
    bool changed = was_split;
    for (int c = 0; c < kNumChildren; ++c) {
      if (!source.crosses(c)) continue;
      const Ref ref = source.children[c];
      const auto beams = source.in_child(c, ref);
      auto& child = source.children.node(c);
      if constexpr (Source::kMayBeAboveCells) {
        if (node.index.level > coarsest_level_) {
          changed = integrate(beams, sampling) || changed;
          continue;
        }
      }
      if (!child.is_leaf()) {
        changed = descend(beams, sampling) || changed;
      } else {
        if (have_fractions && !of_children) of_children.emplace(sampling_, node.index, *sampling.face);
        changed = update_leaf(child.cell(), node.index.level - 1, beams, sampling,
                              have_fractions ? &*of_children : nullptr) ||
                  changed;
      }
    }
    if (!changed && node.node->summary_word() != 0) return false;
    return finish_children(node, summary_(&source.children.node(0)), changed, was_split);
  }

  /// Integrates beams into a leaf:
  /// 1. Saturated? A saturated leaf that all beams clearly pass stays as it is. If more beams end in it
  ///    than the sensor's errors explain, it samples as many beams as a leaf that is not well observed.
  ///    (`uses_small_sample` is false then.)
  /// 2. Sample all beams, or a fraction of them: those below a bucket of each cube-map face.
  ///    A leaf never observed that one beam passes may split at once, see splits_for_one().
  /// 3. Add up the evidence of the sampled beams, see LeafEvidence, and limit it, see EvidenceModel::limit():
  ///    evidence() of the source.
  /// 4. Split? EvidenceRefinement::action() decides whether the leaf is updated or splits.
  /// @param of_siblings sampling fractions of the children of the leaf's parent; null unless the leaf was
  ///   reached from there, by beams of one cube-map face of which not all are sampled.
  /// @returns whether a cell changed.
  template <class Beams>
  NDTREE_ALWAYS_INLINE bool update_leaf(EvidenceCell& cell, int level, const Beams& beams,
                                        const Sampling& sampling, const ChildFractions* of_siblings) {
    const EvidenceModel& model = refinement_.model;
    bool uses_small_sample = model.uses_small_sample(cell);
    if (uses_small_sample && model.is_saturated(cell)) {
      if (beams.all_pass()) return false;
      uses_small_sample = explains_ends(beams);
    }
    FaceSample<D> sample{nullptr, BeamList::kAll, 1.0f};  // All beams.
    if (of_siblings != nullptr) {
      sample = of_siblings->of(static_cast<std::size_t>(beams.child), uses_small_sample);
    } else if (!sampling.samples_all) {
      const CubeFace<D>* const face = sampling_.only_face_of(beams, sampling);
      if (face == nullptr) return update_by_faces(beams, uses_small_sample);
      sample = sampling_.sample_of(*face, sampling_.of(beams.ref().index, *face, uses_small_sample));
    }
    if (!cell.observed() && beams.is_one() && sample.fraction >= 1.0f && splits_for_one(beams, cell, level))
      return split_or_judge(beams, sample, {}, LeafAction::split, sampling);
    const auto otherwise = [&](const ScanEvidence& scan, LeafAction action) {
      return split_or_judge(beams, sample, scan, action, sampling);
    };
    if constexpr (Beams::kHasPassingSet) {
      if (sample.fraction >= 1.0f && beams.all_pass() && !packet_may_exceed_limit_)
        return update_unless_split(cell, level, beams.passed(), otherwise);
    }
    return update_unless_split(cell, level, beams.evidence(cell, level, sample.end), otherwise);
  }
  /// Updates a leaf, or calls `otherwise(scan, action)` if LeafAction is to split or to judge.
  template <class Scan, class Otherwise>
  NDTREE_ALWAYS_INLINE bool update_unless_split(EvidenceCell& leaf, int level, const Scan& scan,
                                                const Otherwise& otherwise) {
    LeafAction action = refinement_.action(leaf, scan, kChildrenAcross<Tree>, level - finest_level_);
    if constexpr (std::is_same_v<Scan, PassedEvidence>)
      if (action == LeafAction::judge_coverage && leaf.observed() && !coverage_.may_cover(level, scan))
        action = LeafAction::update;
    if (action == LeafAction::update) {
      if (level <= finest_level_ && Refinement::is_contradicted(leaf, scan))
        return otherwise(ScanEvidence::of(scan), LeafAction::judge_passes);
      const bool changed = update(leaf, scan);
      if (level > finest_level_ || !refinement_.partial_log_odds) return changed;
      return refinement_.keep_partial(leaf) || changed;
    }
    const ScanEvidence& all = ScanEvidence::of(scan);  // Extends the lifetime of what of() may return.
    if (action == LeafAction::update_without_split) return update_without_split(leaf, all);
    return (all.beams > 0 || action == LeafAction::judge_ends) && otherwise(all, action);
  }

  // Rare steps. They take copies, so that update_leaf() keeps its values in registers.

  /// Whether judge_coverage() splits a leaf that was never observed for the one beam that passes it.
  template <class Beams>
  [[nodiscard]] NDTREE_NEVER_INLINE bool splits_for_one(const Beams beams, const EvidenceCell cell,
                                                        int level) const {
    return level > finest_level_ && !cell.is_partly_seen() && !packet_may_exceed_limit_ && beams.all_pass() &&
           coverage_.splits_for_one(level, beams.first_beam(), beams.crossing_of_one());
  }

  /// update_leaf() for beams that come through several cube-map faces.
  template <class Beams>
  NDTREE_NEVER_INLINE bool update_by_faces(const Beams beams, bool uses_small_sample) {
    return beams.with_list(
        [&](const BeamList& list) { return update_by_faces(beams.ref(), list, uses_small_sample); });
  }
  bool update_by_faces(const Ref& leaf, const BeamList& list, bool uses_small_sample) {
    const CellCrossings<N, D> crossings(tree_.geometry(), beams_, leaf.index);
    const int level = leaf.index.level;
    ScanEvidence scan;
    sampling_.take(leaf.index, list, uses_small_sample, sample_,
                   [&](const CubeFace<D>&, float, const BeamList& part) {
                     if (may_stop_early(level, part))
                       add_until_split(leaf.cell(), leaf.index, crossings, part, scan);
                     else
                       scan.add(evidence_.of(leaf.index, crossings, part));
                   });
    refinement_.model.limit(scan);
    return update_unless_split(leaf.cell(), level, scan, [&](const ScanEvidence& all, LeafAction action) {
      return split_or_judge(leaf, list, sample_, all, action, {});
    });
  }
  /// split_or_judge() with a list. @param sample of one face; of all beams if its face is null.
  template <class Beams>
  NDTREE_NEVER_INLINE bool split_or_judge(const Beams beams, const FaceSample<D> sample,
                                          const ScanEvidence scan, LeafAction action,
                                          const Sampling sampling) {
    return beams.with_list([&](const BeamList& list) {
      const LeafSample<D>* sampled = &all_;
      Sampling below = sampling;
      if (sample.face != nullptr) {
        sample_.clear();
        sample_.add(sample);
        sampled = &sample_;
        below = {sample.face, false};
      }
      return action == LeafAction::judge_coverage
                 ? judge_coverage(beams.ref(), list, *sampled, scan, below)
                 : split_or_judge(beams.ref(), list, *sampled, scan, action, below);
    });
  }
  /// Whether the sensor's errors explain the beams that end in a saturated leaf.
  template <class Beams>
  [[nodiscard]] NDTREE_NEVER_INLINE bool explains_ends(const Beams beams) {
    return beams.with_list([&](const BeamList& list) {
      return sampling_.ends_per_expected_beam(beams.ref().index, list, sample_) <=
             refinement_.split_test.model().free_until();
    });
  }

  /// Only an occupied cell splits for what passes it.
  [[nodiscard]] static bool needs_resolvable_misses(const EvidenceCell& leaf) {
    return leaf.state() == CellState::occupied;
  }
  /// Whether a list is long enough to test for an early split.
  [[nodiscard]] bool may_stop_early(int level, const BeamList& list) const {
    return list.size > kToSplit && level > finest_level_;
  }
  /// Adds up evidence for a leaf until it is certain to split: then its children integrate the beams.
  NDTREE_NEVER_INLINE void add_until_split(const EvidenceCell& cell, const CellIndex<D>& leaf,
                                           const CellCrossings<N, D>& crossings, const BeamList& list,
                                           ScanEvidence& scan) const {
    for (std::size_t first = 0; first < list.size; first += kToSplit) {
      if (refinement_.certainly_splits(cell, scan)) break;
      scan.add(evidence_.of(leaf, crossings, list.part(first, std::min(first + kToSplit, list.size))));
    }
  }

  bool update_without_split(EvidenceCell& leaf, const ScanEvidence& scan) {
    return counted(refinement_.model.update_without_split(leaf, scan), scan.beams);
  }
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const ScanEvidence& scan) {
    return scan.beams > 0 && counted(refinement_.model.update(cell, scan), scan.beams);
  }
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const PassedEvidence& passed) {
    return counted(refinement_.model.update(cell, passed), passed.misses);
  }
  bool counted(bool changed, std::uint32_t beams) {
    counters_.updates += changed ? beams : 0;
    return changed;
  }

  /// Splits a leaf, or judge_coverage(). If beams ended right before it: splits it if a sampled one grazed
  /// the cells before its border, else goes on as if none had ended there. An occupied smallest cell is
  /// updated, knowing whether the beams passed it clearly.
  bool split_or_judge(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample,
                      const ScanEvidence& scan, LeafAction action, const Sampling& sampling) {
    if (action == LeafAction::split) return split(leaf, list, sample, scan, sampling);
    if (action == LeafAction::judge_coverage) return judge_coverage(leaf, list, sample, scan, sampling);
    if (action == LeafAction::judge_ends) {
      bool grazes = false;
      sample.for_each_part(beams_, list, [&](const BeamList& part) {
        grazes = grazes || evidence_.any_grazes(leaf.index, part);
      });
      if (grazes) return split(leaf, list, sample, scan, sampling);
      ScanEvidence others = scan;
      others.ends_before = 0;
      return update_unless_split(leaf.cell(), leaf.index.level, others,
                                 [&](const ScanEvidence& all, LeafAction other) {
                                   return split_or_judge(leaf, list, sample, all, other, sampling);
                                 });
    }
    Passes passes;  // LeafAction::judge_passes
    sample.for_each_part(beams_, list,
                         [&](const BeamList& part) { evidence_.add_passes(leaf.index, part, passes); });
    const bool changed =
        counted(refinement_.model.update_passed(leaf.cell(), scan, passes.are_clear()), scan.beams);
    return (refinement_.partial_log_odds && refinement_.keep_partial(leaf.cell())) || changed;
  }
  /// Asks CoverageModel::judge() about a leaf that beams have only passed. If it was never observed, it
  /// splits, is updated, or waits for scans that see its other parts; else it is updated, and covered if this
  /// scan saw all of it.
  NDTREE_NEVER_INLINE bool judge_coverage(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample,
                                          const ScanEvidence& scan, const Sampling& sampling) {
    EvidenceCell& cell = leaf.cell();
    const CoverageVerdict seen = coverage_.judge(leaf.index, cell, list, sample,
                                                 refinement_.model.beams_of(cell.free_evidence() + scan.free),
                                                 refinement_.model.remembers_no_more(cell, scan));
    const EvidenceCell before = cell;
    if (!before.observed()) {
      if (seen.shows_more) return split(leaf, list, sample, scan, sampling);
      if (!seen.is_enough)
        return counted(refinement_.model.update_partly_seen(cell, seen.parts, scan), scan.beams);
    }
    (void)refinement_.model.update(cell, scan);
    cell.set_covered(seen.is_covered);
    if (seen.is_covered) {  // But for a smallest cell in depth.
      const auto levels_below = static_cast<std::uint32_t>(leaf.index.level - finest_level_);
      if (cell.known_levels() + 1 < levels_below) cell.set_known_levels(levels_below - 1);
    }
    return counted(cell != before, scan.beams);
  }
  /// Splits a leaf and integrates its beams into the children. If these re-merge, the leaf was observed, and
  /// all evidence is for free space, the merged cell is replaced: the leaf as it was, with
  /// update_without_split(), which of passes alone keeps all evidence, and the streak that all parts have. So
  /// evidence of passes adds up, scan by scan. But where the parts of an occupied leaf have changed, it has.
  bool split(const Ref& leaf, const BeamList& list, const LeafSample<D>& sample, const ScanEvidence& scan,
             const Sampling& sampling) {
    const EvidenceCell parent = leaf.cell();
    const bool changed = split_and_descend(leaf, parent, list, sample, sampling);
    if (!leaf.is_leaf() || !parent.observed() || !scan.is_free_alone()) return changed;
    const EvidenceCell merged = leaf.cell();
    if (parent.state() == CellState::occupied && merged.state() == CellState::free) return changed;
    leaf.cell() = parent;
    (void)refinement_.model.update_without_split(leaf.cell(), scan, ChangeDetection::doubting_scans(merged));
    return changed;
  }
  /// Makes a leaf an inner node, initialises its children and integrates its beams into them.
  bool split_and_descend(const Ref& leaf, const EvidenceCell& parent, const BeamList& list,
                         const LeafSample<D>& sample, const Sampling& sampling) {
    ++counters_.splits;
#ifdef NDTREE_HAS_EIGHTS
    if (fits_packet(leaf, list)) {
      EightBeams<D> beams;
      beams_.look_up(list.beam, beams);
      tree_.split_node(*leaf.node, {}, arena_);
      const PacketSource packet(*this, leaf, beams);
      partition_(leaf.index, list, packet.rays);
      if (EvidenceModel::has_evidence_for_children(parent))
        initialiser_.initialise(parent, leaf.index.level, initialiser_.set_of(sample, list), packet.rays,
                                tree_.children(*leaf.node));
      return update_children(leaf, packet, sampling, true);
    }
#endif
    const ListScope scope(stack_);
    const Planes planes = partition_.planes_of(leaf.index);
    const Lists lists = partition(leaf.index, planes, list, sampling, false);
    tree_.split_node(*leaf.node, {}, arena_);
    if (EvidenceModel::has_evidence_for_children(parent))
      initialiser_.initialise(parent, leaf.index, sample, list, lists, planes, tree_.children(*leaf.node));
    return update_children(leaf, ListSource{*this, {tree_, leaf}, planes, lists}, sampling, true);
  }

  /// Finishes a node after its children were updated: merges them, or writes its summary.
  /// @param all summary of the children.
  NDTREE_ALWAYS_INLINE bool finish_children(const Ref& ref, const SummaryOfSiblings& all, bool changed,
                                            bool was_split) {
    if (changed && ref.index.level <= coarsest_level_ && all.are_leaves && all.summary.is_uniform() &&
        merge_children(ref, was_split))
      return true;
    ref.node->set_summary_word(all.summary.word());
    return changed;
  }
  bool merge_children(const Ref& ref, bool was_split) {
    const auto merged =
        refinement_.merge_rule.of_one_state(tree_.children(*ref.node), kNumChildren, kChildrenAcross<Tree>);
    if (!merged || refinement_.stay_apart(*merged)) return false;
    tree_.merge(*ref.node, *merged, arena_);
    if (was_split)
      --counters_.splits;
    else
      ++counters_.merges;
    return true;
  }

  static constexpr std::size_t kToSplit = 32;    // Beams between two tests for an early split.
  static constexpr std::size_t kFetched = 1024;  // Beams whose rows fit the nearest cache.

  Tree& tree_;
  typename Tree::Arena& arena_;
  UndoLog<Tree>* undo_;
  ChangeWindow<D> window_;
  const Refinement& refinement_;
  const ScanBeams<D>& beams_;
  const ChildPartition<N, D> partition_;
  const LeafEvidence<N, D, Sensor> evidence_;
  const LeafCoverage<N, D> coverage_;
  const BeamSampling<N, D> sampling_;
  ListPartition<N, D> list_partition_;
  const ChildrenInitialiser<Tree> initialiser_;
  const EvidenceSummary<kNumChildren> summary_;
  const int finest_level_;
  const int coarsest_level_;
  const bool packet_may_exceed_limit_;  // EvidenceModel::limit() may reduce the evidence of a packet.
  UpdateCounters counters_;
  Pace pace_;
  ListStack stack_;  // Of the nodes on the path from the root, the deepest last.
  const LeafSample<D> all_;
  LeafSample<D> sample_;  // Of the leaf in update_leaf(), until its children are initialised.
};

}  // namespace ndtree
