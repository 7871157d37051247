// SPDX-License-Identifier: BSD-3-Clause
#include "map_adapter.hpp"

namespace ndtree::python {
NDTREE_PYTHON_MAP(, 2, 2);
template std::unique_ptr<MapInterface> adapted(const AdaptiveMap<2, 2>&, const MapLayers<2, 2>&);
}  // namespace ndtree::python
