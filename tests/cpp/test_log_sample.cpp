// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "ndtree/evaluation/log_sample.hpp"

namespace ndtree::test::test_log_sample {
namespace {

TEST(HeldOut, IsTheLastOfEachGroup) {
  for (const std::size_t held_out : {std::size_t{2}, std::size_t{3}, std::size_t{10}}) {
    std::size_t mapped = 0;
    for (std::size_t i = 0; i < 40; ++i) {
      const bool is_last = mapped == held_out - 1;
      EXPECT_EQ(is_held_out(i, held_out), is_last) << i << " of " << held_out;
      mapped = is_last ? 0 : mapped + 1;
    }
  }
  for (std::size_t i = 0; i < 40; ++i) EXPECT_FALSE(is_held_out(i, 0));
}

/// What a reader keeps that does not know how long the log is: where there are twice as many runs as wanted,
/// it drops every second, and takes half as many from then on.
class OnePass {
 public:
  void add(std::size_t number) {
    if (number % kSampleRun == 0) {
      takes_ = until_next_ == 0;
      if (takes_ && runs_.size() == 2 * kSampleRuns) thin();
      until_next_ = takes_ ? pause_ : until_next_ - 1;
      if (takes_) runs_.emplace_back();
    }
    if (takes_) runs_.back().push_back(number);
  }
  [[nodiscard]] const std::vector<std::vector<std::size_t>>& runs() const { return runs_; }

 private:
  void thin() {
    std::vector<std::vector<std::size_t>> half;
    for (std::size_t i = 0; i < runs_.size(); i += 2) half.push_back(std::move(runs_[i]));
    runs_ = std::move(half);
    pause_ = 2 * pause_ + 1;
  }

  std::vector<std::vector<std::size_t>> runs_;
  std::size_t pause_ = 0, until_next_ = 0;  ///< Runs between those that are taken; of these, still to come.
  bool takes_ = false;
};

TEST(LogSample, IsWhatOnePassOverTheLogKeeps) {
  OnePass pass;
  std::size_t doublings = 0, step = 1;
  for (std::size_t scans = 1; scans <= 6000; ++scans) {
    pass.add(scans - 1);
    doublings += sample_step(scans) != step;
    step = sample_step(scans);
    if (scans % 7 != 0 && scans > 400) continue;
    std::vector<std::size_t> expected, found;
    for (const auto& run : pass.runs()) expected.insert(expected.end(), run.begin(), run.end());
    for (std::size_t i = 0; i < scans; ++i)
      if (i / kSampleRun % step == 0) found.push_back(i);
    ASSERT_EQ(found, expected) << scans;
    ASSERT_LE(pass.runs().size(), 2 * kSampleRuns);
    ASSERT_TRUE(pass.runs().size() >= kSampleRuns || scans <= kSampleRun * kSampleRuns) << scans;
  }
  EXPECT_EQ(doublings, 5u);
}

TEST(LogSample, HasTheScansOfItsRuns) {
  std::vector<Scan<2>> log(1000);
  for (std::size_t i = 0; i < log.size(); ++i) {
    log[i].endpoints = Points<2>::Constant(2, 1, 1.0);
    log[i].origins = Points<2>::Zero(2, 1);
    log[i].stamp = static_cast<double>(i);
  }
  const std::vector<Scan<2>> sample = sample_of(log);
  ASSERT_EQ(sample.size(), 63u * kSampleRun);  // Every fourth of 250 runs.
  for (std::size_t i = 0; i < sample.size(); ++i)
    EXPECT_EQ(sample[i].stamp, static_cast<double>(i / kSampleRun * 4 * kSampleRun + i % kSampleRun));
}

TEST(LogSample, OfAScanHasEachStrideThBeamThatIsNear) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  for (const bool own_origins : {false, true})
    for (const Eigen::Index n : {0, 1, 3999, 4000, 4001, 12000, 12001}) {
      Scan<3> scan;
      scan.stamp = 7.0;
      scan.endpoints = Points<3>::Random(3, n);
      scan.origins = Points<3>::Zero(3, own_origins ? n : 1);
      scan.returned.setConstant(n, true);
      scan.range_sigma.setLinSpaced(n, 1.0, 2.0);
      for (Eigen::Index i = 0; i < n; ++i) {
        scan.returned[i] = i % 3 != 0;
        if (i % 5 == 1) scan.endpoints(2, i) = -1.1e9;
        if (i % 5 == 2) scan.endpoints(0, i) = 1e9;
        if (i % 5 == 3) scan.endpoints(1, i) = kNan;
        if (own_origins) scan.origins(0, i) = i % 7 == 0 ? 2e9 : static_cast<double>(i);
      }
      std::vector<Eigen::Index> expected;
      const Eigen::Index stride = n <= 4000 ? 1 : n <= 8000 ? 2 : n <= 12000 ? 3 : 4;
      for (Eigen::Index i = 0; i < n; i += stride)
        if (i % 5 != 1 && !(own_origins && i % 7 == 0)) expected.push_back(i);
      const Scan<3> sample = sampled_beams(scan);
      ASSERT_EQ(sample.size(), static_cast<Eigen::Index>(expected.size())) << n;
      EXPECT_EQ(sample.stamp, 7.0);
      for (Eigen::Index k = 0; k < sample.size(); ++k) {
        const Eigen::Index i = expected[static_cast<std::size_t>(k)];
        EXPECT_EQ(sample.view().is_returned(k), scan.view().is_returned(i));
        EXPECT_EQ(sample.range_sigma[k], scan.range_sigma[i]);
        EXPECT_EQ(sample.endpoints(0, k), scan.endpoints(0, i));
        EXPECT_EQ(std::isnan(sample.endpoints(1, k)), i % 5 == 3);
        EXPECT_EQ(sample.view().origin(k), scan.view().origin(i));
      }
    }
}

}  // namespace
}  // namespace ndtree::test::test_log_sample
