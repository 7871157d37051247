// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// ndtree-compare: one log into several maps, and what each of them costs and is worth.

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstddef>
#include <exception>
#include <iostream>
#include <limits>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "comparison.hpp"
#include "log_input.hpp"
#include "ndtree/version.hpp"
#include "report.hpp"

namespace {

constexpr int kDone = 0;
constexpr int kBadInput = 1;
constexpr int kWrongCall = 2;

/// What the command line says.
struct Call {
  std::string log;
  std::string world;
  std::optional<int> dim;
  std::size_t limit = std::numeric_limits<std::size_t>::max();
  std::string no_return = "auto";
  std::string maps = ndtree::kHaveOctomap ? "adaptive,fixed,octomap" : "adaptive,fixed";
  std::string json;
  std::string csv;
  ndtree::ComparisonOptions options;
};

std::string flag(std::string name) {
  std::replace(name.begin(), name.end(), '_', '-');
  return "--" + name;
}

void declare(CLI::App& app, Call& call) {
  app.add_option("LOG", call.log,
                 "CARMEN log or plain text, also gzipped, or .npz; recognised by its content");
  app.add_option("--world", call.world, "simulated log instead: office, apartment or street")
      ->check(CLI::IsMember({"office", "apartment", "street"}));
  app.add_option("--dim", call.dim, "2 or 3; by default the log's own")->check(CLI::IsMember({2, 3}));
  app.add_option("--limit", call.limit, "use only the first scans of the log")
      ->check(CLI::PositiveNumber)
      ->type_name("SCANS");
  app.add_option("--maps", call.maps,
                 "adaptive, paper, fixed, octomap, octomap-scan, octomap-scan-lazy, octomap-scan-discretized")
      ->capture_default_str();
  app.add_option("--branching", call.options.branching, "children per axis of a node of our maps: 2, 3 or 4")
      ->capture_default_str();
  app.add_option("--max-range", call.options.max_range,
                 "longer beams say only that the space up to there is free [m]; by default unlimited");
  app.add_option("--no-return", call.no_return,
                 "what a beam without return says: free, up to its end point; or ignore, nothing; auto: the "
                 "log decides")
      ->check(CLI::IsMember({"auto", "free", "ignore"}))
      ->capture_default_str();
  app.add_option("--held-out", call.options.held_out,
                 "every K-th scan is not mapped but tests the maps; 0: none")
      ->check(CLI::NonNegativeNumber)
      ->type_name("K")
      ->capture_default_str();
  app.add_option("--repeat", call.options.repeat, "timed runs of each map, alternating")
      ->capture_default_str();
  for (const ndtree::OptionRow& row : ndtree::kOptionTable) {
    CLI::Option* const option =
        app.add_option(flag(row.name), call.options.map.*row.member, std::string(row.help) + row.bounds.unit)
            ->capture_default_str();
    if (row.is_constant()) option->group("");  // Hidden: for trials.
  }
  app.add_option("--json", call.json, "write all figures to this file")->type_name("FILE");
  app.add_option("--csv", call.csv, "write a line for each map to this file")->type_name("FILE");
  app.set_version_flag("--version", NDTREE_VERSION);
  app.footer(
      "Examples:\n"
      "  ndtree-compare intel.log.gz --max-range 20 --no-return ignore\n"
      "  ndtree-compare --world office --repeat 1\n"
      "  ndtree-compare kinect.npz --range-sigma 0.005 --range-sigma-quadratic 0.0015 --json kinect.json\n"
      "  ndtree-compare street.npz --branching 3 --min-cell-size 0.1 --maps adaptive,octomap,octomap-scan\n"
      "\n"
      "Exit status: 0 done, 1 the input is bad, 2 the call is wrong.");
}

std::vector<std::string> split_at_commas(const std::string& text) {
  std::vector<std::string> parts;
  std::istringstream in(text);
  for (std::string name; std::getline(in, name, ',');) parts.push_back(name);
  return parts;
}

/// @throws std::invalid_argument naming what is wrong.
void check(Call& call) {
  if (call.log.empty() == call.world.empty())
    throw std::invalid_argument("expected either a LOG or --world; see --help");
  call.options.maps = split_at_commas(call.maps);
  call.options.validate();
  for (const std::string& file : {call.json, call.csv})
    if (!file.empty() && file == call.log) throw std::invalid_argument(file + ": would overwrite the log");
}

/// On one line of the terminal, if there is one.
void show_progress(const std::string& what, double done) {
  static const bool is_terminal = isatty(STDERR_FILENO) == 1;
  if (!is_terminal) return;
  std::cerr << "\r\033[K" << what;
  if (!what.empty()) std::cerr << " (" << static_cast<int>(100.0 * done) << " %)";
  std::cerr << std::flush;
}

void run(const Call& call) {
  for (const std::string& file : {call.json, call.csv})
    if (!file.empty()) ndtree::check_writable(file);
  show_progress("reading", 0.0);
  ndtree::Log log = call.world.empty() ? ndtree::read_log(call.log, call.dim, call.limit)
                                       : ndtree::simulate_log(call.world, call.dim, call.limit);
  std::string no_return = call.no_return, why;
  if (no_return == "auto") {
    const ndtree::NoReturns found = ndtree::judge_no_returns(log);
    no_return = found.choice();
    if (found.share != 0.0) why = found.to_text() + "\n";
  }
  if (no_return == "ignore") ndtree::keep_returned(log);
  auto report = ndtree::to_json(ndtree::compare(log, call.options, show_progress));
  report["parameters"]["no_return"] = no_return;
  show_progress("", 1.0);
  if (!call.json.empty()) ndtree::write_report(call.json, ndtree::to_text(report));
  if (!call.csv.empty()) ndtree::write_report(call.csv, ndtree::to_csv(report));
  std::cout << why << ndtree::to_table(report) << std::flush;
}

/// One line of printable characters, whatever a log holds.
int complain(const char* what, int status) {
  show_progress("", 1.0);
  std::string line(what);
  for (char& c : line)
    if (static_cast<unsigned char>(c) < 32 || c == 127) c = '?';
  std::cerr << "ndtree-compare: " << line << "\n";
  return status;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Maps one log with cells that adapt, with cells of one size, and with OctoMap, and compares them.",
      "ndtree-compare");
  Call call;
  try {
    declare(app, call);
    app.parse(argc, argv);
    check(call);
  } catch (const CLI::Success& asked) {
    return app.exit(asked);
  } catch (const std::exception& error) {
    return complain(error.what(), kWrongCall);
  }
  try {
    run(call);
  } catch (const std::exception& error) {
    return complain(error.what(), kBadInput);
  }
  return std::cout ? kDone : complain("standard output cannot be written", kBadInput);
}
