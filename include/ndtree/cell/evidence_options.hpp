// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Parameters of the evidence that cells collect.
#pragma once

namespace ndtree {

/// Two options, and constants of the method (kOptionTable says where they come from).
struct EvidenceOptions {
  double sample_beams = 0.5;  ///< A well observed cell samples this many beams of a scan per smallest cell
                              ///< side by side in it, any other cell, and one that the last beams
                              ///< contradict, 5 times as many.
  double evidence_half_life = 0.0;  ///< Scans of a cell after which its evidence has halved; 0: never.

  double evidence_memory = 200.0;  ///< Evidence that a cell remembers at most; older evidence fades [nats].
  double free_memory = 50.0;       ///< Evidence for free space that a cell without other remembers [nats].
  double scan_beams = 64.0;      ///< Beams of one scan that count at most in a cell that all of them passed.
  double known_evidence = 50.0;  ///< A cell with this much evidence is well observed [nats].
  double evidence_prior = 0.5;   ///< Evidence of both kinds that every cell begins with [nats].
  double inherited_beams = 2.0;  ///< Evenly spread beams added to a scan's where a split divides evidence.
  /// A streak of scans less likely than this is a change, in a well observed cell; 0: never.
  double change_probability = 1e-5;
  /// No hit or miss splits a cell into children smaller than this many standard deviations. Coverage may, to
  /// separate seen from unseen space.
  double noise_sigmas = 1.0;
};

}  // namespace ndtree
