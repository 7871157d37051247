// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The evidence of a scan's beams for one leaf: sums of integers over the beams that cross it.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <type_traits>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/mapping/insert/beam_lists.hpp"
#include "ndtree/mapping/insert/crossings.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/partition.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// How beams passed an occupied cell in which none of them ended.
struct Passes {
  bool any_goes_through = false;  ///< On a way of at least half the cell's edge.
  bool any_ends_near = false;     ///< At most two of its edges, and three standard deviations, behind it.

  /// Whether the cell looks empty. The surface behind it may be the one that was met in it before, measured
  /// from a pose that is a little wrong; and beams that clip a corner have not seen the cell.
  [[nodiscard]] bool are_clear() const { return any_goes_through && !any_ends_near; }
};

/// Strategy. Most beams clearly pass a leaf: a vector loop adds up their misses from entry and exit alone.
/// Only for vectors with a beam that ends near the leaf are the ends looked up (add_near_end()). Evidence by
/// where a beam's end point lies:
/// - behind the leaf, farther than the noise (BeamEnd::clearly_free_until): a miss, evidence for free space
///   in proportion to the length inside the leaf;
/// - behind the leaf, within the noise: a miss, and the inverse sensor model's evidence;
/// - in the leaf: a hit, and the inverse sensor model's evidence;
/// - before the leaf, by at most three standard deviations: the inverse sensor model's evidence, but only for
///   cells with an edge of at most two standard deviations, and smallest cells. A coarse cell behind a
///   surface is not the surface; the beam is counted (ScanEvidence::ends_before), as the cell may split.
///
/// A hit, or a miss that is clearly free or without return, is resolvable if a child's edge is at least
/// noise_sigmas standard deviations, and of a hit the beam's width; a miss within the noise of its end point
/// never is. A hit of such small noise is partial, evidence for a part of the leaf only, if the beam's length
/// in the leaf before its end point, or the leaf's edge, exceeds three standard deviations. A beam without
/// return, or cut at the maximum range, is a miss of every leaf that it crosses up to its end: a surface
/// there would have returned it.
///
/// Invariants: sums are integers, so the order of beams and the width do not matter; the loops over eight
/// beams give the bits of OfBeam. Cost: O(beams), a vector of eight that clearly pass in about 40
/// instructions.
template <int N, int D, class Sensor>
class LeafEvidence {
  static constexpr float kNoiseReach = 3.0f;  // Standard deviations that are explained by noise.
  /// Least distance from a hit's end point to the exit of its cell [standard deviations]. Without it a
  /// surface near the far border of its cell would give no evidence in any scan, as F(exit) is 1/2 there.
  static constexpr float kLeastBehindHit = 0.5f;
  static constexpr float kWidestSigma = static_cast<float>(1.0 / kThinnestSurface);
  static constexpr float kSmallCell = 2.0f;  // Standard deviations up to which a cell is small.
  static constexpr double kMeanChord = mean_chord_of_unit_cube(D);
  struct Size;
#ifdef NDTREE_HAS_EIGHTS
  using Corner = std::array<std::int32_t, std::size_t{D}>;  // Lower corner of a leaf minus ScanBeams::base().
#endif

