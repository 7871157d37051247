// SPDX-License-Identifier: BSD-3-Clause
#include "layer_functions.hpp"

namespace ndtree::python {
template class MapLayers<2, 2>;
template class MapLayers<3, 2>;
template class MapLayers<4, 2>;
}  // namespace ndtree::python
