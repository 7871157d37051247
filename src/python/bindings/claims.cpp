// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/evaluation/claims.hpp"

#include <algorithm>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "docstrings.hpp"
#include "numpy.hpp"
#include "python_map.hpp"
#include "seen_space.hpp"
#include "simulated_log.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

AnySeenSpace make_seen_space(const py::iterable& scans, double max_range, const py::object& simulation,
                             std::size_t samples, double spacings, double tolerance, double margin,
                             double middle, std::uint64_t seed) {
  ClaimsOptions options;
  options.samples = samples;
  options.spacings = spacings;
  options.tolerance = tolerance;
  options.margin = margin;
  options.middle = middle;
  options.seed = seed;
  options.validate();
  const ScanArrays arrays(scans);
  if (arrays.beams.empty()) throw py::value_error("scans: none, expected at least one");
  const std::vector<BeamPointers> pointers = arrays.pointers();
  if (arrays.dim == 2) {
    const SimulatedLog<2>* const log = simulated_log<2>(simulation);
    const Released released;
    return seen_space(pointers, log, max_range, options);
  }
  if (arrays.dim == 3) {
    const SimulatedLog<3>* const log = simulated_log<3>(simulation);
    const Released released;
    return seen_space(pointers, log, max_range, options);
  }
  if (!simulation.is_none()) throw py::value_error("simulation: must be None for scans with dim = 4");
  const Released released;
  return seen_space(pointers, max_range, options);
}

py::array_t<double> points_of(const AnySeenSpace& any) {
  return std::visit(
      [](const auto& space) {
        const auto& points = space.points();
        return py::array_t<double>({py::ssize_t{points.cols()}, py::ssize_t{points.rows()}}, points.data());
      },
      any.space);
}

py::array_t<bool> seen_of(const AnySeenSpace& any) {
  return std::visit(
      [](const auto& space) {
        return py::array_t<bool>(py::ssize_t{space.seen().size()}, space.seen().data());
      },
      any.space);
}

py::object box_of(const AnySeenSpace& any) {
  return std::visit(
      [](const auto& space) -> py::object {
        if (!space.box()) return py::none();
        const py::ssize_t dim = space.box()->lower.size();
        py::array_t<double> corners({py::ssize_t{2}, dim});
        std::copy_n(space.box()->lower.data(), dim, corners.mutable_data(0));
        std::copy_n(space.box()->upper.data(), dim, corners.mutable_data(1));
        return corners;
      },
      any.space);
}

double or_nan(std::optional<double> share) {
  return share.value_or(std::numeric_limits<double>::quiet_NaN());
}

}  // namespace

void bind_claims(py::module_& module) {
  const ClaimsOptions defaults;
  py::class_<AnySeenSpace>(module, "SeenSpace", doc::SeenSpace)
      .def(py::init(&make_seen_space), "scans"_a, py::kw_only(),
           "max_range"_a = std::numeric_limits<double>::infinity(), "simulation"_a = py::none(),
           "samples"_a = defaults.samples, "spacings"_a = defaults.spacings,
           "tolerance"_a = defaults.tolerance, "margin"_a = defaults.margin, "middle"_a = defaults.middle,
           "seed"_a = defaults.seed)
      .def_property_readonly(
          "dim", [](const AnySeenSpace& any) { return any.dim(); }, doc::SeenSpace_dim)
      .def_property_readonly("points", &points_of, doc::SeenSpace_points)
      .def_property_readonly("seen", &seen_of, doc::SeenSpace_seen)
      .def_property_readonly("box", &box_of, doc::SeenSpace_box);

  py::class_<Claims>(module, "Claims")
      .def_readonly("points", &Claims::points)
      .def_readonly("seen", &Claims::seen)
      .def_readonly("free", &Claims::free)
      .def_readonly("free_and_unseen", &Claims::free_and_unseen)
      .def_readonly("unknown_and_seen", &Claims::unknown_and_seen)
      .def_property_readonly("free_unseen", [](const Claims& c) { return or_nan(c.free_unseen()); })
      .def_property_readonly("seen_unknown", [](const Claims& c) { return or_nan(c.seen_unknown()); })
      .def_property_readonly("wrong_volume", [](const Claims& c) { return or_nan(c.wrong_volume()); });

  auto map_class = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  map_class.def(
      "claims",
      [](const PythonMap& map, const AnySeenSpace& space) {
        return map.read([&](const MapInterface& m) { return m.claims(space); });
      },
      "space"_a, doc::OccupancyMap_claims);
}

}  // namespace ndtree::python