 public:
  LeafEvidence(const LatticeGeometry<N, D>& geometry, const ScanBeams<D>& beams, const EvidenceModel& model,
               const Sensor& sensor)
      : geometry_(geometry),
        beams_(beams),
        sensor_(sensor),
        width_(beams.width()),
        has_cone_(sensor.has_cone()),
        noise_sigmas_(static_cast<float>(model.noise_sigmas())) {
    sizes_.reserve(static_cast<std::size_t>(1 - geometry.finest_level()));
    for (int level = geometry.finest_level(); level <= 0; ++level) {
      const double size = geometry.cell_size(level);
      const bool is_finest = level <= beams.finest_level();
      Size of_level;
      of_level.cell = static_cast<float>(size);
      of_level.per_cell = 1.0f / of_level.cell;
      of_level.child = is_finest ? -1.0f : static_cast<float>(geometry.cell_size(level - 1));
      of_level.units_per_metre =
          static_cast<float>(static_cast<double>(model.miss_evidence()) / (kMeanChord * size));
      of_level.is_inside_alike = beams.largest_sigma() == beams.smallest_sigma() && !has_cone_;
      of_level.inside = inside_table_(std::min(beams.smallest_sigma() * of_level.per_cell, kWidestSigma));
      of_level.small = is_finest ? 0.0f : of_level.cell;
      of_level.resolves_all = of_level.child >= noise_sigmas_ * beams.largest_sigma();
      of_level.resolves_some = of_level.child >= noise_sigmas_ * beams.smallest_sigma();
      of_level.fits_32_bits = beams.ends_fit_32_bits() && geometry.edge(level) <= ScanBeams<D>::kNearby;
      of_level.edge = of_level.fits_32_bits ? static_cast<std::int32_t>(geometry.edge(level)) : 0;
      of_level.goes_by_eights = beams.width() >= 8 && of_level.fits_32_bits;
      of_level.is_simple = of_level.goes_by_eights && beams.are_alike();
      sizes_.push_back(of_level);
    }
  }

  /// Whether every beam of a list clearly passes its node, whatever the size of the cells in it. O(beams).
  /// @param crossings where beams cross the node.
  [[nodiscard]] bool all_pass(const CellCrossings<N, D>& crossings, const BeamList& list) const {
#ifdef NDTREE_HAS_EIGHTS
    if (width_ >= 8)
      return beams_.are_alike() ? all_pass_by_eights<true>(crossings, list)
                                : all_pass_by_eights<false>(crossings, list);
#endif
    // Rows of eight beams are read by functions that are compiled for the processor.
    for (std::size_t i = 0; i < list.size; ++i)
      if (!(crossings.of(list.beam[i]).exit < beams_.t_free_of(list.beam[i]))) return false;
    return true;
  }

  /// The evidence of a list's beams with numbers below `beams_end` for a leaf of level 0 or below.
  /// @param crossings where beams cross the leaf. @param resolves false: resolvable_misses is not needed.
  [[nodiscard]] NDTREE_ALWAYS_INLINE ScanEvidence of(const CellIndex<D>& leaf,
                                                     const CellCrossings<N, D>& crossings,
                                                     const BeamList& list,
                                                     std::uint32_t beams_end = BeamList::kAll,
                                                     [[maybe_unused]] bool resolves = true) const {
    if (list.size == 1) {
      ScanEvidence sum;
      const std::uint32_t beam = list.first_beam();
      if (beam < beams_end) OfBeam(*this, leaf.level, beam).add(leaf, crossings.of(beam), sum);
      return sum;
    }
#ifdef NDTREE_HAS_EIGHTS
    const Size& size = size_of(leaf.level);
    // An empty list's size minus 1 is the largest number.
    if (size.is_simple && list.size - 1 < kMostAtOnce)
      return of_eights<true>(leaf, crossings, list, beams_end, resolves);
#endif
    return of_any(leaf, crossings, list.part(0, list.find(beams_end)));
  }

  /// Whether a beam of a list ended right before a coarse leaf, and met its border at so grazing an angle
  /// that smallest cells before the border are passed by more beams than end in them. See
  /// cells_passed_per_end(). Such a surface is found in the smallest cells behind the border, or nowhere.
  /// Only resolvable ends count. O(beams).
  [[nodiscard]] NDTREE_NEVER_INLINE bool any_grazes(const CellIndex<D>& leaf, const BeamList& list) const {
    const CellCrossings<N, D> crossings(geometry_, beams_, leaf);
    const Size& size = size_of(leaf.level);
    for (std::size_t i = 0; i < list.size; ++i) {
      const BeamEnd<D>& beam = beams_.end(list.beam[i]);
      if (!beam.is_returned() || is_small(size, beam.sigma) || !is_resolvable(size, beam.sigma)) continue;
      const float behind = crossings.of(list.beam[i]).enter - beam.range;
      if (behind < 0.0f || geometry_.contains(leaf, beams_.end_cell(list.beam[i]))) continue;
      if (cells_passed_per_end(crossings.slant_at_entry(list.beam[i]),
                               behind * size_of(beams_.finest_level()).per_cell) > 1.0f)
        return true;
    }
    return false;
  }

