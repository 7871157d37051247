// SPDX-License-Identifier: BSD-3-Clause
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>

#include "map_shapes.hpp"
#include "ndtree/io/map_file.hpp"

namespace ndtree::python {

NDTREE_PYTHON_MAP(extern, 2, 2);
NDTREE_PYTHON_MAP(extern, 3, 2);
NDTREE_PYTHON_MAP(extern, 4, 2);
NDTREE_PYTHON_MAP(extern, 2, 3);
NDTREE_PYTHON_MAP(extern, 3, 3);
NDTREE_PYTHON_MAP(extern, 4, 3);
NDTREE_PYTHON_MAP(extern, 2, 4);

namespace {

struct Instantiation {
  int branching;
  int dim;
  std::unique_ptr<MapInterface> (*make)(std::string_view, const MapOptions&);
  std::unique_ptr<MapInterface> (*read)(std::string_view, const std::string&);
};

template <int N, int D>
constexpr Instantiation instantiation() {
  return {N, D, &make_map<N, D>, &map_from_bytes<N, D>};
}

const Instantiation& find(int branching, int dim) {
  static constexpr Instantiation all[] = {instantiation<2, 2>(), instantiation<3, 2>(), instantiation<4, 2>(),
                                          instantiation<2, 3>(), instantiation<3, 3>(), instantiation<4, 3>(),
                                          instantiation<2, 4>()};
  for (const Instantiation& one : all)
    if (one.branching == branching && one.dim == dim) return one;
  throw OptionError("branching", std::to_string(branching) + ", dim = " + std::to_string(dim),
                    "branching 2, 3 or 4 with dim 2 or 3, or branching 2 with dim 4; C++ has all others");
}

}  // namespace

std::unique_ptr<MapInterface> make_map(std::string_view refinement, int branching, int dim,
                                       const MapOptions& options) {
  return find(branching, dim).make(refinement, options);
}

std::unique_ptr<MapInterface> map_from_bytes(std::string_view bytes) {
  const MapFileHeader header = map_file_header(bytes);
  const Instantiation* one = nullptr;
  try {
    one = &find(header.branching, header.dim);
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(std::string("holds a map that this module has no type for: ") + error.what());
  }
  return one->read(bytes, header.refinement);
}

}  // namespace ndtree::python
