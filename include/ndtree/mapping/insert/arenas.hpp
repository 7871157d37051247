// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Storage of nodes for several threads that change one tree.
#pragma once

#include <cstddef>
#include <vector>

#include "ndtree/core/cache_lines.hpp"

namespace ndtree {

/// Arenas of nodes, one for each worker; the tree takes them back when this ends, also by an exception.
template <class Tree>
class Arenas {
 public:
  struct alignas(kCacheLines) Lent {
    typename Tree::Arena arena;
  };

  Arenas(Tree& tree, std::size_t count) : tree_(tree), arenas_(count) {
    for (Lent& lent : arenas_) tree_.lend(lent.arena);
  }
  Arenas(const Arenas&) = delete;
  Arenas& operator=(const Arenas&) = delete;
  ~Arenas() {
    for (Lent& lent : arenas_) tree_.absorb(lent.arena);
  }
  [[nodiscard]] std::vector<Lent>& all() { return arenas_; }

 private:
  Tree& tree_;
  std::vector<Lent> arenas_;
};

}  // namespace ndtree
