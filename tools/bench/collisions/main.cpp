// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Collision questions to our map, and to FCL with OctoMap's tree of the same cells.
///
/// usage: ndtree-bench-collisions (LOG | --world NAME) [--first N] [--cell M] [--poses N] [--repeat R]
///
/// For bodies of several kinds in random poses, in turns: medians and the spread from the fastest to the
/// slowest, and of how many poses the answers differ. Both count touching as a collision, and round in their
/// own ways.
#include <fcl/geometry/octree/octree.h>
#include <fcl/narrowphase/collision.h>
#include <octomap/octomap.h>

#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <exception>
#include <functional>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "log_input.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "ndtree/ndtree.hpp"

namespace {

using namespace ndtree;
using FclShape = std::shared_ptr<fcl::CollisionGeometryd>;

/// A body for both libraries; FCL's capsules lie along z.
struct BodyOfBoth {
  std::string name;
  Body<3> ours;
  FclShape fcl;
};

std::vector<BodyOfBoth> bodies() {
  const Vector<3> along_z = 0.25 * Vector<3>::UnitZ();
  return {{"sphere of 0.3 m",
           {Capsule<3>{Vector<3>::Zero(), Vector<3>::Zero(), 0.3}},
           std::make_shared<fcl::Sphered>(0.3)},
          {"capsule of 0.5 m, radius 0.2 m",
           {Capsule<3>{Vector<3>(-along_z), along_z, 0.2}},
           std::make_shared<fcl::Capsuled>(0.2, 0.5)},
          {"box of 0.6 x 0.4 x 0.3 m",
           {OrientedBox<3>{Vector<3>::Zero(), Vector<3>(0.3, 0.2, 0.15), Eigen::Matrix3d::Identity()}},
           std::make_shared<fcl::Boxd>(0.6, 0.4, 0.3)},
          {"box of 4.0 x 1.8 x 1.5 m",
           {OrientedBox<3>{Vector<3>::Zero(), Vector<3>(2.0, 0.9, 0.75), Eigen::Matrix3d::Identity()}},
           std::make_shared<fcl::Boxd>(4.0, 1.8, 1.5)}};
}

/// Anywhere among the observed cells, turned anyhow.
std::vector<Pose<3>> random_poses(const Box<3>& box, std::size_t count) {
  std::uint64_t number = 0;
  const auto random = [&] {
    std::uint64_t x = ++number * 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return static_cast<double>((x ^ (x >> 31)) >> 11) * 0x1p-53;
  };
  std::vector<Pose<3>> poses(count);
  for (Pose<3>& pose : poses) {
    for (int a = 0; a < 3; ++a) pose.translation[a] = box.lower[a] + random() * (box.upper[a] - box.lower[a]);
    const Eigen::Vector4d q(random() - 0.5, random() - 0.5, random() - 0.5, random() - 0.5);
    pose.rotation = Eigen::Quaterniond(q.normalized()).toRotationMatrix();
  }
  return poses;
}

double seconds_of(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void print(const std::string& body, const char* candidate, std::vector<double> seconds, std::size_t poses,
           const std::string& remark) {
  std::sort(seconds.begin(), seconds.end());
  const double median = seconds[seconds.size() / 2];
  std::printf("%-32s%-16s%10.2f ms%7.0f %%%12.3g poses a second%s\n", body.c_str(), candidate, 1e3 * median,
              100.0 * (seconds.back() / seconds.front() - 1.0), static_cast<double>(poses) / median,
              remark.c_str());
}

void run(const std::vector<Scan<3>>& scans, const MapOptions& options, std::size_t count, int repeat) {
  AdaptiveMap<2, 3> map(options);
  for (const Scan<3>& scan : scans) map.insert(scan);
  std::stringstream file(octomap_bytes(map, OctomapFormat::full));
  const std::shared_ptr<octomap::OcTree> octree(
      dynamic_cast<octomap::OcTree*>(octomap::AbstractOcTree::read(file)));
  const auto obstacles = std::make_shared<fcl::OcTreed>(octree);
  const fcl::CollisionObjectd world(obstacles);
  const std::vector<Pose<3>> poses = random_poses(*bounds(map), count);
  std::printf("%zu observed leaves; OctoMap: %zu leaves of the same space\n", map.stats().observed_leaves,
              octree->getNumLeafNodes());
  for (const BodyOfBoth& body : bodies()) {
    std::vector<char> ours(count);
    std::vector<char> theirs(count);
    std::vector<double> our_seconds;
    std::vector<double> their_seconds;
    for (int i = 0; i < repeat; ++i) {
      our_seconds.push_back(seconds_of([&] {
        for (std::size_t k = 0; k < count; ++k) ours[k] = collides(map, body.ours, poses[k]);
      }));
      their_seconds.push_back(seconds_of([&] {
        const fcl::CollisionRequestd request;
        for (std::size_t k = 0; k < count; ++k) {
          const fcl::CollisionObjectd robot(body.fcl, poses[k].rotation, poses[k].translation);
          fcl::CollisionResultd result;
          theirs[k] = fcl::collide(&robot, &world, request, result) > 0;
        }
      }));
    }
    std::size_t differ = 0;
    std::size_t collide = 0;
    for (std::size_t k = 0; k < count; ++k) {
      differ += ours[k] != theirs[k];
      collide += static_cast<std::size_t>(ours[k]);
    }
    print(body.name, "ndtree", our_seconds, count, "");
    print(body.name, "FCL, OctoMap", their_seconds, count,
          "; " + std::to_string(collide) + " collide, " + std::to_string(differ) + " answers differ");
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Asks a map of ndtree's, and FCL with OctoMap's tree of the same cells, for collisions.");
  std::string log_name;
  std::string world = "apartment";
  std::size_t first = 30;
  std::size_t poses = 20000;
  int repeat = 5;
  MapOptions options;
  app.add_option("LOG", log_name, "A recording in 3-D");
  app.add_option("--world", world, "Instead of one: apartment or street");
  app.add_option("--first", first, "Scans of the log, from the first");
  app.add_option("--cell", options.min_cell_size, "Edge of the smallest cells [m]");
  app.add_option("--sigma", options.range_sigma, "Noise of a range [m]");
  app.add_option("--poses", poses, "Of each body")->check(CLI::PositiveNumber);
  app.add_option("--repeat", repeat, "Of each question")->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  options.max_cell_size = 32.0 * options.min_cell_size;
  try {
    const Log log = log_name.empty() ? simulate_log(world, 3, first) : read_log(log_name, 3, first);
    run(std::get<std::vector<Scan<3>>>(log.scans), options, poses, repeat);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "ndtree-bench-collisions: %s\n", error.what());
    return 1;
  }
  return 0;
}
