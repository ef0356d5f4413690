// Bad input: each a one-line error that names the remedy, the agreed exit code, nothing half-written.
#include <gmock/gmock.h>

#include "command_rig.h"

namespace lightmill {
namespace fs = std::filesystem;
namespace {

using test::CommandResult;
using test::fixture;
using test::lightmill_command;
using test::replaced;
using test::ScratchFolder;
using test::slurp;
using test::spill;
using test::tiny_job;
using test::tiny_job_on;
using ::testing::HasSubstr;

/// One line, the command's name in front, and nothing but it on stderr (progress aside).
void expect_one_line(const CommandResult& result, int code, const std::vector<std::string>& words) {
  EXPECT_EQ(result.code, code) << result.err;
  std::istringstream lines(result.err);
  std::string line, last, complaint;
  int complaints = 0;
  while (std::getline(lines, line)) {
    last = line;
    if (line.starts_with("lightmill: ")) {
      ++complaints;
      complaint = line;
    }
  }
  EXPECT_EQ(complaints, 1) << result.err;
  EXPECT_EQ(last, complaint) << "the last line is the error";
  for (const auto& word : words) EXPECT_THAT(complaint, HasSubstr(word));
}

/// Names of all files below, without locks.
std::vector<std::string> files_below(const fs::path& folder) {
  std::vector<std::string> names;
  if (!fs::exists(folder)) return names;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_directory() && entry.path().filename() != ".lock") names.push_back(fs::relative(entry.path(), folder).string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

CommandResult make(const fs::path& job, const ScratchFolder& scratch, const std::string& until = "dry-run") {
  return lightmill_command({"make", job.string(), "-o", (scratch / "run").string(), "--until", until});
}

TEST(BadInput, AnUnreadablePng) {
  const ScratchFolder scratch;
  spill(scratch / "broken.png", slurp(fixture("pictures/tiny.png")).substr(0, 300));
  const CommandResult cut = make(scratch / "broken.png", scratch);
  expect_one_line(cut, 2, {"broken.png", "cut short"});
  std::string picture = slurp(fixture("pictures/tiny.png"));
  picture[picture.size() / 2] ^= 1;
  spill(scratch / "flipped.png", picture);
  const CommandResult flipped = make(scratch / "flipped.png", scratch);
  expect_one_line(flipped, 2, {"flipped.png", "checksum"});
  // No word from the library beside ours.
  EXPECT_THAT(cut.err + flipped.err, ::testing::Not(HasSubstr("libpng")));
  fs::create_directory(scratch / "folder.png");
  expect_one_line(make(scratch / "folder.png", scratch), 2, {"folder.png is a folder"});
  spill(scratch / "text.png", "this is no picture");
  expect_one_line(make(scratch / "text.png", scratch), 2, {"text.png"});
  EXPECT_THAT(files_below(scratch / "run"), ::testing::ElementsAre("job.toml", "report.json"));
}

TEST(BadInput, AnAllBlackPicture) {
  const ScratchFolder scratch;
  // A portable graymap of zeros.
  spill(scratch / "black.pgm", "P5\n8 6\n255\n" + std::string(48, '\0'));
  expect_one_line(make(scratch / "black.pgm", scratch), 2, {"black"});
  EXPECT_THAT(files_below(scratch / "run"), ::testing::ElementsAre("job.toml", "report.json"));
}

TEST(BadInput, ADrawingWithNothingDrawable) {
  const ScratchFolder scratch;
  spill(scratch / "empty.svg", "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 10 10\"><defs/><metadata>x</metadata></svg>\n");
  expect_one_line(make(scratch / "empty.svg", scratch), 2, {"empty.svg"});
}

TEST(BadInput, AnUnknownKey) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch, "thickness_mm = 4", "tickness_mm = 4");
  expect_one_line(make(job, scratch), 2, {"tiny.toml:", "lens.tickness_mm", "thickness_mm"});
  EXPECT_FALSE(fs::exists(scratch / "run")) << "a job that cannot be read leaves no folder";
}

TEST(BadInput, ABlankThatIsTooLow) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch, "[rough]", "[stock]\nheight_mm = 4.1\n\n[rough]");
  expect_one_line(make(job, scratch), 2, {"relief", "stock.height_mm = 4.1", "mm too low", "at least"});
  for (const auto& name : files_below(scratch / "run")) EXPECT_FALSE(name.starts_with("cam/")) << name;
}

TEST(BadInput, ACutterLongerThanTheReach) {
  const ScratchFolder scratch;
  spill(scratch / "long.toml", replaced(slurp(fixture("cutters/finish_4mm_ball.toml")), "length_mm = 85.0", "length_mm = 130.0"));
  const fs::path job = tiny_job(scratch, "[finish]", "[finish]\ncutter = \"long.toml\"");
  expect_one_line(make(job, scratch), 2, {"finish.cutter", "130", "120", "shorter"});
  EXPECT_FALSE(fs::exists(scratch / "run"));
}

