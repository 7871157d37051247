// SPDX-License-Identifier: BSD-3-Clause
// Every allocation fails once: whatever throws, maps stay valid.
#include <gtest/gtest.h>

#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>
#include <string>
#include <type_traits>

#include "ndtree/core/cancel.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "options.hpp"
#include "random.hpp"

namespace {

/// Allocations until one fails; negative: none does.
std::atomic<long> left_until_failure{-1};
std::atomic<long> failures{0};

bool fails_now() {
  if (left_until_failure.load(std::memory_order_relaxed) < 0) return false;
  if (left_until_failure.fetch_sub(1) != 0) return false;
  ++failures;
  return true;
}

}  // namespace

// Of this program, all of which allocates through them. Not inlined: the compiler would see a free() of what
// is made by new.
#define NDTREE_NOT_INLINE __attribute__((noinline))
NDTREE_NOT_INLINE void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  return fails_now() ? nullptr : std::malloc(size > 0 ? size : 1);
}
NDTREE_NOT_INLINE void* operator new(std::size_t size, std::align_val_t alignment) {
  const auto align = static_cast<std::size_t>(alignment);
  if (!fails_now())
    if (void* const memory = std::aligned_alloc(align, (size + align - 1) / align * align)) return memory;
  throw std::bad_alloc();
}
NDTREE_NOT_INLINE void* operator new(std::size_t size) {
  if (void* const memory = operator new(size, std::nothrow)) return memory;
  throw std::bad_alloc();
}
NDTREE_NOT_INLINE void* operator new[](std::size_t size) { return operator new(size); }
NDTREE_NOT_INLINE void operator delete(void* memory) noexcept { std::free(memory); }
NDTREE_NOT_INLINE void operator delete[](void* memory) noexcept { std::free(memory); }
NDTREE_NOT_INLINE void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
NDTREE_NOT_INLINE void operator delete[](void* memory, std::size_t) noexcept { std::free(memory); }
NDTREE_NOT_INLINE void operator delete(void* memory, const std::nothrow_t&) noexcept { std::free(memory); }
NDTREE_NOT_INLINE void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
NDTREE_NOT_INLINE void operator delete(void* memory, std::size_t, std::align_val_t) noexcept {
  std::free(memory);
}

