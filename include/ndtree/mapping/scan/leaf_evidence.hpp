// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The evidence of a scan's beams for one leaf: sums of integers over the beams that cross it.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/scan/beam_lists.hpp"
#include "ndtree/mapping/scan/crossings.hpp"
#include "ndtree/mapping/scan/packed_beams.hpp"
#include "ndtree/mapping/scan/partition.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Strategy. Most beams clearly pass a leaf: a vector loop adds up their misses from entry and exit alone.
/// Only for vectors with a beam that ends near the leaf are the ends looked up (add_near_end()). Evidence by
/// where a beam's end point lies:
/// - clearly behind the leaf: a miss, evidence for free space in proportion to the length inside the leaf;
/// - near the leaf, within the noise: the inverse sensor model's evidence, and a miss if the end is behind;
/// - in the leaf: a hit, and the inverse sensor model's evidence;
/// - before the leaf, by at most three standard deviations: the inverse sensor model's evidence, but only for
///   cells as small as the noise, or smallest cells. A coarse cell behind a surface is not the surface.
///
/// A hit is resolvable if smaller cells would be larger than the noise, and deep if the beam's length in the
/// leaf, or the leaf itself, exceeds what the noise explains. A beam without return, or cut at the maximum
/// range, is a miss of every leaf that it crosses up to its end: a surface there would have returned it.
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
  static constexpr float kWidestSigma = static_cast<float>(1.0 / ScanBeams<D>::kThinnestSurface);
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
        noise_sigmas_(static_cast<float>(model.noise_sigmas())) {
    sizes_.reserve(static_cast<std::size_t>(1 - geometry.finest_level()));
    for (int level = geometry.finest_level(); level <= 0; ++level) {
      const double size = geometry.cell_size(level);
      const bool is_finest = level == geometry.finest_level();
      Size of_level;
      of_level.cell = static_cast<float>(size);
      of_level.per_cell = 1.0f / of_level.cell;
      of_level.child = is_finest ? -1.0f : static_cast<float>(geometry.cell_size(level - 1));
      of_level.units_per_metre =
          static_cast<float>(static_cast<double>(model.miss_evidence()) / (kMeanChord * size));
      of_level.is_inside_alike = beams.largest_sigma() == beams.smallest_sigma();
      of_level.inside = inside(of_level, beams.smallest_sigma());
      of_level.small = is_finest ? 0.0f : of_level.cell;
      of_level.resolves_all = of_level.child >= noise_sigmas_ * beams.largest_sigma();
      of_level.resolves_some = of_level.child >= noise_sigmas_ * beams.smallest_sigma();
      of_level.fits_32_bits = beams.ends_nearby() && geometry.edge(level) <= ScanBeams<D>::kNearby;
      of_level.edge = of_level.fits_32_bits ? static_cast<std::int32_t>(geometry.edge(level)) : 0;
      of_level.goes_by_eights = beams.width() >= 8 && of_level.fits_32_bits;
      of_level.is_simple = of_level.goes_by_eights && beams.are_alike();
      sizes_.push_back(of_level);
    }
  }

  /// Whether every beam of a list passes its node, whatever the size of the cells in it. O(beams).
  /// @param crossings where beams cross the node.
  [[nodiscard]] bool all_pass(const CellCrossings<N, D>& crossings, const BeamList& list) const {
#ifdef NDTREE_HAS_EIGHTS
    if (width_ >= 8)
      return beams_.are_alike() ? all_pass_by_eights<true>(crossings, list)
                                : all_pass_by_eights<false>(crossings, list);
#endif
    for (std::size_t i = 0; i < list.size; ++i)
      if (!(crossings.of(list.beam[i]).exit < beams_.t_free_of(list.beam[i]))) return false;
    return true;
  }

  /// The evidence of a list's beams with numbers below `end` for a leaf of level 0 or below.
  /// @param crossings where beams cross the leaf.
  [[nodiscard]] NDTREE_ALWAYS_INLINE ScanEvidence of(const CellIndex<D>& leaf,
                                                     const CellCrossings<N, D>& crossings,
                                                     const BeamList& list,
                                                     std::uint32_t end = BeamList::kAll) const {
#ifdef NDTREE_HAS_EIGHTS
    const Size& size = size_of(leaf.level);
    // An empty list's size minus 1 is the largest number.
    if (size.is_simple && list.size - 1 < kMostAtOnce)
      return of_eights<true>(leaf, crossings, list, end, size);
#endif
    return of_any(leaf, crossings, list.part(0, list.find(end)));
  }

  /// The evidence of one beam for leaves of one level, 0 or below: the scalar twin of the vector loops.
  class OfBeam {
   public:
    NDTREE_ALWAYS_INLINE OfBeam(const LeafEvidence& all, int level, std::uint32_t beam)
        : all_(all), size_(all.size_of(level)), number_(beam) {}

    /// For a leaf that the beam clearly passes, see ScanBeams::t_free_of().
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
      const bool is_small = size_.small <= kSmallCell * beam.sigma;
      const float end = is_small ? std::max(crossing.exit, enter + beam.surface) : crossing.exit;
      if (end < beam.clear || !beam.is_returned()) return sum.add(passed(crossing));
      const bool holds_end = all_.geometry_.contains(leaf, all_.beams_.end_cell(number_));
      const bool is_behind = !holds_end && enter >= beam.range;
      if (is_behind && !is_small) return;
      const float per_sigma = 1.0f / beam.sigma;
      const float before_end = (enter - beam.range) * per_sigma;
      const float behind_end = (end - beam.range) * per_sigma;
      BeamWeight::add(sum,
                      all_.sensor_.quick_log_odds(
                          before_end, holds_end ? std::max(behind_end, kLeastBehindHit) : behind_end),
                      size_.is_inside_alike ? size_.inside : all_.inside(size_, beam.sigma));
      if (holds_end) {
        ++sum.hits;
        sum.resolvable_hits += is_resolvable();
        sum.deep_hits +=
            is_resolvable() && (before_end < -kNoiseReach || size_.cell > kNoiseReach * beam.sigma);
      } else {
        sum.misses += !is_behind;
      }
      ++sum.beams;
    }

   private:
    /// Whether the beam's noise is small enough for the leaf's children.
    [[nodiscard]] NDTREE_ALWAYS_INLINE bool is_resolvable() const {
      if (size_.resolves_all || !size_.resolves_some) return size_.resolves_all;
      return size_.child >= all_.noise_sigmas_ * all_.beams_.end(number_).sigma;
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
  /// The evidence of a packet's rays with numbers below `end` for a node's child.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_NEVER_INLINE ScanEvidence of(const CellIndex<D>& node, Packet& packet,
                                                                     std::size_t child,
                                                                     std::uint32_t end) const {
    const Size& size = size_of(node.level - 1);
    const __m256 enter = _mm256_load_ps(packet.enter[child].data());
    const __m256 exit = _mm256_load_ps(packet.exit[child].data());
    const std::uint32_t set = packet.set[child] & packet.before(end);
    const __m256i live = detail::lanes_of(set);
    const __m256i zero = _mm256_setzero_si256();
    EightSums sums{zero, zero, zero, zero};
    ScanEvidence sum;
    __m256i misses =
        _mm256_and_si256(live, _mm256_castps_si256(_mm256_cmp_ps(exit, packet.beams.t_free, _CMP_LT_OQ)));
    if ((packet.passing[child] & set) != set)
      misses = add_near_end(child_of(corner_of(node), child, size), size, beams_.ends_of(packet.beams), enter,
                            exit, misses, live, sums, sum);
    sums.free = _mm256_add_epi32(sums.free, _mm256_and_si256(units_of_length(enter, exit, size), misses));
    sums.passed = misses;
    if (size.resolves_some && !size.resolves_all)
      sum.resolvable_misses =
          count(set_of(_mm256_castsi256_ps(misses)) & resolvable(size, beams_.ends_of(packet.beams).sigma));
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
    bool is_inside_alike;   // All beams have equal noise.
    float inside;           // BeamWeight::probability_inside() of the most precise beam.
    float small;            // Edge of the cell; 0 for smallest cells, which are small beside any noise.
  };

  [[nodiscard]] const Size& size_of(int level) const {
    return sizes_[static_cast<std::size_t>(level - geometry_.finest_level())];
  }
  [[nodiscard]] static std::int32_t units_of_length(float ray, const Size& size) {
    return std::max(1, nearest_integer(ray * size.units_per_metre));
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
        sum.add(size.is_simple ? of_eights<true>(leaf, crossings, part, BeamList::kAll, size)
                               : of_eights<false>(leaf, crossings, part, BeamList::kAll, size));
      }
      return sum;
    }
