// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A few scans from all over a log, and a few beams of each: what is asked before a log is
/// mapped; and which scans are held out.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// Whether scan `i` of a log, counted from 0, is held out: the last of every `held_out` scans; none if 0.
[[nodiscard]] constexpr bool is_held_out(std::size_t i, std::size_t held_out) {
  return held_out != 0 && i % held_out == held_out - 1;
}

/// Scans in a row that are sampled together, so that some of them see the same: a run. A log is cut into
/// runs, and the sample has at least kSampleRuns of them, if there are as many, and at most twice as many.
inline constexpr std::size_t kSampleRun = 4, kSampleRuns = 40;
/// Beams of a scan that are sampled at most.
inline constexpr std::size_t kSampleBeams = 4000;
/// Beams that begin or end farther from the map's origin on some axis are not sampled [m].
inline constexpr double kSampleFarthest = 1e9;

/// Of the runs of a log of this many scans, each `step`-th is sampled, the first included: a power of two,
/// which grows with the log. So a log whose length is not known is sampled in one pass: when the step
/// doubles, every second run is dropped, and from then on half as many are taken.
[[nodiscard]] constexpr std::size_t sample_step(std::size_t scans) {
  const std::size_t runs = (scans + kSampleRun - 1) / kSampleRun;
  std::size_t step = 1;
  while ((runs + step - 1) / step > 2 * kSampleRuns) step *= 2;
  return step;
}

/// Of a scan with this many beams, each `stride`-th is sampled, the first included.
[[nodiscard]] constexpr std::size_t sample_stride(std::size_t beams) {
  return std::max<std::size_t>(1, (beams + kSampleBeams - 1) / kSampleBeams);
}

/// Whether a beam may be sampled: neither of its ends lies beyond kSampleFarthest. Not finite is not beyond.
template <int D>
[[nodiscard]] bool is_near(const ScanView<D>& scan, Eigen::Index beam) {
  const auto beyond = [](const auto& point) { return (point.array().abs() > kSampleFarthest).any(); };
  return !beyond(scan.endpoint(beam)) && !beyond(scan.origin(beam));
}

/// The sampled beams of a scan, in their order.
template <int D>
[[nodiscard]] Scan<D> sampled_beams(const Scan<D>& scan) {
  const ScanView<D> view = scan.view();
  const auto stride = static_cast<Eigen::Index>(sample_stride(static_cast<std::size_t>(scan.size())));
  std::vector<Eigen::Index> kept;
  for (Eigen::Index i = 0; i < scan.size(); i += stride)
    if (is_near(view, i)) kept.push_back(i);
  const auto n = static_cast<Eigen::Index>(kept.size());
  Scan<D> sample;
  sample.stamp = scan.stamp;
  sample.endpoints.resize(D, n);
  sample.origins.resize(D, view.origin_per_beam ? n : 1);
  if (!view.origin_per_beam) sample.origins = scan.origins;
  if (scan.returned.size() != 0) sample.returned.resize(n);
  if (scan.range_sigma.size() != 0) sample.range_sigma.resize(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const Eigen::Index i = kept[static_cast<std::size_t>(k)];
    sample.endpoints.col(k) = scan.endpoints.col(i);
    if (view.origin_per_beam) sample.origins.col(k) = scan.origins.col(i);
    if (scan.returned.size() != 0) sample.returned[k] = scan.returned[i];
    if (scan.range_sigma.size() != 0) sample.range_sigma[k] = scan.range_sigma[i];
  }
  return sample;
}

/// The sampled beams of the sampled scans of a whole log, in its order.
template <int D>
[[nodiscard]] std::vector<Scan<D>> sample_of(const std::vector<Scan<D>>& log) {
  const std::size_t step = sample_step(log.size());
  std::vector<Scan<D>> sample;
  for (std::size_t i = 0; i < log.size(); ++i)
    if (i / kSampleRun % step == 0) sample.push_back(sampled_beams(log[i]));
  return sample;
}

}  // namespace ndtree
