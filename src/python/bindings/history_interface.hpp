// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps that follow their scans' poses, whatever their dimension.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "beam_pointers.hpp"
#include "map_interface.hpp"
#include "map_layers.hpp"
#include "ndtree/mapping/history/scan_history.hpp"

namespace ndtree::python {

/// A scan in the map frame; axes as in Scan, flat.
struct StoredScan {
  std::vector<double> endpoints;
  std::vector<double> origins;  ///< One, or one for each beam.
  std::vector<char> returned;
  std::vector<double> range_sigma;  ///< Empty, or one for each beam.
};

class HistoryInterface {
 public:
  using Key = std::int64_t;

  HistoryInterface() = default;
  HistoryInterface(const HistoryInterface&) = delete;
  HistoryInterface& operator=(const HistoryInterface&) = delete;
  virtual ~HistoryInterface() = default;

  [[nodiscard]] virtual int dim() const = 0;
  [[nodiscard]] virtual const MapOptions& options() const = 0;
  /// A copy of the map, which shares its cells.
  [[nodiscard]] virtual std::unique_ptr<MapInterface> map() const = 0;
  [[nodiscard]] virtual std::vector<Key> keys() const = 0;
  [[nodiscard]] virtual bool contains(Key key) const = 0;
  /// A rotation, row by row, and a translation. @throws std::out_of_range
  [[nodiscard]] virtual std::vector<double> pose(Key key) const = 0;
  [[nodiscard]] virtual StoredScan scan(Key key) const = 0;
  [[nodiscard]] virtual std::vector<LayerKind> layers() const = 0;
  /// Of the layers that the scan has some for; one entry a beam of scan().
  [[nodiscard]] virtual std::vector<LayerNumbers> measurements(Key key) const = 0;
  [[nodiscard]] virtual std::size_t memory_bytes() const = 0;
  virtual InsertReport insert(Key key, const BeamPointers& beams, const double* pose,
                              const std::vector<LayerMeasurements>& layers, double max_range,
                              int threads) = 0;
  /// @param poses one after the other, as pose() gives them.
  virtual HistoryReport move(const std::vector<Key>& keys, const double* poses, int threads) = 0;
  virtual HistoryReport remove(const std::vector<Key>& keys, int threads) = 0;
  virtual void freeze(std::size_t count, int threads) = 0;
  [[nodiscard]] virtual std::size_t num_frozen() const = 0;
};

/// Of adaptive maps; each shape is compiled in a file of its own.
template <int N, int D>
std::unique_ptr<HistoryInterface> make_history(const MapOptions& options,
                                               const std::vector<LayerKind>& layers);

/// For one shape: here, or, with `extern` as the prefix, elsewhere.
#define NDTREE_PYTHON_HISTORY(prefix, N, D)                                               \
  prefix template std::unique_ptr<HistoryInterface> make_history<N, D>(const MapOptions&, \
                                                                       const std::vector<LayerKind>&)

}  // namespace ndtree::python
