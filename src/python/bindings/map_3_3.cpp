// SPDX-License-Identifier: BSD-3-Clause
#include "map_adapter.hpp"

namespace ndtree::python {
NDTREE_PYTHON_MAP(, 3, 3);
}
