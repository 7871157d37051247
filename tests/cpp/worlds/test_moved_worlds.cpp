// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What moved in worlds whose truth is known: what stands stays, and what moves goes.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "moved_answers.hpp"
#include "ndtree/evaluation/moved.hpp"
#include "ndtree/logs/simulator.hpp"

namespace ndtree::test::test_moved_worlds {
namespace {

/// Shares of the points of what stands, and of what moves, that are said to have moved.
struct Shares {
  double standing = 0.0;
  double moving = 0.0;
  long num_moving = 0;
  std::vector<float> all;
};

template <int D>
Shares shares_of(const SimulatedLog<D>& log, const MovedOptions& options, std::size_t threads) {
  const std::vector<Scan<D>> scans = scans_of(log);
  Shares shares;
  shares.all = moved_answers(scans, options, threads);
  const float* answer = shares.all.data();
  long said[2] = {0, 0};
  long all[2] = {0, 0};
  for (std::size_t i = 0; i < log.size(); ++i) {
    const std::vector<bool> truth = log.moved(i);
    for (std::size_t k = 0; k < truth.size(); ++k, ++answer) {
      if (!scans[i].returned[static_cast<Eigen::Index>(k)]) continue;
      ++all[truth[k] ? 1 : 0];
      said[truth[k] ? 1 : 0] += *answer > 0.5F ? 1 : 0;
    }
  }
  shares.standing = static_cast<double>(said[0]) / static_cast<double>(std::max(1L, all[0]));
  shares.moving = static_cast<double>(said[1]) / static_cast<double>(std::max(1L, all[1]));
  shares.num_moving = all[1];
  return shares;
}

TEST(Moved, WhatStandsStaysAndWhatMovesGoes) {
  SimulationOptions simulation;
  simulation.seed = 803;
  MovedOptions options;
  options.range_sigma = 0.02;
  {
    simulation.scans = 120;
    EXPECT_LT(shares_of(simulate_office(simulation), options, 2).standing, 0.01) << "nothing moves";
    simulation.people = 6;
    const Shares office = shares_of(simulate_office(simulation), options, 2);
    EXPECT_LT(office.standing, 0.02);
    EXPECT_GT(office.moving, 0.8);
    EXPECT_GT(office.num_moving, 1000);
  }
  {
    simulation.scans = 30;
    simulation.people = 4;
    simulation.cars = 6;
    options.cell_size = 0.1;
    const Shares street = shares_of(simulate_street(simulation, {32, 256}), options, 2);
    EXPECT_LT(street.standing, 0.03);
    EXPECT_GT(street.moving, 0.58) << "of what is wide enough for beams 1.4 degrees apart, not too oblique";
    EXPECT_GT(street.num_moving, 1000);
  }
}

/// How many end points of the scans before `last` are said to have moved.
template <int D>
std::size_t number_moved(const std::vector<Scan<D>>& scans, const MovedOptions& options, std::size_t last) {
  MovedEvidence<D> evidence(options);
  for (const auto& scan : scans) evidence.add(scan.view());
  for (const auto& scan : scans) evidence.look(scan.view());
  std::size_t moved = 0;
  for (std::size_t i = 0; i < last; ++i) {
    std::vector<float> answers(static_cast<std::size_t>(scans[i].size()));
    evidence.probabilities(scans[i].endpoints.data(), answers.size(), answers.data());
    for (const float p : answers) moved += p > 0.5F ? 1 : 0;
  }
  return moved;
}

TEST(Moved, RodsThatBeamsPassOnBothSidesStay) {
  // Rods of 2 cm before a wall, in cells of 5 cm: most beams pass between them.
  for (const double gap : {0.12, 0.3, 1.7}) {
    std::vector<Scan<2>> scans;
    for (int i = 0; i < 120; ++i) {
      Scan<2> scan;
      const Vector<2> origin(-2.0 + 0.033 * i, 0.0);
      scan.origins = origin;
      scan.endpoints.resize(2, 320);
      for (int k = 0; k < 320; ++k) {
        const double angle = (10.0 + 0.5 * k) * 3.14159265358979 / 180.0;
        const double x = origin[0] + 2.5 / std::tan(angle);
        const double y = x - gap * std::floor(x / gap) <= 0.02 ? 2.5 : 4.0;
        scan.endpoints.col(k) = Vector<2>(origin[0] + y / std::tan(angle), y);
      }
      scans.push_back(scan);
    }
    MovedOptions options;
    options.range_sigma = 0.01;
    EXPECT_LT(number_moved(scans, options, scans.size()), 77U) << "0.2 % of the points, gap " << gap;
  }
}

/// The distance along x, y of a way of unit length to a circle, or `far`.
double to_circle(const Vector<2>& from, const Vector<2>& way, const Vector<2>& middle, double radius,
                 double far) {
  const Vector<2> to = middle - from;
  const double along = to.dot(way);
  const double left = radius * radius - to.squaredNorm() + along * along;
  return left > 0.0 && along > 0.0 ? std::min(far, along - std::sqrt(left)) : far;
}

TEST(Moved, ARailingStaysThoughItsRodsAreAsFarApartAsBeams) {
  // Rods of 4 cm every 20 cm, 2.5 m away, columns 4 degrees apart, so that neighbours meet one rod after the
  // other; and on the other side a person who stands for some scans.
  constexpr double kDegree = 3.14159265358979 / 180.0;
  constexpr int kColumns = 90;
  constexpr int kRows = 48;
  std::vector<Scan<3>> scans;
  std::vector<std::vector<int>> kinds;  // 1: on a rod, 2: on the person.
  for (int i = 0; i < 13; ++i) {
    Scan<3> scan;
    scan.origins = Vector<3>(0.17 * i, 0.0, 0.0);
    scan.endpoints.resize(3, kColumns * kRows);
    const Vector<2> from(0.17 * i, 0.0);
    std::vector<int>& kind = kinds.emplace_back(kColumns * kRows, 0);
    for (int k = 0; k < kColumns * kRows; ++k) {
      const double around = 4.0 * (k % kColumns) * kDegree;
      const double up = 0.4 * (k / kColumns - kRows / 2) * kDegree;
      const Vector<2> way(std::cos(around), std::sin(around));
      const double wall = 4.5 / std::max(std::abs(way[1]), 0.1);
      double far = wall;
      for (int rod = -40; rod < 60; ++rod) far = to_circle(from, way, Vector<2>(0.2 * rod, 2.5), 0.02, far);
      if (far < wall) kind[static_cast<std::size_t>(k)] = 1;
      const double rods = far;
      if (i < 4) far = to_circle(from, way, Vector<2>(0.5, -2.0), 0.25, far);
      if (far < rods) kind[static_cast<std::size_t>(k)] = 2;
      scan.endpoints.col(k) = scan.origins + far * Vector<3>(way[0], way[1], std::tan(up));
    }
    scans.push_back(scan);
  }
  MovedOptions options;
  options.cell_size = 0.1;
  options.range_sigma = 0.03;
  MovedEvidence<3> evidence(options);
  for (const auto& scan : scans) evidence.add(scan.view());
  for (const auto& scan : scans) evidence.look(scan.view());
  std::array<int, 3> all{};
  std::array<int, 3> moved{};
  for (std::size_t i = 0; i < scans.size(); ++i) {
    std::vector<float> answers(kinds[i].size());
    evidence.probabilities(scans[i].endpoints.data(), answers.size(), answers.data());
    for (std::size_t k = 0; k < answers.size(); ++k) {
      const auto kind = static_cast<std::size_t>(kinds[i][k]);
      ++all[kind];
      moved[kind] += answers[k] > 0.5F ? 1 : 0;
    }
  }
  EXPECT_GT(all[1], 1000);
  EXPECT_LT(moved[1], 0.1 * all[1]) << "a quarter by what each cell alone says";
  EXPECT_GT(all[2], 200);
  EXPECT_GT(moved[2], 0.8 * all[2]);
}

TEST(Moved, WhoWalkedOnTheGroundGoesThoughColumnsAreFarApart) {
  // 64 rings, columns 4 degrees apart: a person of 50 cm stands 2 m away and leaves to the side.
  std::vector<Scan<3>> scans;
  std::size_t of_person = 0;
  for (int i = 0; i < 12; ++i) {
    Scan<3> scan;
    scan.origins = Vector<3>(0.01 * i, 0.0, 0.0);
    scan.endpoints.resize(3, 64 * 90);
    const double at = i < 4 ? 0.0 : 0.25 * (i - 2);
    for (int k = 0; k < 64 * 90; ++k) {
      const double up = (-24.0 + 0.6 * (k / 90)) * 3.14159265358979 / 180.0;
      const double around = 4.0 * (k % 90) * 3.14159265358979 / 180.0;
      const Vector<3> way(std::cos(around) * std::cos(up), std::sin(around) * std::cos(up), std::sin(up));
      double range = way[2] < 0.0 ? std::min(6.0, -1.0 / way[2]) : 6.0;
      const double far = 2.0 / std::max(way[0], 1e-6);
      if (far < range && std::abs(far * way[1] - at) < 0.25) {
        range = far;
        of_person += i < 4 ? 1 : 0;
      }
      scan.endpoints.col(k) = scan.origins + range * way;
    }
    scans.push_back(scan);
  }
  MovedOptions options;
  options.cell_size = 0.1;
  options.range_sigma = 0.01;
  EXPECT_GT(of_person, 200U);
  EXPECT_GT(number_moved(scans, options, 4), of_person * 3 / 4);
}

TEST(Moved, GroundAtAGrazingAngleStays) {
  std::vector<Scan<3>> scans;
  for (int i = 0; i < 120; ++i) {
    Scan<3> scan;
    const Vector<3> origin(0.3 * i, 0.0, 1.8);
    scan.origins = origin;
    scan.endpoints.resize(3, 7 * 360);
    for (int k = 0; k < 7 * 360; ++k) {
      const double down = (3.0 + 2.0 * (k / 360)) * 3.14159265358979 / 180.0;
      const double around = (k % 360) * 3.14159265358979 / 180.0;
      const double away = 1.8 / std::tan(down);
      scan.endpoints.col(k) = origin + Vector<3>(away * std::cos(around), away * std::sin(around), -1.8);
    }
    scans.push_back(scan);
  }
  MovedOptions options;
  options.cell_size = 0.1;
  options.range_sigma = 0.02;
  EXPECT_EQ(number_moved(scans, options, scans.size()), 0U);
}

TEST(Moved, WhatStoodLongIsGoneAfterADozenScans) {
  for (const int passed : {11, 12}) {
    constexpr int kStay = 400;
    std::vector<Scan<2>> scans;
    for (int i = 0; i < kStay + passed; ++i) {
      Scan<2> scan;
      scan.origins = Vector<2>(0.0, 0.0);
      scan.endpoints.resize(2, 41);
      for (int k = 0; k < 41; ++k) {
        const double y = 0.01 * (k - 20);
        const bool is_there = i < kStay && k > 10 && k < 30;
        scan.endpoints.col(k) = (is_there ? 2.0 : 4.0) * Vector<2>(1.0, y);
      }
      scans.push_back(scan);
    }
    MovedOptions options;
    options.range_sigma = 0.01;
    const std::size_t moved = number_moved(scans, options, kStay);
    if (passed < 12)
      EXPECT_EQ(moved, 0U);
    else
      EXPECT_GT(moved, std::size_t{15} * kStay) << "of 19 beams";
  }
}

TEST(Moved, OneScanAloneSaysNothing) {
  SimulationOptions simulation;
  simulation.scans = 1;
  simulation.people = 3;
  MovedOptions options;
  options.range_sigma = 0.02;
  const Shares shares = shares_of(simulate_apartment(simulation), options, 1);
  EXPECT_GT(shares.all.size(), 1000U);
  long above = 0;
  for (const float p : shares.all) above += p > 0.5F ? 1 : 0;
  // Of errors alone: beams that returned from nowhere.
  EXPECT_LT(static_cast<double>(above), 0.005 * static_cast<double>(shares.all.size()));
}

}  // namespace
}  // namespace ndtree::test::test_moved_worlds
