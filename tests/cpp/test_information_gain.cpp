// SPDX-License-Identifier: BSD-3-Clause
// What a sensor would see anew, against steps along beams and against points that are in sight.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/information_gain.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "random_rotation.hpp"

namespace ndtree::test::test_information_gain {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kPi = 3.14159265358979324;

template <class Map>
Map random_map(Random& random) {
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 1.0;
  options.range_sigma = 0.05;
  Map map = test::random_map<Map>(random, options, 1);
  constexpr int D = Map::kDim;
  for (int i = 0; i < 16; ++i) {  // Blocks, and free space between them and what is unknown.
    Vector<D> lower;
    for (double& x : lower) x = random.uniform(-3.0, 2.0);
    const bool is_block = i >= 8;
    map.mark(Box<D>{lower, (lower.array() + (is_block ? 0.4 : 1.0)).matrix()},
             is_block ? CellState::occupied : CellState::free);
  }
  return map;
}
/// All around, each beam as wide as the gap to its neighbours.
BeamPattern<2> all_around_2(int beams, double max_range) {
  BeamPattern<2> sensor;
  sensor.directions.resize(2, beams);
  sensor.spacing.setConstant(1, beams, 2.0 * kPi / beams);
  for (int i = 0; i < beams; ++i) {
    const double angle = 2.0 * kPi * (i + 0.5) / beams;
    sensor.directions.col(i) << std::cos(angle), std::sin(angle);
  }
  sensor.max_range = max_range;
  return sensor;
}
/// Rings of equal solid angle.
BeamPattern<3> all_around_3(int rings, double max_range) {
  BeamPattern<3> sensor;
  const int beams = 2 * rings * rings;
  sensor.directions.resize(3, beams);
  sensor.spacing.resize(2, beams);
  for (int i = 0; i < beams; ++i) {
    const double z = -1.0 + 2.0 * (i / (2 * rings) + 0.5) / rings;
    const double azimuth = 2.0 * kPi * (i % (2 * rings) + 0.5) / (2 * rings);
    const double flat = std::sqrt(1.0 - z * z);
    sensor.directions.col(i) << flat * std::cos(azimuth), flat * std::sin(azimuth), z;
    sensor.spacing.col(i) << kPi / rings * flat, 2.0 / rings / flat;
  }
  sensor.max_range = max_range;
  return sensor;
}

/// Steps along each beam: every one asks the map what is there.
template <class Map>
InformationGain by_steps(const Map& map, const Pose<Map::kDim>& pose, const BeamPattern<Map::kDim>& sensor) {
  constexpr int D = Map::kDim;
  constexpr double kStep = 0.001;
  const double edge = map.options().min_cell_size;
  const HitRateModel model(map.options());
  InformationGain gain;
  for (Eigen::Index i = 0; i < sensor.directions.cols(); ++i) {
    const Vector<D> direction = pose.rotation * sensor.directions.col(i);
    const auto end = trace_ray(map, pose.translation, direction, sensor.max_range, false, RayAim::cell);
    const double t_end = std::min(end ? end->distance + edge : sensor.max_range, sensor.max_range);
    double passed = 0.0;
    for (double r = 0.5 * kStep; r < t_end; r += kStep) {
      const Vector<D> at = pose.translation + r * direction;
      const auto leaf = map.tree().find_leaf(at);
      const bool is_unknown = !leaf || leaf->cell().state() == CellState::unknown;
      double volume = kStep;
      for (int k = 0; k + 1 < D; ++k) volume *= std::min(edge, r * sensor.spacing(k, i));
      volume *= std::exp(-(passed + (is_unknown ? 0.5 * kStep : 0.0)) / sensor.mean_free_path);
      if (end && r > end->distance && (!leaf || map.tree().box(leaf->index).lower != end->cell->lower)) break;
      const auto cell = leaf && leaf->cell().observed() ? leaf->cell() : typename Map::Tree::Cell{};
      gain.bits += volume / std::pow(edge, D) * model(cell, 1.0).bits_of_next();
      if (is_unknown) {
        gain.volume += volume;
        passed += kStep;
      }
    }
  }
  return gain;
}

template <class Map>
void gain_is_that_of_small_steps(Random& random, BeamPattern<Map::kDim> sensor) {
  const Map map = random_map<Map>(random);
  double most = 0.0;
  for (const double path : {kInfinity, 2.0, 0.1}) {
    sensor.mean_free_path = path;
    std::vector<Pose<Map::kDim>> poses;
    for (int i = 0; i < 8; ++i) poses.push_back(random_pose<Map::kDim>(random, i < 6 ? 1.5 : 6.0));
    poses.erase(poses.begin() + 2, poses.begin() + 6);
    const auto gains = information_gain(map, poses, sensor);
    ASSERT_EQ(gains.size(), poses.size());
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const InformationGain expected = by_steps(map, poses[i], sensor);
      ASSERT_NEAR(gains[i].volume, expected.volume, 0.005 * expected.volume + 2e-4);
      ASSERT_NEAR(gains[i].bits, expected.bits, 0.005 * expected.bits + 2e-3);
      most = std::max(most, gains[i].volume);
    }
    const auto by_three = information_gain(map, poses, sensor, 3);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      ASSERT_EQ(by_three[i].volume, gains[i].volume);
      ASSERT_EQ(by_three[i].bits, gains[i].bits);
    }
  }
  EXPECT_GT(most, 1.0);
}
TEST(InformationGain, IsThatOfSmallSteps) {
  Random random(70);
  gain_is_that_of_small_steps<AdaptiveMap<2, 2>>(random, all_around_2(8, 4.0));
  gain_is_that_of_small_steps<PaperMap<3, 2>>(random, all_around_2(300, 3.0));
  gain_is_that_of_small_steps<AdaptiveMap<2, 3>>(random, all_around_3(9, 2.5));
  BeamPattern<3> plane = all_around_3(7, 2.5);
  plane.spacing.row(1).setConstant(kInfinity);
  gain_is_that_of_small_steps<FixedMap<2, 3>>(random, plane);
}

