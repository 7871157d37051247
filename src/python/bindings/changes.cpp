// SPDX-License-Identifier: BSD-3-Clause
// Maps beside each other: snapshots, what has changed, and maps that are put together.
#include <memory>
#include <optional>
#include <utility>

#include "arguments.hpp"
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
  if (name == "cells") return ChangeOf::cells;
  throw py::value_error("of = '" + name + "': must be 'states' or 'cells'");
}

/// A map that goes on by itself, at once.
std::unique_ptr<MapInterface> clone_of(const PythonMap& map) {
  return map.read([](const MapInterface& m) { return m.clone(); });
}

Changes changes(const PythonMap& map, const PythonMap& since, const std::string& of) {
  const ChangeOf what = change_of(of);
  const auto before = clone_of(since);  // So that never two maps are locked at a time.
  ChangeArrays arrays = map.read([&](const MapInterface& m) { return m.changes(*before, what); });
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
  py::array_t<double> matrix({dim + 1, dim + 1});
  for (int row = 0; row < dim; ++row) {
    for (int column = 0; column < dim; ++column)
      matrix.mutable_at(row, column) = one.numbers[static_cast<std::size_t>(row * dim + column)];
    matrix.mutable_at(row, dim) = one.numbers[static_cast<std::size_t>(dim * dim + row)];
  }
  for (int column = 0; column <= dim; ++column) matrix.mutable_at(dim, column) = column == dim ? 1.0 : 0.0;
  return matrix;
}

}  // namespace

void bind_changes(py::module_& module) {
  module.def("pose_matrix", &pose_matrix, "pose"_a, py::kw_only(), "dim"_a, "name"_a = "pose",
             R"(A pose as a homogeneous matrix, checked as all are that maps are given.

Parameters
----------
pose : (dim + 1, dim + 1) array of float; or (3,) in 2-D, (7,) in 3-D
    As of `OccupancyMap.transformed`.
dim : int
    2, 3 or 4.
name : str
    What errors call it.

Returns
-------
(dim + 1, dim + 1) float64

Raises
------
ValueError
    As of `OccupancyMap.transformed`.
)");
  py::class_<Changes>(module, "Changes", "Regions whose state, or cell, is another one, one entry each.")
      .def_readonly("lower", &Changes::lower, "(n, dim) float64: lower corners [m].")
      .def_readonly("size", &Changes::size, "(n,) float64: edge lengths [m].")
      .def_readonly("before", &Changes::before, "(n,) int8: -1 unknown, 0 free, 1 occupied.")
      .def_readonly("after", &Changes::after, "(n,) int8: the same, now.")
      .def("__len__", [](const Changes& all) { return all.size.size(); })
      .def("__repr__",
           [](const Changes& all) { return "Changes(" + std::to_string(all.size.size()) + " regions)"; });

  auto base = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  const auto snapshot = [](const PythonMap& map) {
    return to_python(map.read([](const MapInterface& m) {
      if (!m.clones_cheaply()) (void)m.queries();  // Which says that it is not ours.
      return m.clone();
    }));
  };
  constexpr const char* kSnapshot = R"(The map as it is now, which stays so while this one goes on.

It shares all cells that do not change from now on, so that it is made in microseconds for each megabyte. Other
threads may read it as long as they like, without waiting. It is a map as any other: what is inserted into it
changes nothing here.

Returns
-------
OccupancyMap
    Of the same kind.

Raises
------
ValueError
    For OctoMap.
)";
  base.def("snapshot", snapshot, kSnapshot);
  base.def_property_readonly(
      "revision", snapshot, "What the map is now, to be asked for `changes(since=...)` later: a snapshot().");
  base.def("changes", &changes, py::kw_only(), "since"_a, "of"_a = "states",
           R"(What is different from what the map, or another one of the same cells, was.

Takes time in proportion to what was written since the snapshot was made, whatever the size of the map. Any number
of listeners may each keep a snapshot of their own; one holds at most the memory that the map held then.

Parameters
----------
since : OccupancyMap
    An earlier snapshot() or `revision` of this map, or any map of the same kind with cells of the same sizes.
of : {"states", "cells"}
    What has to be different: the state, or anything that a cell holds, as its probability, hits and misses, size, or
    values of its layers (which takes time in proportion to those of layers that changed).

Returns
-------
Changes
    Regions, free of overlaps; each lies in one cell of either map.

Raises
------
ValueError
    The maps are not of the same kind, their cells not of the same sizes, or `of` is none of these.
)");
  py::reinterpret_borrow<py::class_<PythonField>>(module.attr("DistanceField"))
      .def(
          "update",
          [](PythonField& field, const PythonMap& map, const PythonMap& since) {
            const auto before = clone_of(since);  // So that no map is locked while the field is.
            const auto now = clone_of(map);
            field.write([&](AnyField& any) { now->update_field(any, *before); });
          },
          "map"_a, py::kw_only(), "since"_a,
          R"(Follow the map: afterwards every value is what distance_field() would give now, bit for bit.

Only points are looked at for which something that changed is no farther away than what was nearest. Other threads that
ask the field meanwhile wait, and get answers of before or after.

Parameters
----------
map : OccupancyMap
    That the field was made of.
since : OccupancyMap
    A snapshot() of it from when the field was made, or last updated.

Raises
------
ValueError
    The maps are not of the same kind, or not of the field's dimension.
)");
  base.def(
      "merge",
      [](PythonMap& map, const PythonMap& other) {
        const auto more = clone_of(other);
        map.write([&](MapInterface& m) { m.merge(*more); });
      },
      "other"_a, R"(Add what another map of the same place knows.

Evidence and counts of cells add up, as if this map had seen both (of paper and fixed maps the log-odds, clamped);
where the cells of one are larger, each of the other's gets its part. What both come to does not depend on which is
merged into which. To put maps of different frames together, move one first: see transformed().

Parameters
----------
other : OccupancyMap
    Of the same kind, with cells of the same sizes.

Raises
------
ValueError
    They are not. The map is then unchanged.
MemoryError
    The map would hold more than max_memory. It is then unchanged.
)");
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
      "other"_a, "box"_a = py::none(),
      R"(Copy the cells of another map where this one is unknown.

