// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Instead of the library's: the tasks of all workers, one after the other in one thread, and their time.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <functional>
#include <numeric>
#include <queue>
#include <utility>
#include <vector>

#include "ndtree/core/even_ranges.hpp"

namespace ndtree {

/// What workers had to do, in the order of time [s].
struct WorkPhase {
  double alone = 0.0;             ///< Before it, in one thread.
  std::vector<double> tasks;      ///< As they are numbered.
  std::size_t first = 0;          ///< Of the tasks in ranges; tasks before it have no owner.
  std::vector<std::size_t> ends;  ///< Of the share of each worker among them.

  [[nodiscard]] double work() const { return std::accumulate(tasks.begin(), tasks.end(), alone); }
  /// Until all workers are done, which take tasks without an owner, then their own range, and then others'
  /// tasks.
  [[nodiscard]] double seconds() const {
    struct Worker {
      double free_at;
      std::size_t number;
      std::size_t helps;  // The worker that many places behind.
      bool operator>(const Worker& other) const { return free_at > other.free_at; }
    };
    std::priority_queue<Worker, std::vector<Worker>, std::greater<>> free;
    std::size_t nobodys = 0;
    std::vector<std::size_t> next(ends.size(), first);
    for (std::size_t i = 0; i < ends.size(); ++i) {
      free.push({0.0, i, 0});
      if (i > 0) next[i] = ends[i - 1];
    }
    double end = 0.0;
    while (!free.empty()) {
      Worker worker = free.top();
      free.pop();
      std::size_t share = (worker.number + worker.helps) % ends.size();
      while (nobodys == first && worker.helps < ends.size() && next[share] == ends[share])
        share = (worker.number + ++worker.helps) % ends.size();
      if (worker.helps == ends.size()) continue;
      worker.free_at += tasks[nobodys < first ? nobodys++ : next[share]++];
      end = std::max(end, worker.free_at);
      free.push(worker);
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
    for_each_task(0, even_ranges(tasks, std::min(count_, tasks)), work);
  }
  template <class Work>
  void for_each_task(std::size_t first, const std::vector<std::size_t>& ends, Work&& work) {
    WorkPhase& phase = next_phase();
    phase.first = first;
    phase.ends = ends.empty() ? std::vector<std::size_t>{first} : ends;
    std::size_t task = 0;
    for (std::size_t worker = 0; worker < phase.ends.size(); ++worker)
      for (; task < phase.ends[worker]; ++task) {
        const Clock::time_point begin = Clock::now();
        work(worker, task);
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
    WorkPhase& phase = phases_.emplace_back();
    phase.alone = seconds_since(last_);
    return phase;
  }

  inline static std::vector<WorkPhase> phases_;
  inline static Clock::time_point last_;
  std::size_t count_;
};

}  // namespace ndtree
