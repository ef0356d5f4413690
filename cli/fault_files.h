// Faults as files: their list for faults.json, and pictures, every kind's first before any other.
#pragma once

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "machine/motion.h"

namespace lightmill {

/// As result.json and faults.json hold it.
nlohmann::json to_json(const Fault& fault);
Fault fault_from(const nlohmann::json& record);

struct FaultFiles {
  nlohmann::json list;                ///< to_json() of each; `picture` names a file
  std::vector<std::string> pictures;  ///< written
  int left_out = 0;                   ///< faults that would have had one, too

  /// {"written": ..., "left_out": ...}
  [[nodiscard]] nlohmann::json picture_count() const;
};

inline constexpr int kMostFaultPictures = 24;

/// Writes ROOT/PREFIXfault_01.svg ..., no more than kMostFaultPictures, and removes those of an earlier run. A fault without a
/// section shows the lines of its program around it; `text_of` gives a program's text, or nothing.
FaultFiles write_fault_pictures(const std::filesystem::path& root, const std::string& prefix, std::vector<Fault> faults,
                                const std::function<std::string(const std::string& program)>& text_of);

}  // namespace lightmill
