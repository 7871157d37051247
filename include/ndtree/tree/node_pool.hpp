// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Storage of a tree: nodes, and a pool of blocks of siblings addressed by 32-bit ids.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/core/memory.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Id of a block of N^D siblings; below 2^31, so that one bit of a node's first word tells leaf from inner
/// node.
using BlockId = std::uint32_t;

/// One node: the cell of a leaf, or an inner node's link to the block of its children and a word for a
/// summary of them, 0 at first. A cell that declares `static constexpr bool kLeavesTopBitOfFirstWordClear =
/// true`, and keeps that promise with a std::uint32_t as its first member, shares its memory with the link:
/// the node is then no larger than the cell. Any other cell stands beside the link.
template <class Cell, class = void>
class Node {
 public:
  [[nodiscard]] bool is_leaf() const { return (link_ & kInner) == 0; }
  [[nodiscard]] BlockId children() const { return link_ & ~kInner; }
  [[nodiscard]] Cell& cell() { return cell_; }
  [[nodiscard]] const Cell& cell() const { return cell_; }
  void become_leaf(const Cell& cell) {
    link_ = 0;
    cell_ = cell;
  }
  void become_inner(BlockId children) {
    link_ = kInner | children;
    summary_word_ = 0;
    cell_ = Cell{};
  }
  /// @pre the node is an inner one.
  [[nodiscard]] std::uint32_t summary_word() const { return summary_word_; }
  void set_summary_word(std::uint32_t word) { summary_word_ = word; }

 private:
  static constexpr std::uint32_t kInner = 0x80000000u;
  std::uint32_t link_ = 0;
  std::uint32_t summary_word_ = 0;
  Cell cell_{};
};

template <class Cell>
class Node<Cell, std::enable_if_t<Cell::kLeavesTopBitOfFirstWordClear>> {
  static_assert(std::is_standard_layout_v<Cell> && std::is_trivially_copyable_v<Cell>);

 public:
  Node() : cell_{} {}
  [[nodiscard]] bool is_leaf() const { return (link_.word & kInner) == 0; }
  [[nodiscard]] BlockId children() const { return link_.word & ~kInner; }
  [[nodiscard]] Cell& cell() { return cell_; }
  [[nodiscard]] const Cell& cell() const { return cell_; }
  void become_leaf(const Cell& cell) { cell_ = cell; }
  void become_inner(BlockId children) { link_ = Link{kInner | children, 0}; }
  [[nodiscard]] std::uint32_t summary_word() const { return link_.summary_word; }
  void set_summary_word(std::uint32_t word) { link_.summary_word = word; }

 private:
  static constexpr std::uint32_t kInner = 0x80000000u;
  struct Link {
    std::uint32_t word;
    std::uint32_t summary_word;
  };
  static_assert(sizeof(Link) <= sizeof(Cell));
  union {  // Both begin with one std::uint32_t, their common initial sequence: it may be read through either.
    Cell cell_;
    Link link_;
  };
};

/// Blocks of `kBlockSize` nodes in chunks that do not move while the pool grows. Freed blocks are used again,
/// the last freed first.
///
/// A copy keeps all ids and shares the chunks, which takes O(chunks). Chunks are copied on write: asking for
/// a block to write it copies its chunk the first time; other threads may then read, write and destroy
/// copies. A pool may be copied while others read it, but not while it is written.
///
/// Threads may allocate and free at once, each through an arena of its own, while they read and write nodes
/// that no other one touches; only the taking of new blocks, some dozens at a time, and the first writing of
/// a chunk that is shared lock.
template <class NodeType, int kBlockSize>
class NodePool {
  static_assert(std::is_trivially_copyable_v<NodeType> && std::is_trivially_destructible_v<NodeType>);
  static_assert(alignof(NodeType) <= __STDCPP_DEFAULT_NEW_ALIGNMENT__);
  static constexpr BlockId kMaxBlocks = 0x7fffffffu;
  static constexpr BlockId kNone = 0x7fffffffu;

 public:
  /// Where one thread takes blocks from, and gives them back to.
  class Arena {
    friend NodePool;
    BlockId next_unused_ = 0;
    BlockId end_of_chunk_ = 0;
    BlockId first_free_ = kNone;
    std::ptrdiff_t num_blocks_ = 0;  // Allocated less freed.
  };

