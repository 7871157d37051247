// SPDX-License-Identifier: BSD-3-Clause
#include "shared_lock.hpp"

#include <condition_variable>
#include <mutex>
#include <new>
#include <stdexcept>

namespace ndtree::python {

namespace {

/// Never destroyed: threads may be at work while the process ends.
struct Gate {
  std::mutex mutex;
  std::condition_variable changed;
  int calls = 0;  // Threads that have some in progress.
  bool is_forking = false;
};
Gate& gate() {
  static Gate* const one = new Gate;
  return *one;
}

/// Calls of this thread: more than one where a signal's handler makes some.
int& own_calls() {
  thread_local int count = 0;
  return count;
}

void begin() {
  std::unique_lock lock(gate().mutex);
  gate().changed.wait(lock, [] { return !gate().is_forking; });
  ++gate().calls;
}
void end() {
  {
    const std::lock_guard lock(gate().mutex);
    --gate().calls;
  }
  gate().changed.notify_all();
}

}  // namespace

CallInProgress::CallInProgress() {
  if (own_calls() == 0) begin();
  ++own_calls();
}

CallInProgress::~CallInProgress() {
  if (--own_calls() == 0) end();
}

void CallInProgress::give_way() {
  if (own_calls() != 1) return;  // The call of which a signal's handler makes this one holds something.
  end();
  begin();
}

void CallInProgress::before_fork() {
  const pybind11::gil_scoped_release released;
  std::unique_lock lock(gate().mutex);
  gate().changed.wait(lock, [] { return !gate().is_forking; });
  gate().is_forking = true;
  gate().changed.wait(lock, [] { return gate().calls == (own_calls() > 0 ? 1 : 0); });
}

void CallInProgress::after_fork_in_parent() {
  {
    const std::lock_guard lock(gate().mutex);
    gate().is_forking = false;
  }
  gate().changed.notify_all();
}

void CallInProgress::after_fork_in_child() {
  Gate* const fresh = new (&gate()) Gate;  // Threads that are gone may have waited at the old one.
  fresh->calls = own_calls() > 0 ? 1 : 0;
}

void SharedLock::Holder::refuse() {
  throw std::runtime_error(
      "the object is in use by the call that this signal's handler has interrupted: ask it, or change it, "
      "when that call has returned");
}

}  // namespace ndtree::python
