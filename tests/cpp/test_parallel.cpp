// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/parallel.hpp"

namespace ndtree::test::test_parallel {
namespace {

TEST(Workers, DoEachTaskOnce) {
  for (const std::size_t threads : {1u, 2u, 5u}) {
    Workers workers(threads);
    for (const std::size_t tasks : {0u, 1u, 2u, 3u, 1000u, 2u, 3u, 4u}) {
      std::vector<std::atomic<int>> done(tasks);
      std::vector<std::atomic<int>> at_work(threads);
      workers.for_each_task(tasks, [&](std::size_t worker, std::size_t task) {
        EXPECT_LT(worker, tasks) << "more workers than tasks";
        EXPECT_EQ(at_work.at(worker)++, 0) << "two tasks at once";
        ++done.at(task);
        if (tasks < threads) std::this_thread::sleep_for(std::chrono::milliseconds(2));  // All wake up.
        --at_work.at(worker);
      });
      for (const auto& times : done) EXPECT_EQ(times, 1);
    }
  }
}

TEST(Workers, BeginWithTheirShares) {
  constexpr std::size_t kWorkers = 3;
  Workers workers(kWorkers);
  for (const std::size_t nobodys : {0u, 1u, 7u})
    for (const std::vector<std::size_t>& sizes : {std::vector<std::size_t>{2, 3, 4},
                                                  {0, 4, 0},
                                                  {4, 0, 4},
                                                  {7, 0, 0},
                                                  {3, 3},
                                                  {0, 1},
                                                  {5},
                                                  {0, 0, 0},
                                                  {}}) {
      std::vector<std::size_t> ends;
      for (const std::size_t size : sizes) ends.push_back((ends.empty() ? nobodys : ends.back()) + size);
      const std::size_t tasks = ends.empty() ? nobodys : ends.back();
      std::vector<std::atomic<std::size_t>> done_by(tasks);
      for (auto& worker : done_by) worker = kWorkers;
      std::vector<std::vector<std::size_t>> tasks_of(kWorkers);
      std::atomic<std::size_t> begun{0};
      workers.for_each_task(nobodys, ends, [&](std::size_t worker, std::size_t task) {
        EXPECT_LT(worker, std::max<std::size_t>(1, ends.size()));
        EXPECT_EQ(done_by.at(task).exchange(worker), kWorkers) << "twice";
        tasks_of.at(worker).push_back(task);
        // All begin with something before anybody is done with it.
        const std::size_t at_once = std::min(ends.size(), tasks);
        ++begun;
        for (int i = 0; i < 100'000 && begun < at_once; ++i)
          std::this_thread::sleep_for(std::chrono::microseconds(50));
        EXPECT_GE(begun, at_once);
      });
      for (const auto& worker : done_by) EXPECT_LT(worker, kWorkers) << "not done";
      // A worker without tasks of its own may start before others, and help them.
      const bool have_all = std::count(sizes.begin(), sizes.end(), 0u) == 0;
      for (std::size_t i = 0; have_all && nobodys == 0 && i < ends.size(); ++i)
        EXPECT_EQ(tasks_of[i].at(0), i == 0 ? 0 : ends[i - 1]) << "of worker " << i;
      for (const std::vector<std::size_t>& of_worker : tasks_of)
        EXPECT_TRUE(std::is_partitioned(of_worker.begin(), of_worker.end(), [&](std::size_t task) {
          return task < nobodys;
        })) << "nobody's come first";
    }
}

TEST(Workers, WorkAtTheSameTime) {
  Workers workers(2);
  std::atomic<int> begun{0};
  workers.for_each_task(2, [&](std::size_t, std::size_t) {
    ++begun;
    for (int i = 0; i < 10000 && begun < 2; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    EXPECT_EQ(begun, 2);
  });
}

TEST(Workers, ThrowWhatTheFirstTaskThrows) {
  for (const std::size_t threads : {1u, 3u}) {
    Workers workers(threads);
    for (int i = 0; i < 200; ++i) {
      try {
        workers.for_each_task(100, [&](std::size_t, std::size_t task) {
          if (task == 7) std::this_thread::sleep_for(std::chrono::microseconds(100));  // Others fail first.
          if (task >= 7) throw std::runtime_error(std::to_string(task));
        });
        ADD_FAILURE() << "nothing was thrown";
      } catch (const std::runtime_error& error) {
        EXPECT_STREQ(error.what(), "7");
      }
    }
    std::atomic<int> done{0};
    workers.for_each_task(10, [&](std::size_t, std::size_t) { ++done; });
    EXPECT_EQ(done, 10) << "after a failure";
  }
}

TEST(Workers, BeginNothingAfterTheyHaveFailed) {
  constexpr std::size_t kWorkers = 3;
  Workers workers(kWorkers);
  for (int i = 0; i < 200; ++i) {
    std::vector<std::atomic<bool>> has_failed(kWorkers);
    EXPECT_THROW(workers.for_each_task(100,
                                       [&](std::size_t worker, std::size_t task) {
                                         EXPECT_FALSE(has_failed.at(worker));
                                         if (task % 10 != static_cast<std::size_t>(i % 10)) return;
                                         has_failed.at(worker) = true;
                                         throw std::runtime_error("failed");
                                       }),
                 std::runtime_error);
  }
}

/// The exception of the question wins over Cancelled of workers that stop because of it.
TEST(Workers, PassOnWhatTheQuestionInATaskThrows) {
  Workers workers(2);
  for (const std::size_t asking : {0u, 1u}) {
    std::atomic<int> begun{0};
    std::atomic<bool> has_thrown{false};
    const CancelScope scope([] { return true; });
    EXPECT_THROW(workers.for_each_task(2,
                                       [&](std::size_t, std::size_t task) {
                                         ++begun;
                                         for (int i = 0; i < 10000 && begun < 2; ++i)
                                           std::this_thread::sleep_for(std::chrono::milliseconds(1));
                                         if (task == asking) {
                                           has_thrown = true;
                                           throw std::runtime_error("asked");
                                         }
                                         for (int i = 0; i < 10000 && !has_thrown; ++i)
                                           std::this_thread::sleep_for(std::chrono::milliseconds(1));
                                         throw Cancelled();
                                       }),
                 std::runtime_error)
        << "in task " << asking;
  }
}

TEST(Workers, AreAllDoneWhenTheQuestionWhetherToStopThrows) {
  Workers workers(2);
  std::atomic<int> begun{0};
  std::atomic<bool> done{false};
  const CancelScope scope([]() -> bool { throw std::runtime_error("asked"); });
  try {
    workers.for_each_task(2, [&](std::size_t worker, std::size_t) {
      ++begun;
      while (begun < 2) std::this_thread::sleep_for(std::chrono::milliseconds(1));  // Both work.
      if (worker == 0) return;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      EXPECT_TRUE(CancelScope::is_cancelled()) << "it was not told";
      done = true;
    });
    ADD_FAILURE() << "nothing was thrown";
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "asked");
  }
  EXPECT_TRUE(done);
}

}  // namespace
}  // namespace ndtree::test::test_parallel
