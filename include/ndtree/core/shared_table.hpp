// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Tables that follow from options: those who ask with the same options share one.
#pragma once

#include <iterator>
#include <map>
#include <memory>
#include <mutex>

namespace ndtree {

/// The table that was made for a key, or what `make()` returns, a shared pointer, if there is none. The same
/// for all threads. The last that was made stays, so that maps that come and go need not make it each time.
/// @tparam Make of one kind of table; each has tables of its own.
template <class Table, class Key, class Make>
[[nodiscard]] std::shared_ptr<Table> shared_table(const Key& key, const Make& make) {
  static std::mutex mutex;
  static std::map<Key, std::weak_ptr<Table>> tables;
  static std::shared_ptr<Table> last;
  const std::lock_guard<std::mutex> lock(mutex);
  for (auto one = tables.begin(); one != tables.end();)
    one = one->second.expired() ? tables.erase(one) : std::next(one);
  std::weak_ptr<Table>& known = tables[key];
  std::shared_ptr<Table> table = known.lock();
  if (!table) known = last = table = make();
  return table;
}

}  // namespace ndtree
