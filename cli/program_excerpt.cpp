#include "cli/program_excerpt.h"

#include "design/core/markup.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr long kAround = 3;          ///< lines shown before and after
constexpr std::size_t kMostLetters = 64;
constexpr std::size_t kMostTitle = 80;
constexpr int kRow = 20, kWidth = 620, kTop = 34;

std::string shortened(std::string_view text, std::size_t most) {
  return text.size() <= most ? std::string(text) : std::string(text.substr(0, most - 3)) + "...";
}

/// Bytes that no page can show become question marks.
std::string printable(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) > 0x7e) c = '?';
  }
  return escaped(text);
}

}  // namespace

std::string program_excerpt(std::string_view text, long line, const std::string& title) {
  const std::string height = std::to_string(kTop + (2 * kAround + 1) * kRow + 10), width = std::to_string(kWidth);
  std::string svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " + width + " " + height + "\" width=\"" + width + "\" height=\"" + height +
                    "\">\n<rect width=\"" + width + "\" height=\"" + height +
                    "\" fill=\"#ffffff\"/>\n<text x=\"10\" y=\"20\" font-family=\"DejaVu Sans, Arial, sans-serif\" font-size=\"13\" fill=\"#b3261e\">" +
                    escaped(shortened(title, kMostTitle)) + "</text>\n";
  bool found = false;
  long number = 1;
  for (std::size_t at = 0; at < text.size() && number <= line + kAround; ++number) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    if (number >= line - kAround) {
      const std::string top = std::to_string(kTop + (number - line + kAround) * kRow);
      const std::string base = std::to_string(kTop + (number - line + kAround) * kRow + 14);
      if (number == line) {
        found = true;
        svg += "<rect x=\"4\" y=\"" + top + "\" width=\"" + std::to_string(kWidth - 8) + "\" height=\"" + std::to_string(kRow) + "\" fill=\"#fbe3e1\"/>\n";
      }
      svg += "<text x=\"60\" y=\"" + base + "\" text-anchor=\"end\" font-family=\"DejaVu Sans Mono, monospace\" font-size=\"13\" fill=\"#5b6675\">" +
             std::to_string(number) + "</text>\n<text x=\"72\" y=\"" + base +
             "\" font-family=\"DejaVu Sans Mono, monospace\" font-size=\"13\" fill=\"#1c2430\">" +
             printable(shortened(text.substr(at, end - at), kMostLetters)) + "</text>\n";
    }
    at = end + 1;
  }
  return found ? svg + "</svg>\n" : "";
}

}  // namespace lightmill
