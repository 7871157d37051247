// SPDX-License-Identifier: BSD-3-Clause
// Maps beside each other: snapshots, what has changed, and maps that are put together.
#include <memory>
#include <optional>
#include <utility>

#include "arguments.hpp"
#include "docstrings.hpp"
#include "python_field.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

struct Changes {
  py::array lower, size, before, after;
};

ChangeOf change_of(const std::string& name) {
  if (name == "states") return ChangeOf::states;
  if (name == "columns") return ChangeOf::columns;
  if (name == "cells") return ChangeOf::cells;
  throw py::value_error("of = '" + name + "': must be 'states', 'columns' or 'cells'");
}

/// A map that goes on by itself, at once.
std::unique_ptr<MapInterface> clone_of(const PythonMap& map) {
  return map.read([](const MapInterface& m) { return m.clone(); });
}

Changes changes(const PythonMap& map, const PythonMap& since, const std::string& of, const py::object& box) {
  const ChangeOf what = change_of(of);
  std::optional<BoxArgument> part;
  if (!box.is_none()) part.emplace(box, map.constant().dim());
  const auto region = part ? std::optional<AnyBox>(*part) : std::nullopt;
  const auto before = clone_of(since);  // So that never two maps are locked at a time.
  ChangeArrays arrays = map.read([&](const MapInterface& m) { return m.changes(*before, what, region); });
  Changes result;
  result.lower = take(std::move(arrays.lower), map.constant().dim());
  result.size = take(std::move(arrays.size));
  result.before = take(std::move(arrays.before));
  result.after = take(std::move(arrays.after));
  return result;
}

py::object transformed(const PythonMap& map, const py::object& pose) {
  const Poses one = pose_from(pose, map.constant().dim());
  return to_python(map.read([&](const MapInterface& m) { return m.transformed(one.numbers.data()); }));
}

struct PythonFrontierSearch {
  std::unique_ptr<AnyFrontierSearch> search;
  mutable SharedLock lock;
};

py::array_t<double> pose_matrix(const py::object& pose, int dim, const std::string& name) {
  if (dim < 2 || dim > 4) throw py::value_error("dim = " + std::to_string(dim) + ": must be 2, 3 or 4");
  const Poses one = pose_from(pose, dim, name.c_str());
  return matrix_of(one.numbers, dim);
}

}  // namespace

void bind_changes(py::module_& module) {
  module.def("pose_matrix", &pose_matrix, "pose"_a, py::kw_only(), "dim"_a, "name"_a = "pose",
             doc::pose_matrix);
  py::class_<Changes>(module, "Changes")
      .def_readonly("lower", &Changes::lower)
      .def_readonly("size", &Changes::size)
      .def_readonly("before", &Changes::before)
      .def_readonly("after", &Changes::after);

  auto base = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  const auto snapshot = [](const PythonMap& map) {
    return to_python(map.read([](const MapInterface& m) {
      if (!m.clones_cheaply()) (void)m.queries();  // Which says that it is not ours.
      return m.clone();
    }));
  };
  constexpr const char* kSnapshot = doc::OccupancyMap_snapshot;
  base.def("snapshot", snapshot, kSnapshot);
  base.def_property_readonly("revision", snapshot, doc::OccupancyMap_revision);
  base.def("changes", &changes, py::kw_only(), "since"_a, "of"_a = "states", "box"_a = py::none(),
           doc::OccupancyMap_changes);
  py::reinterpret_borrow<py::class_<PythonField>>(module.attr("DistanceField"))
      .def(
          "update",
          [](PythonField& field, const PythonMap& map, const PythonMap& since) {
            const auto before = clone_of(since);  // So that no map is locked while the field is.
            const auto now = clone_of(map);
            field.write([&](AnyField& any) { now->update_field(any, *before); });
          },
          "map"_a, py::kw_only(), "since"_a, doc::DistanceField_update);
  base.def(
      "merge",
      [](PythonMap& map, const PythonMap& other) {
        const auto more = clone_of(other);
        map.write([&](MapInterface& m) { m.merge(*more); });
      },
      "other"_a, doc::OccupancyMap_merge);
  base.def(
      "adopt",
      [](PythonMap& map, const PythonMap& other, const py::object& box) {
        std::optional<BoxArgument> part;
        if (!box.is_none()) part.emplace(box, map.constant().dim(), "box");
        const auto more = clone_of(other);
        map.write([&, region = part ? std::optional<AnyBox>(*part) : std::nullopt](MapInterface& m) {
          m.adopt(*more, region);
        });
      },
      "other"_a, "box"_a = py::none(), doc::OccupancyMap_adopt);
  base.def("transformed", &transformed, "pose"_a, doc::OccupancyMap_transformed);
  py::class_<PythonFrontierSearch>(module, "FrontierSearch", doc::FrontierSearch)
      .def(py::init([](const PythonMap& map, const py::object& box) {
             std::optional<BoxArgument> region;
             if (!box.is_none()) region.emplace(box, map.constant().dim());
             auto search = std::make_unique<PythonFrontierSearch>();
             search->search =
                 map.read([&](const MapInterface& m) { return m.queries()->frontier_search(region); });
             return search;
           }),
           "map"_a, "box"_a = py::none())
      .def(
          "update",
          [](PythonFrontierSearch& search, const PythonMap& map) {
            map.read([&](const MapInterface& m) {
              const SharedLock::Holder holder(search.lock, SharedLock::Use::change);
              search.search->update(*m.queries());
            });
          },
          "map"_a, doc::FrontierSearch_update)
      .def(
          "frontiers",
          [](const PythonFrontierSearch& search, double min_cells) {
            AnyFrontiers all;
            {
              const Released released;
              const CallInProgress call;
              const SharedLock::Holder holder(search.lock, SharedLock::Use::look);
              all = search.search->frontiers(min_cells);
            }
            return to_python(std::move(all));
          },
          py::kw_only(), "min_cells"_a = 8.0, doc::FrontierSearch_frontiers);
}

}  // namespace ndtree::python
