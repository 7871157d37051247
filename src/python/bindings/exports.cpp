// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <cmath>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "map_exports.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/map_file.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// Runs `function(exports)` without the interpreter's lock.
template <class Function>
auto read_exports(const PythonMap& map, Function&& function) {
  return map.read([&](const MapInterface& m) { return function(std::as_const(*m.exports())); });
}

/// Cells along an axis from lower to upper. Sizes are decimal numbers that no double holds exactly: a ratio
/// within 1e-9 of a whole number is taken for it.
py::ssize_t cells_between(double lower, double upper, double cell_size) {
  const double cells = (upper - lower) / cell_size;
  const double nearest = std::round(cells);
  if (!(cells < 9e15)) throw py::value_error("box: more cells than can be addressed");
  return static_cast<py::ssize_t>(
      std::abs(cells - nearest) <= 1e-9 * std::max(1.0, std::abs(cells)) ? nearest : std::ceil(cells));
}

py::array grid_of(const PythonMap& map, const py::object& box, std::optional<double> cell_size,
                  const std::string& values) {
  const int dim = map.constant().dim();
  if (values != "state" && values != "probability" && values != "log_odds")
    throw py::value_error("values = '" + values + "': must be 'state', 'probability' or 'log_odds'");
  const double size = cell_size.value_or(map.constant().options().min_cell_size);
  if (!(size > 0.0) || !std::isfinite(size))
    throw py::value_error("cell_size = " + number_text(size) + " m: must be > 0 and finite");
  const DoubleArray corners = as_corners(box, "box", dim);
  const double* const lower = corners.data();
  std::vector<py::ssize_t> shape;
  double cells = 1.0;
  for (int a = 0; a < dim; ++a) {
    const double upper = corners.data()[dim + a];
    if (!std::isfinite(lower[a]) || !std::isfinite(upper) || !(lower[a] <= upper))
      throw py::value_error("box: axis " + std::to_string(a) + " is from " + number_text(lower[a]) + " to " +
                            number_text(upper) + " m, must be finite and from low to high");
    shape.push_back(cells_between(lower[a], upper, size));
    cells *= static_cast<double>(shape.back());
  }
  if (!(cells < 9e15)) throw py::value_error("box: more cells than can be addressed");
  const std::vector<std::size_t> counts(shape.begin(), shape.end());
  if (values == "state") {
    py::array_t<std::int8_t> out(shape);
    read_exports(map, [&, data = out.mutable_data()](const MapExports& m) {
      m.grid_states(lower, counts.data(), size, data);
    });
    return std::move(out);
  }
  py::array_t<float> out(shape);
  read_exports(map, [&, data = out.mutable_data(), n = out.size()](const MapExports& m) {
    m.grid_log_odds(lower, counts.data(), size, data);
    if (values == "probability")
      for (py::ssize_t i = 0; i < n; ++i)
        data[i] = static_cast<float>(probability(static_cast<double>(data[i])));
  });
  return std::move(out);
}

/// Makes a map of any of the refinements with two children along each axis: `make(type)` gives that map.
template <int D, class Make>
py::object made(const std::string& refinement, const Make& make) {
  std::string bytes;
  {
    const Released released;
    if (refinement == FixedRefinement::kName)
      bytes = to_bytes(make(static_cast<FixedMap<2, D>*>(nullptr)));
    else if (refinement == PaperRefinement::kName)
      bytes = to_bytes(make(static_cast<PaperMap<2, D>*>(nullptr)));
    else if (refinement == EvidenceRefinement::kName)
      bytes = to_bytes(make(static_cast<AdaptiveMap<2, D>*>(nullptr)));
    else
      throw std::invalid_argument("refinement = '" + refinement +
                                  "': must be 'evidence', 'paper' or 'fixed'");
  }
  std::unique_ptr<MapInterface> map;
  {
    const Released released;
    map = map_from_bytes(bytes);
  }
  return to_python(std::move(map));
}

py::object load_octomap_file(const std::filesystem::path& path, const std::string& refinement,
                             double max_memory) {
  MapOptions options;
  options.max_memory = max_memory;
  options.validate();
  try {
    return made<3>(refinement, [&](auto* type) {
      return load_octomap<std::remove_pointer_t<decltype(type)>>(path, options);
    });
  } catch (const MemoryLimitReached& error) {
    PyErr_SetString(PyExc_MemoryError, (path.string() + ": " + error.what()).c_str());
    throw py::error_already_set();
  } catch (const std::filesystem::filesystem_error&) {
    throw;
  } catch (const std::runtime_error& error) {
    throw std::invalid_argument(error.what());
  }
}

