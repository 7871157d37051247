// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Storage of a tree: nodes, and a pool of blocks of siblings addressed by 32-bit ids.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

namespace ndtree {

/// Id of a block of N^D siblings; below 2^31, so that one bit of a node's first word tells leaf from inner
/// node.
using BlockId = std::uint32_t;

/// One node: the cell of a leaf, or an inner node's link to the block of its children.
/// A cell that declares `static constexpr bool kLeavesTopBitOfFirstWordClear = true`, and keeps that promise
/// with a std::uint32_t as its first member, shares its memory with the link: the node is then no larger than
/// the cell. Any other cell stands beside the link.
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
    cell_ = Cell{};
  }

 private:
  static constexpr std::uint32_t kInner = 0x80000000u;
  std::uint32_t link_ = 0;
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
  void become_inner(BlockId children) { link_ = Link{kInner | children}; }

 private:
  static constexpr std::uint32_t kInner = 0x80000000u;
  struct Link {
    std::uint32_t word;
  };
  union {  // Both begin with one std::uint32_t, their common initial sequence: it may be read through either.
    Cell cell_;
    Link link_;
  };
};

/// Blocks of `kBlockSize` nodes in chunks that never move: nodes keep their addresses while the pool grows.
/// Freed blocks are used again, the last freed first. Copyable; a copy keeps all ids.
template <class NodeType, int kBlockSize>
class NodePool {
  using Chunk = std::unique_ptr<std::byte[]>;
  static_assert(std::is_trivially_copyable_v<NodeType> && std::is_trivially_destructible_v<NodeType>);
  static_assert(alignof(NodeType) <= __STDCPP_DEFAULT_NEW_ALIGNMENT__);

 public:
  NodePool() = default;
  NodePool(NodePool&& other) noexcept { swap(other); }
  NodePool(const NodePool& other)
      : next_unused_(other.next_unused_), first_free_(other.first_free_), num_blocks_(other.num_blocks_) {
    chunks_.reserve(other.chunks_.size());
    for (const auto& chunk : other.chunks_) {
      chunks_.push_back(allocate_chunk());
      std::memcpy(chunks_.back().get(), chunk.get(), kChunkBytes);
    }
  }
  NodePool& operator=(NodePool other) noexcept {
    swap(other);
    return *this;
  }
  ~NodePool() = default;

  /// Siblings of a block, `kBlockSize` of them.
  [[nodiscard]] NodeType* block(BlockId id) {
    return std::launder(reinterpret_cast<NodeType*>(chunks_[id >> kChunkBits].get())) +
           (id & kChunkMask) * kBlockSize;
  }
  [[nodiscard]] const NodeType* block(BlockId id) const { return const_cast<NodePool*>(this)->block(id); }

  /// A block of default nodes. @throws std::length_error beyond 2^31 blocks.
  BlockId allocate() {
    BlockId id = first_free_;
    if (id != kNone) {
      first_free_ = block(id)[0].children();
    } else {
      if (next_unused_ == kMaxBlocks)
        throw std::length_error("the tree holds 2^31 blocks of nodes: it is full");
      if ((next_unused_ >> kChunkBits) == chunks_.size()) chunks_.push_back(allocate_chunk());
      id = next_unused_++;
    }
    std::uninitialized_fill_n(block(id), kBlockSize, NodeType{});
    ++num_blocks_;
    return id;
  }

  void free(BlockId id) {
    block(id)[0].become_inner(first_free_);
    first_free_ = id;
    --num_blocks_;
  }

  [[nodiscard]] std::size_t num_blocks() const { return num_blocks_; }
  /// Bytes that a pool with so many blocks holds if it was made for them.
  [[nodiscard]] static std::size_t memory_bytes_of(std::size_t num_blocks) {
    const std::size_t chunks = (num_blocks + kChunkMask) >> kChunkBits;
    return chunks * (kChunkBytes + sizeof(Chunk));
  }
  /// Room for so many blocks in the directory; none is allocated.
  void reserve(std::size_t num_blocks) { chunks_.reserve((num_blocks + kChunkMask) >> kChunkBits); }
  /// Bytes held, used or not.
  [[nodiscard]] std::size_t memory_bytes() const {
    return chunks_.size() * kChunkBytes + chunks_.capacity() * sizeof(chunks_[0]);
  }

  void swap(NodePool& other) noexcept {
    std::swap(chunks_, other.chunks_);
    std::swap(next_unused_, other.next_unused_);
    std::swap(first_free_, other.first_free_);
    std::swap(num_blocks_, other.num_blocks_);
  }

 private:
  static constexpr BlockId kMaxBlocks = 0x7fffffffu;
  static constexpr BlockId kNone = 0x7fffffffu;
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

  static Chunk allocate_chunk() { return Chunk(new std::byte[kChunkBytes]); }

  std::vector<Chunk> chunks_;
  BlockId next_unused_ = 0;
  BlockId first_free_ = kNone;
  std::size_t num_blocks_ = 0;
};

}  // namespace ndtree
