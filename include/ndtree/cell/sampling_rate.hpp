// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Sampling rate: how many beams of one scan count in a cell.
#pragma once

#include <algorithm>
#include <cstdint>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_memory.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Beams of one scan are correlated, and what a cell remembers is limited: the fewer beams it samples of each
/// scan, the more scans it remembers.
/// - A well observed cell (of known_evidence nats) samples b = sample_beams beams for each smallest cell of
///   its cross-section, (edge / smallest)^(D - 1) of them; any other cell, and one that is contradicted
///   (a saturated one in which more beams end than errors explain, an occupied one that the last scans' beams
///   all passed), samples 5 b.
/// - At most scan_beams misses of one scan count per cell, if all of the scan's beams passed it.
class SamplingRate {
 public:
  SamplingRate(const EvidenceOptions& options, const EvidenceMemory& memory)
      : sample_beams_(options.sample_beams),
        scan_beams_(static_cast<std::uint32_t>(std::min(options.scan_beams, 4e9))),
        miss_units_(memory.miss_evidence()),
        well_observed_(EvidenceMemory::units(std::min(options.known_evidence, 1e9))) {}

  /// True if the cell has so much evidence that a small sample of a scan will do.
  [[nodiscard]] bool is_well_observed(const EvidenceCell& cell) const {
    return cell.occupied_evidence() + cell.free_evidence() >= well_observed_;
  }
  /// Beams of a scan that a cell samples per smallest cell side by side in it.
  [[nodiscard]] double sample_beams(bool uses_small_sample) const {
    constexpr double kUntilWellObserved = 5.0;
    return uses_small_sample ? sample_beams_ : kUntilWellObserved * sample_beams_;
  }

  /// Limits evidence for free space only to that of scan_beams beams.
  NDTREE_ALWAYS_INLINE void limit(ScanEvidence& scan) const {
    if (scan.beams <= scan_beams_ && scan.free <= scan_beams_ * miss_units_) return;  // Most.
    if (!scan.is_free_alone()) return;
    scan.free = std::min(scan.free, scan_beams_ * miss_units_);
    scan.misses = std::min(scan.misses, scan_beams_);
    scan.beams = std::min(scan.beams, scan_beams_);
  }
  /// False if limit() leaves the evidence of this many beams as it is, whatever their ways through a cell.
  [[nodiscard]] bool may_limit(std::uint32_t beams) const {
    constexpr std::uint32_t kLongestWay = 8;  // In mean_chord_of_unit_cube(): up to eight dimensions.
    return beams > scan_beams_ / kLongestWay;
  }

 private:
  double sample_beams_;
  std::uint32_t scan_beams_;
  std::int64_t miss_units_;
  std::int64_t well_observed_;
};

}  // namespace ndtree
