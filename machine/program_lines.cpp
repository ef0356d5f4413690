#include "machine/program_lines.h"

#include <algorithm>
#include <cctype>

namespace lightmill {

std::vector<ProgramLine> program_lines(std::string_view program) {
  std::vector<ProgramLine> lines;
  lines.reserve(static_cast<std::size_t>(std::count(program.begin(), program.end(), '\n')) + 1);
  long number = 0;
  while (!program.empty()) {
    const std::size_t end = program.find('\n');
    std::string_view line = program.substr(0, end);
    program.remove_prefix(end == std::string_view::npos ? program.size() : end + 1);
    ++number;
    const std::size_t first = line.find_first_not_of(" \t\r");
    if (first == std::string_view::npos) continue;
    line = line.substr(first, line.find_last_not_of(" \t\r") + 1 - first);
    lines.push_back({number, line});
  }
  return lines;
}

void SentLines::add(const std::string& name, std::string_view program) {
  programs_.push_back({name, {}});
  for (const ProgramLine& line : program_lines(program)) {
    if (line.text.front() != '$') programs_.back().numbers.push_back(line.number);
  }
}

std::optional<SentLines::Place> SentLines::find(long count) const {
  if (count <= 0) return std::nullopt;
  for (const Program& program : programs_) {
    const long lines = static_cast<long>(program.numbers.size());
    if (count <= lines) return Place{program.name, program.numbers[static_cast<std::size_t>(count - 1)]};
    count -= lines;
  }
  return std::nullopt;
}

namespace {

/// Has the line, outside comments, an M word of one of these numbers?
bool has_m_word(std::string_view line, std::initializer_list<std::string_view> numbers) {
  std::string words;  // without comments and blanks
  bool comment = false;
  for (const char c : line) {
    if (c == ';') break;
    if (c == '(') comment = true;
    if (!comment && c != ' ' && c != '\t') words += static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    if (c == ')') comment = false;
  }
  for (std::size_t at = words.find('M'); at != std::string::npos; at = words.find('M', at + 1)) {
    std::size_t first = at + 1;
    while (first < words.size() && words[first] == '0') ++first;
    std::size_t last = first;
    while (last < words.size() && std::isdigit(static_cast<unsigned char>(words[last])) != 0) ++last;
    const std::string number = words.substr(first, last - first);
    if (std::find(numbers.begin(), numbers.end(), number) != numbers.end()) return true;
  }
  return false;
}

}  // namespace

bool ends_itself(std::string_view program) {
  auto lines = program_lines(program);
  while (!lines.empty() && lines.back().text == "%") lines.pop_back();
  return !lines.empty() && has_m_word(lines.back().text, {"2", "30"});
}

bool is_optional_stop(std::string_view line) {
  return has_m_word(line, {"1"});
}

std::string LineDigest::hex() const {
  std::string text(16, '0');
  for (std::size_t i = 0; i < 16; ++i) text[i] = "0123456789abcdef"[(state_ >> (60 - 4 * i)) & 15];
  return text;
}

std::string program_digest(std::string_view program) {
  LineDigest digest;
  for (const ProgramLine& line : program_lines(program)) digest.add(line.text);
  return digest.hex();
}

}  // namespace lightmill
