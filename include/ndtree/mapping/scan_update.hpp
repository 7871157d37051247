// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A whole scan into the tree at once: every node passes on the beams that cross it to its children.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/coverage.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/scan_index.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

/// The part of an update that goes down the tree: what one thread does. See ScanUpdate.
template <class Tree, class Refinement, class Sensor>
class ScanWalk {
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  static constexpr int kNumChildren = Tree::kNumChildren;
  static constexpr double kNoiseReach = 3.0;  // Standard deviations that noise is taken to explain.
  static constexpr double kSmallCell = 2.0;   // Standard deviations up to which a cell is small.
  static constexpr std::int64_t kFew = 32;    // Beams, or bins of them.
  static constexpr double kMeanChord = mean_chord_of_unit_cube(D);

 public:
  /// Standard deviations; then a cell in the middle of which a beam ends gets probability_max of the
  /// defaults.
  static constexpr double kThinnestSurface = 5.0 / 3.0;

  using Ref = typename Tree::Ref;
  using Index = ScanIndex<D>;
  using View = typename Index::View;

  /// A node whose part of the update does not touch that of any other one, with the views of its beams.
  struct Task {
    Ref ref;
    Box<D> box;
    std::vector<View> views;
    std::vector<Crossing<D>> crossings;
    std::int64_t effort;  ///< The larger, the longer it takes.
  };

  /// @param arena of the tree, for this thread alone.
  ScanWalk(Tree& tree, typename Tree::Arena& arena, const Refinement& refinement, const Sensor& sensor,
           const Index& scan)
      : tree_(tree),
        arena_(arena),
        refinement_(refinement),
        sensor_(sensor),
        index_(scan),
        largest_sigma_(scan.largest_sigma()),
        smallest_size_(tree.geometry().cell_size(tree.geometry().finest_level())),
        finest_level_(tree.geometry().finest_level()),
        coarsest_level_(Refinement::coarsest_level(finest_level_)) {}

  [[nodiscard]] const UpdateCounters& counters() const { return counters_; }

  /// The whole update, or, if `tasks` are asked for, that of nodes above the coarsest level of cells, of
  /// which none are merged; what is left to do is then in the tasks.
  void run(std::vector<Task>* tasks = nullptr) {
    tasks_ = tasks;
    const Ref root = tree_.root();
    const Box<D> box = tree_.box(root.index);
    View view;
    for (std::uint32_t face = 0; face < index_.num_faces(); ++face)
      if (index_.look(face, box, view)) views_.push_back(view);
    descend(root, box, {false, 0, views_.size()});
    views_.clear();
    tasks_ = nullptr;
  }
  void run(const Task& task) {
    const bool is_listed = !task.crossings.empty();
    views_ = task.views;
    crossings_ = task.crossings;
    descend(task.ref, task.box, {is_listed, 0, is_listed ? crossings_.size() : views_.size()});
    views_.clear();
    crossings_.clear();
  }

 private:
  /// The beams that cross a node: those in its views, or, if they are few, one by one.
  struct Part {
    bool is_listed;
    std::size_t first;  // In crossings_ if they are listed, else in views_.
    std::size_t last;
    [[nodiscard]] bool empty() const { return first == last; }
  };

  struct CrossingOfChild {
    Crossing<D> crossing;
    int child;
  };

