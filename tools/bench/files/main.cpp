// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Readers and writers of map files, timed beside OctoMap's own.
///
/// usage: ndtree-bench-files FILE.bt|FILE.ot ... [--repeat N]
///
/// A line a question: the median of the processor time [ms] of ours and of OctoMap's, in turns, with the
/// spread, megabytes of the file a second of each, and the checksum of what ours wrote. In memory, processor
/// time: neither disks nor other programs count.
#include <octomap/OcTree.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <exception>
#include <functional>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "ndtree/ndtree.hpp"

namespace {

using namespace ndtree;
using Map = AdaptiveMap<2, 3>;
using Task = std::function<void()>;

/// Processor time that a task takes [s].
double seconds_of(const Task& task) {
  const std::clock_t begin = std::clock();
  task();
  return static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
}
/// The checksum of a map's file, without its own.
std::uint32_t checksum_of(const Map& map) {
  const std::string bytes = to_bytes(map);
  return crc32(std::string_view(bytes).substr(0, bytes.size() - 4));
}

struct Times {
  std::vector<double> all;

  [[nodiscard]] double median() const { return all[all.size() / 2]; }
  void print(double megabytes) const {
    std::printf(" %9.1f (%.1f-%.1f) %7.0f", 1e3 * median(), 1e3 * all.front(), 1e3 * all.back(),
                megabytes / median());
  }
};

/// Times both in turns, and prints a line. @param bytes what ours has read or written. @param theirs may be
/// empty.
void compare(const char* name, int repeat, const std::string& bytes, const Task& ours, const Task& theirs) {
  Times of_ours, of_theirs;
  for (int i = 0; i < repeat; ++i) {
    of_ours.all.push_back(seconds_of(ours));
    if (theirs) of_theirs.all.push_back(seconds_of(theirs));
  }
  std::sort(of_ours.all.begin(), of_ours.all.end());
  std::sort(of_theirs.all.begin(), of_theirs.all.end());
  const double megabytes = 1e-6 * static_cast<double>(bytes.size());
  std::printf("%-12s %8.2f MB %08x", name, megabytes, crc32(bytes));
  of_ours.print(megabytes);
  if (theirs) {
    of_theirs.print(megabytes);
    std::printf(" %6.2f", of_ours.median() / of_theirs.median());
  }
  std::printf("\n");
}

std::unique_ptr<octomap::OcTree> octree_of(const std::string& bytes, bool is_binary) {
  std::istringstream in(bytes);
  if (!is_binary)
    return std::unique_ptr<octomap::OcTree>(
        dynamic_cast<octomap::OcTree*>(octomap::AbstractOcTree::read(in)));
  auto tree = std::make_unique<octomap::OcTree>(0.1);
  if (!tree->readBinary(in)) throw std::runtime_error("OctoMap cannot read it");
  return tree;
}

void run(const std::string& path, int repeat) {
  const std::string read = read_file(path);
  const Map map = octomap_from_bytes<Map>(read);
  const bool is_binary = octomap_format_of(path) == OctomapFormat::binary;
  const auto tree = octree_of(read, is_binary);
  std::printf("%s: %zu nodes; ms, MB/s; OctoMap: %zu nodes; ms, MB/s; ratio\n", path.c_str(),
              map.tree().num_nodes(), tree->size());

  std::string bt = octomap_bytes(map, OctomapFormat::binary);
  std::string ot = octomap_bytes(map, OctomapFormat::full);
  std::string coarse = octomap_bytes(map, OctomapFormat::full, 2.5 * map.options().min_cell_size);
  std::string ply = ply_bytes(map, [](const auto&) { return true; });
  std::string pgm = map_server_image(map).pgm();
  std::string file = to_bytes(map);
  std::printf("maps read: .bt %08x, .ot %08x\n", checksum_of(octomap_from_bytes<Map>(bt)),
              checksum_of(octomap_from_bytes<Map>(ot)));

  compare(
      "read .bt", repeat, bt, [&] { (void)octomap_from_bytes<Map>(bt); }, [&] { (void)octree_of(bt, true); });
  compare(
      "read .ot", repeat, ot, [&] { (void)octomap_from_bytes<Map>(ot); },
      [&] { (void)octree_of(ot, false); });
  compare(
      "write .bt", repeat, bt, [&] { (void)octomap_bytes(map, OctomapFormat::binary); },
      [&] {
        std::ostringstream out;
        tree->writeBinary(out);
      });
  compare(
      "write .ot", repeat, ot, [&] { (void)octomap_bytes(map, OctomapFormat::full); },
      [&] {
        std::ostringstream out;
        tree->write(out);
      });
  compare("coarser .ot", repeat, coarse,
          [&] { (void)octomap_bytes(map, OctomapFormat::full, 2.5 * map.options().min_cell_size); }, {});
  compare("write .ply", repeat, ply, [&] { (void)ply_bytes(map, [](const auto&) { return true; }); }, {});
  compare("write .pgm", repeat, pgm, [&] { (void)map_server_image(map); }, {});
  compare("write .ndt", repeat, file.substr(0, file.size() - 4), [&] { (void)to_bytes(map); }, {});
  compare("read .ndt", repeat, file, [&] { (void)from_bytes<Map>(file); }, {});

  GridGeometry<3> grid;  // 256 cells a side, about the middle of what is known.
  grid.cell_size = map.options().min_cell_size;
  grid.shape = {256, 256, 256};
  grid.lower = Vector<3>::Constant(-128 * grid.cell_size);
  std::vector<std::int8_t> states(grid.size());
  const auto state_of_cell = [](const auto& cell) { return static_cast<std::int8_t>(cell.state()); };
  to_grid(map, grid, state_of_cell, states.data());
  const std::string text(reinterpret_cast<const char*>(states.data()), states.size());
  compare("to_grid", repeat, text, [&] { to_grid(map, grid, state_of_cell, states.data()); }, {});
  std::printf("map of a grid: %08x\n", checksum_of(from_grid<Map>(states.data(), grid)));
  compare("from_grid", repeat, text, [&] { (void)from_grid<Map>(states.data(), grid); }, {});
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Readers and writers of map files, timed beside OctoMap's own.");
  std::vector<std::string> files;
  int repeat = 5;
  app.add_option("FILE", files, "OctoMap files")->required();
  app.add_option("--repeat", repeat, "Times that each is timed")->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  try {
    for (const std::string& file : files) run(file, repeat);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
