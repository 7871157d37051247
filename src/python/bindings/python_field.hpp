// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The object behind a Python distance field, guarded so that threads may share it.
#pragma once

#include <utility>

#include "map_queries.hpp"
#include "released.hpp"
#include "shared_lock.hpp"

namespace ndtree::python {

/// A field that threads share: any number ask it, or one brings it up to date. As with maps, the lock is
/// taken when the interpreter's has been left; its holder takes no other one.
class PythonField {
 public:
  explicit PythonField(AnyField field) : field_(std::move(field)) {}

  template <class Function>
  auto read(Function&& function) const {
    const Released released;
    const CallInProgress call;
    const SharedLock::Holder holder(lock_, SharedLock::Use::look);
    return function(std::as_const(field_));
  }
  template <class Function>
  auto write(Function&& function) {
    const Released released;
    const CallInProgress call;
    const SharedLock::Holder holder(lock_, SharedLock::Use::change);
    return function(field_);
  }
  /// Of which all but the values never changes.
  [[nodiscard]] const AnyField& constant() const { return field_; }

 private:
  AnyField field_;
  mutable SharedLock lock_;
};

}  // namespace ndtree::python
