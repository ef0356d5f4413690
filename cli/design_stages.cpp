#include <algorithm>
#include <cmath>

#include "cli/job_light.h"
#include "cli/light_pictures.h"
#include "cli/mask_print.h"
#include "cli/npy.h"
#include "cli/pictures.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/mesh.h"
#include "design/source.h"

namespace lightmill {

using nlohmann::json;

namespace {

constexpr int kPicturePixels = 512;

/// Site x, y, source mass, weight, target centroid x, y; beside it source centroid x, y and target mass.
void write_map(const RunFolder& folder, const TransportMap& map) {
  NpyTable table{6, {}};
  NpyTable rest{3, {}};
  for (std::size_t i = 0; i < map.sites_mm.size(); ++i) {
    table.values.insert(table.values.end(), {map.sites_mm[i].x(), map.sites_mm[i].y(), map.source_masses[i], map.weights_mm2[i],
                                             map.target_centroids_mm[i].x(), map.target_centroids_mm[i].y()});
    rest.values.insert(rest.values.end(), {map.source_centroids_mm[i].x(), map.source_centroids_mm[i].y(), map.target_masses[i]});
  }
  write_npy(folder.file("design/transport.npy"), table);
  write_npy(folder.file("design/transport_cells.npy"), rest);
}

TransportMap read_map(const RunFolder& folder) {
  const NpyTable table = read_npy(folder.needed("design/transport.npy", "design"));
  const NpyTable rest = read_npy(folder.needed("design/transport_cells.npy", "design"));
  if (table.columns != 6 || rest.columns != 3 || table.rows() != rest.rows()) {
    throw InputError(folder.file("design/transport.npy").string() + " and transport_cells.npy do not belong together; run lightmill design " +
                     folder.root().string());
  }
  TransportMap map;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const double* a = &table.values[6 * i];
    const double* b = &rest.values[3 * i];
    map.sites_mm.emplace_back(a[0], a[1]);
    map.source_masses.push_back(a[2]);
    map.weights_mm2.push_back(a[3]);
    map.target_centroids_mm.emplace_back(a[4], a[5]);
    map.source_centroids_mm.emplace_back(b[0], b[1]);
    map.target_masses.push_back(b[2]);
  }
  return map;
}

/// Where the job's light would land unbent; an error where it folds.
TracedSource source_of(const Scene& scene, const Job& job) {
  TracedSource traced = trace_source(scene.lens, scene.light, job.receiver);
  if (traced.report.folded.share > 0) {
    SourceReport fold;
    fold.folded = traced.report.folded;
    throw InputError("light: " + fold.words().front() +
                     "; no surface can sort light that is mixed before it; move the receiver (receiver.distance_mm) or flatten the base");
  }
  return traced;
}

json to_json(const SourceFault& fault) {
  json place = {{"share", fault.share}};
  if (fault.share > 0) place["lens_mm"] = {fault.lens_mm.x(), fault.lens_mm.y()};
  return place;
}

Vec2 picture_pixels(const Box2& extent) {
  const Vec2 size = extent.size();
  const double pixel = size.maxCoeff() / kPicturePixels;
  return {std::max(1.0, std::round(size.x() / pixel)), std::max(1.0, std::round(size.y() / pixel))};
}

/// target.png: 16-bit linear, clipped where strokes and points are endlessly bright; target_view.png for the eye.
double write_target_pictures(const Job& job, const RunFolder& folder, const TargetLight& target) {
  const Vec2 pixels = picture_pixels(target.extent);
  const Grid<double> flux = rasterise(target, static_cast<int>(pixels.x()), static_cast<int>(pixels.y()));
  const double mean = 1.0 / static_cast<double>(flux.values.size());
  const double brightest = *std::max_element(flux.values.begin(), flux.values.end()) / mean;
  const double white = display_white(target);
  const bool endless = !target.curves.empty() || !target.points.empty();
  const double full_scale = endless ? std::min(brightest, 4 * white) : brightest;
  Grid<float> linear(flux.width, flux.height);
  for (std::size_t i = 0; i < linear.values.size(); ++i) linear.values[i] = static_cast<float>(flux.values[i] / mean / full_scale);
  write_png16(folder.file("design/target.png"), as_seen(linear, job.receiver.viewed_from));
  write_png8(folder.file("design/target_view.png"), display_picture(flux, job.receiver.viewed_from, white));
  return full_scale;
}

/// The filter on the lens's back and the light through it, if the target has colours; returns the files.
std::vector<std::string> write_color_mask(const Job& job, const RunFolder& folder, const Scene& scene, const SurfaceMesh& mesh,
                                          const std::vector<RayEnds>& ends, const TargetLight& target, const Caustic& caustic,
                                          double white) {
  auto colours = target_colours(job.target);
  if (!colours) return {};
  clear_for_curves(*colours, target);
  constexpr double kInch = 25.4;
  const Box2 film = Box2::centred(scene.lens.size_mm + 2 * Vec2(kMaskMargin_mm, kMaskMargin_mm));
  write_mask_png(folder.file("design/color_mask.png"), colour_mask(mesh, ends, *colours, film, kMaskDotsPerInch / kInch));
  write_mask_svg(folder.file("design/color_mask.svg"), "color_mask.png", scene.lens, job.name);
  ColourGrid light = coloured(caustic, *colours);
  // As bright as the caustic's picture.
  double landed = 0;
  for (const double f : caustic.flux.values) landed += f;
  const auto scale = static_cast<float>(static_cast<double>(caustic.flux.values.size()) / (std::max(landed, 1e-30) * white));
  for (Grid<float>* channel : {&light.red, &light.green, &light.blue}) {
    for (float& value : channel->values) value *= scale;
  }
  const ViewedFrom from = job.receiver.viewed_from;
  write_png8(folder.file("design/caustic_colour.png"), as_seen(light.red, from), as_seen(light.green, from), as_seen(light.blue, from));
  return {"design/color_mask.png", "design/color_mask.svg", "design/caustic_colour.png"};
}

}  // namespace

