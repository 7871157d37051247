// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Files that appear whole or not at all, on POSIX systems.
#pragma once

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <random>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

namespace ndtree {

/// Why a file cannot be read or written, in words, where the system's own error would not say it.
class FileError : public std::filesystem::filesystem_error {
 public:
  FileError(const std::filesystem::path& path, int error, std::string reason)
      : filesystem_error(reason, path, std::error_code(error, std::generic_category())),
        reason_(std::move(reason)) {}
  [[nodiscard]] const std::string& reason() const { return reason_; }

 private:
  std::string reason_;
};

/// The system's last error about a file.
[[nodiscard]] inline std::filesystem::filesystem_error file_error(const char* what,
                                                                  const std::filesystem::path& path,
                                                                  int error) {
  return {what, path, std::error_code(error != 0 ? error : EIO, std::generic_category())};
}

namespace detail {

/// A file descriptor with one owner.
class Descriptor {
 public:
  explicit Descriptor(int number = -1) : number_(number) {}
  Descriptor(Descriptor&& other) noexcept : number_(std::exchange(other.number_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(number_, other.number_);
    return *this;
  }
  ~Descriptor() {
    if (number_ >= 0) ::close(number_);
  }
  [[nodiscard]] bool is_open() const { return number_ >= 0; }
  [[nodiscard]] int operator*() const { return number_; }

 private:
  int number_;
};

inline constexpr std::string_view kTemporaryPrefix = ".ndtree-";
inline constexpr std::size_t kTemporaryDigits = 16;

/// Whether a name is one that ReplacedFile makes.
[[nodiscard]] inline bool is_temporary_name(std::string_view name) {
  if (name.substr(0, kTemporaryPrefix.size()) != kTemporaryPrefix) return false;
  name.remove_prefix(kTemporaryPrefix.size());
  const std::size_t digits = name.find_first_not_of("0123456789abcdef");
  return std::min(digits, name.size()) == kTemporaryDigits &&
         (digits == std::string_view::npos || name[digits] == '.');
}

/// A hidden name that is as short for a target with a long name, and keeps its ending.
[[nodiscard]] inline std::filesystem::path temporary_name(const std::filesystem::path& folder,
                                                          const std::filesystem::path& ending) {
  std::random_device random;
  std::array<char, kTemporaryDigits + 1> digits{};
  std::snprintf(digits.data(), digits.size(), "%08x%08x", static_cast<unsigned>(random()),
                static_cast<unsigned>(random()));
  std::string name = std::string(kTemporaryPrefix) + digits.data();
  if (ending.native().size() <= 16) name += ending.string();
  return folder / name;
}

/// Removes what writers that were killed have left in a folder: their locks are gone.
inline void remove_abandoned(const std::filesystem::path& folder) {
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (!is_temporary_name(entry->path().filename().string())) continue;
    const Descriptor file(::open(entry->path().c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC));
    struct ::stat about {};
    if (file.is_open() && ::fstat(*file, &about) == 0 && S_ISREG(about.st_mode) &&
        ::flock(*file, LOCK_EX | LOCK_NB) == 0)
      ::unlink(entry->path().c_str());
  }
}

/// Where a symbolic link leads in the end, also if nothing is there.
[[nodiscard]] inline std::filesystem::path behind_links(const std::filesystem::path& path) {
  std::filesystem::path at = path;
  std::error_code error;
  for (int links = 0; std::filesystem::is_symlink(std::filesystem::symlink_status(at, error)); ++links) {
    if (links == 40) throw file_error("cannot write", path, ELOOP);
    const std::filesystem::path to = std::filesystem::read_symlink(at, error);
    if (error) throw file_error("cannot write", path, error.value());
    at = at.parent_path() / to;
  }
  return at;
}

/// @returns the system's error number, 0 if all bytes were written.
[[nodiscard]] inline int write_all(int file, std::string_view bytes) {
  while (!bytes.empty()) {
    const auto written = ::write(file, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return errno;
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
  return 0;
}

/// @returns the system's error number; some file systems cannot sync a folder, which is no error.
[[nodiscard]] inline int sync_folder(const std::filesystem::path& folder) {
  const Descriptor opened(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!opened.is_open() || ::fsync(*opened) == 0) return 0;
  return errno == EINVAL || errno == ENOTSUP ? 0 : errno;
}

}  // namespace detail

/// A file that is written under a hidden name beside its target, and takes the target's place when it is
/// whole and on the disk: readers see the old file or the new one, also after a crash, and also if several
/// programs write it at once.
///
/// Links are followed, and the mode and owner of a file that is there are kept. A stream (a pipe, a terminal,
/// /dev/null) is not replaced: what was written goes into it. Refused at once are folders, block devices and
/// sockets, a FIFO without a reader, a file that may not be written, and one with several hard links, of
/// which only one would be replaced.
///
/// The hidden file is removed when the object ends. A writer that is killed leaves it; the next one that
/// writes into the folder removes it.
class ReplacedFile {
 public:
  /// @throws std::filesystem::filesystem_error naming the target, and the system's or our reason.
  explicit ReplacedFile(std::filesystem::path target) : target_(std::move(target)) {
    look_at_target();
    const std::filesystem::path folder = stream_.is_open()          ? std::filesystem::temp_directory_path()
                                         : place_.has_parent_path() ? place_.parent_path()
                                                                    : std::filesystem::path(".");
    for (int attempt = 0; !file_.is_open(); ++attempt) {
      temporary_ = detail::temporary_name(folder, target_.extension());
      // O_EXCL: never a file that is there already.
      file_ = detail::Descriptor(::open(temporary_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666));
      if (!file_.is_open() && (errno != EEXIST || attempt == 100)) fail(errno);
      if (file_.is_open() && !is_ours()) file_ = detail::Descriptor();
    }
    if (mode_ && ::fchmod(*file_, *mode_ | S_IRUSR | S_IWUSR) != 0) fail(errno);
    detail::remove_abandoned(folder);
  }
  ReplacedFile(ReplacedFile&& other) noexcept
      : target_(std::move(other.target_)),
        place_(std::move(other.place_)),
        temporary_(std::exchange(other.temporary_, {})),
        file_(std::move(other.file_)),
        stream_(std::move(other.stream_)),
        mode_(other.mode_),
        owner_(other.owner_),
        group_(other.group_) {}
  ReplacedFile& operator=(ReplacedFile&&) = delete;
  ~ReplacedFile() { discard(); }

  /// Where what is to become the file is written, by write() or by others.
  [[nodiscard]] const std::filesystem::path& temporary() const { return temporary_; }

  /// Appends. @throws std::filesystem::filesystem_error naming the target.
  void write(std::string_view bytes) {
    if (const int error = detail::write_all(*file_, bytes); error != 0) fail(error);
  }

  /// Takes the target's place. @throws std::filesystem::filesystem_error; the target is then as it was.
  void commit() {
    seal();
    if (!stream_.is_open()) {
      if (::rename(temporary_.c_str(), place_.c_str()) != 0) fail(errno);
      temporary_.clear();
      if (const int error = detail::sync_folder(folder()); error != 0) fail(error);
    }
    discard();
  }

  /// Forgets what was written.
  void discard() noexcept {
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
    temporary_.clear();
    file_ = detail::Descriptor();
  }

  friend void commit_together(std::vector<ReplacedFile>& files);

 private:
  [[noreturn]] void fail(int error) const { throw file_error("cannot write", target_, error); }
  [[noreturn]] void refuse(int error, const std::string& reason) const {
    throw FileError(target_, error, reason);
  }
  [[nodiscard]] std::filesystem::path folder() const {
    return place_.has_parent_path() ? place_.parent_path() : std::filesystem::path(".");
  }

  void look_at_target() {
    struct ::stat about {};
    if (::stat(target_.c_str(), &about) != 0) {
      if (errno != ENOENT) fail(errno);
      place_ = detail::behind_links(target_);
      return;
    }
    if (S_ISFIFO(about.st_mode) || S_ISCHR(about.st_mode)) {
      stream_ = detail::Descriptor(::open(target_.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
      if (!stream_.is_open() && errno == ENXIO) refuse(ENXIO, "is a stream that nobody reads");
      if (!stream_.is_open()) fail(errno);
      const int flags = ::fcntl(*stream_, F_GETFL);
      ::fcntl(*stream_, F_SETFL, flags & ~O_NONBLOCK);
      place_ = target_;
      return;
    }
    if (S_ISDIR(about.st_mode)) fail(EISDIR);
    if (!S_ISREG(about.st_mode)) refuse(EINVAL, "is a device or a socket, expected a file");
    if (about.st_nlink > 1)
      refuse(EMLINK, "has " + std::to_string(about.st_nlink) +
                         " names (hard links), of which writing would replace one; expected one name");
    if (::faccessat(AT_FDCWD, target_.c_str(), W_OK, AT_EACCESS) != 0) fail(errno);
    place_ = detail::behind_links(target_);
    mode_ = about.st_mode & 0777;
    owner_ = about.st_uid;
    group_ = about.st_gid;
  }

  /// Locks the file that was just made, unless remove_abandoned() was faster.
  [[nodiscard]] bool is_ours() const {
    struct ::stat about {};
    const bool locked = ::flock(*file_, LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK;
    return locked && ::fstat(*file_, &about) == 0 && about.st_nlink > 0;
  }

  /// Brings what was written to the disk, or into the stream. Others may have put another file at
  /// temporary().
  void seal() {
    detail::Descriptor written(::open(temporary_.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
    if (!written.is_open()) fail(errno);
    if (stream_.is_open()) {
      std::vector<char> part(1 << 16);
      for (;;) {
        const auto count = ::read(*written, part.data(), part.size());
        if (count < 0 && errno == EINTR) continue;
        if (count < 0) fail(errno);
        if (count == 0) return;
        const std::string_view bytes(part.data(), static_cast<std::size_t>(count));
        if (const int error = detail::write_all(*stream_, bytes); error != 0) fail(error);
      }
    }
    if (mode_) {
      // Who may not give files away keeps them.
      if (::fchown(*written, owner_, group_) != 0 && errno != EPERM && errno != EINVAL) fail(errno);
      if (::fchmod(*written, *mode_) != 0) fail(errno);
    }
    if (::fsync(*written) != 0) fail(errno);
  }

  std::filesystem::path target_;  ///< As the caller named it.
  std::filesystem::path place_;   ///< What is replaced: the target behind its links.
  std::filesystem::path temporary_;
  detail::Descriptor file_;
  detail::Descriptor stream_;     ///< Open if the target is one.
  std::optional<::mode_t> mode_;  ///< Of the file that is there; none if there is none.
  ::uid_t owner_ = 0;
  ::gid_t group_ = 0;
};

/// Puts files into their places that only together make sense, the one that names the others last.
///
/// Of several, while it happens, which takes microseconds, the replaced files are not there: a reader
/// that comes then, or after a crash just then, finds no file rather than one that describes others.
/// @throws std::filesystem::filesystem_error; all targets are then as they were.
inline void commit_together(std::vector<ReplacedFile>& files) {
  if (files.size() == 1) return files.front().commit();
  for (ReplacedFile& file : files) file.seal();
  struct Before {  // The old file, if there is one, and where it waits.
    std::filesystem::path path;
    detail::Descriptor lock;
  };
  std::vector<Before> before(files.size());
  const ReplacedFile* failed = nullptr;
  int error = 0;
  const auto move = [&](const ReplacedFile& file, const auto& from, const auto& to) {
    if (::rename(from.c_str(), to.c_str()) == 0) return true;
    error = errno;
    failed = &file;
    return false;
  };
  for (std::size_t i = files.size(); i-- > 0 && failed == nullptr;) {
    if (!files[i].mode_) continue;
    Before old{detail::temporary_name(files[i].folder(), files[i].target_.extension()),
               detail::Descriptor(::open(files[i].place_.c_str(), O_RDONLY | O_CLOEXEC))};
    if (old.lock.is_open()) ::flock(*old.lock, LOCK_EX | LOCK_NB);
    if (move(files[i], files[i].place_, old.path)) before[i] = std::move(old);
  }
  std::size_t placed = 0;
  while (placed < files.size() && failed == nullptr &&
         (files[placed].stream_.is_open() ||
          move(files[placed], files[placed].temporary_, files[placed].place_)))
    ++placed;
  if (failed != nullptr) {
    for (std::size_t i = 0; i < files.size(); ++i) {
      if (!before[i].path.empty())
        ::rename(before[i].path.c_str(), files[i].place_.c_str());
      else if (i < placed && !files[i].stream_.is_open())
        ::unlink(files[i].place_.c_str());
    }
    failed->fail(error);
  }
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (!before[i].path.empty()) ::unlink(before[i].path.c_str());
    if (!files[i].stream_.is_open())
      if (const int at_folder = detail::sync_folder(files[i].folder()); at_folder != 0)
        files[i].fail(at_folder);
    files[i].discard();
  }
}

/// Writes a whole file as ReplacedFile does.
/// @throws std::filesystem::filesystem_error naming the file and the reason; nothing is left behind.
inline void write_file(const std::filesystem::path& path, std::string_view bytes) {
  ReplacedFile file(path);
  file.write(bytes);
  file.commit();
}

}  // namespace ndtree
