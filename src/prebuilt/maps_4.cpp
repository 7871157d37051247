// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/mapping/prebuilt.hpp"

namespace ndtree {
NDTREE_PREBUILT_MAPS(, 2, 4);
}