  NodePool() = default;
  NodePool(NodePool&& other) noexcept { swap(other); }
  NodePool(const NodePool& other) : NodePool() {  // So that what fails below is destroyed.
    main_ = other.main_;
    make_directory(other.num_chunks_);
    for (; num_chunks_ < other.num_chunks_; ++num_chunks_) {
      Chunk* const chunk = other.entry(num_chunks_).share();
      chunk->owners.fetch_add(1, std::memory_order_relaxed);
      entry(num_chunks_).set(chunk, true);
    }
    may_share_.store(num_chunks_ > 0, std::memory_order_relaxed);
    other.may_share_.store(num_chunks_ > 0, std::memory_order_relaxed);
  }
  NodePool& operator=(NodePool other) noexcept {
    swap(other);
    return *this;
  }
  ~NodePool() {
    for (std::size_t i = 0; i < num_chunks_; ++i) release(entry(i).chunk());
  }

  /// Siblings of a block, `kBlockSize` of them, to be written: they are shared with no other pool. Pointers
  /// that were got for reading may then be of what was.
  /// @throws std::bad_alloc if they are, and there is no memory for their own; the pool is then unchanged.
  [[nodiscard]] NDTREE_ALWAYS_INLINE NodeType* block(BlockId id) {
    const std::size_t number = id >> kChunkBits;
    const typename Entry::Now now = entry(number).now();
    return in_chunk(now.is_shared ? make_own(number) : now.chunk, id);
  }
  [[nodiscard]] const NodeType* block(BlockId id) const {
    return in_chunk(entry(id >> kChunkBits).chunk(), id);
  }
  /// Whether a block is still the same memory as another pool's: neither has asked for it to write it, or
  /// for one beside it, since one of the two was copied from the other.
  [[nodiscard]] bool shares(BlockId id, const NodePool& other) const {
    const std::size_t number = id >> kChunkBits;
    return number < other.num_chunks_ && entry(number).chunk() == other.entry(number).chunk();
  }
  /// Whether some chunk is shared, so that to write it needs memory. O(chunks) after a copy was made, else
  /// O(1).
  [[nodiscard]] bool is_shared() {
    bool is_shared = may_share_.load(std::memory_order_relaxed);
    for (std::size_t i = 0; is_shared; ++i) {
      if (i == num_chunks_)
        is_shared = false;
      else if (entry(i).is_shared() && entry(i).chunk()->owners.load(std::memory_order_acquire) > 1)
        break;
    }
    may_share_.store(is_shared, std::memory_order_relaxed);
    return is_shared;
  }

  /// The one that is used if no other is named.
  [[nodiscard]] Arena& main_arena() { return main_; }

  /// Bytes that it may hold from now on, `others` beside it included; what it holds already stays. Neither
  /// copied nor swapped.
  void limit_memory(std::size_t bytes, std::size_t others = 0) {
    limit_ = bytes;
    others_ = others;
  }

  /// A block of default nodes. @throws std::length_error beyond 2^31 blocks, MemoryLimitReached,
  ///   std::bad_alloc; the pool is then unchanged.
  BlockId allocate() { return allocate(main_); }
  BlockId allocate(Arena& arena) {
    if (arena.first_free_ == kNone && arena.next_unused_ == arena.end_of_chunk_) refill(arena);
    const bool is_free = arena.first_free_ != kNone;
    const BlockId id = is_free ? pop_free(arena) : arena.next_unused_;
    std::uninitialized_fill_n(block(id), kBlockSize, NodeType{});
    arena.next_unused_ += is_free ? 0 : 1;
    ++arena.num_blocks_;
    return id;
  }

  void free(BlockId id) { free(id, main_); }
  void free(BlockId id, Arena& arena) {
    push_free(arena, id);
    --arena.num_blocks_;
  }

  /// Before a thread begins with an arena. As long as one is lent, no block is allocated or freed without.
  void lend(Arena& arena) {
    arena = Arena{};
    ++num_lent_;
  }
  /// When it is done: takes over what its arena holds.
  void absorb(Arena& arena) {
    while (arena.first_free_ != kNone) push_free(main_, pop_free(arena));
    for (; arena.next_unused_ < arena.end_of_chunk_; ++arena.next_unused_) {
      new (block(arena.next_unused_)) NodeType;
      push_free(main_, arena.next_unused_);
    }
    main_.num_blocks_ += arena.num_blocks_;
    arena = Arena{};
    if (--num_lent_ == 0) forget_what_was_replaced();
  }