  /// Calls `visit(crossings, n)` with the part's beams, some at a time, until it returns false.
  template <class Visit>
  void for_each_crossing(const Part& part, const Box<D>& box, Visit&& visit) const {
    if (part.is_listed) {
      visit(crossings_.data() + part.first, part.last - part.first);
    } else {
      for (std::size_t v = part.first; v < part.last; ++v)
        if (!index_.for_each_crossing(views_[v], box, visit)) return;
    }
  }
  /// Which of a scan's beams count in a cell: about so many for each smallest cell beside each other in it.
  struct Sample {
    const Box<D>* cell;
    double beams;
  };
  /// The same with those of a sample.
  template <class Visit>
  void for_each_crossing(const Part& part, const Box<D>& box, const Sample& sample, Visit&& visit) const {
    const auto visit_sampled = [&](const Crossing<D>* crossings, std::size_t n, double share) {
      if (share >= 1.0) return visit(crossings, n);
      for (std::size_t i = 0; i < n; ++i)
        if (static_cast<double>(crossings[i].beam->chance) < share && !visit(crossings + i, std::size_t{1}))
          return false;
      return true;
    };
    if (part.is_listed) {
      std::uint32_t face = Index::kNoFace;
      double share = 1.0;
      for (std::size_t i = part.first; i < part.last; ++i) {
        if (crossings_[i].beam->face != face) {
          face = crossings_[i].beam->face;
          share = share_of(face, sample);
        }
        if (!visit_sampled(&crossings_[i], 1, share)) return;
      }
      return;
    }
    for (std::size_t v = part.first; v < part.last; ++v) {
      const double share = share_of(views_[v].face, sample);
      const auto visit_some = [&](const Crossing<D>* crossings, std::size_t n) {
        return visit_sampled(crossings, n, share);
      };
      if (!index_.for_each_crossing(views_[v], box, visit_some, share)) return;
    }
  }
  [[nodiscard]] double share_of(std::uint32_t face, const Sample& sample) const {
    return sample.beams / index_.expected_beams(face, *sample.cell, smallest_size_);
  }

  /// One by one if they are few.
  Part listed_if_few(const Part& part, const Box<D>& box) {
    if (part.is_listed || num_bins(part) > kFew) return part;
    Part listed{true, crossings_.size(), 0};
    for_each_crossing(part, box, [&](const Crossing<D>* crossings, std::size_t n) {
      for (std::size_t i = 0; i < n; ++i) {  // As exactly as they are then handed down.
        const ScanBeam<D>* const beam = crossings[i].beam;
        Crossing<D> crossing{beam, 0.0, beam->t_end};
        const Vector<D>& origin = index_.origin(beam->face);
        if (clip_to_box<D>(box.lower - origin, box.upper - origin, beam->path, crossing.t_enter,
                           crossing.t_exit))
          crossings_.push_back(crossing);
      }
      return true;
    });
    listed.last = crossings_.size();
    return listed;
  }
  [[nodiscard]] std::int64_t num_bins(const Part& views) const {
    std::int64_t bins = 0;
    for (std::size_t v = views.first; v < views.last; ++v) bins += Index::num_bins(views_[v]);
    return bins;
  }

  /// Hands a node's beams to its children. @param index set for the children that get any.
  std::array<Part, kNumChildren> hand_down(const Ref& ref, const Part& part,
                                           std::array<CellIndex<D>, kNumChildren>& index) {
    std::array<Part, kNumChildren> parts;
    if (!part.is_listed) {
      for (int j = 0; j < kNumChildren; ++j) {
        const auto k = static_cast<std::size_t>(j);
        index[k] = tree_.geometry().child(ref.index, child_offset<N, D>(j));
        const Box<D> box = tree_.box(index[k]);
        parts[k] = {false, views_.size(), 0};
        for (std::size_t i = part.first; i < part.last; ++i) {
          View view;
          if (index_.look(views_[i].face, box, view)) views_.push_back(view);
        }
        parts[k].last = views_.size();
      }
      return parts;
    }
    std::array<std::size_t, kNumChildren + 1> begin{};
    unsorted_.clear();
    for (std::size_t i = part.first; i < part.last; ++i) {
      const ScanBeam<D>* const beam = crossings_[i].beam;
      BeamStepper<N, D>(tree_.geometry(), index_.origin(beam->face), beam->path)
          .for_each_child(ref.index, crossings_[i].t_enter, crossings_[i].t_exit,
                          [&](int child, const CellIndex<D>& child_index, double t_enter, double t_exit) {
                            unsorted_.push_back({{beam, t_enter, t_exit}, child});
                            ++begin[static_cast<std::size_t>(child) + 1];
                            index[static_cast<std::size_t>(child)] = child_index;
                            return true;
                          });
    }
    begin[0] = crossings_.size();
    for (std::size_t j = 1; j < begin.size(); ++j) begin[j] += begin[j - 1];
    crossings_.resize(begin.back());
    std::array<std::size_t, kNumChildren + 1> next = begin;
    for (const CrossingOfChild& of_child : unsorted_)
      crossings_[next[static_cast<std::size_t>(of_child.child)]++] = of_child.crossing;
    for (std::size_t j = 0; j < parts.size(); ++j) parts[j] = {true, begin[j], begin[j + 1]};
    return parts;
  }

