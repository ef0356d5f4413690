#include "machine/fault_words.h"

#include "machine/detail/fault_picture.h"

namespace lightmill {

std::string lines_in_words(const Fault& fault) {
  if (fault.line <= 0) return "";
  if (fault.last_line <= fault.line) return "line " + std::to_string(fault.line);
  std::string words = "lines " + std::to_string(fault.line) + " to " + std::to_string(fault.last_line);
  if (fault.worst_line > 0) words += ", worst in " + std::to_string(fault.worst_line);
  return words;
}

std::string heading(const Fault& fault) {
  std::string words = fault.kind;
  if (!fault.program.empty()) words += " in " + fault.program;
  const std::string lines = lines_in_words(fault);
  if (!lines.empty()) words += (fault.program.empty() ? " " : ", ") + lines;
  return words;
}

std::string described(const Fault& fault) {
  return heading(fault) + ": " + fault.message;
}

std::string headed_picture(const Fault& fault) {
  constexpr std::size_t kMostLetters = 100;
  constexpr double kLeft = 10, kHeading = 18, kMessage = 34;
  const std::size_t end = fault.picture.rfind("</svg>");
  if (end == std::string::npos) return "";
  const std::string message = fault.message.size() > kMostLetters ? fault.message.substr(0, kMostLetters - 3) + "..." : fault.message;
  return fault.picture.substr(0, end) + svg_words(kLeft, kHeading, heading(fault)) + svg_words(kLeft, kMessage, message, 10) + fault.picture.substr(end);
}

void locate(Fault& fault, const SentLines& sent) {
  for (long* line : {&fault.last_line, &fault.worst_line, &fault.line}) {
    const auto place = sent.find(*line);
    if (!place) continue;
    *line = place->line;
    fault.program = place->program;
  }
}

}  // namespace lightmill
