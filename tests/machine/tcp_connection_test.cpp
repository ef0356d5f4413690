#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <filesystem>
#include <fstream>

#include "design/core/errors.h"
#include "machine/connection.h"
#include "machine/serial_ports.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using testing::HasSubstr;

/// A serial server with one place.
struct Server {
  Server() : listener(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    EXPECT_EQ(::bind(listener, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    EXPECT_EQ(::listen(listener, 1), 0);
    EXPECT_EQ(::getsockname(listener, reinterpret_cast<sockaddr*>(&address), &size), 0);
    name = "tcp://127.0.0.1:" + std::to_string(ntohs(address.sin_port));
  }
  ~Server() { ::close(listener); }
  int listener;
  std::string name;
};

TEST(Tcp, AllBytesPassBothWays) {
  const Server server;
  const auto connection = open_connection(server.name, 0);
  const int far = ::accept(server.listener, nullptr, nullptr);
  std::string all;
  for (int i = 0; i < 256; ++i) all += static_cast<char>(i);
  EXPECT_EQ(connection->write_some(all, milliseconds(1000)), all.size());
  std::array<char, 512> bytes;
  EXPECT_EQ(::recv(far, bytes.data(), all.size(), MSG_WAITALL), 256);
  EXPECT_EQ(std::string(bytes.data(), 256), all);
  EXPECT_EQ(::send(far, all.data(), all.size(), 0), 256);
  std::string back;
  while (back.size() < all.size()) back.append(bytes.data(), connection->read_some(bytes, milliseconds(1000)));
  EXPECT_EQ(back, all);
  // Deadlines are kept.
  const ClockTime before = connection->clock().now();
  EXPECT_EQ(connection->read_some(bytes, milliseconds(30)), 0U);
  EXPECT_GE(connection->clock().now() - before, milliseconds(29));
  EXPECT_FALSE(connection->wait(false, milliseconds(0)));
  EXPECT_TRUE(connection->wait(true, milliseconds(0)));
  // What came before the hang-up is still read; then it is an error.
  ::send(far, "ok", 2, 0);
  ::close(far);
  EXPECT_EQ(connection->read_some(bytes, milliseconds(1000)), 2U);
  EXPECT_THROW(connection->read_some(bytes, milliseconds(1000)), IoError);
}

TEST(Tcp, NobodyThereAndNonsenseSaySo) {
  std::string gone;
  {
    const Server server;
    gone = server.name;
  }
  try {
    open_connection(gone, 0);
    FAIL();
  } catch (const IoError& error) {
    EXPECT_THAT(error.what(), HasSubstr(gone));
  }
  for (const char* bad : {"tcp://", "tcp://host", "tcp://host:", "tcp://:80", "tcp://host:http"}) {
    EXPECT_THROW(open_connection(bad, 0), InputError) << bad;
  }
}

TEST(SerialFormat, IsRead) {
  const SerialFormat format = serial_format("7E2");
  EXPECT_EQ(format.data_bits, 7);
  EXPECT_EQ(format.parity, 'E');
  EXPECT_EQ(format.stop_bits, 2);
  for (const char* bad : {"", "8", "9N1", "8X1", "8N3", "8N1 "}) EXPECT_THROW(serial_format(bad), InputError) << bad;
}

TEST(SerialPorts, HaveTheirUsbNames) {
  namespace fs = std::filesystem;
  const fs::path root = fs::temp_directory_path() / ("lightmill_ports_" + std::to_string(::getpid()));
  const fs::path dev = root / "dev", sys = root / "sys";
  fs::create_directories(dev / "serial/by-id");
  for (const char* name : {"ttyUSB0", "ttyACM3", "tty5"}) std::ofstream(dev / name) << "";
  fs::create_symlink("../../ttyUSB0", dev / "serial/by-id/usb-Maker_Cable-if00");
  fs::create_symlink("../../ttyUSB9", dev / "serial/by-id/usb-gone");
  const fs::path adapter = sys / "devices/usb1/1-2";
  fs::create_directories(adapter / "1-2:1.0/ttyUSB0");
  std::ofstream(adapter / "manufacturer") << "Maker\n";
  std::ofstream(adapter / "product") << "Cable \n";
  std::ofstream(adapter / "serial") << "A50285\n";
  fs::create_directories(sys / "class/tty/ttyUSB0");
  fs::create_symlink(adapter / "1-2:1.0/ttyUSB0", sys / "class/tty/ttyUSB0/device");
  const auto ports = serial_ports(dev, sys);
  fs::remove_all(root);
  ASSERT_EQ(ports.size(), 2U);
  EXPECT_EQ(ports[0].path.filename(), "usb-Maker_Cable-if00");
  EXPECT_EQ(ports[0].usb_name, "Maker Cable A50285");
  EXPECT_EQ(ports[1].path.filename(), "ttyACM3");
  EXPECT_EQ(ports[1].usb_name, "");
}

}  // namespace
}  // namespace lightmill
