// SPDX-License-Identifier: BSD-3-Clause
#include "history_adapter.hpp"
#include "map_adapter.hpp"

namespace ndtree::python {
NDTREE_PYTHON_MAP(, 2, 3);
NDTREE_PYTHON_HISTORY(, 2, 3);
}  // namespace ndtree::python
