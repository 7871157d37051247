// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The object behind a Python map: one interface, guarded so that threads may share it.
#pragma once

#include <pybind11/pybind11.h>

#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
#include <string_view>
#include <utility>

#include "map_interface.hpp"
#include "ndtree/core/cancel.hpp"

namespace ndtree::python {

/// While one lives, the interpreter's lock is left to other threads, and, in the thread that hears signals,
/// long calls stop as soon as a signal's handler raises, as that of Ctrl-C does: they throw Cancelled, and
/// the handler's exception is set.
class Released {
 public:
  Released() {
    if (hears_signals()) scope_.emplace([this] { return was_raised(); });
  }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::milliseconds kPause{100};  // Who asks has to wait for the interpreter.

  [[nodiscard]] static bool hears_signals();
  [[nodiscard]] bool was_raised() {
    if (Clock::now() < next_) return false;
    const pybind11::gil_scoped_acquire held;
    const bool raised = PyErr_CheckSignals() != 0;
    next_ = Clock::now() + kPause;
    return raised;
  }

  Clock::time_point next_ = Clock::now() + kPause;
  pybind11::gil_scoped_release released_;
  std::optional<CancelScope> scope_;
};

/// Queries of several threads run at the same time, an insertion runs alone. Both leave the interpreter's
/// lock to others, and take this one only after that: so they cannot wait for each other in a circle.
class PythonMap {
 public:
  explicit PythonMap(std::unique_ptr<MapInterface> map) : map_(std::move(map)) {}
  PythonMap(PythonMap&& other) noexcept : map_(std::move(other.map_)) {}

  template <class Function>
  auto read(Function&& function) const {
    const Released released;
    const std::shared_lock lock(mutex_);
    return function(std::as_const(*map_));
  }
  template <class Function>
  auto write(Function&& function) {
    const Released released;
    const std::unique_lock lock(mutex_);
    return function(*map_);
  }
  /// What never changes: dimension, branching, options.
  [[nodiscard]] const MapInterface& constant() const { return *map_; }

 private:
  std::unique_ptr<MapInterface> map_;
  mutable std::shared_mutex mutex_;
};

struct PythonAdaptiveMap : PythonMap {
  using PythonMap::PythonMap;
};
struct PythonFixedMap : PythonMap {
  using PythonMap::PythonMap;
};

/// What OctoMap calls its refinement here, beside those of our own maps.
inline constexpr const char* kOctomap = "octomap";

/// Options from keywords. @param refinement of the map, which decides what options it reads.
/// @throws TypeError naming a keyword that is unknown, not read by this map, or not a number.
MapOptions options_from_keywords(const pybind11::kwargs& keywords, std::string_view refinement,
                                 const char* type);

/// What repr() shows: type, dimension, cell sizes, and how much there is.
std::string describe(const char* type, const PythonMap& map, bool adaptive);

/// The one of AdaptiveMap and FixedMap that a map belongs to.
pybind11::object to_python(std::unique_ptr<MapInterface> map);

/// Remembers the thread that imports the module, in which Python calls the handlers of signals, unless
/// another one is its main thread. What the library throws becomes an exception of Python's in one readable
/// line; and `ReplacedFile`.
void bind_errors(pybind11::module_& module);
void bind_files(pybind11::module_& module);
void bind_maps(pybind11::module_& module);
/// @pre bind_maps() has run: it adds methods to its classes.
void bind_exports(pybind11::module_& module);
/// @pre as bind_exports().
void bind_queries(pybind11::module_& module);
/// What rays end at: a RayEnds. @param origins, directions checked.
pybind11::object trace_rays(const PythonMap& map, const DoubleArray& origins, const DoubleArray& directions,
                            double max_range, bool stops_at_unknown);
/// @pre as bind_exports().
void bind_claims(pybind11::module_& module);
void bind_logs(pybind11::module_& module);
void bind_statistics(pybind11::module_& module);
void bind_octomap(pybind11::module_& module);

}  // namespace ndtree::python
