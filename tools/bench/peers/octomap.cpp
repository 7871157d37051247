// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// OctoMap. Modes: ray (insertRay), lazy_discrete (insertPointCloud, inner nodes and pruning after the last
/// scan).
#include <octomap/octomap.h>

#include <memory>

#include "bench.hpp"

namespace {

class Peer {
 public:
  explicit Peer(const bench::Log& log) : log_(log), is_lazy_(log.mode != "ray"), clouds_(log.scans.size()) {
    for (std::size_t s = 0; s < clouds_.size(); ++s)
      for (std::size_t i = 0; i < log.scans[s].size(); ++i)
        clouds_[s].push_back(point(log.scans[s].point(i)));
  }

  void create() { map_ = std::make_unique<octomap::OcTree>(log_.head.cell); }
  void insert(std::size_t s) {
    const octomap::point3d origin = point(log_.scans[s].origin());
    if (is_lazy_) {
      map_->insertPointCloud(clouds_[s], origin, log_.head.max_range, true, true);
    } else {
      for (const octomap::point3d& end : clouds_[s]) map_->insertRay(origin, end, log_.head.max_range);
    }
  }
  void finish() {
    if (!is_lazy_) return;
    map_->updateInnerOccupancy();
    map_->prune();
  }

 private:
  static octomap::point3d point(const Eigen::Vector3d& p) {
    return {float(p.x()), float(p.y()), float(p.z())};
  }

  const bench::Log& log_;
  bool is_lazy_;
  std::vector<octomap::Pointcloud> clouds_;
  std::unique_ptr<octomap::OcTree> map_;
};

}  // namespace

int main(int count, char** arguments) { return bench::run<Peer>("octomap", count, arguments); }