template <int D>
py::object map_of_grid(const py::array_t<std::int8_t, py::array::c_style>& states, const DoubleArray& lower,
                       double cell_size, const std::string& refinement) {
  GridGeometry<D> grid;
  grid.cell_size = cell_size;
  for (int a = 0; a < D; ++a) {
    grid.lower[a] = lower.data()[a];
    grid.shape[static_cast<std::size_t>(a)] = static_cast<std::size_t>(states.shape(a));
  }
  const std::int8_t* const data = states.data();
  return made<D>(refinement,
                 [&](auto* type) { return from_grid<std::remove_pointer_t<decltype(type)>>(data, grid); });
}

py::object map_from_grid(const py::object& states, const py::object& lower, double cell_size,
                         const std::string& refinement) {
  using States = py::array_t<std::int8_t, py::array::c_style>;
  const py::array given = py::array::ensure(states);
  if (!given || (given.dtype().kind() != 'i' && given.dtype().kind() != 'u'))
    throw py::type_error("states: must be an array of whole numbers");
  if (given.ndim() != 2 && given.ndim() != 3)
    throw py::value_error("states has shape " + shape_text(given) + ": must have two or three axes");
  const auto dim = static_cast<int>(given.ndim());
  for (const char* const bound : {"min", "max"}) {  // Before they are made narrower.
    if (given.size() == 0) break;
    const auto extreme = given.attr(bound)().cast<long long>();
    if (extreme < -1 || extreme > 1)
      throw py::value_error("states holds " + std::to_string(extreme) +
                            ": must be -1 unknown, 0 free and 1 occupied");
  }
  const auto narrow = States::ensure(given.attr("astype")("int8"));
  const DoubleArray corner = as_doubles(lower, "lower");
  if (corner.ndim() != 1 || corner.shape(0) != dim)
    throw py::value_error("lower has shape " + shape_text(corner) + ": must be (" + std::to_string(dim) +
                          ",)");
  return dim == 2 ? map_of_grid<2>(narrow, corner, cell_size, refinement)
                  : map_of_grid<3>(narrow, corner, cell_size, refinement);
}

void write_ply_of(const std::filesystem::path& path, const py::object& points, const py::object& size,
                  const py::object& probability, const py::object& state) {
  const DoubleArray at = as_doubles(points, "points");
  if (at.ndim() != 2 || (at.shape(1) != 2 && at.shape(1) != 3))
    throw py::value_error("points has shape " + shape_text(at) + ": must be (n, 2) or (n, 3)");
  const auto of_points = [&](const py::object& object, const char* name) {
    const DoubleArray values = as_doubles(object, name);
    if (values.ndim() != 1 || values.shape(0) != at.shape(0))
      throw py::value_error(std::string(name) + " has shape " + shape_text(values) + ", points " +
                            shape_text(at) + ": must be as many");
    return values;
  };
  const DoubleArray sizes = of_points(size, "size");
  const DoubleArray probabilities = of_points(probability, "probability");
  const DoubleArray states = of_points(state, "state");
  PlyCells cells;
  for (py::ssize_t i = 0; i < at.shape(0); ++i) {
    Vector<3> centre = Vector<3>::Zero();
    for (py::ssize_t a = 0; a < at.shape(1); ++a) centre[a] = at.at(i, a);
    cells.add(centre, sizes.at(i), probabilities.at(i), static_cast<CellState>(states.at(i)));
  }
  write_file(path, cells.bytes());
}

MapServerOptions map_server_options(std::optional<double> cell_size,
                                    std::optional<std::pair<double, double>> height) {
  MapServerOptions options;
  options.cell_size = cell_size;
  options.height = height;
  return options;
}

}  // namespace

