// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/replaced_file.hpp"

namespace ndtree::test::test_replaced_file {
namespace {

namespace fs = std::filesystem;

class ReplacedFileTest : public testing::Test {
 protected:
  ReplacedFileTest()
      : folder_(fs::path(testing::TempDir()) /
                ("ndtree_replaced_" +
                 std::string(testing::UnitTest::GetInstance()->current_test_info()->name()))) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~ReplacedFileTest() override { fs::remove_all(folder_); }

  [[nodiscard]] std::map<std::string, std::string> contents() const {
    std::map<std::string, std::string> found;
    for (const auto& entry : fs::directory_iterator(folder_))
      found[entry.path().filename().string()] =
          !entry.is_symlink() && entry.is_regular_file() ? read_file(entry.path()) : "";
    return found;
  }
  [[nodiscard]] static int error_of(const std::function<void()>& run) {
    try {
      run();
      return 0;
    } catch (const fs::filesystem_error& error) {
      EXPECT_FALSE(error.path1().empty());
      return error.code().value();
    }
  }

  fs::path folder_;
};

TEST_F(ReplacedFileTest, AppearsWholeOrNotAtAll) {
  const fs::path path = folder_ / "a.txt";
  {
    ReplacedFile file(path);
    file.write("new");
    EXPECT_FALSE(fs::exists(path));
    EXPECT_EQ(file.temporary().extension(), ".txt");
    EXPECT_EQ(file.temporary().filename().string()[0], '.');
  }
  EXPECT_TRUE(contents().empty());
  write_file(path, "one");
  ReplacedFile file(path);
  file.write("two, ");
  file.write("and more");
  EXPECT_EQ(read_file(path), "one");
  ReplacedFile moved(std::move(file));
  moved.commit();
  EXPECT_EQ(contents(), (std::map<std::string, std::string>{{"a.txt", "two, and more"}}));
}

TEST_F(ReplacedFileTest, KeepsWhatIsThere) {
  const fs::path real = folder_ / "real", link = folder_ / "link";
  write_file(real, "one");
  fs::permissions(real, fs::perms(0640));
  fs::create_symlink("real", link);
  write_file(link, "two");
  EXPECT_TRUE(fs::is_symlink(link));
  EXPECT_EQ(read_file(real), "two");
  EXPECT_EQ(fs::status(real).permissions(), fs::perms(0640));
  fs::create_hard_link(real, folder_ / "other");
  EXPECT_EQ(error_of([&] { write_file(real, "three"); }), EMLINK);
  EXPECT_EQ(read_file(folder_ / "other"), "two");
}

TEST_F(ReplacedFileTest, RefusesWhatCannotBeReplaced) {
  EXPECT_EQ(error_of([&] { write_file(folder_, "x"); }), EISDIR);
  EXPECT_EQ(error_of([&] { write_file(folder_ / "none" / "a", "x"); }), ENOENT);
  EXPECT_EQ(error_of([&] { write_file(folder_ / std::string(256, 'n'), "x"); }), ENAMETOOLONG);
  write_file(folder_ / std::string(255, 'n'), "x");
  fs::create_symlink("round", folder_ / "round");
  EXPECT_EQ(error_of([&] { write_file(folder_ / "round", "x"); }), ELOOP);
  ASSERT_EQ(::mkfifo((folder_ / "pipe").c_str(), 0600), 0);
  EXPECT_EQ(error_of([&] { write_file(folder_ / "pipe", "x"); }), ENXIO);
  EXPECT_EQ(error_of([&] { static_cast<void>(read_file(folder_ / "pipe")); }), EINVAL);
  EXPECT_EQ(error_of([] { static_cast<void>(read_file("/dev/zero")); }), EINVAL);
  EXPECT_EQ(contents().size(), 3u);
}

/// The test's own devices: a writer that replaces what it should not must not take the system's.
TEST_F(ReplacedFileTest, DevicesStayDevices) {
  const auto made = [&](const char* name, unsigned minor) {
    const fs::path path = folder_ / name;
    const bool is_made = ::mknod(path.c_str(), S_IFCHR | 0666, makedev(1, minor)) == 0;
    return is_made && std::ofstream(path).is_open();
  };
  if (!made("null", 3) || !made("full", 7)) GTEST_SKIP() << "no right to make devices";
  EXPECT_EQ(error_of([&] { write_file(folder_ / "null", "x"); }), 0);
  EXPECT_EQ(error_of([&] { write_file(folder_ / "full", "x"); }), ENOSPC);
  EXPECT_TRUE(fs::is_character_file(folder_ / "null"));
  EXPECT_TRUE(fs::is_character_file(folder_ / "full"));
}

TEST_F(ReplacedFileTest, WritesIntoAPipe) {
  const fs::path path = folder_ / "pipe";
  ASSERT_EQ(::mkfifo(path.c_str(), 0600), 0);
  std::string got;
  std::thread reader([&] {
    std::ifstream in(path, std::ios::binary);
    got.assign(std::istreambuf_iterator<char>(in), {});
  });
  const std::string large(1 << 20, 'x');
  while (error_of([&] { write_file(path, large); }) == ENXIO) std::this_thread::yield();
  reader.join();
  EXPECT_EQ(got, large);
  EXPECT_TRUE(fs::is_fifo(path));
}

TEST_F(ReplacedFileTest, AFullDiskLeavesTheOldFile) {
  const fs::path path = folder_ / "a";
  write_file(path, "old");
  ::rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  auto* const handler = std::signal(SIGXFSZ, SIG_IGN);
  const ::rlimit little{1000, before.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &little);
  const int error = error_of([&] { write_file(path, std::string(5000, 'x')); });
  ::setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  EXPECT_EQ(error, EFBIG);
  EXPECT_EQ(contents(), (std::map<std::string, std::string>{{"a", "old"}}));
}

TEST_F(ReplacedFileTest, RemovesWhatTheDeadHaveLeftAndNothingElse) {
  std::ofstream(folder_ / ".ndtree-0123456789abcdef.bt") << "of the dead";
  std::ofstream(folder_ / ".ndtree-0123456789abcdef0") << "of a user";
  std::ofstream(folder_ / ".ndtree-notes") << "of a user";
  ReplacedFile alive(folder_ / "b");
  alive.write("slow");
  write_file(folder_ / "a", "x");
  EXPECT_FALSE(fs::exists(folder_ / ".ndtree-0123456789abcdef.bt"));
  EXPECT_TRUE(fs::exists(alive.temporary()));
  alive.commit();
  EXPECT_EQ(contents().size(), 4u);
}

TEST_F(ReplacedFileTest, SeveralAreReplacedTogether) {
  const fs::path one = folder_ / "a.pgm", other = folder_ / "a.yaml";
  for (const bool is_there : {false, true}) {
    const auto before = contents();
    EXPECT_EQ(before.size(), is_there ? 2u : 0u);
    std::vector<ReplacedFile> dropped;
    dropped.emplace_back(one);
    dropped.emplace_back(other);
    dropped.clear();
    EXPECT_EQ(contents(), before);
    std::vector<ReplacedFile> files;
    files.emplace_back(one);
    files.emplace_back(other);
    files[0].write(is_there ? "image 2" : "image 1");
    files[1].write(is_there ? "text 2" : "text 1");
    commit_together(files);
    EXPECT_EQ(contents(),
              is_there ? (std::map<std::string, std::string>{{"a.pgm", "image 2"}, {"a.yaml", "text 2"}})
                       : (std::map<std::string, std::string>{{"a.pgm", "image 1"}, {"a.yaml", "text 1"}}));
  }
  fs::remove(other);
  std::vector<ReplacedFile> files;
  files.emplace_back(one);
  files.emplace_back(other);
  files[0].write("image 3");
  files[1].write("text 3");
  fs::create_directory(other);  // No file can take this place any more.
  EXPECT_EQ(error_of([&] { commit_together(files); }), EISDIR);
  files.clear();
  fs::remove(other);
  EXPECT_EQ(contents(), (std::map<std::string, std::string>{{"a.pgm", "image 2"}}));
}

TEST_F(ReplacedFileTest, WritersAtOnceLeaveOneWholeFile) {
  const fs::path path = folder_ / "a";
  std::vector<std::thread> writers;
  for (int w = 0; w < 4; ++w)
    writers.emplace_back([&, w] {
      for (int i = 0; i < 50; ++i) write_file(path, std::string(1000, static_cast<char>('a' + w)));
    });
  for (std::thread& writer : writers) writer.join();
  const std::string found = read_file(path);
  EXPECT_EQ(found, std::string(1000, found.at(0)));
  EXPECT_EQ(contents().size(), 1u);
}

}  // namespace
}  // namespace ndtree::test::test_replaced_file
