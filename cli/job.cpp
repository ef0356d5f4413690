#include "cli/job.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "cam/work_holding.h"
#include "cli/errors_file.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "design/core/toml_table.h"
#include "machine/connection.h"
#include "postproc/program.h"

namespace lightmill {

namespace fs = std::filesystem;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kDegree = kPi / 180;

/// The keys in the order in which people think of a job.
constexpr std::array kSections = {"job",   "target",      "lens",   "light",   "receiver", "transport",  "surface", "solid", "mount", "stock",
                                  "rough", "semi_finish", "finish", "rest", "profile", "machine",  "controller", "dry_run", "stream"};

/// In the order of their enumerations.
const std::vector<std::string_view> kBases{"flat", "sphere", "cylinder", "image", "mesh"};
const std::vector<std::string_view> kLights{"parallel", "point", "mesh"};
const std::vector<std::string_view> kSurfaceSolvers{"creases", "everywhere", "height_field"};
const std::vector<std::string_view> kStrategies{"one_way", "zig_zag", "spiral"};
const std::vector<std::string_view> kProfiles{"uniform", "gaussian", "image"};

/// Refuses what the design foresees and this version cannot do, in words that say so.
void not_yet(TomlTable& table, std::string_view key, std::string_view what_works) {
  if (table.has(key)) throw InputError(table.complaint(key, "not supported yet: " + std::string(what_works)));
}

/// A choice among values that are known, of which only the first works today.
void only_choice(TomlTable& table, std::string_view key, const std::vector<std::string_view>& known) {
  const std::string value = table.choice(key, known.front(), known);
  if (value != known.front()) {
    throw InputError(table.complaint(key, "not supported yet: use \"" + std::string(known.front()) + "\""));
  }
}

Vec2 positive2(TomlTable& table, std::string_view key, const Vec2& fallback) {
  const Vec2 value = table.vector2(key, fallback);
  if (!(value.minCoeff() > 0) || !value.allFinite() || value.maxCoeff() > 10000) {
    throw InputError(table.complaint(key, "must be two numbers above 0 and at most 10000 mm"));
  }
  return value;
}

double positive(TomlTable& table, std::string_view key, double fallback, double most = 1e6) {
  const double value = table.number(key, fallback);
  if (!(value > 0 && value <= most)) {
    throw InputError(table.complaint(key, "must be a number above 0 and at most " + std::to_string(std::lround(most))));
  }
  return value;
}

/// A number, or nothing where the key says "auto" or is not there.
std::optional<double> number_or_auto(TomlTable& table, std::string_view key, double least, double most) {
  if (table.is_text(key)) table.choice(key, "auto", {"auto"});
  else if (table.has(key)) return table.number_in(key, least, least, most);
  return std::nullopt;
}

/// A path in the job; relative ones are relative to the job's folder. Empty stays empty.
fs::path path_in(TomlTable& table, std::string_view key, const fs::path& folder, const fs::path& fallback = {}) {
  const std::string text = table.text(key, "");
  if (text.empty()) return fallback;
  const fs::path path(text);
  return fs::absolute(path.is_absolute() ? path : folder / path).lexically_normal();
}

void read_target(TomlTable table, const fs::path& folder, Job& job) {
  TargetSpec& target = job.target;
  target.image = path_in(table, "image", folder, target.image);
  target.drawing = path_in(table, "drawing", folder, target.drawing);
  if (target.image.empty() && target.drawing.empty()) {
    throw InputError(table.complaint("image", "missing; name a picture (image = \"portrait.png\") or a drawing (drawing = \"signature.svg\")"));
  }
  target.size_mm = positive2(table, "size_mm", target.size_mm);
  if (table.is_text("curve_flux")) {
    table.choice("curve_flux", "auto", {"auto"});
  } else if (table.has("curve_flux")) {
    target.curve_flux = table.number_in("curve_flux", 0, 0, 1);
  }
  target.background = table.number_in("background", target.background, 0, 1000);
  const std::string transfer = table.choice("transfer", "auto", {"auto", "srgb", "linear"});
  target.transfer = transfer == "srgb" ? Transfer::kSrgb : transfer == "linear" ? Transfer::kLinear : Transfer::kAuto;
  target.colours = path_in(table, "colours", folder, target.colours);
  target.color_mask = table.boolean("color_mask", target.color_mask);
}

void read_mount(TomlTable table, Job& job) {
  MountOptions& mount = job.mount;
  mount.chamfer_mm = table.number_in("chamfer_mm", mount.chamfer_mm, 0, 100);
  for (const auto& row : table.number_rows("dowels_mm", 2)) mount.dowels_mm.emplace_back(row[0], row[1]);
  mount.dowel_diameter_mm = positive(table, "dowel_diameter_mm", mount.dowel_diameter_mm, 100);
  mount.dowel_depth_mm = table.number_in("dowel_depth_mm", mount.dowel_depth_mm, 0, 1000);
  mount.label = table.text("label", mount.label);
  mount.label_on_back = table.choice("label_side", "land", {"land", "back"}) == "back";
  mount.label_height_mm = positive(table, "label_height_mm", mount.label_height_mm, 100);
  mount.label_depth_mm = positive(table, "label_depth_mm", mount.label_depth_mm, 100);
  if (table.has("label_at_mm")) mount.label_at_mm = table.vector2("label_at_mm", {0, 0});
  for (const char* key : {"chamfer_mm", "dowels_mm", "label"}) {
    const bool wanted = key[0] == 'c' ? mount.chamfer_mm > 0 : key[0] == 'd' ? !mount.dowels_mm.empty() : !mount.label.empty();
    if (wanted && job.land.width_mm <= 0) throw InputError(table.complaint(key, "is cut into the land around the lens: set lens.land_mm"));
  }
}

void read_lens(TomlTable table, const fs::path& folder, Job& job) {
  Lens& lens = job.lens;
  SourceFiles& files = job.source_files;
  files.outline = path_in(table, "outline", folder);
  const std::string shape = table.choice("shape", files.outline.empty() ? "rectangle" : "outline", {"rectangle", "disk", "outline"});
  lens.shape = shape == "disk" ? Lens::Shape::kDisk : shape == "outline" ? Lens::Shape::kOutline : Lens::Shape::kRectangle;
  if ((lens.shape == Lens::Shape::kOutline) != !files.outline.empty()) {
    throw InputError(table.complaint("shape", "an outline (outline = \"lens.svg\") and shape = \"outline\" go together"));
  }
  lens.size_mm = positive2(table, "size_mm", lens.size_mm);
  if (lens.shape == Lens::Shape::kDisk && lens.size_mm.x() != lens.size_mm.y()) {
    throw InputError(table.complaint("size_mm", "must be the diameter twice for shape = \"disk\""));
  }
  job.land.width_mm = table.number_in("land_mm", job.land.width_mm, 0, 1000);
  job.land.drop_mm = table.number_in("land_drop_mm", job.land.drop_mm, 0.05, 1000);
  lens.thickness_mm = positive(table, "thickness_mm", lens.thickness_mm, 1000);
  lens.refractive_index = table.number_in("refractive_index", lens.refractive_index, 1.05, 4);
  const std::string base = table.choice("base", "flat", kBases);
  lens.base.kind = static_cast<Base::Kind>(std::find(kBases.begin(), kBases.end(), base) - kBases.begin());
  if (lens.base.kind == Base::Kind::kSphere || lens.base.kind == Base::Kind::kCylinder) {
    lens.base.radius_mm = table.number_in("base_radius_mm", lens.base.radius_mm, -1e6, 1e6);
    if (std::abs(lens.base.radius_mm) < 1) throw InputError(table.complaint("base_radius_mm", "must be at least 1 mm, or at most -1 mm for a hollow base"));
  }
  if (lens.base.kind == Base::Kind::kCylinder) lens.base.axis_rad = kDegree * table.number_in("base_axis_deg", 0, -360, 360);
  if (lens.base.kind == Base::Kind::kImage || lens.base.kind == Base::Kind::kMesh) {
    files.base = path_in(table, "base_file", folder);
    if (files.base.empty()) throw InputError(table.complaint("base_file", "missing; name the height image or the PLY of the base"));
  }
  if (lens.base.kind == Base::Kind::kImage) files.base_scale_mm = table.number_in("base_scale_mm", files.base_scale_mm, -1000, 1000);
}

void read_light(TomlTable table, const fs::path& folder, Job& job) {
  Light& beam = job.light.beam;
  const std::string kind = table.choice("kind", "parallel", kLights);
  beam.kind = static_cast<Light::Kind>(std::find(kLights.begin(), kLights.end(), kind) - kLights.begin());
  if (beam.kind == Light::Kind::kParallel) {
    beam.direction = table.vector3("direction", beam.direction);
    if (!(beam.direction.allFinite() && beam.direction.z() > 0)) throw InputError(table.complaint("direction", "its z must be above 0: light travels along +Z through the lens"));
  } else if (beam.kind == Light::Kind::kPoint) {
    beam.position_mm = table.vector3("position_mm", beam.position_mm);
    if (!(beam.position_mm.allFinite() && beam.position_mm.z() < 0)) throw InputError(table.complaint("position_mm", "its z must be below 0: the lens's back is z = 0"));
  } else {
    job.source_files.light_mesh = path_in(table, "mesh", folder);
    if (job.source_files.light_mesh.empty()) throw InputError(table.complaint("mesh", "missing; name the light's PLY"));
  }
  const std::string profile = table.choice("profile", "uniform", kProfiles);
  beam.profile.kind = static_cast<Profile::Kind>(std::find(kProfiles.begin(), kProfiles.end(), profile) - kProfiles.begin());
  if (beam.profile.kind == Profile::Kind::kGaussian) {
    beam.profile.sigma_mm = positive(table, "sigma_mm", beam.profile.sigma_mm, 10000);
    beam.profile.centre_mm = table.vector2("centre_mm", beam.profile.centre_mm);
  } else if (beam.profile.kind == Profile::Kind::kImage) {
    job.source_files.light_image = path_in(table, "image", folder);
    if (job.source_files.light_image.empty()) throw InputError(table.complaint("image", "missing; name the picture of the profile"));
  }
  job.light.angular_diameter_rad = kDegree * table.number_in("angular_diameter_deg", 0, 0, 20);
  job.light.fresnel = table.boolean("fresnel", job.light.fresnel);
  job.light.dispersion = table.boolean("dispersion", job.light.dispersion);
}

void read_receiver(TomlTable table, Job& job) {
  job.receiver.distance_mm = positive(table, "distance_mm", job.receiver.distance_mm, 1e6);
  const bool behind = table.choice("viewed_from", "lens", {"lens", "behind"}) == "behind";
  job.receiver.viewed_from = job.target.viewed_from = behind ? ViewedFrom::kBehind : ViewedFrom::kLens;
  const Vec2 tilt_deg = table.vector2("tilt_deg", Vec2::Zero());
  if (!(tilt_deg.cwiseAbs().maxCoeff() <= 80)) throw InputError(table.complaint("tilt_deg", "must be two angles of at most 80 degrees"));
  job.receiver.tilt_rad = kDegree * tilt_deg;
  job.receiver.shift_mm = table.vector2("shift_mm", Vec2::Zero());
  if (!(job.receiver.shift_mm.cwiseAbs().maxCoeff() <= 1e6)) throw InputError(table.complaint("shift_mm", "must be two lengths of at most 1e6 mm"));
}

void read_transport(TomlTable table, Job& job) {
  TransportOptions& o = job.transport;
  o.solver = table.choice("solver", "newton", {"newton", "lbfgs"}) == "lbfgs" ? TransportSolver::kLbfgs : TransportSolver::kNewton;
  o.samples = table.integer_in("samples", o.samples, 16, 16'000'000);
  o.l1_tolerance = table.number_in("l1_tolerance", o.l1_tolerance, 1e-12, 1);
  o.max_tolerance = table.number_in("max_tolerance", o.max_tolerance, 1e-12, 10);
  o.max_iterations = table.integer_in("max_iterations", o.max_iterations, 1, 1'000'000);
  o.point_radius_mm = positive(table, "point_radius_mm", o.point_radius_mm, 10);
  o.seed = static_cast<std::uint64_t>(table.integer_in("seed", static_cast<int>(o.seed), 0, 2'147'483'647));
}

void read_surface(TomlTable table, Job& job) {
  SurfaceOptions& o = job.surface;
  o.mesh = table.integer_in("mesh", o.mesh, 5, 8193);
  const std::string solver = table.choice("solver", "creases", kSurfaceSolvers);
  o.solver = static_cast<SurfaceSolver>(std::find(kSurfaceSolvers.begin(), kSurfaceSolvers.end(), solver) - kSurfaceSolvers.begin());
  o.outer_iterations = table.integer_in("outer_iterations", o.outer_iterations, 1, 1000);
  o.picture_turns = table.integer_in("picture_turns", o.picture_turns, 0, 100);
  o.height_tolerance_mm = table.number_in("height_tolerance_um", o.height_tolerance_mm * 1000, 0, 1000) / 1000;
  o.min_concave_radius_mm = positive(table, "min_concave_radius_mm", o.min_concave_radius_mm, 10000);
  o.limit_hollows = table.boolean("limit_hollows", o.limit_hollows);
  TomlTable weights = table.table("weights");
  o.weights.integration = positive(weights, "integration", o.weights.integration);
  o.weights.barrier = weights.number_in("barrier", o.weights.barrier, 0, 1e9);
  o.weights.direction = weights.number_in("direction", o.weights.direction, 0, 1e9);
  o.weights.flux = weights.number_in("flux", o.weights.flux, 0, 1e9);
  o.weights.smoothness = weights.number_in("smoothness", o.weights.smoothness, 0, 1e9);
}

void read_stock(TomlTable table, Job& job) {
  StockSpec& stock = job.stock;
  if (table.is_text("height_mm")) {
    table.choice("height_mm", "auto", {"auto"});
  } else if (table.has("height_mm")) {
    stock.height_mm = positive(table, "height_mm", 0, 1000);
  }
  stock.allowance_mm = table.number_in("allowance_mm", stock.allowance_mm, 0, 100);
  stock.margin_mm = number_or_auto(table, "margin_mm", 0, 1000);
  stock.material = table.text("material", stock.material);
  for (const auto& row : table.number_rows("keep_outs", 6)) {
    const KeepOut box{{row[0], row[1], row[2]}, {row[3], row[4], row[5]}};
    if (!((box.max_mm - box.min_mm).minCoeff() > 0)) {
      throw InputError(table.complaint("keep_outs", "rows are [x0, y0, z0, x1, y1, z1] in mm, the first corner below the second in every axis"));
    }
    stock.keep_outs.push_back(box);
  }
  stock.work_holding = table.choice("work_holding", stock.work_holding, {"vacuum", "vise", "clamps"});
  if (stock.work_holding == "vise") {
    stock.jaw_mm = table.vector3("jaw_mm", stock.jaw_mm);
    if (!(stock.jaw_mm.minCoeff() > 0 && stock.jaw_mm.allFinite())) throw InputError(table.complaint("jaw_mm", "must be length, thickness and height above 0"));
  }
  if (stock.work_holding == "clamps" && stock.keep_outs.empty()) {
    throw InputError(table.complaint("work_holding", "clamps need their room: keep_outs = [[x0, y0, z0, x1, y1, z1], ...] in mm from the middle of the blank's underside"));
  }
}

constexpr double kLeastFeedMmPerMin = 10;

/// The cutter of a pass with its data for the material, with the job's own over those.
void read_pass_cutter(TomlTable& table, const fs::path& folder, const fs::path& fallback, const std::string& material, fs::path& file, Cutter& cutter) {
  file = path_in(table, "cutter", folder, fallback);
  cutter = read_cutter(file, material_name(material));
  cutter.spindle_rpm = positive(table, "spindle_rpm", cutter.spindle_rpm, 500000);
  cutter.feed_per_tooth_mm = positive(table, "feed_per_tooth_mm", cutter.feed_per_tooth_mm, 5);
  if (cutter.feed_mm_per_s() * 60 < kLeastFeedMmPerMin) {
    throw InputError(table.complaint("feed_per_tooth_mm", "with the spindle's speed it makes a feed of " + compact(cutter.feed_mm_per_s() * 60, 6) + " mm/min; at least " +
                                                              compact(kLeastFeedMmPerMin, 3) + " are needed, or a pass takes weeks"));
  }
}

double feed_mm_per_s(TomlTable& table, std::string_view key, double fallback_mm_per_s) {
  const double feed = table.number(key, fallback_mm_per_s * 60);
  if (!(feed >= kLeastFeedMmPerMin * (1 - 1e-9) && feed <= 1e5)) {
    throw InputError(table.complaint(key, "must be from " + compact(kLeastFeedMmPerMin, 3) + " to 100000 mm/min; slower, a pass takes weeks"));
  }
  return feed / 60;
}

template <class Options>
void read_motion(TomlTable& table, Options& o) {
  o.link_feed_mm_per_s = feed_mm_per_s(table, "link_feed_mm_per_min", o.link_feed_mm_per_s);
  o.max_feed_mm_per_s = feed_mm_per_s(table, "max_feed_mm_per_min", o.max_feed_mm_per_s);
  o.clearance_mm = table.number_in("clearance_mm", o.clearance_mm, 0.5, 500);
  o.acceleration_mm_per_s2 = table.number_in("acceleration_mm_per_s2", o.acceleration_mm_per_s2, 1, 1e6);
}

void read_rough(TomlTable table, const fs::path& folder, Job& job) {
  RoughPass& pass = job.rough;
  read_pass_cutter(table, folder, fixtures_folder() / "cutters/rough_10mm.toml", job.stock.material, pass.cutter_file, pass.cutter);
  only_choice(table, "axis", {"vertical", "fixed", "lead_tilt"});
  RoughOptions& o = pass.options;
  o.allowance_mm = table.number_in("allowance_mm", o.allowance_mm, 0.01, 10);
  // A level and a line take time and memory each.
  o.stepdown_mm = table.number_in("stepdown_mm", o.stepdown_mm, 0.05, 50);
  o.stepover_mm = table.number_in("stepover_mm", o.stepover_mm, 0.1, 50);
  if (o.stepover_mm > pass.cutter.diameter_mm) {
    throw InputError(table.complaint("stepover_mm", "must be at most the cutter's diameter, " + std::to_string(pass.cutter.diameter_mm) + " mm"));
  }
  read_motion(table, o);
}

void read_ball_pass(TomlTable table, const fs::path& folder, const fs::path& fallback, const std::string& material, BallPass& pass) {
  read_pass_cutter(table, folder, fallback, material, pass.cutter_file, pass.cutter);
  if (!pass.cutter.is_ball()) throw InputError(table.complaint("cutter", "must be a ball cutter (corner radius half the diameter): " + pass.cutter_file.string()));
  if (pass.options.pass != "finish") not_yet(table, "blur_mm", "only finish.blur_mm decides what the light sees; use cusp_um");
  not_yet(table, "stepover_mm", "use cusp_um; the stepover follows from it");
  FinishOptions& o = pass.options;
  const std::string strategy = table.choice("strategy", "one_way", kStrategies);
  o.strategy = static_cast<Strategy>(std::find(kStrategies.begin(), kStrategies.end(), strategy) - kStrategies.begin());
  o.angle_rad = kDegree * table.number_in("angle_deg", 0, -360, 360);
  pass.along_creases = table.boolean("along_creases", false);
  if (pass.along_creases && o.pass != "finish") throw InputError(table.complaint("along_creases", "belongs to [finish]; a rest pass goes along creases anyway"));
  if (table.has("blur_mm")) {
    if (table.has("cusp_um")) throw InputError(table.complaint("blur_mm", "gives the cusp height, and so does cusp_um; give one of them"));
    pass.blur_mm = positive(table, "blur_mm", 0, 1000);
  }
  o.cusp_um = table.number_in("cusp_um", o.cusp_um, 0.01, 1000);
  o.allowance_mm = table.number_in("allowance_mm", o.allowance_mm, 0, 5);
  const std::string axis = table.choice("axis", axis_name(o.axis), {"fixed", "vertical", "lead_tilt"});
  o.axis = axis == "fixed" ? AxisPolicy::kFixed : axis == "vertical" ? AxisPolicy::kVertical : AxisPolicy::kLeadTilt;
  o.tilt_rad = kDegree * table.number_in("tilt_deg", o.tilt_rad / kDegree, 0, 80);
  o.tilt_direction_rad = kDegree * table.number_in("tilt_direction_deg", o.tilt_direction_rad / kDegree, -360, 360);
  o.chord_tolerance_mm = table.number_in("chord_tolerance_um", o.chord_tolerance_mm * 1000, 0.001, 1000) / 1000;
  o.longest_segment_mm = table.number_in("longest_segment_mm", o.longest_segment_mm, 0.01, 100);
  read_motion(table, o);
}

void read_rest(TomlTable table, const fs::path& folder, Job& job) {
  BallPass pass;
  pass.options = job.finish.options;
  pass.options.pass = "rest";
  read_ball_pass(table, folder, fixtures_folder() / "cutters/rest_1mm_ball.toml", job.stock.material, pass);
  if (pass.options.strategy != Strategy::kOneWay) throw InputError(table.complaint("strategy", "the rest pass goes along creases; leave it out"));
  if (!(pass.cutter.radius_mm() < job.finish.cutter.radius_mm())) {
    throw InputError(table.complaint("cutter", "must be a smaller ball than the finishing one: " + pass.cutter_file.string()));
  }
  for (const Cutter* other : {&job.rough.cutter, &job.semi_finish.cutter, &job.finish.cutter}) {
    if (other->number == pass.cutter.number) {
      throw InputError(table.complaint("cutter", "has the place " + std::to_string(pass.cutter.number) + " in the tool table, and so has '" + other->name + "'"));
    }
  }
  job.rest = pass;
}

void read_profile(TomlTable table, Job& job) {
  if (table.is_text("cut")) {
    table.choice("cut", "auto", {"auto"});
  } else if (table.has("cut")) {
    job.profile.cut = table.boolean("cut", true);
  }
  ProfileOptions& o = job.profile.options;
  if (table.is_text("tabs")) {
    table.choice("tabs", "auto", {"auto"});
  } else if (table.has("tabs")) {
    o.tabs = table.integer_in("tabs", o.tabs, 0, 100);
    job.profile.tabs_give_way = false;
  }
  o.tab_width_mm = positive(table, "tab_width_mm", o.tab_width_mm, 100);
  o.tab_height_mm = positive(table, "tab_height_mm", o.tab_height_mm, 100);
  o.skin_mm = table.number_in("skin_mm", o.skin_mm, 0, 10);
  if (o.tabs > 0 && o.tab_height_mm <= o.skin_mm) throw InputError(table.complaint("tab_height_mm", "must be above skin_mm"));
  o.stepdown_mm = job.rough.options.stepdown_mm;
  o.link_feed_mm_per_s = job.rough.options.link_feed_mm_per_s;
  o.max_feed_mm_per_s = job.rough.options.max_feed_mm_per_s;
  o.acceleration_mm_per_s2 = job.rough.options.acceleration_mm_per_s2;
  o.clearance_mm = job.rough.options.clearance_mm;
  if (job.land.width_mm > 0 && !is_cut_out(job)) {
    throw InputError(table.complaint("cut", "must be true for a lens with a land (lens.land_mm): the same pass mills it"));
  }
}

void read_machine_section(TomlTable table, const fs::path& folder, Job& job) {
  job.machine.file = path_in(table, "file", folder, fixtures_folder() / "machines/hsm400u_grblhal.toml");
  job.machine.workpiece_origin_mm = table.vector3("workpiece_origin_mm", job.machine.workpiece_origin_mm);
  job.machine.work_offset = table.integer_in("work_offset", job.machine.work_offset, 54, 59);
}

void read_controller(TomlTable table, Job& job) {
  std::vector<std::string_view> known;
  const std::vector<DialectFacts> all = dialects();
  for (const DialectFacts& dialect : all) known.push_back(dialect.name);
  std::error_code error;
  const std::string own = fs::exists(job.machine.file, error) ? read_machine(job.machine.file).controller : "grblhal";
  job.controller.dialect = table.choice("dialect", own, known);
  int most_decimals = 6;
  for (const DialectFacts& dialect : all) {
    if (dialect.name == job.controller.dialect) most_decimals = std::min(most_decimals, dialect.most_decimals);
  }
  job.controller.decimals = std::min(job.controller.decimals, most_decimals);
  job.controller.tcp = table.choice("tcp", "off", {"off", "on"}) == "on";
  job.controller.decimals = table.integer_in("decimals", job.controller.decimals, 4, most_decimals);
  job.controller.one_program = table.boolean("one_program", job.controller.one_program);
  job.controller.block_numbers = table.boolean("block_numbers", job.controller.block_numbers);
  job.controller.tip_tolerance_um = table.number_in("tip_tolerance_um", job.controller.tip_tolerance_um, 0.001, 1000);
  job.controller.arcs = table.boolean("arcs", job.controller.arcs);
}

void read_dry_run(TomlTable table, Job& job) {
  DryRunSpec& o = job.dry_run;
  o.pitch_um = table.number_in("pitch_um", o.pitch_um, 1, 1000);
  o.solid_pitch_um = number_or_auto(table, "solid_pitch_um", 0, 5000);
  o.starvation_mark_um = table.number_in("starvation_mark_um", o.starvation_mark_um, 0, 1000);
  o.wall_tolerance_um = table.number_in("wall_tolerance_um", o.wall_tolerance_um, 0, 1000);
  o.polish_sigma_um = table.number_in("polish_sigma_um", o.polish_sigma_um, 0, 10000);
  o.wavelength_um = table.number_in("wavelength_um", o.wavelength_um, 0, 20);
  if (job.finish.blur_mm) {
    job.finish.options.cusp_um = cusp_for_blur_um(job.finish.cutter.radius_mm(), *job.finish.blur_mm, job.receiver.distance_mm,
                                                  job.lens.refractive_index, o.polish_sigma_um / 1000);
  }
  o.gouge_tolerance_um = table.number_in("gouge_tolerance_um", o.gouge_tolerance_um, 0, 1000);
  // The plan keeps a margin below what is promised: 1.3 um planned, 1.5 um promised.
  const double promise = job.finish.options.cusp_um + std::max(0.2, 0.15 * job.finish.options.cusp_um);
  o.cusp_limit_um = table.number_in("cusp_limit_um", promise, 0, 10000);
  if (table.is_text("pace_baud")) table.choice("pace_baud", "auto", {"auto"});
  else if (table.has("pace_baud")) o.pace_baud = table.integer_in("pace_baud", 0, 0, 4'000'000);
  o.line_times = table.choice("line_times", o.line_times, {"auto", "on", "off"});
  o.time_factor = table.number_in("time_factor", o.time_factor, 0, 1e6);
  not_yet(table, "faults", "plant faults by dry-run's --machine, --cutters and --work-offset");
  not_yet(table, "error_model", "use [dry_run.errors]");
  TomlTable errors = table.table("errors");
  o.errors = read_machine_errors(errors);
}

void read_stream(TomlTable table, Job& job) {
  job.stream.port = table.text("port", job.stream.port);
  job.stream.baud = table.integer_in("baud", job.stream.baud, 300, 4'000'000);
  job.stream.protocol = table.choice("protocol", job.stream.protocol, {"auto", "grblhal", "grbl", "drip", "fe"});
  job.stream.format = table.text("format", job.stream.format);
  if (job.stream.format != "auto") {
    try {
      serial_format(job.stream.format);
    } catch (const InputError&) {
      throw InputError(table.complaint("format", "must be \"auto\", or data bits, parity and stop bits: \"8N1\", \"7E1\", \"7E2\""));
    }
  }
  job.stream.rts_cts = table.boolean("rts_cts", job.stream.rts_cts);
  job.stream.one_at_a_time = table.boolean("one_at_a_time", job.stream.one_at_a_time);
  job.stream.leader_nulls = table.integer_in("leader_nulls", job.stream.leader_nulls, 0, 50);
  job.stream.check_first = table.boolean("check_first", job.stream.check_first);
}

Job read_table(TomlTable root, const fs::path& folder, Job job) {
  TomlTable general = root.table("job");
  job.name = general.text("name", job.name);
  job.author = general.text("author", job.author);
  const fs::path cutters = fixtures_folder() / "cutters";
  job.semi_finish.options.pass = "semi_finish";
  job.semi_finish.options.cusp_um = 10;
  job.semi_finish.options.allowance_mm = 0.05;
  job.finish.options.pass = "finish";
  read_target(root.table("target"), folder, job);
  read_lens(root.table("lens"), folder, job);
  read_light(root.table("light"), folder, job);
  read_receiver(root.table("receiver"), job);
  read_transport(root.table("transport"), job);
  TomlTable surface = root.table("surface");
  read_surface(surface, job);
  read_stock(root.table("stock"), job);
  read_rough(root.table("rough"), folder, job);
  read_ball_pass(root.table("semi_finish"), folder, cutters / "semi_finish_4mm_ball.toml", job.stock.material, job.semi_finish);
  read_ball_pass(root.table("finish"), folder, cutters / "finish_4mm_ball.toml", job.stock.material, job.finish);
  // What the design is held against is the ball that will cut it.
  if (!surface.has("min_concave_radius_mm")) job.surface.min_concave_radius_mm = job.finish.cutter.radius_mm();
  read_profile(root.table("profile"), job);
  read_mount(root.table("mount"), job);
  TomlTable solid = root.table("solid");
  job.spline_fit.finer_creases = solid.boolean("finer_creases", job.spline_fit.finer_creases);
  job.step_schema = solid.choice("step", "ap242", {"ap242", "ap214"}) == "ap214" ? StepSchema::kAp214 : StepSchema::kAp242;
  job.mesh_tolerance_mm = solid.number_in("mesh_tolerance_mm", job.mesh_tolerance_mm, 0, 10);
  if (job.mesh_tolerance_mm > 0 && job.mesh_tolerance_mm < 0.005) {
    throw InputError(solid.complaint("mesh_tolerance_mm", "must be 0 (no mesh) or at least 0.005: a mesh for a printer, not the lens"));
  }
  read_machine_section(root.table("machine"), folder, job);
  read_controller(root.table("controller"), job);
  read_dry_run(root.table("dry_run"), job);
  if (root.has("rest")) read_rest(root.table("rest"), folder, job);
  read_stream(root.table("stream"), job);
  root.finish();
  if (job.rough.options.allowance_mm <= job.semi_finish.options.allowance_mm) {
    throw InputError("rough.allowance_mm must be above semi_finish.allowance_mm, or semi-finishing finds nothing to cut");
  }
  if (job.semi_finish.options.allowance_mm < job.finish.options.allowance_mm) {
    throw InputError("semi_finish.allowance_mm must be at least finish.allowance_mm");
  }
  return job;
}

bool is_picture(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(), [](char c) { return c >= 'A' && c <= 'Z' ? char(c + 32) : c; });
  for (const char* known : {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".bmp", ".pgm", ".ppm", ".webp", ".svg"}) {
    if (extension == known) return true;
  }
  return false;
}

/// Lines of `key = value`. 12 significant digits, so that a unit conversion and back writes the same text.
class Section {
 public:
  Section& put(std::string_view key, double value) { return line(key, number(value)); }
  Section& put(std::string_view key, const std::optional<double>& value) { return value ? put(key, *value) : put(key, "auto"); }
  Section& put(std::string_view key, int value) { return line(key, std::to_string(value)); }
  Section& put(std::string_view key, bool value) { return line(key, value ? "true" : "false"); }
  Section& put(std::string_view key, const Vec2& v) { return line(key, "[" + number(v.x()) + ", " + number(v.y()) + "]"); }
  Section& put(std::string_view key, const Vec3& v) {
    return line(key, "[" + number(v.x()) + ", " + number(v.y()) + ", " + number(v.z()) + "]");
  }
  Section& put(std::string_view key, const std::vector<Vec2>& places) {
    std::string rows;
    for (const Vec2& p : places) rows += (rows.empty() ? "[" : ", [") + number(p.x()) + ", " + number(p.y()) + "]";
    return line(key, "[" + rows + "]");
  }
  Section& put(std::string_view key, const std::vector<KeepOut>& boxes) {
    std::string rows;
    for (const KeepOut& box : boxes) {
      rows += rows.empty() ? "[" : ", [";
      for (const double v : box.min_mm) rows += number(v) + ", ";
      rows += number(box.max_mm.x()) + ", " + number(box.max_mm.y()) + ", " + number(box.max_mm.z()) + "]";
    }
    return line(key, "[" + rows + "]");
  }
  Section& put(std::string_view key, const char* value) { return put(key, std::string(value)); }
  Section& put(std::string_view key, const fs::path& value) { return put(key, value.string()); }
  Section& put(std::string_view key, const std::string& value) {
    std::string quoted = "\"";
    for (const char c : value) {
      if (c == '"' || c == '\\') {
        quoted += '\\';
        quoted += c;
      } else if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
        quoted += "\\u00";
        quoted += "0123456789ABCDEF"[(c >> 4) & 15];
        quoted += "0123456789ABCDEF"[c & 15];
      } else {
        quoted += c;
      }
    }
    return line(key, quoted + "\"");
  }
  operator std::string() const { return text_; }

  static std::string number(double value) {
    char buffer[64];
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, value == 0 ? 0.0 : value, std::chars_format::general, 12).ptr;
    std::string text(buffer, end);
    if (text.find_first_of(".e") == std::string::npos) text += ".0";
    return text;
  }

