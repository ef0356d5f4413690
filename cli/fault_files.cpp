#include "cli/fault_files.h"

#include <algorithm>
#include <set>

#include "cli/program_excerpt.h"
#include "design/core/files.h"
#include "machine/fault_words.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

json to_json(const Fault& fault) {
  return {{"picture", fault.picture},
          {"kind", fault.kind},
          {"program", fault.program},
          {"line", fault.line},
          {"last_line", fault.last_line},
          {"worst_line", fault.worst_line},
          {"message", fault.message},
          {"amount_mm", fault.amount_mm},
          {"place_mm", {fault.place_mm.x(), fault.place_mm.y(), fault.place_mm.z()}}};
}

Fault fault_from(const json& record) {
  const auto number = [](const json& value) { return value.is_number() ? value.get<double>() : 0.0; };
  Fault fault;
  fault.kind = record.at("kind");
  fault.program = record.at("program");
  fault.line = record.at("line");
  fault.last_line = record.value("last_line", 0L);
  fault.worst_line = record.value("worst_line", 0L);
  fault.message = record.at("message");
  fault.picture = record.value("picture", "");
  fault.amount_mm = number(record.at("amount_mm"));
  for (int i = 0; i < 3; ++i) fault.place_mm[i] = number(record.at("place_mm").at(i));
  return fault;
}

json FaultFiles::picture_count() const {
  return {{"written", pictures.size()}, {"left_out", left_out}};
}

namespace {

bool has_section(const Fault& fault) { return fault.picture.starts_with("<svg"); }

std::string picture_name(const std::string& prefix, std::size_t number) {
  return prefix + "fault_" + (number < 10 ? "0" : "") + std::to_string(number) + ".svg";
}

/// Which faults get a picture: of every kind the first with a section through the stock, or else the first; then in order.
std::vector<bool> chosen(const std::vector<Fault>& faults, const std::vector<bool>& can_be_drawn) {
  std::vector<bool> chosen(faults.size(), false);
  int count = 0;
  const auto choose = [&](const auto& wanted) {
    for (std::size_t k = 0; k < faults.size() && count < kMostFaultPictures; ++k) {
      if (chosen[k] || !can_be_drawn[k] || !wanted(faults[k])) continue;
      chosen[k] = true;
      ++count;
    }
  };
  std::set<std::string> kinds;
  choose([&](const Fault& fault) { return has_section(fault) && kinds.insert(fault.kind).second; });
  choose([&](const Fault& fault) { return kinds.insert(fault.kind).second; });
  choose([](const Fault&) { return true; });
  return chosen;
}

}  // namespace

FaultFiles write_fault_pictures(const fs::path& root, const std::string& prefix, std::vector<Fault> faults,
                                const std::function<std::string(const std::string& program)>& text_of) {
  std::error_code ignored;
  for (std::size_t k = 1; fs::remove(root / picture_name(prefix, k), ignored); ++k) {
  }
  // A line of a program can be shown; that it is there is seen when it is tried.
  std::vector<bool> can_be_drawn;
  for (const Fault& fault : faults) can_be_drawn.push_back(has_section(fault) || (fault.picture.empty() && fault.line > 0 && !fault.program.empty()));
  const std::vector<bool> draw = chosen(faults, can_be_drawn);
  FaultFiles files;
  files.list = json::array();
  for (std::size_t k = 0; k < faults.size(); ++k) {
    Fault& fault = faults[k];
    if (can_be_drawn[k]) {
      const std::string svg = !draw[k] ? "" : has_section(fault) ? headed_picture(fault) : program_excerpt(text_of(fault.program), fault.line, described(fault));
      fault.picture.clear();
      files.left_out += !draw[k];
      if (!svg.empty()) {
        fault.picture = picture_name(prefix, files.pictures.size() + 1);
        write_whole(root / fault.picture, svg);
        files.pictures.push_back(fault.picture);
      }
    }
    files.list.push_back(to_json(fault));
  }
  return files;
}

}  // namespace lightmill
