// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What one beam is worth to a cell, and what a cell's collected evidence makes of its occupancy.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_logs.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/rounded.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

struct EvidenceOptions {
  double evidence_memory = 200.0;  ///< A cell remembers evidence of this weight; older fades [nats].
  double free_memory = 50.0;       ///< So much if it knows of nothing but free space [nats].
  double scan_beams = 64.0;        ///< Beams of one scan that count in a cell if all of them passed it.
  double known_evidence = 50.0;    ///< A cell that knows this much counts fewer beams of a scan [nats]:
  double sample_beams = 0.5;  ///< so many for each smallest cell side by side in it; others 5 times as many.
  double evidence_prior = 0.5;   ///< Evidence of both kinds that every cell begins with [nats].
  double inherited_beams = 2.0;  ///< Beams, spread evenly, that count with the scan that shares evidence out.
  double change_probability = 1e-5;  ///< A streak of scans less likely than this is a change; 0: never.
  double evidence_half_life = 0.0;   ///< A cell's evidence halves in so many scans of it; 0: never.
  double noise_sigmas = 1.0;         ///< No split makes cells smaller than this many standard deviations.

  /// Calls `visit(name, value, bounds)` for each. @param options of this kind, const or not.
  template <class Options, class Visit>
  static void for_each_bounded(Options& options, Visit&& visit) {
    visit("evidence_memory", options.evidence_memory, OptionBounds{1.0, 255.0, " nats"});
    visit("free_memory", options.free_memory, OptionBounds{1.0, 255.0, " nats"});
    visit("scan_beams", options.scan_beams, OptionBounds{1.0, 4e9});
    visit("known_evidence", options.known_evidence, OptionBounds{1.0, 1e9, " nats"});
    visit("sample_beams", options.sample_beams, OptionBounds{1e-3, 1e12});
    visit("evidence_prior", options.evidence_prior, OptionBounds{1e-6, 1e6, " nats"});
    visit("inherited_beams", options.inherited_beams, OptionBounds{0.0, 1e9});
    visit("change_probability", options.change_probability, OptionBounds{0.0, 1.0 - 1e-6});
    visit("evidence_half_life", options.evidence_half_life, OptionBounds{0.0, 1e9, " scans"});
    visit("noise_sigmas", options.noise_sigmas, OptionBounds{0.0, 1e6});
  }
  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const { for_each_bounded(*this, require_within); }
};

/// Mean length of the chords that random straight lines cut out of a unit cube of this dimension: for a
/// convex body of volume V and surface S it is D (k_D / k_(D-1)) V / S, k_D being the volume of the unit ball
/// (Cauchy). Pi / 4 in 2-D, 2 / 3 in 3-D.
[[nodiscard]] constexpr double mean_chord_of_unit_cube(int dim) {
  constexpr double kPi = 3.14159265358979323846;
  const auto unit_ball = [](int n) {
    double volume = n % 2 == 0 ? 1.0 : 2.0;
    for (int i = n % 2 == 0 ? 2 : 3; i <= n; i += 2) volume *= 2.0 * kPi / i;
    return volume;
  };
  return unit_ball(dim) / (2.0 * unit_ball(dim - 1));
}

/// One in so many of the beams through a node crosses one of its children, in the mean: of N^D children, a
/// beam passes through about N.
template <class Tree>
inline constexpr int kShareDivisor = Tree::kNumChildren / Tree::kBranching;

