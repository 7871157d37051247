// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How much of a leaf's children the beams of a list have seen.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ndtree/cell/beam_weight.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/coverage.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/partition.hpp"
#include "ndtree/mapping/insert/sampling.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Widths of the beams of a list, in edges of a child.
struct BeamWidths {
  float per_depth = 0.0f;  ///< Width at a depth of 1 m [1/m]; 0 if all widths are `fixed`.
  float fixed = 0.0f;
};

/// Sums over the children that the beams of a list cross, see ScanCoverage. O(beams (N D + children
/// crossed)).
template <int N, int D>
class LeafCoverage {
  using Partition = ChildPartition<N, D>;
  using Planes = typename Partition::Planes;
  using Sum = ScanCoverage<N, D>;
  static constexpr int kNumChildren = Partition::kNumChildren;

 public:
  /// @param miss_evidence of a beam on a way of mean length, see EvidenceMemory.
  /// @param width_per_range least width of a beam at a distance of 1 m; 0: its distance to its neighbours.
  LeafCoverage(const ScanBeams<D>& beams, const Partition& partition, const CoverageModel& model,
               std::int64_t miss_evidence, float width_per_range)
      : beams_(beams), partition_(partition), model_(model), width_per_range_(width_per_range) {
    const LatticeGeometry<N, D>& geometry = partition.geometry();
    levels_.reserve(static_cast<std::size_t>(-geometry.finest_level()));
    const double smallest = geometry.cell_size(beams.finest_level());
    for (int level = geometry.finest_level() + 1; level <= 0; ++level) {
      const float per_child = 1.0f / static_cast<float>(geometry.cell_size(level - 1));
      const CoverageLimits limits = model.limits<N>(geometry.edge_in(level, beams.finest_level()));
      constexpr double kChildrenAcross = kNumChildren / (N * mean_chord_of_unit_cube(D)) / Sum::kUnitsOfOne;
      levels_.push_back({limits, per_child, static_cast<float>(smallest) * per_child,
                         static_cast<std::int64_t>(2.0 * kBelowRounding * kChildrenAcross *
                                                   static_cast<double>(limits.covered * miss_evidence))});
    }
  }
  /// False if beams that pass a leaf are too few to cover it, as their ways through it tell.
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool may_cover(int level, const PassedEvidence& passed) const {
    return 2 * passed.free + passed.misses >= of(level).covering_evidence;  // Ways are rounded.
  }

  /// Whether a leaf that was never seen splits for the only beam of the scan that passes it: the beam leaves
  /// out a child that two such beams would pass. Then judge() splits it, too, and no evidence is needed.
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool splits_for_one(int level, std::uint32_t beam,
                                                         const Crossing& crossing) const {
    const OfLevel& at = of(level);
    const CubeFace<D>& face = beams_.face_of(beam);
    const float per_depth = std::max(face.width_of_beam(), width_per_range_) * at.per_child;
    if (kMostCrossed >= kNumChildren || !CellParts<N, D>::kAreChildren || !model_.may_split(at.limits) ||
        !model_.is_on() || !(per_depth > 0.0f))
      return false;
    const float slant = beams_.end(beam).slant;
    Sum sum;
    sum.add(Sum::passed((crossing.exit - crossing.enter) * (slant * (at.per_child * Sum::kUnitsOfOne)),
                        0.5f * (crossing.enter + crossing.exit) * per_metre(slant, per_depth)));
    return CoverageModel::may_miss(sum);
  }