  /// Adds how the beams of a list passed a cell. O(beams).
  NDTREE_NEVER_INLINE void add_passes(const CellIndex<D>& cell, const BeamList& list, Passes& passes) const {
    constexpr float kNear = 2.0f;
    constexpr float kThrough = 0.5f;
    const CellCrossings<N, D> crossings(geometry_, beams_, cell);
    const float edge = size_of(cell.level).cell;
    for (std::size_t i = 0; i < list.size; ++i) {
      const BeamEnd<D>& beam = beams_.end(list.beam[i]);
      const auto [enter, exit] = crossings.of(list.beam[i]);
      if (!(enter < exit)) continue;
      const float near = unfused(kNear * edge) + unfused(kNoiseReach * beam.sigma);
      passes.any_ends_near = passes.any_ends_near || (beam.is_returned() && beam.range - exit < near);
      passes.any_goes_through = passes.any_goes_through || exit - enter >= kThrough * edge;
    }
  }

  /// The evidence of one beam for leaves of one level, 0 or below, by the same rules as of vectors. It goes
  /// on its own, as it returns early, and where cells or sums do not fit 32 bits.
  class OfBeam {
   public:
    NDTREE_ALWAYS_INLINE OfBeam(const LeafEvidence& all, int level, std::uint32_t beam)
        : all_(all), size_(all.size_of(level)), number_(beam) {}

    /// For a leaf that the beam is a miss of, without evidence for occupied space.
    /// @param crossing where it crosses the leaf.
    [[nodiscard]] NDTREE_ALWAYS_INLINE PassedEvidence passed(const Crossing& crossing) const {
      return {units_of_length(crossing.exit - crossing.enter, size_), 1, is_resolvable()};
    }
    /// Adds the beam's evidence for any leaf.
    NDTREE_ALWAYS_INLINE void add(const CellIndex<D>& leaf, const Crossing& crossing,
                                  ScanEvidence& sum) const {
      const float enter = crossing.enter;
      // A surface is as thick as the noise: evidence for smaller cells does not depend on their size.
      const BeamEnd<D>& beam = all_.beams_.end(number_);
      const bool is_small = LeafEvidence::is_small(size_, beam.sigma);
      const float exit_or_surface = is_small ? std::max(crossing.exit, enter + beam.surface) : crossing.exit;
      if (exit_or_surface < beam.clearly_free_until || !beam.is_returned()) return sum.add(passed(crossing));
      const bool holds_end = all_.geometry_.contains(leaf, all_.beams_.end_cell(number_));
      const bool is_behind_surface = !holds_end && enter >= beam.range;
      if (is_behind_surface && !is_small) {
        ++sum.ends_before;
        return;
      }
      float entry_behind = 0.0f;
      BeamWeight::add(
          sum, all_.near_end(size_, beam.range, beam.sigma, enter, exit_or_surface, holds_end, entry_behind));
      if (holds_end) {
        ++sum.hits;
        sum.resolvable_hits += is_resolvable() && all_.fits_child(size_, beam.range);
        sum.partial_hits += is_resolvable() && is_partial_hit(size_, beam.sigma, entry_behind);
      } else {
        sum.misses += !is_behind_surface;
      }
      ++sum.beams;
    }