TEST(BadInput, WhatTheControlCannotIsRefusedBeforeTheDesign) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch);
  spill(job, slurp(job) + "\n[controller]\ntcp = \"on\"\n");
  expect_one_line(make(job, scratch), 2, {"tool-centre-point control", "grblhal", "tcp = \"off\""});
  const fs::path router = tiny_job_on(scratch, "router_grblhal.toml", "grblhal");
  std::string upright = replaced(slurp(router), "[controller]", "[controller]\ntcp = \"on\"");
  for (const char* pass : {"[semi_finish]", "[finish]"}) upright = replaced(upright, pass, std::string(pass) + "\naxis = \"vertical\"\nspindle_rpm = 24000");
  spill(router, upright);
  expect_one_line(make(router, scratch), 2, {"tool-centre-point control", "no rotary axes", "tcp = \"off\""});
  EXPECT_TRUE(files_below(scratch / "run").empty());
}

TEST(BadInput, ASerialPortThatIsNotThere) {
  const ScratchFolder scratch;
  spill(scratch / "part.nc", "G21\nM30\n");
  const std::string part = (scratch / "part.nc").string();
  expect_one_line(lightmill_command({"stream", part, "--port", "/dev/ttyNotThere"}), 2, {"do not mill", "--proof", "--unproven"});
  const CommandResult typed = test::typed_command({"stream", part, "--port", "/dev/ttyNotThere", "--unproven"}, "unproven\n");
  EXPECT_EQ(typed.code, 3) << typed.out;
  EXPECT_THAT(typed.out, HasSubstr("/dev/ttyNotThere"));
  expect_one_line(lightmill_command({"stream", (scratch / "part.nc").string()}), 2, {"--port"});
}

TEST(BadInput, AProgramThatIsCutShortIsNotSent) {
  const ScratchFolder scratch;
  for (const char* text : {"", "G21\nG0 X1\n", "G21\nM3 S1000 (M30)\n", "G21\nM300\n"}) {
    spill(scratch / "cut.nc", text);
    expect_one_line(lightmill_command({"stream", (scratch / "cut.nc").string(), "--port", "/dev/ttyNotThere"}), 2,
                    {"cut.nc", "cut short"});
  }
  for (const char* text : {"G21\nM30\n%\n", "G21\nN20 m02 ; end", "G21\nM5 M9 M30 (done)"}) {
    spill(scratch / "whole.nc", text);
    expect_one_line(lightmill_command({"stream", (scratch / "whole.nc").string(), "--port", "/dev/ttyNotThere"}), 2,
                    {"no dry run of"});
  }
}

TEST(BadInput, ALensWithAHoleIsDesignedButNotMilled) {
  const ScratchFolder scratch;
  spill(scratch / "ring.svg", "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 12 10'><path fill-rule='evenodd' "
                              "d='M0 0H12V10H0ZM5 4H7V6H5Z'/></svg>");
  const fs::path job = tiny_job(scratch, "[lens]\n", "[lens]\noutline = \"" + (scratch / "ring.svg").string() + "\"\n");
  EXPECT_EQ(make(job, scratch, "design").code, 0);
  expect_one_line(make(job, scratch), 2, {"2 loops", "--until design"});
}

TEST(BadInput, ALandWithoutACutOut) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch, "[lens]\n", "[profile]\ncut = false\n[lens]\nland_mm = 2\n");
  expect_one_line(make(job, scratch), 2, {"profile.cut", "land_mm"});
}

TEST(BadInput, ACommandLineThatIsNone) {
  expect_one_line(lightmill_command({}), 2, {"--help"});
  expect_one_line(lightmill_command({"mill"}), 2, {"--help"});
  expect_one_line(lightmill_command({"make", "job.toml"}), 2, {"--out"});
  expect_one_line(lightmill_command({"make", "/absent/job.toml", "-o", "/tmp/never"}), 2, {"/absent/job.toml"});
  expect_one_line(lightmill_command({"cam", "/absent"}), 2, {"lightmill make"});
  expect_one_line(lightmill_command({"machine", "--pty", "/tmp/never", "--out", "/tmp/never", "--blank", "10x10"}), 2, {"--blank", "100x80x14"});
}

TEST(BadInput, AnEmptyName) {
  expect_one_line(lightmill_command({"make", "", "-o", "somewhere"}), 2, {"empty"});
  expect_one_line(lightmill_command({"make", fixture("jobs/tiny.toml").string(), "-o", ""}), 2, {"empty"});
}

TEST(BadInput, AFolderThatCannotBeWritten) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch);
  expect_one_line(lightmill_command({"make", job.string(), "-o", "/proc/lightmill"}), 3, {"/proc/lightmill"});
}

TEST(Help, EveryCommandHasOneWithAnExample) {
  for (const char* name : {"make", "resume", "design", "cam", "post", "dry-run", "stream", "machine", "trace", "check", "ports", "machines", "dialects", "doctor"}) {
    const CommandResult result = lightmill_command({name, "--help"});
    EXPECT_EQ(result.code, 0) << name;
    EXPECT_THAT(result.out, HasSubstr(std::string("Example: lightmill ") + name));
  }
}

}  // namespace
}  // namespace lightmill
