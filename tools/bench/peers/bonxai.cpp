// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Bonxai's probabilistic map. Mode: scan (insertPointCloud).
#include <bonxai_map/probabilistic_map.hpp>
#include <memory>

#include "bench.hpp"

namespace {

class Peer {
 public:
  explicit Peer(const bench::Log& log) : log_(log), clouds_(log.scans.size()) {
    for (std::size_t s = 0; s < clouds_.size(); ++s)
      for (std::size_t i = 0; i < log.scans[s].size(); ++i) clouds_[s].push_back(log.scans[s].point(i));
  }

  void create() { map_ = std::make_unique<Bonxai::ProbabilisticMap>(log_.head.cell); }
  void insert(std::size_t s) {
    map_->insertPointCloud(clouds_[s], log_.scans[s].origin(), log_.head.max_range);
  }
  void finish() {}

 private:
  const bench::Log& log_;
  std::vector<std::vector<Eigen::Vector3d>> clouds_;
  std::unique_ptr<Bonxai::ProbabilisticMap> map_;
};

}  // namespace

int main(int count, char** arguments) { return bench::run<Peer>("bonxai", count, arguments); }
