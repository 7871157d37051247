// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Scans and poses for maps that follow them, and random calls.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/history/scan_history.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "options.hpp"
#include "random.hpp"
#include "random_rotation.hpp"  // random_pose(), for those who include this.

namespace ndtree::test {

/// Of maps whose root grows several times around scans some metres apart.
inline MapOptions options_of_history(int branching) {
  MapOptions options = spelled_out_options(0.1, 0.1 * std::pow(branching, branching == 2 ? 4 : 2));
  options.range_sigma = 0.02;
  options.sample_beams = 2.0;
  return options;
}

/// Beams to a wall all around, with some that do not return or are not finite.
template <int D>
Scan<D> random_scan(Random& random) {
  Scan<D> scan;
  const int beams = random.integer(5, 60);
  scan.origins = Vector<D>::Zero();
  scan.endpoints.resize(D, beams);
  scan.returned.resize(beams);
  for (int i = 0; i < beams; ++i) {
    Vector<D> direction;
    for (double& x : direction) x = random.uniform(-1.0, 1.0);
    scan.endpoints.col(i) = direction * (random.uniform(0.5, 4.0) / (direction.norm() + 0.01));
    scan.returned[i] = !random.chance(0.1);
    if (random.chance(0.02)) scan.endpoints(0, i) = std::numeric_limits<double>::quiet_NaN();
  }
  if (random.chance(0.2)) scan.range_sigma = Eigen::ArrayXd::Constant(beams, random.uniform(0.01, 0.05));
  if (random.chance(0.2)) {
    scan.origins.resize(D, beams);
    for (Eigen::Index i = 0; i < scan.origins.size(); ++i) scan.origins(i) = random.uniform(-0.2, 0.2);
  }
  return scan;
}

/// Plays random calls, and compares with a map that took the same scans in at once.
/// @tparam Taken of a history and a key: the scan as the history has kept it. insert_into(map, number)
/// inserts
///   it, insert(random, history, key, scan, number, pose, max_range) gives it to a history, and bytes_of(map)
///   is all of a map but the counters of how it was made.
/// @returns how often scans were mapped again.
template <class Map, class Taken>
std::size_t play(std::uint64_t seed, int calls) {
  constexpr int D = Map::kDim;
  Random random(seed);
  SCOPED_TRACE(random.trace());
  ScanHistory<Map> history(options_of_history(Map::kBranching));
  std::map<std::uint64_t, std::int64_t> present;  // Keys, by number.
  std::vector<std::pair<std::uint64_t, Taken>> frozen;
  std::uint64_t number = 0;
  std::size_t replayed = 0;
  for (int call = 0; call < calls; ++call) {
    const int what = random.integer(0, 10);
    if (present.size() < 3 || what < 5) {
      const auto key = static_cast<std::int64_t>(1000 - 7 * number);
      if (random.chance(0.3)) number += 2;
      Taken::insert(random, history, key, random_scan<D>(random), number, random_pose<D>(random, 8.0),
                    random.chance(0.5) ? 3.0 : kUnlimitedRange);
      present.emplace(number++, key);
    } else if (what < 8) {
      std::vector<std::pair<std::int64_t, Pose<D>>> poses;
      for (const auto& [n, key] : present) {
        if (!random.chance(0.3)) continue;
        Pose<D> pose = random.chance(0.3) ? random_pose<D>(random, 8.0) : history.pose(key);
        for (double& x : pose.translation) x += random.uniform(-0.2, 0.2);
        poses.emplace_back(key, pose);
      }
      std::reverse(poses.begin(), poses.end());
      const HistoryReport report = history.move(poses, 1 + random.integer(0, 1));
      EXPECT_EQ(report.moved, poses.size());
      EXPECT_LE(report.cube_scans, report.all_cube_scans);
      replayed += report.replayed;
    } else if (what == 10) {
      const std::size_t count = std::min<std::size_t>(2, present.size());
      auto end = present.begin();
      for (std::size_t i = 0; i < count; ++i, ++end)
        frozen.emplace_back(end->first, Taken(history, end->second));
      history.freeze(count);
      present.erase(present.begin(), end);
      EXPECT_EQ(history.num_frozen(), frozen.size());
    } else {
      auto gone = present.begin();
      std::advance(gone, random.integer(0, static_cast<int>(present.size()) - 1));
      (void)history.remove({gone->second});
      present.erase(gone);
    }
    EXPECT_EQ(history.size(), present.size());
    if (call % 4 != 3 && call + 1 != calls) continue;
    Map expected(options_of_history(Map::kBranching));
    for (const auto& [n, taken] : frozen) taken.insert_into(expected, n);
    for (const auto& [n, key] : present) Taken(history, key).insert_into(expected, n);
    EXPECT_TRUE(Taken::bytes_of(history.map()) == Taken::bytes_of(expected)) << "after call " << call;
  }
  return replayed;
}

}  // namespace ndtree::test