 private:
  Section& line(std::string_view key, const std::string& value) {
    text_ += std::string(key) + " = " + value + "\n";
    return *this;
  }
  std::string text_;
};

std::string ball_section(const BallPass& pass) {
  const FinishOptions& o = pass.options;
  return Section()
      .put("cutter", pass.cutter_file)
      .put("spindle_rpm", pass.cutter.spindle_rpm)
      .put("feed_per_tooth_mm", pass.cutter.feed_per_tooth_mm)
      .put("strategy", std::string(kStrategies[static_cast<std::size_t>(o.strategy)]))
      .put("angle_deg", o.angle_rad / kDegree)
      .put("along_creases", pass.along_creases)
      .put("cusp_um", o.cusp_um)
      .put("allowance_mm", o.allowance_mm)
      .put("axis", axis_name(o.axis))
      .put("tilt_deg", o.tilt_rad / kDegree)
      .put("tilt_direction_deg", o.tilt_direction_rad / kDegree)
      .put("chord_tolerance_um", o.chord_tolerance_mm * 1000)
      .put("longest_segment_mm", o.longest_segment_mm)
      .put("link_feed_mm_per_min", o.link_feed_mm_per_s * 60)
      .put("max_feed_mm_per_min", o.max_feed_mm_per_s * 60)
      .put("acceleration_mm_per_s2", o.acceleration_mm_per_s2)
      .put("clearance_mm", o.clearance_mm);
}

}  // namespace