   private:
    /// Whether the beam's noise is small enough for the leaf's children.
    [[nodiscard]] NDTREE_ALWAYS_INLINE bool is_resolvable() const {
      if (size_.resolves_all || !size_.resolves_some) return size_.resolves_all;
      return all_.is_resolvable(size_, all_.beams_.end(number_).sigma);
    }

    const LeafEvidence& all_;
    const Size& size_;
    std::uint32_t number_;
  };

#ifdef NDTREE_HAS_EIGHTS
  static constexpr int kNumChildren = ChildPartition<N, D>::kNumChildren;
  using Packet = RayPacket<D, kNumChildren>;

  /// Whether nodes of a level, and of all levels below, may have ray packets.
  [[nodiscard]] bool takes_packets(int level) const { return size_of(level).fits_32_bits; }
  /// The evidence of a packet for a node's child that all its rays clearly pass.
  /// @param level of the children. @pre takes_packets() there.
  [[nodiscard]] PassedEvidence passed(int level, Packet& packet, std::size_t child) const {
    const Size& size = size_of(level);
    if (!packet.has_passed) weigh_passes(size, packet);
    return {packet.free[child], detail::kBitCount[packet.set[child]],
            detail::kBitCount[packet.set[child] & packet.resolvable]};
  }
  /// The evidence of a packet's rays with numbers below `beams_end` for a node's child.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_NEVER_INLINE ScanEvidence of(const CellIndex<D>& node, Packet& packet,
                                                                     std::size_t child,
                                                                     std::uint32_t beams_end) const {
    const Size& size = size_of(node.level - 1);
    const EightFloats enter = EightFloats::load(packet.enter[child].data());
    const EightFloats exit = EightFloats::load(packet.exit[child].data());
    const std::uint32_t set = packet.set[child] & packet.before(beams_end);
    const EightMask live = EightMask::of_set(set);
    EightSums sums{0, 0, 0, 0};
    ScanEvidence sum;
    EightMask misses = live & (exit < packet.beams.t_free);
    if ((packet.passing[child] & set) != set)
      misses = add_near_end(child_of(corner_of(node), child, size), size, beams_.ends_of(packet.beams), enter,
                            exit, misses, live, sums, sum);
    add_misses(enter, exit, misses, size, sums);
    if (size.resolves_some && !size.resolves_all)
      sum.resolvable_misses = (misses & is_resolvable(size, beams_.ends_of(packet.beams).sigma)).count();
    finish(sums, size, sum);
    return sum;
  }
