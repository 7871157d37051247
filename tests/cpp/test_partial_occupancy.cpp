// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "ndtree/cell/partial_occupancy.hpp"

namespace ndtree::test::test_partial_occupancy {
namespace {

SplitOptions options_of(double hit_given_free, double miss_given_occupied) {
  SplitOptions options;
  options.hit_given_free = hit_given_free;
  options.miss_given_occupied = miss_given_occupied;
  return options;
}

/// The mean of rho^hits (1 - rho)^misses over [from, to], relative to its largest value anywhere: by Gauss's
/// three points in each of many pieces.
long double mean_likelihood(double hits, double misses, long double from, long double to) {
  const long double n = hits + misses;
  const auto log_likelihood = [&](long double rho) {
    return hits * std::log(rho) + misses * std::log1p(-rho);
  };
  const bool inside = hits > 0 && misses > 0;
  const long double peak = inside ? log_likelihood(hits / n) : 0.0L;
  constexpr int kPieces = 1500;
  const long double half = 0.5L * (to - from) / kPieces;
  const long double node = std::sqrt(0.6L) * half;
  long double sum = 0.0L;
  for (int i = 0; i < kPieces; ++i) {
    const long double middle = from + (2 * i + 1) * half;
    sum += 8.0L * std::exp(log_likelihood(middle) - peak);
    sum += 5.0L * std::exp(log_likelihood(middle - node) - peak);
    sum += 5.0L * std::exp(log_likelihood(middle + node) - peak);
  }
  return sum / 18.0L / kPieces;
}

struct Rates {
  double hit_given_free, miss_given_occupied;
};
constexpr Rates kRates[] = {{0.05, 0.1}, {0.01, 0.05}, {0.3, 0.2}, {0.45, 0.5}};

TEST(PartialOccupancy, EqualsTheThreeIntegrals) {
  for (const Rates& rates : kRates) {
    const PartialOccupancyModel model(options_of(rates.hit_given_free, rates.miss_given_occupied));
    for (const std::uint32_t hits : {0u, 1u, 2u, 7u, 40u, 300u, 4095u})
      for (const std::uint32_t misses : {0u, 1u, 3u, 11u, 60u, 500u, 4095u}) {
        SCOPED_TRACE(std::to_string(hits) + " hits, " + std::to_string(misses) + " misses");
        const long double u = rates.hit_given_free;
        const long double v = 1.0L - rates.miss_given_occupied;
        const long double free = mean_likelihood(hits, misses, 0.0L, u);
        const long double occupied = mean_likelihood(hits, misses, v, 1.0L);
        const long double partial = mean_likelihood(hits, misses, u, v);
        const long double sum = free + occupied + partial;
        const OccupancyHypotheses what = model(hits, misses);
        EXPECT_NEAR(what.free, static_cast<double>(free / sum), 1e-8);
        EXPECT_NEAR(what.occupied, static_cast<double>(occupied / sum), 1e-8);
        EXPECT_NEAR(what.partial, static_cast<double>(partial / sum), 1e-8);
        EXPECT_NEAR(what.free + what.occupied + what.partial, 1.0, 1e-14);
      }
  }
}

TEST(PartialOccupancy, RatesThatLeaveNoRoomAreRefused) {
  struct Row {
    double hit_given_free, miss_given_occupied;
    bool room;
  };
  const Row rows[] = {{0.5, 0.5, false}, {0.75, 0.25, false}, {0.9, 0.2, false},
                      {0.25, 0.5, true}, {0.5, 0.25, true},   {0.75, 0.125, true}};
  for (const Row& row : rows) {
    try {
      const PartialOccupancyModel model(options_of(row.hit_given_free, row.miss_given_occupied));
      EXPECT_TRUE(row.room) << row.hit_given_free;
    } catch (const std::invalid_argument& error) {
      EXPECT_FALSE(row.room);
      const std::string text = error.what();
      EXPECT_EQ(text.rfind("hit_given_free = 0.", 0), 0u) << text;
      EXPECT_NE(text.find("must be less than 1 - miss_given_occupied"), std::string::npos) << text;
    }
  }
}

TEST(PartialOccupancySplitTest, RemembersWhatTheModelSays) {
  std::vector<std::uint32_t> counts(120);
  std::iota(counts.begin(), counts.end(), 0u);
  for (std::uint32_t count = 500; count < 520; ++count)
    counts.push_back(count);  // Beyond what is remembered.
  for (const double probability : {0.5, 0.7})
    for (const double miss_given_occupied : {0.1, 0.25}) {
      SplitOptions options = options_of(0.05, miss_given_occupied);
      options.split_probability = probability;
      const PartialOccupancyModel model(options);
      const PartialOccupancySplitTest test(options);
      const PartialOccupancySplitTest copy = test;
      const auto ask_all = [&](const PartialOccupancySplitTest& of) {
        int splits = 0;
        for (const std::uint32_t hits : counts)
          for (const std::uint32_t misses : counts) {
            const bool says = of(hits, misses);
            EXPECT_EQ(says, model(hits, misses).partial > probability) << hits << ", " << misses;
            splits += says;
          }
        return splits;
      };
      const int splits = ask_all(test);
      EXPECT_GT(splits, 1000);
      EXPECT_EQ(ask_all(test), splits);
      EXPECT_EQ(ask_all(copy), splits);
      EXPECT_EQ(ask_all(PartialOccupancySplitTest(options)), splits);
    }
}

TEST(PartialOccupancySplitTest, IsAskedByManyThreads) {
  const PartialOccupancyModel model(options_of(0.04, 0.1));
  std::array<int, 4> wrong{};
  std::vector<std::thread> threads;
  for (std::size_t t = 0; t < wrong.size(); ++t)
    threads.emplace_back([&, t] {
      const PartialOccupancySplitTest test(options_of(0.04, 0.1));  // They share what they remember.
      for (std::uint32_t hits = 0; hits < 60; ++hits)
        for (std::uint32_t misses = 0; misses < 60; ++misses)
          wrong[t] += test(hits, misses) != (model(hits, misses).partial > 0.7);
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, (std::array<int, 4>{}));
}

}  // namespace
}  // namespace ndtree::test::test_partial_occupancy
