// A whole job as plain data: what the TOML file says, every default filled in.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "cam/blank.h"
#include "cam/cutter.h"
#include "cam/finishing.h"
#include "cam/profile.h"
#include "cam/roughing.h"
#include "cam/solid.h"
#include "design/light.h"
#include "design/optics.h"
#include "design/surface.h"
#include "design/target.h"
#include "design/transport.h"
#include "machine/machine_errors.h"

namespace lightmill {

/// Files that shape the source light; read when the light is traced, so that a job can be read without them.
struct SourceFiles {
  std::filesystem::path outline;        ///< SVG; its view box is stretched onto lens.size_mm
  std::filesystem::path base;           ///< height image, or PLY
  double base_scale_mm = 1;             ///< height of a pixel of value 1 in the image
  std::filesystem::path light_mesh;     ///< PLY: vertex normals are the directions, `intensity` the flux per mm^2
  std::filesystem::path light_image;    ///< the profile over the lens's bounding box, seen from the exit
};

struct LightSpec {
  Light beam;                           ///< without what is in files
  // For the predicted picture only:
  double angular_diameter_rad = 0;      ///< as seen from the lens
  bool fresnel = false;                 ///< count what both faces reflect
  bool dispersion = false;              ///< red, green and blue bent as acrylic bends them
};

struct StockSpec {
  std::optional<double> height_mm;      ///< empty: "auto", what thickness, relief and allowance ask for
  double allowance_mm = 0.5;            ///< material above the highest point of the lens, for "auto"
  std::optional<double> margin_mm;      ///< beside the part; empty: "auto", room for the mill where the part is cut out
  std::string material = "PMMA, cast, annealed";  ///< its first word chooses the cutters' data
  std::vector<KeepOut> keep_outs;       ///< clamps, jaws: [x0, y0, z0, x1, y1, z1] each
  std::string work_holding = "vacuum";  ///< "vacuum", "vise" or "clamps"
  Vec3 jaw_mm{80, 20, 3};               ///< of a vise, at the blank's sides at -y and +y: length, thickness, height over the table
};

struct RoughPass {
  std::filesystem::path cutter_file;
  Cutter cutter;                        ///< with the job's own spindle speed and feed per tooth
  RoughOptions options;
};

struct BallPass {
  std::filesystem::path cutter_file;
  Cutter cutter;
  FinishOptions options;
  std::optional<double> blur_mm;        ///< on the wall after the polish: what options.cusp_um was made from
  bool along_creases = false;           ///< once more along every concave crease
};

/// A flat land around the optical surface, the part's rim.
struct LandSpec {
  double width_mm = 0;                  ///< 0: none
  double drop_mm = 1;                   ///< below the lowest place of the optical surface's border
};

/// Cutting the part out of its blank, by the roughing mill.
struct ProfilePass {
  std::optional<bool> cut;              ///< empty: "auto", all but plain rectangles
  bool tabs_give_way = true;            ///< "auto": fewer and smaller ones where the part is small
  ProfileOptions options;
};

struct MachineSpec {
  std::filesystem::path file;
  Vec3 workpiece_origin_mm = Vec3::Zero();  ///< of the blank's back centre from the table's centre, joints at zero
  int work_offset = 54;
};

struct ControllerSpec {
  std::string dialect = "grblhal";
  bool tcp = false;                     ///< by the control's tool-centre-point control
  bool one_program = false;             ///< for all passes, with tool changes
  int decimals = 5;
  bool block_numbers = false;
  double tip_tolerance_um = 0.2;
  bool arcs = false;                    ///< G2, G3 for straight moves that stay within tip_tolerance_um
};

struct DryRunSpec {
  double pitch_um = 20;
  std::optional<double> solid_pitch_um; ///< of the true solid beside the heights, 0: none; empty: "auto", 200 where the part is cut out
  double starvation_mark_um = 1;        ///< how far a cutter that the line lets stand in the cut sinks in (a model)
  double wall_tolerance_um = 20;        ///< a wall that is farther off the outline is a fault
  double polish_sigma_um = 100;         ///< hand polish as a Gaussian low-pass of the heights; 0: as milled
  double wavelength_um = 0.55;          ///< of the light that the cusps diffract; 0: not looked at
  double gouge_tolerance_um = 1;        ///< deeper below the reachable surface is a fault
  double cusp_limit_um = 1.5;           ///< higher where the surface is reachable is a fault
  std::optional<int> pace_baud;         ///< of the simulated line, 0: bytes take no time; empty: "auto", stream.baud
  std::string line_times = "auto";      ///< or on, off; "auto": a table of the lines' times for short programs
  double time_factor = 0;               ///< of the virtual clock against the wall's; 0: as fast as it can
  MachineErrors errors;                 ///< of the simulated machine
};

struct StreamSpec {
  std::string port;
  int baud = 115200;
  std::string protocol = "auto";  ///< or grblhal, grbl, drip, fe; "auto": what the dialect's control speaks
  std::string format = "auto";    ///< or 8N1, 7E1...
  bool rts_cts = false;           ///< the line obeys RTS and CTS
  bool one_at_a_time = false;     ///< grblHAL, grbl: wait for each line's ok
  int leader_nulls = 0;           ///< drip: before the program
  bool check_first = true;        ///< grblHAL, grbl: once in check mode before anything moves
};

struct Job {
  std::string name;                     ///< of the part, for programs and pages
  std::string author;                   ///< for the solid
  TargetSpec target;
  Lens lens;
  LightSpec light;
  SourceFiles source_files;
  Receiver receiver;
  TransportOptions transport;
  SurfaceOptions surface;
  StockSpec stock;
  RoughPass rough;
  BallPass semi_finish;
  BallPass finish;
  std::optional<BallPass> rest;         ///< with a smaller ball along concave creases
  LandSpec land;
  MountOptions mount;                   ///< cut into the land; not milled by the passes
  ProfilePass profile;
  SplineFitOptions spline_fit;
  StepSchema step_schema = StepSchema::kAp242;
  double mesh_tolerance_mm = 0.05;      ///< of cam/lens.stl and cam/lens.3mf; 0: not written
  MachineSpec machine;
  ControllerSpec controller;
  DryRunSpec dry_run;
  StreamSpec stream;
};

/// Whether the part is cut out of its blank.
bool is_cut_out(const Job& job);
/// How much the blank is larger than the part on every side.
double blank_margin_mm(const Job& job);
/// As jobs and reports name it.
const char* axis_name(AxisPolicy axis);
/// Length and width of the blank: the part and its margin.
Vec2 blank_size_mm(const Job& job);
/// Of the dry run's solid; 0: none.
double solid_pitch_um(const Job& job);
/// Of the dry run's line to a control that is fed while it mills; 0: not paced.
int pace_baud(const Job& job);
/// Jaws, clamps and what else holds the blank.
std::vector<KeepOut> keep_outs_of(const Job& job);

/// Reads a job file, or makes the default job of a picture (.png, .svg, .tif, .exr, ...). Relative paths in a job are
/// relative to the job file. Throws InputError naming file, line, key, value and rule.
Job read_job(const std::filesystem::path& job_or_picture);

/// Reads a job from text; `folder` is what relative paths are relative to.
Job read_job_text(std::string_view toml, const std::string& name, const std::filesystem::path& folder);

/// The job as TOML with every default explicit and absolute paths, by section in the order of the file.
/// read_job_text(resolved_toml(job)) is the same job up to 12 digits.
std::map<std::string, std::string> resolved_sections(const Job& job);
std::string resolved_toml(const Job& job);

/// Where the cutters and machines that come with Lightmill are (environment LIGHTMILL_FIXTURES, or the source tree).
std::filesystem::path fixtures_folder();

}  // namespace lightmill
