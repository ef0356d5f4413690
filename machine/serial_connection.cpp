#include <fcntl.h>
#include <libserial/SerialPort.h>
#include <poll.h>
#include <pty.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <map>

#include "design/core/errors.h"
#include "machine/connection.h"

// libserial opens, configures and closes the port; bytes go by poll, read and write on its descriptor, because its own
// Read and Write poll byte by byte, spin without end when the other side sends XOFF, and report a hang-up as a timeout.

namespace lightmill {

namespace {

using LibSerial::BaudRate;

BaudRate baud_rate(int baud) {
  static const std::map<int, BaudRate> kRates = {
      {1200, BaudRate::BAUD_1200},       {2400, BaudRate::BAUD_2400},       {4800, BaudRate::BAUD_4800},
      {9600, BaudRate::BAUD_9600},       {19200, BaudRate::BAUD_19200},     {38400, BaudRate::BAUD_38400},
      {57600, BaudRate::BAUD_57600},     {115200, BaudRate::BAUD_115200},   {230400, BaudRate::BAUD_230400},
      {460800, BaudRate::BAUD_460800},   {921600, BaudRate::BAUD_921600},   {1000000, BaudRate::BAUD_1000000},
      {2000000, BaudRate::BAUD_2000000}, {3000000, BaudRate::BAUD_3000000}, {4000000, BaudRate::BAUD_4000000}};
  const auto found = kRates.find(baud);
  if (found != kRates.end()) return found->second;
  std::string known;
  for (const auto& [rate, name] : kRates) known += (known.empty() ? "" : ", ") + std::to_string(rate);
  throw InputError("baud rate " + std::to_string(baud) + " is not one of " + known);
}

/// One sender per device: an flock on a file named by the device number, so that links to it count as it.
class PortLock {
 public:
  PortLock(const std::string& port, dev_t device) {
    const std::string name =
        "/lightmill-" + std::to_string(major(device)) + "-" + std::to_string(minor(device)) + ".lock";
    for (const char* folder : {"/run/lock", "/var/lock", "/tmp"}) {
      const std::string path = folder + name;
      // Without O_CREAT first: in a sticky folder the kernel refuses O_CREAT on another user's file.
      fd_ = ::open(path.c_str(), O_RDWR | O_CLOEXEC);
      if (fd_ < 0) fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
      if (fd_ >= 0) break;
    }
    if (fd_ < 0) throw IoError("cannot make a lock file for " + port + ": " + std::strerror(errno));
    ::fchmod(fd_, 0666);
    if (::flock(fd_, LOCK_EX | LOCK_NB) != 0) {
      ::close(fd_);
      throw IoError("serial port " + port + " is in use by another lightmill; end that one first");
    }
  }
  ~PortLock() { ::close(fd_); }
  PortLock(const PortLock&) = delete;
  PortLock& operator=(const PortLock&) = delete;

 private:
  int fd_ = -1;
};

dev_t device_of(const std::string& port) {
  struct stat status {};
  if (::stat(port.c_str(), &status) != 0) {
    throw IoError("serial port " + port + " is not there (" + std::strerror(errno) +
                  "): check the cable and the name; 'lightmill ports' lists what is there");
  }
  if (!S_ISCHR(status.st_mode)) throw IoError(port + " is not a serial port; 'lightmill ports' lists what is there");
  if (::access(port.c_str(), R_OK | W_OK) != 0) {
    throw IoError("serial port " + port + " may not be used by you (" + std::strerror(errno) +
                  "): join the group that owns it, e.g. 'sudo adduser $USER dialout', and log in again");
  }
  return status.st_rdev;
}

class SerialConnection final : public Connection {
 public:
  SerialConnection(const std::string& port, int baud, const SerialFormat& format)
      : name_(port), device_(device_of(port)), rate_(baud_rate(baud)), lock_(port, device_) {
    try {
      // Configure before talking: setting the flow control throws away what has been received.
      port_.Open(port);
      port_.SetFlowControl(format.hardware_flow ? LibSerial::FlowControl::FLOW_CONTROL_HARDWARE
                                                : LibSerial::FlowControl::FLOW_CONTROL_NONE);
      port_.SetBaudRate(rate_);
      port_.SetCharacterSize(format.data_bits == 7 ? LibSerial::CharacterSize::CHAR_SIZE_7
                                                   : LibSerial::CharacterSize::CHAR_SIZE_8);
      port_.SetParity(format.parity == 'E'   ? LibSerial::Parity::PARITY_EVEN
                      : format.parity == 'O' ? LibSerial::Parity::PARITY_ODD
                                             : LibSerial::Parity::PARITY_NONE);
      port_.SetStopBits(format.stop_bits == 2 ? LibSerial::StopBits::STOP_BITS_2 : LibSerial::StopBits::STOP_BITS_1);
      fd_ = port_.GetFileDescriptor();
      // All 256 byte values must pass both ways: no translation of line ends, no signals, and IXON only if asked for.
      termios settings{};
      if (::tcgetattr(fd_, &settings) != 0) throw std::runtime_error(std::strerror(errno));
      const tcflag_t control = settings.c_cflag;
      ::cfmakeraw(&settings);
      settings.c_cflag = control;
      if (format.software_flow) settings.c_iflag |= IXON;
      if (format.data_bits == 7) settings.c_iflag |= ISTRIP;
      if (::tcsetattr(fd_, TCSANOW, &settings) != 0) throw std::runtime_error(std::strerror(errno));
      ::fcntl(fd_, F_SETFL, ::fcntl(fd_, F_GETFL) | O_NONBLOCK);
    } catch (const std::exception& error) {
      close_quietly();
      throw IoError("cannot open serial port " + port + ": " + error.what() +
                    " (does another program use it? 'lightmill ports' lists what is there)");
    }
  }
  ~SerialConnection() override { close_quietly(); }

