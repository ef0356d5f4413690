#include "postproc/machine_model.h"

#include <Eigen/Geometry>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "design/core/toml_table.h"

namespace lightmill {
namespace {

constexpr double kRadPerDeg = kPi / 180;
// Rotary axes closer to parallel than this (sine of the angle between them) cannot orient a tool in practice.
constexpr double kLeastAxisSine = 1e-3;

[[noreturn]] void refuse(const TomlTable& table, std::string_view key, std::string_view rule) {
  throw InputError(table.complaint(key, rule));
}

double required(TomlTable& table, std::string_view key) {
  if (!table.has(key)) refuse(table, key, "is missing; a machine file has no default for it");
  return table.number(key, 0);
}

double positive(TomlTable& table, std::string_view key) {
  const double value = required(table, key);
  if (value <= 0) refuse(table, key, "must be greater than 0");
  return value;
}

Vec3 required_vector(TomlTable& table, std::string_view key) {
  if (!table.has(key)) refuse(table, key, "is missing; a machine file has no default for it");
  const Vec3 value = table.vector3(key, Vec3::Zero());
  if (!value.allFinite()) refuse(table, key, "must be three finite numbers");
  return value;
}

LinearAxis read_linear(TomlTable table) {
  LinearAxis axis;
  axis.min_mm = required(table, "min_mm");
  axis.max_mm = required(table, "max_mm");
  if (axis.min_mm >= axis.max_mm) refuse(table, "max_mm", "must be greater than min_mm");
  axis.max_speed_mm_per_s = positive(table, "max_speed_mm_per_min") / 60;
  axis.acceleration_mm_per_s2 = positive(table, "acceleration_mm_per_s2");
  axis.jerk_mm_per_s3 = table.number_in("jerk_mm_per_s3", 0, 0, 1e9);
  return axis;
}

RotaryAxis read_rotary(TomlTable table, std::string_view default_letter, bool on_head) {
  RotaryAxis axis;
  axis.on_head = on_head;
  axis.letter = table.choice("letter", default_letter, {"A", "B", "C"}).front();
  axis.axis = required_vector(table, "axis");
  if (axis.axis.norm() < 1e-9) refuse(table, "axis", "must be a direction, not zero");
  axis.axis.normalize();
  axis.point_mm = required_vector(table, "point_mm");
  axis.direction = required(table, "direction");
  if (std::abs(axis.direction) != 1) {
    refuse(table, "direction", on_head ? "must be 1 (ISO 841: the letter names the tool's turn) or -1 (against it)"
                                       : "must be -1 (ISO 841: the letter names the tool's turn) or 1 (the table's turn)");
  }
  if (table.has("min_deg") != table.has("max_deg")) {
    refuse(table, table.has("min_deg") ? "min_deg" : "max_deg",
           "needs min_deg and max_deg, or neither for an endless axis");
  }
  if (table.has("min_deg")) {
    axis.min_rad = required(table, "min_deg") * kRadPerDeg;
    axis.max_rad = required(table, "max_deg") * kRadPerDeg;
    if (axis.min_rad >= axis.max_rad) refuse(table, "max_deg", "must be greater than min_deg");
    if (axis.min_rad > 0 || axis.max_rad < 0)
      refuse(table, "min_deg", "limits must enclose 0, where the workpiece is set up");
  }
  axis.max_speed_rad_per_s = positive(table, "max_speed_deg_per_min") / 60 * kRadPerDeg;
  axis.acceleration_rad_per_s2 = positive(table, "acceleration_deg_per_s2") * kRadPerDeg;
  axis.jerk_rad_per_s3 = table.number_in("jerk_deg_per_s3", 0, 0, 1e9) * kRadPerDeg;
  return axis;
}

bool within(const LinearAxis& axis, double value) {
  return value >= axis.min_mm && value <= axis.max_mm;
}

// An axis that lies farther from what it turns than the machine is large was measured in another frame, or mistyped.
void check_pivot(TomlTable& table, const MachineModel& machine, const RotaryAxis& axis) {
  const Vec3 travel(machine.x.max_mm - machine.x.min_mm, machine.y.max_mm - machine.y.min_mm,
                    machine.z.max_mm - machine.z.min_mm);
  const Vec3 from = axis.on_head ? Vec3(Vec3::Zero()) : machine.table_centre_mm;
  const double off = axis.axis.cross(axis.point_mm - from).norm();
  const double most = travel.norm() + (axis.on_head ? machine.max_tool_length_mm : machine.table_radius_mm);
  if (off > most) {
    refuse(table, "point_mm", "is an impossible pivot: the axis passes " + compact(off, 3) + " mm from the " +
                                  (axis.on_head ? "spindle" : "table's centre") + ", more than the machine's size of " +
                                  compact(most, 3) + " mm; give a point on the axis " +
                                  (axis.on_head ? "from the spindle's gauge point" : "in machine coordinates"));
  }
}

void read_rotary_axes(TomlTable& file, MachineModel& machine) {
  const std::string chain = file.choice("chain", "table_table", {"table_table", "head_table", "head_head", "three_axis"});
  machine.simultaneous = file.boolean("simultaneous", true);
  if (chain == "three_axis") {
    if (file.has("outer") || file.has("inner")) {
      refuse(file, file.has("outer") ? "outer" : "inner", "has no place on a machine with chain = \"three_axis\"");
    }
    machine.chain = Chain::kThreeAxis;
    return;
  }
  machine.chain = chain == "table_table" ? Chain::kTableTable
                  : chain == "head_table" ? Chain::kHeadTable
                                          : Chain::kHeadHead;
  TomlTable outer = file.table("outer");
  TomlTable inner = file.table("inner");
  machine.outer = read_rotary(outer, "B", machine.chain != Chain::kTableTable);
  machine.inner = read_rotary(inner, "C", machine.chain == Chain::kHeadHead);
  if (machine.outer.letter == machine.inner.letter) refuse(inner, "letter", "must differ from outer.letter");
  if (machine.outer.axis.cross(machine.inner.axis).norm() < kLeastAxisSine) {
    refuse(inner, "axis", "must not be parallel to outer.axis: two parallel rotary axes cannot tilt the work");
  }
  if (machine.outer.axis.cross(Vec3::UnitZ()).norm() < kLeastAxisSine) {
    refuse(outer, "axis", "must not be parallel to the spindle (Z): it could not tilt the work");
  }
  check_pivot(outer, machine, machine.outer);
  check_pivot(inner, machine, machine.inner);
}

}  // namespace

MachineModel read_machine(const std::filesystem::path& path) {
  TomlTable file = TomlTable::from_file(path);
  MachineModel machine;
  machine.name = file.text("name", "");
  if (machine.name.empty()) refuse(file, "name", "must be a text that names the machine");
  machine.notes = file.text("notes", "");
  machine.table_centre_mm = required_vector(file, "table_centre_mm");
  machine.table_radius_mm = positive(file, "table_radius_mm");
  machine.max_tool_length_mm = positive(file, "max_tool_length_mm");
  machine.spindle_nose_radius_mm = file.number_in("spindle_nose_radius_mm", 0, 0, 1000);
  machine.spindle_nose_length_mm = file.number_in("spindle_nose_length_mm", 0, 0, 2000);
  machine.spindle_start_s = file.number_in("spindle_start_s", 0, 0, 600);

  machine.x = read_linear(file.table("x"));
  machine.y = read_linear(file.table("y"));
  machine.z = read_linear(file.table("z"));
  machine.retract_z_mm = required(file, "retract_z_mm");
  if (!within(machine.z, machine.retract_z_mm)) refuse(file, "retract_z_mm", "must lie within the travel of z");
  machine.tool_change_mm = required_vector(file, "tool_change_mm");
  const Vec3& change = machine.tool_change_mm;
  if (!within(machine.x, change.x()) || !within(machine.y, change.y()) || !within(machine.z, change.z())) {
    refuse(file, "tool_change_mm", "must lie within the travels of x, y and z");
  }

  if (file.has("park_mm")) {
    machine.park_mm = file.vector2("park_mm", Vec2::Zero());
    if (!within(machine.x, machine.park_mm->x()) || !within(machine.y, machine.park_mm->y())) {
      refuse(file, "park_mm", "must lie within the travels of x and y");
    }
  }
  read_rotary_axes(file, machine);

  TomlTable spindle = file.table("spindle");
  machine.min_spindle_rpm = positive(spindle, "min_rpm");
  machine.max_spindle_rpm = positive(spindle, "max_rpm");
  if (machine.min_spindle_rpm > machine.max_spindle_rpm) refuse(spindle, "max_rpm", "must not be less than min_rpm");

  TomlTable controller = file.table("controller");
  machine.controller = controller.choice(
      "kind", "grblhal", {"grblhal", "linuxcnc", "heidenhain", "heidenhain_iso", "fanuc", "siemens"});
  machine.has_tcp = controller.boolean("tcp", false);
  if (machine.has_tcp && machine.controller == "grblhal") {
    refuse(controller, "tcp", "must be false: grblHAL has no tool-centre-point control");
  }
  if (machine.has_tcp && !machine.has_rotary()) refuse(controller, "tcp", "must be false on three axes");
  machine.corner_tolerance_mm = controller.number_in("corner_tolerance_um", 10, 0, 10000) / 1000;
  if (controller.has("straight_rapids")) machine.straight_rapids = controller.boolean("straight_rapids", true);
  machine.receive_buffer_bytes = controller.integer_in("receive_buffer_bytes", 1024, 128, 1 << 20);
  machine.planner_blocks = controller.integer_in("planner_blocks", 100, 1, 100000);
  machine.min_block_s = controller.number_in("min_block_ms", 0, 0, 1000) / 1000;
  machine.max_program_bytes = static_cast<std::size_t>(controller.number_in("max_program_kb", 0, 0, 1e9) * 1000);
  file.finish();
  return machine;
}

}  // namespace lightmill
