// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// ndtree. Modes: adaptive (the default options), all (adaptive, and every beam counts), fixed.
#include <memory>
#include <ndtree/ndtree.hpp>

#include "bench.hpp"

namespace {

template <class Map>
class Peer {
  static constexpr int D = Map::kDim;

 public:
  explicit Peer(const bench::Log& log) : log_(log), scans_(log.scans.size()) {
    for (std::size_t s = 0; s < scans_.size(); ++s) {
      const bench::Scan& from = log.scans[s];
      scans_[s].origins = from.origin().head<D>();
      scans_[s].endpoints.resize(D, Eigen::Index(from.size()));
      for (std::size_t i = 0; i < from.size(); ++i)
        scans_[s].endpoints.col(Eigen::Index(i)) = from.point(i).template head<D>();
    }
  }

  void create() {
    ndtree::MapOptions options;
    options.min_cell_size = log_.head.cell;
    options.max_cell_size = 32 * log_.head.cell;
    options.range_sigma = log_.head.sigma;
    options.range_sigma_quadratic = log_.head.sigma_quadratic;
    if (log_.mode == "all") options.sample_beams = 1e9;
    map_ = std::make_unique<Map>(options);
  }
  void insert(std::size_t s) { map_->insert(scans_[s], log_.head.max_range, 1); }
  void finish() {}

 private:
  const bench::Log& log_;
  std::vector<ndtree::Scan<D>> scans_;
  std::unique_ptr<Map> map_;
};

}  // namespace

int main(int count, char** arguments) {
  using ndtree::AdaptiveMap, ndtree::FixedMap, bench::run;
  if (count < 3) return 2;
  const bool is_flat = bench::read(arguments[1]).head.dim == 2;
  if (std::string(arguments[2]) == "fixed")
    return is_flat ? run<Peer<FixedMap<2, 2>>>("ndtree", count, arguments)
                   : run<Peer<FixedMap<2, 3>>>("ndtree", count, arguments);
  return is_flat ? run<Peer<AdaptiveMap<2, 2>>>("ndtree", count, arguments)
                 : run<Peer<AdaptiveMap<2, 3>>>("ndtree", count, arguments);
}