  std::size_t write_some(std::span<const char> bytes, std::chrono::milliseconds deadline) override {
    const auto end = std::chrono::steady_clock::now() + deadline;
    std::size_t written = 0;
    while (written < bytes.size()) {
      const ssize_t count = ::write(fd_, bytes.data() + written, bytes.size() - written);
      if (count > 0) {
        written += static_cast<std::size_t>(count);
        continue;
      }
      if (count < 0 && errno == EINTR) continue;
      if (count < 0 && errno != EAGAIN) hung_up();
      const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
      if (left.count() <= 0 || !poll_for(POLLOUT, left)) break;
    }
    return written;
  }

  std::size_t read_some(std::span<char> buffer, std::chrono::milliseconds deadline) override {
    for (;;) {
      const ssize_t count = ::read(fd_, buffer.data(), buffer.size());
      if (count > 0) return static_cast<std::size_t>(count);
      if (count < 0 && errno == EINTR) continue;
      // A raw terminal with VMIN 0 says 0 when there is nothing, and also after a hang-up: poll tells them apart.
      if (count < 0 && errno != EAGAIN) hung_up();
      if (deadline.count() <= 0) {
        poll_for(POLLIN, std::chrono::milliseconds(0));
        return 0;
      }
      if (!poll_for(POLLIN, deadline)) return 0;
      deadline = std::chrono::milliseconds(0);
    }
  }

  bool wait(bool for_room, std::chrono::milliseconds deadline) override {
    return poll_for(static_cast<short>(for_room ? POLLIN | POLLOUT : POLLIN), deadline);
  }

  std::size_t queued() const override {
    int count = 0;
    return ::ioctl(fd_, TIOCOUTQ, &count) == 0 && count > 0 ? static_cast<std::size_t>(count) : 0;
  }
  std::string name() const override { return name_; }

 private:
  std::string name_;
  dev_t device_;
  BaudRate rate_;
  PortLock lock_;
  LibSerial::SerialPort port_;
  int fd_ = -1;

  [[noreturn]] void hung_up() const {
    throw IoError("serial port " + name_ + " has hung up: the cable is out or the controller is off");
  }

  bool poll_for(short events, std::chrono::milliseconds deadline) const {
    pollfd waiting{fd_, events, 0};
    const int ready = ::poll(&waiting, 1, static_cast<int>(deadline.count()));
    if (ready <= 0) return false;
    // What has arrived before the hang-up is still to be read.
    if ((waiting.revents & POLLIN) == 0 && (waiting.revents & (POLLHUP | POLLERR | POLLNVAL)) != 0) hung_up();
    int unread = 0;
    if ((waiting.revents & POLLHUP) != 0 && (::ioctl(fd_, FIONREAD, &unread) != 0 || unread == 0)) hung_up();
    return true;
  }

  /// libserial's Close throws after a hang-up and its destructor then ends the process, so it gets a healthy terminal
  /// to close instead. Always, because the hang-up may come at any moment.
  void close_quietly() noexcept {
    try {
      if (!port_.IsOpen()) return;
      const int fd = port_.GetFileDescriptor();
      ::ioctl(fd, TIOCNXCL);  // a simulated machine's own hold would keep the claim alive
      int master = -1, slave = -1;
      if (::openpty(&master, &slave, nullptr, nullptr, nullptr) == 0) {
        ::dup2(slave, fd);
        ::close(slave);
      }
      port_.Close();
      if (master >= 0) ::close(master);
    } catch (...) {
      // Nothing is left to do for a port that does not close.
    }
  }
};

}  // namespace

SerialFormat serial_format(std::string_view text) {
  SerialFormat format;
  if (text.size() == 3 && (text[0] == '7' || text[0] == '8') && (text[1] == 'N' || text[1] == 'E' || text[1] == 'O') &&
      (text[2] == '1' || text[2] == '2')) {
    format.data_bits = text[0] - '0';
    format.parity = text[1];
    format.stop_bits = text[2] - '0';
    return format;
  }
  throw InputError("line format '" + std::string(text) + "' must be data bits, parity and stop bits, as 8N1 or 7E1");
}

std::unique_ptr<Connection> open_serial(const std::string& port, int baud, const SerialFormat& format) {
  return std::make_unique<SerialConnection>(port, baud, format);
}

}  // namespace lightmill
