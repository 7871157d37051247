// SPDX-License-Identifier: BSD-3-Clause
#include "maps.hpp"

namespace ndtree::fuzz {
NDTREE_FUZZ_KINDS(3, 2)
}