/// Weighs beams and turns a cell's evidence E+ (for occupied) and E- (for free) into log-odds:
///   log((E+ + prior) / (E- + prior)), within [log_odds_min, log_odds_max].
/// A beam adds the inverse sensor model's log-odds to one of the two: its part above 0 to E+, times the
/// probability that the surface is where it was measured, its part below 0 to E-.
///
/// A recursive Bayes update adds up E+ - E-, and must be clamped so that a cell can change its mind; the
/// clamp forgets how *often* a cell was passed and hit, and then a few grazing beams or wrong hits tip it.
/// The ratio keeps the share of beams that end in the cell, the posterior mean of rho under a Beta prior (see
/// PartialOccupancyModel), and it is 0 where the unclamped sum is 0: the same sensor model, but without loss
/// of memory.
class EvidenceModel {
 public:
  EvidenceModel(const EvidenceOptions& options, const SensorOptions& sensor)
      : options_(options),
        log_odds_min_(static_cast<float>(sensor.log_odds_min)),
        log_odds_max_(static_cast<float>(sensor.log_odds_max)),
        odds_min_(std::exp(sensor.log_odds_min)),
        odds_max_(std::exp(sensor.log_odds_max)),
        prior_(options.evidence_prior / EvidenceCell::kUnit),
        logs_(EvidenceLogs::of_prior(prior_)),
        hit_(ndtree::log_odds(sensor.probability_max)),
        miss_(units(-ndtree::log_odds(sensor.probability_min))),
        memory_(units(options.evidence_memory)),
        free_memory_(units(std::min(options.free_memory, options.evidence_memory))),
        free_memory_beams_(static_cast<std::uint32_t>(
            std::clamp<std::int64_t>(free_memory_ / miss_, 1, EvidenceCell::kMaxCount))),
        scan_beams_(static_cast<std::uint32_t>(std::min(options.scan_beams, 4e9))),
        known_(units(std::min(options.known_evidence, 1e9))),
        kept_(options.evidence_half_life > 0.0 ? std::exp2(-1.0 / options.evidence_half_life) : 1.0),
        settled_(settled_cell()) {}

  /// Evidence for free space from a beam that passed a cell on a way of mean length, in EvidenceCell::kUnit.
  [[nodiscard]] std::int64_t of_miss() const { return miss_; }
  /// Adds what a beam says near its end point.
  /// @param nats the inverse sensor model's log-odds that the cell is occupied, |nats| < 1e6.
  /// @param inside probability_inside() of the cell: what evidence that it is occupied is worth.
  static void add(ScanEvidence& sum, float nats, float inside) {
    constexpr auto kUnitsPerNat = static_cast<float>(1.0 / EvidenceCell::kUnit);
    const float weight = nats > 0.0f ? inside : 1.0f;
    const std::int64_t units = nearest_integer(weight * nats * kUnitsPerNat);
    sum.occupied += std::max<std::int64_t>(units, 0);
    sum.free -= std::min<std::int64_t>(units, 0);
  }

#ifdef NDTREE_HAS_EIGHTS
  /// What add() adds, of eight beams, to the last bit: for occupied space if > 0, else less so much for free.
  NDTREE_BY_EIGHTS [[nodiscard]] static NDTREE_ALWAYS_INLINE __m256i units_of(__m256 nats, __m256 inside) {
    constexpr auto kUnitsPerNat = static_cast<float>(1.0 / EvidenceCell::kUnit);
    const __m256 is_for = _mm256_cmp_ps(nats, _mm256_setzero_ps(), _CMP_GT_OQ);
    const __m256 weight = _mm256_blendv_ps(_mm256_set1_ps(1.0f), inside, is_for);
    return _mm256_cvtps_epi32(_mm256_mul_ps(_mm256_mul_ps(weight, nats), _mm256_set1_ps(kUnitsPerNat)));
  }
#endif

  /// Probability that a surface is in the cell in which it was measured, u standard deviations wide, in the
  /// mean over places in the cell: erf(u / sqrt 2) - sqrt(2 / pi) (1 - exp(-u² / 2)) / u.
  [[nodiscard]] static double probability_inside(double u) {
    constexpr double kSqrtHalf = 0.70710678118654752;
    constexpr double kSqrt2OverPi = 0.79788456080286536;
    return std::erf(u * kSqrtHalf) - kSqrt2OverPi * (1.0 - std::exp(-0.5 * u * u)) / u;
  }

  /// probability_inside() of cells at least one standard deviation wide, by 1 / u, within 1e-5.
  [[nodiscard]] static const CubicTable& probability_inside_table() {
    static const CubicTable table(
        1.0, [](double sigmas) { return sigmas == 0.0 ? 1.0 : probability_inside(1.0 / sigmas); });
    return table;
  }

