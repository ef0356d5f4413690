#include "cli/job_light.h"

#include <nlohmann/json.hpp>

#include "design/core/image.h"
#include "design/core/text.h"
#include "design/source.h"

namespace lightmill {

using nlohmann::json;

namespace {

/// A file's picture over a box: row 0 at the smallest y.
Grid<float> over_box(const Grid<float>& picture) {
  return flipped_rows(picture);
}

struct Loss {
  const char* key;
  const char* words;
  double share;
  Box2 from;
};

std::vector<Loss> losses(const Caustic& c) {
  return {{"totally_reflected", "is totally reflected inside the lens", c.totally_reflected, c.reflected_from},
          {"shadowed", "meets the surface a second time", c.shadowed, c.shadowed_from},
          {"enters_by_rim", "would have to enter through the lens's side", c.enters_by_rim, c.enters_rim_from},
          {"leaves_by_rim", "leaves through the lens's side before it meets the surface", c.leaves_by_rim,
           c.leaves_rim_from}};
}

}  // namespace

Scene scene_of(const Job& job) {
  Scene scene{job.lens, job.light.beam, {}};
  Lens& lens = scene.lens;
  Light& light = scene.light;
  const SourceFiles& files = job.source_files;
  if (lens.shape == Lens::Shape::kOutline) {
    LensOutline outline = read_outline(files.outline.string(), lens.size_mm);
    lens.outline_mm = std::move(outline.loops_mm);
    scene.warnings = std::move(outline.warnings);
  }
  if (lens.base.kind == Base::Kind::kImage) {
    lens.base.heights_mm = over_box(read_float_image(files.base));
    for (float& h : lens.base.heights_mm.values) h *= static_cast<float>(files.base_scale_mm);
    lens.base.extent = Box2::centred(lens.size_mm);
  }
  if (lens.base.kind == Base::Kind::kMesh) lens.base.mesh = read_ply(files.base);
  if (light.kind == Light::Kind::kMesh) {
    const auto [mesh, intensities] = read_intensity_ply(files.light_mesh);
    light.mesh.positions_mm = mesh.vertices;
    light.mesh.directions = mesh.normals;
    light.mesh.intensities = intensities.empty() ? std::vector<double>(mesh.vertices.size(), 1.0) : intensities;
    light.mesh.triangles = mesh.triangles;
  }
  if (light.profile.kind == Profile::Kind::kImage) {
    const Picture picture = read_picture(files.light_image);
    light.profile.image = over_box(picture.gray);
    scene.warnings.insert(scene.warnings.end(), picture.warnings.begin(), picture.warnings.end());
  }
  return scene;
}

BeamOptions beam_options(const Job& job) {
  BeamOptions options;
  options.angular_diameter_rad = job.light.angular_diameter_rad;
  options.fresnel = job.light.fresnel;
  return options;
}

CastLight cast_light(const SurfaceMesh& mesh, const Scene& scene, const Receiver& receiver, const Box2& extent,
                     bool dispersion, const BeamOptions& options, const Monitor& monitor) {
  const double part = dispersion ? 0.25 : 1.0;
  CastLight cast{trace_beams(mesh, scene.lens, scene.light, receiver, extent, options, monitor.part(0, part)), {}};
  if (!dispersion) return cast;
  for (const double wavelength_um : kPrimaryWavelengthsUm) {
    const double done = part * static_cast<double>(1 + cast.colours.size());
    cast.colours.push_back(trace_beams(mesh, lens_at(scene.lens, wavelength_um), scene.light, receiver, extent, options,
                                       monitor.part(done, done + part)));
  }
  return cast;
}

void write_light_picture(const std::filesystem::path& path, const CastLight& light, ViewedFrom viewed_from,
                         double white) {
  const auto picture = [&](const Caustic& caustic) { return display_picture(caustic.flux, viewed_from, white); };
  if (light.colours.empty()) {
    write_png8(path, picture(light.caustic));
  } else {
    write_png8(path, picture(light.colours[0]), picture(light.colours[1]), picture(light.colours[2]));
  }
}

json losses_json(const Caustic& caustic) {
  json told;
  told["fresnel_reflected"] = caustic.fresnel_reflected;
  told["flux_beside_picture"] = caustic.outside_extent;
  for (const Loss& loss : losses(caustic)) {
    told[loss.key] = loss.share;
    if (loss.from.empty()) continue;
    told["lost_from_mm"][loss.key] = {loss.from.min.x(), loss.from.min.y(), loss.from.max.x(), loss.from.max.y()};
  }
  return told;
}

std::vector<std::string> loss_words(const Caustic& caustic) {
  constexpr double kWorthALine = 1e-6;
  std::vector<std::string> lines;
  for (const Loss& loss : losses(caustic)) {
    if (!(loss.share > kWorthALine)) continue;
    const auto range = [&](int axis) { return fixed(loss.from.min[axis], 1) + " to " + fixed(loss.from.max[axis], 1); };
    lines.push_back(compact(100 * loss.share, 4) + " % of the light " + loss.words + ", within x " + range(0) + ", y " +
                    range(1) + " mm of the lens");
  }
  return lines;
}

}  // namespace lightmill