#endif
    for (std::size_t i = 0; i < list.size; ++i)
      OfBeam(*this, leaf.level, list.beam[i]).add(leaf, crossings.of(list.beam[i]), sum);
    return sum;
  }

  /// BeamWeight::probability_inside() of a cell.
  [[nodiscard]] float inside(const Size& size, float sigma) const {
    return inside_table_(std::min(sigma * size.per_cell, kWidestSigma));
  }
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE __m256 inside(const Size& size, __m256 sigma) const {
    return inside_table_(
        _mm256_min_ps(_mm256_mul_ps(sigma, _mm256_set1_ps(size.per_cell)), _mm256_set1_ps(kWidestSigma)));
  }
#endif

#ifdef NDTREE_HAS_EIGHTS
  template <bool kAlike>
  NDTREE_BY_EIGHTS [[nodiscard]] bool all_pass_by_eights(const CellCrossings<N, D>& crossings,
                                                         const BeamList& list) const {
    for (std::size_t i = 0; i < list.size; i += 8) {
      const __m256i live = detail::first_of_eight(list.size - i);
      const std::uint32_t* const beam = list.beam + i;
      const EightCrossings eight = crossings.template of<kAlike>(beam, beams_.rays(beam));
      const __m256 not_passing = _mm256_cmp_ps(eight.exit, eight.t_free, _CMP_NLT_UQ);
      if (!_mm256_testz_si256(_mm256_castps_si256(not_passing), live)) return false;
    }
    return true;
  }
  static constexpr std::size_t kMostAtOnce = 1024;  // Beams, whose sums fit 32 bits.

  /// Sums of eight lanes.
  struct EightSums {
    __m256i occupied, free;  // Evidence.
    __m256i passed, near;    // Minus the number of beams that passed, and of others with evidence.
  };

  /// The evidence of 1 to kMostAtOnce beams, those with numbers below `end`: the bits of OfBeam.
  template <bool kAlike>
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE ScanEvidence of_eights(const CellIndex<D>& leaf,
                                                              const CellCrossings<N, D>& crossings,
                                                              const BeamList& list, std::uint32_t end,
                                                              const Size& size) const {
    const __m256i last = _mm256_set1_epi32(static_cast<int>(std::min(end, ScanBeams<D>::kMostInLoops)));
    const __m256i zero = _mm256_setzero_si256();
    EightSums sums{zero, zero, zero, zero};
    ScanEvidence sum;
    std::size_t i = 0;
    do {
      const std::uint32_t* const beam = list.beam + i;
      const __m256i live = _mm256_and_si256(detail::first_of_eight(list.size - i),
                                            _mm256_cmpgt_epi32(last, detail::load(beam)));
      const EightCrossings at = crossings.template of<kAlike>(beam, beams_.rays(beam));
      __m256i misses =
          _mm256_and_si256(live, _mm256_castps_si256(_mm256_cmp_ps(at.exit, at.t_free, _CMP_LT_OQ)));
      if (!_mm256_testc_si256(misses, live))
        misses = add_near_end(corner_of(leaf), size, beams_.ends(beam), at.enter, at.exit, misses, live, sums,
                              sum);
      sums.free =
          _mm256_add_epi32(sums.free, _mm256_and_si256(units_of_length(at.enter, at.exit, size), misses));
      sums.passed = _mm256_add_epi32(sums.passed, misses);
      if (size.resolves_some && !size.resolves_all)
        sum.resolvable_misses +=
            count(set_of(_mm256_castsi256_ps(misses)) & resolvable(size, beams_.ends(beam).sigma));
      i += 8;
    } while (i < list.size && list.beam[i] < end);
    finish(sums, size, sum);
    return sum;
  }
  /// Adds up the lanes. @param sum has the counts that are not kept in lanes.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE static void finish(const EightSums& sums, const Size& size,
                                                           ScanEvidence& sum) {
    const __m128i all = detail::sums_of(sums.occupied, sums.free, sums.passed, sums.near);
    const auto passed = 0u - static_cast<std::uint32_t>(_mm_extract_epi32(all, 2));
    sum.occupied = static_cast<std::uint32_t>(_mm_cvtsi128_si32(all));
    sum.free = static_cast<std::uint32_t>(_mm_extract_epi32(all, 1));
    sum.misses += passed;
    sum.resolvable_misses += size.resolves_all ? passed : 0;
    sum.beams = passed - static_cast<std::uint32_t>(_mm_extract_epi32(all, 3));
  }
  [[nodiscard]] NDTREE_ALWAYS_INLINE Corner corner_of(const CellIndex<D>& cell) const {
    Corner corner;  // It fits: what beams cross is where they reach, see ScanBeams::ends_nearby().
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
  /// All ones in the lanes whose end cells lie in a leaf.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static __m256i lie_in(const Corner& leaf,
                                                                            const Size& size,
                                                                            const __m256i* cell) {
    __m256i farthest = _mm256_sub_epi32(cell[0], _mm256_set1_epi32(leaf[0]));  // Without sign: before is far.
#pragma GCC unroll 4
    for (std::size_t a = 1; a < D; ++a)
      farthest = _mm256_max_epu32(farthest, _mm256_sub_epi32(cell[a], _mm256_set1_epi32(leaf[a])));
    const __m256i last = _mm256_set1_epi32(size.edge - 1);
    return _mm256_cmpeq_epi32(_mm256_max_epu32(farthest, last), last);
  }
  /// Adds the evidence of eight beams that do not all clearly pass a leaf, but for misses.
  /// @param misses beams that clearly pass. @returns these and other beams that passed; their misses are not
  ///   added.
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE __m256i add_near_end(const Corner& leaf, const Size& size,
                                                             const EightEnds<D>& beams, __m256 enter,
                                                             __m256 exit, __m256i misses, __m256i live,
                                                             EightSums& sums, ScanEvidence& sum) const {
    const __m256i others = _mm256_andnot_si256(misses, live);
    const __m256 sigma = beams.sigma;
    const __m256 range = beams.range;
    const __m256 is_small = _mm256_cmp_ps(_mm256_set1_ps(size.small),
                                          _mm256_mul_ps(_mm256_set1_ps(kSmallCell), sigma), _CMP_LE_OQ);
    const __m256 end = _mm256_max_ps(exit, _mm256_add_ps(enter, _mm256_and_ps(beams.surface, is_small)));
    const __m256 no_return = _mm256_cmp_ps(beams.surface, _mm256_setzero_ps(), _CMP_EQ_OQ);
    const __m256 is_clear = _mm256_cmp_ps(end, beams.clear, _CMP_LT_OQ);
    const __m256 passes_or_not_returned = _mm256_or_ps(is_clear, no_return);
    const __m256 holds_end = _mm256_andnot_ps(is_clear, _mm256_castsi256_ps(lie_in(leaf, size, beams.cell)));
    misses = _mm256_or_si256(misses, _mm256_and_si256(others, _mm256_castps_si256(passes_or_not_returned)));
    const __m256 is_behind = _mm256_andnot_ps(holds_end, _mm256_cmp_ps(enter, range, _CMP_GE_OQ));
    const __m256 says_nothing = _mm256_or_ps(passes_or_not_returned, _mm256_andnot_ps(is_small, is_behind));
    if (_mm256_testc_si256(_mm256_castps_si256(says_nothing), others)) return misses;
    const __m256 says = _mm256_andnot_ps(says_nothing, _mm256_castsi256_ps(others));
    const __m256 per_sigma = _mm256_div_ps(_mm256_set1_ps(1.0f), sigma);
    const __m256 before_end = _mm256_mul_ps(_mm256_sub_ps(enter, range), per_sigma);
    const __m256 behind_end = _mm256_mul_ps(_mm256_sub_ps(end, range), per_sigma);
    const __m256 behind_hit = _mm256_max_ps(behind_end, _mm256_set1_ps(kLeastBehindHit));
    const __m256i evidence = _mm256_and_si256(
        _mm256_castps_si256(says),
        BeamWeight::units_of(
            sensor_.quick_log_odds(before_end, _mm256_blendv_ps(behind_end, behind_hit, holds_end)),
            size.is_inside_alike ? _mm256_set1_ps(size.inside) : inside(size, sigma)));
    const __m256i occupied = _mm256_max_epi32(evidence, _mm256_setzero_si256());
    sums.occupied = _mm256_add_epi32(sums.occupied, occupied);
    sums.free = _mm256_add_epi32(sums.free, _mm256_sub_epi32(occupied, evidence));
    sums.near = _mm256_add_epi32(sums.near, _mm256_castps_si256(says));
    sum.misses += count(set_of(_mm256_andnot_ps(_mm256_or_ps(holds_end, is_behind), says)));
    const unsigned hits = set_of(_mm256_and_ps(holds_end, says));
    if (hits == 0) return misses;
    const unsigned resolved = hits & resolvable(size, sigma);
    sum.hits += count(hits);
    sum.resolvable_hits += count(resolved);
    sum.deep_hits +=
        count(resolved & set_of(_mm256_or_ps(
                             _mm256_cmp_ps(before_end, _mm256_set1_ps(-kNoiseReach), _CMP_LT_OQ),
                             _mm256_cmp_ps(_mm256_set1_ps(size.cell),
                                           _mm256_mul_ps(_mm256_set1_ps(kNoiseReach), sigma), _CMP_GT_OQ))));
    return misses;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static __m256i units_of_length(__m256 enter, __m256 exit, const Size& size) {
    return _mm256_max_epi32(
        _mm256_set1_epi32(1),
        _mm256_cvtps_epi32(_mm256_mul_ps(_mm256_sub_ps(exit, enter), _mm256_set1_ps(size.units_per_metre))));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] unsigned resolvable(const Size& size, __m256 sigma) const {
    return set_of(_mm256_cmp_ps(_mm256_set1_ps(size.child),
                                _mm256_mul_ps(_mm256_set1_ps(noise_sigmas_), sigma), _CMP_GE_OQ));
  }
  /// Adds up the misses of a packet's rays for each child that they cross.
  NDTREE_BY_EIGHTS NDTREE_NEVER_INLINE void weigh_passes(const Size& size, Packet& packet) const {
    constexpr std::size_t kLast = kNumChildren - 1;
    packet.resolvable = size.resolves_all    ? 0xff
                        : size.resolves_some ? resolvable(size, beams_.ends_of(packet.beams).sigma)
                                             : 0;
#pragma GCC unroll 8
    for (std::size_t c = 0; c < kNumChildren; c += 4) {  // The last again if there are no four left.
      const __m128i four =
          detail::sums_of(passed_units(size, packet, c), passed_units(size, packet, std::min(c + 1, kLast)),
                          passed_units(size, packet, std::min(c + 2, kLast)),
                          passed_units(size, packet, std::min(c + 3, kLast)));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(packet.free.data() + c), four);
    }
    packet.has_passed = true;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static __m256i passed_units(const Size& size,
                                                                                  const Packet& packet,
                                                                                  std::size_t child) {
    const __m256 enter = _mm256_load_ps(packet.enter[child].data());
    const __m256 exit = _mm256_load_ps(packet.exit[child].data());
    return _mm256_and_si256(units_of_length(enter, exit, size),
                            _mm256_castps_si256(_mm256_cmp_ps(exit, enter, _CMP_GT_OQ)));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static unsigned set_of(__m256 mask) {
    return static_cast<unsigned>(_mm256_movemask_ps(mask));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] static unsigned count(unsigned set) {
    return static_cast<unsigned>(__builtin_popcount(set));
  }
#endif

  const LatticeGeometry<N, D>& geometry_;
  const ScanBeams<D>& beams_;
  const Sensor& sensor_;
  const CubicTable& inside_table_ = BeamWeight::probability_inside_table();
  int width_;
  float noise_sigmas_;
  std::vector<Size> sizes_;  // Of levels from the finest up to 0.
};

}  // namespace ndtree
