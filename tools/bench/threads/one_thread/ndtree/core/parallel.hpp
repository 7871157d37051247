// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Instead of the library's: the tasks of all workers, one after the other in one thread, and their time.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <functional>
#include <queue>
#include <utility>
#include <vector>

namespace ndtree {

/// What workers had to do, in the order of time [s].
struct WorkPhase {
  double alone = 0.0;         ///< Before it, in one thread.
  std::vector<double> tasks;  ///< As they are handed out.

  /// Until so many workers are done, each of which takes the next task when it is free.
  [[nodiscard]] double seconds(std::size_t workers) const {
    std::priority_queue<double, std::vector<double>, std::greater<>> free_at;
    for (std::size_t i = 0; i < workers; ++i) free_at.push(0.0);
    double end = 0.0;
    for (const double task : tasks) {
      const double done = free_at.top() + task;
      free_at.pop();
      free_at.push(done);
      end = std::max(end, done);
    }
    return alone + end;
  }
};

class Workers {
 public:
  explicit Workers(std::size_t threads) : count_(threads) {}

  [[nodiscard]] std::size_t count() const { return count_; }
  template <class Work>
  void for_each_task(std::size_t tasks, Work&& work) {
    WorkPhase& phase = next_phase();
    for (std::size_t task = 0; task < tasks; ++task) {
      const Clock::time_point begin = Clock::now();
      work(task % count_, task);
      phase.tasks.push_back(seconds_since(begin));
    }
    last_ = Clock::now();
  }

  /// Forgets what was done.
  static void begin() {
    phases_.clear();
    last_ = Clock::now();
  }
  /// What was done since then.
  [[nodiscard]] static std::vector<WorkPhase> end() {
    next_phase();
    return std::exchange(phases_, {});
  }

 private:
  using Clock = std::chrono::steady_clock;
  static double seconds_since(Clock::time_point begin) {
    return std::chrono::duration<double>(Clock::now() - begin).count();
  }
  static WorkPhase& next_phase() {
    phases_.push_back({seconds_since(last_), {}});
    return phases_.back();
  }

  inline static std::vector<WorkPhase> phases_;
  inline static Clock::time_point last_;
  std::size_t count_;
};

}  // namespace ndtree
