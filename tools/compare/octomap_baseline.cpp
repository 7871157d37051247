// SPDX-License-Identifier: BSD-3-Clause
#include "octomap_baseline.hpp"

#include <octomap/OcTree.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <istream>
#include <limits>
#include <memory>
#include <ostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/log_odds.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {
namespace {

constexpr int kKeyOfZero = 32768;  // OctoMap's cell [0, cell size) has this key on each axis.

/// OctoMap's octree with exactly our log-odds; its setters would take them through probabilities.
class Tree : public octomap::OcTree {
 public:
  Tree(double cell_size, const MapOptions& options) : OcTree(cell_size) {
    prob_hit_log = static_cast<float>(ndtree::log_odds(options.probability_max));
    prob_miss_log = static_cast<float>(ndtree::log_odds(options.probability_min));
    clamping_thres_min = static_cast<float>(options.log_odds_min);
    clamping_thres_max = static_cast<float>(options.log_odds_max);
    occ_prob_thres_log = std::numeric_limits<float>::min();  // OctoMap compares by >=, and 0 is unknown.
  }

  using OcTree::integrateMissOnRay;  // What insertRay() calls for a beam beyond its maximum range.
};

octomap::point3d to_octomap(const Vector<3>& point) {
  return {static_cast<float>(point.x()), static_cast<float>(point.y()), static_cast<float>(point.z())};
}

/// One beam as OctoMap takes it.
struct Ray {
  octomap::point3d origin;
  octomap::point3d end;
  bool hit;
};

/// FNV-1a: a damaged file must be found out before OctoMap reads it, which trusts what it reads.
std::uint64_t checksum(const std::string& bytes) {
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  for (const char byte : bytes) hash = (hash ^ static_cast<unsigned char>(byte)) * 0x100000001b3ULL;
  return hash;
}

constexpr char kMagic[] = "ndtree-octomap 1\n";

template <class T>
void write_value(std::ostream& out, T value) {
  out.write(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string read_bytes(std::istream& in, std::uint64_t size) {
  constexpr std::uint64_t kChunk = 1 << 20;  // A wrong size fails at the end of the file, not in allocation.
  std::string bytes;
  while (bytes.size() < size) {
    const std::size_t begin = bytes.size();
    bytes.resize(begin + static_cast<std::size_t>(std::min(size - begin, kChunk)));
    if (!in.read(bytes.data() + begin, static_cast<std::streamsize>(bytes.size() - begin)))
      throw std::runtime_error("OctoMap baseline: the stream ends too early");
  }
  return bytes;
}

template <class T>
T read_value(std::istream& in) {
  const std::string bytes = read_bytes(in, sizeof(T));
  T value;
  std::memcpy(&value, bytes.data(), sizeof value);
  return value;
}

}  // namespace

struct OctomapBaseline::Impl {
  Tree tree;
  MapOptions options;
  OctomapInsertion insertion;
  std::uint64_t updates = 0;

  Impl(double cell_size, const MapOptions& map_options, OctomapInsertion how)
      : tree(cell_size, map_options), options(map_options), insertion(how) {}

  [[nodiscard]] double cell_size() const { return tree.getResolution(); }
  /// Points with every |component| below this [m] have a key, also when rounded to float.
  [[nodiscard]] double reach() const { return (kKeyOfZero - 2) * cell_size(); }
  [[nodiscard]] bool in_reach(const Vector<3>& point) const {
    return (point.array().abs() < reach()).all();  // False for NaN.
  }
  /// Lower border of the cells with this key on an axis [m].
  [[nodiscard]] double border(int key) const { return (key - kKeyOfZero) * cell_size(); }
  [[nodiscard]] int key(double coordinate) const {
    const double limited = std::clamp(coordinate, -reach(), reach());
    return tree.coordToKey(limited);
  }

  /// The keys that insertRay() updates as free: all but the end point's.
  [[nodiscard]] std::size_t count_free(const Ray& ray, octomap::KeyRay& keys) const {
    return tree.computeRayKeys(ray.origin, ray.end, keys) ? keys.size() : 0;
  }

  template <int D>
  std::vector<Ray> rays(const ScanView<D>& scan, double max_range, InsertReport& report) const;
  void check(const Ray& ray, Eigen::Index i) const;
  void insert_beam_by_beam(const std::vector<Ray>& rays, InsertReport& report);
  void insert_at_once(const std::vector<Ray>& rays, InsertReport& report);
};

/// The valid beams of a scan; counts all of them. @throws std::invalid_argument as insert().
template <int D>
std::vector<Ray> OctomapBaseline::Impl::rays(const ScanView<D>& scan, double max_range,
                                             InsertReport& report) const {
  if (!(max_range > 0.0))
    throw std::invalid_argument("max_range = " + std::to_string(max_range) + " m: must be > 0");
  if (!scan.origin_per_beam && scan.size > 0 && !scan.origin(0).allFinite())
    throw std::invalid_argument("origin: every component must be finite");
  std::vector<Ray> result;
  result.reserve(static_cast<std::size_t>(scan.size));
  report.beams = static_cast<std::uint64_t>(scan.size);
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    ++report.count(beam.outcome);
    if (beam.outcome == BeamOutcome::invalid) continue;
    const Vector<3> origin = detail::in_space(beam.origin);
    const Vector<3> end = detail::in_space(Vector<D>(beam.free_end()));
    if (!in_reach(origin) || !in_reach(end))
      throw std::invalid_argument("beam " + std::to_string(i) + ": with cells of " +
                                  std::to_string(cell_size()) + " m OctoMap needs every component within " +
                                  std::to_string(reach()) + " m of 0");
    result.push_back({to_octomap(origin), to_octomap(end), beam.outcome == BeamOutcome::returned});
    check(result.back(), i);
  }
  return result;
}

/// A beam's keys must fit into OctoMap's buffer, which does not check that.
void OctomapBaseline::Impl::check(const Ray& ray, Eigen::Index i) const {
  constexpr int kMostKeys = 99990;
  int steps = 0;
  for (unsigned a = 0; a < 3; ++a)
    steps += std::abs(int{tree.coordToKey(static_cast<double>(ray.end(a)))} -
                      int{tree.coordToKey(static_cast<double>(ray.origin(a)))});
  if (steps > kMostKeys)
    throw std::invalid_argument("beam " + std::to_string(i) + " crosses " + std::to_string(steps) +
                                " cells: OctoMap takes at most " + std::to_string(kMostKeys));
}

void OctomapBaseline::Impl::insert_beam_by_beam(const std::vector<Ray>& rays, InsertReport& report) {
  const auto start = std::chrono::steady_clock::now();
  for (const Ray& ray : rays) {
    if (ray.hit)
      tree.insertRay(ray.origin, ray.end);
    else
      tree.integrateMissOnRay(ray.origin, ray.end);
  }
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();

  octomap::KeyRay keys;
  for (const Ray& ray : rays) report.updates += count_free(ray, keys) + (ray.hit ? 1 : 0);
}

/// What insertPointCloud() does, step by step: it takes one maximum range for the whole scan, and so cannot
/// be told of beams without return that are free up to points of their own.
void OctomapBaseline::Impl::insert_at_once(const std::vector<Ray>& rays, InsertReport& report) {
  octomap::Pointcloud hits;
  hits.reserve(rays.size());
  for (const Ray& ray : rays) {
    if (!(ray.origin == rays.front().origin))
      throw std::invalid_argument("origins: OctoMap takes a scan at once from one origin only");
    if (ray.hit) hits.push_back(ray.end);
  }
  if (rays.empty()) return;
  const bool discretized = insertion == OctomapInsertion::scan_discretized;
  const bool lazy = discretized || insertion == OctomapInsertion::scan_at_once_lazy;
  octomap::KeyRay keys;

  const auto start = std::chrono::steady_clock::now();
  {
    octomap::KeySet free;
    octomap::KeySet occupied;
    octomap::KeySet ends;  // Of beams without return, if one to a cell counts.
    if (discretized)
      tree.computeDiscreteUpdate(hits, rays.front().origin, free, occupied, -1.0);
    else
      tree.computeUpdate(hits, rays.front().origin, free, occupied, -1.0);
    for (const Ray& ray : rays) {
      if (ray.hit || (discretized && !ends.insert(tree.coordToKey(ray.end)).second)) continue;
      if (!tree.computeRayKeys(ray.origin, ray.end, keys)) continue;
      for (const octomap::OcTreeKey& key : keys)
        if (occupied.find(key) == occupied.end()) free.insert(key);
    }
    for (const octomap::OcTreeKey& key : free) tree.updateNode(key, false, lazy);
    for (const octomap::OcTreeKey& key : occupied) tree.updateNode(key, true, lazy);
    report.updates = free.size() + occupied.size();
  }
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

OctomapBaseline::OctomapBaseline(double cell_size, const MapOptions& options, OctomapInsertion insertion) {
  require_option(cell_size > 0.0 && std::isfinite(cell_size), "cell_size", cell_size, "> 0 m and finite");
  options.validate();
  impl_ = std::make_unique<Impl>(cell_size, options, insertion);
}

OctomapBaseline::~OctomapBaseline() = default;
OctomapBaseline::OctomapBaseline(const OctomapBaseline& other)
    : impl_(std::make_unique<Impl>(*other.impl_)) {}
OctomapBaseline::OctomapBaseline(OctomapBaseline&& other) noexcept = default;
OctomapBaseline& OctomapBaseline::operator=(OctomapBaseline other) noexcept {
  impl_.swap(other.impl_);
  return *this;
}

template <int D>
InsertReport OctomapBaseline::insert(const ScanView<D>& scan, double max_range) {
  InsertReport report;
  const std::vector<Ray> rays = impl_->rays(scan, max_range, report);
  if (impl_->insertion == OctomapInsertion::beam_by_beam)
    impl_->insert_beam_by_beam(rays, report);
  else
    impl_->insert_at_once(rays, report);
  impl_->updates += report.updates;
  return report;
}

template InsertReport OctomapBaseline::insert(const ScanView<2>& scan, double max_range);
template InsertReport OctomapBaseline::insert(const ScanView<3>& scan, double max_range);

double OctomapBaseline::cell_size() const { return impl_->cell_size(); }
const MapOptions& OctomapBaseline::options() const { return impl_->options; }
OctomapInsertion OctomapBaseline::insertion() const { return impl_->insertion; }

OctomapStats OctomapBaseline::stats() const {
  OctomapStats stats;
  for (auto leaf = impl_->tree.begin_leafs(); leaf != impl_->tree.end_leafs(); ++leaf) {
    ++stats.leaves;
    stats.leaves_expanded += std::size_t{1} << (3 * (impl_->tree.getTreeDepth() - leaf.getDepth()));
  }
  Tree pruned(impl_->tree);
  pruned.prune();
  stats.leaves_pruned = pruned.getNumLeafNodes();
  stats.nodes = impl_->tree.size();
  stats.updates = impl_->updates;
  stats.memory_bytes = impl_->tree.memoryUsage();
  return stats;
}

OctomapLeaves OctomapBaseline::leaves() const {
  const auto n = static_cast<Eigen::Index>(impl_->tree.getNumLeafNodes());
  OctomapLeaves leaves{Points<3>(3, n), Eigen::VectorXd(n), Eigen::VectorXf(n)};
  Eigen::Index i = 0;
  for (auto leaf = impl_->tree.begin_leafs(); leaf != impl_->tree.end_leafs(); ++leaf, ++i) {
    const octomap::OcTreeKey first = leaf.getIndexKey();
    for (unsigned a = 0; a < 3; ++a) leaves.lower(a, i) = impl_->border(first[a]);
    leaves.size[i] = leaf.getSize();
    leaves.log_odds[i] = leaf->getLogOdds();
  }
  return leaves;
}

std::optional<float> OctomapBaseline::log_odds(const Vector<3>& point) const {
  if (!impl_->in_reach(point)) return std::nullopt;
  const octomap::OcTreeNode* const node =
      impl_->tree.search(impl_->tree.coordToKey(point.x(), point.y(), point.z()));
  if (node == nullptr) return std::nullopt;
  return node->getLogOdds();
}

bool OctomapBaseline::occupied_within(const Vector<3>& point, double radius) const {
  if (!point.allFinite() || impl_->tree.size() == 0) return false;
  std::array<octomap::OcTreeKey, 2> corner;
  for (int a = 0; a < 3; ++a) {
    const auto axis = static_cast<unsigned>(a);
    corner[0][axis] = static_cast<octomap::key_type>(impl_->key(point[a] - radius) - 1);  // Closed cells.
    corner[1][axis] = static_cast<octomap::key_type>(impl_->key(point[a] + radius));
  }
  for (auto leaf = impl_->tree.begin_leafs_bbx(corner[0], corner[1]); leaf != impl_->tree.end_leafs_bbx();
       ++leaf) {
    if (!(leaf->getLogOdds() > 0.0f)) continue;
    const octomap::OcTreeKey first = leaf.getIndexKey();
    Box<3> cell;
    for (int a = 0; a < 3; ++a) cell.lower[a] = impl_->border(first[static_cast<unsigned>(a)]);
    cell.upper = cell.lower.array() + leaf.getSize();
    if (cell.squared_distance(point) <= radius * radius) return true;
  }
  return false;
}

std::optional<double> OctomapBaseline::cast_ray(const Vector<3>& origin, const Vector<3>& direction,
                                                double max_range, RayAim aim) const {
  const double length = direction.norm();
  if (!origin.allFinite() || !(length > 0.0) || !direction.allFinite())
    throw std::invalid_argument("ray: origin and direction must be finite, and the direction not zero");
  if (!(max_range > 0.0))
    throw std::invalid_argument("max_range = " + std::to_string(max_range) + " m: must be > 0");
  if (!impl_->in_reach(origin)) return std::nullopt;

  // OctoMap's range ends at the centre of a cell, and must end before its last cell.
  const Vector<3> unit = direction / length;
  double search_range = max_range + impl_->cell_size();
  for (int a = 0; a < 3; ++a)
    if (unit[a] != 0.0)
      search_range = std::min(
          search_range, (impl_->reach() - origin[a] * (unit[a] < 0.0 ? -1.0 : 1.0)) / std::abs(unit[a]));
  octomap::point3d center;
  if (!(search_range > 0.0) ||
      !impl_->tree.castRay(to_octomap(origin), to_octomap(unit), center, true, search_range))
    return std::nullopt;

  // Where the ray enters that cell: getRayIntersection() tolerates 1e-6 m, which float coordinates exceed.
  double entry = 0.0;
  for (int a = 0; a < 3; ++a) {
    if (unit[a] == 0.0) continue;
    const int key = impl_->key(static_cast<double>(center(static_cast<unsigned>(a))));
    entry = std::max(entry, (impl_->border(unit[a] > 0.0 ? key : key + 1) - origin[a]) / unit[a]);
  }
  if (!(entry < max_range)) return std::nullopt;
  if (aim == RayAim::cell) return entry;
  detail::MedianEnd end(entry + detail::kMostDepth * impl_->cell_size());
  for_each_cell(origin, unit, entry, [&](float log_odds, double enter, double exit) {
    const bool is_observed = state_of(log_odds) != CellState::unknown;
    return end.pass(is_observed ? HitRateModel::mean_of(static_cast<double>(log_odds)) : 0.0, enter, exit);
  });
  return end.t();
}

void OctomapBaseline::for_each_cell(const Vector<3>& origin, const Vector<3>& direction, double begin,
                                    const std::function<bool(float, double, double)>& visit) const {
  const LatticeGeometry<2, 3> lattice(impl_->cell_size(), 0);
  const BeamStepper<2, 3> stepper(lattice, origin, direction);
  const std::function<bool(const CellIndex<3>&, double, double)> descend = [&](const CellIndex<3>& cell,
                                                                               double enter, double exit) {
    if (cell.level > lattice.finest_level())
      return stepper.for_each_child(
          cell, enter, exit,
          [&](int, const CellIndex<3>& child, double from, double to) { return descend(child, from, to); });
    octomap::OcTreeKey key;
    for (unsigned a = 0; a < 3; ++a) key[a] = static_cast<octomap::key_type>(cell.lower[a] + kKeyOfZero);
    const octomap::OcTreeNode* const node = impl_->tree.search(key);
    return visit(node == nullptr ? 0.0f : node->getLogOdds(), enter, exit);
  };
  constexpr int kLevels = 16;  // Of OctoMap's tree.
  CellIndex<3> all{{-kKeyOfZero, -kKeyOfZero, -kKeyOfZero}, kLevels};
  double end = std::numeric_limits<double>::infinity();
  if (stepper.clip(all, begin, end)) descend(all, begin, end);
}

void OctomapBaseline::save(std::ostream& out) const {
  std::ostringstream nodes;
  impl_->tree.writeData(nodes);
  std::ostringstream body;
  write_value(body, impl_->cell_size());
  for_each_option(impl_->options, [&](const char*, const double& value) { write_value(body, value); });
  write_value(body, static_cast<std::uint64_t>(impl_->insertion));
  write_value(body, impl_->updates);
  write_value(body, static_cast<std::uint64_t>(impl_->tree.size()));
  body << nodes.str();
  const std::string bytes = body.str();
  out << kMagic;
  write_value(out, static_cast<std::uint64_t>(bytes.size()));
  write_value(out, checksum(bytes));
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

OctomapBaseline OctomapBaseline::load(std::istream& in) {
  if (read_bytes(in, sizeof kMagic - 1) != kMagic)
    throw std::runtime_error("OctoMap baseline: the stream does not start with 'ndtree-octomap 1'");
  const auto size = read_value<std::uint64_t>(in);
  const auto sum = read_value<std::uint64_t>(in);
  const std::string bytes = read_bytes(in, size);
  if (checksum(bytes) != sum) throw std::runtime_error("OctoMap baseline: the stream is damaged");

  std::istringstream body(bytes);
  const auto cell_size = read_value<double>(body);
  MapOptions options;
  for_each_option(options, [&](const char*, double& value) { value = read_value<double>(body); });
  const auto insertion = read_value<std::uint64_t>(body);
  OctomapBaseline map(cell_size, options, static_cast<OctomapInsertion>(insertion));
  map.impl_->updates = read_value<std::uint64_t>(body);
  const auto nodes = read_value<std::uint64_t>(body);
  if (nodes > 0) map.impl_->tree.readData(body);
  if (map.impl_->tree.size() != nodes) throw std::runtime_error("OctoMap baseline: the stream is damaged");
  return map;
}

void OctomapBaseline::write_ot(std::ostream& out) const {
  Tree copy(impl_->tree);
  copy.updateInnerOccupancy();  // Lazy insertion leaves it to the end.
  copy.write(out);
}

void OctomapBaseline::write_bt(std::ostream& out) const { Tree(impl_->tree).writeBinary(out); }

OctomapBaseline OctomapBaseline::read_octomap(std::istream& in) {
  std::string line;
  std::getline(in, line);
  in.seekg(0);
  std::unique_ptr<octomap::AbstractOcTree> any;
  if (line.find("binary") != std::string::npos) {
    auto tree = std::make_unique<octomap::OcTree>(0.1);
    if (tree->readBinary(in)) any = std::move(tree);
  } else {
    any.reset(octomap::AbstractOcTree::read(in));
  }
  const auto* const tree = dynamic_cast<const octomap::OcTree*>(any.get());
  if (tree == nullptr) throw std::runtime_error("OctoMap does not read the stream");
  OctomapBaseline map(tree->getResolution());
  std::stringstream nodes;
  tree->writeData(nodes);
  if (tree->size() > 0) map.impl_->tree.readData(nodes);
  return map;
}

}  // namespace ndtree
