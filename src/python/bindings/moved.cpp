// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/evaluation/moved.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "docstrings.hpp"
#include "ndtree/cell/moved_points.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "python_map.hpp"
#include "shared_lock.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// Evidence in 2 or 3 dimensions that threads share: one adds or looks, or any number ask. A call that waits
/// hears signals, one of a signal's handler is refused, and a fork waits, as with PythonMap.
struct AnyMovedEvidence {
  std::variant<MovedEvidence<2>, MovedEvidence<3>> evidence;
  mutable SharedLock lock;

  AnyMovedEvidence(int dim, const MovedOptions& options) : evidence(make(dim, options)) {}

  static std::variant<MovedEvidence<2>, MovedEvidence<3>> make(int dim, const MovedOptions& options) {
    if (dim == 2) return MovedEvidence<2>(options);
    if (dim == 3) return MovedEvidence<3>(options);
    throw py::value_error("dim = " + std::to_string(dim) + ": must be 2 or 3");
  }
  [[nodiscard]] int dim() const { return static_cast<int>(evidence.index()) + 2; }
  [[nodiscard]] const MovedOptions& options() const {
    return std::visit([](const auto& one) -> const MovedOptions& { return one.options(); }, evidence);
  }
  /// Calls `use(evidence, scan)` without the interpreter's lock.
  template <class Use>
  void with(const BeamArrays& beams, Use&& use) {
    const BeamPointers pointers = beams.pointers();
    const Released released;
    const CallInProgress call;
    const SharedLock::Holder holder(lock, SharedLock::Use::change);
    if (auto* const flat = std::get_if<0>(&evidence))
      use(*flat, pointers.view<2>());
    else
      use(std::get<1>(evidence), pointers.view<3>());
  }
};

void add(AnyMovedEvidence& any, const py::object& points, const py::object& origin,
         const py::object& returned, double max_range, const py::object& range_sigma) {
  const BeamArrays beams(points, origin, returned, any.dim(), range_sigma);
  any.with(beams, [&](auto& evidence, const auto& scan) { evidence.add(scan, max_range); });
}

void look(AnyMovedEvidence& any, const py::object& points, const py::object& origin,
          const py::object& returned, double max_range, const py::object& range_sigma, int threads) {
  const auto workers = static_cast<std::size_t>(number_of_threads(threads));
  const BeamArrays beams(points, origin, returned, any.dim(), range_sigma);
  any.with(beams, [&](auto& evidence, const auto& scan) { evidence.look(scan, max_range, workers); });
}

py::array_t<float> probability(const AnyMovedEvidence& any, const py::object& object) {
  const DoubleArray points = as_points(object, "points", any.dim());
  py::array_t<float> out(points.shape(0));
  const auto n = static_cast<std::size_t>(points.shape(0));
  const double* const data = points.data();
  float* const results = out.mutable_data();
  const Released released;
  const CallInProgress call;
  const SharedLock::Holder holder(any.lock, SharedLock::Use::look);
  std::visit([&](const auto& evidence) { evidence.probabilities(data, n, results); }, any.evidence);
  return out;
}

constexpr std::size_t kCounts = 4;

template <int D>
void write_counts(const MovedEvidence<D>& evidence, const double* points, std::size_t n, std::uint32_t* out) {
  for (std::size_t i = 0; i < n; ++i) {
    const MovedTally tally = evidence.tally(Eigen::Map<const Vector<D>>(points + i * D));
    const std::array<std::uint32_t, kCounts> row{tally.through, tally.found, tally.stays, tally.unsure};
    std::copy(row.begin(), row.end(), out + i * kCounts);
  }
}

py::array_t<std::uint32_t> counts(const AnyMovedEvidence& any, const py::object& object) {
  const DoubleArray points = as_points(object, "points", any.dim());
  py::array_t<std::uint32_t> out({points.shape(0), static_cast<py::ssize_t>(kCounts)});
  const auto n = static_cast<std::size_t>(points.shape(0));
  const double* const data = points.data();
  std::uint32_t* const results = out.mutable_data();
  const Released released;
  const CallInProgress call;
  const SharedLock::Holder holder(any.lock, SharedLock::Use::look);
  std::visit([&](const auto& evidence) { write_counts(evidence, data, n, results); }, any.evidence);
  return out;
}