  void defer(const Ref& ref, const Box<D>& box, const Part& part) {
    if (part.empty()) return;
    Task task{ref, box, {}, {}, 0};
    if (part.is_listed)
      task.crossings.assign(crossings_.begin() + static_cast<std::ptrdiff_t>(part.first),
                            crossings_.begin() + static_cast<std::ptrdiff_t>(part.last));
    else
      task.views.assign(views_.begin() + static_cast<std::ptrdiff_t>(part.first),
                        views_.begin() + static_cast<std::ptrdiff_t>(part.last));
    task.effort = part.is_listed ? static_cast<std::int64_t>(part.last - part.first) : num_bins(part);
    tasks_->push_back(std::move(task));
  }

  /// @param part not empty. @returns whether a cell changed.
  bool descend(const Ref& ref, const Box<D>& box, const Part& seen) {
    if (tasks_ != nullptr && ref.index.level <= coarsest_level_) {
      defer(ref, box, seen);
      return false;
    }
    const std::size_t views_before = views_.size();
    const std::size_t crossings_before = crossings_.size();
    const bool is_known =
        ref.is_leaf() && ref.index.level <= coarsest_level_ && refinement_.model.is_known(ref.cell());
    const bool changed = update_subtree(ref, box, is_known ? seen : listed_if_few(seen, box));
    views_.resize(views_before);
    crossings_.resize(crossings_before);
    return changed;
  }

  bool update_subtree(const Ref& ref, const Box<D>& box, const Part& part) {
    if (part.empty()) return false;
    const bool is_leaf = ref.is_leaf();
    const bool is_unknown = is_leaf && ref.index.level > coarsest_level_;
    const bool splits = is_leaf && !is_unknown;
    if (is_unknown && !any_crossing(part, box)) return false;
    if (!is_leaf && Summary(ref.node->note()).is_settled() && all_pass(part)) return false;
    EvidenceCell parent;
    std::size_t beams = 0;  // Of the sample.
    std::optional<Sample> sample;
    if (splits) {
      ScanEvidence scan;
      sample = look_into(ref, box, part, scan);
      if (!sample) return false;
      const CoverageVerdict seen = look_at_coverage(ref, box, part, *sample, scan);
      if (!seen.is_enough && !seen.shows_more) return remember(ref.cell(), seen.parts, scan);
      if (ref.index.level == finest_level_ || (seen.is_enough && !refinement_.splits(ref.cell(), scan)))
        return update(ref.cell(), scan);
      parent = ref.cell();
      beams = count(part, box, *sample).all;
      ++counters_.splits;
    }
    if (is_leaf) tree_.split_node(*ref.node, {}, arena_);

    bool changed = splits;
    auto* const children = tree_.children(*ref.node);
    std::array<CellIndex<D>, kNumChildren> index;
    const std::array<Part, kNumChildren> parts = hand_down(ref, part, index);
    for (int j = 0; j < kNumChildren; ++j) {
      const auto k = static_cast<std::size_t>(j);
      if (parts[k].empty()) {
        if (splits)
          children[j].cell() = refinement_.model.inherited(parent, kShareDivisor<Tree>, 0, beams,
                                                           CellParts<N, D>::of_child(j));
        continue;
      }
      const Box<D> child = tree_.box(index[k]);
      if (splits)
        children[j].cell() =
            refinement_.model.inherited(parent, kShareDivisor<Tree>, count(parts[k], child, *sample).passed,
                                        beams, CellParts<N, D>::of_child(j));
      changed = descend(Ref{children + j, index[k]}, child, parts[k]) || changed;
    }

    if (tasks_ != nullptr) {
      ref.node->set_note(0);  // Until they are done.
      return changed;
    }
    const auto merged = changed && ref.index.level <= coarsest_level_
                            ? refinement_.merge_rule(children, kNumChildren, kShareDivisor<Tree>)
                            : std::nullopt;
    if (!merged) {
      if (changed || ref.node->note() == 0)
        summarise(tree_, *ref.node,
                  [this](const EvidenceCell& cell) { return refinement_.is_settled(cell); });
      return changed;
    }
    tree_.merge(*ref.node, *merged, arena_);
    if (splits)
      --counters_.splits;
    else
      ++counters_.merges;
    return true;
  }

