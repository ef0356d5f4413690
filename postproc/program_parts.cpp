#include "postproc/program_parts.h"

#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {
namespace {

constexpr double kPlane_mm = 1e-3;  // as the checker grants

// Where a new part may begin: before a rapid that leads from one place above the safe plane to another.
std::vector<std::size_t> seams_of(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion) {
  const auto is_high = [&](const AxisMove& move) {
    if (move.joints.z_mm == machine.retract_z_mm) return true;
    const ToolPose pose = forward(machine, setup, motion.cutter.length_mm, move.joints);
    return pose.tip_mm.z() >= motion.clearance_z_mm - kPlane_mm;
  };
  std::vector<std::size_t> seams;
  for (std::size_t i = 2; i < motion.moves.size(); ++i) {
    const AxisMove& move = motion.moves[i];
    if (move.kind != MoveKind::kRapid || move.joints.z_mm == machine.retract_z_mm) continue;
    if (is_high(move) && is_high(motion.moves[i - 1])) seams.push_back(i);
  }
  return seams;
}

std::vector<Program> write_in_parts(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                                    const ProgramOptions& options, std::size_t whole_bytes) {
  const std::size_t most = machine.max_program_bytes;
  const std::size_t count = motion.moves.size();
  const double bytes_per_move = static_cast<double>(whole_bytes) / static_cast<double>(count);
  const std::vector<std::size_t> seams = seams_of(machine, setup, motion);
  std::vector<std::size_t> begins{0};
  // The text is as long as it is only once it is written: guess, write, and go back a seam while it is too long.
  while (true) {
    const std::size_t begin = begins.back();
    const auto after = std::upper_bound(seams.begin(), seams.end(), begin);
    auto end = std::upper_bound(after, seams.end(),
                                begin + static_cast<std::size_t>(static_cast<double>(most) / bytes_per_move));
    const auto bytes = [&](std::size_t to) {
      return write_program(machine, setup, part_of(machine, motion, begin, to), options).text.size();
    };
    if (static_cast<double>(count - begin) * bytes_per_move < static_cast<double>(most) * 1.1 && bytes(count) <= most)
      break;
    while (end != after && bytes(*(end - 1)) > most) --end;
    if (end == after) {
      const std::size_t first = std::min(begin + 1, count - 1);  // below the machine's top
      const Vec3 tip = forward(machine, setup, motion.cutter.length_mm, motion.moves[first].joints).tip_mm;
      throw InputError(motion.pass + ": the control takes programs of " + std::to_string(most / 1000) +
                       " kB ([controller] max_program_kb), and from move " + std::to_string(begin + 1) + " of " +
                       std::to_string(count) + ", tip (" + compact(tip.x(), 3) + ", " + compact(tip.y(), 3) + ", " +
                       compact(tip.z(), 3) +
                       ") mm, no retract comes in time to split there; lift the tool more often, "
                       "write fewer decimals or run the program from the control's disk");
    }
    begins.push_back(*(end - 1));
  }
  if (begins.size() > 99) {
    throw InputError(motion.pass + ": the program would need " + std::to_string(begins.size()) +
                     " parts; run it from the control's disk ([controller] max_program_kb)");
  }
  std::vector<Program> programs;
  for (std::size_t k = 0; k < begins.size(); ++k) {
    ProgramOptions part = options;
    part.part = static_cast<int>(k) + 1;
    part.parts = static_cast<int>(begins.size());
    const std::size_t end = k + 1 < begins.size() ? begins[k + 1] : count;
    programs.push_back(write_program(machine, setup, part_of(machine, motion, begins[k], end), part));
  }
  return programs;
}

}  // namespace

AxisMotion part_of(const MachineModel& machine, const AxisMotion& motion, std::size_t begin, std::size_t end) {
  AxisMotion part = motion;
  part.moves.clear();
  if (begin > 0) {
    AxisMove above = motion.moves[begin];
    above.joints.z_mm = machine.retract_z_mm;
    above.rotary_moves = true;
    part.moves.push_back(above);
  }
  part.moves.insert(part.moves.end(), motion.moves.begin() + static_cast<std::ptrdiff_t>(begin),
                    motion.moves.begin() + static_cast<std::ptrdiff_t>(end));
  return part;
}

std::vector<Program> write_programs(const MachineModel& machine, const WorkSetup& setup,
                                    std::span<const AxisMotion> passes, bool one_program,
                                    const ProgramOptions& options) {
  const auto fits = [&](const Program& program) {
    return machine.max_program_bytes == 0 || program.text.size() <= machine.max_program_bytes;
  };
  if (one_program && passes.size() > 1) {
    Program whole = write_program(machine, setup, passes, options);
    if (fits(whole)) return {std::move(whole)};
  }
  std::vector<Program> programs;
  for (const AxisMotion& pass : passes) {
    Program program = write_program(machine, setup, pass, options);
    if (fits(program)) {
      programs.push_back(std::move(program));
      continue;
    }
    std::vector<Program> parts = write_in_parts(machine, setup, pass, options, program.text.size());
    std::move(parts.begin(), parts.end(), std::back_inserter(programs));
  }
  return programs;
}

}  // namespace lightmill
