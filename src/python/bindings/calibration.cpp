// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/evaluation/calibration.hpp"

#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

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
  py::class_<Calibration>(module, "Reliability",
                          "How often beams end where a map says that they would; counts that add up.\n\n"
                          "Of pairs of a held-out beam and an observed cell that it reaches, up to that of "
                          "its end point. Columns\n"
                          "have an entry for each group of pairs that are alike in state, size, number of "
                          "beams and twentieth of\n"
                          "the probability.")
      .def(py::init<>())
      .def_readonly("beams", &Calibration::beams, "Beams asked about.")
      .def_readonly("ends_at_unknown", &Calibration::ends_at_unknown,
                    "Of these, that ended where nothing was observed.")
      .def_property_readonly(
          "state",
          [](const Calibration& c) {
            return column<std::int8_t>(c, [](const Group& g, const Bin&) { return std::get<0>(g); });
          },
          "(k,) int8 of the cells: -1 unknown, 0 free, 1 occupied.")
      .def_property_readonly(
          "size",
          [](const Calibration& c) {
            return column<double>(c, [](const Group& g, const Bin&) { return std::get<1>(g); });
          },
          "(k,) float64: their edge [m].")
      .def_property_readonly(
          "power",
          [](const Calibration& c) {
            return column<std::int64_t>(c, [](const Group& g, const Bin&) { return std::get<2>(g); });
          },
          "(k,) int64: 2**power - 1 beams or more, and less than 2**(power + 1) - 1, are what their evidence "
          "is\n"
          "worth; -1 where a map does not keep that.")
      .def_property_readonly(
          "pairs",
          [](const Calibration& c) {
            return column<std::uint64_t>(c, [](const Group&, const Bin& b) { return b.pairs; });
          },
          "(k,) uint64: pairs of a beam and a cell.")
      .def_property_readonly(
          "probability",
          [](const Calibration& c) {
            return column<double>(
                c, [](const Group&, const Bin& b) { return b.hit_rates / static_cast<double>(b.pairs); });
          },
          "(k,) float64: mean probability that the beam ends in the cell, `probability(of=\"hit\")`.")
      .def_property_readonly(
          "ends",
          [](const Calibration& c) {
            return column<std::uint64_t>(c, [](const Group&, const Bin& b) { return b.ends; });
          },
          "(k,) uint64: pairs of which the beam ended in the cell.")
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
                R"(Count how often beams that the map was not built from end where it says that they would.

Parameters
----------
points, origin, returned, max_range
    As for insert(). Only returned beams within max_range count.
counts : Reliability, optional
    Of earlier scans, to add to; it is not changed itself.

Returns
-------
Reliability
)");
}

}  // namespace ndtree::python
