// A sender that is killed while it streams to a machine in another process, and what `lightmill resume` makes of it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "design/core/text.h"
#include "machine/stock_model.h"
#include "tests/cli/command_rig.h"

namespace lightmill::test {
namespace {

using nlohmann::json;
using testing::HasSubstr;

/// The simulated machine of a run folder's job, until it is ended.
class MachineProcess {
 public:
  MachineProcess(const fs::path& run, const fs::path& out) : out_(out) {
    fs::create_directories(out);
    const json blank = json::parse(slurp(run / "report.json"))["cam"]["blank"];
    const auto side = [&](int i) { return compact(blank["size_mm"][static_cast<std::size_t>(i)].get<double>(), 9); };
    process_ =
        start_lightmill({"machine", "--pty", port(),
                         "--blank=" + side(0) + "x" + side(1) + "x" + compact(blank["height_mm"].get<double>(), 9),
                         "--origin=7,-4,-420", "--pitch-um", "40", "--time-factor", "150", "--pace-baud", "2000000",
                         "--starvation-mark-um", "0",  // so quick, it starves where this computer is busy
                         "--out", out.string()},
                        out / "log");
    for (int i = 0; i < 500 && !fs::exists(port()); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  ~MachineProcess() {
    if (process_ > 0) {
      kill(process_, SIGKILL);
      wait_for(process_);
    }
  }
  [[nodiscard]] std::string port() const { return (out_ / "port").string(); }
  int end() {
    kill(process_, SIGTERM);
    const int code = wait_for(process_);
    process_ = -1;
    return code;
  }

 private:
  fs::path out_;
  pid_t process_ = -1;
};

std::size_t journals(const fs::path& run) {
  std::size_t count = 0;
  for (const auto& entry : fs::directory_iterator(run / "stream"))
    count += entry.path().extension() == ".journal" ? 1 : 0;
  return count;
}

/// Streams, and is killed once the journal numbered `number` has `bytes`.
void kill_in(const std::vector<std::string>& arguments, const fs::path& run, const std::string& number,
             std::size_t bytes) {
  const pid_t sender = start_lightmill(arguments, run / "sender.log");
  bool there = false;
  for (int i = 0; i < 4000 && !there; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(3));
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(run / "stream", error)) {
      there =
          there || (entry.path().filename().string().starts_with(number) && fs::file_size(entry.path(), error) > bytes);
    }
  }
  kill(sender, SIGKILL);
  EXPECT_EQ(wait_for(sender), 128 + SIGKILL) << "it was through before it could be killed\n"
                                             << slurp(run / "sender.log");
  EXPECT_TRUE(there) << slurp(run / "sender.log");
}

TEST(Resume, TheSurfaceIsThatOfAnUndisturbedRun) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  ASSERT_EQ(lightmill_command({"make", tiny_job(scratch).string(), "-o", run.string(), "-q"}).code, 0);
  MachineProcess machine(run, scratch / "machine");

  // Killed in the second program; the machine goes on with what it holds.
  kill_in({"stream", run.string(), "--port", machine.port(), "--confirm-all"}, run, "000002", 2000);
  const CommandResult shown = lightmill_command({"resume", run.string()});
  EXPECT_EQ(shown.code, 0) << shown.err;
  for (const char* said : {"20_semi_finish.nc", "the sender died", "surely cut", "gone over again", "G43.1 Z85",
                           "no fault", "nothing was sent"}) {
    EXPECT_THAT(shown.out, HasSubstr(said));
  }
  EXPECT_THAT(slurp(run / "stream/20_semi_finish_resume.nc"), HasSubstr("RESTART"));
  EXPECT_THAT(slurp(run / "stream/20_semi_finish_resume.svg"), HasSubstr("</svg>"));
  EXPECT_EQ(journals(run), 2U) << "showing sends nothing";

  // Nobody at the terminal confirms; then the restart itself is killed; then it goes through.
  const CommandResult unconfirmed = lightmill_command({"resume", run.string(), "--port", machine.port()});
  EXPECT_EQ(unconfirmed.code, 2);
  EXPECT_THAT(unconfirmed.err, HasSubstr("not confirmed"));
  kill_in({"resume", run.string(), "--port", machine.port(), "--confirm-all", "--yes", "--overlap", "1"}, run, "000003",
          1400);
  // The line is the job's.
  spill(run / "job.toml", replaced(slurp(run / "job.toml"), "\nport = \"\"", "\nport = \"" + machine.port() + "\""));
  const CommandResult resumed = lightmill_command({"resume", run.string(), "--confirm-all", "--yes"});
  EXPECT_EQ(resumed.code, 0) << resumed.err;
  EXPECT_THAT(resumed.out, HasSubstr("30_finish.nc"));
  EXPECT_EQ(machine.end(), 0);

