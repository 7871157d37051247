// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The lock of an object that threads of Python share.
#pragma once

#include <chrono>
#include <shared_mutex>

#include "ndtree/core/cancel.hpp"
#include "released.hpp"

namespace ndtree::python {

/// Calls that are at work on shared objects in all threads, counted so that a fork waits until there are none
/// but those of its own thread: only that thread lives on in the child, where a lock of another would never
/// be unlocked, and what another was writing would stay half written.
class CallInProgress {
 public:
  /// Waits while another thread forks.
  CallInProgress();
  ~CallInProgress();
  CallInProgress(const CallInProgress&) = delete;
  CallInProgress& operator=(const CallInProgress&) = delete;

  /// Lets a fork go ahead, for a call that only waits, and holds nothing that it has not held from the start.
  static void give_way();

  /// Around fork(), in its thread. @pre of before_fork(): the interpreter's lock is held; it is left to other
  /// threads while this one waits.
  static void before_fork();
  static void after_fork_in_parent();
  static void after_fork_in_child();
};

/// Any number look, or one changes. Each of them is Released.
class SharedLock {
 public:
  enum class Use { look, change };

  /// Holds the lock until its end.
  class Holder {
   public:
    /// Waits, however long others hold the lock. @param on_wait is called before it waits.
    /// @throws Cancelled, see Released; std::runtime_error if the thread holds the lock already, and would
    /// wait
    ///   for itself: in a signal's handler that a call on the same object has stopped to run. To look while
    ///   one looks is allowed.
    template <class OnWait>
    Holder(SharedLock& lock, Use use, OnWait&& on_wait) : lock_(lock), use_(use), outer_(innermost()) {
      if (const Holder* const own = holder_of(lock)) {
        if (use == Use::change || own->use_ == Use::change) refuse();
        is_nested_ = true;
      } else if (!try_now()) {
        on_wait();
        constexpr std::chrono::milliseconds kPatience{20};
        while (!try_for(kPatience)) {
          checkpoint();
          if (outer_ == nullptr) CallInProgress::give_way();
        }
      }
      innermost() = this;
    }
    Holder(SharedLock& lock, Use use) : Holder(lock, use, [] {}) {}
    Holder(const Holder&) = delete;
    Holder& operator=(const Holder&) = delete;
    ~Holder() {
      innermost() = outer_;
      if (is_nested_) return;
      if (use_ == Use::change)
        lock_.mutex_.unlock();
      else
        lock_.mutex_.unlock_shared();
    }

   private:
    static Holder*& innermost() {
      thread_local Holder* of_thread = nullptr;
      return of_thread;
    }
    static const Holder* holder_of(const SharedLock& lock) {
      const Holder* one = innermost();
      while (one != nullptr && &one->lock_ != &lock) one = one->outer_;
      return one;
    }
    [[noreturn]] static void refuse();
    bool try_now() { return use_ == Use::change ? lock_.mutex_.try_lock() : lock_.mutex_.try_lock_shared(); }
    template <class Duration>
    bool try_for(Duration patience) {
      return use_ == Use::change ? lock_.mutex_.try_lock_for(patience)
                                 : lock_.mutex_.try_lock_shared_for(patience);
    }

    SharedLock& lock_;
    Use use_;
    bool is_nested_ = false;
    Holder* outer_;
  };

 private:
  std::shared_timed_mutex mutex_;
};

}  // namespace ndtree::python
