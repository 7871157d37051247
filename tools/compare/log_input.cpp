// SPDX-License-Identifier: BSD-3-Clause
#include "log_input.hpp"

#include <zlib.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>
#include <sstream>
#include <string_view>
#include <utility>

#include "ndtree/core/types.hpp"
#include "ndtree/logs/carmen.hpp"
#include "ndtree/logs/xyz.hpp"
#include "npz.hpp"

namespace ndtree {
namespace {

using Scans = decltype(Log::scans);

constexpr const char* kFormats = "expected a CARMEN log, lines of 4 to 7 numbers, or an .npz";

/// All bytes of a file, unpacked if it is gzipped.
std::string read_file(const std::string& path) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) throw std::runtime_error("no such file: " + std::string(kFormats));
  if (std::filesystem::is_directory(status))
    throw std::runtime_error("is a folder: " + std::string(kFormats));

  errno = 0;
  const std::unique_ptr<gzFile_s, int (*)(gzFile)> file(gzopen(path.c_str(), "rb"), gzclose_r);
  if (!file)
    throw std::runtime_error("cannot be opened: " + std::string(errno ? std::strerror(errno) : "no memory"));
  std::string bytes;
  constexpr unsigned kChunk = 1 << 20;
  int count = 1;
  while (count > 0) {
    const std::size_t begin = bytes.size();
    bytes.resize(begin + kChunk);
    count = gzread(file.get(), bytes.data() + begin, kChunk);
    bytes.resize(begin + static_cast<std::size_t>(std::max(count, 0)));
  }
  int code = Z_OK;
  const char* const message = gzerror(file.get(), &code);
  if (code == Z_ERRNO) throw std::runtime_error("cannot be read: " + std::string(std::strerror(errno)));
  if (code != Z_OK && code != Z_STREAM_END)
    throw std::runtime_error(
        "damaged gzip behind byte " + std::to_string(bytes.size()) +
        " of its content: " + (code == Z_BUF_ERROR ? "expected more, it is cut off" : message));
  if (bytes.empty()) throw std::runtime_error("empty: " + std::string(kFormats));
  return bytes;
}

bool looks_binary(std::string_view bytes) {
  bytes = bytes.substr(0, 4096);
  return std::any_of(bytes.begin(), bytes.end(), [](char c) {
    const auto code = static_cast<unsigned char>(c);
    return code < 9 || (code > 13 && code < 32);
  });
}

/// Whether the first line that is not blank or a comment starts with a word, as CARMEN's records do.
bool looks_like_carmen(const std::string& text) {
  std::istringstream in(text.substr(0, 3) == "\xEF\xBB\xBF" ? text.substr(3) : text);
  std::string line;
  while (std::getline(in, line)) {
    const std::size_t first = line.find_first_not_of(" \t\r");
    if (first != std::string::npos && line[first] != '#')
      return std::isalpha(static_cast<unsigned char>(line[first])) != 0;
  }
  return false;
}

std::vector<Scan<2>> carmen_scans(const std::string& text, std::size_t limit) {
  std::istringstream in(text);
  CarmenParser parser;
  std::vector<Scan<2>> scans;
  std::string line;
  while (scans.size() < limit && std::getline(in, line))
    if (std::optional<Scan<2>> scan = parser.parse_line(line)) scans.push_back(std::move(*scan));
  if (scans.empty())
    throw std::runtime_error("no FLASER or ROBOTLASER1 record in " + std::to_string(parser.line_number()) +
                             " lines: " + kFormats);
  return scans;
}

template <int D>
std::vector<Scan<D>> xyz_scans(std::istream& in, std::size_t limit) {
  XyzParser<D> parser;
  std::vector<Scan<D>> scans;
  std::string line;
  while (scans.size() < limit && std::getline(in, line))
    if (std::optional<Scan<D>> scan = parser.parse_line(line)) scans.push_back(std::move(*scan));
  if (scans.size() < limit)
    if (std::optional<Scan<D>> scan = parser.finish()) scans.push_back(std::move(*scan));
  return scans;
}