Every cell stays what it is, bit for bit: parts of space that were mapped apart, see insert(window=), become the map that
one would have made. To add up the evidence of two maps of the same place, see merge().

Parameters
----------
other : OccupancyMap
    Of the same kind, with cells of the same sizes.
box : (2, dim) array of float, optional
    Lower and upper corner [m]: only cells in it are taken over, that is, in all cubes of `max_cell_size` (of a fixed
    map: all cells) that share a volume with it, and the counts of `stats` stay this map's. Default: all, and the
    counts add up.

Raises
------
ValueError
    The maps are not of the same kind, their cells not of the same sizes, the box has no volume, or both maps hold cells
    in a cube of `max_cell_size`; it is named. The map is then unchanged.
MemoryError
    The map would hold more than max_memory. It is then unchanged.
)");
  base.def("transformed", &transformed, "pose"_a, R"(The map in another frame: moved by a rigid motion.

A motion by right angles and whole cells of max_cell_size (of a fixed map: whole cells) moves every cell as it is, with
what it carries, bit for bit, and keeps the counters; the identity gives a map of the same bytes. After any other,
borders and surfaces are moved to the nearest smallest cell, by at most half its diagonal more than the motion; nothing
is blurred, and nothing unknown becomes known.

Parameters
----------
pose : (dim + 1, dim + 1) array of float; or (3,) in 2-D, (7,) in 3-D
    Every point x of this map is at `pose * x` in the other: a homogeneous matrix; or x, y and yaw; or x, y, z and a
    quaternion qx, qy, qz, qw [m, rad].

Returns
-------
OccupancyMap
    Of the same kind and options.

Raises
------
ValueError
    The pose is not finite, its rotation mirrors or is none, the last row of its matrix is not 0, ..., 0, 1, or it moves
    cells to where the lattice of cells does not reach; or borders and surfaces would go through more than 2**24 of the
    smallest cells, and 16 more for each leaf.
MemoryError
    The map, with what its cells carry, would hold more than max_memory.
)");
  py::class_<PythonFrontierSearch>(module, "FrontierSearch",
                                   R"(Frontiers that follow a map.

What has not changed since the last update() is not looked at again. Threads may share it.

Parameters
----------
map : OccupancyMap
    One of ndtree's own.
box : (2, dim) array of float, optional
    Lower and upper corner [m]: free cells that touch it count. Default: everywhere.

Raises
------
ValueError
    The map is an OctoMap, or the box has a wrong shape.
)")
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
          "map"_a, R"(Follow the map: afterwards the frontiers are those of the map as it is now.

Parameters
----------
map : OccupancyMap
    That the search was made of, or a copy of it that has changed.

Raises
------
ValueError
    The map is of another kind, or its cells of other sizes.
KeyboardInterrupt
    Ctrl-C: there are no frontiers then until the next update.
)")
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
          py::kw_only(), "min_cells"_a = 8.0, R"(As OccupancyMap.frontiers() of the map at the last update.

Parameters
----------
min_cells : float
    Frontiers with a border smaller than this many faces of smallest cells are left out.

Returns
-------
list of Frontier
    The largest border first.
)");
}

}  // namespace ndtree::python
