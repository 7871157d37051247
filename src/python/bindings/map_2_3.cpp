// SPDX-License-Identifier: BSD-3-Clause
#include "map_adapter.hpp"

namespace ndtree::python {
NDTREE_PYTHON_MAP(, 2, 3);
template std::unique_ptr<MapInterface> adapted(const AdaptiveMap<2, 3>&, const MapLayers<2, 3>&);
}  // namespace ndtree::python
