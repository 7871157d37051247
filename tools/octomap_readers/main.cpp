// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Reads an OctoMap file with ndtree's reader or with OctoMap's own, for tools/octomap-damaged.
///
/// usage: ndtree-octomap-readers (ndtree | octomap) FILE
///
/// Exit status: 0 the file was read, 1 it was refused, 2 the call is wrong.
#include <octomap/AbstractOcTree.h>
#include <octomap/OcTree.h>

#include <cstdio>
#include <exception>
#include <memory>
#include <string>

#include "ndtree/io/octomap_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"

namespace {

bool ndtree_reads(const std::string& path) {
  const auto map = ndtree::load_octomap<ndtree::AdaptiveMap<2, 3>>(path);
  map.check_invariants();
  return true;
}

bool octomap_reads(const std::string& path) {
  if (path.size() > 3 && path.substr(path.size() - 3) == ".bt") {
    octomap::OcTree tree(0.1);
    return tree.readBinary(path) && tree.size() > 0;
  }
  const std::unique_ptr<octomap::AbstractOcTree> tree(octomap::AbstractOcTree::read(path));
  return tree != nullptr;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string reader = argc == 3 ? argv[1] : "";
  if (reader != "ndtree" && reader != "octomap") {
    std::fputs("usage: ndtree-octomap-readers (ndtree | octomap) FILE\n", stderr);
    return 2;
  }
  try {
    return (reader == "ndtree" ? ndtree_reads(argv[2]) : octomap_reads(argv[2])) ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
