#include "machine/program_trace.h"

#include <algorithm>
#include <cmath>

#include "machine/detail/fault_picture.h"
#include "machine/kinematics.h"
#include "machine/program_lines.h"

namespace lightmill {

namespace {

using OnMotion = std::function<void(const Motion&, const std::vector<SweptMove>&)>;

void trace_lines(const MachineModel& machine, const OperatorSetup& setup, std::string_view program, const OnMotion& on_motion) {
  SimulationOptions options;
  options.remove_stock = false;
  SimulatedMachine simulated(machine, setup, options);
  const std::vector<ProgramLine> lines = program_lines(program);
  simulated.on_motion = [&](Motion motion, const std::vector<SweptMove>& pieces) {
    motion.line = lines[static_cast<std::size_t>(motion.line - 1)].number;
    on_motion(motion, pieces);
  };
  for (const ProgramLine& line : lines) {
    simulated.receive(line.text);
    simulated.receive("\n");
    simulated.work(1);
    simulated.receive("~");  // goes on at tool changes and pauses, is nothing elsewhere
    simulated.take_replies();
  }
}

/// As quick as the axes are; above 0, because pieces share a motion's time.
constexpr double kRapid_s = 1e-6;

void trace_file(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect, std::string_view program,
                const OnMotion& on_motion) {
  const ReaderSetup reader = reader_setup(machine, setup);
  WorkpieceView view(machine, setup.workpiece_origin_mm);
  std::vector<SweptMove> pieces;
  Motion motion;
  motion.to = to_position(reader.start);
  double length_mm = 0;
  read_program(program, reader_dialect(dialect), machine, reader, [&](const ProgramStep& step) {
    if (step.kind == ProgramStep::kDwell) motion.stood_s += step.seconds;
    if (step.kind == ProgramStep::kSpindle) motion.spindle_rpm = step.number == 5 ? 0 : step.rpm;
    if (step.kind == ProgramStep::kChangeTool) {
      motion.tool = step.number;
      const auto found = reader.tool_length_mm.find(step.number);
      length_mm = found == reader.tool_length_mm.end() ? 0 : found->second;
    }
    if (step.kind != ProgramStep::kMove) return;
    motion.line = step.line;
    motion.from = motion.to;
    motion.to = to_position(step.target);
    motion.rapid = step.rapid;
    motion.seconds = std::max(step.seconds, kRapid_s);
    motion.corner_tolerance_mm = step.corner_tolerance_mm;
    motion.exact_stop = step.exact_stop;
    pieces.clear();
    view.sweep(motion, length_mm, {}, pieces);
    on_motion(motion, pieces);
    motion.stood_s = 0;
  });
}

/// Nodes around the place, which is their origin, and their distance.
constexpr double kNodePitch_mm = 0.01, kNodesAround_mm = 0.02;
/// What the picture is drawn from.
constexpr double kDrawnPitch_mm = 0.1, kDrawn_mm = 44;

double height_at(const MachinedSurface& surface, const Vec2& place_mm) {
  const Vec2 at = (place_mm - surface.extent.min) / surface.pitch_mm;
  const double i = std::round(at.x()), j = std::round(at.y());
  const Grid<float>& heights = surface.heights_mm;
  if (i < 0 || j < 0 || i >= heights.width || j >= heights.height) return 0;
  return heights.at(static_cast<int>(i), static_cast<int>(j));
}

/// How far from its tip a cutter may cut, seen from above.
double reach_mm(const Cutter& cutter, const SweptMove& move) {
  constexpr double kUpright = 0.9999;
  const bool leans = std::min(move.from.axis.z(), move.to.axis.z()) < kUpright;
  return leans ? std::hypot(cutter.diameter_mm, cutter.flute_length_mm) : cutter.diameter_mm;
}

bool comes_near(const SweptMove& move, const Vec2& place_mm, double reach_mm) {
  const Vec2 a = move.from.tip_mm.head<2>(), b = move.to.tip_mm.head<2>();
  return ((a.cwiseMin(b) - place_mm).array() <= reach_mm).all() && ((place_mm - a.cwiseMax(b)).array() <= reach_mm).all();
}

/// The section with the place as its origin: only what is around it is needed.
std::string section_at(const MachinedSurface& surface, const Blank& blank, const Cutter& cutter, const SweptMove& move, const Vec3& place_mm) {
  const Vec3 origin(place_mm.x(), place_mm.y(), 0);
  StockField field({Vec2::Constant(kDrawn_mm), blank.height_mm}, kDrawnPitch_mm);
  field.lower_to([&](const Vec2& p) { return height_at(surface, p + origin.head<2>()); });
  std::vector<KeepOut> keep_outs = blank.keep_outs;
  for (KeepOut& box : keep_outs) {
    box.min_mm -= origin;
    box.max_mm -= origin;
  }
  const Vec3 way = move.to.tip_mm - move.from.tip_mm;
  const double share = way.squaredNorm() > 0 ? std::clamp((place_mm - move.from.tip_mm).dot(way) / way.squaredNorm(), 0.0, 1.0) : 1;
  const ToolPose pose{move.from.tip_mm + share * way - origin, (move.from.axis + share * (move.to.axis - move.from.axis)).normalized()};
  return fault_picture(field, nullptr, Tool(cutter), pose, way, place_mm - origin, keep_outs);
}

}  // namespace

void trace_program(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect, std::string_view program,
                   const OnMotion& on_motion) {
  if (dialect == "grblhal") {
    trace_lines(machine, setup, program, on_motion);
  } else {
    trace_file(machine, setup, dialect, program, on_motion);
  }
}

std::optional<Vec3> place_of_line(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                                  std::string_view program, long line) {
  std::optional<Vec3> place;
  trace_program(machine, setup, dialect, program, [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
    if (!place && motion.line >= line) place = pieces.back().to.tip_mm;
  });
  return place;
}

std::optional<Maker> maker_of(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                              const std::vector<ProgramFile>& programs, const MachinedSurface& surface, const Vec2& place_mm) {
  const Vec3 origin(place_mm.x(), place_mm.y(), 0);
  Blank blank;
  blank.size_mm = Vec2::Constant(kNodesAround_mm);
  blank.height_mm = setup.blank.height_mm;
  StockOptions options;
  options.pitch_mm = kNodePitch_mm;
  StockModel nodes(blank, options);
  const Cutter* cutter = nullptr;
  float lowest = static_cast<float>(blank.height_mm);
  std::optional<Maker> maker;
  SweptMove last;
  const Cutter* last_cutter = nullptr;
  for (const ProgramFile& program : programs) {
    trace_program(machine, setup, dialect, program.text, [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
      if (cutter == nullptr || cutter->number != motion.tool) {
        const auto found = std::find_if(setup.cutters.begin(), setup.cutters.end(), [&](const Cutter& c) { return c.number == motion.tool; });
        if (found == setup.cutters.end()) return;
        cutter = &*found;
        nodes.set_cutter(*cutter);
      }
      for (SweptMove piece : pieces) {
        if (!comes_near(piece, place_mm, reach_mm(*cutter, piece))) continue;
        const SweptMove here = piece;
        piece.from.tip_mm -= origin;
        piece.to.tip_mm -= origin;
        // Whatever touches takes material along.
        piece.rapid = false;
        piece.spindle_on = true;
        nodes.move(piece);
        nodes.flush();
        const Grid<float> heights = nodes.surface().heights_mm;
        const float height = heights.at(heights.width / 2, heights.height / 2);
        if (height >= lowest) continue;
        lowest = height;
        maker = Maker{program.name, motion.line, {}, {}};
        last = here;
        last_cutter = cutter;
      }
    });
  }
  if (!maker) return maker;
  maker->place_mm = Vec3(place_mm.x(), place_mm.y(), height_at(surface, place_mm));
  maker->picture = section_at(surface, setup.blank, *last_cutter, last, maker->place_mm);
  return maker;
}

}  // namespace lightmill
