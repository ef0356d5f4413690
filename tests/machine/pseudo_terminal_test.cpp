#include "machine/pseudo_terminal.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <string>

#include "design/core/errors.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;

std::filesystem::path scratch(const std::string& name) {
  const auto folder = std::filesystem::temp_directory_path() / ("lightmill_pty_" + std::to_string(::getpid()));
  std::filesystem::create_directories(folder);
  return folder / name;
}

std::string read_all(PseudoTerminal& terminal, std::size_t size) {
  std::string text;
  char bytes[256];
  while (text.size() < size) {
    const std::size_t count = terminal.read_some(bytes, milliseconds(1000));
    if (count == 0) break;
    text.append(bytes, count);
  }
  return text;
}

TEST(PseudoTerminal, CarriesAllBytesUnchanged) {
  PseudoTerminal terminal{std::filesystem::path()};
  const int fd = ::open(terminal.far_end().c_str(), O_RDWR | O_NOCTTY);
  ASSERT_GE(fd, 0);
  std::string all;
  for (int i = 0; i < 256; ++i) all += static_cast<char>(i);
  ASSERT_EQ(::write(fd, all.data(), all.size()), 256);
  EXPECT_EQ(read_all(terminal, 256), all);
  EXPECT_EQ(terminal.write_some(all, milliseconds(1000)), 256U);
  std::string back(256, '\0');
  std::size_t got = 0;
  while (got < 256) {
    const ssize_t count = ::read(fd, back.data() + got, 256 - got);
    ASSERT_GT(count, 0);
    got += static_cast<std::size_t>(count);
  }
  EXPECT_EQ(back, all);
  ::close(fd);
}

TEST(PseudoTerminal, OutlivesItsClients) {
  PseudoTerminal terminal{std::filesystem::path()};
  for (const char* text : {"first", "second"}) {
    const int fd = ::open(terminal.far_end().c_str(), O_RDWR | O_NOCTTY);
    ASSERT_GE(fd, 0);
    ASSERT_GT(::write(fd, text, std::string(text).size()), 0);
    EXPECT_EQ(read_all(terminal, std::string(text).size()), text);
    ::close(fd);
    char byte[1];
    EXPECT_EQ(terminal.read_some(byte, milliseconds(1)), 0U);
  }
}

TEST(PseudoTerminal, NobodyReadingIsADeadlineNotAHang) {
  PseudoTerminal terminal{std::filesystem::path()};
  const std::string much(1 << 20, 'x');
  const std::size_t taken = terminal.write_some(much, milliseconds(20));
  EXPECT_GT(taken, 0U);
  EXPECT_LT(taken, much.size());
}

TEST(PseudoTerminal, LinkIsThereAndGone) {
  const auto link = scratch("port");
  {
    const PseudoTerminal terminal(link);
    EXPECT_EQ(std::filesystem::read_symlink(link), terminal.far_end());
  }
  EXPECT_FALSE(std::filesystem::is_symlink(link));
  // A dead link is replaced, a file is not.
  std::filesystem::create_symlink("/nowhere", link);
  { const PseudoTerminal terminal(link); }
  std::ofstream(link) << "mine";
  EXPECT_THROW(PseudoTerminal{link}, IoError);
  EXPECT_TRUE(std::filesystem::is_regular_file(link));
  std::filesystem::remove(link);
}

TEST(PseudoTerminal, LinkGoesWithAKilledProcess) {
  const auto link = scratch("killed");
  const pid_t child = ::fork();
  if (child == 0) {
    const PseudoTerminal terminal(link);
    ::pause();
    _exit(0);
  }
  for (int i = 0; i < 200 && !std::filesystem::is_symlink(link); ++i) ::usleep(10000);
  ASSERT_TRUE(std::filesystem::is_symlink(link));
  ::usleep(20000);  // the handler is set after the link
  ::kill(child, SIGTERM);
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status));
  EXPECT_EQ(WTERMSIG(status), SIGTERM);
  EXPECT_FALSE(std::filesystem::is_symlink(link));
}

}  // namespace
}  // namespace lightmill
