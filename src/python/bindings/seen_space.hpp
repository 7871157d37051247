// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What scans saw, compiled apart from its binding.
#pragma once

#include <variant>
#include <vector>

#include "any_seen_space.hpp"
#include "beam_pointers.hpp"

namespace ndtree {
template <int D>
struct SimulatedLog;
}

namespace ndtree::python {

/// @param log simulated, of the scans; null: beams alone say what was seen. @throws as SeenSpace.
AnySeenSpace seen_space(const std::vector<BeamPointers>& scans, const SimulatedLog<2>* log, double max_range,
                        const ClaimsOptions& options);
AnySeenSpace seen_space(const std::vector<BeamPointers>& scans, const SimulatedLog<3>* log, double max_range,
                        const ClaimsOptions& options);
/// Of scans in four dimensions.
AnySeenSpace seen_space(const std::vector<BeamPointers>& scans, double max_range,
                        const ClaimsOptions& options);

}  // namespace ndtree::python