TargetLight target_of(const Job& job) { return load_target(job.target); }

double display_white(const TargetLight& target) {
  const Vec2 pixels = picture_pixels(target.extent);
  Grid<double> flux = rasterise(target, static_cast<int>(pixels.x()), static_cast<int>(pixels.y()));
  const double mean = 1.0 / static_cast<double>(flux.values.size());
  std::vector<double> lit;
  for (const double f : flux.values) {
    if (f > 0) lit.push_back(f / mean);
  }
  if (lit.empty()) return 1;
  const auto place = lit.begin() + static_cast<std::ptrdiff_t>(0.995 * static_cast<double>(lit.size() - 1));
  std::nth_element(lit.begin(), place, lit.end());
  // Thin strokes on black: their pixels are few, and all are bright.
  return std::clamp(*place, 1.0, 50.0);
}

json to_json(const CausticMeasures& measures) {
  return {{"l1_error", measures.l1_error},
          {"psnr_db", measures.psnr_db},
          {"flux_outside_support", measures.flux_outside_support},
          {"flux_totally_reflected", measures.flux_totally_reflected}};
}

StageResult run_transport(const Job& job, const RunFolder& folder, const Monitor& monitor) {
  const TargetLight target = target_of(job);
  monitor.report("target read", 0);
  const Scene scene = scene_of(job);
  const TracedSource traced = source_of(scene, job);
  const SourceLight& source = traced.source;
  const TransportMap map = solve_transport(source, target, job.transport, monitor);
  Box2 lit = Box2::centred(source.size_mm);
  if (source.shape == SourceLight::Shape::kMesh) {
    lit = {};
    for (const Vec2& p : source.mesh.vertices_mm) lit.include(p);
  }
  const Vec2 pixels = picture_pixels(lit);
  Grid<float> irradiance = rasterise_source(source, lit, static_cast<int>(pixels.x()), static_cast<int>(pixels.y()));
  const float brightest = std::max(*std::max_element(irradiance.values.begin(), irradiance.values.end()), 1e-30F);
  for (float& value : irradiance.values) value /= brightest;
  write_png8(folder.file("design/source.png"), as_seen(irradiance, job.receiver.viewed_from));
  const double full_scale = write_target_pictures(job, folder, target);
  write_map(folder, map);
  write_samples_picture(folder.file("design/samples.png"), map, lit, target.extent, job.receiver.viewed_from);
  write_cells_picture(folder.file("design/cells.png"), map, target.extent, job.receiver.viewed_from);

  const TransportSummary& s = map.summary;
  StageResult result;
  result.report["design"]["transport"] = {{"samples", s.samples},
                                          {"seconds", s.seconds},
                                          {"seconds_diagrams", s.phases.diagrams},
                                          {"seconds_integrals", s.phases.integrals},
                                          {"seconds_equations", s.phases.equations},
                                          {"seconds_relaxation", s.phases.relaxation},
                                          {"iterations", s.iterations},
                                          {"levels", s.levels},
                                          {"l1_mass_error", s.l1_mass_error},
                                          {"max_mass_error", s.max_mass_error},
                                          {"empty_cells", s.empty_cells},
                                          {"flux_spread", s.flux_spread},
                                          {"converged", s.converged},
                                          {"reason", s.reason}};
  const SourceReport& faults = traced.report;
  std::vector<std::string> source_warnings = scene.warnings;
  for (const auto& words : faults.words()) source_warnings.push_back(words);
  result.report["design"]["source"] = {{"totally_reflected", to_json(faults.totally_reflected)},
                                       {"lost", to_json(faults.lost)},
                                       {"beside_back", to_json(faults.beside_back)},
                                       {"unlit_share", faults.unlit_share},
                                       {"warnings", source_warnings}};
  result.report["design"]["target"] = {{"area_share", target.area_total()},
                                       {"curve_share", target.curve_total()},
                                       {"point_share", target.point_total()},
                                       {"white_times_mean", display_white(target)},
                                       {"png_full_scale_times_mean", full_scale},
                                       {"warnings", target.warnings}};
  result.files = {"design/source.png", "design/target.png", "design/target_view.png", "design/samples.png", "design/cells.png", "design/transport.npy", "design/transport_cells.npy"};
  return result;
}

