// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a scan measured for a layer, kept in few bytes.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstring>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/scan.hpp"

namespace ndtree {

/// Whether a beam of a scan may end in a cell: it returned, and has a direction.
template <int D>
[[nodiscard]] bool ends_in_a_cell(const ScanView<D>& scan, Eigen::Index i) {
  return Beam<D>(scan.origin(i), scan.endpoint(i), scan.is_returned(i)).outcome == BeamOutcome::returned;
}

/// Refuses what cannot be added, before anything is. @param measurements one a beam.
/// @throws std::invalid_argument naming the beam; beams that did not return are not checked.
template <class Value, int D>
void check_measurements(const ScanView<D>& scan, const typename Value::Measurement* measurements) {
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    if (!ends_in_a_cell(scan, i)) continue;
    try {
      Value::check(measurements[i]);
    } catch (const std::invalid_argument& error) {
      throw std::invalid_argument("'" + Value::rule() + "' of beam " + std::to_string(i) + " = " +
                                  error.what());
    }
  }
}

namespace detail {

template <class Value, class = void>
struct PackedOf {
  using Type = typename Value::Measurement;
};
template <class Value>
struct PackedOf<Value, std::void_t<typename Value::Packed>> {
  using Type = typename Value::Packed;
};

}  // namespace detail

/// The measurements of a scan's beams that may end in a cell, each as Value::Packed, else as
/// Value::Measurement; one for all if their bits are the same, as those of a scan's time are.
/// Cost: O(beams).
template <class Value>
class PackedMeasurements {
 public:
  using Measurement = typename Value::Measurement;

  PackedMeasurements() = default;
  /// @param measurements one a beam, that check_measurements() accepts.
  template <int D>
  PackedMeasurements(const ScanView<D>& scan, const Measurement* measurements) {
    const auto for_each_end = [&](const auto& visit) {
      for (Eigen::Index i = 0; i < scan.size; ++i)
        if (ends_in_a_cell(scan, i)) visit(static_cast<Packed>(measurements[i]));
    };
    std::size_t count = 0;
    bool all_same = true;
    Packed first{};
    for_each_end([&](const Packed& one) {
      if (count++ == 0) first = one;
      all_same = all_same && has_same_bits(one, first);
    });
    packed_.reserve(all_same ? std::min<std::size_t>(count, 1) : count);
    for_each_end([&](const Packed& one) {
      if (!all_same || packed_.empty()) packed_.push_back(one);
    });
  }

  /// One a beam, as they were given; those of beams that did not return are 0.
  /// @param scan as PackedScan::at() unpacks it: beams without a direction are left out.
  template <int D>
  [[nodiscard]] std::vector<Measurement> at(const ScanView<D>& scan) const {
    std::vector<Measurement> measurements(static_cast<std::size_t>(scan.size));
    std::size_t next = 0;
    for (Eigen::Index i = 0; i < scan.size; ++i) {
      if (!scan.is_returned(i)) continue;
      measurements[static_cast<std::size_t>(i)] =
          static_cast<Measurement>(packed_[packed_.size() == 1 ? 0 : next++]);
    }
    return measurements;
  }
  [[nodiscard]] std::size_t memory_bytes() const {
    return sizeof(*this) + packed_.capacity() * sizeof(Packed);
  }

 private:
  using Packed = typename detail::PackedOf<Value>::Type;

  [[nodiscard]] static bool has_same_bits(const Packed& one, const Packed& other) {
    if constexpr (std::is_trivially_copyable_v<Packed>)
      return std::memcmp(&one, &other, sizeof one) == 0;
    else
      return false;
  }

  std::vector<Packed> packed_;
};

}  // namespace ndtree