  const json result = json::parse(slurp(scratch / "machine/result.json"));
  for (const json& fault : result["faults"])
    EXPECT_EQ(fault["kind"], "starved") << "a machine 150 times too fast starves; " << fault;
  const MachinedSurface milled = read_machined(scratch / "machine/machined.tif");
  const MachinedSurface undisturbed = read_machined(run / "dry_run/machined.tif");
  ASSERT_EQ(milled.heights_mm.values.size(), undisturbed.heights_mm.values.size());
  double worst_mm = 0;
  for (std::size_t i = 0; i < milled.heights_mm.values.size(); ++i) {
    worst_mm = std::max(worst_mm, std::abs(double(milled.heights_mm.values[i]) - undisturbed.heights_mm.values[i]));
  }
  EXPECT_LT(1000 * worst_mm, 0.05) << "the cusps are 4 um high";

  // The summary of the last stream, and the plain log of the first.
  const std::string summaries = slurp(run / "streams.jsonl");
  EXPECT_THAT(summaries, HasSubstr("20_semi_finish"));
  const json last = json::parse(summaries.substr(summaries.rfind('\n', summaries.size() - 2) + 1));
  EXPECT_EQ(last["program"], "30_finish.nc");
  EXPECT_GT(last["planned_seconds"], 1);
  EXPECT_GT(last["seconds"], 0);
  EXPECT_LT(last["pace"], 1) << "a machine 150 times too fast is ahead of the dry run's time";
  const std::string log = slurp(run / "stream/000001_10_rough.log");
  EXPECT_THAT(log, HasSubstr("by the dry run's times"));
  EXPECT_THAT(log, HasSubstr("starved"));
  EXPECT_THAT(log, HasSubstr("done: "));
  const CommandResult nothing = lightmill_command({"resume", run.string(), "--port", machine.port()});
  EXPECT_EQ(nothing.code, 2) << "everything is milled";
  EXPECT_THAT(nothing.err, HasSubstr("no stream"));
  EXPECT_EQ(lightmill_command({"resume", run.string(), "-q"}).code, 0) << "stages that are done stay";
}

// Such a control knows where it stopped: the operator names the line, and loads what is written.
TEST(Resume, OnAControlThatRunsFilesWritesAProgram) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  const fs::path job = tiny_job_on(scratch, "trunnion_linuxcnc.toml", "linuxcnc");
  const CommandResult made = lightmill_command({"make", job.string(), "-o", run.string(), "-q"});
  ASSERT_EQ(made.code, 0) << made.err;
  const std::string program = slurp(run / "program/30_finish.ngc");
  const long line = std::count(program.begin(), program.end(), '\n') / 2;

  const CommandResult unnamed = lightmill_command({"resume", run.string(), "--from", std::to_string(line)});
  EXPECT_EQ(unnamed.code, 2);
  EXPECT_THAT(unnamed.err, HasSubstr("name the program that broke off with --program"));
  EXPECT_FALSE(fs::exists(run / "stream/30_finish_R.ngc"));

  // This control has no line to be fed by: a port changes nothing.
  for (const bool port : {false, true}) {
    std::vector<std::string> arguments{"resume", run.string(), "--program", "30_finish.ngc", "--from", std::to_string(line)};
    if (port) arguments.insert(arguments.end(), {"--port", "/dev/ttyNotThere"});
    const CommandResult resumed = lightmill_command(arguments);
    EXPECT_EQ(resumed.code, 0) << resumed.err;
    EXPECT_THAT(resumed.out, HasSubstr("nothing was sent; load the text at the control\n"));
    EXPECT_THAT(resumed.out, HasSubstr((run / "stream/30_finish_R.ngc").string()));
  }
  const std::string restart = slurp(run / "stream/30_finish_R.ngc");
  EXPECT_NE(restart.find("(RESTART OF 30_FINISH.NGC AT ITS LINE "), std::string::npos);
  EXPECT_TRUE(restart.ends_with(program.substr(program.size() - 200))) << "and goes on as the program";
  EXPECT_THAT(slurp(run / "stream/30_finish_R.svg"), HasSubstr("</svg>"));
  EXPECT_EQ(journals(run), 0U);
  EXPECT_FALSE(fs::exists(run / "streams.jsonl")) << "nothing was streamed";
}

}  // namespace
}  // namespace lightmill::test