py::array_t<double> cells(const AnyMovedEvidence& any) {
  std::vector<double> means;
  {
    const Released released;
    const CallInProgress call;
    const SharedLock::Holder holder(any.lock, SharedLock::Use::look);
    std::visit([&](const auto& evidence) { means = evidence.means(); }, any.evidence);
  }
  const auto dim = static_cast<py::ssize_t>(any.dim());
  py::array_t<double> out({static_cast<py::ssize_t>(means.size()) / dim, dim});
  std::copy(means.begin(), means.end(), out.mutable_data());
  return out;
}

}  // namespace

std::vector<float> moved_before(const MapInterface& map, const BeamPointers& beams, double max_range) {
  const auto moved = [&](auto dim) {
    return probability_moved(
        beams.view<dim>(), max_range,
        [&map](const double* points, std::size_t n, float* out) { map.moved(points, n, out); });
  };
  if (map.dim() == 2) return moved(std::integral_constant<int, 2>());
  if (map.dim() == 3) return moved(std::integral_constant<int, 3>());
  return moved(std::integral_constant<int, 4>());
}

void bind_moved(py::module_& module) {
  const MovedOptions defaults;
  py::class_<AnyMovedEvidence>(module, "MovedEvidence", doc::MovedEvidence)
      .def(py::init([](int dim, double cell_size, double range_sigma, double range_sigma_quadratic,
                       double place_sigma, double turn_sigma, double noise_sigmas, double error_rate) {
             MovedOptions options;
             options.cell_size = cell_size;
             options.range_sigma = range_sigma;
             options.range_sigma_quadratic = range_sigma_quadratic;
             options.place_sigma = place_sigma;
             options.turn_sigma = turn_sigma;
             options.noise_sigmas = noise_sigmas;
             options.error_rate = error_rate;
             return std::make_unique<AnyMovedEvidence>(dim, options);
           }),
           py::kw_only(), "dim"_a, "cell_size"_a = defaults.cell_size, "range_sigma"_a = defaults.range_sigma,
           "range_sigma_quadratic"_a = defaults.range_sigma_quadratic, "place_sigma"_a = defaults.place_sigma,
           "turn_sigma"_a = defaults.turn_sigma, "noise_sigmas"_a = defaults.noise_sigmas,
           "error_rate"_a = defaults.error_rate)
      .def_property_readonly(
          "dim", [](const AnyMovedEvidence& any) { return any.dim(); }, doc::MovedEvidence_dim)
      .def_property_readonly(
          "cell_size", [](const AnyMovedEvidence& any) { return any.options().cell_size; },
          doc::MovedEvidence_cell_size)
      .def("add", &add, "points"_a, "origin"_a, py::kw_only(), "returned"_a = py::none(),
           "max_range"_a = std::numeric_limits<double>::infinity(), "range_sigma"_a = py::none(),
           doc::MovedEvidence_add)
      .def("look", &look, "points"_a, "origin"_a, py::kw_only(), "returned"_a = py::none(),
           "max_range"_a = std::numeric_limits<double>::infinity(), "range_sigma"_a = py::none(),
           "threads"_a = 0, doc::MovedEvidence_look)
      .def("cells", &cells, doc::MovedEvidence_cells)
      .def("counts", &counts, "points"_a, doc::MovedEvidence_counts)
      .def("probability", &probability, "points"_a, doc::MovedEvidence_probability);

  auto map_class = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  map_class.def(
      "moved",
      [](const PythonMap& map, const py::object& object) {
        const DoubleArray points = as_points(object, "points", map.constant().dim());
        py::array_t<float> out(points.shape(0));
        float* const results = out.mutable_data();
        const double* const data = points.data();
        const auto n = static_cast<std::size_t>(points.shape(0));
        map.read([&](const MapInterface& m) { m.moved(data, n, results); });
        return out;
      },
      "points"_a, doc::OccupancyMap_moved);
}

}  // namespace ndtree::python
