#include "machine/serial_ports.h"

#include <algorithm>
#include <fstream>
#include <set>

namespace lightmill {

namespace fs = std::filesystem;

namespace {

std::string first_line(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  while (!line.empty() && (line.back() == ' ' || line.back() == '\r')) line.pop_back();
  return line;
}

/// The USB device is some folders above the port's own: the first that says what product it is.
std::string usb_name(const std::string& port, const fs::path& sys) {
  std::error_code error;
  fs::path folder = fs::canonical(sys / "class/tty" / port / "device", error);
  if (error) return "";
  constexpr int kMostLevels = 4;
  for (int level = 0; level < kMostLevels && folder.has_relative_path(); ++level, folder = folder.parent_path()) {
    if (!fs::exists(folder / "product", error)) continue;
    std::string name;
    for (const char* part : {"manufacturer", "product", "serial"}) {
      const std::string text = first_line(folder / part);
      if (!text.empty()) name += (name.empty() ? "" : " ") + text;
    }
    return name;
  }
  return "";
}

}  // namespace

std::vector<SerialPort> serial_ports(const fs::path& dev, const fs::path& sys) {
  std::vector<SerialPort> lasting, others;
  std::set<fs::path> seen;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(dev / "serial/by-id", error)) {
    const fs::path device = fs::canonical(entry.path(), error);
    if (error) continue;  // pulled out a moment ago
    seen.insert(device);
    lasting.push_back({entry.path(), usb_name(device.filename().string(), sys)});
  }
  const fs::path root = fs::canonical(dev, error);
  for (const auto& entry : fs::directory_iterator(dev, error)) {
    const std::string name = entry.path().filename().string();
    for (const char* start : {"ttyUSB", "ttyACM", "ttyAMA"}) {
      if (name.starts_with(start) && !seen.contains(root / name)) others.push_back({entry.path(), usb_name(name, sys)});
    }
  }
  const auto by_path = [](const SerialPort& a, const SerialPort& b) { return a.path < b.path; };
  std::sort(lasting.begin(), lasting.end(), by_path);
  std::sort(others.begin(), others.end(), by_path);
  lasting.insert(lasting.end(), others.begin(), others.end());
  return lasting;
}

}  // namespace lightmill