namespace ndtree::test {
namespace {

/// Runs `call` with the n-th allocation failing, for every n until none does, and `check(failed)` after each.
/// @returns how many failed.
template <class Prepare, class Call, class Check>
int with_each_failure(const Prepare& prepare, const Call& call, const Check& check) {
  int failed = 0;
  for (long n = 0;; ++n) {
    auto state = prepare();
    failures = 0;
    bool threw = false;
    left_until_failure = n;
    try {
      call(state);
    } catch (const std::bad_alloc&) {
      threw = true;
    }
    left_until_failure = -1;
    check(state, threw, n);
    failed += threw;
    if (failures == 0 || testing::Test::HasFatalFailure()) return failed;
  }
}

template <int D>
Scan<D> scan_of(std::uint64_t seed, Eigen::Index beams, double reach, double offset) {
  Random random(seed);
  Scan<D> scan;
  scan.origins = Vector<D>::Constant(offset);
  scan.endpoints.resize(D, beams);
  for (Eigen::Index i = 0; i < beams; ++i)
    for (int a = 0; a < D; ++a) scan.endpoints(a, i) = offset + random.uniform(-reach, reach);
  return scan;
}

template <class Map>
struct Case {
  Map map;
  std::string before;
};

template <class Map>
class ScarceMemory : public testing::Test {
 public:
  static Map small_map(bool is_limited) {
    MapOptions options = spelled_out_options(0.1, 1.6);
    if (is_limited) options.max_memory = 1e9;
    Map map(options);
    map.insert(scan_of<Map::kDim>(1, 40, 1.5, 0.0));
    map.insert(scan_of<Map::kDim>(2, 40, 1.5, 0.7));
    return map;
  }
  /// Valid, and good for more.
  static void expect_usable(Map& map, long n) {
    ASSERT_NO_THROW(map.check_invariants()) << "allocation " << n;
    ASSERT_NO_THROW(map.insert(scan_of<Map::kDim>(5, 30, 2.0, 0.2), kUnlimitedRange, 1))
        << "allocation " << n;
    ASSERT_NO_THROW(map.check_invariants()) << "allocation " << n;
    const std::string bytes = to_bytes(map);
    ASSERT_TRUE(to_bytes(from_bytes<Map>(bytes)) == bytes) << "allocation " << n;
  }
};
using Maps = testing::Types<AdaptiveMap<2, 3>, PaperMap<2, 3>, FixedMap<2, 2>>;
TYPED_TEST_SUITE(ScarceMemory, Maps);

TYPED_TEST(ScarceMemory, AnyAllocationOfAnInsertionMayFail) {
  constexpr int D = TypeParam::kDim;
  for (const bool is_limited : {false, true}) {
    for (const bool is_shared : {false, true})
      for (const int threads : {1, 2, 3}) {  // With a snapshot.
        if (threads > 1 && !std::is_same_v<typename TypeParam::RefinementType, EvidenceRefinement>) continue;
        const TypeParam first = this->small_map(is_limited);
        const std::string before = to_bytes(first);
        const Scan<D> scan = threads == 1   ? scan_of<D>(3, 120, 4.0, 6.0)
                             : threads == 2 ? scan_of<D>(3, 2050, 2.5, 6.0)
                                            : scan_of<D>(3, 3050, 0.5, 0.8);  // Into one coarse cell.
        const int failed =
            with_each_failure([&] { return is_shared ? first : from_bytes<TypeParam>(before); },
                              [&](TypeParam& map) { map.insert(scan, kUnlimitedRange, threads); },
                              [&](TypeParam& map, bool threw, long n) {
                                ASSERT_TRUE(!threw || !(is_limited || is_shared) || to_bytes(map) == before)
                                    << "allocation " << n;
                                ASSERT_TRUE(to_bytes(first) == before) << "allocation " << n;
                                this->expect_usable(map, n);
                              });
        EXPECT_GT(failed, 5);
        testing::Test::RecordProperty("failed_" + std::to_string(threads) + (is_limited ? "_undone" : ""),
                                      failed);
      }
  }
}

TYPED_TEST(ScarceMemory, AnyChunkThatASnapshotSharesMayLackMemory) {
  // Of a map of many chunks, that the insertion goes through one by one.
  constexpr int D = TypeParam::kDim;
  TypeParam first(spelled_out_options(0.1, 1.6));
  for (std::uint64_t i = 0; i < 6; ++i) first.insert(scan_of<D>(i, 150, 3.0, 3.0 * static_cast<double>(i)));
  const std::string before = to_bytes(first);
  const Scan<D> scan = scan_of<D>(9, 60, 8.0, 8.0);
  const int failed =
      with_each_failure([&] { return first; }, [&](TypeParam& map) { map.insert(scan, kUnlimitedRange, 1); },
                        [&](TypeParam& map, bool threw, long n) {
                          ASSERT_TRUE(!threw || to_bytes(map) == before) << "allocation " << n;
                          ASSERT_NO_THROW(map.check_invariants()) << "allocation " << n;
                        });
  EXPECT_GT(failed, 20);
}

TYPED_TEST(ScarceMemory, AnyAllocationOfOtherChangesMayFail) {
  constexpr int D = TypeParam::kDim;
  TypeParam first = this->small_map(false);
  const std::string before = to_bytes(first);
  const Box<D> box{Vector<D>::Constant(-0.33), Vector<D>::Constant(0.77)};
  const auto usable = [&](TypeParam& map, bool threw, long n) {
    ASSERT_TRUE(!threw || to_bytes(map) == before) << "allocation " << n;
    this->expect_usable(map, n);
    ASSERT_TRUE(to_bytes(first) == before) << "allocation " << n;
  };
  const auto copied = [&] { return first; };
  with_each_failure(
      copied, [&](TypeParam& map) { map.crop(box); }, usable);
  with_each_failure(
      copied, [&](TypeParam& map) { map.clear(box); }, usable);
  with_each_failure(
      copied, [&](TypeParam& map) { map.keep_near(Vector<D>::Zero(), 0.9); }, usable);
  TypeParam other = this->small_map(false);
  other.insert(scan_of<D>(4, 40, 1.5, 2.0));
  EXPECT_GT(with_each_failure(
                copied, [&](TypeParam& map) { map.merge(other); }, usable),
            3);
  EXPECT_GT(with_each_failure(
                copied, [](TypeParam& map) { map.shrink_to_fit(); },
                [&](TypeParam& map, bool, long n) {
                  ASSERT_TRUE(to_bytes(map) == before);
                  this->expect_usable(map, n);
                }),
            1);
  if constexpr (std::is_same_v<typename TypeParam::RefinementType, EvidenceRefinement>) {
    EXPECT_GT(with_each_failure(
                  copied,
                  [](TypeParam& map) {
                    map.compress({1e9, {}, {}});
                  },
                  [&](TypeParam& map, bool threw, long n) {
                    ASSERT_TRUE(!threw || to_bytes(map) == before);
                    this->expect_usable(map, n);
                  }),
              10);
  }
}

TYPED_TEST(ScarceMemory, AnyAllocationOfCopiesAndFilesMayFail) {
  TypeParam first = this->small_map(false);
  const std::string before = to_bytes(first);
  const auto none = [] { return std::unique_ptr<TypeParam>(); };
  const auto usable = [&](std::unique_ptr<TypeParam>& map, bool threw, long n) {
    ASSERT_EQ(map == nullptr, threw);
    if (!map) return;
    ASSERT_TRUE(to_bytes(*map) == before);
    this->expect_usable(*map, n);
  };
  EXPECT_GT(with_each_failure(
                none,
                [&](std::unique_ptr<TypeParam>& map) {
                  map = std::make_unique<TypeParam>(from_bytes<TypeParam>(before));
                },
                usable),
            5);
  EXPECT_GT(
      with_each_failure(
          none, [&](std::unique_ptr<TypeParam>& map) { map = std::make_unique<TypeParam>(first); }, usable),
      2);
  const auto same = [&](std::string& bytes, bool threw, long) { ASSERT_TRUE(threw || bytes == before); };
  with_each_failure([] { return std::string(); }, [&](std::string& bytes) { bytes = to_bytes(first); }, same);
  // To what is there already.
  MapOptions coarser = first.options();
  coarser.min_cell_size *= 2.0;
  const TypeParam other(coarser);
  const std::string of_other = to_bytes(other);
  with_each_failure([&] { return other; }, [&](TypeParam& map) { map = first; },
                    [&](TypeParam& map, bool threw, long n) {
                      ASSERT_TRUE(to_bytes(map) == (threw ? of_other : before));
                      this->expect_usable(map, n);
                    });
}

}  // namespace
}  // namespace ndtree::test
