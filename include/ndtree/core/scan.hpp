// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// All beams of one sensor reading: origins, end points, and which of them came back.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/core/types.hpp"

namespace ndtree {

/// A scan that somebody else owns; what bulk calls take. Never outlives its arrays.
template <int D>
struct ScanView {
  const double* endpoints = nullptr;  ///< D numbers a beam, contiguous [m].
  const double* origins = nullptr;    ///< D numbers in all, or D a beam if `origin_per_beam` [m].
  const bool* returned = nullptr;     ///< One a beam; null: every beam hit a surface at its end point.
  const double* range_sigma =
      nullptr;            ///< Standard deviation of each range [m]; null: the map's options say.
  Eigen::Index size = 0;  ///< Number of beams.
  bool origin_per_beam = false;
  /// The scan's number in its log, from 0: each number samples other beams of a dense scan. Empty: one more
  /// than that of the scan before. Maps that take only some of a log's scans, as the parts of a distributed
  /// one do, give it, and sample as the map of all scans does.
  std::optional<std::uint64_t> number;

  [[nodiscard]] Eigen::Map<const Vector<D>> endpoint(Eigen::Index i) const {
    return Eigen::Map<const Vector<D>>(endpoints + i * D);
  }
  [[nodiscard]] Eigen::Map<const Vector<D>> origin(Eigen::Index i) const {
    return Eigen::Map<const Vector<D>>(origins + (origin_per_beam ? i * D : 0));
  }
  [[nodiscard]] bool is_returned(Eigen::Index i) const { return returned == nullptr || returned[i]; }
};

/// One sensor reading in the map frame.
/// Invariant (tested by view()): `origins` has one column, or as many as `endpoints`; `returned` and
/// `range_sigma` are empty or have one entry a beam.
template <int D>
struct Scan {
  Points<D> endpoints;  ///< Measured points, one column a beam [m].
  Points<D> origins;    ///< One column for all beams, or one each [m].
  Eigen::Array<bool, Eigen::Dynamic, 1>
      returned;        ///< False: nothing was hit up to the end point. Empty: all true.
  double stamp = 0.0;  ///< Time of the reading [s]; 0 where the log has none.
  /// Standard deviation of each range [m], for sensors of which it is known beam by beam. Empty: the map's
  /// options say.
  Eigen::ArrayXd range_sigma;

  [[nodiscard]] Eigen::Index size() const { return endpoints.cols(); }

  /// The same scan with only the beams that returned, in their order: for sensors whose missing returns say
  /// nothing, because glass, dark surfaces or the sky cause them alike.
  [[nodiscard]] Scan returned_only() const {
    if (returned.size() == 0) return *this;
    Scan result;
    result.stamp = stamp;
    const Eigen::Index kept = returned.count();
    result.endpoints.resize(D, kept);
    result.origins.resize(D, origins.cols() == 1 ? 1 : kept);
    if (origins.cols() == 1) result.origins = origins;
    if (range_sigma.size() != 0) result.range_sigma.resize(kept);
    for (Eigen::Index i = 0, k = 0; i < size(); ++i) {
      if (!returned[i]) continue;
      result.endpoints.col(k) = endpoints.col(i);
      if (origins.cols() != 1) result.origins.col(k) = origins.col(i);
      if (range_sigma.size() != 0) result.range_sigma[k] = range_sigma[i];
      ++k;
    }
    return result;
  }

  /// @throws std::invalid_argument if the arrays' sizes disagree.
  [[nodiscard]] ScanView<D> view() const {
    if (origins.cols() != 1 && origins.cols() != size())
      throw std::invalid_argument("origins has " + std::to_string(origins.cols()) +
                                  " columns: must be 1 or " + std::to_string(size()) +
                                  ", the number of end points");
    if (returned.size() != 0 && returned.size() != size())
      throw std::invalid_argument("returned has " + std::to_string(returned.size()) +
                                  " entries: must be 0 or " + std::to_string(size()) +
                                  ", the number of end points");
    if (range_sigma.size() != 0 && range_sigma.size() != size())
      throw std::invalid_argument("range_sigma has " + std::to_string(range_sigma.size()) +
                                  " entries: must be 0 or " + std::to_string(size()) +
                                  ", the number of end points");
    ScanView<D> view;
    view.endpoints = endpoints.data();
    view.origins = origins.data();
    if (returned.size() != 0) view.returned = returned.data();
    if (range_sigma.size() != 0) view.range_sigma = range_sigma.data();
    view.size = size();
    view.origin_per_beam = origins.cols() != 1;
    return view;
  }
};

}  // namespace ndtree
