// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What MovedEvidence says of all points of a simulated log.
#pragma once

#include <cstddef>
#include <limits>
#include <vector>

#include "ndtree/evaluation/moved.hpp"
#include "ndtree/logs/simulator.hpp"

namespace ndtree::test {

template <int D>
std::vector<Scan<D>> scans_of(const SimulatedLog<D>& log) {
  std::vector<Scan<D>> scans;
  for (std::size_t i = 0; i < log.size(); ++i) scans.push_back(log.scan(i));
  return scans;
}

/// The probability that each end point moved, scan by scan, once all scans were added and have looked.
template <int D>
std::vector<float> moved_answers(const std::vector<Scan<D>>& scans, const MovedOptions& options,
                                 std::size_t threads) {
  MovedEvidence<D> evidence(options);
  for (const auto& scan : scans) evidence.add(scan.view());
  for (const auto& scan : scans) evidence.look(scan.view(), std::numeric_limits<double>::infinity(), threads);
  std::vector<float> all;
  for (const auto& scan : scans) {
    std::vector<float> answers(static_cast<std::size_t>(scan.size()));
    evidence.probabilities(scan.endpoints.data(), answers.size(), answers.data());
    all.insert(all.end(), answers.begin(), answers.end());
  }
  return all;
}

}  // namespace ndtree::test
