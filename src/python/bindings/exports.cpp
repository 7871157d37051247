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

#include "docstrings.hpp"
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
                  const std::string& values, std::optional<double> wall_depth) {
  const int dim = map.constant().dim();
  if (values != "state" && values != "probability" && values != "log_odds")
    throw py::value_error("values = '" + values + "': must be 'state', 'probability' or 'log_odds'");
  if (wall_depth && values != "state")
    throw py::value_error("wall_depth with values = '" + values + "': is for states");
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
      m.grid_states(lower, counts.data(), size, wall_depth, data);
    });
    return py::array(std::move(out));
  }
  py::array_t<float> out(shape);
  read_exports(map, [&, data = out.mutable_data(), n = out.size()](const MapExports& m) {
    m.grid_log_odds(lower, counts.data(), size, data);
    if (values == "probability")
      for (py::ssize_t i = 0; i < n; ++i)
        data[i] = static_cast<float>(probability(static_cast<double>(data[i])));
  });
  return py::array(std::move(out));
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
                                    std::optional<std::pair<double, double>> height,
                                    std::optional<double> wall_depth) {
  MapServerOptions options;
  options.cell_size = cell_size;
  options.height = height;
  options.wall_depth = wall_depth;
  return options;
}

}  // namespace

void bind_exports(py::module_& module) {
  auto map_class = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  map_class
      .def("to_grid", &grid_of, "box"_a, "cell_size"_a = py::none(), py::kw_only(), "values"_a = "state",
           "wall_depth"_a = py::none(), doc::OccupancyMap_to_grid)
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
          "lower"_a, "upper"_a, doc::OccupancyMap_states_in)
      .def(
          "distance_to_occupied",
          [](const PythonMap& map, const py::object& points) {
            const DoubleArray p = as_points(points, "points", map.constant().dim());
            py::array_t<double> out(p.shape(0));
            read_exports(map, [&, data = out.mutable_data(), n = static_cast<std::size_t>(p.shape(0)),
                               in = p.data()](const MapExports& m) { m.distance_to_occupied(in, n, data); });
            return out;
          },
          "points"_a, doc::OccupancyMap_distance_to_occupied)
      .def(
          "save_octomap",
          [](const PythonMap& map, const std::filesystem::path& path, std::optional<double> cell_size) {
            const OctomapFormat format = octomap_format_of(path);
            read_exports(map,
                         [&](const MapExports& m) { write_file(path, m.octomap_bytes(format, cell_size)); });
          },
          "path"_a, py::kw_only(), "cell_size"_a = py::none(), doc::OccupancyMap_save_octomap)
      .def(
          "save_map_server",
          [](const PythonMap& map, const std::filesystem::path& path, std::optional<double> cell_size,
             std::optional<std::pair<double, double>> height, std::optional<double> wall_depth) {
            read_exports(map, [&](const MapExports& m) {
              save_map_server(m.map_server_image(map_server_options(cell_size, height, wall_depth)), path);
            });
          },
          "path"_a, py::kw_only(), "cell_size"_a = py::none(), "height"_a = py::none(),
          "wall_depth"_a = py::none(), doc::OccupancyMap_save_map_server)
      .def(
          "map_server_image",
          [](const PythonMap& map, std::optional<double> cell_size,
             std::optional<std::pair<double, double>> height, std::optional<double> wall_depth) {
            MapServerImage image = read_exports(map, [&](const MapExports& m) {
              return m.map_server_image(map_server_options(cell_size, height, wall_depth));
            });
            const auto rows = static_cast<py::ssize_t>(image.height);
            const auto columns = static_cast<py::ssize_t>(image.width);
            py::array_t<std::uint8_t> pixels = take(std::move(image.pixels));
            return py::make_tuple(pixels.reshape({rows, columns}),
                                  py::make_tuple(image.origin.x(), image.origin.y()), image.cell_size);
          },
          py::kw_only(), "cell_size"_a = py::none(), "height"_a = py::none(), "wall_depth"_a = py::none(),
          doc::OccupancyMap_map_server_image)
      .def(
          "save_ply",
          [](const PythonMap& map, const std::filesystem::path& path, const py::object& leaves) {
            const auto n =
                static_cast<py::ssize_t>(map.read([](const MapInterface& m) { return m.stats().leaves; }));
            const py::object mask = as_mask(leaves, "leaves", n);
            const bool* const chosen = mask.is_none() ? nullptr : mask.cast<BoolArray>().data();
            read_exports(map, [&](const MapExports& m) { write_file(path, m.ply_bytes(chosen)); });
          },
          "path"_a, py::kw_only(), "leaves"_a = py::none(), doc::OccupancyMap_save_ply);

  module.def("write_ply", &write_ply_of, "path"_a, "points"_a, py::kw_only(), "size"_a, "probability"_a,
             "state"_a, doc::write_ply);
}

}  // namespace ndtree::python
