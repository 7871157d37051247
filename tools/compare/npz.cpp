// SPDX-License-Identifier: BSD-3-Clause
#include "npz.hpp"

#include <zlib.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <utility>

#include "ndtree/core/option.hpp"

namespace ndtree {
namespace {

// Signatures of the parts of a zip file (PKWARE's APPNOTE 6.3, sections 4.3 and 4.5).
constexpr std::string_view kLocalHeader = "PK\x03\x04";
constexpr std::string_view kCentralHeader = "PK\x01\x02";
constexpr std::string_view kEndOfDirectory = "PK\x05\x06";
constexpr std::string_view kEndOfDirectory64 = "PK\x06\x06";
constexpr std::string_view kLocator64 = "PK\x06\x07";
constexpr std::uint64_t k16 = 0xffff;      // In a 16-bit field: see the 64-bit record.
constexpr std::uint64_t k32 = 0xffffffff;  // In a 32-bit field.

[[noreturn]] void fail(const std::string& what) { throw std::runtime_error(what); }

std::string_view part(std::string_view bytes, std::uint64_t offset, std::uint64_t size) {
  if (offset > bytes.size() || size > bytes.size() - offset)
    fail("the zip is cut off: expected " + std::to_string(size) + " bytes at " + std::to_string(offset) +
         ", the file has " + std::to_string(bytes.size()));
  return bytes.substr(static_cast<std::size_t>(offset), static_cast<std::size_t>(size));
}

/// Unsigned little-endian number of `size` bytes.
std::uint64_t number(std::string_view bytes, std::uint64_t offset, std::size_t size) {
  std::uint64_t value = 0;
  for (std::size_t i = size; i-- > 0;)
    value = value << 8 | static_cast<unsigned char>(part(bytes, offset, size)[i]);
  return value;
}

void expect(std::string_view bytes, std::uint64_t offset, std::string_view signature, const char* what) {
  if (part(bytes, offset, signature.size()) != signature)
    fail("the zip is damaged: expected " + std::string(what) + " at byte " + std::to_string(offset));
}

struct Member {
  std::string name;
  std::uint64_t flags = 0;
  std::uint64_t method = 0;
  std::uint64_t crc = 0;
  std::uint64_t packed_size = 0;
  std::uint64_t size = 0;
  std::uint64_t offset = 0;
};

/// Takes the 64-bit fields of a member whose 32-bit ones are full.
void read_extra64(std::string_view extra, Member& member) {
  while (extra.size() >= 4) {
    const std::uint64_t id = number(extra, 0, 2);
    std::string_view field = part(extra, 4, number(extra, 2, 2));
    extra.remove_prefix(4 + field.size());
    if (id != 1) continue;
    for (std::uint64_t* value : {&member.size, &member.packed_size, &member.offset}) {
      if (*value != k32) continue;
      *value = number(field, 0, 8);
      field.remove_prefix(8);
    }
  }
}

std::vector<Member> directory(std::string_view zip) {
  constexpr std::size_t kEndSize = 22;
  constexpr std::size_t kLongestComment = 65535;
  const std::size_t first =
      zip.size() < kEndSize + kLongestComment ? 0 : zip.size() - kEndSize - kLongestComment;
  const std::size_t found = zip.substr(first).rfind(kEndOfDirectory);
  if (found == std::string_view::npos) fail("the zip is cut off or damaged: expected a directory at its end");
  const std::size_t end = first + found;
  std::uint64_t count = number(zip, end + 10, 2);
  std::uint64_t offset = number(zip, end + 16, 4);
  if (count == k16 || offset == k32) {
    if (end < 20) fail("the zip is damaged: expected a 64-bit directory");
    expect(zip, end - 20, kLocator64, "a 64-bit directory");
    const std::uint64_t end64 = number(zip, end - 20 + 8, 8);
    expect(zip, end64, kEndOfDirectory64, "a 64-bit directory");
    count = number(zip, end64 + 32, 8);
    offset = number(zip, end64 + 48, 8);
  }
  std::vector<Member> members;
  for (std::uint64_t i = 0; i < count; ++i) {
    expect(zip, offset, kCentralHeader, "an entry of the directory");
    Member member;
    member.flags = number(zip, offset + 8, 2);
    member.method = number(zip, offset + 10, 2);
    member.crc = number(zip, offset + 16, 4);
    member.packed_size = number(zip, offset + 20, 4);
    member.size = number(zip, offset + 24, 4);
    member.offset = number(zip, offset + 42, 4);
    const std::uint64_t name_size = number(zip, offset + 28, 2);
    const std::uint64_t extra_size = number(zip, offset + 30, 2);
    member.name = part(zip, offset + 46, name_size);
    read_extra64(part(zip, offset + 46 + name_size, extra_size), member);
    offset += 46 + name_size + extra_size + number(zip, offset + 32, 2);
    members.push_back(std::move(member));
  }
  return members;
}

/// Chunks that zlib's 32-bit counts hold.
uInt chunk(std::size_t size) {
  return static_cast<uInt>(std::min<std::size_t>(size, std::numeric_limits<uInt>::max()));
}

std::string inflated(std::string_view packed, std::uint64_t size) {
  constexpr std::uint64_t kBestRatio = 1032;  // Of deflate; a larger size cannot be true.
  if (size / kBestRatio > packed.size())
    fail("damaged: it cannot unpack to " + std::to_string(size) + " bytes");
  std::string result(static_cast<std::size_t>(size), '\0');
  z_stream stream{};
  if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) fail("zlib has no memory to unpack it");
  std::size_t taken = 0;
  std::size_t given = 0;
  int status = Z_OK;
  while (status == Z_OK) {
    const uInt in = chunk(packed.size() - taken);
    const uInt out = chunk(result.size() - given);
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data() + taken));
    stream.avail_in = in;
    stream.next_out = reinterpret_cast<Bytef*>(result.data() + given);
    stream.avail_out = out;
    status = inflate(&stream, Z_NO_FLUSH);
    taken += in - stream.avail_in;
    given += out - stream.avail_out;
  }
  inflateEnd(&stream);
  if (status != Z_STREAM_END || given != result.size())
    fail("damaged: unpacked " + std::to_string(given) + " of " + std::to_string(size) + " bytes");
  return result;
}

