// An independent renderer's light through our mesh: POV-Ray's photon mapping against the predicted caustic, on the same
// grid.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <numeric>

#include "design/beams.h"
#include "design/core/image.h"
#include "design/surface.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

std::string point(const Vec3& p) {
  char text[96];
  std::snprintf(text, sizeof text, "<%.9g,%.9g,%.9g>", p.x(), p.y(), p.z());
  return text;
}

/// A closed lens: our surface with our normals, walls down to z = 0 and the flat back.
std::string solid(const SurfaceMesh& mesh, double index) {
  std::string text = "mesh {\n";
  std::map<std::pair<int, int>, int> edges;
  const auto at_foot = [&](int v) { return Vec3(mesh.vertices[v].x(), mesh.vertices[v].y(), 0); };
  for (const auto& t : mesh.triangles) {
    text += "smooth_triangle {";
    for (int k = 0; k < 3; ++k) {
      text += (k ? "," : "") + point(mesh.vertices[t[k]]) + "," + point(mesh.normals[t[k]]);
      ++edges[{t[k], t[(k + 1) % 3]}];
    }
    text += "}\ntriangle {" + point(at_foot(t[2])) + "," + point(at_foot(t[1])) + "," + point(at_foot(t[0])) + "}\n";
  }
  for (const auto& [edge, count] : edges) {
    if (edges.contains({edge.second, edge.first})) continue;
    const auto& [a, b] = edge;
    text += "triangle {" + point(mesh.vertices[b]) + "," + point(mesh.vertices[a]) + "," + point(at_foot(a)) + "}\n" +
            "triangle {" + point(mesh.vertices[b]) + "," + point(at_foot(a)) + "," + point(at_foot(b)) + "}\n";
  }
  return text + "inside_vector <0,0,1>\npigment { rgbf 1 }\ninterior { ior " + std::to_string(index) +
         " }\nphotons { target refraction on reflection off collect off }\n}\n";
}

TEST(PovRay, ItsPhotonsLandWhereOurBeamsDo) {
  if (std::system("command -v povray > /dev/null 2>&1") != 0)
    GTEST_SKIP() << "povray is not installed, nothing is compared: apt-get install --no-install-recommends povray";
  // A lens that is designed to draw its light together to an uneven, lopsided spot well inside its own shadow, as its file says
  // it is.
  Lens lens;
  lens.size_mm = {30, 24};
  const Receiver receiver{.distance_mm = 60};
  const auto spot = [](const std::vector<Vec2>& places) {
    const Vec2 wave(0.5, 0.35);
    std::vector<Vec2> targets;
    for (const Vec2& p : places)
      targets.push_back(Vec2(1 + 0.45 * p.x() + 0.05 * p.y(), 0.05 * p.x() + 0.44 * p.y()) + 0.6 * std::cos(wave.dot(p)) * wave);
    return targets;
  };
  SurfaceOptions options;
  options.mesh = 61;
  const fs::path folder = fs::temp_directory_path() / ("lightmill_povray_" + std::to_string(getpid()));
  fs::create_directories(folder);
  write_ply(folder / "surface.ply", solve_surface(lens, {}, receiver, spot, options).mesh);
  const SurfaceMesh mesh = read_ply(folder / "surface.ply");
  const Box2 picture{{-9, -8}, {11, 8}};
  constexpr int kColumns = 40, kRows = 32, kFiner = 4;  // POV-Ray looks at points: several per pixel
  const Caustic ours = trace_beams(mesh, lens, {}, receiver, picture, {.pixels = kColumns});
  ASSERT_EQ(ours.flux.height, kRows);

  // The wall is looked at from close by, upright: row 0 is the largest y. POV-Ray's z runs away from the eye as ours
  // runs towards the wall; mirrored space bends light alike.
  const double wall = lens.thickness_mm + receiver.distance_mm;
  const Vec3 middle(picture.centre().x(), picture.centre().y(), wall);
  std::ofstream(folder / "scene.pov")
      << "#version 3.7;\nglobal_settings { assumed_gamma 1 photons { count 400000 gather 100, 400 } }\n"
      << "camera { orthographic location " << point(middle - Vec3(0, 0, 1)) << " look_at " << point(middle)
      << " right x*" << picture.size().x() << " up y*" << picture.size().y() << " }\n"
      << "light_source { <0,0,-500> rgb 0.01 parallel point_at <0,0,0> photons { refraction on reflection off } }\n"
      << "plane { z, " << wall << " pigment { rgb 1 } finish { ambient 0 diffuse 1 } }\n"
      << solid(mesh, lens.refractive_index);
  const std::string command = "cd '" + folder.string() + "' && povray +Iscene.pov +Oout.png +FN16 File_Gamma=1.0 +W" +
                              std::to_string(kFiner * kColumns) + " +H" + std::to_string(kFiner * kRows) +
                              " -D +WT2 > log.txt 2>&1";
  ASSERT_EQ(std::system(command.c_str()), 0) << "see " << folder / "log.txt";
  const Picture theirs = read_picture(folder / "out.png", Transfer::kLinear);
  fs::remove_all(folder);
  ASSERT_EQ(theirs.gray.width, kFiner * kColumns);
  Grid<double> averaged(kColumns, kRows);  // row 0 at the smallest y, as ours
  for (int j = 0; j < kFiner * kRows; ++j) {
    for (int i = 0; i < kFiner * kColumns; ++i)
      averaged.at(i / kFiner, kRows - 1 - j / kFiner) += theirs.gray.at(i, j) / (kFiner * kFiner);
  }

  const double our_mean = std::accumulate(ours.flux.values.begin(), ours.flux.values.end(), 0.0) / (kColumns * kRows);
  const double their_mean = std::accumulate(averaged.values.begin(), averaged.values.end(), 0.0) / (kColumns * kRows);
  ASSERT_GT(their_mean, 0);
  double difference = 0;
  double mirrored = 0;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      const double there = averaged.at(i, j) / their_mean;
      difference += std::abs(ours.flux.at(i, j) / our_mean - there) / (kColumns * kRows);
      mirrored += std::abs(ours.flux.at(kColumns - 1 - i, j) / our_mean - there) / (kColumns * kRows);
    }
  }
  std::printf("POV-Ray against the prediction: mean difference %.4f of the mean irradiance; mirrored %.4f\n",
              difference, mirrored);
  // Photons are gathered from disks that blur, and leave grain of 1 / sqrt(100 to 400 photons); measured 0.07.
  EXPECT_LT(difference, 0.12);
  EXPECT_GT(mirrored, 2 * difference);  // the comparison sees which way the picture runs
}

}  // namespace
}  // namespace lightmill
