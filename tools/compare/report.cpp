// SPDX-License-Identifier: BSD-3-Clause
#include "report.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <set>
#include <stdexcept>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/io/replaced_file.hpp"
#include "ndtree/version.hpp"

namespace ndtree {
namespace {

using Json = nlohmann::ordered_json;

template <class T>
Json nullable(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}
Json nullable(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

std::string processor() {
  std::ifstream file("/proc/cpuinfo");
  std::string line;
  while (std::getline(file, line))
    if (line.compare(0, 10, "model name") == 0) return line.substr(std::min(line.find(':') + 2, line.size()));
  return "unknown processor";
}

std::string compiler() {
#if defined(__clang__)
  return __VERSION__;
#elif defined(__GNUC__)
  return "GCC " __VERSION__;
#else
  return "unknown compiler";
#endif
}

Json parameters(const ComparisonOptions& options) {
  Json json;
  for_each_option(options.map, [&](const char* name, const double& value) { json[name] = value; });
  json["max_range"] = nullable(options.max_range);
  json["held_out"] = options.held_out;
  json["repeat"] = options.repeat;
  json["sample_spacing"] = options.truth.sample_spacing;
  json["sample_margin"] = options.truth.sample_margin;
  json["endpoint_radius"] = options.truth.endpoint_radius;
  json["cast_tolerance"] = options.truth.cast_tolerance;
  json["cast_overshoot"] = options.truth.cast_overshoot;
  json["probability_clip"] = options.truth.probability_clip;
  json["claims_samples"] = options.claims.samples;
  json["claims_spacings"] = options.claims.spacings;
  json["claims_tolerance"] = options.claims.tolerance;
  json["claims_margin"] = options.claims.margin;
  json["claims_middle"] = options.claims.middle;
  json["claims_seed"] = options.claims.seed;
  return json;
}

/// What for_each_figure() visits; null for what is none or infinite.
template <class Figures>
Json figures(const Figures& of) {
  Json json;
  for_each_figure(of, [&](const char* name, const auto& value) {
    if constexpr (std::is_integral_v<std::decay_t<decltype(value)>>)
      json[name] = value;
    else
      json[name] = nullable(value.value_or(HUGE_VAL));
  });
  return json;
}

Json map_entry(const MapResult& map, std::uint64_t beams) {
  const double seconds = median(map.seconds);
  Json json = {
      {"map", map.map},
      {"refinement", map.refinement},
      {"cells", map.cells},
      {"cells_pruned", nullable(map.cells_pruned)},
      {"leaves", map.leaves},
      {"nodes", map.nodes},
      {"updates", map.updates},
      {"splits", nullable(map.splits)},
      {"merges", nullable(map.merges)},
      {"seconds",
       {{"median", seconds},
        {"min", *std::min_element(map.seconds.begin(), map.seconds.end())},
        {"max", *std::max_element(map.seconds.begin(), map.seconds.end())},
        {"runs", map.seconds.size()}}},
      {"beams_per_second", nullable(static_cast<double>(beams) / seconds)},
      {"memory_bytes", map.memory_bytes},
      {"bytes_per_node", nullable(static_cast<double>(map.memory_bytes) / static_cast<double>(map.nodes))},
      {"resident_bytes", nullable(map.resident_bytes)},
      {"truth", figures(map.truth)},
      {"claims", figures(map.claims)}};
  if (!map.cells_pruned) json.erase("cells_pruned");
  json["cell_sizes"] = Json::array();
  for (const CellSizeCount& count : map.cell_sizes)
    json["cell_sizes"].push_back(
        {{"size", count.size}, {"observed", count.observed}, {"leaves", count.leaves}});
  return json;
}

Json ratio(const Json& a, const Json& b) {
  if (!a.is_number() || !b.is_number() || b.get<double>() == 0.0) return nullptr;
  return a.get<double>() / b.get<double>();
}

/// How much of `other` the adaptive map needs.
Json ratios(const Json& adaptive, const Json& other) {
  Json json;
  for (const char* const key : {"cells", "nodes", "updates"}) json[key] = ratio(adaptive[key], other[key]);
  json["seconds"] = ratio(adaptive["seconds"]["median"], other["seconds"]["median"]);
  json["memory_bytes"] = ratio(adaptive["memory_bytes"], other["memory_bytes"]);
  json["resident_bytes"] = ratio(adaptive["resident_bytes"], other["resident_bytes"]);
  if (other.contains("cells_pruned")) json["cells_pruned"] = ratio(adaptive["cells"], other["cells_pruned"]);
  return json;
}

Json all_ratios(const Json& maps) {
  Json json = Json::object();
  const auto adaptive =
      std::find_if(maps.begin(), maps.end(), [](const Json& map) { return map["map"] == "adaptive"; });
  if (adaptive == maps.end()) return json;
  for (const Json& map : maps) {
    if (map["map"] == "adaptive") continue;
    const Json of_map = ratios(*adaptive, map);
    if (map["map"] == "fixed")
      json.update(of_map);
    else
      json[map["map"].get<std::string>()] = of_map;
  }
  return json;
}

// Cells of the table. What is null prints as a dash.

std::string formatted(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string decimals(const Json& value, int digits, double scale = 1.0) {
  if (!value.is_number()) return "-";
  return formatted(("%." + std::to_string(digits) + "f").c_str(), value.get<double>() * scale);
}

/// With the digits that it takes, as 0.05 or 1.6.
std::string shortest(const Json& value) {
  return value.is_number() ? formatted("%g", value.get<double>()) : "-";
}

std::string count(const Json& value) {
  if (!value.is_number()) return "-";
  std::string text = std::to_string(value.get<std::uint64_t>());
  for (std::ptrdiff_t i = static_cast<std::ptrdiff_t>(text.size()) - 3; i > 0; i -= 3)
    text.insert(static_cast<std::size_t>(i), ",");
  return text;
}

std::string percent(const Json& part, int digits = 1) {
  return part.is_number() ? decimals(part, digits, 100.0) + " %" : "-";
}
std::string percent(const Json& part, const Json& whole) { return percent(ratio(part, whole), 2); }

/// A field of a CSV line; empty for null.
std::string csv_field(const Json& value) {
  if (value.is_null()) return "";
  if (!value.is_string()) return value.dump();
  std::string text = value.get<std::string>();
  for (std::size_t i = text.find('"'); i != std::string::npos; i = text.find('"', i + 2))
    text.insert(i, "\"");
  return "\"" + text + "\"";
}

class Table {
 public:
  /// A row with nothing but dashes is left out.
  void row(std::vector<std::string> cells) {
    if (!std::all_of(cells.begin() + 1, cells.end(), [](const std::string& cell) { return cell == "-"; }))
      rows_.push_back(std::move(cells));
  }

  /// The first column to the left, the others to the right.
  [[nodiscard]] std::string text() const {
    std::vector<std::size_t> widths;
    for (const auto& cells : rows_) {
      widths.resize(std::max(widths.size(), cells.size()));
      for (std::size_t i = 0; i < cells.size(); ++i) widths[i] = std::max(widths[i], cells[i].size());
    }
    std::string result;
    for (const auto& cells : rows_) {
      std::string line;
      for (std::size_t i = 0; i < cells.size(); ++i) {
        const std::string padding(widths[i] - cells[i].size(), ' ');
        line += i == 0 ? cells[i] + padding : "  " + padding + cells[i];
      }
      line.erase(line.find_last_not_of(' ') + 1);
      result += line + "\n";
    }
    return result;
  }

 private:
  std::vector<std::vector<std::string>> rows_;
};

std::string heading(const Json& json) {
  const Json& beams = json["beams"];
  return json["log"].get<std::string>() + ": " + std::to_string(json["dim"].get<int>()) +
         "-D, N = " + std::to_string(json["branching"].get<int>()) + "\n" + count(json["scans"]) +
         " scans, " + count(json["scans_mapped"]) +
         " of them mapped, the others held out\nbeams mapped: " + count(beams["returned"]) + " returned, " +
         count(beams["not_returned"]) + " not returned, " + count(beams["beyond_max_range"]) +
         " beyond max_range, " + count(beams["invalid"]) + " invalid\n";
}

void add_map_rows(const Json& maps, Table& table) {
  const auto row = [&](const std::string& name, const std::function<std::string(const Json&)>& cell) {
    std::vector<std::string> cells{name};
    for (const Json& map : maps) cells.push_back(cell(map));
    table.row(cells);
  };
  const auto row_of_truth = [&](const char* name, const char* part, const char* whole) {
    row(name, [=](const Json& map) { return percent(map["truth"][part], map["truth"][whole]); });
  };
  row("", [](const Json& map) { return map["map"].get<std::string>(); });
  row("cells (observed leaves)", [](const Json& map) { return count(map["cells"]); });
  row("  after prune()", [](const Json& map) { return count(map.value("cells_pruned", Json())); });
  row("leaves", [](const Json& map) { return count(map["leaves"]); });
  row("nodes", [](const Json& map) { return count(map["nodes"]); });
  row("cell updates", [](const Json& map) { return count(map["updates"]); });
  row("splits", [](const Json& map) { return count(map["splits"]); });
  row("merges", [](const Json& map) { return count(map["merges"]); });
  row("insertion, median [s]", [](const Json& map) { return decimals(map["seconds"]["median"], 3); });
  row("  fastest run [s]", [](const Json& map) { return decimals(map["seconds"]["min"], 3); });
  row("  slowest run [s]", [](const Json& map) { return decimals(map["seconds"]["max"], 3); });
  row("million beams a second", [](const Json& map) { return decimals(map["beams_per_second"], 3, 1e-6); });
  row("memory [MiB]", [](const Json& map) { return decimals(map["memory_bytes"], 2, 0x1p-20); });
  row("  bytes a node", [](const Json& map) { return decimals(map["bytes_per_node"], 1); });
  row("  resident [MiB]", [](const Json& map) { return decimals(map["resident_bytes"], 2, 0x1p-20); });
  row_of_truth("held out: free space free", "free", "samples");
  row_of_truth("  occupied", "occupied", "samples");
  row_of_truth("  unknown", "unknown", "samples");
  row_of_truth("end points at occupied", "endpoints_near", "endpoints");
  row("balanced accuracy", [](const Json& map) {
    const Json& accuracy = map["truth"]["balanced_accuracy"];
    return accuracy.is_number() ? decimals(accuracy, 2, 100.0) + " %" : "-";
  });
  row("log score [nats]", [](const Json& map) { return decimals(map["truth"]["log_score"], 4); });
  row_of_truth("ray casts right", "surfaces_within", "casts");
  row("  median error [m]", [](const Json& map) { return decimals(map["truth"]["surface_error"], 4); });
  row_of_truth("  to the cell, right", "casts_within", "casts");
  row("  median error [m]", [](const Json& map) { return decimals(map["truth"]["median_error"], 4); });
  row("free but unseen", [](const Json& map) { return percent(map["claims"]["free_unseen"]); });
  row("seen but unknown", [](const Json& map) { return percent(map["claims"]["seen_unknown"]); });
  row("wrong volume", [](const Json& map) { return percent(map["claims"]["wrong_volume"]); });
}

void add_size_rows(const Json& maps, Table& table) {
  std::set<double, std::greater<>> sizes;
  for (const Json& map : maps)
    for (const Json& entry : map["cell_sizes"])
      if (entry["observed"].get<std::uint64_t>() > 0) sizes.insert(entry["size"].get<double>());
  // Sizes that are equal but for rounding are one row.
  double last = HUGE_VAL;
  for (const double size : sizes) {
    if (size > last * (1.0 - 1e-9)) continue;
    last = size;
    std::vector<std::string> cells{"observed leaves of " + shortest(size) + " m"};
    for (const Json& map : maps) {
      Json observed;
      for (const Json& entry : map["cell_sizes"])
        if (std::abs(entry["size"].get<double>() / size - 1.0) < 1e-9) observed = entry["observed"];
      cells.push_back(count(observed));
    }
    table.row(cells);
  }
}

std::string ratio_table(const Json& json) {
  std::vector<std::pair<std::string, Json>> columns;
  for (const Json& map : json["maps"]) {
    const auto name = map["map"].get<std::string>();
    if (name == "fixed")
      columns.emplace_back(name, json["ratios"]);
    else if (json["ratios"].contains(name))
      columns.emplace_back(name, json["ratios"][name]);
  }
  if (json["ratios"].empty()) return "";
  Table table;
  const auto row = [&](const char* name, const char* key) {
    std::vector<std::string> cells{name};
    for (const auto& column : columns)
      cells.push_back(key == nullptr ? column.first : percent(column.second.value(key, Json())));
    table.row(cells);
  };
  row("adaptive as a share of", nullptr);
  row("cells", "cells");
  row("  after prune()", "cells_pruned");
  row("cell updates", "updates");
  row("insertion time", "seconds");
  row("memory", "memory_bytes");
  row("  resident", "resident_bytes");
  return "\n" + table.text();
}

std::string notes(const Json& json) {
  const auto text_of = [](const Json& value) { return value.get<std::string>(); };
  std::string text = "\n" + text_of(json["machine"]["processor"]) + ", " +
                     text_of(json["machine"]["compiler"]) +
                     "; timed runs of each map, alternating: " + count(json["parameters"]["repeat"]) +
                     "\nresident: growth of a process that builds this map alone\n";
  bool octomap = false;
  for (const Json& map : json["maps"]) {
    text += text_of(map["map"]) + ": " + text_of(map["refinement"]) + "\n";
    octomap = octomap || map.contains("cells_pruned");
  }
  if (octomap && json["dim"] == 2)
    text += "OctoMap holds a 2-D map as one layer of cells, which cannot be pruned\n";
  if (!kHaveOctomap) text += "built without OctoMap: no octomap columns\n";
  for (const auto& [name, value] : json["parameters"].items())
    text += name + " = " + (value.is_null() ? "unlimited" : shortest(value)) + "\n";
  return text;
}

}  // namespace

Json to_json(const Comparison& comparison) {
  const InsertReport& beams = comparison.beams;
  Json json = {{"log", comparison.log},
               {"dim", comparison.dim},
               {"branching", comparison.options.branching},
               {"scans", comparison.scans},
               {"scans_mapped", comparison.scans_mapped},
               {"beams",
                {{"returned", beams.returned},
                 {"not_returned", beams.not_returned},
                 {"beyond_max_range", beams.beyond_max_range},
                 {"invalid", beams.invalid}}},
               {"parameters", parameters(comparison.options)}};
  json["maps"] = Json::array();
  for (const MapResult& map : comparison.maps)
    json["maps"].push_back(map_entry(map, beams.beams - beams.invalid));
  json["ratios"] = all_ratios(json["maps"]);
  json["version"] = NDTREE_VERSION;
  json["machine"] = {
      {"processor", processor()}, {"threads", std::thread::hardware_concurrency()}, {"compiler", compiler()}};
  return json;
}

std::string to_text(const Json& json) {
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string to_table(const Json& json) {
  Table table;
  add_map_rows(json["maps"], table);
  add_size_rows(json["maps"], table);
  return heading(json) + "\n" + table.text() + ratio_table(json) + notes(json);
}

std::string to_csv(const Json& json) {
  std::string header;
  std::string lines;
  for (const Json& map : json["maps"]) {
    std::string line;
    const auto add = [&](const std::string& name, const Json& value) {
      if (lines.empty()) header += (header.empty() ? "" : ",") + name;
      line += (line.empty() ? "" : ",") + csv_field(value);
    };
    for (const char* const key : {"log", "dim", "branching", "scans", "scans_mapped"}) add(key, json[key]);
    for (const char* const key :
         {"map", "refinement", "cells", "cells_pruned", "leaves", "nodes", "updates", "splits", "merges",
          "beams_per_second", "memory_bytes", "bytes_per_node", "resident_bytes"})
      add(key, map.value(key, Json()));
    for (const auto& [key, value] : map["seconds"].items()) add("seconds_" + key, value);
    for (const auto& [key, value] : map["truth"].items()) add("truth_" + key, value);
    for (const auto& [key, value] : map["claims"].items()) add("claims_" + key, value);
    for (const auto& [key, value] : json["beams"].items()) add("beams_" + key, value);
    for (const auto& [key, value] : json["parameters"].items()) add("parameter_" + key, value);
    lines += line + "\n";
  }
  return header + "\n" + lines;
}

void check_writable(const std::string& path) {
  std::error_code error;
  const std::filesystem::path file(path);
  const std::filesystem::path folder = file.has_parent_path() ? file.parent_path() : ".";
  if (!std::filesystem::is_directory(folder, error))
    throw std::runtime_error(path + ": cannot be written: no folder " + folder.string());
  if (std::filesystem::is_directory(file, error))
    throw std::runtime_error(path + ": cannot be written: is a folder");
}

void write_report(const std::string& path, const std::string& text) {
  try {
    write_file(path, text);
  } catch (const std::filesystem::filesystem_error& error) {
    const auto* const refused = dynamic_cast<const FileError*>(&error);
    throw std::runtime_error(
        path + ": cannot be written: " + (refused != nullptr ? refused->reason() : error.code().message()));
  }
}

}  // namespace ndtree