  /// Adds what beams of one face see of a leaf's children, up to their end points, until the leaf is certain
  /// to be covered.
  /// @param per_child 1 / edge of a child [1/m].
  NDTREE_ALWAYS_INLINE void operator()(const CellIndex<D>& leaf, const CubeFace<D>& face,
                                       const BeamList& list, float per_child, const BeamWidths& widths,
                                       const CoverageLimits& limits, Sum& sum) const {
    [[maybe_unused]] const bool by_eights = partition_.goes_by_eights() && !face.is_single();
    [[maybe_unused]] const auto main = static_cast<std::size_t>(face.axis);
    for (std::size_t first = 0; first < list.size; first += kChunk) {
      if (first > 0 && CoverageModel::is_certain(sum, limits)) return;
      const BeamList part = list.part(first, std::min(list.size, first + kChunk));
#ifdef NDTREE_HAS_EIGHTS
      if constexpr (kNumChildren <= Partition::kMostAtOnce) {
        if (by_eights) {
          const std::size_t at_once = kAllInLanes && part.size % 8 <= kFew ? part.size / 8 * 8 : part.size;
          if (at_once > 0) add_by_eights(leaf, main, part.part(0, at_once), per_child, widths, sum);
          if constexpr (kAllInLanes)
            if (at_once < part.size)
              add_to_eight(leaf, main, part.part(at_once, part.size), per_child, widths, sum);
          continue;
        }
      }
#endif
      add(leaf, face, part, per_child, widths, sum);
    }
  }
  /// Whether enough of a leaf was seen to update it as a whole; of an observed one, only whether it is
  /// covered.
  /// @param sample the beams of its list that it samples. @param beams, adds_nothing as in
  /// CoverageModel::judge().
  [[nodiscard]] NDTREE_NEVER_INLINE CoverageVerdict judge(const CellIndex<D>& leaf, const EvidenceCell& cell,
                                                          const BeamList& list, const LeafSample<D>& sample,
                                                          double beams, bool adds_nothing) const {
    if (cell.observed() && kMostCrossed * list.size < kNumChildren) return {};
    const OfLevel& level = of(leaf.level);
    const std::uint32_t seen_before = cell.is_partly_seen() ? cell.seen_parts() : 0;
    Sum sum;
    bool are_single = true;
    float sampled = 1.0f;
    sample.for_each_fraction(
        beams_, list, [&](const CubeFace<D>& face, float fraction, const BeamList& part) {
          // Sampled beams stand for the others, too.
          const float width = face.width_of_beam() * BeamSampling<N, D>::widening(fraction);
          const BeamWidths widths{std::max(width, width_per_range_) * level.per_child, level.smallest};
          const std::int64_t before = sum.way();
          (*this)(leaf, face, part, level.per_child, widths, level.limits, sum);
          if (sum.way() == before) return;
          are_single &= widths.per_depth == 0.0f;
          sampled = std::min(sampled, fraction);
        });
    CoverageVerdict verdict;
    if (!cell.observed())  // What lies beside a beam without neighbours, no such beam shows.
      verdict = model_.judge(sum, seen_before, level.limits, beams, adds_nothing || are_single,
                             static_cast<double>(sampled));
    verdict.is_covered = verdict.is_enough && CoverageModel::is_covered(sum, level.limits);
    return verdict;
  }

 private:
  struct OfLevel {
    CoverageLimits limits;
    float per_child;                 // 1 / edge of a child [1/m].
    float smallest;                  // A smallest cell, in edges of a child.
    std::int64_t covering_evidence;  // Twice the least evidence for free space of beams that cover a leaf.
  };
  [[nodiscard]] const OfLevel& of(int level) const {
    return levels_[static_cast<std::size_t>(level - partition_.geometry().finest_level() - 1)];
  }
  static constexpr std::size_t kMostCrossed = D * (N - 1) + 1;  // Children, by one beam.
  static constexpr double kBelowRounding = 1.0 - 1e-3;
  static constexpr std::size_t kChunk = 32;  // Beams between two tests; sums of up to 64 fit 32 bits.

