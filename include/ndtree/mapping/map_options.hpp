// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Everything that a map can be told when it is made, and the one table of it.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string_view>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/cell/merge_rule.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/cell/split_test.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/mapping/insert/coverage.hpp"

namespace ndtree {

/// The options of a map, and constants of the method, which no front end offers; see kOptionTable. Those of
/// the sensor, the split test, the merge rules, evidence and coverage are its bases.
struct MapOptions : SensorOptions,
                    SplitOptions,
                    MergeOptions,
                    EvidenceOptions,
                    EvidenceMergeOptions,
                    CoverageOptions {
  double min_cell_size = 0.05;  ///< Leaves are never split below this edge length [m].
  /// No larger cell is ever updated [m]. The map uses the largest min_cell_size * N^k that is not above it.
  double max_cell_size = 1.6;
  /// A scan with which the map would hold more is refused [bytes]; 0: three quarters of the machine's memory.
  double max_memory = 0.0;

  /// @throws OptionError naming the first option that is out of bounds.
  void validate() const;

  /// Bytes that the map may hold, see max_memory.
  [[nodiscard]] std::size_t memory_limit() const {
    if (max_memory == 0.0) return machine_memory() / 4 * 3;
    return max_memory < 0x1p63 ? static_cast<std::size_t>(max_memory) : kUnlimitedMemory;
  }

  /// Levels between the smallest and the largest cell for N children per axis. Sizes are decimal numbers that
  /// no double holds exactly: a ratio within 1e-9 of a power of N is taken for that power.
  [[nodiscard]] int num_levels(int branching) const {
    const double largest = max_cell_size / min_cell_size * (1.0 + 1e-9);
    int levels = 0;
    for (double ratio = branching; ratio <= largest && std::isfinite(ratio); ratio *= branching) ++levels;
    return levels;
  }
};

/// Kinds of maps, by their refinement, that read an option: bits.
enum MapKinds : unsigned { kOfEvidence = 1, kOfPaper = 2, kOfFixed = 4, kOfOctomap = 8 };

/// An option, for every front end: bindings, stub, flags, files of TOML, parameters of ROS, help and pages.
struct OptionRow {
  const char* name;
  double MapOptions::*member;  ///< Its default is the member's own.
  OptionBounds bounds;         ///< With the unit.
  unsigned kinds;              ///< Of maps that read it, of MapKinds.
  const char* placeholder;     ///< What is typed behind a flag; nullptr: a constant of the method.
  const char* help;            ///< What it is; of a constant, where its value comes from.
  const char* when;            ///< When to touch it.

