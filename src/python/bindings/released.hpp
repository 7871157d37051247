// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How a call leaves the interpreter to other threads without growing deaf to signals.
#pragma once

#include <pybind11/pybind11.h>

#include <chrono>
#include <optional>

#include "ndtree/core/cancel.hpp"

namespace ndtree::python {

/// While one lives, the interpreter's lock is left to other threads, and, in the thread that hears signals,
/// long calls stop as soon as a signal's handler raises, as that of Ctrl-C does: they throw Cancelled, and
/// the handler's exception is set.
class Released {
 public:
  Released() {
    if (hears_signals()) scope_.emplace([this] { return was_raised(); }, [this] { return is_raised(); });
  }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::milliseconds kPause{100};  // Asking waits for the interpreter.

  [[nodiscard]] static bool hears_signals();
  [[nodiscard]] bool was_raised() { return Clock::now() >= next_ && is_raised(); }
  [[nodiscard]] bool is_raised() {
    const pybind11::gil_scoped_acquire held;
    const bool raised = PyErr_CheckSignals() != 0;
    next_ = Clock::now() + kPause;
    return raised;
  }

  Clock::time_point next_ = Clock::now() + kPause;
  pybind11::gil_scoped_release released_;
  std::optional<CancelScope> scope_;
};

}  // namespace ndtree::python
