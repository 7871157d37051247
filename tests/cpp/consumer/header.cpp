// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Finds and compiles the headers, without what takes a compiler long: for trying many versions of CMake.
#include <ndtree/ndtree.hpp>

int main() { return ndtree::MapOptions{}.min_cell_size > 0.0 ? 0 : 1; }