  /// The axis of a face; of beams that are alone on their faces, which share one, the first along which the
  /// beam goes farthest.
  [[nodiscard]] static std::size_t main_axis(const CubeFace<D>& face, const BeamRay<D>& ray) {
    if (!face.is_single()) return static_cast<std::size_t>(face.axis);
    std::size_t main = 0;
    for (std::size_t a = 1; a < D; ++a)
      if (std::abs(ray.inverse[a]) < std::abs(ray.inverse[main])) main = a;
    return main;
  }
  /// Beam by beam where the partition goes beam by beam, whose crossings it takes.
  void add(const CellIndex<D>& leaf, const CubeFace<D>& face, const BeamList& list, float per_child,
           const BeamWidths& widths, Sum& sum) const {
    std::uint32_t last = BeamList::kAll;  // The beam that was added to the sums last.
    partition_.for_each_crossing(
        leaf, list, [&](std::size_t child, std::uint32_t beam, float enter, float leave) {
          const BeamEnd<D>& end = beams_.end(beam);
          const float exit = std::min(leave, end.range);
          if (!(exit > enter)) return;
          const float units_per_metre = end.slant * (per_child * Sum::kUnitsOfOne);
          const auto width_at = [&](float distance) {
            return widths.per_depth > 0.0f ? distance * per_metre(end.slant, widths.per_depth) : widths.fixed;
          };
          if (beam != last) {
            last = beam;
            const Crossing whole = partition_.crossing(leaf, beam);
            const float end_of_way = std::min(whole.exit, end.range);
            sum.add(Sum::passed((end_of_way - whole.enter) * units_per_metre,
                                width_at(0.5f * (whole.enter + end_of_way))));
          }
          const float middle = 0.5f * (enter + exit);
          const std::size_t main = main_axis(face, beams_.ray(beam));
          float area = 1.0f;
          for (std::size_t k = 0; k + 1 < D; ++k) {  // The axes across, as with_last() has them.
            const std::size_t a = k == main ? D - 1 : k;
            const float border = partition_.plane_of(leaf, a, Partition::kOffsets[child][a], beam);
            const float along = unfused(middle * (1.0f / beams_.ray(beam).inverse[a] * per_child));
            area *= Sum::overlap(std::abs(along - middle_of(border, per_child)), width_at(middle));
          }
          sum.add(static_cast<int>(child), nearest_integer((exit - enter) * units_per_metre * area));
        });
  }
  /// Planes with the last axis and another one exchanged.
  [[nodiscard]] static Planes with_last(std::size_t axis, Planes planes) {
    std::swap(planes[axis], planes[D - 1]);
    return planes;
  }
  /// Of each axis, the numbers of the children as with_last() numbers them.
  static constexpr auto kWithLast = [] {
    std::array<std::array<int, std::size_t{kNumChildren}>, std::size_t{D}> numbers{};
    for (std::size_t axis = 0; axis < D; ++axis) {
      for (std::size_t c = 0; c < std::size_t{kNumChildren}; ++c) {
        int number = 0;
        for (std::size_t a = D; a-- > 0;) {
          const std::size_t from = a == axis ? D - 1 : a == D - 1 ? axis : a;
          number = number * N + static_cast<int>(Partition::kOffsets[c][from]);
        }
        numbers[axis][c] = number;
      }
    }
    return numbers;
  }();
  /// Width of a beam for each metre along it. @param slant depth for each metre.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats per_metre(const Floats& slant, float per_depth) {
    if constexpr (D == 2)
      return Floats(per_depth) / slant;  // Evenly spaced by angle, see CubeFace.
    else
      return slant * per_depth;
  }
  /// The middle of a child, in its edges. @param border its lower one.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats middle_of(const Floats& border, float per_child) {
    return unfused(Floats(border * per_child)) + 0.5f;
  }
