// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Tables that follow from options: of the same options there is one, as long as somebody holds it.
#pragma once

#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

namespace ndtree {

/// The table that was made for a key, or what `make()` returns, a shared pointer, if there is none. The same
/// for all threads.
template <class Table, class Key, class Make>
[[nodiscard]] std::shared_ptr<Table> shared_table(const Key& key, const Make& make) {
  static std::mutex mutex;
  static std::map<Key, std::weak_ptr<Table>> tables;
  const std::lock_guard<std::mutex> lock(mutex);
  for (auto one = tables.begin(); one != tables.end();)
    one = one->second.expired() ? tables.erase(one) : std::next(one);
  std::weak_ptr<Table>& known = tables[key];
  std::shared_ptr<Table> table = known.lock();
  if (!table) known = table = make();
  return table;
}

}  // namespace ndtree