  /// Whether enough of a leaf was seen to update it as a whole. Cells that are observed were seen before;
  /// hits speak for themselves; and no cell can be smaller than the smallest.
  [[nodiscard]] CoverageVerdict look_at_coverage(const Ref& leaf, const Box<D>& box, const Part& part,
                                                 const Sample& sample, const ScanEvidence& scan) const {
    const CoverageModel& model = refinement_.coverage;
    const EvidenceCell& cell = leaf.cell();
    if (!model.is_on() || cell.observed() || leaf.index.level == finest_level_ || scan.beams == 0 ||
        scan.hits > 0 || scan.occupied > 0)
      return {0, true, false};
    const std::uint32_t seen_before = cell.is_partly_seen() ? cell.seen_parts() : 0;
    const double size = tree_.geometry().cell_size(leaf.index.level);
    return model.judge(coverage_of(leaf, box, part, sample), seen_before, size / smallest_size_);
  }
  [[nodiscard]] ScanCoverage<N, D> coverage_of(const Ref& leaf, const Box<D>& box, const Part& part,
                                               const Sample& sample) const {
    const double child_size = tree_.geometry().cell_size(leaf.index.level - 1);
    ScanCoverage<N, D> coverage;
    for_each_crossing(part, box, sample, [&](const Crossing<D>* crossing, std::size_t n) {
      const std::uint32_t face = crossing->beam->face;  // Of all of them.
      // Those of a sample stand for those that are not in it, too.
      const double spread = widening(std::min(1.0, share_of(face, sample)));
      for (std::size_t i = 0; i < n; ++i) {
        const ScanBeam<D>& beam = *crossing[i].beam;
        const double depth = index_.depth_of(beam);
        BeamStepper<N, D>(tree_.geometry(), index_.origin(face), beam.path)
            .for_each_child(
                leaf.index, crossing[i].t_enter, std::min(crossing[i].t_exit, 1.0),
                [&](int child, const CellIndex<D>&, double t_enter, double t_exit) {
                  const double middle = 0.5 * (t_enter + t_exit) * depth;
                  const double width = spread * index_.width_of_beam(face, middle, smallest_size_);
                  coverage.add(child, (t_exit - t_enter) * depth / child_size, width / child_size);
                  return true;
                });
      }
      return true;
    });
    return coverage;
  }
  /// How much wider beams get if only a share of them is left.
  [[nodiscard]] static double widening(double share) {
    if constexpr (D < 2) return 1.0;
    if constexpr (D == 2) return 1.0 / share;
    if constexpr (D == 3) return 1.0 / std::sqrt(share);
    return std::pow(share, -1.0 / (D - 1));
  }

  bool remember(EvidenceCell& cell, std::uint32_t parts, const ScanEvidence& scan) {
    const EvidenceCell before = cell;
    refinement_.model.remember(cell, parts, scan);
    if (cell == before) return false;
    counters_.updates += scan.beams;
    return true;
  }

  bool update(EvidenceCell& cell, const ScanEvidence& scan) {
    if (scan.beams == 0) return false;
    const EvidenceCell before = cell;
    refinement_.model.update(cell, scan);
    if (cell == before) return false;
    counters_.updates += scan.beams;
    return true;
  }

