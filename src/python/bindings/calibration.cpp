// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/evaluation/calibration.hpp"

#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "docstrings.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// An entry for each bin of each group that is not empty.
template <class T, class Value>
py::array_t<T> column(const Calibration& calibration, const Value& value) {
  std::vector<T> entries;
  for (const auto& [group, bins] : calibration.groups)
    for (const Calibration::Bin& bin : bins)
      if (bin.pairs > 0) entries.push_back(static_cast<T>(value(group, bin)));
  return py::array_t<T>(static_cast<py::ssize_t>(entries.size()), entries.data());
}

Calibration calibrated(const PythonMap& map, const py::object& points, const py::object& origin,
                       const py::object& returned, double max_range, std::optional<Calibration> counts) {
  const BeamArrays beams(points, origin, returned, map.constant().dim());
  Calibration result = counts ? std::move(*counts) : Calibration{};
  map.read(
      [&, pointers = beams.pointers()](const MapInterface& m) { m.calibrate(pointers, max_range, result); });
  return result;
}

}  // namespace

void bind_calibration(py::module_& module) {
  using Group = Calibration::Group;
  using Bin = Calibration::Bin;
  py::class_<Calibration>(module, "Reliability", doc::Reliability)
      .def(py::init<>())
      .def_readonly("beams", &Calibration::beams, doc::Reliability_beams)
      .def_readonly("ends_at_unknown", &Calibration::ends_at_unknown, doc::Reliability_ends_at_unknown)
      .def_property_readonly(
          "state",
          [](const Calibration& c) {
            return column<std::int8_t>(c, [](const Group& g, const Bin&) { return std::get<0>(g); });
          },
          doc::Reliability_state)
      .def_property_readonly(
          "size",
          [](const Calibration& c) {
            return column<double>(c, [](const Group& g, const Bin&) { return std::get<1>(g); });
          },
          doc::Reliability_size)
      .def_property_readonly(
          "power",
          [](const Calibration& c) {
            return column<std::int64_t>(c, [](const Group& g, const Bin&) { return std::get<2>(g); });
          },
          doc::Reliability_power)
      .def_property_readonly(
          "pairs",
          [](const Calibration& c) {
            return column<std::uint64_t>(c, [](const Group&, const Bin& b) { return b.pairs; });
          },
          doc::Reliability_pairs)
      .def_property_readonly(
          "probability",
          [](const Calibration& c) {
            return column<double>(
                c, [](const Group&, const Bin& b) { return b.hit_rates / static_cast<double>(b.pairs); });
          },
          doc::Reliability_probability)
      .def_property_readonly(
          "ends",
          [](const Calibration& c) {
            return column<std::uint64_t>(c, [](const Group&, const Bin& b) { return b.ends; });
          },
          doc::Reliability_ends)
      .def("__iadd__",
           [](Calibration& a, const Calibration& b) -> Calibration& {
             a.add(b);
             return a;
           })
      .def(py::pickle(
          [](const Calibration& c) {
            py::list groups;
            for (const auto& [group, bins] : c.groups)
              for (std::size_t i = 0; i < bins.size(); ++i)
                if (bins[i].pairs > 0)
                  groups.append(py::make_tuple(static_cast<int>(std::get<0>(group)), std::get<1>(group),
                                               std::get<2>(group), i, bins[i].pairs, bins[i].hit_rates,
                                               bins[i].ends));
            return py::make_tuple(c.beams, c.ends_at_unknown, groups);
          },
          [](const py::tuple& state) {
            Calibration c;
            c.beams = state[0].cast<std::uint64_t>();
            c.ends_at_unknown = state[1].cast<std::uint64_t>();
            for (const py::handle one : state[2]) {
              const auto part = py::reinterpret_borrow<py::tuple>(one);
              const Group group{static_cast<CellState>(part[0].cast<int>()), part[1].cast<double>(),
                                part[2].cast<int>()};
              c.groups[group].at(part[3].cast<std::size_t>()) = {
                  part[4].cast<std::uint64_t>(), part[5].cast<double>(), part[6].cast<std::uint64_t>()};
            }
            return c;
          }));

  auto map_class = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  map_class.def("reliability", &calibrated, "points"_a, "origin"_a, py::kw_only(), "returned"_a = py::none(),
                "max_range"_a = std::numeric_limits<double>::infinity(), "counts"_a = py::none(),
                doc::OccupancyMap_reliability);
}

}  // namespace ndtree::python
