#include "cli/pages.h"

#include "design/core/files.h"

namespace lightmill {

std::string escaped(std::string_view text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '&': result += "&amp;"; break;
      case '<': result += "&lt;"; break;
      case '>': result += "&gt;"; break;
      case '"': result += "&quot;"; break;
      default: result += c;
    }
  }
  return result;
}

void write_pages(const Job& job, const RunFolder& folder) {
  write_whole(folder.file("report.html"), report_page(job, folder));
  std::error_code error;
  if (std::filesystem::exists(folder.file("stages/post.json"), error)) {
    write_whole(folder.file("setup_sheet.html"), setup_page(job, folder));
  } else {
    std::filesystem::remove(folder.file("setup_sheet.html"), error);
  }
}

}  // namespace lightmill
