// The README's table of dialects is what these tests find: dialect, output, witness, result.
#include <gtest/gtest.h>

#include <algorithm>

#include "design/core/text.h"
#include "machine/detail/interpreter.h"
#include "machine/kinematics.h"
#include "machine/program_reader.h"
#include "postproc/program_check.h"
#include "tests/machine/readme_table.h"
#include "tests/postproc/programs.h"
#include "tests/postproc/rs274.h"

namespace lightmill {
namespace {

using test::Made;

constexpr const char* kBegin = "<!-- dialects: written by tests/machine/dialect_table_test.cpp -->\n";
constexpr const char* kEnd = "<!-- end of dialects -->\n";

// Read back by the machine room's reader: how many planned moves arrive, in their order, and how far off the worst is.
std::string read_back(const Made& made) {
  ReaderSetup setup;
  const Vec3& zero = made.setup.origin_mm;
  setup.offsets[0] = {zero.x(), zero.y(), zero.z(), 0, 0};
  const Cutter& cutter = made.motion.cutter;
  setup.tool_length_mm = {{cutter.number, cutter.length_mm}};
  WorkpieceView view(made.machine, zero);
  std::size_t next = 0;
  double tip_um = 0, axis_urad = 0;
  const auto arrived = [&](const AxisValues& q) {
    if (next == made.motion.moves.size()) return;
    const ToolPose at = view.cutter({q[0], q[1], q[2], q[3], q[4]}, cutter.length_mm);
    const ToolPose want = forward(made.machine, made.setup, cutter.length_mm, made.motion.moves[next].joints);
    const double tip = (at.tip_mm - want.tip_mm).norm() * 1e3, axis = (at.axis - want.axis).norm() * 1e6;
    if (tip > 0.2 || axis > 2) return;
    tip_um = std::max(tip_um, tip);
    axis_urad = std::max(axis_urad, axis);
    ++next;
  };
  if (made.machine.controller == "grblhal") {
    detail::Interpreter interpreter(made.machine);
    interpreter.set_offset(made.setup.work_offset, {zero.x(), zero.y(), zero.z()});
    for (const std::string& line : test::lines_of(made.program.text)) {
      if (const int error = interpreter.execute(line)) return line + ": " + std::string(detail::describe(error));
      for (const detail::GcodeStep& step : interpreter.steps()) {
        if (step.kind == detail::GcodeStep::kMove) arrived(step.target);
      }
    }
  } else {
    const ReadResult result =
        read_program(made.program.text, reader_dialect(made.machine.controller), made.machine, setup,
                     [&](const ProgramStep& step) {
                       if (step.kind == ProgramStep::kMove && step.whole) arrived(step.target);
                     });
    if (result.error) return "line " + std::to_string(result.error->line) + ": " + result.error->rule;
  }
  return std::to_string(next) + " of " + std::to_string(made.motion.moves.size()) + " moves, tip within " +
         fixed(tip_um, 2) + " um, axis " + fixed(axis_urad, 1) + " urad";
}

std::string rs274(const Made& made) {
  const test::Rs274Run run = test::run_rs274(made);
  const auto feeds = [](const auto& c) { return c.call == "STRAIGHT_FEED"; };
  return "exit " + std::to_string(run.exit_code) + ", " +
         std::to_string(std::count_if(run.calls.begin(), run.calls.end(), feeds)) + " feed moves";
}

// Every line of header and footer and every fifth of the cut left out once; block numbers set right again.
std::string mutations(const Made& made) {
  const std::vector<std::string> lines = test::lines_of(made.program.text);
  int made_count = 0, caught = 0;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const bool inside = i > 60 && i + 30 < lines.size();
    if (test::is_comment(lines[i]) || (inside && i % 5 != 0)) continue;
    std::vector<std::string> changed = lines;
    changed.erase(changed.begin() + static_cast<long>(i));
    ++made_count;
    caught += !test::faults_of(made, test::renumbered(changed, made.machine.controller)).empty();
  }
  return std::to_string(caught) + " of " + std::to_string(made_count) + " lost lines noticed";
}

TEST(DialectTable, TheReadmeSaysWhatWasFound) {
  std::string table = kBegin;
  table +=
      "| dialect | output | own check of the text | `machine/`'s reader | LinuxCNC's `rs274` "
      "|\n|---|---|---|---|---|\n";
  if (!test::has_rs274()) GTEST_SKIP() << "rs274 is not installed: its column cannot be written";
  for (const DialectFacts& dialect : dialects()) {
    for (const bool tcp : {false, true}) {
      if (tcp && !dialect.tcp) continue;
      const bool turning = dialect.name != "heidenhain_iso" || tcp;
      const Made made = test::make_for(dialect.name, turning, tcp);
      const bool linuxcnc_reads_it = dialect.name == "grblhal" || dialect.name == "linuxcnc";
      table += "| " + dialect.name + " | " + (tcp ? "tool-centre-point control" : "kinematics in the post") +
               (turning ? "" : ", axes fixed") + " | " + mutations(made) + " | " +
               read_back(made) + " | " +
               (linuxcnc_reads_it ? rs274(made) : "") + " |\n";
    }
  }
  table += kEnd;
  test::expect_in_readme("README.md", kBegin, kEnd, table);
}

}  // namespace
}  // namespace lightmill
