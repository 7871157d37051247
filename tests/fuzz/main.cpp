// SPDX-License-Identifier: BSD-3-Clause
// Entry of all targets: the environment variable NDTREE_FUZZ names the one that runs. With clang, libFuzzer
// has the main function. Without it this one replays files and folders, and then changes what it has read at
// random for a time: -max_total_time=SECONDS, -seed=N.
#include <cstring>
#include <map>

#include "target.hpp"

namespace {

ndtree::fuzz::Target chosen_target() {
  using namespace ndtree::fuzz;  // NOLINT(google-build-using-namespace)
  static const std::map<std::string, Target> targets{
      {"insertion", insertion}, {"map_file", map_file}, {"octomap_file", octomap_file},
      {"carmen", carmen},       {"xyz", xyz},           {"npz", npz}};
  const char* const name = std::getenv("NDTREE_FUZZ");
  const auto found = targets.find(name == nullptr ? "" : name);
  if (found != targets.end()) return found->second;
  std::fputs("NDTREE_FUZZ must be one of:", stderr);
  for (const auto& [known, target] : targets) std::fprintf(stderr, " %s", known.c_str());
  std::fputs("\n", stderr);
  std::exit(2);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const ndtree::fuzz::Target target = chosen_target();
  target(ndtree::fuzz::Bytes(data, size));
  return 0;
}

#ifndef NDTREE_LIBFUZZER
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

namespace {

using Input = std::vector<std::uint8_t>;

Input read(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// One input made of others: bytes set, cut, copied, joined.
Input changed(const std::vector<Input>& inputs, std::mt19937_64& random) {
  const auto below = [&](std::size_t n) { return n == 0 ? std::size_t{0} : random() % n; };
  Input input = inputs.empty() ? Input{} : inputs[below(inputs.size())];
  for (std::size_t changes = 1 + below(8); changes > 0; --changes) {
    const std::size_t at = below(input.size());
    const std::size_t length = below(std::min<std::size_t>(input.size() - at, 32) + 1);
    const auto first = input.begin() + static_cast<std::ptrdiff_t>(at);
    const auto last = first + static_cast<std::ptrdiff_t>(length);
    switch (below(6)) {
      case 0:
        if (!input.empty()) input[at] = static_cast<std::uint8_t>(random());
        break;
      case 1:
        if (!input.empty()) input[at] = static_cast<std::uint8_t>(input[at] ^ (1u << below(8)));
        break;
      case 2:
        input.erase(first, last);
        break;
      case 3: {
        const Input part(first, last);
        input.insert(input.begin() + static_cast<std::ptrdiff_t>(below(input.size() + 1)), part.begin(),
                     part.end());
        break;
      }
      case 4:
        for (std::size_t n = below(16); n > 0; --n)
          input.insert(input.begin() + static_cast<std::ptrdiff_t>(at), static_cast<std::uint8_t>(random()));
        break;
      default:
        if (!inputs.empty()) {
          const Input& other = inputs[below(inputs.size())];
          const auto from = other.begin() + static_cast<std::ptrdiff_t>(below(other.size()));
          input.resize(at);
          input.insert(input.end(), from, other.end());
        }
    }
  }
  if (input.size() > 4096) input.resize(4096);
  return input;
}

}  // namespace

int main(int argc, char** argv) {
  double seconds = 0.0;
  std::uint64_t seed = 1;
  std::vector<Input> inputs;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument.rfind("-max_total_time=", 0) == 0)
      seconds = std::atof(argument.c_str() + 16);
    else if (argument.rfind("-seed=", 0) == 0)
      seed = std::strtoull(argument.c_str() + 6, nullptr, 10);
    else if (argument[0] == '-')
      continue;  // One of libFuzzer's own.
    else if (!std::filesystem::is_directory(argument))
      inputs.push_back(read(argument));
    else
      for (const auto& entry : std::filesystem::directory_iterator(argument))
        if (entry.is_regular_file()) inputs.push_back(read(entry.path()));
  }
  for (const Input& input : inputs) LLVMFuzzerTestOneInput(input.data(), input.size());
  std::mt19937_64 random(seed);
  const auto start = std::chrono::steady_clock::now();
  const auto elapsed = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  std::size_t runs = inputs.size();
  for (; elapsed() < seconds; ++runs) {
    const Input input = changed(inputs, random);
    const char* const keep =
        std::getenv("NDTREE_FUZZ_KEEP");  // What is being tried, to find it after a crash.
    if (keep != nullptr) {
      std::ofstream out(keep, std::ios::binary);
      out.write(reinterpret_cast<const char*>(input.data()), static_cast<std::streamsize>(input.size()));
    }
    LLVMFuzzerTestOneInput(input.data(), input.size());
  }
  std::printf("Done %zu runs in %.0f second(s)\n", runs, elapsed());
}
#endif