void bind_exports(py::module_& module) {
  auto map_class = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  map_class
      .def("to_grid", &grid_of, "box"_a, "cell_size"_a = py::none(), py::kw_only(), "values"_a = "state",
           R"(A part of the map as a dense array.

Entry [i, j, ...] is what the map says at the centre of the cell from lower + (i, j, ...) * cell_size to
lower + (i + 1, j + 1, ...) * cell_size, half-open: the first axis is x, the second y, the third z.

Parameters
----------
box : (2, dim) array of float
    Lower and upper corner [m]. Cells begin at the lower one, as many as cover the box.
cell_size : float, optional
    [m]; left out, the map's smallest.
values : {"state", "probability", "log_odds"}
    What is stored.

Returns
-------
array of int8, or of float32
    One axis for each of space. States are -1 unknown, 0 free, 1 occupied; unknown space has the probability
    0.5 and the log-odds 0.

Raises
------
ValueError
    A shape is wrong, the box not finite or not from low to high, or cell_size not > 0.
)")
      .def(
          "states_in",
          [](const PythonMap& map, const py::object& lower, const py::object& upper) {
            const int dim = map.constant().dim();
            const DoubleArray low = as_points(lower, "lower", dim);
            const DoubleArray high = as_points(upper, "upper", dim);
            if (low.shape(0) != high.shape(0))
              throw py::value_error("lower has shape " + shape_text(low) + ", upper " + shape_text(high) +
                                    ": must be the same");
            for (py::ssize_t i = 0; i < low.size(); ++i)
              if (!(low.data()[i] <= high.data()[i]))
                throw py::value_error("box " + std::to_string(i / dim) + ": must be from low to high");
            py::array_t<bool> out({low.shape(0), py::ssize_t{3}});
            read_exports(map,
                         [&, a = low.data(), b = high.data(), n = static_cast<std::size_t>(low.shape(0)),
                          data = out.mutable_data()](const MapExports& m) { m.states_in(a, b, n, data); });
            return out;
          },
          "lower"_a, "upper"_a, R"(Which states there are in boxes.

Parameters
----------
lower, upper : (n, dim) array of float
    Corners [m]. The boxes are closed: a cell that shares a point with one counts.

Returns
-------
(n, 3) bool
    Whether something in the box is unknown, free, occupied. Space outside the map is unknown.

Raises
------
ValueError
    A shape is wrong, or a box not from low to high.
)")
      .def(
          "distance_to_occupied",
          [](const PythonMap& map, const py::object& points) {
            const DoubleArray p = as_points(points, "points", map.constant().dim());
            py::array_t<double> out(p.shape(0));
            read_exports(map, [&, data = out.mutable_data(), n = static_cast<std::size_t>(p.shape(0)),
                               in = p.data()](const MapExports& m) { m.distance_to_occupied(in, n, data); });
            return out;
          },
          "points"_a, R"(Distance from points to the nearest occupied cell.

Parameters
----------
points : (n, dim) array of float
    Map frame [m].

Returns
-------
(n,) float64
    To the cell's border, 0 inside [m]; nan where the map has no occupied cell.
)")
      .def(
          "save_octomap",
          [](const PythonMap& map, const std::filesystem::path& path, std::optional<double> cell_size) {
            const OctomapFormat format = octomap_format_of(path);
            read_exports(map,
                         [&](const MapExports& m) { write_file(path, m.octomap_bytes(format, cell_size)); });
          },
          "path"_a, py::kw_only(), "cell_size"_a = py::none(), R"(Write an OctoMap file of a 3-D map.

A cell of OctoMap's takes what the map says at its centre; with branching 2 and the map's own cell size that is
exact. Unknown space stays unknown. The file appears whole or not at all.

Parameters
----------
path : str or os.PathLike
    Ends in .ot, with the log-odds of each cell, or in .bt, where cells are free or occupied and no more.
cell_size : float, optional
    OctoMap's resolution [m]; left out, the map's smallest cell size.

Raises
------
ValueError
    The map is not 3-D, the name ends otherwise, or something known lies more than 32768 cells from 0.
OSError
    The file cannot be written.
)")
      .def(
          "save_map_server",
          [](const PythonMap& map, const std::filesystem::path& path, std::optional<double> cell_size,
             std::optional<std::pair<double, double>> height) {
            read_exports(map, [&](const MapExports& m) {
              save_map_server(m.map_server_image(map_server_options(cell_size, height)), path);
            });
          },
          "path"_a, py::kw_only(), "cell_size"_a = py::none(), "height"_a = py::none(),
          R"(Write a map for navigation, as ROS's map_server and nav2 read it: .yaml, and .pgm beside it.

A pixel is occupied if some occupied cell overlaps it, else free if some free one does, else unknown.

Parameters
----------
path : str or os.PathLike
    Ends in .yaml; the image has the same name with .pgm.
cell_size : float, optional
    Edge of a pixel [m]; left out, the map's smallest cell size.
height : (low, high), optional
    Of a 3-D map, only cells that overlap low <= z < high [m]; left out, all.

Raises
------
ValueError
    The map is not 2-D or 3-D, a value is out of bounds, or nothing is known there.
OSError
    A file cannot be written.
)")
      .def(
          "map_server_image",
          [](const PythonMap& map, std::optional<double> cell_size,
             std::optional<std::pair<double, double>> height) {
            MapServerImage image = read_exports(map, [&](const MapExports& m) {
              return m.map_server_image(map_server_options(cell_size, height));
            });
            const auto rows = static_cast<py::ssize_t>(image.height);
            const auto columns = static_cast<py::ssize_t>(image.width);
            py::array_t<std::uint8_t> pixels = take(std::move(image.pixels));
            return py::make_tuple(pixels.reshape({rows, columns}),
                                  py::make_tuple(image.origin.x(), image.origin.y()), image.cell_size);
          },
          py::kw_only(), "cell_size"_a = py::none(), "height"_a = py::none(),
          R"(The image that save_map_server() writes.

Parameters
----------
cell_size, height
    As of save_map_server().

Returns
-------
pixels : (rows, columns) uint8
    254 free, 0 occupied, 205 unknown; the first row is the one with the largest y.
origin : (x, y)
    Lower left corner of the last row's first pixel [m].
cell_size : float
    Edge of a pixel [m].
)")
      .def(
          "save_ply",
          [](const PythonMap& map, const std::filesystem::path& path, const py::object& leaves) {
            const auto n =
                static_cast<py::ssize_t>(map.read([](const MapInterface& m) { return m.stats().leaves; }));
            const py::object mask = as_mask(leaves, "leaves", n);
            const bool* const chosen = mask.is_none() ? nullptr : mask.cast<BoolArray>().data();
            read_exports(map, [&](const MapExports& m) { write_file(path, m.ply_bytes(chosen)); });
          },
          "path"_a, py::kw_only(), "leaves"_a = py::none(), R"(Write cells as points of a PLY file.

Each has x, y, z of the cell's centre and its size [m], its probability and its state (-1 unknown, 0 free,
1 occupied). In the plane, z is 0. The file appears whole or not at all.

Parameters
----------
path : str or os.PathLike
leaves : (n,) array of bool, optional
    Which of leaves() are written; left out, the occupied ones.

Raises
------
ValueError
    The map is not 2-D or 3-D, or the mask has another length.
OSError
    The file cannot be written.
)");

  module.def("write_ply", &write_ply_of, "path"_a, "points"_a, py::kw_only(), "size"_a, "probability"_a,
             "state"_a,
             "A PLY file as OccupancyMap.save_ply() writes it, of any cells: their centres and more.");
  module.def("load_octomap", &load_octomap_file, "path"_a, py::kw_only(),
             "refinement"_a = EvidenceRefinement::kName, "max_memory"_a = 0.0,
             R"(Read an OctoMap file, .bt or .ot, into a map.

Cells have the borders and states of the file's leaves. Log-odds are the file's with refinement "paper" and
"fixed". With "evidence" a cell gets the least evidence that gives its log-odds, which is met within 0.008 from
-4.6 to 5.9, and is the nearer bound outside. Leaves of a .bt file get the map's log_odds_min or log_odds_max.

Parameters
----------
path : str or os.PathLike
refinement : {"evidence", "paper", "fixed"}
    How the map goes on when scans are inserted. With "fixed" all cells are of the smallest size.
max_memory : float
    As of AdaptiveMap: a file that needs more is refused [bytes].

Returns
-------
AdaptiveMap or FixedMap
    With dim 3, branching 2, and the file's resolution as its smallest cell size.

Raises
------
OSError
    The file cannot be read.
ValueError
    It is not an OctoMap file, or damaged: what was found, and where.
MemoryError
    The map would hold more than max_memory.
)");
  module.def("from_grid", &map_from_grid, "states"_a, "lower"_a, "cell_size"_a, py::kw_only(),
             "refinement"_a = EvidenceRefinement::kName, R"(A map with the states of a dense array.

The inverse of OccupancyMap.to_grid(). Free cells get the map's log_odds_min, occupied ones its log_odds_max.

Parameters
----------
states : 2-D or 3-D array of int
    -1 unknown, 0 free, 1 occupied; the first axis is x, the second y, the third z.
lower : (dim,) array of float
    Lower corner of the first cell [m]: within a millionth of a cell of whole numbers of cells from 0.
cell_size : float
    [m].
refinement : {"evidence", "paper", "fixed"}
    How the map goes on when scans are inserted. With the first two, equal neighbours are joined.

Returns
-------
AdaptiveMap or FixedMap
    With branching 2.

Raises
------
ValueError
    A shape or a number is wrong, or the corner is not on the lattice of cells.
)");
}

}  // namespace ndtree::python
