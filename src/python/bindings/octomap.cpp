// SPDX-License-Identifier: BSD-3-Clause
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>

#include "octomap_baseline.hpp"  // Before the adapter, which finds OctoMap's queries only if they are declared.
//
#include "docstrings.hpp"
#include "python_map.hpp"
#include "query_adapter.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

struct PythonOctoMap : PythonMap {
  using PythonMap::PythonMap;
};

template <int D>
class OctomapAdapter final : public QueryAdapter<OctomapBaseline, D> {
 public:
  explicit OctomapAdapter(OctomapBaseline map) : map_(std::move(map)) {}

  [[nodiscard]] std::unique_ptr<MapInterface> clone() const override {
    return std::make_unique<OctomapAdapter>(map_);
  }
  [[nodiscard]] int branching() const override { return 2; }
  [[nodiscard]] std::string refinement() const override { return kOctomap; }
  [[nodiscard]] const MapOptions& options() const override { return map_.options(); }
  [[nodiscard]] bool clones_cheaply() const override { return false; }
  /// It keeps no hits beside its log-odds, which are what it knows.
  void moved(const double* points, std::size_t n, float* out) const override {
    const auto ask = [this](const double* some, std::size_t k, float* of) { this->probability(some, k, of); };
    probability_moved<D>(points, n, MovedMargin::of(options()), ask, ask, out);
  }
  void hit_rate(const double* points, std::size_t n, double interval,
                const HitRateArrays& out) const override {
    if (interval > 0.0)
      throw std::invalid_argument("interval: OctoMap does not keep how many beams a cell has seen");
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      const float log_odds =
          map_.log_odds(detail::in_space(Vector<D>(Eigen::Map<const Vector<D>>(points + i * D))))
              .value_or(0.0f);
      out.value[i] = state_of(log_odds) == CellState::unknown
                         ? std::numeric_limits<float>::quiet_NaN()
                         : static_cast<float>(HitRateModel::mean_of(static_cast<double>(log_odds)));
    });
  }
  InsertReport insert(const BeamPointers& beams, double max_range, int threads,
                      const std::optional<AnyBox>& window,
                      const std::vector<LayerMeasurements>& layers) override {
    (void)number_of_threads(threads);                      // OctoMap has one.
    if (window || !layers.empty()) (void)this->queries();  // Nor does it know windows and layers.
    return map_.insert(beams.view<D>(), max_range);
  }
  [[nodiscard]] PythonStats stats() const override {
    const OctomapStats octomap = map_.stats();
    PythonStats stats;
    stats.leaves = octomap.leaves;
    stats.observed_leaves = octomap.leaves_expanded;
    stats.pruned_leaves = octomap.leaves_pruned;
    stats.nodes = octomap.nodes;
    stats.updates = octomap.updates;
    stats.memory_bytes = octomap.memory_bytes;
    return stats;
  }
  [[nodiscard]] LeafArrays leaves() const override {
    const OctomapLeaves all = map_.leaves();
    LeafArrays arrays;
    const auto n = static_cast<std::size_t>(all.size.size());
    for (Eigen::Index i = 0; i < all.size.size(); ++i)
      for (int a = 0; a < D; ++a) arrays.lower.push_back(all.lower(a, i));
    arrays.size.assign(all.size.data(), all.size.data() + n);
    arrays.log_odds.assign(all.log_odds.data(), all.log_odds.data() + n);
    arrays.hits.assign(n, 0);
    arrays.misses.assign(n, 0);
    arrays.observed.assign(n, 1);
    arrays.disputed.assign(n, 0);
    arrays.thin.assign(n, 0);
    return arrays;
  }
  [[nodiscard]] std::map<double, LeafCounts> leaf_counts() const override {
    const OctomapLeaves all = map_.leaves();
    std::map<double, LeafCounts> by_size;
    for (Eigen::Index i = 0; i < all.size.size(); ++i) {
      LeafCounts& counts = by_size[all.size(i)];
      const CellState state = state_of(all.log_odds(i));
      ++counts.observed;
      counts.free += state == CellState::free;
      counts.occupied += state == CellState::occupied;
    }
    return by_size;
  }
  [[nodiscard]] std::string to_bytes() const override {
    std::ostringstream out;
    map_.save(out);
    return out.str();
  }
  [[nodiscard]] std::string file_bytes() const override {
    std::ostringstream out;
    map_.write_ot(out);
    return out.str();
  }

 private:
  [[nodiscard]] const OctomapBaseline& cells() const override { return map_; }

  OctomapBaseline map_;
};

std::unique_ptr<MapInterface> adapter(OctomapBaseline map, int dim) {
  if (dim == 2) return std::make_unique<OctomapAdapter<2>>(std::move(map));
  if (dim == 3) return std::make_unique<OctomapAdapter<3>>(std::move(map));
  throw OptionError("dim", std::to_string(dim), "2 or 3 for OctoMap");
}

OctomapInsertion insertion_from(const std::string& name) {
  if (name == "ray") return OctomapInsertion::beam_by_beam;
  if (name == "scan") return OctomapInsertion::scan_at_once;
  if (name == "scan_lazy") return OctomapInsertion::scan_at_once_lazy;
  if (name == "scan_discretized") return OctomapInsertion::scan_discretized;
  throw OptionError("insertion", "'" + name + "'", "'ray', 'scan', 'scan_lazy' or 'scan_discretized'");
}

PythonOctoMap copy(const PythonOctoMap& map) {
  return PythonOctoMap(map.read([](const MapInterface& m) { return m.clone(); }));
}

}  // namespace

void bind_octomap(py::module_& module) {
  py::class_<PythonOctoMap, PythonMap>(module, "OctoMap", doc::OctoMap)
      .def(py::init([](int dim, const std::string& insertion, const py::kwargs& keywords) {
             const MapOptions options = options_from_keywords(keywords, kOctomap, "OctoMap");
             options.validate();
             return PythonOctoMap(
                 adapter(OctomapBaseline(options.min_cell_size, options, insertion_from(insertion)), dim));
           }),
           py::kw_only(), "dim"_a = 3, "insertion"_a = "ray")
      .def("__repr__", [](const PythonOctoMap& map) { return describe("OctoMap", map, false); })
      .def("__copy__", &copy)
      .def("__deepcopy__", [](const PythonOctoMap& map, const py::dict&) { return copy(map); })
      .def(py::pickle(
          [](const PythonOctoMap& map) {
            return py::make_tuple(map.constant().dim(),
                                  py::bytes(map.read([](const MapInterface& m) { return m.to_bytes(); })));
          },
          [](const py::tuple& state) {
            std::istringstream in(state[1].cast<std::string>());
            return PythonOctoMap(adapter(OctomapBaseline::load(in), state[0].cast<int>()));
          }));
}

}  // namespace ndtree::python
