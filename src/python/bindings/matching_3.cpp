// SPDX-License-Identifier: BSD-3-Clause
#include "matching_functions.hpp"

namespace ndtree::python {
NDTREE_PYTHON_MATCHING(3);
}
