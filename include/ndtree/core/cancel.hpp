// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How a long call is stopped from outside: by a signal, a button, a deadline.
#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <utility>

#include "ndtree/core/inline.hpp"

namespace ndtree {

/// What a call throws that was stopped.
class Cancelled : public std::exception {
 public:
  [[nodiscard]] const char* what() const noexcept override { return "cancelled"; }
};

/// While one lives, every long call of the thread that made it (insertion, compression, queries of whole
/// maps, files, exports) asks it some fifty times a second whether to stop, and then throws Cancelled.
/// Threads that the call has started stop as well. Scopes may lie within each other: each is asked.
/// ```
/// std::atomic<bool> stop{false};                 // Set by some other thread or a signal handler.
/// const CancelScope scope([&] { return stop.load(); });
/// map.insert(scan);                              // Throws Cancelled; the map is then as it was before.
/// ```
/// What a cancelled call leaves is said where it is declared; where nothing is said, nothing has changed.
class CancelScope {
 public:
  /// @param stop is called in the thread that makes the scope, and no other. What it throws is passed on.
  /// @param stop_now is called by last_checkpoint() in place of `stop`, if given: for a `stop` that does not
  ///   look each time it is called.
  explicit CancelScope(std::function<bool()> stop, std::function<bool()> stop_now = {})
      : stop_(std::move(stop)),
        stop_now_(std::move(stop_now)),
        outer_(here().scope),
        outer_is_borrowed_(here().is_borrowed) {
    here() = {this, false};
  }
  CancelScope(const CancelScope&) = delete;
  CancelScope& operator=(const CancelScope&) = delete;
  ~CancelScope() { here() = {outer_, outer_is_borrowed_}; }

  /// The innermost of this thread; null if there is none.
  [[nodiscard]] static CancelScope* current() { return here().scope; }

  /// Lends the scope of one thread to another, which stops when the first has been told to.
  class Lent {
   public:
    explicit Lent(CancelScope* scope) : before_(here()) { here() = {scope, true}; }
    Lent(const Lent&) = delete;
    Lent& operator=(const Lent&) = delete;
    ~Lent() { here() = before_; }

   private:
    friend CancelScope;
    struct Here {
      CancelScope* scope = nullptr;
      bool is_borrowed = false;
    };
    Here before_;
  };

  /// Asks, if it is time to. @returns whether the calls of this thread are to stop.
  static bool is_cancelled() {
    const Lent::Here now = here();
    if (now.scope == nullptr) return false;
    return now.is_borrowed ? now.scope->was_stopped() : now.scope->asks(Clock::now(), false);
  }
  /// Asks, however short ago it last did.
  static bool is_cancelled_now() {
    const Lent::Here now = here();
    if (now.scope == nullptr) return false;
    return now.is_borrowed ? now.scope->was_stopped() : now.scope->asks(Clock::now(), true);
  }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::milliseconds kPause{20};

  static Lent::Here& here() {
    thread_local Lent::Here of_thread;
    return of_thread;
  }
  [[nodiscard]] bool was_stopped() const {
    return stopped_.load(std::memory_order_relaxed) || (outer_ != nullptr && outer_->was_stopped());
  }
  bool asks(Clock::time_point now, bool at_once) {
    if (was_stopped()) return true;
    if (at_once || now >= next_) {
      next_ = now + kPause;
      try {
        if (at_once && stop_now_ ? stop_now_() : stop_()) stopped_.store(true, std::memory_order_relaxed);
      } catch (...) {  // Then other threads stop, as well.
        stopped_.store(true, std::memory_order_relaxed);
        throw;
      }
    }
    return was_stopped() || (outer_ != nullptr && !outer_is_borrowed_ && outer_->asks(now, at_once));
  }

  std::function<bool()> stop_;
  std::function<bool()> stop_now_;
  std::atomic<bool> stopped_{false};
  Clock::time_point next_{};
  CancelScope* outer_;
  bool outer_is_borrowed_;
};

/// Ends a call that is cancelled. @throws Cancelled.
inline void checkpoint() {
  if (CancelScope::is_cancelled()) throw Cancelled();
}

/// The checkpoint of a call right before what it changes becomes final. It asks at once, so that a wish to
/// stop that came shortly before, and would be noticed as soon as the call has returned, still leaves
/// everything as it was. The call makes no checkpoint after this one. @throws Cancelled.
inline void last_checkpoint() {
  if (CancelScope::is_cancelled_now()) throw Cancelled();
}

/// Checkpoints of a loop: one for about a millisecond of work; the calls between cost a subtraction.
class Pace {
 public:
  /// @param work done since the last call, in steps of some ten nanoseconds.
  NDTREE_ALWAYS_INLINE void spend(std::size_t work = 1) {
    if ((left_ -= static_cast<std::int64_t>(work)) < 0) stop_here();
  }

 private:
  static constexpr std::int64_t kSteps = std::int64_t{1} << 15;
  NDTREE_NEVER_INLINE void stop_here() {
    left_ = kSteps;
    checkpoint();
  }
  std::int64_t left_ = kSteps;
};

/// Calls `visit(i)` for each i below n. @param work of one, as for Pace::spend().
template <class Visit>
void for_each_paced(std::size_t n, std::size_t work, Visit&& visit) {
  Pace pace;
  for (std::size_t i = 0; i < n; ++i) {
    pace.spend(work);
    visit(i);
  }
}

}  // namespace ndtree
