// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How often held-out beams end where a map says that they would: counts that add up over scans.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <stdexcept>
#include <tuple>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree {

/// Pairs of a held-out beam and a cell that it reaches, by what the map says of the cell. Unknown cells say
/// nothing.
struct Calibration {
  static constexpr std::size_t kNumBins = 20;

  /// Pairs whose hit rates are in the same twentieth of [0, 1].
  struct Bin {
    std::uint64_t pairs = 0;
    double hit_rates = 0.0;  ///< Their sum.
    std::uint64_t ends = 0;  ///< Pairs of which the beam ended in the cell.
  };
  /// State, size [m], and the power of two that is not above 1 + beams, or -1 where their number is not kept.
  using Group = std::tuple<CellState, double, int>;
  std::map<Group, std::array<Bin, kNumBins>> groups;
  std::uint64_t beams = 0;            ///< Beams asked about.
  std::uint64_t ends_at_unknown = 0;  ///< Of these, that ended where the map says nothing.

  void add(const CellOnBeam& cell) {
    const int power = std::isnan(cell.beams) ? -1 : static_cast<int>(std::floor(std::log2(1.0 + cell.beams)));
    const auto number = static_cast<std::size_t>(cell.hit_rate * static_cast<double>(kNumBins));
    Bin& bin = groups[{cell.state, cell.size, power}][std::min(number, kNumBins - 1)];
    ++bin.pairs;
    bin.hit_rates += cell.hit_rate;
    bin.ends += cell.ends_beam;
  }
  /// The counts of other beams join these.
  void add(const Calibration& other) {
    for (const auto& [group, bins] : other.groups) {
      auto& own = groups[group];
      for (std::size_t i = 0; i < kNumBins; ++i) {
        own[i].pairs += bins[i].pairs;
        own[i].hit_rates += bins[i].hit_rates;
        own[i].ends += bins[i].ends;
      }
    }
    beams += other.beams;
    ends_at_unknown += other.ends_at_unknown;
  }
};

/// Asks the map about each beam of a scan that was not mapped.
/// @param map any type for which `for_each_cell_on(map, beam, visit)` is found.
/// @param max_range [m] longer beams, and beams that did not return, are not asked about.
/// @throws std::invalid_argument if max_range is not > 0.
template <class Map, int D>
void calibrate(const Map& map, const ScanView<D>& scan, double max_range, Calibration& calibration) {
  constexpr std::size_t kSteps = 64;  // Of a beam.
  if (!(max_range > 0.0))
    throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
  Pace pace;
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned || !(beam.range > 0.0)) continue;
    pace.spend(kSteps);
    bool ended = false;
    for_each_cell_on(map, beam, [&](const CellOnBeam& cell) {
      calibration.add(cell);
      ended = ended || cell.ends_beam;
    });
    ++calibration.beams;
    calibration.ends_at_unknown += !ended;
  }
}

}  // namespace ndtree
