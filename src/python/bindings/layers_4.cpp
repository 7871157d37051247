// SPDX-License-Identifier: BSD-3-Clause
#include "layer_functions.hpp"

namespace ndtree::python {
template class MapLayers<2, 4>;
}  // namespace ndtree::python
