#include "cli/pages.h"

#include "design/core/files.h"

namespace lightmill {

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
