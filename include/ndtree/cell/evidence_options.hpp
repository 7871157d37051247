// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parameters of the evidence that cells collect.
#pragma once

#include "ndtree/core/option.hpp"

namespace ndtree {

struct EvidenceOptions {
  double evidence_memory = 200.0;  ///< Evidence that a cell remembers at most; older evidence fades [nats].
  double free_memory = 50.0;       ///< Evidence for free space that a cell without other remembers [nats].
  double scan_beams = 64.0;      ///< Beams of one scan that count at most in a cell that all of them passed.
  double known_evidence = 50.0;  ///< A cell with this much evidence is well observed [nats]:
  double sample_beams = 0.5;  ///< it samples this many beams of a scan per smallest cell side by side in it,
                              ///< any other cell, and a saturated one that is contradicted,
                              ///< 5 times as many.
  double evidence_prior = 0.5;   ///< Evidence of both kinds that every cell begins with [nats].
  double inherited_beams = 2.0;  ///< Evenly spread beams added to a scan's where a split divides evidence.
  double change_probability = 1e-5;  ///< A streak of scans less likely than this is a change; 0: never.
  double evidence_half_life = 0.0;   ///< Scans of a cell after which its evidence has halved; 0: never.
  /// No hit or miss splits a cell into children smaller than this many standard deviations. Coverage may, to
  /// separate seen from unseen space.
  double noise_sigmas = 1.0;

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

}  // namespace ndtree