Scans text_scans(const std::string& text, std::size_t limit) {
  if (looks_binary(text)) throw std::runtime_error("neither text nor a zip: " + std::string(kFormats));
  if (looks_like_carmen(text)) return carmen_scans(text, limit);
  std::istringstream in(text);
  if (xyz_dimension(in) == 2) return xyz_scans<2>(in, limit);
  return xyz_scans<3>(in, limit);
}

/// Checks the shapes against each other. @throws std::runtime_error naming array, shape and expectation.
void check_arrays(const std::map<std::string, NpyArray>& arrays) {
  const auto find = [&](const char* name, const char* expected) -> const NpyArray& {
    const auto found = arrays.find(name);
    if (found == arrays.end())
      throw std::runtime_error("no array '" + std::string(name) + "': expected " + expected);
    return found->second;
  };
  const auto require = [](bool valid, const char* name, const NpyArray& array, const std::string& expected) {
    if (!valid)
      throw std::runtime_error(std::string(name) + ": " + array.description() + ", expected " + expected);
  };
  const NpyArray& origins = find("origins", "one sensor position a scan");
  const NpyArray& points = find("points", "the end points of all scans");
  const NpyArray& offsets = find("offsets", "where each scan begins in points, and the end");
  const std::size_t d = origins.columns();
  require(origins.shape.size() == 2 && (d == 2 || d == 3) && origins.kind == 'f', "origins", origins,
          "floats of shape (scans, 2) or (scans, 3)");
  require(points.shape.size() == 2 && points.columns() == d && points.kind == 'f', "points", points,
          "floats of shape (beams, " + std::to_string(d) + ") as in origins");
  require(offsets.shape.size() == 1 && offsets.rows() == origins.rows() + 1 &&
              (offsets.kind == 'i' || offsets.kind == 'u'),
          "offsets", offsets, std::to_string(origins.rows() + 1) + " whole numbers, one more than origins");
  const auto no_return = arrays.find("no_return");
  if (no_return != arrays.end())
    require(no_return->second.shape.size() == 1 && no_return->second.rows() == points.rows() &&
                no_return->second.kind == 'b',
            "no_return", no_return->second,
            "bools of shape (" + std::to_string(points.rows()) + ",), one flag a point");
  for (std::size_t i = 0; i < offsets.rows(); ++i) {
    const double least = i == 0 ? 0.0 : offsets.at(i - 1);
    const auto end = static_cast<double>(points.rows());
    const double value = offsets.at(i);
    if (value < least || value > end || (i == 0 && value != 0.0) || (i + 1 == offsets.rows() && value != end))
      throw std::runtime_error(
          "offsets[" + std::to_string(i) + "] = " + std::to_string(static_cast<std::int64_t>(value)) +
          ": expected them to rise from 0 to " + std::to_string(points.rows()) + ", the number of points");
  }
}

/// Whether all z of an array are the same, leaving out those that are not a number; a 2-D array has none.
bool is_planar(const NpyArray& array) {
  if (array.columns() == 2) return true;
  std::optional<double> height;
  for (std::size_t i = 0; i < array.rows(); ++i) {
    const double z = array.at(i, 2);
    if (std::isnan(z)) continue;
    if (height.value_or(z) != z) return false;
    height = z;
  }
  return true;
}

template <int D>
std::vector<Scan<D>> npz_scans(const std::map<std::string, NpyArray>& arrays, std::size_t limit) {
  const NpyArray& origins = arrays.at("origins");
  const NpyArray& points = arrays.at("points");
  const NpyArray& offsets = arrays.at("offsets");
  const auto no_return = arrays.find("no_return");
  std::vector<Scan<D>> scans(std::min(origins.rows(), limit));
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const auto begin = static_cast<std::size_t>(offsets.at(i));
    const auto n = static_cast<Eigen::Index>(offsets.at(i + 1)) - static_cast<Eigen::Index>(begin);
    Scan<D>& scan = scans[i];
    scan.origins.resize(D, 1);
    scan.endpoints.resize(D, n);
    scan.returned.setConstant(n, true);
    for (int a = 0; a < D; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      scan.origins(a, 0) = origins.at(i, axis);
      for (Eigen::Index k = 0; k < n; ++k)
        scan.endpoints(a, k) = points.at(begin + static_cast<std::size_t>(k), axis);
    }
    if (no_return == arrays.end()) continue;
    for (Eigen::Index k = 0; k < n; ++k)
      scan.returned[k] = no_return->second.at(begin + static_cast<std::size_t>(k)) == 0.0;
  }
  return scans;
}