#endif

 private:
  struct Size {
    float cell;             // [m]
    float per_cell;         // 1 / cell [1/m].
    float child;            // Of its children [m]; less than any noise if it cannot split.
    float units_per_metre;  // Of evidence for free space, for a metre through it.
    bool resolves_all;      // The noise of every beam is small enough for children of this size.
    bool resolves_some;     // The noise of at least one beam is.
    bool fits_32_bits;      // Corner and edge do.
    bool goes_by_eights;    // Vector loops are used.
    bool is_simple;         // Vector loops are used, and ScanBeams::are_alike().
    std::int32_t edge;      // Of the cell, in smallest cells, if it fits 32 bits.
    bool is_inside_alike;   // All beams have equal noise, and no width.
    float inside;           // BeamWeight::probability_inside() of the most precise beam.
    float small;            // Edge of the cell; 0 for smallest cells, which are small beside any noise.
  };

  [[nodiscard]] const Size& size_of(int level) const {
    return sizes_[static_cast<std::size_t>(level - geometry_.finest_level())];
  }

  // Of one beam, or of eight:

  /// The weight of a miss: evidence for free space in proportion to its way through the cell [m].
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static auto units_of_length(const Floats& way, const Size& size) {
    const auto units = nearest_integer(Floats(way * size.units_per_metre));
    return max_of(std::decay_t<decltype(units)>(1), units);
  }
  /// Whether a cell is small beside a beam's noise.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static auto is_small(const Size& size, const Floats& sigma) {
    return size.small <= kSmallCell * sigma;
  }
  /// The weight of a hit in a cell, along and across the beam.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Floats inside(const Size& size, const Floats& sigma,
                                                   const Floats& range) const {
    if (size.is_inside_alike) return size.inside;
    const Floats along = inside_table_(min_of(sigma * size.per_cell, kWidestSigma));
    return has_cone_ ? Floats(along * BeamWeight::covered_part<D>(size.cell, sensor_.cone_width(range)))
                     : along;
  }
  /// Whether the noise of a beam is small enough for the leaf's children.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE auto is_resolvable(const Size& size, const Floats& sigma) const {
    return size.child >= noise_sigmas_ * sigma;
  }
  /// Whether a beam is no wider at its end point than the leaf's children.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE auto fits_child(const Size& size, const Floats& range) const {
    return Floats(size.child) >= sensor_.cone_width(range);
  }
  /// The evidence, see BeamWeight, for a cell whose exit is not clearly before a beam's end point.
  /// @param exit_or_surface where it leaves the cell, or what counts as that [m].
  /// @param holds_end whether the cell holds its end point.
  /// @param entry_behind gets how far the entry is behind its end point, negative before it [standard
  ///   deviations].
  template <class Floats, class Condition>
  [[nodiscard]] NDTREE_ALWAYS_INLINE auto near_end(const Size& size, const Floats& range, const Floats& sigma,
                                                   const Floats& enter, const Floats& exit_or_surface,
                                                   const Condition& holds_end, Floats& entry_behind) const {
    const Floats per_sigma = 1.0f / sigma;
    entry_behind = (enter - range) * per_sigma;
    const Floats end_behind = (exit_or_surface - range) * per_sigma;
    const Floats exit_behind = select(holds_end, max_of(end_behind, Floats(kLeastBehindHit)), end_behind);
    return BeamWeight::units_of(sensor_.quick_log_odds(entry_behind, exit_behind),
                                inside(size, sigma, range));
  }
  /// Whether a hit, if it is resolvable, is evidence for a part of the cell only.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static auto is_partial_hit(const Size& size, const Floats& sigma,
                                                                const Floats& entry_behind) {
    return (entry_behind < -kNoiseReach) | (size.cell > kNoiseReach * sigma);
  }

  /// of() for any list, leaf and beams.
  [[nodiscard]] NDTREE_NEVER_INLINE ScanEvidence of_any(const CellIndex<D>& leaf,
                                                        const CellCrossings<N, D>& crossings,
                                                        const BeamList& list) const {
    ScanEvidence sum;
#ifdef NDTREE_HAS_EIGHTS
    const Size& size = size_of(leaf.level);
    if (size.goes_by_eights) {
      for (std::size_t first = 0; first < list.size; first += kMostAtOnce) {
        const BeamList part = list.part(first, std::min(first + kMostAtOnce, list.size));
        sum.add(size.is_simple ? of_eights<true>(leaf, crossings, part, BeamList::kAll, true)
                               : of_eights<false>(leaf, crossings, part, BeamList::kAll, true));
      }
      return sum;
    }
#endif
    for (std::size_t i = 0; i < list.size; ++i)
      OfBeam(*this, leaf.level, list.beam[i]).add(leaf, crossings.of(list.beam[i]), sum);
    return sum;
  }