fs::path fixtures_folder() {
  const char* chosen = std::getenv("LIGHTMILL_FIXTURES");
  return chosen && *chosen ? fs::absolute(chosen) : fs::path(LIGHTMILL_FIXTURES);
}

bool is_cut_out(const Job& job) {
  return job.profile.cut.value_or(job.lens.shape != Lens::Shape::kRectangle || job.land.width_mm > 0);
}

Vec2 blank_size_mm(const Job& job) {
  return job.lens.size_mm + Vec2::Constant(2 * (job.land.width_mm + blank_margin_mm(job)));
}

std::vector<KeepOut> keep_outs_of(const Job& job) {
  std::vector<KeepOut> all = job.stock.keep_outs;
  if (job.stock.work_holding != "vise") return all;
  const std::vector<KeepOut> jaws = vise_jaws(blank_size_mm(job), job.stock.jaw_mm);
  all.insert(all.end(), jaws.begin(), jaws.end());
  return all;
}

double blank_margin_mm(const Job& job) {
  constexpr double kOutsideMillMm = 2;  // of material that stays around the slot
  return job.stock.margin_mm.value_or(is_cut_out(job) ? job.rough.cutter.diameter_mm + kOutsideMillMm : 0);
}

double solid_pitch_um(const Job& job) {
  constexpr double kForWalls_um = 200;
  return job.dry_run.solid_pitch_um.value_or(is_cut_out(job) ? kForWalls_um : 0);
}

