// The run folder: where every file of a job is, which stages are done, and the report they add up to.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace lightmill {

/// In the order of the chain. `design` on the command line is transport and surface.
enum class Stage { kTransport, kSurface, kCam, kPost, kDryRun };
inline constexpr Stage kAllStages[] = {Stage::kTransport, Stage::kSurface, Stage::kCam, Stage::kPost, Stage::kDryRun};

/// "transport", "surface", "cam", "post", "dry-run".
std::string_view stage_name(Stage stage);

/// A folder that one process at a time works in. A stage is done when its record, written last and whole, carries the digest
/// of the inputs and options it would be made from now, and its files are there with the sizes in the record.
class RunFolder {
 public:
  /// Creates the folder if asked to. Throws InputError if it is not there or is no run folder, IoError if another lightmill
  /// works in it.
  RunFolder(const std::filesystem::path& root, bool create);
  ~RunFolder();
  RunFolder(const RunFolder&) = delete;
  RunFolder& operator=(const RunFolder&) = delete;

  [[nodiscard]] const std::filesystem::path& root() const { return root_; }
  /// An absolute path of a file named relative to the folder.
  [[nodiscard]] std::filesystem::path file(std::string_view relative) const { return root_ / relative; }
  /// The same; throws InputError that names the command which makes it when it is not there.
  [[nodiscard]] std::filesystem::path needed(std::string_view relative, std::string_view made_by) const;

  /// The programs that are there, whatever their dialect, in the order of their names.
  [[nodiscard]] std::vector<std::filesystem::path> programs() const;

  [[nodiscard]] bool is_done(Stage stage, const std::string& digest) const;
  /// The record of a finished stage, or null.
  [[nodiscard]] nlohmann::json record(Stage stage) const;

  /// Removes what this stage and later ones left (they were made from something else) and partial files of killed runs.
  void begin(Stage stage);
  /// Writes the stage's record and the report. `files` are relative to the folder.
  void finish(Stage stage, const std::string& digest, const std::vector<std::string>& files, const nlohmann::json& report);

  /// Keeps why a stage refused these inputs and options, until it or an earlier one begins again.
  void refuse(Stage stage, const std::string& digest, const std::string& reason);
  /// The reason, empty where there is none or it was about other inputs.
  [[nodiscard]] std::string refusal(Stage stage, const std::string& digest) const;

  /// The figures of all finished stages, merged; keys that are null go missing.
  [[nodiscard]] nlohmann::json report() const;

 private:
  [[nodiscard]] std::filesystem::path record_path(Stage stage) const;
  [[nodiscard]] std::filesystem::path refusal_path(Stage stage) const;
  void write_report() const;

  std::filesystem::path root_;
  int lock_fd_ = -1;
};

}  // namespace lightmill
