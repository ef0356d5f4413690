#include <algorithm>
#include <cmath>
#include <limits>

#include "cam/finishing.h"
#include "cam/outline.h"
#include "cam/outline_region.h"
#include "cam/profile.h"
#include "cam/reachable.h"
#include "cam/rest.h"
#include "cam/roughing.h"
#include "cam/solid.h"
#include "cli/cam_inputs.h"
#include "cli/crease_report.h"
#include "cli/job_light.h"
#include "cli/machinability_report.h"
#include "cli/pictures.h"
#include "cli/spline_file.h"
#include "cli/stage_runs.h"
#include "design/caustic.h"
#include "design/core/errors.h"
#include "design/core/image.h"
#include "design/core/text.h"
#include "postproc/machine_model.h"

namespace lightmill {

using nlohmann::json;

namespace {

json to_json(const ToolPath& path, double rapid_mm_per_s) {
  double cut_mm = 0, cut_s = 0, slowest = std::numeric_limits<double>::infinity(), fastest = 0;
  for (std::size_t i = 1; i < path.moves.size(); ++i) {
    const Move& move = path.moves[i];
    if (move.kind != MoveKind::kCut && move.kind != MoveKind::kPlunge) continue;
    const double length = (move.pose.tip_mm - path.moves[i - 1].pose.tip_mm).norm();
    cut_mm += length;
    cut_s += length / move.feed_mm_per_s;
    if (move.kind == MoveKind::kPlunge) continue;
    slowest = std::min(slowest, move.feed_mm_per_s);
    fastest = std::max(fastest, move.feed_mm_per_s);
  }
  return {{"length_mm", path.length_mm()},   {"cutting_length_mm", cut_mm},
          {"points", path.moves.size()},     {"stepover_mm", path.stepover_mm},
          {"minutes", path.minutes(rapid_mm_per_s)}, {"predicted_cusp_um", path.predicted_cusp_um},
          {"cutter", path.cutter.name},      {"spindle_rpm", path.spindle_rpm},
          {"feed_mm_per_min", path.cutter.feed_mm_per_s() * 60},
          // What is planned: the cutter's, lowered for thin chips, even marks and gentle bends.
          {"slowest_feed_mm_per_min", std::min(slowest, fastest) * 60},
          {"fastest_feed_mm_per_min", fastest * 60},
          {"mean_feed_mm_per_min", cut_s > 0 ? cut_mm / cut_s * 60 : 0}};
}

}  // namespace

StageResult run_cam(const Job& job, const RunFolder& folder, const Monitor& monitor) {
  const Scene scene = scene_of(job);
  const Outline outline = outline_of(scene.lens);
  const bool cut_out = is_cut_out(job);
  const SurfaceMesh mesh = read_ply(folder.needed("design/surface.ply", "design"));
  const Box2 extent = Box2::centred(job.lens.size_mm);
  const SplineFit fit = fit_spline(mesh, extent, job.spline_fit, monitor.part(0, 0.1));
  const SplineSurface surface = faded_outside(fit.surface, outline, job.land.drop_mm);
  const Blank blank = blank_of(job, surface);
  write_spline(folder.file("cam/spline.bin"), surface);

  SolidOptions solid_options;
  solid_options.product_name = job.name;
  solid_options.author = job.author;
  solid_options.material = job.stock.material;
  solid_options.schema = job.step_schema;
  solid_options.mesh_tolerance_mm = job.mesh_tolerance_mm;
  if (outline.shape != Outline::Shape::kRectangle || job.land.width_mm > 0) solid_options.outline = outline;
  solid_options.land_mm = job.land.width_mm;
  solid_options.mount = job.mount;
  if (job.land.width_mm > 0) solid_options.land_z_mm = land_z_mm(job, surface, outline);
  const SolidSummary solid = write_lens_step(folder.file("cam/lens.step"), surface, solid_options, monitor.part(0.1, 0.3));
  write_blank_step(folder.file("cam/stock.step"), blank);
  if (job.mesh_tolerance_mm > 0) {
    write_stl(folder.file("cam/lens.stl"), solid.mesh);
    write_3mf(folder.file("cam/lens.3mf"), solid.mesh, job.name);
  }

  FinishOptions semi_finish = job.semi_finish.options;
  FinishOptions finish = job.finish.options;
  semi_finish.outline = finish.outline = finishing_border(job, outline);
  const ReachableSurface reachable = reachable_by_finishing(job, surface, outline, monitor.part(0.3, 0.38));
  if (job.finish.along_creases) {
    for (const Crease& crease : concave_creases(surface, reachable)) finish.also_along.push_back(line_to_follow(crease));
  }

  std::vector<ToolPath> passes;
  RoughChoice rough = plan_faster_roughing(surface, blank, job.rough.cutter, job.rough.options, monitor.part(0.38, 0.48));
  const bool roughed = !rough.path.moves.empty();
  if (roughed) passes.push_back(std::move(rough.path));
  semi_finish.standing = rough.rest;
  passes.push_back(plan_finishing(surface, blank, job.semi_finish.cutter, semi_finish, monitor.part(0.48, 0.62)));
  // Above its flutes nothing cuts.
  const double deepest_mm = deepest_cut_mm(rough.rest, passes.back());
  if (deepest_mm > job.semi_finish.cutter.flute_length_mm) {
    throw InputError("semi_finish: roughing leaves " + compact(deepest_mm, 2) + " mm to be cut at once, the flutes of '" + job.semi_finish.cutter.name +
                     "' are " + compact(job.semi_finish.cutter.flute_length_mm, 2) + " mm long; use a smaller roughing mill or a ball with longer flutes");
  }
  finish.standing = after_pass(rough.rest, passes.back());
  passes.push_back(plan_finishing(surface, blank, job.finish.cutter, finish, monitor.part(0.62, 0.9)));
  std::optional<RestPlan> rest;
  FinishOptions rest_options;
  if (job.rest) {
    rest_options = job.rest->options;
    rest_options.outline = finish.outline;
    rest_options.standing = after_pass(*finish.standing, passes.back());
    constexpr double kShortestMm = 0;  // a crease may be out of reach in spots
    rest = plan_rest(surface, blank, job.rest->cutter, concave_creases(surface, reachable, kShortestMm), reachable, passes.back(), rest_options, monitor.part(0.9, 0.93));
    if (rest->ways > 0) passes.push_back(std::move(rest->path));
  }
  std::optional<ProfileOptions> profile;
  if (cut_out) {
    profile = profile_options(job, surface, outline);
    passes.push_back(plan_profile(surface, blank, outline, job.rough.cutter, *profile, monitor.part(0.93, 0.95)));
  }
  write_toolpaths(folder.file("cam/toolpaths.bin"), passes);

  // The light that an ideal ball's part will cast: what creases and hollows lose to its radius, before any cusp.
  monitor.report("light through what the ball reaches", 0.95);
  const TargetLight target = target_of(job);
  CausticOptions light_options;
  light_options.angular_diameter_rad = job.light.angular_diameter_rad;
  const Caustic caustic = trace_heights(reachable.closing_mm, reachable.extent, scene.lens, scene.light, job.receiver, target.extent, light_options);
  write_png8(folder.file("cam/caustic_reachable.png"), display_picture(caustic.flux, job.receiver.viewed_from, display_white(target)));

  monitor.report("pictures", 0.97);
  constexpr int kHeightPixels = 800;
  write_height_picture(folder.file("cam/surface.png"), sample_heights(surface, kHeightPixels), extent.size().maxCoeff() / kHeightPixels);
  write_deviation_picture(folder.file("cam/unreachable.png"), reachable.residue_um, std::max(1.0, std::ceil(reachable.max_residue_um)));
  const Grid<float> normals_left = residue_normals_mrad(reachable);
  write_deviation_picture(folder.file("cam/unreachable_normals.png"), normals_left,
                          std::max(1.0, std::ceil(static_cast<double>(*std::max_element(normals_left.values.begin(), normals_left.values.end())))), "mrad");
  const double ball_mm = job.finish.cutter.radius_mm();
  const OutlineRegion lens(outline, 0);
  const Grid<float> hollows = sample_surface(surface, kHeightPixels, [&](const Vec2& p, const SplineSurface::Sample& s) {
    return lens.contains(p) ? ball_mm * hollow_curvature(s) : std::numeric_limits<double>::quiet_NaN();
  });
  write_deviation_picture(folder.file("cam/hollows.png"), hollows, 1, "ball");

  const FitErrors errors = fit_errors(mesh, surface);
  const double height_range_um = std::max(0.5, std::ceil(4 * fit.summary.rms_deviation_um));
  std::vector<double> normal_mrad;
  for (const double urad : errors.normal_urad) normal_mrad.push_back(urad / 1000);
  write_deviation_picture(folder.file("cam/fit_height.png"), rasterise_values(mesh, errors.height_um, extent, kHeightPixels), height_range_um);
  write_deviation_picture(folder.file("cam/fit_normal.png"), rasterise_values(mesh, normal_mrad, extent, kHeightPixels),
                          std::max(0.1, std::ceil(3 * fit.summary.rms_normal_deviation_urad) / 1000), "mrad");

  StageResult result;
  result.files = {"cam/caustic_reachable.png", "cam/fit_height.png", "cam/fit_normal.png", "cam/spline.bin", "cam/lens.step", "cam/stock.step", "cam/toolpaths.bin", "cam/surface.png", "cam/unreachable.png", "cam/unreachable_normals.png", "cam/hollows.png"};
  if (job.mesh_tolerance_mm > 0) result.files.insert(result.files.end(), {"cam/lens.stl", "cam/lens.3mf"});
  const double rapid = read_machine(job.machine.file).x.max_speed_mm_per_s;
  json& cam = result.report["cam"];
  for (const ToolPath& path : passes) {
    const std::string picture = "cam/toolpaths_" + path.pass + ".png";
    write_toolpath_picture(folder.file(picture), path, blank);
    result.files.push_back(picture);
    cam[path.pass] = to_json(path, rapid);
    if (path.pass != "semi_finish" && path.pass != "finish" && path.pass != "rest") continue;
    const FinishOptions& options = path.pass == "finish" ? finish : path.pass == "rest" ? rest_options : semi_finish;
    const ContactSummary contact = contact_summary(surface, path, options);
    cam[path.pass]["contact"] = {{"least_angle_deg", contact.least_angle_rad * 180 / kPi},
                                 {"most_angle_deg", contact.most_angle_rad * 180 / kPi},
                                 {"slowest_m_per_min", contact.slowest_m_per_min},
                                 {"fastest_m_per_min", contact.fastest_m_per_min},
                                 {"least_diameter_mm", contact.least_diameter_mm},
                                 {"most_diameter_mm", contact.most_diameter_mm},
                                 {"climb_share", contact.climb_share}};
  }
  if (roughed) {
    cam["rough"]["conventional_share"] = rough.cutting.conventional_share();
    cam["rough"]["both_sides_share"] = rough.cutting.both_sides_share();
    cam["rough"]["strategy"] = rough.way == RoughWay::kLayers ? "layers" : "levels";
    cam["rough"]["levels_minutes"] = rough.levels_minutes;
    cam["rough"]["layers_minutes"] = rough.layers_minutes;
  }
  cam["semi_finish"]["deepest_cut_mm"] = deepest_mm;
  if (profile) cam["profile"].update({{"tabs", profile->tabs}, {"tab_width_mm", profile->tab_width_mm}, {"tab_height_mm", profile->tab_height_mm}});
  cam["creases"] = creases_json(surface, reachable, job);
  cam["machinability"] = machinability_json(job, surface, outline, reachable);
  if (rest) {
    cam["creases"]["rest"] = {{"ways", rest->ways},
                              {"ball_radius_mm", job.rest->cutter.radius_mm()},
                              {"highest_before_um", rest->highest_before_um},
                              {"highest_after_um", rest->highest_after_um},
                              {"area_before_mm2", rest->area_before_mm2},
                              {"area_after_mm2", rest->area_after_mm2}};
  }
  cam["solid"] = {{"valid", solid.valid},
                  {"volume_mm3", solid.volume_mm3},
                  {"spline_volume_mm3", solid.expected_volume_mm3},
                  {"faces", solid.faces},
                  {"mesh_triangles", solid.mesh.triangles.size()},
                  {"free_edges", solid.free_edges},
                  {"file_bytes", solid.file_bytes},
                  {"max_deviation_um", fit.summary.max_deviation_um},
                  {"rms_deviation_um", fit.summary.rms_deviation_um},
                  {"rms_normal_deviation_urad", fit.summary.rms_normal_deviation_urad},
                  {"crease_share", fit.summary.crease_share},
                  {"crease_width_mm", fit.summary.crease_width_mm},
                  {"face_deviation_um", solid.max_deviation_um},
                  {"seconds", solid.seconds}};
  cam["blank"] = {{"size_mm", {blank.size_mm.x(), blank.size_mm.y()}},
                  {"height_mm", blank.height_mm},
                  {"highest_mm", surface.highest()},
                  {"lowest_mm", surface.lowest()},
                  {"roughed", roughed}};
  cam["reachable"] = {{"unreachable_area_mm2", reachable.unreachable_area_mm2},
                      {"unreachable_share", reachable.unreachable_area_mm2 / outline.area_mm2()},
                      {"threshold_um", reachable.threshold_um},
                      {"max_residue_um", reachable.max_residue_um},
                      {"ball_radius_mm", job.finish.cutter.radius_mm()},
                      {"caustic", to_json(measure_caustic(caustic, target))}};
  return result;
}

}  // namespace lightmill