std::uint64_t checksum(std::string_view bytes) {
  uLong sum = crc32(0, nullptr, 0);
  while (!bytes.empty()) {
    const uInt size = chunk(bytes.size());
    sum = crc32(sum, reinterpret_cast<const Bytef*>(bytes.data()), size);
    bytes.remove_prefix(size);
  }
  return sum;
}

std::string unpacked(std::string_view zip, const Member& member) {
  if ((member.flags & 1) != 0) fail("encrypted: expected a file without password");
  expect(zip, member.offset, kLocalHeader, "a file");
  const std::uint64_t name_size = number(zip, member.offset + 26, 2);
  if (part(zip, member.offset + 30, name_size) != member.name)
    fail("the zip is damaged: expected the same name at byte " + std::to_string(member.offset + 30));
  const std::uint64_t begin = member.offset + 30 + name_size + number(zip, member.offset + 28, 2);
  const std::string_view packed = part(zip, begin, member.packed_size);
  std::string bytes;
  if (member.method == 8)
    bytes = inflated(packed, member.size);
  else if (member.method == 0 && member.packed_size == member.size)
    bytes = packed;
  else
    fail("compression method " + std::to_string(member.method) + ": expected 0, stored, or 8, deflated");
  if (checksum(bytes) != member.crc) fail("damaged: its checksum is wrong");
  return bytes;
}

/// The value behind 'key': in the dictionary of an .npy header, and all that follows.
std::string_view value_of(std::string_view header, const char* key) {
  const std::string quoted = "'" + std::string(key) + "':";
  const std::size_t at = header.find(quoted);
  if (at == std::string_view::npos) fail("damaged: its header has no '" + std::string(key) + "'");
  header.remove_prefix(at + quoted.size());
  header.remove_prefix(std::min(header.find_first_not_of(' '), header.size()));
  return header;
}

std::vector<std::size_t> parse_shape(std::string_view value) {
  const std::size_t end = value.find(')');
  if (value.empty() || value.front() != '(' || end == std::string_view::npos)
    fail("damaged: its header has no shape");
  std::vector<std::size_t> shape;
  bool in_number = false;
  for (const char c : value.substr(1, end - 1)) {
    const bool digit = c >= '0' && c <= '9';
    if (!digit && c != ',' && c != ' ') fail("damaged: its header has no shape");
    if (digit) {
      if (!in_number) shape.push_back(0);
      if (shape.back() > std::numeric_limits<std::size_t>::max() / 100)
        fail("damaged: its shape is too large");
      shape.back() = shape.back() * 10 + static_cast<std::size_t>(c - '0');
    }
    in_number = digit;
  }
  return shape;
}

