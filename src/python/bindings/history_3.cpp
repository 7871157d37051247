// SPDX-License-Identifier: BSD-3-Clause
#include "history_adapter.hpp"

namespace ndtree::python {
extern template std::unique_ptr<MapInterface> adapted(const AdaptiveMap<2, 3>&, const MapLayers<2, 3>&);
NDTREE_PYTHON_HISTORY(, 2, 3);
}  // namespace ndtree::python