  [[nodiscard]] std::size_t num_blocks() const { return static_cast<std::size_t>(main_.num_blocks_); }
  /// Blocks that there is memory for, used or not.
  [[nodiscard]] std::size_t capacity_in_blocks() const { return num_chunks_ << kChunkBits; }
  /// Bytes that a pool with this many blocks holds if it was made for them.
  [[nodiscard]] static std::size_t memory_bytes_of(std::size_t num_blocks) {
    const std::size_t chunks = (num_blocks + kChunkMask) >> kChunkBits;
    return chunks * (sizeof(Chunk) + sizeof(Entry));
  }
  /// Room for this many blocks in the directory; none is allocated.
  void reserve(std::size_t num_blocks) { make_directory((num_blocks + kChunkMask) >> kChunkBits); }
  /// Bytes held, used or not, shared with other pools or not.
  [[nodiscard]] std::size_t memory_bytes() const {
    return num_chunks_ * sizeof(Chunk) + capacity_ * sizeof(Entry);
  }

  void swap(NodePool& other) noexcept {
    std::swap(directories_, other.directories_);
    Entry* const directory = directory_.load(std::memory_order_relaxed);
    directory_.store(other.directory_.load(std::memory_order_relaxed), std::memory_order_relaxed);
    other.directory_.store(directory, std::memory_order_relaxed);
    const bool may_share = may_share_.load(std::memory_order_relaxed);
    may_share_.store(other.may_share_.load(std::memory_order_relaxed), std::memory_order_relaxed);
    other.may_share_.store(may_share, std::memory_order_relaxed);
    std::swap(num_chunks_, other.num_chunks_);
    std::swap(capacity_, other.capacity_);
    std::swap(main_, other.main_);
  }

 private:
  static constexpr std::size_t kBlockBytes = sizeof(NodeType) * kBlockSize;
  /// Chunks are of about 8 KiB, so that small maps are small, and of at least one block.
  static constexpr int chunk_bits() {
    int bits = 0;
    while ((kBlockBytes << (bits + 1)) <= 8192) ++bits;
    return bits;
  }
  static constexpr int kChunkBits = chunk_bits();
  static constexpr BlockId kChunkMask = (BlockId{1} << kChunkBits) - 1;
  static constexpr std::size_t kChunkBytes = kBlockBytes << kChunkBits;

  struct Chunk {
    alignas(std::max_align_t) std::byte bytes[kChunkBytes];  // Not initialised.
    std::atomic<std::uint32_t> owners{1};

    Chunk() {}  // NOLINT(modernize-use-equals-default): that would write zeros.
  };
  /// A chunk, and whether it may have other owners: then its address is odd.
  class Entry {
   public:
    [[nodiscard]] Chunk* chunk() const { return reinterpret_cast<Chunk*>(word() & ~kShared); }
    [[nodiscard]] bool is_shared() const { return (word() & kShared) != 0; }
    struct Now {
      Chunk* chunk;  // Its address only if it is not shared.
      bool is_shared;
    };
    [[nodiscard]] Now now() const {
      const std::uintptr_t word = this->word();
      return {reinterpret_cast<Chunk*>(word), (word & kShared) != 0};
    }
    void set(Chunk* chunk, bool is_shared) {
      word_.store(reinterpret_cast<std::uintptr_t>(chunk) | (is_shared ? kShared : 0),
                  std::memory_order_release);
    }
    void set(const Entry& other) { word_.store(other.word(), std::memory_order_relaxed); }
    Chunk* share() const { return reinterpret_cast<Chunk*>(word_.fetch_or(kShared) & ~kShared); }

   private:
    static constexpr std::uintptr_t kShared = 1;
    [[nodiscard]] std::uintptr_t word() const { return word_.load(std::memory_order_acquire); }
    mutable std::atomic<std::uintptr_t> word_{0};
  };

  [[nodiscard]] Entry& entry(std::size_t number) const {
    return directory_.load(std::memory_order_acquire)[number];
  }
  [[nodiscard]] static NodeType* in_chunk(Chunk* chunk, BlockId id) {
    return std::launder(reinterpret_cast<NodeType*>(chunk->bytes)) + (id & kChunkMask) * kBlockSize;
  }
  static void release(Chunk* chunk) {
    if (chunk->owners.fetch_sub(1, std::memory_order_acq_rel) == 1) delete chunk;
  }

