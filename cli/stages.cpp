#include "cli/stages.h"

#include "cli/digest.h"
#include "cli/pages.h"
#include "cli/posted_programs.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "postproc/machine_model.h"

namespace lightmill {

namespace fs = std::filesystem;

namespace {

/// Digests of files by content; a missing one makes the whole digest empty.
class Inputs {
 public:
  Inputs& text(const std::string& text) {
    sum_.add(std::to_string(text.size()) + ":").add(text);
    return *this;
  }
  Inputs& file(const fs::path& path) {
    if (path.empty()) return text("none");
    std::error_code error;
    if (!fs::is_regular_file(path, error)) {
      complete_ = false;
      return *this;
    }
    return text(sha256_of_file(path));
  }
  std::string digest() { return complete_ ? sum_.hex() : ""; }

 private:
  Sha256 sum_;
  bool complete_ = true;
};

}  // namespace

std::string making_digest(const Job& job) {
  Inputs inputs;
  for (const auto& [name, text] : resolved_sections(job)) {
    if (name != "dry_run" && name != "stream") inputs.text(name).text(text);
  }
  return inputs.digest();
}

std::string stage_digest(Stage stage, const Job& job, const RunFolder& folder, const ShopOverrides& overrides) {
  const auto sections = resolved_sections(job);
  const std::string viewed = job.receiver.viewed_from == ViewedFrom::kLens ? "lens" : "behind";
  Inputs inputs;
  inputs.text(LIGHTMILL_VERSION).text(std::string(stage_name(stage)));
  const auto target = [&] { inputs.text(sections.at("target")).text(viewed).file(job.target.image).file(job.target.drawing).file(job.target.colours); };
  const auto light_files = [&] {
    const SourceFiles& files = job.source_files;
    inputs.file(files.outline).file(files.base).file(files.light_mesh).file(files.light_image);
  };
  switch (stage) {
    case Stage::kTransport:
      target();
      if (is_plain_source(job.lens, job.light.beam, job.receiver)) {
        // Distance, index and thickness do not move unbent light.
        inputs.text(job.lens.shape == Lens::Shape::kDisk ? "disk" : "rectangle")
            .text(compact(job.lens.size_mm.x(), 9) + "x" + compact(job.lens.size_mm.y(), 9));
      } else {
        for (const char* name : {"lens", "light", "receiver"}) inputs.text(sections.at(name));
        light_files();
      }
      inputs.text(sections.at("transport"));
      break;
    case Stage::kSurface:
      target();
      light_files();
      inputs.file(folder.file("design/transport.npy"))
          .file(folder.file("design/transport_cells.npy"))
          .text(sections.at("lens"))
          .text(sections.at("light"))
          .text(sections.at("receiver"))
          .text(sections.at("surface"));
      break;
    case Stage::kCam:
      target();
      light_files();
      inputs.file(folder.file("design/surface.ply")).text(job.name).text(job.author);
      for (const char* name : {"lens", "light", "receiver", "solid", "mount", "stock", "rough", "semi_finish", "finish", "profile"}) inputs.text(sections.at(name));
      if (job.rest) inputs.text(sections.at("rest")).file(job.rest->cutter_file);
      inputs.file(job.rough.cutter_file).file(job.semi_finish.cutter_file).file(job.finish.cutter_file).file(job.machine.file);
      break;
    case Stage::kPost:
      inputs.file(folder.file("cam/toolpaths.bin")).file(job.machine.file).text(making_digest(job));
      break;
    case Stage::kDryRun:
      target();
      light_files();
      for (const auto& program : folder.programs()) inputs.text(program.filename().string()).file(program);
      inputs.file(folder.file("cam/spline.bin")).file(overrides.machine_file.value_or(job.machine.file));
      if (overrides.cutter_files.empty()) {
        inputs.file(job.rough.cutter_file).file(job.semi_finish.cutter_file).file(job.finish.cutter_file);
        if (job.rest) inputs.file(job.rest->cutter_file);
      }
      for (const auto& file : overrides.cutter_files) inputs.file(file);
      inputs.text(overrides.work_offset ? std::to_string(*overrides.work_offset) : "");
      if (overrides.workpiece_origin_mm) {
        for (const double v : *overrides.workpiece_origin_mm) inputs.text(compact(v, 9));
      }
      inputs.text(std::to_string(overrides.pace_baud.value_or(pace_baud(job)))).text(job.stream.one_at_a_time ? "one at a time" : "");
      for (const char* name : {"lens", "light", "receiver", "stock", "machine", "dry_run"}) inputs.text(sections.at(name));
      break;
  }
  return inputs.digest();
}

void check_job(const Job& job) {
  const MachineModel machine = read_machine(job.machine.file);
  const auto check = [&](const char* pass, const Cutter& cutter) {
    if (cutter.length_mm > machine.max_tool_length_mm) {
      throw InputError(std::string(pass) + ".cutter: \"" + cutter.name + "\" is " + compact(cutter.length_mm, 3) +
                       " mm long, the machine's reach is " + compact(machine.max_tool_length_mm, 3) + " mm (max_tool_length_mm); clamp it shorter by " +
                       compact(cutter.length_mm - machine.max_tool_length_mm, 3) + " mm or choose another cutter");
    }
    as_it_turns(cutter, job.dry_run.errors);  // refuses errors that leave nothing of it
    if (cutter.spindle_rpm < machine.min_spindle_rpm || cutter.spindle_rpm > machine.max_spindle_rpm) {
      throw InputError(std::string(pass) + ".spindle_rpm = " + compact(cutter.spindle_rpm, 1) + " is out of the machine's range, " +
                       compact(machine.min_spindle_rpm, 1) + " to " + compact(machine.max_spindle_rpm, 1) + "; change it in the job");
    }
  };
  check_posting(job);
  check("rough", job.rough.cutter);
  check("semi_finish", job.semi_finish.cutter);
  check("finish", job.finish.cutter);
  if (job.rest) check("rest", job.rest->cutter);
}

void run_stage(Stage stage, const Job& job, RunFolder& folder, const Monitor& monitor, const ShopOverrides& overrides) {
  monitor.check();
  folder.begin(stage);
  // Pages of the run before would praise programs that are gone, should this stage fail.
  std::error_code error;
  if (std::filesystem::exists(folder.file("report.html"), error)) write_pages(job, folder);
  const std::string digest = stage_digest(stage, job, folder, overrides);
  StageResult result;
  switch (stage) {
    case Stage::kTransport: result = run_transport(job, folder, monitor); break;
    case Stage::kSurface: result = run_surface(job, folder, monitor); break;
    case Stage::kCam:
      try {
        result = run_cam(job, folder, monitor);
      } catch (const InputError& e) {
        folder.refuse(stage, digest, e.what());
        throw;
      }
      break;
    case Stage::kPost: result = run_post(job, folder, monitor); break;
    case Stage::kDryRun: result = run_dry_run(job, folder, monitor, overrides); break;
  }
  folder.finish(stage, digest, result.files, result.report);
}

int count_faults(const RunFolder& folder) {
  const nlohmann::json report = folder.report();
  return report.contains("dry_run") ? report["dry_run"].value("faults", 0) : 0;
}

}  // namespace lightmill