const char* axis_name(AxisPolicy axis) {
  return axis == AxisPolicy::kVertical ? "vertical" : axis == AxisPolicy::kFixed ? "fixed" : "lead_tilt";
}

int pace_baud(const Job& job) { return job.dry_run.pace_baud.value_or(job.stream.baud); }

Job read_job_text(std::string_view toml, const std::string& name, const fs::path& folder) {
  Job job;
  job.name = fs::path(name).stem().string();
  return read_table(TomlTable::from_text(toml, name), folder, job);
}

Job read_job(const fs::path& job_or_picture) {
  const fs::path path = fs::absolute(job_or_picture).lexically_normal();
  std::error_code error;
  if (!fs::exists(path, error)) throw InputError(job_or_picture.string() + " does not exist; name a job (.toml) or a picture (.png, .svg)");
  if (!is_picture(path)) return read_job_text(read_whole(path), job_or_picture.string(), path.parent_path());
  Job job;
  job.name = path.stem().string();
  (path.extension() == ".svg" || path.extension() == ".SVG" ? job.target.drawing : job.target.image) = path;
  return read_table(TomlTable::from_text("", job_or_picture.string()), path.parent_path(), job);
}

std::map<std::string, std::string> resolved_sections(const Job& job) {
  std::map<std::string, std::string> sections;
  sections["job"] = Section().put("name", job.name).put("author", job.author);
  Section target;
  if (!job.target.image.empty()) target.put("image", job.target.image);
  if (!job.target.colours.empty()) target.put("colours", job.target.colours);
  target.put("color_mask", job.target.color_mask);
  if (!job.target.drawing.empty()) target.put("drawing", job.target.drawing);
  target.put("size_mm", job.target.size_mm);
  if (job.target.curve_flux < 0) {
    target.put("curve_flux", "auto");
  } else {
    target.put("curve_flux", job.target.curve_flux);
  }
  target.put("background", job.target.background)
      .put("transfer", job.target.transfer == Transfer::kAuto ? "auto" : job.target.transfer == Transfer::kSrgb ? "srgb" : "linear");
  sections["target"] = target;
  const SourceFiles& files = job.source_files;
  Section lens;
  lens.put("shape", job.lens.shape == Lens::Shape::kDisk ? "disk" : job.lens.shape == Lens::Shape::kOutline ? "outline" : "rectangle");
  if (!files.outline.empty()) lens.put("outline", files.outline);
  const Base& base = job.lens.base;
  lens.put("size_mm", job.lens.size_mm)
      .put("thickness_mm", job.lens.thickness_mm)
      .put("refractive_index", job.lens.refractive_index)
      .put("base", std::string(kBases[static_cast<std::size_t>(base.kind)]));
  if (base.kind == Base::Kind::kSphere || base.kind == Base::Kind::kCylinder) lens.put("base_radius_mm", base.radius_mm);
  if (base.kind == Base::Kind::kCylinder) lens.put("base_axis_deg", base.axis_rad / kDegree);
  if (!files.base.empty()) lens.put("base_file", files.base);
  if (base.kind == Base::Kind::kImage) lens.put("base_scale_mm", files.base_scale_mm);
  lens.put("land_mm", job.land.width_mm).put("land_drop_mm", job.land.drop_mm);
  sections["lens"] = lens;
  const Light& beam = job.light.beam;
  Section light;
  light.put("kind", std::string(kLights[static_cast<std::size_t>(beam.kind)]));
  if (beam.kind == Light::Kind::kParallel) light.put("direction", beam.direction);
  if (beam.kind == Light::Kind::kPoint) light.put("position_mm", beam.position_mm);
  if (!files.light_mesh.empty()) light.put("mesh", files.light_mesh);
  light.put("profile", std::string(kProfiles[static_cast<std::size_t>(beam.profile.kind)]));
  if (beam.profile.kind == Profile::Kind::kGaussian) light.put("sigma_mm", beam.profile.sigma_mm).put("centre_mm", beam.profile.centre_mm);
  if (!files.light_image.empty()) light.put("image", files.light_image);
  sections["light"] = light.put("angular_diameter_deg", job.light.angular_diameter_rad / kDegree)
                          .put("fresnel", job.light.fresnel)
                          .put("dispersion", job.light.dispersion);
  sections["receiver"] = Section()
                             .put("distance_mm", job.receiver.distance_mm)
                             .put("shift_mm", job.receiver.shift_mm)
                             .put("tilt_deg", Vec2(job.receiver.tilt_rad / kDegree))
                             .put("viewed_from", job.receiver.viewed_from == ViewedFrom::kLens ? "lens" : "behind");
  sections["transport"] = Section()
                              .put("solver", job.transport.solver == TransportSolver::kLbfgs ? "lbfgs" : "newton")
                              .put("samples", job.transport.samples)
                              .put("l1_tolerance", job.transport.l1_tolerance)
                              .put("max_tolerance", job.transport.max_tolerance)
                              .put("max_iterations", job.transport.max_iterations)
                              .put("point_radius_mm", job.transport.point_radius_mm)
                              .put("seed", static_cast<int>(job.transport.seed));
  const SurfaceWeights& w = job.surface.weights;
  sections["surface"] = std::string(Section()
                                        .put("solver", std::string(kSurfaceSolvers[static_cast<std::size_t>(job.surface.solver)]))
                                        .put("mesh", job.surface.mesh)
                                        .put("outer_iterations", job.surface.outer_iterations)
                                        .put("picture_turns", job.surface.picture_turns)
                                        .put("height_tolerance_um", job.surface.height_tolerance_mm * 1000)
                                        .put("min_concave_radius_mm", job.surface.min_concave_radius_mm)
                                        .put("limit_hollows", job.surface.limit_hollows)) +
                        "weights = { integration = " + Section::number(w.integration) + ", barrier = " + Section::number(w.barrier) +
                        ", direction = " + Section::number(w.direction) + ", flux = " + Section::number(w.flux) +
                        ", smoothness = " + Section::number(w.smoothness) + " }\n";
  Section stock;
  sections["stock"] = stock.put("height_mm", job.stock.height_mm)
                          .put("margin_mm", job.stock.margin_mm)
                          .put("allowance_mm", job.stock.allowance_mm)
                          .put("keep_outs", job.stock.keep_outs)
                          .put("material", job.stock.material)
                          .put("work_holding", job.stock.work_holding);
  if (job.stock.work_holding == "vise") sections["stock"] = stock.put("jaw_mm", job.stock.jaw_mm);
  const RoughOptions& r = job.rough.options;
  sections["rough"] = Section()
                          .put("cutter", job.rough.cutter_file)
                          .put("spindle_rpm", job.rough.cutter.spindle_rpm)
                          .put("feed_per_tooth_mm", job.rough.cutter.feed_per_tooth_mm)
                          .put("axis", "vertical")
                          .put("allowance_mm", r.allowance_mm)
                          .put("stepdown_mm", r.stepdown_mm)
                          .put("stepover_mm", r.stepover_mm)
                          .put("link_feed_mm_per_min", r.link_feed_mm_per_s * 60)
                          .put("max_feed_mm_per_min", r.max_feed_mm_per_s * 60)
                          .put("acceleration_mm_per_s2", r.acceleration_mm_per_s2)
                          .put("clearance_mm", r.clearance_mm);
  sections["semi_finish"] = ball_section(job.semi_finish);
  sections["finish"] = ball_section(job.finish);
  if (job.rest) sections["rest"] = ball_section(*job.rest);
  const ProfileOptions& p = job.profile.options;
  Section profile;
  if (job.profile.cut) {
    profile.put("cut", *job.profile.cut);
  } else {
    profile.put("cut", "auto");
  }
  sections["profile"] =
      (job.profile.tabs_give_way ? profile.put("tabs", "auto") : profile.put("tabs", p.tabs)).put("tab_width_mm", p.tab_width_mm).put("tab_height_mm", p.tab_height_mm).put("skin_mm", p.skin_mm);
  const MountOptions& m = job.mount;
  Section mount;
  mount.put("chamfer_mm", m.chamfer_mm)
      .put("dowels_mm", m.dowels_mm)
      .put("dowel_diameter_mm", m.dowel_diameter_mm)
      .put("dowel_depth_mm", m.dowel_depth_mm)
      .put("label", m.label)
      .put("label_side", m.label_on_back ? "back" : "land")
      .put("label_height_mm", m.label_height_mm)
      .put("label_depth_mm", m.label_depth_mm);
  if (m.label_at_mm) mount.put("label_at_mm", *m.label_at_mm);
  sections["mount"] = mount;
  sections["solid"] = Section()
                          .put("finer_creases", job.spline_fit.finer_creases)
                          .put("step", job.step_schema == StepSchema::kAp214 ? "ap214" : "ap242")
                          .put("mesh_tolerance_mm", job.mesh_tolerance_mm);
  sections["machine"] = Section()
                            .put("file", job.machine.file)
                            .put("workpiece_origin_mm", job.machine.workpiece_origin_mm)
                            .put("work_offset", job.machine.work_offset);
  sections["controller"] = Section()
                               .put("dialect", job.controller.dialect)
                               .put("tcp", job.controller.tcp ? "on" : "off")
                               .put("decimals", job.controller.decimals)
                               .put("one_program", job.controller.one_program)
                               .put("block_numbers", job.controller.block_numbers)
                               .put("tip_tolerance_um", job.controller.tip_tolerance_um)
                               .put("arcs", job.controller.arcs);
  sections["dry_run"] = Section()
                            .put("pitch_um", job.dry_run.pitch_um)
                            .put("solid_pitch_um", job.dry_run.solid_pitch_um)
                            .put("starvation_mark_um", job.dry_run.starvation_mark_um)
                            .put("wall_tolerance_um", job.dry_run.wall_tolerance_um)
                            .put("polish_sigma_um", job.dry_run.polish_sigma_um)
                            .put("wavelength_um", job.dry_run.wavelength_um)
                            .put("gouge_tolerance_um", job.dry_run.gouge_tolerance_um)
                            .put("cusp_limit_um", job.dry_run.cusp_limit_um)
                            .put("pace_baud", job.dry_run.pace_baud)
                            .put("line_times", job.dry_run.line_times)
                            .put("time_factor", job.dry_run.time_factor);
  sections["dry_run"] += machine_errors_text(job.dry_run.errors, "errors.");
  sections["stream"] = Section()
                           .put("port", job.stream.port)
                           .put("baud", job.stream.baud)
                           .put("protocol", job.stream.protocol)
                           .put("format", job.stream.format)
                           .put("rts_cts", job.stream.rts_cts)
                           .put("one_at_a_time", job.stream.one_at_a_time)
                           .put("leader_nulls", job.stream.leader_nulls)
                           .put("check_first", job.stream.check_first);
  return sections;
}

std::string resolved_toml(const Job& job) {
  const auto sections = resolved_sections(job);
  std::string text = "# The whole job with every default explicit. Written by lightmill " LIGHTMILL_VERSION ".\n";
  for (const char* name : kSections) {
    if (sections.contains(name)) text += "\n[" + std::string(name) + "]\n" + sections.at(name);
  }
  return text;
}

}  // namespace lightmill
