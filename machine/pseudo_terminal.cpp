#include "machine/pseudo_terminal.h"

#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstring>

#include "design/core/errors.h"

namespace lightmill {

namespace {

// Links to remove when a signal ends the process. Plain arrays: a signal handler may not allocate.
constexpr std::size_t kMostLinks = 8, kLongestPath = 1024;
std::array<std::array<char, kLongestPath>, kMostLinks> g_links;
std::array<std::atomic<bool>, kMostLinks> g_link_used;

extern "C" void remove_links_and_die(int signal) {
  for (std::size_t i = 0; i < kMostLinks; ++i) {
    if (g_link_used[i].load()) ::unlink(g_links[i].data());
  }
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

void remember_link(const std::string& path) {
  if (path.size() >= kLongestPath) return;
  for (std::size_t i = 0; i < kMostLinks; ++i) {
    if (g_link_used[i].load()) continue;
    std::memcpy(g_links[i].data(), path.c_str(), path.size() + 1);
    g_link_used[i].store(true);
    break;
  }
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction now {};
    // Who handles the signal already unwinds and so destroys the terminal.
    if (sigaction(signal, nullptr, &now) == 0 && now.sa_handler == SIG_DFL) std::signal(signal, remove_links_and_die);
  }
}

void forget_link(const std::string& path) {
  for (std::size_t i = 0; i < kMostLinks; ++i) {
    if (g_link_used[i].load() && path == g_links[i].data()) {
      g_link_used[i].store(false);
      return;
    }
  }
}

[[noreturn]] void fail(const std::string& what) {
  throw IoError(what + ": " + std::strerror(errno));
}

}  // namespace

PseudoTerminal::PseudoTerminal(const std::filesystem::path& link) : link_(link) {
  fd_ = ::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (fd_ < 0) fail("cannot make a pseudo-terminal");
  std::array<char, 128> name{};
  const auto give_up = [&](const std::string& what) {
    const int reason = errno;
    hang_up();
    errno = reason;
    fail(what);
  };
  if (::grantpt(fd_) != 0 || ::unlockpt(fd_) != 0 || ::ptsname_r(fd_, name.data(), name.size()) != 0) {
    give_up("cannot open the far end of a pseudo-terminal");
  }
  far_end_ = name.data();
  keep_open_fd_ = ::open(far_end_.c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (keep_open_fd_ < 0) give_up("cannot open " + far_end_);
  termios settings{};
  if (::tcgetattr(keep_open_fd_, &settings) != 0) give_up("cannot configure " + far_end_);
  ::cfmakeraw(&settings);
  if (::tcsetattr(keep_open_fd_, TCSANOW, &settings) != 0) give_up("cannot configure " + far_end_);
  ::fcntl(fd_, F_SETFL, ::fcntl(fd_, F_GETFL) | O_NONBLOCK);

  if (link_.empty()) return;
  // A dead link of an earlier run may be replaced, anything else may not.
  std::error_code ignored;
  if (std::filesystem::is_symlink(link_, ignored)) std::filesystem::remove(link_, ignored);
  if (::symlink(far_end_.c_str(), link_.c_str()) != 0) {
    const std::string path = link_.string();
    link_.clear();
    give_up("cannot make the link " + path + " to a pseudo-terminal (is there a file of that name?)");
  }
  remember_link(link_.string());
}

PseudoTerminal::~PseudoTerminal() {
  hang_up();
  if (link_.empty()) return;
  forget_link(link_.string());
  // Only our own link: another machine may have taken the name since.
  std::error_code ignored;
  if (std::filesystem::read_symlink(link_, ignored) == far_end_) std::filesystem::remove(link_, ignored);
}

void PseudoTerminal::hang_up() {
  for (int* fd : {&keep_open_fd_, &fd_}) {
    if (*fd >= 0) ::close(*fd);
    *fd = -1;
  }
}

std::size_t PseudoTerminal::read_some(std::span<char> buffer, std::chrono::milliseconds deadline) {
  if (fd_ < 0) return 0;
  for (;;) {
    const ssize_t count = ::read(fd_, buffer.data(), buffer.size());
    if (count > 0) return static_cast<std::size_t>(count);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0 && errno != EAGAIN && errno != EIO) fail("cannot read from the pseudo-terminal");
    if (deadline.count() <= 0) return 0;
    pollfd waiting{fd_, POLLIN, 0};
    const int ready = ::poll(&waiting, 1, static_cast<int>(deadline.count()));
    if (ready <= 0) {
      // A client that died has left its claim to the port behind, because our own hold keeps the terminal open.
      ::ioctl(keep_open_fd_, TIOCNXCL);
      return 0;
    }
    deadline = std::chrono::milliseconds(0);
  }
}

std::size_t PseudoTerminal::write_some(std::span<const char> bytes, std::chrono::milliseconds deadline) {
  if (fd_ < 0) return 0;
  const auto end = std::chrono::steady_clock::now() + deadline;
  std::size_t written = 0;
  while (written < bytes.size()) {
    const ssize_t count = ::write(fd_, bytes.data() + written, bytes.size() - written);
    if (count > 0) {
      written += static_cast<std::size_t>(count);
      continue;
    }
    if (count < 0 && errno == EINTR) continue;
    if (count < 0 && errno != EAGAIN && errno != EIO) fail("cannot write to the pseudo-terminal");
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    if (left.count() <= 0) break;
    pollfd waiting{fd_, POLLOUT, 0};
    ::poll(&waiting, 1, static_cast<int>(left.count()));
  }
  return written;
}

}  // namespace lightmill
