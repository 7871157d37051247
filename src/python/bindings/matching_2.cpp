// SPDX-License-Identifier: BSD-3-Clause
#include <vector>

#include "matching_functions.hpp"
#include "ndtree/alignment/pose_graph.hpp"

namespace ndtree::python {

NDTREE_PYTHON_MATCHING(2);

PoseGraphReport solve_graph(std::vector<XyYaw>& poses, const std::vector<PoseRelation>& relations,
                            int iterations) {
  return solve(poses, relations, iterations);
}

}  // namespace ndtree::python