#ifdef NDTREE_HAS_EIGHTS
  template <bool kAlike>
  NDTREE_BY_EIGHTS [[nodiscard]] bool all_pass_by_eights(const CellCrossings<N, D>& crossings,
                                                         const BeamList& list) const {
    for (std::size_t i = 0; i < list.size; i += 8) {
      const std::uint32_t* const beam = list.beam + i;
      const EightCrossings eight = crossings.template of<kAlike>(beam, beams_.rays(beam));
      if (!EightMask::first(list.size - i).is_within(eight.exit < eight.t_free)) return false;
    }
    return true;
  }
  static constexpr std::size_t kMostAtOnce = 1024;  // Beams, whose sums fit 32 bits.

  /// Sums of eight lanes.
  struct EightSums {
    EightInts occupied, free;  // Evidence.
    EightInts passed, near;    // Minus the number of beams that passed, and of others with evidence.
  };

  /// The evidence of 1 to kMostAtOnce beams, those with numbers below `beams_end`: the bits of OfBeam.
  template <bool kAlike>
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE ScanEvidence of_eights(const CellIndex<D>& leaf,
                                                              const CellCrossings<N, D>& crossings,
                                                              const BeamList& list, std::uint32_t beams_end,
                                                              bool resolves) const {
    const Size& size = size_of(leaf.level);
    const bool resolves_some = resolves && size.resolves_some && !size.resolves_all;
    const auto last = static_cast<std::int32_t>(std::min(beams_end, ScanBeams<D>::kMostInLoops));
    EightSums sums{0, 0, 0, 0};
    ScanEvidence sum;
    std::size_t i = 0;
    do {
      const std::uint32_t* const beam = list.beam + i;
      const EightMask live = EightMask::first(list.size - i) & (EightInts(last) > EightInts::load(beam));
      const EightCrossings at = crossings.template of<kAlike>(beam, beams_.rays(beam));
      EightMask misses = live & (at.exit < at.t_free);
      if (!live.is_within(misses))
        misses = add_near_end(corner_of(leaf), size, beams_.ends(beam), at.enter, at.exit, misses, live, sums,
                              sum);
      add_misses(at.enter, at.exit, misses, size, sums);
      if (resolves_some)
        sum.resolvable_misses += (misses & is_resolvable(size, beams_.ends(beam).sigma)).count();
      i += 8;
    } while (i < list.size && list.beam[i] < beams_end);
    finish(sums, size, sum);
    return sum;
  }
  /// Adds up the lanes. @param sum has the counts that are not kept in lanes.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE static void finish(const EightSums& sums, const Size& size,
                                                           ScanEvidence& sum) {
    const FourInts all = sums_of(sums.occupied, sums.free, sums.passed, sums.near);
    const std::uint32_t passed = 0u - all.get<2>();
    sum.occupied = all.get<0>();
    sum.free = all.get<1>();
    sum.misses += passed;
    sum.resolvable_misses += size.resolves_all ? passed : 0;
    sum.beams = passed - all.get<3>();
  }
  [[nodiscard]] NDTREE_ALWAYS_INLINE Corner corner_of(const CellIndex<D>& cell) const {
    Corner corner;  // It fits: what beams cross is where they reach, see ScanBeams::ends_fit_32_bits().
    for (std::size_t a = 0; a < D; ++a)
      corner[a] = static_cast<std::int32_t>(static_cast<std::uint32_t>(cell.lower[a]) -
                                            static_cast<std::uint32_t>(beams_.base()[a]));
    return corner;
  }
  /// Corner of a node's child.
  [[nodiscard]] static Corner child_of(Corner corner, std::size_t child, const Size& size) {
    for (std::size_t a = 0; a < D; ++a, child /= N)
      corner[a] += static_cast<std::int32_t>(child % N) * size.edge;
    return corner;
  }
  /// Whether the end cells of eight beams lie in a leaf.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static EightMask lie_in(const Corner& leaf,
                                                                              const Size& size,
                                                                              const EightInts* cell) {
    EightInts farthest = cell[0] - leaf[0];  // Without sign: before is far.
#pragma GCC unroll 4
    for (std::size_t a = 1; a < D; ++a) farthest = unsigned_max_of(farthest, cell[a] - leaf[a]);
    const EightInts last = size.edge - 1;
    return unsigned_max_of(farthest, last) == last;
  }
  /// Adds the misses of beams that pass a leaf.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE static void add_misses(const EightFloats& enter,
                                                               const EightFloats& exit,
                                                               const EightMask& misses, const Size& size,
                                                               EightSums& sums) {
    sums.free += units_of_length(EightFloats(exit - enter), size) & misses;
    sums.passed += EightInts::minus_one_where(misses);
  }
  /// Of eight beams, adds the evidence of all but misses; some of the beams end near the leaf or in it.
  /// @param misses the beams that clearly pass. @returns all misses, for add_misses().
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightMask add_near_end(const Corner& leaf, const Size& size,
                                                               const EightEnds<D>& beams,
                                                               const EightFloats& enter,
                                                               const EightFloats& exit, EightMask misses,
                                                               const EightMask& live, EightSums& sums,
                                                               ScanEvidence& sum) const {
    const EightMask others = live.without(misses);
    const EightMask is_small = LeafEvidence::is_small(size, beams.sigma);
    const EightFloats exit_or_surface = max_of(exit, enter + (beams.surface & is_small));
    const EightMask is_clearly_free = exit_or_surface < beams.clearly_free_until;
    const EightMask passes = is_clearly_free | (beams.surface == 0.0f);  // Or without return.
    const EightMask holds_end = lie_in(leaf, size, beams.cell).without(is_clearly_free);
    misses = misses | (others & passes);
    const EightMask is_behind_surface = (enter >= beams.range).without(holds_end);
    const EightMask has_evidence = others.without(passes | is_behind_surface.without(is_small));
    sum.ends_before += others.without(passes | has_evidence).count();
    if (has_evidence.set() == 0) return misses;
    EightFloats entry_behind;
    const EightInts evidence =
        near_end(size, beams.range, beams.sigma, enter, exit_or_surface, holds_end, entry_behind) &
        has_evidence;
    const EightInts occupied = max_of(evidence, 0);
    sums.occupied += occupied;
    sums.free += occupied - evidence;
    sums.near += EightInts::minus_one_where(has_evidence);
    sum.misses += has_evidence.without(holds_end | is_behind_surface).count();
    const EightMask hits = holds_end & has_evidence;
    if (hits.set() == 0) return misses;
    const EightMask resolved = hits & is_resolvable(size, beams.sigma);
    sum.hits += hits.count();
    sum.resolvable_hits += has_cone_ ? (resolved & fits_child(size, beams.range)).count() : resolved.count();
    sum.partial_hits += (resolved & is_partial_hit(size, beams.sigma, entry_behind)).count();
    return misses;
  }
  /// Adds up the misses of a packet's rays for each child that they cross.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void weigh_passes(const Size& size, Packet& packet) const {
    constexpr std::size_t kLast = kNumChildren - 1;
    packet.resolvable = size.resolves_all    ? 0xff
                        : size.resolves_some ? is_resolvable(size, beams_.ends_of(packet.beams).sigma).set()
                                             : 0;
#pragma GCC unroll 8
    for (std::size_t c = 0; c < kNumChildren; c += 4)  // The last again if there are no four left.
      sums_of(passed_units(size, packet, c), passed_units(size, packet, std::min(c + 1, kLast)),
              passed_units(size, packet, std::min(c + 2, kLast)),
              passed_units(size, packet, std::min(c + 3, kLast)))
          .store(packet.free.data() + c);
    packet.has_passed = true;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static EightInts passed_units(const Size& size,
                                                                                    const Packet& packet,
                                                                                    std::size_t child) {
    const EightFloats enter = EightFloats::load(packet.enter[child].data());
    const EightFloats exit = EightFloats::load(packet.exit[child].data());
    return units_of_length(EightFloats(exit - enter), size) & (exit > enter);
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const Sensor& sensor_;
  const CubicTable& inside_table_ = BeamWeight::probability_inside_table();
  int width_;
  bool has_cone_;  // Beams are cones, see BeamSensorModel::cone_width().
  float noise_sigmas_;
  std::vector<Size> sizes_;  // Of levels from the finest up to 0.
};

}  // namespace ndtree
