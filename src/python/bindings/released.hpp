// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How a call leaves the interpreter to other threads, and waits for what they hold, without growing deaf.
#pragma once

#include <pybind11/pybind11.h>

#include <chrono>
#include <optional>
#include <shared_mutex>

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

/// What threads share, each of them Released: any number look, or one writes.
using SharedMutex = std::shared_timed_mutex;

/// Waits until the lock is held, however long others hold it. @throws Cancelled, see Released.
template <class Lock>
void wait_for(Lock& lock) {
  constexpr std::chrono::milliseconds kPatience{20};
  while (!lock.owns_lock() && !lock.try_lock_for(kPatience)) checkpoint();
}

}  // namespace ndtree::python
