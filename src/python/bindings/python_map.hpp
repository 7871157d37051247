// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The object behind a Python map: one interface, guarded so that threads may share it.
#pragma once

#include <pybind11/pybind11.h>

#include <exception>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "binders.hpp"
#include "map_interface.hpp"
#include "numpy.hpp"
#include "released.hpp"
#include "shared_lock.hpp"

namespace ndtree::python {

/// A map that threads share. One writes at a time. Until a call has had to wait, queries read the map itself,
/// several at the same time; from then on they read a copy that every writer leaves behind when it is done,
/// so that readers and writers do not wait for each other. When no copy has been read for a while, writers
/// make none any more.
///
/// All leave the interpreter's lock to others, and take this one only after that: so they cannot wait for
/// each other in a circle. A call that waits for it handles signals meanwhile. A fork waits until no other
/// thread is in a call, see CallInProgress, so that the child can go on with the map.
class PythonMap {
 public:
  explicit PythonMap(std::unique_ptr<MapInterface> map) : map_(std::move(map)) {}
  PythonMap(PythonMap&& other) noexcept : map_(std::move(other.map_)) {}

  template <class Function>
  auto read(Function&& function) const {
    const Released released;
    const CallInProgress call;
    std::shared_ptr<const MapInterface> copy = left_behind();
    if (!copy) {
      const SharedLock::Holder holder(lock_, SharedLock::Use::look, [this] { expect_company(); });
      if (!has_company()) return function(std::as_const(*map_));
      copy = map_->clone();
    }
    return function(*copy);
  }
  template <class Function>
  auto write(Function&& function) {
    const Released released;
    const CallInProgress call;
    const SharedLock::Holder holder(lock_, SharedLock::Use::change, [this] { expect_company(); });
    const CopyInTheEnd copy(*this);
    return function(*map_);
  }
  /// What never changes: dimension, branching, options.
  [[nodiscard]] const MapInterface& constant() const { return *map_; }

 private:
  static constexpr int kPatience = 100;  // Writers that leave copies without a reader.

  struct CopyInTheEnd {
    explicit CopyInTheEnd(PythonMap& map) : map_(map) {}
    CopyInTheEnd(const CopyInTheEnd&) = delete;
    CopyInTheEnd& operator=(const CopyInTheEnd&) = delete;
    ~CopyInTheEnd() { map_.leave_copy(); }

   private:
    PythonMap& map_;
  };

  void expect_company() const {
    const std::lock_guard lock(copy_mutex_);
    patience_ = map_->clones_cheaply() ? kPatience : 0;
  }
  [[nodiscard]] bool has_company() const {
    const std::lock_guard lock(copy_mutex_);
    return patience_ > 0;
  }
  [[nodiscard]] std::shared_ptr<const MapInterface> left_behind() const {
    const std::lock_guard lock(copy_mutex_);
    if (copy_) patience_ = kPatience;
    return copy_;
  }
  void leave_copy() noexcept {
    std::shared_ptr<const MapInterface> copy;  // What was there before goes after the lock.
    try {
      if (has_company()) copy = map_->clone();
    } catch (const std::exception&) {  // No memory: then readers wait.
    }
    const std::lock_guard lock(copy_mutex_);
    if (patience_ > 0) --patience_;
    copy_.swap(copy);
  }

  std::unique_ptr<MapInterface> map_;
  mutable SharedLock lock_;
  // Of all below:
  mutable std::mutex copy_mutex_;
  mutable int patience_ = 0;                  // > 0: there may be several who look and write.
  std::shared_ptr<const MapInterface> copy_;  // As the last writer left the map, or none.
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

/// What rays end at: a RayEnds. @param origins, directions checked.
pybind11::object trace_rays(const PythonMap& map, const DoubleArray& origins, const DoubleArray& directions,
                            double max_range, bool stops_at_unknown, RayAim aim);
/// Of each beam the probability that it returns from what moves, by the map as it is; without the
/// interpreter's lock. See OccupancyMap::insert().
std::vector<float> moved_before(const MapInterface& map, const BeamPointers& beams, double max_range);
/// A list of Frontier.
pybind11::object to_python(AnyFrontiers&& frontiers);

}  // namespace ndtree::python
