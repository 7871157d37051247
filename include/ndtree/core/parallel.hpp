// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Loops over tasks that several threads work on.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/inline.hpp"

namespace ndtree {

/// The end of each worker's range of tasks, if [0, tasks) is divided evenly among them, in order.
[[nodiscard]] inline std::vector<std::size_t> even_ranges(std::size_t tasks, std::size_t workers) {
  std::vector<std::size_t> ends(workers);
  for (std::size_t i = 0; i < workers; ++i) ends[i] = tasks * (i + 1) / workers;
  return ends;
}

/// Threads that wait for work until they are gone. The one that makes them is worker number 0. Work often
/// comes in short pieces one after the other, so idle workers spin briefly before sleeping.
class Workers {
 public:
  /// @param threads that may work at once, >= 1. They are started when there is work for them.
  explicit Workers(std::size_t threads) : count_(threads) {}
  Workers(const Workers&) = delete;
  Workers& operator=(const Workers&) = delete;
  ~Workers() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      job_ = {};
      ++jobs_;
    }
    wake_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

  [[nodiscard]] std::size_t count() const { return count_; }

  /// Calls `work(worker, task)` once for each task in [0, tasks). Each worker begins with a range of its
  /// own, and then takes tasks that others have not begun (work stealing). Called again with tasks in the
  /// same order, workers mostly find their data in their core's own cache. There are no more workers than
  /// tasks. Returns when all are done.
  /// @throws what the failing task with the lowest number has thrown, also if another failed earlier in time;
  ///   later tasks may then not have begun, and a worker that has failed begins none. Or Cancelled, see
  ///   CancelScope, if nothing else was thrown.
  template <class Work>
  void for_each_task(std::size_t tasks, Work&& work) {
    run_tasks(0, even_ranges(tasks, std::max<std::size_t>(1, std::min(count_, tasks))), std::ref(work));
  }
  /// As above with ranges of any size, and before them tasks without an owner: an idle worker takes the next.
  /// @param first of the tasks in ranges. @param ends of the ranges, one behind the other, of as many workers
  ///   as are to work, not more than there are; the last is the number of tasks.
  template <class Work>
  void for_each_task(std::size_t first, const std::vector<std::size_t>& ends, Work&& work) {
    run_tasks(first, ends, std::ref(work));
  }

 private:
  /// Tasks side by side that workers take one by one.
  struct alignas(kCacheLines) Range {
    std::atomic<std::size_t> next{0};
    std::size_t end = 0;
  };

  /// As for_each_task(); compiled once, whatever the work.
  NDTREE_NEVER_INLINE void run_tasks(std::size_t first, const std::vector<std::size_t>& ends,
                                     const std::function<void(std::size_t, std::size_t)>& work) {
    const std::size_t tasks = ends.empty() ? first : ends.back();
    if (ends.size() <= 1 || tasks <= 1) {
      for (std::size_t task = 0; task < tasks; ++task) work(0, task);
      return;
    }
    Range unowned;
    unowned.end = first;
    std::vector<Range> ranges(ends.size());
    for (std::size_t i = 0; i < ranges.size(); ++i) {
      ranges[i].next = i == 0 ? first : ends[i - 1];
      ranges[i].end = ends[i];
    }
    std::mutex failing;
    std::atomic<std::size_t> failed{tasks};  // Tasks from here on are not begun.
    std::exception_ptr error;
    std::size_t failed_first = tasks;  // Whose error that is; none's if it is Cancelled.
    CancelScope* const scope = CancelScope::current();
    run([&](std::size_t worker) {
      if (worker >= ranges.size()) return;
      std::optional<CancelScope::Lent> lent;
      if (worker > 0) lent.emplace(scope);
      /// Whether all went well.
      const auto work_off = [&](Range& range) {
        for (std::size_t task = range.next++; task < range.end && task < failed; task = range.next++) {
          try {
            work(worker, task);
          } catch (const Cancelled&) {
            const std::lock_guard<std::mutex> lock(failing);
            if (!error) error = std::current_exception();
            failed = 0;
            return false;
          } catch (...) {
            const std::lock_guard<std::mutex> lock(failing);
            if (task < failed_first) error = std::current_exception();
            failed_first = std::min(failed_first, task);
            failed = std::min<std::size_t>(failed, task);
            return false;
          }
        }
        return true;
      };
      bool is_well = work_off(unowned);
      for (std::size_t i = 0; is_well && i < ranges.size(); ++i)
        is_well = work_off(ranges[(worker + i) % ranges.size()]);
    });
    if (error) std::rethrow_exception(error);
    checkpoint();
  }
  /// Calls `job(worker)` once for each worker.
  void run(std::function<void(std::size_t)> job) {
    bool any_asleep = false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      job_ = std::move(job);
      busy_ = threads_.size();
      ++jobs_;
      any_asleep = num_asleep_ > 0;
    }
    if (any_asleep) wake_.notify_all();
    start_missing();
    job_(0);
    if (wait_awake([this] { return busy_ == 0; })) return;
    std::exception_ptr error;  // Of the question whether to stop, kept until all have.
    std::unique_lock<std::mutex> lock(mutex_);
    while (!done_.wait_for(lock, std::chrono::milliseconds(20), [this] { return busy_ == 0; })) {
      lock.unlock();
      try {
        (void)CancelScope::is_cancelled();  // Then the others stop, too.
      } catch (...) {
        error = std::current_exception();
      }
      lock.lock();
    }
    if (error) std::rethrow_exception(error);
  }

  void start_missing() {
    try {
      while (threads_.size() + 1 < count_) {
        const std::lock_guard<std::mutex> lock(mutex_);
        threads_.emplace_back([this, worker = threads_.size() + 1, seen = jobs_ - 1] { live(worker, seen); });
        ++busy_;
      }
    } catch (...) {  // No more threads are to be had, or no memory for them: these will do.
      count_ = threads_.size() + 1;
    }
  }

  void live(std::size_t worker, std::size_t seen) {
    for (;;) {
      const auto is_called = [&] { return jobs_ != seen; };
      if (!wait_awake(is_called)) {
        std::unique_lock<std::mutex> lock(mutex_);
        ++num_asleep_;
        wake_.wait(lock, is_called);
        --num_asleep_;
      }
      seen = jobs_;
      if (!job_) return;
      job_(worker);
      const std::lock_guard<std::mutex> lock(mutex_);
      if (--busy_ == 0) done_.notify_one();
    }
  }
  /// Whether something happens within a moment.
  template <class Condition>
  static bool wait_awake(const Condition& has_happened) {
    constexpr std::chrono::microseconds kMoment{50};
    const auto end = std::chrono::steady_clock::now() + kMoment;
    do {
      for (int i = 0; i < 16; ++i) {
        if (has_happened()) return true;
        pause_briefly();
      }
    } while (std::chrono::steady_clock::now() < end);
    return false;
  }
  /// Leaves what a core has to the other thread of the core, if there is one.
  static void pause_briefly() {
#if defined(__x86_64__) && (defined(__GNUC__) || defined(__clang__))
    __builtin_ia32_pause();
#elif defined(__aarch64__) && (defined(__GNUC__) || defined(__clang__))
    __asm__ volatile("yield");
#endif
  }

  std::size_t count_;
  std::vector<std::thread> threads_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::condition_variable done_;
  std::function<void(std::size_t)> job_;  // None: there will be no more.
  // Written by who has the mutex, and read without by who waits awake:
  std::atomic<std::size_t> jobs_{0};
  std::atomic<std::size_t> busy_{0};  // Threads that have not finished the job.
  std::size_t num_asleep_ = 0;
};

}  // namespace ndtree
