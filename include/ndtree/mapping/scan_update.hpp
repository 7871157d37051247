// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A whole scan into the tree at once: every node passes on the beams that cross it to its children.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/beam_traversal.hpp"

namespace ndtree {

/// Integrates all beams of a scan in one walk over the tree. A leaf gets the joint evidence of the beams that
/// cross it, so their order does not matter. A leaf that splits passes the same beams on to its children,
/// which begin with what is due to them of what it knew. Siblings are merged on the way back. A leaf that
/// splits and is whole again after the same scan was neither split nor merged.
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
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;
  static constexpr int kNumChildren = Tree::kNumChildren;
  static constexpr double kNoiseReach = 3.0;  // Standard deviations that noise is taken to explain.
  static constexpr double kSmallCell = 2.0;   // Standard deviations up to which a cell is small.
  // Standard deviations; then a cell in the middle of which a beam ends gets probability_max of the defaults.
  static constexpr double kThinnestSurface = 5.0 / 3.0;
  static constexpr double kMeanChord = mean_chord_of_unit_cube(D);

 public:
  ScanUpdate(Tree& tree, const Refinement& refinement, const Sensor& sensor, const MapOptions&,
             UpdateCounters& counters)
      : tree_(tree),
        refinement_(refinement),
        sensor_(sensor),
        counters_(counters),
        finest_level_(tree.geometry().finest_level()),
        coarsest_level_(Refinement::coarsest_level(finest_level_)) {}

  /// @pre the beam is valid, and the tree contains it up to Sensor::t_end(). It waits for finish().
  void add(const Beam<D>& beam) {
    const bool returned = beam.outcome == BeamOutcome::returned;
    const double sigma = sensor_.sigma(beam.range);
    const auto number = static_cast<std::uint32_t>(beams_.size());
    beams_.push_back({{tree_.geometry(), beam.origin, beam.displacement},
                      returned ? cell_of_hit(beam) : tree_.geometry().coordinates(beam.free_end()),
                      beam.range,
                      sigma,
                      returned ? sensor_.clearly_free_until(beam.range, sigma) / beam.range : beam.t_free,
                      returned});
    segments_.push_back({number, 0.0, sensor_.t_end(beam)});
  }

  void finish() {
    const auto root = tree_.root();
    std::size_t kept = 0;
    for (Segment segment : segments_)
      if (beams_[segment.beam].stepper.clip(root.index, segment.t_enter, segment.t_exit))
        segments_[kept++] = segment;
    segments_.resize(kept);
    if (kept > 0) descend(root, 0, kept);
    segments_.clear();
    beams_.clear();
  }

 private:
  using Ref = typename Tree::Ref;

  struct BeamInScan {
    BeamStepper<N, D> stepper;
    Lattice<D> end;  // The smallest cell that it ends in.
    double range;
    double sigma;
    double t_clearly_free;
    bool returned;
  };
  /// The part of a beam that lies in a node.
  struct Segment {
    std::uint32_t beam;
    double t_enter;
    double t_exit;
  };
  struct SegmentOfChild {
    Segment segment;
    int child;
  };

  /// @param first, last range of segments_ that holds the node's.
  void descend(const Ref& ref, std::size_t first, std::size_t last) {
    const bool is_leaf = ref.is_leaf();
    const bool splits = is_leaf && ref.index.level <= coarsest_level_;
    EvidenceCell parent;
    if (splits) {
      const ScanEvidence scan = evidence(ref, first, last);
      if (ref.index.level == finest_level_ || !refinement_.splits(ref.cell(), scan)) {
        if (scan.beams > 0) refinement_.model.update(ref.cell(), scan);
        counters_.updates += scan.beams;
        return;
      }
      parent = ref.cell();
      ++counters_.splits;
    }
    if (is_leaf) tree_.split(ref);

    std::array<std::size_t, kNumChildren + 1> begin;
    std::array<CellIndex<D>, kNumChildren> index;
    const std::size_t base = segments_.size();
    pass_on(ref, first, last, begin, index);
    auto* const children = tree_.children(*ref.node);
    for (int j = 0; j < kNumChildren; ++j) {
      const auto k = static_cast<std::size_t>(j);
      if (splits)
        children[j].cell() = refinement_.model.inherited(parent, kShareDivisor<Tree>,
                                                         num_passed(begin[k], begin[k + 1]), last - first);
      if (begin[k] < begin[k + 1]) descend(Ref{children + j, index[k]}, begin[k], begin[k + 1]);
    }
    segments_.resize(base);

    if (ref.index.level > coarsest_level_) return;
    const auto merged = refinement_.merge_rule(children, kNumChildren, kShareDivisor<Tree>);
    if (!merged) return;
    tree_.merge(*ref.node, *merged);
    if (splits)
      --counters_.splits;
    else
      ++counters_.merges;
  }