/// Unknown points in sight of the sensor, by rays of their own: beams are dense enough for all of them.
template <class Map>
void volume_is_what_is_in_sight(Random& random, const BeamPattern<Map::kDim>& sensor, double share) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  for (int round = 0; round < 5; ++round) {
    const Pose<D> pose = random_pose<D>(random, 1.0);
    constexpr int kEdge = D == 2 ? 800 : 90;  // A random point in each box of a lattice.
    const double box = 2.0 * sensor.max_range / kEdge;
    int in_sight = 0;
    for (int i = 0; i < static_cast<int>(std::pow(kEdge, D)); ++i) {
      Vector<D> offset;
      for (int a = 0, left = i; a < D; ++a, left /= kEdge)
        offset[a] = (left % kEdge + random.uniform(0.0, 1.0)) * box - sensor.max_range;
      const double range = offset.norm();
      if (range > sensor.max_range || range == 0.0) continue;
      if (state(map, Vector<D>(pose.translation + offset)) != CellState::unknown) continue;
      in_sight += !cast_ray(map, pose.translation, offset, range, RayAim::cell);
    }
    const double expected = std::pow(box, D) * in_sight;
    EXPECT_NEAR(information_gain(map, {pose}, sensor)[0].volume, expected, share * expected);
    EXPECT_GT(expected, 0.5);
  }
}
TEST(InformationGain, VolumeIsWhatIsInSight) {
  Random random(71);
  volume_is_what_is_in_sight<FixedMap<2, 2>>(random, all_around_2(20000, 4.0), 0.01);
  volume_is_what_is_in_sight<FixedMap<2, 3>>(random, all_around_3(100, 2.5), 0.01);
}

TEST(InformationGain, LessBitsTheMoreIsObserved) {
  double before = 1.0;
  for (const double beams : {0.0, 1.0, 10.0, 1000.0}) {  // The mean is always that of the prior.
    const double bits = HitRate(0.85, 0.14 * beams, 0.82 * beams, 0.14, 0.82).bits_of_next();
    EXPECT_LT(bits, before);
    before = bits;
    // By a plain integral over the rate's fraction.
    const double a = 0.14 * (1.0 + beams / HitRate::kBeamsOfOne);
    const double b = 0.82 * (1.0 + beams / HitRate::kBeamsOfOne);
    double mean = 0.0;
    const int steps = 200000;
    for (int i = 0; i < steps; ++i) {
      const double u = (i + 0.5) / steps;  // x = u⁸ takes the pole at 0 away.
      const double x = std::pow(u, 8.0);
      const double y = 1.0 - x;
      const double density = std::exp((a - 1.0) * std::log(x) + (b - 1.0) * std::log(y) - log_beta(a, b));
      mean += density * 8.0 * std::pow(u, 7.0) / steps * -(x * std::log2(x) + y * std::log2(y));
    }
    const double p = a / (a + b);
    EXPECT_NEAR(bits, -(p * std::log2(p) + (1.0 - p) * std::log2(1.0 - p)) - mean, 1e-4);
  }
}

TEST(InformationGain, RefusesWhatIsWrongAndStops) {
  Random random(72);
  const AdaptiveMap<2, 2> map = random_map<AdaptiveMap<2, 2>>(random);
  const std::vector<Pose<2>> poses{random_pose<2>(random, 1.0)};
  const BeamPattern<2> right = all_around_2(8, 3.0);
  EXPECT_EQ(information_gain(map, {}, right).size(), 0u);
  const auto refused = [&](const auto& change) {
    BeamPattern<2> wrong = right;
    change(wrong);
    EXPECT_THROW((void)information_gain(map, poses, wrong), std::invalid_argument);
  };
  refused([](BeamPattern<2>& s) { s.max_range = 0.0; });
  refused([](BeamPattern<2>& s) { s.max_range = kInfinity; });
  refused([](BeamPattern<2>& s) { s.mean_free_path = 0.0; });
  refused([](BeamPattern<2>& s) { s.spacing(0, 3) = 0.0; });
  refused([](BeamPattern<2>& s) { s.directions *= 2.0; });
  refused([](BeamPattern<2>& s) { s.spacing.conservativeResize(1, 7); });
  std::vector<Pose<2>> nowhere = poses;
  nowhere[0].translation[1] = kInfinity;
  EXPECT_THROW((void)information_gain(map, nowhere, right), std::invalid_argument);
  const CancelScope scope([] { return true; });
  EXPECT_THROW((void)information_gain(map, poses, right), Cancelled);
}

}  // namespace
}  // namespace ndtree::test::test_information_gain