#ifdef NDTREE_HAS_EIGHTS
  /// add() of beams of one face, with_last() its axis.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void add_by_eights(const CellIndex<D>& leaf, std::size_t main,
                                                          const BeamList& list, float per_child,
                                                          const BeamWidths& widths, Sum& sum) const {
    const Planes planes = with_last(main, partition_.planes_by_fours(leaf));
    EightInts child[std::size_t{kNumChildren}];
#pragma GCC unroll 32
    for (int c = 0; c < kNumChildren; ++c) child[c] = 0;
    std::array<std::uint32_t, 4> sums;
    EightInts way = 0;
    EightInts slice = 0;
    const EightFloats fixed = widths.per_depth > 0.0f ? 0.0f : widths.fixed;
    typename Partition::Planes middles;  // Of children, across.
    for (std::size_t a = 0; a + 1 < D; ++a)
      for (std::size_t i = 0; i < N; ++i) middles[a][i] = middle_of(planes[a][i], per_child);
    for (std::size_t i = 0; i < list.size; i += 8) {
      EightRays<D> rays = beams_.rays(list.beam + i);
      std::swap(rays.inverse[main], rays.inverse[D - 1]);
      const EightEnds<D> ends = beams_.ends(list.beam + i);
      const EightFloats seen = min_of(rays.t_max, ends.range) & EightMask::first(list.size - i);
      EightFloats enter[std::size_t{kNumChildren}];
      EightFloats exit[std::size_t{kNumChildren}];
      Partition::template crossings_of_children<EightFloats>(planes, rays.inverse, 0.0f, seen, enter, exit);
      const EightFloats units_per_metre = ends.slant * (per_child * Sum::kUnitsOfOne);
      const EightFloats width_per_metre = per_metre(ends.slant, widths.per_depth);
      EightFloats enter_leaf, exit_leaf;
      Partition::crossings_of_node(planes, rays.inverse, seen, enter_leaf, exit_leaf);
      const EightMask passes = exit_leaf > enter_leaf;
      const auto passed = Sum::passed(EightFloats((exit_leaf - enter_leaf) * units_per_metre),
                                      EightFloats(0.5f * (enter_leaf + exit_leaf) * width_per_metre + fixed));
      way += passed.way & passes;
      slice += passed.slice & passes;
      EightFloats per_metre[std::size_t{D}];  // Along the beam: children's edges along the axis.
#pragma GCC unroll 4
      for (std::size_t a = 0; a + 1 < D; ++a) per_metre[a] = 1.0f / rays.inverse[a] * per_child;
#pragma GCC unroll 32
      for (int c = 0; c < kNumChildren; ++c) {
        const EightMask crosses = exit[c] > enter[c];
        if (crosses.set() == 0) continue;  // Beams side by side leave most children out.
        const EightFloats middle = 0.5f * (enter[c] + exit[c]);
        const EightFloats width = middle * width_per_metre + fixed;
        EightFloats area = 1.0f;
#pragma GCC unroll 4
        for (std::size_t a = 0; a + 1 < D; ++a) {
          const float middle_of_child = middles[a][Partition::kOffsets[static_cast<std::size_t>(c)][a]];
          area = area * Sum::overlap(abs_of(middle * per_metre[a] - middle_of_child), width);
        }
        child[c] += nearest_integer((exit[c] - enter[c]) * units_per_metre * area) & crosses;
      }
    }
#pragma GCC unroll 8
    for (int c = 0; c < kNumChildren; c += 4) {  // The last again if there are no four left.
      constexpr int kLast = kNumChildren - 1;
      sums_of(child[c], child[std::min(c + 1, kLast)], child[std::min(c + 2, kLast)],
              child[std::min(c + 3, kLast)])
          .store(sums.data());
      for (int k = 0; k < std::min(4, kNumChildren - c); ++k)
        sum.add(kWithLast[main][static_cast<std::size_t>(c + k)], sums[static_cast<std::size_t>(k)]);
    }
    sums_of(way, slice, way, slice).store(sums.data());
    sum.add(typename Sum::template Passed<std::uint32_t>{sums[0], sums[1]});
  }
  /// All children fit the lanes of a vector.
  static constexpr bool kAllInLanes = N == 2 && kNumChildren <= 8;
  static constexpr std::size_t kFew = D + 1;  // Beams for which lanes of beams would mostly be empty.

  /// Of each axis, the numbers of the planes below children, or above, if N is 2.
  static constexpr auto kPlanesBeside = [] {
    std::array<std::array<std::array<std::uint32_t, 8>, std::size_t{D}>, 2> planes{};
    for (unsigned above = 0; above < 2; ++above)
      for (unsigned a = 0; a < D; ++a)
        for (unsigned c = 0; c < 8; ++c) planes[above][a][c] = (c >> a & 1u) + above;
    return planes;
  }();
  /// add() of few beams of one face, one after the other: lanes are children.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void add_to_eight(const CellIndex<D>& leaf, std::size_t main,
                                                         const BeamList& list, float per_child,
                                                         const BeamWidths& widths, Sum& sum) const {
    const Planes planes = partition_.planes_by_fours(leaf);
    EightFloats lower[std::size_t{D}];
    EightFloats upper[std::size_t{D}];
    EightFloats middles[std::size_t{D}];
#pragma GCC unroll 4
    for (std::size_t a = 0; a < D; ++a) {
      lower[a] = of_four(planes[a].data(), kPlanesBeside[0][a].data());
      upper[a] = of_four(planes[a].data(), kPlanesBeside[1][a].data());
      middles[a] = middle_of(lower[a], per_child);
    }
    const float fixed = widths.per_depth > 0.0f ? 0.0f : widths.fixed;
    EightInts seen_of_children = 0;
    for (std::size_t i = 0; i < list.size; ++i) {
      const BeamRay<D>& ray = beams_.ray(list.beam[i]);
      const BeamEnd<D>& end = beams_.end(list.beam[i]);
      const float seen = min_of(ray.t_max, end.range);
      float enter_leaf, exit_leaf;
      Partition::crossings_of_node(planes, ray.inverse.data(), seen, enter_leaf, exit_leaf);
      if (!(exit_leaf > enter_leaf)) continue;
      const float units_per_metre = end.slant * (per_child * Sum::kUnitsOfOne);
      const float width_per_metre = per_metre(end.slant, widths.per_depth);
      sum.add(Sum::passed((exit_leaf - enter_leaf) * units_per_metre,
                          unfused(0.5f * (enter_leaf + exit_leaf) * width_per_metre) + fixed));
      EightFloats enter = 0.0f;
      EightFloats exit = seen;
#pragma GCC unroll 4
      for (std::size_t a = 0; a < D; ++a) {
        const EightFloats inverse = ray.inverse[a];
        const EightFloats at_lower = lower[a] * inverse;
        const EightFloats at_upper = upper[a] * inverse;
        enter = max_of(enter, min_of(at_lower, at_upper));
        exit = min_of(exit, max_of(at_lower, at_upper));
      }
      const EightFloats middle = 0.5f * (enter + exit);
      const EightFloats width = middle * EightFloats(width_per_metre) + EightFloats(fixed);
      EightFloats area = 1.0f;
#pragma GCC unroll 4
      for (std::size_t k = 0; k + 1 < D; ++k) {
        const std::size_t a = k == main ? D - 1 : k;
        const EightFloats along = middle * EightFloats(1.0f / ray.inverse[a] * per_child);
        area = area * Sum::overlap(abs_of(along - middles[a]), width);
      }
      seen_of_children +=
          nearest_integer((exit - enter) * EightFloats(units_per_metre) * area) & (exit > enter);
    }
    std::array<std::uint32_t, 8> sums;
    seen_of_children.store(sums.data());
    for (int c = 0; c < kNumChildren; ++c) sum.add(c, sums[static_cast<std::size_t>(c)]);
  }
#endif

  const ScanBeams<D>& beams_;
  const Partition& partition_;
  const CoverageModel& model_;
  const float width_per_range_;
  std::vector<OfLevel> levels_;  // From the one above the finest up to 0.
};

}  // namespace ndtree
