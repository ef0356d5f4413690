#include "cli/run_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "cli/digest.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "postproc/program.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Files that a killed run left beside their places.
void remove_partial_files(const fs::path& root) {
  std::error_code error;
  std::vector<fs::path> partial;
  for (const auto& entry : fs::recursive_directory_iterator(root, error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(".") && name.find(".partial") != std::string::npos) partial.push_back(entry.path());
  }
  for (const auto& path : partial) fs::remove(path, error);
}

}  // namespace

std::string_view stage_name(Stage stage) {
  switch (stage) {
    case Stage::kTransport: return "transport";
    case Stage::kSurface: return "surface";
    case Stage::kCam: return "cam";
    case Stage::kPost: return "post";
    case Stage::kDryRun: return "dry-run";
  }
  return "";
}

RunFolder::RunFolder(const fs::path& root, bool create) : root_(fs::absolute(root).lexically_normal()) {
  std::error_code error;
  if (fs::exists(root_, error) && !fs::is_directory(root_, error)) {
    throw InputError(root.string() + " is a file; name a folder for the run");
  }
  if (create) {
    fs::create_directories(root_, error);
    if (error) throw IoError("cannot create folder " + root.string() + ": " + error.message());
  } else if (!fs::exists(root_ / "job.toml", error)) {
    throw InputError(root.string() + " is no run folder (it has no job.toml); make one with: lightmill make JOB -o " + root.string());
  }
  lock_fd_ = ::open((root_ / ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock_fd_ < 0) throw IoError("cannot write into " + root.string() + ": " + std::strerror(errno));
  if (::flock(lock_fd_, LOCK_EX | LOCK_NB) != 0) {
    ::close(lock_fd_);
    throw IoError("another lightmill works in " + root.string() + "; wait for it or choose another folder");
  }
}

RunFolder::~RunFolder() { ::close(lock_fd_); }

fs::path RunFolder::needed(std::string_view relative, std::string_view made_by) const {
  const fs::path path = file(relative);
  std::error_code error;
  if (!fs::exists(path, error)) {
    throw InputError(path.string() + " is not there; make it with: lightmill " + std::string(made_by) + " " + root_.string());
  }
  return path;
}

fs::path RunFolder::record_path(Stage stage) const { return root_ / "stages" / (std::string(stage_name(stage)) + ".json"); }

fs::path RunFolder::refusal_path(Stage stage) const { return root_ / "stages" / (std::string(stage_name(stage)) + "_refused.json"); }

json RunFolder::record(Stage stage) const {
  std::error_code error;
  if (!fs::exists(record_path(stage), error)) return nullptr;
  // Records are written whole, so a broken one was edited: as good as none.
  json record = json::parse(read_whole(record_path(stage)), nullptr, false);
  if (!record.is_object() || !record.contains("digest") || !record.contains("files") || !record.contains("report")) return nullptr;
  return record;
}

std::vector<fs::path> RunFolder::programs() const {
  const std::vector<DialectFacts> known = dialects();
  std::vector<fs::path> programs;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(file("program"), error)) {
    const fs::path& path = entry.path();
    const auto is_its = [&](const DialectFacts& dialect) { return path.extension() == dialect.extension; };
    if (!path.filename().string().starts_with(".") && std::any_of(known.begin(), known.end(), is_its)) programs.push_back(path);
  }
  std::sort(programs.begin(), programs.end());
  return programs;
}

bool RunFolder::is_done(Stage stage, const std::string& digest) const {
  const json made = record(stage);
  if (made.is_null() || made["digest"] != digest) return false;
  for (const auto& [name, what] : made["files"].items()) {
    std::error_code error;
    const auto bytes = fs::file_size(file(name), error);
    if (error || bytes != what.value("bytes", std::uintmax_t{0})) return false;
  }
  return true;
}

void RunFolder::begin(Stage stage) {
  remove_partial_files(root_);
  std::error_code error;
  for (auto later = std::rbegin(kAllStages); later != std::rend(kAllStages) && *later >= stage; ++later) {
    const json made = record(*later);
    if (!made.is_null()) {
      for (const auto& [name, what] : made["files"].items()) fs::remove(file(name), error);
    }
    fs::remove(record_path(*later), error);
    fs::remove(refusal_path(*later), error);
  }
  write_report();
}

void RunFolder::refuse(Stage stage, const std::string& digest, const std::string& reason) {
  write_whole(refusal_path(stage), json({{"digest", digest}, {"reason", reason}}).dump(1) + "\n");
}

std::string RunFolder::refusal(Stage stage, const std::string& digest) const {
  std::error_code error;
  if (!fs::exists(refusal_path(stage), error)) return "";
  const json refused = json::parse(read_whole(refusal_path(stage)), nullptr, false);
  return refused.is_object() && refused.value("digest", "") == digest ? refused.value("reason", "") : "";
}

void RunFolder::finish(Stage stage, const std::string& digest, const std::vector<std::string>& files, const json& report) {
  json record = {{"stage", stage_name(stage)}, {"lightmill", LIGHTMILL_VERSION}, {"digest", digest}, {"report", report}};
  record["files"] = json::object();
  for (const auto& name : files) {
    record["files"][name] = {{"bytes", fs::file_size(file(name))}, {"sha256", sha256_of_file(file(name))}};
  }
  write_whole(record_path(stage), record.dump(1) + "\n");
  write_report();
}

json RunFolder::report() const {
  json report = {{"lightmill", LIGHTMILL_VERSION}};
  for (const Stage stage : kAllStages) {
    const json made = record(stage);
    if (!made.is_null()) report.merge_patch(made["report"]);
  }
  return report;
}

void RunFolder::write_report() const { write_whole(file("report.json"), report().dump(2) + "\n"); }

}  // namespace lightmill