  /// Takes a chunk's place by a copy, unless all other owners are gone.
  NDTREE_NEVER_INLINE Chunk* make_own(std::size_t number) {
    const std::lock_guard<std::mutex> lock(entries_mutex_);
    Entry& shared = entry(number);
    Chunk* const chunk = shared.chunk();
    if (!shared.is_shared()) return chunk;  // Another thread was here.
    if (chunk->owners.load(std::memory_order_acquire) == 1) {
      shared.set(chunk, false);
      return chunk;
    }
    if (replaced_.size() == replaced_.capacity())
      replaced_.reserve(std::max<std::size_t>(16, 2 * replaced_.size()));
    Chunk* const own = new Chunk;
    std::memcpy(own->bytes, chunk->bytes, kChunkBytes);
    shared.set(own, false);
    if (num_lent_ == 0)
      release(chunk);
    else
      replaced_.push_back(chunk);  // Another thread may still read it.
    return own;
  }

  /// A larger directory with the same chunks. A reader of the old one finds in it all blocks that it has ids
  /// of.
  void make_directory(std::size_t capacity) {
    if (capacity <= capacity_) return;
    directories_.push_back(std::make_unique<Entry[]>(capacity));
    for (std::size_t i = 0; i < num_chunks_; ++i) directories_.back()[i].set(entry(i));
    directory_.store(directories_.back().get(), std::memory_order_release);
    capacity_ = capacity;
  }

  void forget_what_was_replaced() {
    if (directories_.size() > 1) directories_.erase(directories_.begin(), directories_.end() - 1);
    for (Chunk* const chunk : replaced_) release(chunk);
    replaced_.clear();
  }

  BlockId pop_free(Arena& arena) {
    const BlockId id = arena.first_free_;
    arena.first_free_ = block(id)[0].children();
    return id;
  }
  void push_free(Arena& arena, BlockId id) {
    block(id)[0].become_inner(arena.first_free_);
    arena.first_free_ = id;
  }

  /// Takes free blocks that no thread has, as many as a chunk holds, else a new chunk.
  void refill(Arena& arena) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (&arena != &main_ && main_.first_free_ != kNone) {
      for (BlockId i = 0; i <= kChunkMask && main_.first_free_ != kNone; ++i)
        push_free(arena, pop_free(main_));
      return;
    }
    if ((num_chunks_ + 1) << kChunkBits > kMaxBlocks)
      throw std::length_error("the tree holds 2^31 blocks of nodes: it is full");
    const std::lock_guard<std::mutex> lock_entries(entries_mutex_);
    const bool is_full = num_chunks_ == capacity_;
    const std::size_t capacity = is_full ? std::max<std::size_t>(2 * capacity_, 4) : capacity_;
    if (limit_ != kUnlimitedMemory &&
        (num_chunks_ + 1) * sizeof(Chunk) + capacity * sizeof(Entry) + others_ > limit_)
      throw MemoryLimitReached(limit_);
    if (is_full) make_directory(capacity);
    if (num_lent_ == 0) forget_what_was_replaced();
    entry(num_chunks_).set(new Chunk, false);
    arena.next_unused_ = static_cast<BlockId>(num_chunks_ << kChunkBits);
    arena.end_of_chunk_ = arena.next_unused_ + kChunkMask + 1;
    ++num_chunks_;
  }

  // Every look-up reads directory_, so what threads write meanwhile, from the mutexes on, is in another cache
  // line (no false sharing).
  std::atomic<Entry*> directory_{nullptr};
  std::vector<std::unique_ptr<Entry[]>> directories_;  // The last one is in use.
  std::size_t capacity_ = 0;
  std::size_t limit_ = kUnlimitedMemory;        // Bytes that may be held in all.
  std::size_t others_ = 0;                      // Bytes of limit_ that are not the pool's.
  mutable std::atomic<bool> may_share_{false};  // Some chunk, with another pool.
  int num_lent_ = 0;                            // Arenas that threads work with.
  Arena main_;
  std::mutex entries_mutex_;      // Of chunks that take the place of others, and of directories.
  std::vector<Chunk*> replaced_;  // As long as arenas are lent.
  std::mutex mutex_;              // Of what arenas share; its holder may lock the other one.
  std::size_t num_chunks_ = 0;
};

}  // namespace ndtree
