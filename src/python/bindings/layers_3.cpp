// SPDX-License-Identifier: BSD-3-Clause
#include "layer_functions.hpp"

namespace ndtree::python {
template class MapLayers<2, 3>;
template class MapLayers<3, 3>;
template class MapLayers<4, 3>;
}  // namespace ndtree::python
