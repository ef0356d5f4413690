// The serial ports of this computer.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace lightmill {

struct SerialPort {
  std::filesystem::path path;  ///< the lasting name (/dev/serial/by-id/...) if it has one
  std::string usb_name;        ///< maker, product and serial number as the adapter says; empty: not on USB
};

/// Adapters and controllers by their lasting names first, then what else is there. The folders are for tests.
std::vector<SerialPort> serial_ports(const std::filesystem::path& dev = "/dev", const std::filesystem::path& sys = "/sys");

}  // namespace lightmill
