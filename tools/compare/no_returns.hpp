// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What beams without return say in a log: that space is free, or nothing. The same rule, by the same
/// numbers, as that of ndtree.evaluation.no_returns in Python.
#pragma once

#include <cstddef>
#include <string>

#include "log_input.hpp"

namespace ndtree {

/// What a sample of a log shows.
struct NoReturns {
  bool are_free = true;   ///< Else they say nothing.
  std::size_t beams = 0;  ///< Without return, that tell whether they are right.
  double crossing = 0.0;  ///< The share of them that crosses surfaces which other scans found.
  double expected = 0.0;  ///< The share that would if they were right, by errors of poses and what moves.
  double share = 0.0;     ///< Of beams without return among all of the sample.

  /// The least share of them that is wrong.
  [[nodiscard]] double wrong() const;
  /// What was chosen and why, in one line.
  [[nodiscard]] std::string to_text() const;
};

/// Every second scan of a sample makes a map of the surfaces that its returned beams found, and the beams of
/// the others are held against it: those without return that cross one claim free space where it is not, if
/// it was hit both before the beam and after it. Where the first surface came later or had left, a beam is
/// not judged.
[[nodiscard]] NoReturns judge_no_returns(const Log& log);

}  // namespace ndtree