  /// Whether a leaf is small beside the noise of some beam.
  [[nodiscard]] bool may_be_small(const Ref& leaf) const {
    return leaf.index.level == finest_level_ ||
           tree_.geometry().cell_size(leaf.index.level) <= kSmallCell * largest_sigma_;
  }
  /// Adds up what the scan says about a leaf that may be updated. @returns the sample of it that counts;
  /// nothing if it would not change the leaf.
  std::optional<Sample> look_into(const Ref& leaf, const Box<D>& box, const Part& part,
                                  ScanEvidence& scan) const {
    const auto& model = refinement_.model;
    const bool is_settled = model.is_settled(leaf.cell());
    const bool is_known = model.is_known(leaf.cell());
    const Freedom freedom = knows_only_free(leaf, box, part, is_settled, is_known);
    if (freedom == Freedom::only_free && is_settled) return std::nullopt;
    const Sample sample{&box, model.sample_beams(is_known && freedom != Freedom::contradicted)};
    add_evidence(leaf, box, part, freedom == Freedom::only_free, sample, scan);
    return sample;
  }

  /// Whether it is certain that all beams of a part pass its node, whatever the size of the cells in it.
  [[nodiscard]] bool all_pass(const Part& part) const {
    const auto first = static_cast<std::ptrdiff_t>(part.first);
    const auto last = static_cast<std::ptrdiff_t>(part.last);
    if (!part.is_listed)
      return std::all_of(views_.begin() + first, views_.begin() + last,
                         [](const View& view) { return view.all_pass; });
    return std::all_of(crossings_.begin() + first, crossings_.begin() + last,
                       [](const Crossing<D>& crossing) {
                         return crossing.t_exit < crossing.beam->t_clearly_free - crossing.beam->t_surface;
                       });
  }

  enum class Freedom {
    only_free,     ///< It is certain that no beam says of anything but free space.
    contradicted,  ///< More beams end in a leaf that knows only free space than the sensor's errors explain.
    unknown        ///< Neither, or it was not worth finding out.
  };
  [[nodiscard]] Freedom knows_only_free(const Ref& leaf, const Box<D>& box, const Part& part, bool is_settled,
                                        bool is_known) const {
    constexpr std::int64_t kMany = 64;
    const bool is_small = may_be_small(leaf);
    if (part.is_listed && !is_settled) return Freedom::unknown;
    if (all_pass(part)) return Freedom::only_free;
    if (!is_settled && (is_small || is_known || num_bins(part) < kMany)) return Freedom::unknown;
    const double blocked = share_blocked(leaf, box, part);
    if (blocked == 0.0 && !is_small) return Freedom::only_free;
    return is_settled && blocked > refinement_.partial_occupancy.free_until() ? Freedom::contradicted
                                                                              : Freedom::unknown;
  }
  /// Of the beams of the larger sample that would cross a leaf if they were spread evenly, the share that
  /// ends in it; or part of it, if that is more than a free cell explains.
  [[nodiscard]] double share_blocked(const Ref& leaf, const Box<D>& box, const Part& part) const {
    const Sample sample{&box, refinement_.model.sample_beams(false)};
    std::uint32_t face = Index::kNoFace;
    double share = 0.0;
    double of_beam = 0.0;
    double blocked = 0.0;
    const auto add = [&](const ScanBeam<D>& beam) {
      if (beam.face != face) {
        face = beam.face;
        share = std::min(1.0, share_of(face, sample));
        of_beam = 1.0 / std::max(1.0, share * index_.expected_beams(face, box, box.upper[0] - box.lower[0]));
      }
      if (beam.returned && static_cast<double>(beam.chance) < share &&
          tree_.geometry().contains(leaf.index, beam.end))
        blocked += of_beam;
      return blocked <= refinement_.partial_occupancy.free_until();
    };
    if (part.is_listed) {
      for (std::size_t i = part.first; i < part.last && add(*crossings_[i].beam); ++i) {
      }
      return blocked;
    }
    for (std::size_t v = part.first; v < part.last; ++v) index_.for_each_end(views_[v], box, add);
    return blocked;
  }

