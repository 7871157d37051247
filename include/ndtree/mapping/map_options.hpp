// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Everything that a map can be told when it is made.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <string_view>

#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/merge_rule.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/cell/split_test.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/mapping/coverage.hpp"

namespace ndtree {

/// The options of a map; those of the sensor, the split test, the merge rules, evidence and coverage are its
/// bases.
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

  /// Calls `visit(name, value, bounds)` for every option. @param options a MapOptions, const or not.
  template <class Options, class Visit>
  static void for_each_bounded(Options& options, Visit&& visit) {
    visit("min_cell_size", options.min_cell_size, OptionBounds{1e-9, 1e6, " m"});
    visit("max_cell_size", options.max_cell_size, OptionBounds{1e-9, 1e9, " m"});
    visit("max_memory", options.max_memory,
          OptionBounds{0.0, std::numeric_limits<double>::infinity(), " bytes"});
    SensorOptions::for_each_bounded(options, visit);
    SplitOptions::for_each_bounded(options, visit);
    MergeOptions::for_each_bounded(options, visit);
    EvidenceOptions::for_each_bounded(options, visit);
    EvidenceMergeOptions::for_each_bounded(options, visit);
    CoverageOptions::for_each_bounded(options, visit);
  }
  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    for_each_bounded(*this, require_within);
    require_option(max_cell_size >= min_cell_size, "max_cell_size", max_cell_size,
                   "at least min_cell_size = " + describe_number(min_cell_size) + " m");
  }

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

/// The one refinement that reads an option, by its kName; empty for an option that more than one reads.
[[nodiscard]] inline std::string_view only_reader(std::string_view option) {
  for (const char* const name : {"significance", "merge_free_below", "merge_occupied_above"})
    if (option == name) return "paper";
  for (const char* const name :
       {"split_probability", "partial_probability", "merge_loss", "inherited_beams", "noise_sigmas",
        "evidence_memory", "free_memory", "scan_beams", "known_evidence", "sample_beams", "evidence_prior",
        "change_probability", "evidence_half_life", "covered_share", "coverage_cells", "beam_divergence"})
    if (option == name) return "evidence";
  return {};
}

/// Calls `visit(name, value)` for every option, in this order: the one list behind files and bindings.
/// @param options a MapOptions, const or not; the value is a reference to its double.
template <class Options, class Visit>
void for_each_option(Options& options, Visit&& visit) {
  visit("min_cell_size", options.min_cell_size);
  visit("max_cell_size", options.max_cell_size);
  visit("range_sigma", options.range_sigma);
  visit("range_sigma_quadratic", options.range_sigma_quadratic);
  visit("probability_min", options.probability_min);
  visit("probability_max", options.probability_max);
  visit("log_odds_min", options.log_odds_min);
  visit("log_odds_max", options.log_odds_max);
  visit("miss_given_occupied", options.miss_given_occupied);
  visit("hit_given_free", options.hit_given_free);
  visit("significance", options.significance);
  visit("merge_free_below", options.merge_free_below);
  visit("merge_occupied_above", options.merge_occupied_above);
  visit("split_probability", options.split_probability);
  visit("merge_loss", options.merge_loss);
  visit("inherited_beams", options.inherited_beams);
  visit("noise_sigmas", options.noise_sigmas);
  visit("evidence_memory", options.evidence_memory);
  visit("free_memory", options.free_memory);
  visit("scan_beams", options.scan_beams);
  visit("known_evidence", options.known_evidence);
  visit("sample_beams", options.sample_beams);
  visit("evidence_prior", options.evidence_prior);
  visit("change_probability", options.change_probability);
  visit("evidence_half_life", options.evidence_half_life);
  visit("covered_share", options.covered_share);
  visit("coverage_cells", options.coverage_cells);
  visit("partial_probability", options.partial_probability);
  visit("beam_divergence", options.beam_divergence);
  visit("max_memory", options.max_memory);
}

}  // namespace ndtree