  /// Appends the segments in the children of a node to segments_, child by child: those of child j are in
  /// [begin[j], begin[j + 1]).
  void pass_on(const Ref& ref, std::size_t first, std::size_t last,
               std::array<std::size_t, kNumChildren + 1>& begin,
               std::array<CellIndex<D>, kNumChildren>& index) {
    begin.fill(0);
    unsorted_.clear();
    for (std::size_t i = first; i < last; ++i) {
      const Segment segment = segments_[i];
      beams_[segment.beam].stepper.for_each_child(
          ref.index, segment.t_enter, segment.t_exit,
          [&](int child, const CellIndex<D>& child_index, double t_enter, double t_exit) {
            unsorted_.push_back({{segment.beam, t_enter, t_exit}, child});
            ++begin[static_cast<std::size_t>(child) + 1];
            index[static_cast<std::size_t>(child)] = child_index;
            return true;
          });
    }
    begin[0] = segments_.size();
    for (std::size_t j = 1; j < begin.size(); ++j) begin[j] += begin[j - 1];
    segments_.resize(begin.back());
    std::array<std::size_t, kNumChildren + 1> next = begin;
    for (const SegmentOfChild& of_child : unsorted_)
      segments_[next[static_cast<std::size_t>(of_child.child)]++] = of_child.segment;
  }

  /// Of these segments, those at whose end the beam has clearly not met anything.
  [[nodiscard]] std::size_t num_passed(std::size_t first, std::size_t last) const {
    std::size_t n = 0;
    for (std::size_t i = first; i < last; ++i) {
      const BeamInScan& beam = beams_[segments_[i].beam];
      n += !beam.returned || segments_[i].t_exit < beam.t_clearly_free;
    }
    return n;
  }

  [[nodiscard]] ScanEvidence evidence(const Ref& leaf, std::size_t first, std::size_t last) const {
    const double size = tree_.geometry().cell_size(leaf.index.level);
    const bool is_finest = leaf.index.level == finest_level_;
    const double child_size = is_finest ? 0.0 : tree_.geometry().cell_size(leaf.index.level - 1);
    ScanEvidence sum;
    for (std::size_t i = first; i < last; ++i) {
      const Segment& segment = segments_[i];
      const BeamInScan& beam = beams_[segment.beam];
      const bool resolvable = child_size >= refinement_.model.noise_sigmas() * beam.sigma;
      const bool is_small = is_finest || size <= kSmallCell * beam.sigma;
      // No surface seems thinner than the noise: what is said of smaller cells does not depend on their size.
      const double t_exit =
          beam.returned && is_small
              ? std::max(segment.t_exit, segment.t_enter + kThinnestSurface * beam.sigma / beam.range)
              : segment.t_exit;
      if (t_exit < beam.t_clearly_free || !beam.returned) {
        if (!beam.returned && segment.t_exit >= beam.t_clearly_free && holds_end(leaf, beam))
          continue;  // Nothing is said about the rest of the cell.
        sum.free +=
            refinement_.model.of_miss((segment.t_exit - segment.t_enter) * beam.range / (kMeanChord * size));
        ++sum.misses;
        sum.resolvable_misses += resolvable;
      } else {
        const bool hit = holds_end(leaf, beam);
        const bool behind = !hit && segment.t_enter >= 1.0;
        if (behind && !is_small) continue;
        refinement_.model.add(
            sum,
            sensor_.log_odds(Sensor::cdf(segment.t_enter * beam.range, beam.range, beam.sigma),
                             Sensor::cdf(t_exit * beam.range, beam.range, beam.sigma)),
            std::max(size / beam.sigma, kThinnestSurface));
        if (hit) {
          const double noise = kNoiseReach * beam.sigma;
          ++sum.hits;
          sum.resolvable_hits += resolvable;
          sum.deep_hits += resolvable && ((1.0 - segment.t_enter) * beam.range > noise || size > noise);
        } else {
          sum.misses += !behind;
        }
      }
      ++sum.beams;
    }
    return sum;
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
  [[nodiscard]] bool holds_end(const Ref& leaf, const BeamInScan& beam) const {
    return tree_.geometry().contains(leaf.index, beam.end);
  }

  Tree& tree_;
  const Refinement& refinement_;
  const Sensor& sensor_;
  UpdateCounters& counters_;
  const int finest_level_;
  const int coarsest_level_;
  std::vector<BeamInScan> beams_;
  std::vector<Segment> segments_;         // Of the nodes on the path from the root, the deepest last.
  std::vector<SegmentOfChild> unsorted_;  // While they are passed on.
};

}  // namespace ndtree