  [[nodiscard]] bool any_crossing(const Part& part, const Box<D>& box) const {
    bool any = false;
    for_each_crossing(part, box, [&](const Crossing<D>*, std::size_t) {
      any = true;
      return false;
    });
    return any;
  }
  struct Crossings {
    std::size_t all = 0;
    std::size_t passed = 0;  ///< Those at whose exit the beam has clearly not met anything.
  };
  [[nodiscard]] Crossings count(const Part& part, const Box<D>& box, const Sample& sample) const {
    Crossings sum;
    for_each_crossing(part, box, sample, [&](const Crossing<D>* crossing, std::size_t n) {
      sum.all += n;
      for (std::size_t i = 0; i < n; ++i)
        sum.passed += !crossing[i].beam->returned || crossing[i].t_exit < crossing[i].beam->t_clearly_free;
      return true;
    });
    return sum;
  }

  /// @param only_free no beam says of anything but free space: then not all may be needed.
  void add_evidence(const Ref& leaf, const Box<D>& box, const Part& part, bool only_free,
                    const Sample& sample, ScanEvidence& sum) const {
    const double size = tree_.geometry().cell_size(leaf.index.level);
    const bool is_finest = leaf.index.level == finest_level_;
    const double child_size = is_finest ? 0.0 : tree_.geometry().cell_size(leaf.index.level - 1);
    const double chords_per_metre = 1.0 / (kMeanChord * size);
    for_each_crossing(part, box, sample, [&](const Crossing<D>* crossing, std::size_t n) {
      for (std::size_t i = 0; i < n; ++i) {
        const ScanBeam<D>& beam = *crossing[i].beam;
        const double t_enter = crossing[i].t_enter;
        const double t_exit = crossing[i].t_exit;
        const bool is_small = is_finest || size <= kSmallCell * beam.sigma;
        if (t_exit < beam.t_clearly_free &&
            (!is_small || std::max(t_exit, t_enter + beam.t_surface) < beam.t_clearly_free)) {
          sum.free += refinement_.model.of_miss((t_exit - t_enter) * beam.range * chords_per_metre);
          ++sum.misses;
          ++sum.beams;
          sum.resolvable_misses += child_size >= refinement_.model.noise_sigmas() * beam.sigma;
        } else {
          add_near_end(leaf, crossing[i], size, child_size, chords_per_metre, sum);
        }
      }
      return !(only_free && refinement_.model.is_full(sum));
    });
    refinement_.model.limit(sum);
  }

  /// Adds what a beam says about a leaf that it has not clearly passed.
  /// @param child_size 0 for leaves that cannot split [m].
  void add_near_end(const Ref& leaf, const Crossing<D>& crossing, double size, double child_size,
                    double chords_per_metre, ScanEvidence& sum) const {
    const ScanBeam<D>& beam = *crossing.beam;
    const double t_enter = crossing.t_enter;
    const bool resolvable = child_size >= refinement_.model.noise_sigmas() * beam.sigma;
    const bool holds_end = tree_.geometry().contains(leaf.index, beam.end);
    if (!beam.returned) {
      if (holds_end) return;  // Nothing is said about the rest of the cell.
      sum.free += refinement_.model.of_miss((crossing.t_exit - t_enter) * beam.range * chords_per_metre);
      ++sum.misses;
      sum.resolvable_misses += resolvable;
      ++sum.beams;
      return;
    }
    const bool is_small = leaf.index.level == finest_level_ || size <= kSmallCell * beam.sigma;
    const bool is_behind = !holds_end && t_enter >= 1.0;
    if (is_behind && !is_small) return;
    // No surface seems thinner than the noise: what is said of smaller cells does not depend on their size.
    const double t_exit = is_small ? std::max(crossing.t_exit, t_enter + beam.t_surface) : crossing.t_exit;
    const double range_in_sigmas = beam.range / beam.sigma;
    refinement_.model.add(
        sum, sensor_.tabulated_log_odds((t_enter - 1.0) * range_in_sigmas, (t_exit - 1.0) * range_in_sigmas),
        std::max(size / beam.sigma, kThinnestSurface));
    if (holds_end) {
      const double noise = kNoiseReach * beam.sigma;
      ++sum.hits;
      sum.resolvable_hits += resolvable;
      sum.deep_hits += resolvable && ((1.0 - t_enter) * beam.range > noise || size > noise);
    } else {
      sum.misses += !is_behind;
    }
    ++sum.beams;
  }

