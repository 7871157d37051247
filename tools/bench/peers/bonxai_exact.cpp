// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Bonxai's grid below an exact traversal of ours (Amanatides and Woo, 1987): a beam visits every cell that
/// it crosses, and a scan updates a cell once, a hit before a miss. Mode: scan.
#include <bonxai/bonxai.hpp>
#include <cmath>
#include <limits>
#include <memory>

#include "bench.hpp"

namespace {

enum class Seen : std::int8_t { no, passed, hit };

struct Cell {
  float log_odds = 0.0F;
  Seen seen = Seen::no;
};

class Map {
 public:
  explicit Map(double cell) : cell_(cell), grid_(cell) {}

  void insert(const std::vector<Eigen::Vector3d>& points, const Eigen::Vector3d& origin, double max_range) {
    auto accessor = grid_.createAccessor();
    const auto see = [&](const Bonxai::CoordT& at, Seen how) {
      Cell* const cell = accessor.value(at, true);
      if (cell->seen == Seen::no) seen_.push_back(cell);
      if (cell->seen != Seen::hit) cell->seen = how;
    };
    ends_.clear();
    for (const Eigen::Vector3d& point : points) {
      const Eigen::Vector3d way = point - origin;
      const bool is_cut = way.norm() >= max_range;
      const Eigen::Vector3d end = is_cut ? Eigen::Vector3d(origin + max_range / way.norm() * way) : point;
      const auto at = grid_.posToCoord(end);
      const Cell* const cell = accessor.value(at, true);
      if (cell->seen == Seen::no) ends_.push_back(at);  // One beam for each cell in which beams end.
      see(at, is_cut ? Seen::passed : Seen::hit);
    }
    for (const auto& end : ends_) walk(origin, end, see);
    for (Cell* const cell : seen_) {
      const float change = cell->seen == Seen::hit ? 0.85F : -0.41F;  // Probabilities of 0.7 and 0.4.
      cell->log_odds = std::min(3.5F, std::max(-2.0F, cell->log_odds + change));
      cell->seen = Seen::no;
    }
    seen_.clear();
  }

 private:
  /// Calls see() for the cells from the origin's to the one before the end's, towards the middle of that one.
  template <class See>
  void walk(const Eigen::Vector3d& origin, const Bonxai::CoordT& end, const See& see) const {
    const Eigen::Vector3d way = cell_ * Eigen::Vector3d(end.x + 0.5, end.y + 0.5, end.z + 0.5) - origin;
    auto at = grid_.posToCoord(origin);
    Eigen::Vector3d next;   // Fraction of the way at which the beam enters the next cell along an axis.
    Eigen::Vector3d width;  // Fraction of the way across a cell along an axis.
    for (int axis = 0; axis < 3; ++axis) {
      const double border = cell_ * (at[axis] + (way[axis] > 0.0 ? 1 : 0)) - origin[axis];
      next[axis] = way[axis] == 0.0 ? std::numeric_limits<double>::infinity() : border / way[axis];
      width[axis] = way[axis] == 0.0 ? 0.0 : cell_ / std::abs(way[axis]);
    }
    while (!(at == end)) {
      see(at, Seen::passed);
      int axis = 0;
      if (next.minCoeff(&axis) > 1.0) return;
      at[axis] += way[axis] > 0.0 ? 1 : -1;
      next[axis] += width[axis];
    }
  }

  double cell_;
  Bonxai::VoxelGrid<Cell> grid_;
  std::vector<Bonxai::CoordT> ends_;
  std::vector<Cell*> seen_;
};

class Peer {
 public:
  explicit Peer(const bench::Log& log) : log_(log), clouds_(log.scans.size()) {
    for (std::size_t s = 0; s < clouds_.size(); ++s)
      for (std::size_t i = 0; i < log.scans[s].size(); ++i) clouds_[s].push_back(log.scans[s].point(i));
  }

  void create() { map_ = std::make_unique<Map>(log_.head.cell); }
  void insert(std::size_t s) { map_->insert(clouds_[s], log_.scans[s].origin(), log_.head.max_range); }
  void finish() {}

 private:
  const bench::Log& log_;
  std::vector<std::vector<Eigen::Vector3d>> clouds_;
  std::unique_ptr<Map> map_;
};

}  // namespace

int main(int count, char** arguments) { return bench::run<Peer>("bonxai_exact", count, arguments); }