NpyArray parse_npy(std::string bytes) {
  constexpr std::string_view kMagic = "\x93NUMPY";
  if (bytes.compare(0, kMagic.size(), kMagic) != 0 || bytes.size() < 12) fail("expected a .npy file");
  const std::size_t count_size = bytes[6] == 1 ? 2 : 4;  // Versions 2 and 3 differ from 1 in this alone.
  if (bytes[6] < 1 || bytes[6] > 3) fail("expected .npy version 1 to 3");
  const auto header_size = static_cast<std::size_t>(number(bytes, 8, count_size));
  const std::string header(part(bytes, 8 + count_size, header_size));

  const std::string_view type = value_of(header, "descr");
  NpyArray array;
  constexpr std::string_view kTypes[] = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"};
  const bool known = type.size() >= 5 && type[0] == '\'' && type[4] == '\'' &&
                     (type[1] == '<' || (type[1] == '|' && type[3] == '1')) &&
                     std::find(std::begin(kTypes), std::end(kTypes), type.substr(2, 2)) != std::end(kTypes);
  if (!known)
    fail("type " + describe_text(type.substr(type.substr(0, 1) == "'", type.find_first_of("',", 1) - 1)) +
         ": expected little-endian numbers, '<f4', '<f8', '<i8', '|b1' or alike");
  array.kind = type[2];
  array.item_size = static_cast<std::size_t>(type[3] - '0');
  array.fortran_order = value_of(header, "fortran_order").substr(0, 4) == "True";
  array.shape = parse_shape(value_of(header, "shape"));
  if (array.shape.size() > 2) fail(array.description() + ": expected at most two dimensions");

  bytes.erase(0, 8 + count_size + header_size);
  std::size_t size = array.item_size;
  for (const std::size_t n : array.shape) {
    if (n != 0 && size > bytes.size() / n + 1)
      size = bytes.size() + 1;
    else
      size *= n;
  }
  if (size != bytes.size())
    fail(array.description() + ": does not fit its " + std::to_string(bytes.size()) + " bytes of data");
  array.data = std::move(bytes);
  return array;
}

template <class T>
double element(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

}  // namespace

double NpyArray::at(std::size_t row, std::size_t column) const {
  const char* const bytes =
      data.data() + item_size * (fortran_order ? column * rows() + row : row * columns() + column);
  switch (kind) {
    case 'f':
      return item_size == 4 ? element<float>(bytes) : element<double>(bytes);
    case 'i':
      return item_size == 1   ? element<std::int8_t>(bytes)
             : item_size == 2 ? element<std::int16_t>(bytes)
             : item_size == 4 ? element<std::int32_t>(bytes)
                              : element<std::int64_t>(bytes);
    default:
      return item_size == 1   ? element<std::uint8_t>(bytes)
             : item_size == 2 ? element<std::uint16_t>(bytes)
             : item_size == 4 ? element<std::uint32_t>(bytes)
                              : element<std::uint64_t>(bytes);
  }
}

std::string NpyArray::description() const {
  const char* const name = kind == 'f' ? "float" : kind == 'i' ? "int" : kind == 'u' ? "uint" : "bool";
  std::string text = kind == 'b' ? name : name + std::to_string(8 * item_size);
  text += " (";
  for (std::size_t i = 0; i < shape.size(); ++i) text += (i ? ", " : "") + std::to_string(shape[i]);
  return text + (shape.size() == 1 ? ",)" : ")");
}

bool looks_like_zip(std::string_view bytes) {
  return bytes.substr(0, 4) == kLocalHeader || bytes.substr(0, 4) == kEndOfDirectory;
}

std::map<std::string, NpyArray> read_npz(std::string_view bytes, const std::vector<std::string>& names) {
  std::map<std::string, NpyArray> arrays;
  for (const Member& member : directory(bytes)) {
    const auto name = std::find_if(names.begin(), names.end(),
                                   [&](const std::string& wanted) { return member.name == wanted + ".npy"; });
    if (name == names.end()) continue;
    try {
      arrays[*name] = parse_npy(unpacked(bytes, member));
    } catch (const std::runtime_error& error) {
      fail(member.name + ": " + error.what());
    }
  }
  return arrays;
}

}  // namespace ndtree