  Tree& tree_;
  typename Tree::Arena& arena_;
  const Refinement& refinement_;
  const Sensor& sensor_;
  const Index& index_;
  const double largest_sigma_;
  const double smallest_size_;
  const int finest_level_;
  const int coarsest_level_;
  UpdateCounters counters_;
  std::vector<Task>* tasks_ = nullptr;
  // Of the nodes on the path from the root, the deepest last:
  std::vector<View> views_;
  std::vector<Crossing<D>> crossings_;
  std::vector<CrossingOfChild> unsorted_;  // While they are handed down.
};

/// Integrates all beams of a scan in one walk over the tree. A leaf gets the joint evidence of the beams that
/// cross it over more than a point: a sum of whole numbers, so that neither their order matters nor how they
/// are found. A leaf that splits passes the same beams on to its children, which begin with what is due to
/// them of what it knew. Siblings of which a cell changed are merged on the way back. A leaf that splits and
/// is whole again after the same scan was neither split nor merged.
///
/// A cell that a scan leaves as it was is not updated, and does not count as such. That is so for cells that
/// know as much free space as a cell can remember: where all beams pass, they are not even asked.
///
/// What a beam says about a leaf, by where its end point lies:
/// - behind the leaf, and clearly so: a miss, evidence for free space in proportion to the way through it;
/// - near it, within the sensor's noise: what the inverse sensor model says, and a miss if behind;
/// - in it: a hit, and what the inverse sensor model says;
/// - before it: up to three standard deviations behind a hit the leaf takes what the model says, but only if
///   it is small, or of the smallest. A surface is not the whole of a coarse cell that it lies in front of.
///
/// A hit asks for smaller cells if the beam came a longer way through the leaf than noise explains, or if the
/// leaf is larger than what the noise leaves open. A beam without return is a miss of all leaves that it
/// passes as a whole.
template <class Tree, class Refinement, class Sensor>
class ScanUpdate {
  static constexpr int D = Tree::kDim;
  using Walk = ScanWalk<Tree, Refinement, Sensor>;

 public:
  ScanUpdate(Tree& tree, const Refinement& refinement, const Sensor& sensor, const MapOptions&,
             UpdateCounters& counters)
      : tree_(tree), refinement_(refinement), sensor_(sensor), counters_(counters) {}

  /// So many that the start of a thread is worth it for each.
  [[nodiscard]] static std::size_t most_workers(Eigen::Index beams) {
    constexpr Eigen::Index kBeamsOfWorker = 1000;
    return static_cast<std::size_t>(std::max<Eigen::Index>(1, beams / kBeamsOfWorker));
  }

  /// Before the beams of a scan, which must stay where it is until finish() is done.
  /// @param parts in which its beams will be added, about as many in each.
  void begin(const ScanView<D>& scan, double max_range, std::size_t parts) {
    scan_ = scan;
    max_range_ = max_range;
    index_.begin(parts, static_cast<std::size_t>(scan.size) / parts + 1);
  }
  /// Beams wait for finish(): the tree need not contain them yet.
  static constexpr bool kWaits = true;

  /// @param part of the scan; beams of different parts may be added at the same time.
  /// @param number of the beam in the scan. @param sigma of the range [m]. @param t_end the last point that
  ///   the beam says anything about. @pre the beam is valid.
  void add(std::size_t part, Eigen::Index number, const Beam<D>& beam, double sigma, double t_end) {
    index_.part(part).add(beam.origin, beam.displacement, t_end, sigma, chance_of<D>(beam.endpoint),
                          static_cast<std::uint32_t>(number));
  }