  /// No front end offers it. It is a member because map files carry it, so that an old map goes on as it was
  /// made, and because tests vary it.
  [[nodiscard]] constexpr bool is_constant() const { return placeholder == nullptr; }
  /// @param refinement as a refinement's kName, or "octomap".
  [[nodiscard]] constexpr bool is_read_by(std::string_view refinement) const {
    const unsigned kind = refinement == "evidence" ? kOfEvidence
                          : refinement == "paper"  ? kOfPaper
                          : refinement == "fixed"  ? kOfFixed
                                                   : kOfOctomap;
    return (kinds & kind) != 0;
  }
};

namespace detail {

/// All options and constants, in the order of map files.
constexpr std::array<OptionRow, 30> option_table() {
  using O = MapOptions;
  constexpr unsigned kOurs = kOfEvidence | kOfPaper | kOfFixed;
  constexpr unsigned kAdaptive = kOfEvidence | kOfPaper;
  constexpr unsigned kEvery = kOurs | kOfOctomap;
  constexpr double kAnyLarge = std::numeric_limits<double>::infinity();
  constexpr auto option = [](const char* name, double O::*member, OptionBounds bounds, unsigned kinds,
                             const char* placeholder, const char* help, const char* when) {
    return OptionRow{name, member, bounds, kinds, placeholder, help, when};
  };
  // `source` says where the value comes from.
  constexpr auto constant = [](const char* name, double O::*member, OptionBounds bounds, unsigned kinds,
                               const char* source) {
    return OptionRow{name, member, bounds, kinds, nullptr, source, ""};
  };
  return {{
      option("min_cell_size", &O::min_cell_size, {1e-9, 1e6, " m"}, kEvery, "M",
             "Edge of the smallest cells; of all cells where they are fixed.",
             "the finest detail that you can use"),
      option("max_cell_size", &O::max_cell_size, {1e-9, 1e9, " m"}, kAdaptive, "M",
             "Edge of the largest cells that are updated; rounded down to min_cell_size * branching**k.",
             "hardly ever"),
      option("range_sigma", &O::range_sigma, kRangeSigmaBounds, kOurs, "M",
             "Standard deviation of a range; by default refinement at least 3/5 of a smallest cell.",
             "as ndtree calibrate says"),
      option("range_sigma_quadratic", &O::range_sigma_quadratic, {0.0, 1e6, " 1/m"}, kOurs, "PER_M",
             "Growth of that deviation with the squared range.", "depth cameras: 0.001 to 0.0015"),
      option("probability_min", &O::probability_min, {1e-6, 0.49}, kEvery, "P",
             "Lowest probability that a single beam gives a cell.", "what one miss says"),
      option("probability_max", &O::probability_max, {0.51, 1.0 - 1e-6}, kEvery, "P",
             "Highest probability that a single beam gives a cell.",
             "0.8: thin things survive, walls get thicker"),
      option("log_odds_min", &O::log_odds_min, {-1e3, -1e-3}, kEvery, "L",
             "Lower bound of a cell's log-odds.", "how sure free space may be"),
      option("log_odds_max", &O::log_odds_max, {1e-3, 1e3}, kEvery, "L", "Upper bound of a cell's log-odds.",
             "how sure walls may be"),
      option("miss_given_occupied", &O::miss_given_occupied, {1e-6, 1.0 - 1e-6}, kAdaptive, "SHARE",
             "Fraction of beams that pass an occupied cell.", "as ndtree calibrate says"),
      option("hit_given_free", &O::hit_given_free, {1e-6, 1.0 - 1e-6}, kAdaptive, "SHARE",
             "Fraction of beams that end in a free cell.", "as ndtree calibrate says"),
      option("significance", &O::significance, {1e-6, 1.0 - 1e-9}, kOfPaper, "P",
             "Confidence of the chi-square test that splits a cell.", "with --refinement paper"),
      constant("merge_free_below", &O::merge_free_below, {0.0, 0.49}, kOfPaper,
               "Just inside the cap of log-odds: those of log_odds_min = -2 are 0.119."),
      constant("merge_occupied_above", &O::merge_occupied_above, {0.51, 1.0}, kOfPaper,
               "Just inside the cap of log-odds: those of log_odds_max = 3.5 are 0.971."),
      constant(
          "split_probability", &O::split_probability, {1e-6, 1.0 - 1e-6}, kOfEvidence,
          "Partial occupancy is more than twice as probable as both others together: a choice, not fitted."),
      constant("merge_loss", &O::merge_loss, {0.0, 1e9, " bits"}, kOfEvidence,
               "0.1 finds 0.4 points more thin things, for a tenth more cells (tools/bench/README.md)."),
      constant(
          "inherited_beams", &O::inherited_beams, {0.0, 1e9}, kOfEvidence,
          "A pseudo-count of the fractions due to children; 0.1: 4 to 17 % more cells, worse ray casts."),
      constant("noise_sigmas", &O::noise_sigmas, {0.0, 1e6}, kOfEvidence,
               "Below one standard deviation of the range a smaller cell holds no more information."),
      constant("evidence_memory", &O::evidence_memory, {1.0, 255.0, " nats"}, kOfEvidence,
               "Two sums in steps of 1/256 nat have 16 bits each, which hold 256 nats: most of that."),
      constant(
          "free_memory", &O::free_memory, {1.0, 255.0, " nats"}, kOfEvidence,
          "About 120 misses of 0.41 nats, a quarter of evidence_memory: free space soon is saturated, and "
          "skipped."),
      constant("scan_beams", &O::scan_beams, {1.0, 4e9}, kOfEvidence,
               "Beams of one scan are correlated: 64 misses of 0.41 nats are half of free_memory."),
      constant("known_evidence", &O::known_evidence, {1.0, 1e9, " nats"}, kOfEvidence,
               "As free_memory: saturated free space is well observed."),
      option("sample_beams", &O::sample_beams, {1e-3, 1e12}, kOfEvidence, "BEAMS",
             "Beams of a dense scan that a well observed cell samples, per smallest cell side by side in it.",
             "dense scans: more beams, slower"),
      constant("evidence_prior", &O::evidence_prior, {1e-6, 1e6, " nats"}, kOfEvidence,
               "About one beam of each kind: a hit is worth 0.46 nats, a miss 0.41."),
      constant("change_probability", &O::change_probability, {0.0, 1.0 - 1e-6}, kOfEvidence,
               "Of an unchanged cell, one streak in 1e5 is taken for a change."),
      option("evidence_half_life", &O::evidence_half_life, {0.0, 1e9, " scans"}, kOfEvidence, "SCANS",
             "A cell's evidence halves in this many scans that observe it; 0: never.",
             "old evidence should fade"),
      option("covered_share", &O::covered_share, {0.0, 1.0}, kOfEvidence, "SHARE",
             "Fraction of each part (quadrant, octant) to be seen until a cell is observed; 0: any beam.",
             "0: a cell is free as soon as one beam clips it"),
      constant("coverage_cells", &O::coverage_cells, {1.0, 1e9}, kOfEvidence,
               "1: a finer border of unseen space for a third more cells; 4: 4 points more wrong volume "
               "(tools/bench/README.md)."),
      constant("partial_probability", &O::partial_probability, {0.0, 0.95}, kOfEvidence,
               "Just free: from 0.49 on, rays at grazing angles end before their surfaces "
               "(tools/bench/README.md)."),
      option("beam_divergence", &O::beam_divergence, {0.0, 2.0, " rad"}, kOfEvidence, "RAD",
             "Full angle of wide beams, as of sonar; 0: lines.", "sonar and radar: the angle of their cones"),
      option("max_memory", &O::max_memory, {0.0, kAnyLarge, " bytes"}, kOurs, "BYTES",
             "Most memory that a map may take; 0: 3/4 of the machine's.", "several maps on one machine"),
  }};
}

}  // namespace detail

/// The one table of options and constants. A row is all that a new option takes, beside its member and the
/// code that reads it.
inline constexpr auto kOptionTable = detail::option_table();
static_assert(sizeof(MapOptions) == kOptionTable.size() * sizeof(double), "every member has a row");

/// Calls `visit(name, value)` for every row, in the order of map files.
/// @param options a MapOptions, const or not; the value is a reference to its double.
template <class Options, class Visit>
void for_each_option(Options& options, Visit&& visit) {
  for (const OptionRow& row : kOptionTable) visit(row.name, options.*row.member);
}

inline void MapOptions::validate() const {
  for (const OptionRow& row : kOptionTable) require_within(row.name, this->*row.member, row.bounds);
  if (max_cell_size < min_cell_size)
    throw OptionError("max_cell_size", describe_number(max_cell_size), "at least ", "min_cell_size",
                      " = " + describe_number(min_cell_size) + " m");
}

}  // namespace ndtree
