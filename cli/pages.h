// The two pages of a run folder for people: report.html to judge the part, setup_sheet.html to mill it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "cli/job.h"
#include "cli/run_folder.h"

namespace lightmill {

/// Writes both from what the folder holds now; the setup sheet only when there are programs.
void write_pages(const Job& job, const RunFolder& folder);

std::string report_page(const Job& job, const RunFolder& folder);
std::string setup_page(const Job& job, const RunFolder& folder);

/// Pictures and figures of several designs side by side, for a page at `page`: pictures are linked, not copied.
std::string gallery_page(const std::vector<std::filesystem::path>& folders, const std::filesystem::path& page);

}  // namespace lightmill
