// SPDX-License-Identifier: BSD-3-Clause
// All branchings together: much of a scan does not depend on them.
#include "ndtree/mapping/prebuilt.hpp"

namespace ndtree {
NDTREE_PREBUILT_MAPS(, 2, 2);
NDTREE_PREBUILT_MAPS(, 3, 2);
NDTREE_PREBUILT_MAPS(, 4, 2);
}  // namespace ndtree