StageResult run_surface(const Job& job, const RunFolder& folder, const Monitor& monitor) {
  const TransportMap map = read_map(folder);
  const Scene scene = scene_of(job);
  const TargetLight target = target_of(job);
  const OpticalSurface surface = solve_surface(scene.lens, scene.light, job.receiver, map, target, job.surface, monitor.part(0, 0.9));
  write_ply(folder.file("design/surface.ply"), surface.mesh);

  // Light through the surface as designed.
  BeamOptions options = beam_options(job);
  options.pixels = kPicturePixels;
  const CastLight cast =
      cast_light(surface.mesh, scene, job.receiver, target.extent, job.light.dispersion, options, monitor.part(0.9, 1));
  const Caustic& caustic = cast.caustic;
  const CausticMeasures measures = measure_caustic(caustic, target);
  const double white = display_white(target);
  write_light_picture(folder.file("design/caustic.png"), cast, job.receiver.viewed_from, white);
  write_exposures(folder.file("design/exposures.png"), caustic.flux, job.receiver.viewed_from, white);
  // Irradiance as a multiple of what would be even over the picture, as its reader sees it.
  Grid<float> irradiance(caustic.flux.width, caustic.flux.height);
  for (std::size_t i = 0; i < irradiance.values.size(); ++i) {
    irradiance.values[i] = static_cast<float>(caustic.flux.values[i] * static_cast<double>(irradiance.values.size()));
  }
  write_float_image(folder.file("design/caustic.exr"), as_seen(irradiance, job.receiver.viewed_from));
  const Box2 extent = Box2::centred(job.lens.size_mm);
  constexpr int kHeightPixels = 800;
  write_height_picture(folder.file("design/heights.png"), rasterise_heights(surface.mesh, extent, kHeightPixels),
                       extent.size().maxCoeff() / kHeightPixels);
  write_curvature_picture(folder.file("design/curvature.png"), surface.mesh, extent);
  const std::vector<RayEnds> ends = ray_ends(surface.mesh, scene.lens, scene.light, job.receiver);
  write_checkerboard_picture(folder.file("design/checkerboard.png"), surface.mesh, ends, extent, target.extent);
  const std::vector<std::string> mask_files = write_color_mask(job, folder, scene, surface.mesh, ends, target, caustic, white);

  const SurfaceSummary& s = surface.summary;
  StageResult result;
  result.report["design"]["surface"] = {{"vertices", s.vertices},
                                        {"seconds", s.seconds},
                                        {"outer_iterations", s.outer_iterations},
                                        {"energy_history", s.energy_history},
                                        {"picture_errors", s.picture_errors},
                                        {"inverted_triangles", s.inverted_triangles},
                                        {"held_back_vertices", s.held_back_vertices},
                                        {"sliding_vertices", s.sliding_vertices},
                                        {"unmapped_vertices", s.unmapped_vertices},
                                        {"height_range_mm", s.height_range_mm},
                                        {"min_concave_radius_mm", s.min_concave_radius_mm},
                                        {"sharper_area_share", s.sharper_area_share},
                                        {"sharper_light_share", s.sharper_light_share},
                                        {"final_height_change_mm", s.final_height_change_mm},
                                        {"reason", s.reason}};
  result.report["design"]["caustic"] = to_json(measures);
  result.report["design"]["caustic"].update(losses_json(caustic));
  result.report["design"]["caustic"]["warnings"] = loss_words(caustic);
  result.files = {"design/surface.ply", "design/caustic.png", "design/caustic.exr", "design/exposures.png", "design/heights.png",
                  "design/curvature.png", "design/checkerboard.png"};
  result.files.insert(result.files.end(), mask_files.begin(), mask_files.end());
  return result;
}

}  // namespace lightmill
