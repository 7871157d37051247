// SPDX-License-Identifier: BSD-3-Clause
#include "seen_space.hpp"

#include <algorithm>

#include "ndtree/logs/simulator.hpp"

namespace ndtree::python {

namespace {

template <int D>
std::vector<ScanView<D>> views_of(const std::vector<BeamPointers>& scans) {
  std::vector<ScanView<D>> views;
  views.reserve(scans.size());
  for (const BeamPointers& scan : scans) views.push_back(scan.view<D>());
  return views;
}

template <int D>
AnySeenSpace make(const std::vector<BeamPointers>& scans, const SimulatedLog<D>* log, double max_range,
                  const ClaimsOptions& options) {
  if (log == nullptr) return {SeenSpace<D>(views_of<D>(scans), max_range, options)};
  const double farthest = max_range > log->range.max_range ? log->range.max_range : max_range;
  return {SeenSpace<D>(views_of<D>(scans), farthest, options, log->world)};
}

}  // namespace

AnySeenSpace seen_space(const std::vector<BeamPointers>& scans, const SimulatedLog<2>* log, double max_range,
                        const ClaimsOptions& options) {
  return make(scans, log, max_range, options);
}
AnySeenSpace seen_space(const std::vector<BeamPointers>& scans, const SimulatedLog<3>* log, double max_range,
                        const ClaimsOptions& options) {
  return make(scans, log, max_range, options);
}
AnySeenSpace seen_space(const std::vector<BeamPointers>& scans, double max_range,
                        const ClaimsOptions& options) {
  return {SeenSpace<4>(views_of<4>(scans), max_range, options)};
}

}  // namespace ndtree::python
