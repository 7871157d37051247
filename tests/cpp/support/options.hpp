// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Options spelled out, so that what a test works out by hand does not move with the defaults.
#pragma once

#include <stdexcept>
#include <string>

#include "ndtree/mapping/map_options.hpp"

namespace ndtree::test {

/// What options are refused with, or "accepted".
template <class Options>
std::string refusal_of(const Options& options) {
  try {
    options.validate();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "accepted";
}

/// Cells of 0.25 m, and of two levels more.
inline MapOptions some_options(int branching) {
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 0.25 * branching * branching;
  options.range_sigma = 0.05;
  return options;
}

/// @param min_cell_size @param max_cell_size [m].
inline MapOptions spelled_out_options(double min_cell_size, double max_cell_size) {
  MapOptions options;
  options.min_cell_size = min_cell_size;
  options.max_cell_size = max_cell_size;
  options.range_sigma = 0.06;
  options.range_sigma_quadratic = 0.0;
  options.probability_min = 0.4;
  options.probability_max = 0.7;
  options.log_odds_min = -2.0;
  options.log_odds_max = 3.5;
  options.miss_given_occupied = 0.05;
  options.hit_given_free = 0.01;
  options.significance = 0.995;
  options.merge_free_below = 0.13;
  options.merge_occupied_above = 0.96;
  options.split_probability = 0.7;
  options.merge_loss = 4.0;
  options.inherited_beams = 2.0;
  options.noise_sigmas = 1.0;
  options.evidence_memory = 200.0;
  options.free_memory = 200.0;
  options.scan_beams = 1e6;
  options.known_evidence = 50.0;
  options.sample_beams = 1e6;
  options.evidence_prior = 0.5;
  options.change_probability = 1e-5;
  options.evidence_half_life = 0.0;
  options.covered_share = 0.0;
  options.coverage_cells = 2.0;
  options.partial_probability = 0.0;
  options.beam_divergence = 0.0;
  return options;
}

}  // namespace ndtree::test
