#include "cli/trace_command.h"

#include <Eigen/Geometry>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>

#include "cli/commands.h"
#include "cli/job_light.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/image.h"
#include "design/core/text.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

Light turned(Light light, const Eigen::Matrix3d& turn) {
  light.direction = turn * light.direction;
  light.position_mm = turn * light.position_mm;
  for (Vec3& p : light.mesh.positions_mm) p = turn * p;
  for (Vec3& d : light.mesh.directions) d = turn * d;
  return light;
}

constexpr double kFirstTurn = kPi / 8;

/// A light's mesh must stay behind the back of the turned lens.
void check_room_to_turn(const Light& light) {
  double missing = 0;
  for (const Vec3& p : light.mesh.positions_mm) missing = std::max(missing, p.z() + p.x() * std::tan(kFirstTurn));
  if (missing > 0) {
    throw InputError("--movie: the lens, turned by 22.5 degrees, would stand in the light's mesh; cut the beam of light.mesh at least " +
                     compact(missing, 3) + " mm further back, or leave out --movie");
  }
}

/// Stills while the lens comes up to its place: turned about Y through the middle of its back, from 22.5 degrees
/// down to none; light and wall stay. One exposure for all.
void write_movie(const SurfaceMesh& mesh, const Scene& scene, const Receiver& receiver, const TargetLight& target,
                 bool colours, const BeamOptions& options, const TraceOptions& given, Progress& progress) {
  const Box2 wide{target.extent.min - target.extent.size() / 2, target.extent.max + target.extent.size() / 2};
  const double white = display_white(target) * wide.size().prod() / target.extent.size().prod();
  for (int frame = 0; frame < given.movie; ++frame) {
    const double turn = given.movie == 1 ? 0.0 : kFirstTurn * (1 - static_cast<double>(frame) / (given.movie - 1));
    // Seen from the lens, light and wall turn the other way.
    const Eigen::Matrix3d back = Eigen::AngleAxisd(-turn, Vec3::UnitY()).toRotationMatrix();
    const Vec3 wall = back * receiver_frame(scene.lens, receiver).origin_mm;
    Receiver seen = receiver;
    seen.distance_mm = wall.z() - scene.lens.thickness_mm;
    seen.shift_mm = wall.head<2>();
    seen.tilt_rad.y() -= turn;
    const CastLight still = cast_light(mesh, {scene.lens, turned(scene.light, back), {}}, seen, wide, colours, options,
                                       progress.stage("still " + std::to_string(frame + 1)));
    // Common exposure: scaled by all light through the lens, not by what landed.
    const auto exposed = [&](const Caustic& caustic) {
      Grid<float> light(caustic.flux.width, caustic.flux.height);
      for (std::size_t i = 0; i < light.values.size(); ++i)
        light.values[i] = static_cast<float>(caustic.flux.values[i] * static_cast<double>(light.values.size()) / white);
      return as_seen(light, receiver.viewed_from);
    };
    std::string number = std::to_string(frame + 1);
    number.insert(0, number.size() < 4 ? 4 - number.size() : 0, '0');
    const fs::path path = given.picture.parent_path() / (given.picture.stem().string() + "_" + number + ".png");
    if (colours) {
      write_png8(path, exposed(still.colours[0]), exposed(still.colours[1]), exposed(still.colours[2]));
    } else {
      write_png8(path, exposed(still.caustic));
    }
    progress.done();
  }
}

}  // namespace

int trace(const TraceOptions& given, Progress& progress) {
  if (given.picture.empty() && given.movie > 0)
    throw InputError("--movie needs -o: the stills are named after the picture");
  const Job job = read_job(given.job);
  const OpticalPart part = optical_part(read_surface(given.surface));
  const TargetLight target = target_of(job);
  if (part.walls_and_bottom > 0) {
    progress.say("left out: " + std::to_string(part.walls_and_bottom) +
                 " triangles of walls and bottom, which do not face +Z");
  }
  Scene scene = scene_of(job);
  Receiver receiver = job.receiver;
  BeamOptions options = beam_options(job);
  options.pixels = given.pixels;
  options.lamp_samples = given.lamp_samples;
  options.fresnel |= given.fresnel;
  const bool colours = given.colours || job.light.dispersion;
  if (given.direction) {
    scene.light.kind = Light::Kind::kParallel;
    scene.light.direction = *given.direction;
  }
  if (given.lamp_mm) {
    scene.light.kind = Light::Kind::kPoint;
    scene.light.position_mm = *given.lamp_mm;
    options.angular_diameter_rad = 2 * std::atan(given.lamp_diameter_mm / (2 * given.lamp_mm->norm()));
  }
  if (given.tilt_rad) {
    constexpr double kMostTilt = 80 * kPi / 180;  // as in a job
    if (!(given.tilt_rad->cwiseAbs().maxCoeff() <= kMostTilt)) throw InputError("--tilt-deg: must be two angles of at most 80 degrees");
    receiver.tilt_rad = *given.tilt_rad;
  }
  if (given.movie > 1 && scene.light.kind == Light::Kind::kMesh) check_room_to_turn(scene.light);

  const CastLight cast = cast_light(part.mesh, scene, receiver, target.extent, colours && !given.picture.empty(),
                                    options, progress.stage("trace"));
  progress.done();
  const CausticMeasures measures = measure_caustic(cast.caustic, target);
  if (!given.picture.empty()) write_light_picture(given.picture, cast, receiver.viewed_from, display_white(target));
  if (given.movie > 0) write_movie(part.mesh, scene, receiver, target, colours, options, given, progress);

  progress.say("l1_error " + fixed(measures.l1_error, 4) + ", psnr_db " + fixed(measures.psnr_db, 2) +
               ", flux_outside_support " + fixed(measures.flux_outside_support, 4) + ", flux_totally_reflected " +
               fixed(measures.flux_totally_reflected, 6));
  progress.say("fresnel_reflected " + fixed(cast.caustic.fresnel_reflected, 6) + ", beside the picture " +
               fixed(cast.caustic.outside_extent, 6));
  for (const std::string& line : loss_words(cast.caustic)) progress.say(line);
  json told = to_json(measures);
  told.update(losses_json(cast.caustic));
  progress.event({{"event", "trace"}, {"measures", told}});
  return kExitDone;
}

}  // namespace lightmill
