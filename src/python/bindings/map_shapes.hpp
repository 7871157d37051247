// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps by branching and dimension, each compiled in a file of its own.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "map_interface.hpp"

namespace ndtree::python {

/// @param refinement a policy's kName.
template <int N, int D>
std::unique_ptr<MapInterface> make_map(std::string_view refinement, const MapOptions& options);
template <int N, int D>
std::unique_ptr<MapInterface> map_from_bytes(std::string_view bytes, const std::string& refinement);

/// Both for one shape: here, or, with `extern` as the prefix, elsewhere.
#define NDTREE_PYTHON_MAP(prefix, N, D)                                                              \
  prefix template std::unique_ptr<MapInterface> make_map<N, D>(std::string_view, const MapOptions&); \
  prefix template std::unique_ptr<MapInterface> map_from_bytes<N, D>(std::string_view, const std::string&)

}  // namespace ndtree::python