Scans npz_scans(std::string_view bytes, std::size_t limit) {
  const std::map<std::string, NpyArray> arrays =
      read_npz(bytes, {"origins", "points", "offsets", "no_return"});
  check_arrays(arrays);
  if (arrays.at("origins").rows() == 0) throw std::runtime_error("origins: no scans");
  if (is_planar(arrays.at("origins")) && is_planar(arrays.at("points"))) return npz_scans<2>(arrays, limit);
  return npz_scans<3>(arrays, limit);
}

std::vector<Scan<3>> lifted(const std::vector<Scan<2>>& flat) {
  std::vector<Scan<3>> scans(flat.size());
  const auto lift = [](const Points<2>& points) {
    Points<3> result = Points<3>::Zero(3, points.cols());
    result.topRows<2>() = points;
    return result;
  };
  for (std::size_t i = 0; i < flat.size(); ++i)
    scans[i] = {lift(flat[i].endpoints), lift(flat[i].origins), flat[i].returned, flat[i].stamp,
                flat[i].range_sigma};
  return scans;
}

/// @throws std::runtime_error if z is not the same everywhere.
std::vector<Scan<2>> flattened(const std::vector<Scan<3>>& solid) {
  std::vector<Scan<2>> scans(solid.size());
  std::optional<double> height;
  const auto flatten = [&](const Points<3>& points, std::size_t i) {
    for (Eigen::Index k = 0; k < points.cols(); ++k) {
      const double z = points(2, k);
      if (!std::isfinite(z)) continue;
      if (height.value_or(z) != z)
        throw std::runtime_error("scan " + std::to_string(i) + ": z = " + std::to_string(z) +
                                 " m: expected " + std::to_string(*height) + " m as before, for --dim 2");
      height = z;
    }
    return Points<2>(points.topRows<2>());
  };
  for (std::size_t i = 0; i < solid.size(); ++i)
    scans[i] = {flatten(solid[i].endpoints, i), flatten(solid[i].origins, i), solid[i].returned,
                solid[i].stamp, solid[i].range_sigma};
  return scans;
}

void change_dimension(Scans& scans, std::optional<int> dim) {
  if (dim == 3 && scans.index() == 0) scans = lifted(std::get<0>(scans));
  if (dim == 2 && scans.index() == 1) scans = flattened(std::get<1>(scans));
}

template <int D>
void take(SimulatedLog<D> simulation, std::size_t limit, Log& log) {
  std::vector<Scan<D>> scans;
  for (std::size_t i = 0; i < std::min(simulation.size(), limit); ++i) scans.push_back(simulation.scan(i));
  log.scans = std::move(scans);
  log.simulation = std::move(simulation);
}

}  // namespace

Log read_log(const std::string& path, std::optional<int> dim, std::size_t limit) {
  Log log;
  log.name = path;
  try {
    const std::string bytes = read_file(path);
    log.scans = looks_like_zip(bytes) ? npz_scans(bytes, limit) : text_scans(bytes, limit);
    change_dimension(log.scans, dim);
  } catch (const std::runtime_error& error) {
    throw InputError(path + ": " + error.what());
  }
  return log;
}

Log simulate_log(const std::string& world, std::optional<int> dim, std::size_t limit) {
  Log log;
  log.name = "world " + world;
  if (world == "office")
    take(simulate_office(), limit, log);
  else if (world == "apartment")
    take(simulate_apartment(), limit, log);
  else if (world == "street")
    take(simulate_street(), limit, log);
  else
    throw InputError("world " + world + ": expected office, apartment or street");
  try {
    change_dimension(log.scans, dim);
  } catch (const std::runtime_error& error) {
    throw InputError(log.name + ": " + error.what());
  }
  return log;
}

void keep_returned(Log& log) {
  std::visit(
      [](auto& scans) {
        for (auto& scan : scans) scan = scan.returned_only();
      },
      log.scans);
}

}  // namespace ndtree
