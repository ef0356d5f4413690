// The light that a job describes, through a surface: the same for the design check, the dry run and `trace`.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "cli/job.h"
#include "design/beams.h"

namespace lightmill {

/// Lens and light with what their files say.
struct Scene {
  Lens lens;
  Light light;
  std::vector<std::string> warnings;  ///< what of its files was not taken as it is
};
Scene scene_of(const Job& job);

/// What the job's prediction counts: width of the light, losses.
BeamOptions beam_options(const Job& job);

struct CastLight {
  Caustic caustic;
  std::vector<Caustic> colours;  ///< red, green, blue, each bent by its own index; empty without dispersion
};
CastLight cast_light(const SurfaceMesh& mesh, const Scene& scene, const Receiver& receiver, const Box2& extent,
                     bool dispersion, const BeamOptions& options, const Monitor& monitor = {});

/// As display_picture(); with colours, each is scaled to the same brightness.
void write_light_picture(const std::filesystem::path& path, const CastLight& light, ViewedFrom viewed_from,
                         double white);

/// Shares of all light that are lost, and the boxes on the lens where that happens (min x, min y, max x, max y in mm).
nlohmann::json losses_json(const Caustic& caustic);
/// One line for each way in which more than a millionth of the light is lost, with its place.
std::vector<std::string> loss_words(const Caustic& caustic);

}  // namespace lightmill
