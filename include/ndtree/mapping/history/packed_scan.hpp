// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A scan in its sensor's frame, kept in few bytes: what a map takes in is what can be unpacked again.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// A scan in its sensor's frame: 8 bytes a beam in up to three dimensions. End points are rounded to steps of
/// a 1024th of a smallest cell, or, if the farthest lies beyond 1024 cells, of the least power of 2 of them
/// that reaches it. Standard deviations, if the scan has them, take 4 bytes more, and own origins of beams 8
/// more. Beams that are not finite, or have no direction, are left out.
/// Cost: O(beams).
template <int D>
class PackedScan {
 public:
  PackedScan() = default;
  /// @param scan in its sensor's frame. @param unit edge of the smallest cell [m].
  /// @throws std::invalid_argument if a beam is longer than the lattice has cells, and as Scan::view().
  PackedScan(const ScanView<D>& scan, double unit) : step_(kFinestStep * unit) {
    double farthest = 0.0;
    std::vector<Eigen::Index> kept;
    kept.reserve(static_cast<std::size_t>(scan.size));
    const auto reach_of = [](const Vector<D>& point) { return point.cwiseAbs().maxCoeff(); };
    if (scan.size > 0 && !scan.origin_per_beam) {
      one_origin_ = scan.origin(0);
      if (!one_origin_.allFinite())
        throw std::invalid_argument("the scan's origin: every component must be finite");
    }
    for (Eigen::Index i = 0; i < scan.size; ++i) {
      if (Beam<D>(scan.origin(i), scan.endpoint(i)).outcome == BeamOutcome::invalid) continue;
      kept.push_back(i);
      farthest = std::max(farthest, reach_of(scan.endpoint(i)));
      if (scan.origin_per_beam) farthest = std::max(farthest, reach_of(scan.origin(i)));
    }
    num_left_out_ = static_cast<std::size_t>(scan.size) - kept.size();
    while (!(farthest <= kMost * step_)) {
      if (!(step_ < unit))
        throw std::invalid_argument("a beam ends " + describe_number(farthest) +
                                    " m from its sensor: with cells of " + describe_number(unit) +
                                    " m at most " + describe_number(kMost * step_) + " m can be kept");
      step_ *= 2.0;
    }
    ends_.reserve(kept.size() * kWords);
    for (const Eigen::Index i : kept) {
      append(ends_, scan.endpoint(i), scan.is_returned(i));
      if (scan.origin_per_beam) append(origins_, scan.origin(i), true);
      if (scan.range_sigma != nullptr) range_sigma_.push_back(static_cast<float>(scan.range_sigma[i]));
    }
  }

  [[nodiscard]] std::size_t size() const { return ends_.size() / kWords; }
  /// Beams that were not finite, or had no direction.
  [[nodiscard]] std::size_t num_left_out() const { return num_left_out_; }
  [[nodiscard]] std::size_t memory_bytes() const {
    return sizeof(*this) + (ends_.capacity() + origins_.capacity()) * sizeof(std::uint64_t) +
           range_sigma_.capacity() * sizeof(float);
  }
  /// The scan in the map's frame, the same bits on every machine. @param pose of the sensor.
  [[nodiscard]] Scan<D> at(const Pose<D>& pose) const {
    const auto count = static_cast<Eigen::Index>(size());
    Scan<D> scan;
    scan.endpoints.resize(D, count);
    scan.returned.resize(count);
    for (Eigen::Index i = 0; i < count; ++i) {
      scan.endpoints.col(i) = moved(point(ends_, i), pose);
      scan.returned[i] = (ends_[static_cast<std::size_t>(i) * kWords] & kReturned) != 0;
    }
    if (origins_.empty()) {
      scan.origins = moved(one_origin_, pose);
    } else {
      scan.origins.resize(D, count);
      for (Eigen::Index i = 0; i < count; ++i) scan.origins.col(i) = moved(point(origins_, i), pose);
    }
    if (!range_sigma_.empty())
      scan.range_sigma = Eigen::Map<const Eigen::ArrayXf>(range_sigma_.data(), count).template cast<double>();
    return scan;
  }

 private:
  static constexpr int kBits = 21;  // Of an axis; three of them and `returned` are a word.
  static constexpr std::size_t kWords = (D + 2) / 3;
  static constexpr double kMost = (1 << (kBits - 1)) - 1;
  static constexpr std::int64_t kOffset = 1 << (kBits - 1);
  static constexpr std::uint64_t kReturned = std::uint64_t{1} << 63;
  static constexpr double kFinestStep = 0x1p-10;  // Over a smallest cell.

  void append(std::vector<std::uint64_t>& words, const Vector<D>& point, bool is_returned) const {
    std::array<std::uint64_t, kWords> packed{};
    for (std::size_t a = 0; a < D; ++a) {
      const auto steps = static_cast<std::int64_t>(std::nearbyint(point[static_cast<int>(a)] / step_));
      packed[a / 3] |= static_cast<std::uint64_t>(steps + kOffset) << (a % 3 * kBits);
    }
    if (is_returned) packed[0] |= kReturned;
    words.insert(words.end(), packed.begin(), packed.end());
  }
  [[nodiscard]] Vector<D> point(const std::vector<std::uint64_t>& words, Eigen::Index beam) const {
    Vector<D> result;
    for (std::size_t a = 0; a < D; ++a) {
      const std::uint64_t word = words[static_cast<std::size_t>(beam) * kWords + a / 3];
      const auto steps =
          static_cast<std::int64_t>(word >> (a % 3 * kBits) & ((std::uint64_t{1} << kBits) - 1)) - kOffset;
      result[static_cast<int>(a)] = static_cast<double>(steps) * step_;
    }
    return result;
  }
  /// Products are rounded one by one, see unfused().
  [[nodiscard]] static Vector<D> moved(const Vector<D>& point, const Pose<D>& pose) {
    Vector<D> result = pose.translation;
    for (int a = 0; a < D; ++a)
      for (int b = 0; b < D; ++b) result[a] += unfused(pose.rotation(a, b) * point[b]);
    return result;
  }

  double step_ = 1.0;  // Of coordinates [m].
  std::size_t num_left_out_ = 0;
  Vector<D> one_origin_ = Vector<D>::Zero();
  std::vector<std::uint64_t> ends_;
  std::vector<std::uint64_t> origins_;  // Empty if all beams have one.
  std::vector<float> range_sigma_;      // Empty if the map's options say.
};

}  // namespace ndtree
