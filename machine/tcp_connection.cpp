#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "design/core/errors.h"
#include "machine/connection.h"

namespace lightmill {

namespace {

using std::chrono::milliseconds;

constexpr std::string_view kScheme = "tcp://";
constexpr milliseconds kConnectTimeout{5000};

class TcpConnection final : public Connection {
 public:
  TcpConnection(const std::string& host, const std::string& port) : name_(std::string(kScheme) + host + ":" + port) {
    addrinfo hints{};
    hints.ai_family = AF_UNSPEC;
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (const int error = ::getaddrinfo(host.c_str(), port.c_str(), &hints, &found); error != 0) {
      throw IoError("cannot find " + name_ + ": " + ::gai_strerror(error));
    }
    std::string reason = "no address";
    for (const addrinfo* address = found; address != nullptr && fd_ < 0; address = address->ai_next) {
      if (!connect_to(*address)) reason = std::strerror(errno);
    }
    ::freeaddrinfo(found);
    if (fd_ < 0) throw IoError("cannot connect to " + name_ + ": " + reason + " (is the serial server on, is it the right port?)");
    const int on = 1;
    ::setsockopt(fd_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);  // a feed hold does not wait for company
    ::setsockopt(fd_, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
  }
  ~TcpConnection() override { ::close(fd_); }
  TcpConnection(const TcpConnection&) = delete;
  TcpConnection& operator=(const TcpConnection&) = delete;

  std::size_t write_some(std::span<const char> bytes, milliseconds deadline) override {
    const ClockTime end = clock().now() + deadline;
    std::size_t written = 0;
    while (written < bytes.size()) {
      const ssize_t count = ::send(fd_, bytes.data() + written, bytes.size() - written, MSG_NOSIGNAL);
      if (count > 0) {
        written += static_cast<std::size_t>(count);
        continue;
      }
      if (count < 0 && errno == EINTR) continue;
      if (count < 0 && errno != EAGAIN) hung_up();
      const auto left = std::chrono::duration_cast<milliseconds>(end - clock().now());
      if (left.count() <= 0 || !poll_for(POLLOUT, left)) break;
    }
    return written;
  }

  std::size_t read_some(std::span<char> buffer, milliseconds deadline) override {
    for (;;) {
      const ssize_t count = ::recv(fd_, buffer.data(), buffer.size(), 0);
      if (count > 0) return static_cast<std::size_t>(count);
      if (count == 0) hung_up();
      if (errno == EINTR) continue;
      if (errno != EAGAIN) hung_up();
      if (deadline.count() <= 0 || !poll_for(POLLIN, deadline)) return 0;
      deadline = milliseconds(0);
    }
  }

  bool wait(bool for_room, milliseconds deadline) override {
    return poll_for(static_cast<short>(for_room ? POLLIN | POLLOUT : POLLIN), deadline);
  }
  /// Not acknowledged by the server's computer yet; what its serial port still holds nobody tells.
  [[nodiscard]] std::size_t queued() const override {
    int count = 0;
    return ::ioctl(fd_, TIOCOUTQ, &count) == 0 && count > 0 ? static_cast<std::size_t>(count) : 0;
  }
  [[nodiscard]] std::string name() const override { return name_; }

 private:
  std::string name_;
  int fd_ = -1;

  bool connect_to(const addrinfo& address) {
    const int fd = ::socket(address.ai_family, address.ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, address.ai_protocol);
    if (fd < 0) return false;
    int error = ::connect(fd, address.ai_addr, address.ai_addrlen) == 0 ? 0 : errno;
    if (error == EINPROGRESS) {
      pollfd waiting{fd, POLLOUT, 0};
      socklen_t size = sizeof error;
      if (::poll(&waiting, 1, static_cast<int>(kConnectTimeout.count())) <= 0) {
        error = ETIMEDOUT;
      } else if (::getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size) != 0) {
        error = errno;
      }
    }
    if (error == 0) {
      fd_ = fd;
      return true;
    }
    ::close(fd);
    errno = error;
    return false;
  }

  [[noreturn]] void hung_up() const { throw IoError(name_ + " has hung up: the server or the network is gone"); }

  bool poll_for(short events, milliseconds deadline) const {
    pollfd waiting{fd_, events, 0};
    return ::poll(&waiting, 1, static_cast<int>(deadline.count())) > 0;
  }
};

}  // namespace

std::unique_ptr<Connection> open_tcp(const std::string& address) {
  const std::string rest = address.starts_with(kScheme) ? address.substr(kScheme.size()) : address;
  const std::size_t colon = rest.rfind(':');
  std::string host = rest.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  const std::string port = colon == std::string::npos ? "" : rest.substr(colon + 1);
  if (host.empty() || port.empty() || port.find_first_not_of("0123456789") != std::string::npos) {
    throw InputError("network address '" + address + "' must be like tcp://192.168.0.9:4001");
  }
  return std::make_unique<TcpConnection>(host, port);
}

std::unique_ptr<Connection> open_connection(const std::string& port, int baud, const SerialFormat& format) {
  return port.starts_with(kScheme) ? open_tcp(port) : open_serial(port, baud, format);
}

}  // namespace lightmill