  /// @pre the tree contains all beams up to Sensor::t_end().
  /// The result is the same for every number of workers.
  void finish(Workers& workers) {
    const auto& geometry = tree_.geometry();
    index_.sort(
        {refinement_.model.sample_beams(false), geometry.cell_size(geometry.finest_level()),
         geometry.cell_size(Refinement::coarsest_level(geometry.finest_level()))},
        workers,
        [this](std::uint32_t number) -> Vector<D> {
          const auto i = static_cast<Eigen::Index>(number);
          return scan_.endpoint(i) - scan_.origin(i);
        },
        [this](std::uint32_t number) { return beam_of(number); });
    if (index_.num_beams() == 0) return;
    if (workers.count() <= 1) {
      Walk walk(tree_, tree_.main_arena(), refinement_, sensor_, index_);
      walk.run();
      add(walk.counters());
    } else {
      run_tasks(workers);
    }
  }

 private:
  /// One thread walks down to the cells of the coarsest level, which are then shared out, the ones with the
  /// most beams first.
  void run_tasks(Workers& workers) {
    std::vector<typename Walk::Task> tasks;
    Walk above(tree_, tree_.main_arena(), refinement_, sensor_, index_);
    above.run(&tasks);
    add(above.counters());
    std::stable_sort(tasks.begin(), tasks.end(),
                     [](const auto& a, const auto& b) { return a.effort > b.effort; });
    std::vector<typename Tree::Arena> arenas(std::min(workers.count(), tasks.size()));
    std::vector<Walk> walks;
    walks.reserve(arenas.size());
    for (typename Tree::Arena& arena : arenas) {
      tree_.lend(arena);
      walks.emplace_back(tree_, arena, refinement_, sensor_, index_);
    }
    const auto put_together = [&] {
      for (std::size_t i = 0; i < arenas.size(); ++i) {
        tree_.absorb(arenas[i]);
        add(walks[i].counters());
      }
    };
    try {
      workers.for_each_task(tasks.size(),
                            [&](std::size_t worker, std::size_t task) { walks[worker].run(tasks[task]); });
    } catch (...) {
      put_together();
      throw;
    }
    put_together();
  }

  [[nodiscard]] ScanBeam<D> beam_of(std::uint32_t number) const {
    const auto i = static_cast<Eigen::Index>(number);
    const Beam<D> beam(scan_.origin(i), scan_.endpoint(i), scan_.is_returned(i), max_range_);
    const double sigma = scan_.range_sigma == nullptr ? sensor_.sigma(beam.range) : scan_.range_sigma[i];
    const bool returned = beam.outcome == BeamOutcome::returned;
    ScanBeam<D> result;
    result.path = beam.displacement;
    result.range = beam.range;
    result.sigma = sigma;
    result.t_end = Sensor::t_end(beam, sigma);
    result.t_clearly_free =
        returned ? sensor_.clearly_free_until(beam.range, sigma) / beam.range : beam.t_free;
    result.t_surface = returned ? Walk::kThinnestSurface * sigma / beam.range : 0.0;
    result.end = returned ? cell_of_hit(beam) : tree_.geometry().coordinates(beam.free_end());
    result.returned = returned;
    return result;
  }

  /// The smallest cell that a returned beam ends in: the one that holds the end point, or, if the beam only
  /// touches that one in a corner, the next along the beam.
  [[nodiscard]] Lattice<D> cell_of_hit(const Beam<D>& beam) const {
    const auto& geometry = tree_.geometry();
    const Vector<D>& end = beam.endpoint;
    Lattice<D> cell = geometry.coordinates(end);
    Lattice<D> behind = cell;
    bool is_touched_only = false;
    for (std::size_t a = 0; a < D; ++a) {
      const double d = beam.displacement[static_cast<int>(a)];
      if (d == 0.0 || geometry.border(cell[a]) != end[static_cast<int>(a)]) continue;
      is_touched_only = is_touched_only || d > 0.0;
      if (d < 0.0) --behind[a];
    }
    return is_touched_only ? behind : cell;
  }

  void add(const UpdateCounters& counters) {
    counters_.updates += counters.updates;
    counters_.splits += counters.splits;
    counters_.merges += counters.merges;
  }

  Tree& tree_;
  const Refinement& refinement_;
  const Sensor& sensor_;
  UpdateCounters& counters_;
  ScanView<D> scan_;
  double max_range_ = kUnlimitedRange;
  ScanIndex<D> index_;
};

}  // namespace ndtree
