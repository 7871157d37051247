// SPDX-License-Identifier: BSD-3-Clause
// Maps made of files, bytes and grids.
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "arguments.hpp"
#include "docstrings.hpp"
#include "map_layers.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/dense_grid.hpp"
#include "ndtree/io/layer_file.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "python_map.hpp"

namespace ndtree::python {

// In the file of each shape.
template <class Map>
std::unique_ptr<MapInterface> adapted(const Map& map, const MapLayers<Map::kBranching, Map::kDim>& layers);
extern template std::unique_ptr<MapInterface> adapted(const AdaptiveMap<2, 2>&, const MapLayers<2, 2>&);
extern template std::unique_ptr<MapInterface> adapted(const AdaptiveMap<2, 3>&, const MapLayers<2, 3>&);

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// A map and its layers as Python's: one of the default without layers as it is, all others by way of their
/// bytes.
template <class Map>
std::unique_ptr<MapInterface> wrapped(const Map& map, const std::vector<StoredLayer>& layers) {
  if constexpr (std::is_same_v<Map, AdaptiveMap<2, Map::kDim>>)
    if (layers.empty()) return adapted(map, MapLayers<2, Map::kDim>{});
  return map_from_bytes(to_bytes(map, layers));
}

/// Makes a map of any of the refinements with two children along each axis: `make(type)` gives it, wrapped.
template <int D, class Make>
std::unique_ptr<MapInterface> made(const std::string& refinement, const Make& make) {
  if (refinement == FixedRefinement::kName) return make(static_cast<FixedMap<2, D>*>(nullptr));
  if (refinement == PaperRefinement::kName) return make(static_cast<PaperMap<2, D>*>(nullptr));
  if (refinement == EvidenceRefinement::kName) return make(static_cast<AdaptiveMap<2, D>*>(nullptr));
  throw OptionError("refinement", "'" + refinement + "'", "'evidence', 'paper' or 'fixed'");
}

/// What `make()` makes of the file's bytes, without the interpreter's lock; errors name the file.
template <class Make>
py::object loaded(const std::filesystem::path& path, const Make& make) {
  std::unique_ptr<MapInterface> map;
  try {
    const Released released;
    map = make(read_file(path));
  } catch (const MemoryLimitReached& error) {
    PyErr_SetString(PyExc_MemoryError, (path.string() + ": " + error.what()).c_str());
    throw py::error_already_set();
  } catch (const std::filesystem::filesystem_error&) {
    throw;
  } catch (const std::runtime_error& error) {
    throw std::invalid_argument(path.string() + ": " + error.what());
  }
  return to_python(std::move(map));
}

std::unique_ptr<MapInterface> map_of_octomap(std::string_view bytes, const std::string& refinement,
                                             double max_memory) {
  MapOptions options;
  options.max_memory = max_memory;
  return made<3>(refinement, [&](auto* type) {
    using Map = std::remove_pointer_t<decltype(type)>;
    std::optional<OctomapColors<Map>> colors;
    const Map map = octomap_from_bytes<Map>(bytes, options, &colors);
    std::vector<StoredLayer> layers;
    if (colors) layers.push_back(stored(*colors, "color"));
    return wrapped(map, layers);
  });
}

py::object load(const std::filesystem::path& path) {
  return loaded(path, [](std::string_view bytes) {
    return is_octomap_file(bytes) ? map_of_octomap(bytes, EvidenceRefinement::kName, 0.0)
                                  : map_from_bytes(bytes);
  });
}

py::object load_octomap_file(const std::filesystem::path& path, const std::string& refinement,
                             double max_memory) {
  return loaded(path, [&](std::string_view bytes) { return map_of_octomap(bytes, refinement, max_memory); });
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
  std::unique_ptr<MapInterface> map;
  {
    const Released released;
    map = made<D>(refinement, [&](auto* type) {
      return wrapped(from_grid<std::remove_pointer_t<decltype(type)>>(data, grid), {});
    });
  }
  return to_python(std::move(map));
}

py::object map_from_grid(const py::object& states, const py::object& lower, double cell_size,
                         const std::string& refinement) {
  using States = py::array_t<std::int8_t, py::array::c_style>;
  const char* const expected = "states: must be an array of whole numbers";
  const py::array given = as_array(states, expected);
  if (given.dtype().kind() != 'i' && given.dtype().kind() != 'u') throw py::type_error(expected);
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
  const States narrow(py::object(given.attr("astype")("int8")));
  const DoubleArray corner = as_doubles(lower, "lower");
  if (corner.ndim() != 1 || corner.shape(0) != dim)
    throw py::value_error("lower has shape " + shape_text(corner) + ": must be (" + std::to_string(dim) +
                          ",)");
  return dim == 2 ? map_of_grid<2>(narrow, corner, cell_size, refinement)
                  : map_of_grid<3>(narrow, corner, cell_size, refinement);
}

}  // namespace

void bind_loading(py::module_& module) {
  module.def("load", &load, "path"_a, doc::load);
  module.def(
      "from_bytes",
      [](const py::bytes& bytes) {
        std::unique_ptr<MapInterface> map;
        try {
          const Released released;
          map = map_from_bytes(std::string_view(bytes));
        } catch (const std::runtime_error& error) {
          throw std::invalid_argument(error.what());
        }
        return to_python(std::move(map));
      },
      "bytes"_a, doc::from_bytes);
  module.def("load_octomap", &load_octomap_file, "path"_a, py::kw_only(),
             "refinement"_a = EvidenceRefinement::kName, "max_memory"_a = 0.0, doc::load_octomap);
  module.def("from_grid", &map_from_grid, "states"_a, "lower"_a, "cell_size"_a, py::kw_only(),
             "refinement"_a = EvidenceRefinement::kName, doc::from_grid);
}

}  // namespace ndtree::python
