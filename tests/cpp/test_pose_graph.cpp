// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A pose graph's solution is where no pose can be moved to fit better, and wrong relations do not count.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <vector>

#include "ndtree/alignment/pose_graph.hpp"
#include "random.hpp"

namespace ndtree::test::test_pose_graph {
namespace {

XyYaw random_pose(Random& random, double reach, double angle) {
  return {random.uniform(-reach, reach), random.uniform(-reach, reach), random.uniform(-angle, angle)};
}

/// The pose that is seen as `relative` from `from`.
XyYaw placed(const XyYaw& from, const XyYaw& relative) {
  const double c = std::cos(from[2]);
  const double s = std::sin(from[2]);
  return {from[0] + c * relative[0] - s * relative[1], from[1] + s * relative[0] + c * relative[1],
          wrapped(from[2] + relative[2])};
}

Eigen::Matrix3d random_information(Random& random) {
  Eigen::Matrix3d half;
  for (Eigen::Index i = 0; i < half.size(); ++i) half(i) = random.uniform(-10.0, 10.0);
  return half * half.transpose() + 10.0 * Eigen::Matrix3d::Identity();
}

struct Graph {
  std::vector<XyYaw> truth;
  std::vector<XyYaw> start;
  std::vector<PoseRelation> relations;
};

/// A chain with relations between poses of random numbers. @param noise of the relations.
Graph random_graph(Random& random, double noise) {
  Graph graph;
  const int count = random.integer(2, 40);
  graph.truth.push_back(random_pose(random, 5.0, 3.0));
  for (int i = 1; i < count; ++i)
    graph.truth.push_back(placed(graph.truth.back(), random_pose(random, 1.0, 1.0)));
  const auto relate = [&](std::size_t from, std::size_t to) {
    PoseRelation relation;
    relation.from = from;
    relation.to = to;
    relation.measured = between(graph.truth[from], graph.truth[to]) + random_pose(random, noise, noise);
    relation.information = random_information(random);
    graph.relations.push_back(relation);
  };
  for (std::size_t i = 1; i < graph.truth.size(); ++i) relate(i - 1, i);
  for (int i = 0; i < count / 2; ++i)
    relate(static_cast<std::size_t>(random.integer(0, count - 1)),
           static_cast<std::size_t>(random.integer(0, count - 1)));
  graph.start.push_back(graph.truth.front());
  for (std::size_t i = 1; i < graph.truth.size(); ++i)
    graph.start.push_back(placed(
        graph.start.back(), between(graph.truth[i - 1], graph.truth[i]) + random_pose(random, 0.03, 0.03)));
  return graph;
}

double cost(const std::vector<XyYaw>& poses, const std::vector<PoseRelation>& relations) {
  double sum = 0.0;
  for (const PoseRelation& r : relations) {
    XyYaw error = between(poses[r.from], poses[r.to]) - r.measured;
    error[2] = wrapped(error[2]);
    const double square = error.dot(r.information * error);
    sum += r.kernel > 0.0 ? r.kernel * r.kernel * std::log(1.0 + square / (r.kernel * r.kernel)) : square;
  }
  return sum;
}

TEST(PoseGraph, ExactRelationsGiveTheTruth) {
  Random random(1);
  for (int i = 0; i < 200; ++i) {
    Graph graph = random_graph(random, 0.0);
    const PoseGraphReport report = solve(graph.start, graph.relations);
    EXPECT_NEAR(report.after, 0.0, 1e-9);
    for (std::size_t k = 0; k < graph.truth.size(); ++k) {
      EXPECT_NEAR(between(graph.truth[k], graph.start[k]).norm(), 0.0, 1e-5)
          << "graph " << i << ", pose " << k;
    }
  }
}

TEST(PoseGraph, NoPoseFitsBetterElsewhere) {
  Random random(2);
  for (int i = 0; i < 100; ++i) {
    Graph graph = random_graph(random, 0.05);
    for (PoseRelation& r : graph.relations) r.kernel = random.chance(0.3) ? 3.0 : 0.0;
    std::vector<XyYaw> poses = graph.start;
    const PoseGraphReport report = solve(poses, graph.relations, 200);
    EXPECT_NEAR(report.before, cost(graph.start, graph.relations), 1e-6 * (1.0 + report.before));
    EXPECT_NEAR(report.after, cost(poses, graph.relations), 1e-6 * (1.0 + report.after));
    EXPECT_LE(report.after, report.before);
    EXPECT_EQ(poses.front(), graph.start.front());
    for (std::size_t k = 1; k < poses.size(); ++k)
      for (int a = 0; a < 3; ++a)
        for (const double step : {-1e-3, 1e-3}) {
          std::vector<XyYaw> other = poses;
          other[k][a] += step;
          EXPECT_GE(cost(other, graph.relations), report.after - 1e-6) << "graph " << i;
        }
  }
}

TEST(PoseGraph, WrongRelationsWithAKernelDoNotCount) {
  Random random(3);
  for (int i = 0; i < 50; ++i) {
    Graph graph = random_graph(random, 0.0);
    if (graph.truth.size() < 5) continue;
    PoseRelation wrong;
    wrong.to = graph.truth.size() - 1;
    wrong.measured = between(graph.truth.front(), graph.truth.back()) + XyYaw(2.0, -1.0, 0.5);
    wrong.information = 100.0 * Eigen::Matrix3d::Identity();
    wrong.kernel = 1.0;
    for (PoseRelation& relation : graph.relations) relation.information *= 100.0;
    graph.relations.push_back(wrong);
    solve(graph.start, graph.relations, 200);
    for (std::size_t k = 0; k < graph.truth.size(); ++k)
      EXPECT_LT(between(graph.truth[k], graph.start[k]).norm(), 0.1) << "graph " << i;
  }
}

TEST(PoseGraph, RefusesWhatIsWrong) {
  std::vector<XyYaw> poses(2, XyYaw::Zero());
  PoseRelation relation;
  relation.to = 2;
  relation.measured.setZero();
  relation.information.setIdentity();
  EXPECT_THROW(solve(poses, {relation}), std::invalid_argument);
  relation.to = 1;
  relation.measured[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(solve(poses, {relation}), std::invalid_argument);
  relation.measured[0] = 1.0;
  poses[0][1] = std::numeric_limits<double>::infinity();
  EXPECT_THROW(solve(poses, {relation}), std::invalid_argument);
}

}  // namespace
}  // namespace ndtree::test::test_pose_graph
