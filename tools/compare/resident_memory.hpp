// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How much resident memory a process needs to make one thing, and nothing else.
#pragma once

#include <cstddef>
#include <optional>

#ifdef __linux__
#include <malloc.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#endif

namespace ndtree {

#ifdef __linux__
/// Resident memory of this process that belongs to no file [bytes]: resident less shared pages.
inline std::size_t resident_bytes() {
  std::ifstream statm("/proc/self/statm");
  std::size_t total = 0;
  std::size_t resident = 0;
  std::size_t shared = 0;
  statm >> total >> resident >> shared;
  return (resident - shared) * static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
}
#endif

/// Growth of resident memory while `make()` runs in a process of its own, with what it returns still held.
/// Call it before this process has made anything similar, so that freed memory does not hide the growth.
/// The kernel counts in batches: small growth is uncertain by some 100 kB.
/// @returns none if it cannot be measured: not on Linux, or `make` throws.
template <class Make>
std::optional<std::size_t> resident_growth(const Make& make) {
#ifdef __linux__
  int ends[2];
  if (pipe(ends) != 0) return std::nullopt;
  const pid_t child = fork();
  if (child == 0) {
    std::size_t growth = 0;
    try {
      malloc_trim(0);
      const std::size_t before = resident_bytes();
      const auto made = make();
      const std::size_t after = resident_bytes();
      growth = after > before ? after - before : 0;
    } catch (...) {
      _exit(1);
    }
    _exit(write(ends[1], &growth, sizeof growth) == sizeof growth ? 0 : 1);
  }
  close(ends[1]);
  std::size_t growth = 0;
  const bool known = child > 0 && read(ends[0], &growth, sizeof growth) == sizeof growth;
  close(ends[0]);
  int status = 0;
  if (child > 0) waitpid(child, &status, 0);
  if (known) return growth;
#else
  static_cast<void>(make);
#endif
  return std::nullopt;
}

}  // namespace ndtree