  /// @pre both are in [0, EvidenceCell::kMaxEvidence].
  [[nodiscard]] NDTREE_ALWAYS_INLINE float log_odds_of(std::int64_t occupied, std::int64_t free) const {
    return std::clamp((*logs_)[occupied] - (*logs_)[free], log_odds_min_, log_odds_max_);
  }

  /// The odds that a cell is occupied: exp(log-odds), but for rounding. 1 if it was never observed.
  [[nodiscard]] double odds_of(const EvidenceCell& cell) const {
    if (!cell.observed()) return 1.0;
    return std::clamp((static_cast<double>(cell.occupied_evidence()) + prior_) /
                          (static_cast<double>(cell.free_evidence()) + prior_),
                      odds_min_, odds_max_);
  }

  /// A cell with this evidence, faded to what it can remember: the ratio stays, but for rounding.
  NDTREE_ALWAYS_INLINE void assign(EvidenceCell& cell, std::int64_t occupied, std::int64_t free) const {
    fade(occupied, free);
    cell.set_evidence(occupied, free, log_odds_of(occupied, free));
  }

  /// Adds the joint evidence of a scan. @returns whether the cell changed.
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const ScanEvidence& scan) const {
    return scan.hits == 0 && scan.occupied == 0 && stays_free_alone(cell)
               ? update_free(cell, scan.free, scan.misses)
               : update_any(cell, scan);
  }
  NDTREE_ALWAYS_INLINE bool update(EvidenceCell& cell, const PassedEvidence& passed) const {
    return stays_free_alone(cell) ? update_free(cell, passed.free, passed.misses)
                                  : update_any(cell, ScanEvidence::of(passed));
  }

  /// What beams say about the parts of a cell that they passed, of which too little was seen yet.
  /// @returns whether the cell changed.
  bool remember(EvidenceCell& cell, std::uint32_t parts, const ScanEvidence& scan) const {
    const EvidenceCell before = cell;
    cell.set_partly_seen(parts, std::min(part(cell.free_evidence(), kept_) + scan.free, free_memory_));
    return cell != before;
  }

  /// Beams of one scan are much alike: of those that say of nothing but free space, a cell counts
  /// `scan_beams`.
  NDTREE_ALWAYS_INLINE void limit(ScanEvidence& scan) const {
    if (scan.beams <= scan_beams_ && scan.free <= scan_beams_ * miss_) return;  // Most.
    if (scan.hits > 0 || scan.occupied > 0) return;
    scan.free = std::min(scan.free, scan_beams_ * miss_);
    scan.misses = std::min(scan.misses, scan_beams_);
    scan.beams = std::min(scan.beams, scan_beams_);
  }
  /// Whether limit() may change what so many beams say, of any ways through a cell.
  [[nodiscard]] bool may_limit(std::uint32_t beams) const {
    constexpr std::uint32_t kLongestWay = 8;  // In mean_chord_of_unit_cube(): up to eight dimensions.
    return beams > scan_beams_ / kLongestWay;
  }
  /// Whether more beams that say of nothing but free space would change nothing in what limit() leaves.
  [[nodiscard]] bool is_full(const ScanEvidence& scan) const {
    return scan.misses >= scan_beams_ && scan.free >= scan_beams_ * miss_;
  }
  /// Whether scans of which all beams pass the cell leave it as it is: it knows as much free space as a cell
  /// can remember, and nothing else.
  [[nodiscard]] bool is_settled(const EvidenceCell& cell) const {
    return cell.is_as_free_as(settled_) && forgets_nothing();
  }

  /// The cell that is, but for its log-odds; none is unless the model forgets nothing.
  [[nodiscard]] const EvidenceCell& settled() const { return settled_; }
  [[nodiscard]] bool forgets_nothing() const { return kept_ == 1.0; }

  /// Whether the cell knows so much that of a scan a sample will do. The beams of a scan are much alike, and
  /// what a cell remembers is limited: the fewer it takes of each scan, the more scans it remembers.
  [[nodiscard]] bool is_known(const EvidenceCell& cell) const {
    return cell.occupied_evidence() + cell.free_evidence() >= known_;
  }
  /// Beams of a scan that count in a cell, for each smallest cell beside each other in it.
  [[nodiscard]] double sample_beams(bool is_known) const {
    constexpr double kLearning = 5.0;
    return is_known ? options_.sample_beams : kLearning * options_.sample_beams;
  }

  /// Whether the last scans contradict the cell for so long that the world must have changed there. A cell
  /// that holds a piece of a surface is both hit and passed, scan by scan; a streak of k scans that all
  /// passed it has the probability (1 - rho)^k, rho being the share of hits so far. Beams of a few
  /// consecutive scans are too much alike for that to hold, so that no shorter streak than
  /// kLeastScansOfChange counts.
  [[nodiscard]] bool has_changed(const EvidenceCell& cell) const {
    if (!has_contradiction(cell) || options_.change_probability == 0.0) return false;
    const bool hit = cell.streak_is_of_hits();
    constexpr double kPriorBeams = 0.5;
    const double hits = effective_hits(cell) + kPriorBeams;
    const double misses = effective_misses(cell) + kPriorBeams;
    return std::pow((hit ? hits : misses) / (hits + misses), cell.streak()) < options_.change_probability;
  }

  /// Whether children of a cell may know anything from it.
  [[nodiscard]] static bool has_heirs(const EvidenceCell& parent) {
    return parent.observed() || parent.is_partly_seen();
  }
  /// What a child knows from its parent. Free evidence is shared out as this scan's beams are: most earlier
  /// beams took much the same ways. `inherited_beams` more beams, spread evenly, count with them, and a
  /// twentieth is shared out evenly. Where the hits were is not known, so all children take as much of their
  /// evidence, but those of a free cell never more than of the free: they are as free as their parent. Of a
  /// child of a free cell to which less than one beam is due, nothing is known.
  /// @param share_divisor one in so many of a parent's beams crosses one of its children, in the mean.
  /// @param passed of this scan's `beams` in the parent, those that passed the child.
  ///
  /// Free space is claimed only where it was seen: of a parent that was not covered, nothing is known of a
  /// child that would be free and that none of this scan's beams has passed.
  /// @param cell_part of the parent that the child lies in: if it was but partly seen, what is known of it is
  ///   known of those parts alone.
  /// @param is_finest the child cannot be divided: a beam sees all of it.
  [[nodiscard]] EvidenceCell inherited(const EvidenceCell& parent, int share_divisor, std::size_t passed,
                                       std::size_t beams, int cell_part = 0, bool is_finest = true) const {
    EvidenceCell child;
    const bool was_seen = parent.is_partly_seen() && (parent.seen_parts() >> cell_part & 1u) != 0;
    if (!parent.observed() && !was_seen) return child;
    const double mean = 1.0 / share_divisor;
    const double share = share_of_ways(mean, static_cast<double>(passed), static_cast<double>(beams));
    const std::int64_t free = part(parent.free_evidence(), share);
    const bool may_be_unknown = parent.state() != CellState::occupied;
    if (may_be_unknown && free < miss_) return child;
    const double share_of_hits = may_be_unknown ? std::min(mean, share) : mean;
    assign(child, part(parent.occupied_evidence(), share_of_hits), free);
    child.set_counts(static_cast<std::uint32_t>(part(parent.hits(), share_of_hits)),
                     static_cast<std::uint32_t>(part(parent.misses(), share)));
    const bool is_covered = parent.observed() && parent.is_covered();
    if (!is_covered && !was_seen && passed == 0 && child.state() == CellState::free) return EvidenceCell();
    child.set_covered(is_covered || is_finest);
    return child;
  }

  /// Whether smaller cells, for which a scan asks, would most likely join again after it:
  /// - in free space, if so much is known of it that even where the hits are it would stay free, if nobody
  ///   passed there: as far as two levels below;
  /// - in an occupied cell that few beams have passed, if those of the scan could not make a child free.
  /// More beams that end in free space never make that true.
  /// @pre splitting is asked for. @param share_divisor as in inherited(). @param levels there are below.
  [[nodiscard]] bool splits_in_vain(const EvidenceCell& cell, const ScanEvidence& scan, int share_divisor,
                                    int levels) const {
    constexpr double kFreeOdds = 0.75;
    constexpr double kFewMisses = 12.0;
    constexpr double kManyTimes = 3.0;
    const double mean = 1.0 / share_divisor;
    const auto occupied = static_cast<double>(cell.occupied_evidence());
    const auto free = static_cast<double>(cell.free_evidence());
    const auto miss = static_cast<double>(miss_);
    switch (cell.state()) {
      case CellState::free: {
        const double of_child = share_of_ways(mean, 0.0, scan.beams);
        const double share = levels > 1 ? of_child * of_child : of_child;
        return share * (rounded(kFreeOdds * free) - occupied) >=
               static_cast<double>(scan.occupied) + rounded((1.0 - kFreeOdds) * prior_);
      }
      case CellState::unknown:
        return false;
      case CellState::occupied:
        break;
    }
    const double passes =
        rounded(share_of_ways(mean, scan.misses, scan.beams) * free) + rounded(miss * scan.misses);
    return free <= kFewMisses * miss && mean * occupied > kManyTimes * passes;
  }
  /// What a split leaves of a cell whose children join again, as update(): of what beams said that went
  /// through parts which those of the scan did not reach, as much is forgotten as the children would have
  /// forgotten; in free space of the hits as well. The streak ends.
  /// @returns whether the cell changed.
  bool update_whole(EvidenceCell& cell, const ScanEvidence& scan) const {
    constexpr double kNotReached = 0.75;  // Of a cell, by a beam that ends in it.
    const double reached = scan.beams - rounded(kNotReached * scan.hits);
    const double kept = kept_ * share_of_ways(1.0, reached, scan.beams);
    const double kept_hits = cell.state() == CellState::free ? kept : kept_;
    EvidenceCell now;
    now.set_covered(cell.is_covered());
    assign(now, part_up(cell.occupied_evidence(), kept_hits) + scan.occupied,
           part_up(cell.free_evidence(), kept) + scan.free);
    set_counts(now, static_cast<std::uint32_t>(part_up(cell.hits(), kept_hits)) + scan.hits,
               static_cast<std::uint32_t>(part_up(cell.misses(), kept)) + scan.misses);
    return replace(cell, now);
  }

  /// The evidence of two cells of one place, of which neither is blank. Their streaks end.
  /// @param parts if neither was observed, and the parts that were seen are still not enough.
  [[nodiscard]] EvidenceCell joined(const EvidenceCell& one, const EvidenceCell& other,
                                    const std::optional<std::uint32_t>& parts) const {
    EvidenceCell both;
    const std::int64_t free = one.free_evidence() + other.free_evidence();
    if (parts) {
      both.set_partly_seen(*parts, std::min(free, free_memory_));
      return both;
    }
    assign(both, one.occupied_evidence() + other.occupied_evidence(), free);
    set_counts(both, one.hits() + other.hits(), one.misses() + other.misses());
    both.set_covered((one.observed() && one.is_covered()) || (other.observed() && other.is_covered()));
    return both;
  }
  /// A cell of a model with other options, as far as this one can remember; of the same options, the same.
  [[nodiscard]] EvidenceCell adopted(EvidenceCell cell) const {
    if (cell.observed())
      assign(cell, cell.occupied_evidence(), cell.free_evidence());
    else if (cell.is_partly_seen())
      cell.set_partly_seen(cell.seen_parts(), std::min(cell.free_evidence(), free_memory_));
    return cell;
  }
  /// A child's part of a cell of which no more is known than of its siblings; the parent of equal ones, see
  /// EvidenceMergeRule, is the cell again, but for rounding up.
  [[nodiscard]] EvidenceCell part_of(const EvidenceCell& cell, int share_divisor, int cell_part) const {
    EvidenceCell part;
    const bool was_seen = cell.is_partly_seen() && (cell.seen_parts() >> cell_part & 1u) != 0;
    if (!cell.observed() && !was_seen) return part;
    const auto share = [share_divisor](std::int64_t whole) {
      return (whole + share_divisor - 1) / share_divisor;
    };
    std::int64_t occupied = share(cell.occupied_evidence());
    std::int64_t free = share(cell.free_evidence());
    if (occupied == free && cell.occupied_evidence() != cell.free_evidence())  // The state stays.
      ++(cell.occupied_evidence() > cell.free_evidence() ? occupied : free);
    assign(part, occupied, free);
    set_counts(part, static_cast<std::uint32_t>(share(cell.hits())),
               static_cast<std::uint32_t>(share(cell.misses())));
    part.set_covered(cell.observed() && cell.is_covered());
    return part;
  }

  /// Beams that evidence for free space is worth.
  [[nodiscard]] double beams_of(std::int64_t free) const {
    return static_cast<double>(free) / static_cast<double>(miss_);
  }
  [[nodiscard]] double noise_sigmas() const { return options_.noise_sigmas; }
  /// Beams that a cell's evidence is worth, of those that end in it and of those that pass it.
  [[nodiscard]] double effective_hits(const EvidenceCell& cell) const {
    return static_cast<double>(cell.occupied_evidence()) * EvidenceCell::kUnit / hit_;
  }
  [[nodiscard]] double effective_misses(const EvidenceCell& cell) const {
    return beams_of(cell.free_evidence());
  }

 private:
  static constexpr std::uint32_t kLeastScansOfChange = 12;

  /// Whether a streak that is long enough says the opposite of the cell.
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool has_contradiction(const EvidenceCell& cell) {
    return cell.streak() >= kLeastScansOfChange &&
           cell.state() == (cell.streak_is_of_hits() ? CellState::free : CellState::occupied);
  }
  /// Whether update_free() does, where beams say of nothing but free space.
  [[nodiscard]] NDTREE_ALWAYS_INLINE bool stays_free_alone(const EvidenceCell& cell) const {
    return cell.knows_free_alone() && forgets_nothing();
  }
  /// update() of most cells, for which update_any() does the same.
  NDTREE_ALWAYS_INLINE bool update_free(EvidenceCell& cell, std::int64_t free, std::uint32_t misses) const {
    EvidenceCell now = cell;
    const std::int64_t all = std::min(cell.free_evidence() + free, free_memory_);
    now.set_free(all, std::min(cell.misses() + misses, free_memory_beams_), log_odds_of(0, all));
    return replace(cell, now);
  }
  /// @returns whether that is another cell.
  NDTREE_ALWAYS_INLINE static bool replace(EvidenceCell& cell, const EvidenceCell& now) {
    const EvidenceCell before = cell;
    cell = now;
    if (!now.knows_the_same(before)) return true;
    return now.log_odds() != before.log_odds();  // A file may say others than those of its evidence.
  }
  /// update() of any cell.
  NDTREE_ALWAYS_INLINE bool update_any(EvidenceCell& cell, const ScanEvidence& scan) const {
    EvidenceCell now = cell;
    now.count_scan(scan.hits > 0, scan.misses > 0);
    if (has_contradiction(now)) now = after_contradiction(now);
    std::int64_t occupied = now.occupied_evidence();
    std::int64_t free = now.free_evidence();
    if (!forgets_nothing()) {
      occupied = part(occupied, kept_);
      free = part(free, kept_);
    }
    occupied += scan.occupied;
    free += scan.free;
    fade(occupied, free);
    const std::uint32_t hits = now.hits() + scan.hits;
    const std::uint32_t misses = now.misses() + scan.misses;
    const float log_odds = log_odds_of(occupied, free);
    if (occupied > 0 || scan.hits > 0) {
      now.set_evidence(occupied, free, log_odds);
      now.set_counts(hits, misses);
    } else {
      now.set_free(free, std::min(misses, free_memory_beams_), log_odds);
    }
    return replace(cell, now);
  }
  /// To what a cell can remember.
  NDTREE_ALWAYS_INLINE void fade(std::int64_t& occupied, std::int64_t& free) const {
    if (occupied == 0) free = std::min(free, free_memory_);
    const std::int64_t sum = occupied + free;
    if (sum <= memory_) return;
    occupied = faded(occupied, memory_, sum);
    free = faded(free, memory_, sum);
  }

  /// Counts of a cell that has its evidence: without any for occupied space, no hit is left that could be
  /// contradicted.
  NDTREE_ALWAYS_INLINE void set_counts(EvidenceCell& cell, std::uint32_t hits, std::uint32_t misses) const {
    if (cell.occupied_evidence() > 0)
      cell.set_counts(hits, misses);
    else
      cell.set_counts(0, std::min(misses, free_memory_beams_));
  }

  /// A cell that knows as much free space as a cell can remember, but for its log-odds.
  [[nodiscard]] EvidenceCell settled_cell() const {
    EvidenceCell cell;
    cell.set_evidence(0, free_memory_, log_odds_min_);
    cell.set_counts(0, free_memory_beams_);
    return cell;
  }

  /// Takes and gives a copy, so that whoever asks has its cell in registers.
  [[nodiscard]] NDTREE_NEVER_INLINE EvidenceCell after_contradiction(EvidenceCell cell) const {
    if (has_changed(cell)) forget_but_streak(cell);
    return cell;
  }
  /// Leaves a cell with one beam's evidence for each scan of its streak.
  void forget_but_streak(EvidenceCell& cell) const {
    const bool hit = cell.streak_is_of_hits();
    const std::int64_t one = hit ? units(hit_) : miss_;
    const std::int64_t evidence = hit ? cell.occupied_evidence() : cell.free_evidence();
    const std::int64_t recent = std::min(evidence, cell.streak() * one);
    assign(cell, hit ? recent : 0, hit ? 0 : recent);
    cell.set_counts(hit ? cell.streak() : 0, hit ? 0 : cell.streak());
  }

  [[nodiscard]] static std::int64_t part(std::int64_t whole, double share) {
    return static_cast<std::int64_t>(static_cast<double>(whole) * share);
  }
  /// The same rounded up: what was seen once is not forgotten.
  [[nodiscard]] static std::int64_t part_up(std::int64_t whole, double share) {
    return whole - part(whole, 1.0 - share);
  }
  /// The share of earlier beams' ways that is due to a part of a cell, see inherited().
  /// @param mean of all parts. @param passed of this scan's `beams`, those that passed the part.
  [[nodiscard]] double share_of_ways(double mean, double passed, double beams) const {
    constexpr double kOtherWays = 0.05;
    const double share_now =
        (passed + rounded(options_.inherited_beams * mean)) / (beams + options_.inherited_beams);
    return rounded(kOtherWays * mean) + rounded((1.0 - kOtherWays) * share_now);
  }
  [[nodiscard]] static std::int64_t units(double nats) { return std::llround(nats / EvidenceCell::kUnit); }
  /// part * whole / sum, rounded down: what nothing adds to fades to nothing. Below 2^53 it is exact, as
  /// quotients are then farther from whole numbers than they are rounded.
  [[nodiscard]] static std::int64_t faded(std::int64_t part, std::int64_t whole, std::int64_t sum) {
    return static_cast<std::int64_t>(static_cast<double>(part * whole) / static_cast<double>(sum));
  }

  EvidenceOptions options_;
  float log_odds_min_;
  float log_odds_max_;
  double odds_min_;
  double odds_max_;
  double prior_;  // In kUnit.
  std::shared_ptr<const EvidenceLogs> logs_;
  double hit_;           // [nats]
  std::int64_t miss_;    // In kUnit.
  std::int64_t memory_;  // In kUnit.
  std::int64_t free_memory_;
  std::uint32_t free_memory_beams_;
  std::uint32_t scan_beams_;
  std::int64_t known_;
  double kept_;  // From one scan to the next.
  EvidenceCell settled_;
};

}  // namespace ndtree
