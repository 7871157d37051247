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
#include "ndtree/core/memory.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/dense_grid.hpp"
#include "ndtree/io/layer_file.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// Makes a map of any of the refinements with two children along each axis: `make(type)` gives that map's
/// bytes.
template <int D, class Make>
std::unique_ptr<MapInterface> made(const std::string& refinement, const Make& make) {
  if (refinement == FixedRefinement::kName)
    return map_from_bytes(make(static_cast<FixedMap<2, D>*>(nullptr)));
  if (refinement == PaperRefinement::kName)
    return map_from_bytes(make(static_cast<PaperMap<2, D>*>(nullptr)));
  if (refinement == EvidenceRefinement::kName)
    return map_from_bytes(make(static_cast<AdaptiveMap<2, D>*>(nullptr)));
  throw std::invalid_argument("refinement = '" + refinement + "': must be 'evidence', 'paper' or 'fixed'");
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
    return to_bytes(map, layers);
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
      return to_bytes(from_grid<std::remove_pointer_t<decltype(type)>>(data, grid));
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
  module.def("load", &load, "path"_a,
             R"(Read a map that save() wrote, or an OctoMap file, .bt or .ot; the content says what it is.

Parameters
----------
path : str or os.PathLike

Returns
-------
AdaptiveMap or FixedMap
    Of an OctoMap file as load_octomap() gives it, which takes options, too.

Raises
------
OSError
    The file cannot be read.
ValueError
    It is no such file, truncated, damaged, or of another version.
)");
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
      "bytes"_a, "The map that to_bytes() wrote; ValueError as load().");
  module.def("load_octomap", &load_octomap_file, "path"_a, py::kw_only(),
             "refinement"_a = EvidenceRefinement::kName, "max_memory"_a = 0.0,
             R"(Read an OctoMap file, .bt or .ot, into a map.

Cells have the borders and states of the file's leaves. Log-odds are the file's with refinement "paper" and
"fixed". With "evidence" a cell gets the least evidence that gives its log-odds, which is met within 0.008 from
-4.6 to 5.9, and is the nearer bound outside. Leaves of a .bt file get the map's log_odds_min or log_odds_max.
Colours of a ColorOcTree's .ot become the layer 'color' of the rule 'mean3', red, green and blue from 0 to 255.

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
