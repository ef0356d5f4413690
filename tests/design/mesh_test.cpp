#include "design/mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

class Mesh : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("lightmill_mesh_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  fs::path write(const std::string& content) const {
    const fs::path path = folder_ / "given.ply";
    write_whole(path, content);
    return path;
  }
  std::string complaint_about(const std::string& content) const {
    try {
      read_ply(write(content));
    } catch (const InputError& e) {
      return e.what();
    }
    return "read without complaint";
  }
  fs::path folder_;
};

/// A fan of four triangles over an off-centre rectangle, its middle lifted.
SurfaceMesh fan() {
  SurfaceMesh mesh;
  mesh.vertices = {{-1, -2, 1}, {5, -2, 1}, {5, 1, 1}, {-1, 1, 1}, {1.0 / 3, -0.5, 1.1}};
  mesh.triangles = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  return mesh;
}

TEST_F(Mesh, PlyKeepsEveryBit) {
  const SurfaceMesh mesh = fan();
  write_ply(folder_ / "a.ply", mesh);
  const SurfaceMesh again = read_ply(folder_ / "a.ply");
  EXPECT_EQ(again.vertices, mesh.vertices);
  EXPECT_EQ(again.normals, mesh.normals);
  EXPECT_EQ(again.triangles, mesh.triangles);
  // 5 vertices of 6 doubles and 4 faces of a count and 3 ints follow the header.
  const std::string content = read_whole(folder_ / "a.ply");
  EXPECT_EQ(content.size() - (content.find("end_header\n") + 11), 5u * 48 + 4u * 13);
}

TEST_F(Mesh, ReadsAsciiWithForeignPropertiesAndComputesNormals) {
  const SurfaceMesh mesh = read_ply(
      write("ply\r\nformat ascii 1.0\r\ncomment by hand\r\nelement camera 1\r\nproperty float f\r\nelement vertex 3\r\n"
            "property uchar red\r\nproperty float x\r\nproperty float y\r\nproperty float z\r\nelement face 1\r\n"
            "property list uchar int vertex_index\r\nproperty int colour\r\nend_header\r\n"
            "7.5\r\n255 0 0 1.5e0\r\n1 2 0 1.5\r\n2 0 -3 1.5\r\n3 0 2 1 9\r\n"));
  ASSERT_EQ(mesh.vertices.size(), 3u);
  EXPECT_EQ(mesh.vertices[2], Vec3(0, -3, 1.5));
  EXPECT_EQ(mesh.triangles[0], (std::array<int, 3>{0, 2, 1}));
  EXPECT_LT((mesh.normals[0] - Vec3(0, 0, 1)).norm(), 1e-15);
}

TEST_F(Mesh, ReadsBigEndianFloats) {
  std::string content =
      "ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float32 x\nproperty float32 y\nproperty float32 "
      "z\n"
      "element face 1\nproperty list uint8 uint16 vertex_indices\nend_header\n";
  const auto put = [&](const void* value, int bytes) {
    const auto* raw = static_cast<const char*>(value);
    for (int b = bytes - 1; b >= 0; --b) content.push_back(raw[b]);
  };
  for (float value : {0.f, 0.f, 2.f, 1.f, 0.f, 2.f, 0.f, 1.f, 2.f}) put(&value, 4);
  content.push_back(3);
  for (std::uint16_t corner : {0, 1, 2}) put(&corner, 2);
  const SurfaceMesh mesh = read_ply(write(content));
  EXPECT_EQ(mesh.vertices[1], Vec3(1, 0, 2));
  EXPECT_EQ(count_inverted(mesh), 0);
}

TEST_F(Mesh, SaysWhatIsWrongWithAFile) {
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
  const std::string faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  using ::testing::HasSubstr;
  EXPECT_THAT(complaint_about("solid stl\n"), HasSubstr("does not begin with 'ply'"));
  EXPECT_THAT(complaint_about("ply\nformat ascii 1.0\n"), HasSubstr("header does not end"));
  EXPECT_THAT(complaint_about(head + faces + "0 0 0 1 0 0 0 1 0 3 0 1 3\n"), HasSubstr("vertex 3 of 3"));
  EXPECT_THAT(complaint_about(head + faces + "0 0 0 1 0 0 0 1 0 2 0 1\n"), HasSubstr("2 corners"));
  EXPECT_THAT(complaint_about(head + faces + "0 0 0 1 0\n"), HasSubstr("missing or malformed"));
  EXPECT_THAT(complaint_about(head + faces + "0 0 nan 1 0 0 0 1 0 3 0 1 2\n"), HasSubstr("not finite"));
  EXPECT_THAT(complaint_about("ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
                              "property float y\nproperty float z\n" +
                              faces),
              HasSubstr("more items than it can hold"));
  EXPECT_THROW(read_ply(folder_ / "absent.ply"), InputError);
}

/// A box of 4 x 2 x 3 mm as text that other programs write: closed, quads, walls and bottom.
const char* kBoxObj =
    "# a box\nmtllib x.mtl\nv -2 -1 0\nv 2 -1 0\nv 2 1 0\nv -2 1 0\nv -2 -1 3\nv 2 -1 3\nv 2 1 3\nv -2 1 3\nvt 0 0\n"
    "f 4 3 2 1\nf 5/1 6/1 7/1 8/1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf -5 -8 -4 -1\n";

TEST_F(Mesh, OfAForeignSolidTheTopIsKept) {
  write_whole(folder_ / "box.OBJ", std::string_view(kBoxObj));
  const SurfaceMesh box = read_surface(folder_ / "box.OBJ");
  EXPECT_EQ(box.vertices.size(), 8u);
  EXPECT_EQ(box.triangles.size(), 12u);
  const std::vector<bool> border = border_vertices(box);
  EXPECT_EQ(std::count(border.begin(), border.end(), true), 0);  // closed
  const OpticalPart top = optical_part(box);
  EXPECT_EQ(top.walls_and_bottom, 10);
  ASSERT_EQ(top.mesh.triangles.size(), 2u);
  for (std::size_t v = 0; v < 4; ++v) {
    EXPECT_EQ(top.mesh.vertices[v].z(), 3);
    EXPECT_EQ(top.mesh.normals[v], Vec3(0, 0, 1));  // not leaning to the walls
  }
  EXPECT_EQ(count_inverted(top.mesh), 0);
  // A surface of ours is left alone, normals included.
  EXPECT_EQ(optical_part(fan()).mesh.normals, fan().normals);
}

TEST_F(Mesh, StlIsWeldedWhereCornersCoincide) {
  const SurfaceMesh mesh = fan();
  std::string text = "solid fan\n";
  std::string binary(80, 's');
  const auto count = static_cast<std::uint32_t>(mesh.triangles.size());
  binary.append(reinterpret_cast<const char*>(&count), 4);
  for (const auto& t : mesh.triangles) {
    text += " facet normal 0 0 1\n  outer loop\n";
    binary.append(12, '\0');
    for (int v : t) {
      char line[120];
      std::snprintf(line, sizeof line, "   vertex %.17g %.17g %.17g\n", mesh.vertices[v].x(), mesh.vertices[v].y(), mesh.vertices[v].z());
      text += line;
      for (int axis = 0; axis < 3; ++axis) {
        const auto value = static_cast<float>(mesh.vertices[v][axis]);
        binary.append(reinterpret_cast<const char*>(&value), 4);
      }
    }
    text += "  endloop\n endfacet\n";
    binary.append(2, '\0');
  }
  binary.replace(0, 5, "solid");  // as some programs begin their binary files
  for (const auto& [content, tolerance] : {std::pair(text + "endsolid fan\n", 0.0), std::pair(binary, 1e-6)}) {
    write_whole(folder_ / "fan.stl", content);
    const SurfaceMesh again = read_surface(folder_ / "fan.stl");
    ASSERT_EQ(again.vertices.size(), 5u);
    ASSERT_EQ(again.triangles.size(), 4u);
    for (std::size_t t = 0; t < 4; ++t) {
      for (int k = 0; k < 3; ++k) {
        EXPECT_LE((again.vertices[again.triangles[t][k]] - mesh.vertices[mesh.triangles[t][k]]).norm(), tolerance);
      }
    }
  }
  const auto complaint = [&](const char* name, const std::string& content) -> std::string {
    write_whole(folder_ / name, content);
    try {
      read_surface(folder_ / name);
    } catch (const InputError& e) {
      return e.what();
    }
    return "read without complaint";
  };
  using ::testing::HasSubstr;
  EXPECT_THAT(complaint("a.stl", binary.substr(0, 200)), HasSubstr("200 bytes there"));
  EXPECT_THAT(complaint("a.stl", "x" + binary), HasSubstr("byte 80"));
  EXPECT_THAT(complaint("a.stl", "solid\nvertex 1 2\n"), HasSubstr("line 2"));
  EXPECT_THAT(complaint("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2 3\n"), HasSubstr("line 3"));
  EXPECT_THAT(complaint("a.obj", "v 0 0 nan\n"), HasSubstr("line 1"));
  EXPECT_THAT(complaint("a.obj", "v 0 0 1\n"), HasSubstr("no triangles"));
  EXPECT_THAT(complaint("a.3ds", ""), HasSubstr(".ply, .obj or .stl"));
}

TEST_F(Mesh, PlyPolygonsAreCutIntoFans) {
  const SurfaceMesh mesh = read_ply(
      write("ply\nformat ascii 1.0\nelement vertex 5\nproperty float z\nproperty float x\nproperty float y\nelement face 1\n"
            "property list uchar int vertex_indices\nend_header\n9 0 0\n9 2 0\n9 3 1\n9 1 2\n9 -1 1\n5 0 1 2 3 4\n"));
  ASSERT_EQ(mesh.triangles.size(), 3u);
  EXPECT_EQ(mesh.triangles[2], (std::array<int, 3>{0, 3, 4}));
  EXPECT_EQ(count_inverted(mesh), 0);
}

TEST_F(Mesh, NormalOfACubesCornerIsItsDiagonalHoweverItIsTriangulated) {
  // Three faces meet at the origin; one of them is cut in two there. Weights by area or by count would lean to a side.
  const std::vector<Vec3> vertices = {{0, 0, 0},   {-1, 0, 0},  {0, -1, 0}, {0, 0, -1},
                                      {-1, -1, 0}, {-1, 0, -1}, {0, -1, -1}};
  const std::vector<std::array<int, 3>> triangles = {{0, 1, 4}, {0, 4, 2}, {0, 3, 1}, {0, 2, 3}};
  const Vec3 normal = angle_weighted_normals(vertices, triangles)[0];
  EXPECT_LT((normal - Vec3(1, 1, 1).normalized()).norm(), 1e-14);
}

TEST_F(Mesh, BorderIsTheRim) {
  EXPECT_THAT(border_vertices(fan()), ::testing::ElementsAre(true, true, true, true, false));
}

TEST_F(Mesh, CountsTrianglesThatAreFoldedOver) {
  SurfaceMesh mesh = fan();
  EXPECT_EQ(count_inverted(mesh), 0);
  mesh.vertices[4].y() = 1.5;  // beyond the upper side: one triangle folds
  EXPECT_EQ(count_inverted(mesh), 1);
}

TEST(Ply, IntensitiesComeWithTheirVertices) {
  const std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("lightmill_intensity_" + std::to_string(::getpid()) + ".ply");
  std::ofstream(path)
      << "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
         "property double intensity\nproperty double nx\nproperty double ny\nproperty double nz\nelement face 1\n"
         "property list uchar int vertex_indices\nend_header\n0 0 -5 1.5 0 0 1\n1 0 -5 2.5 0 0.6 0.8\n0 1 -5 0 0 0 "
         "2\n3 0 1 2\n";
  const IntensityMesh read = read_intensity_ply(path);
  std::filesystem::remove(path);
  EXPECT_EQ(read.intensities, (std::vector<double>{1.5, 2.5, 0}));
  EXPECT_EQ(read.mesh.normals[1], Vec3(0, 0.6, 0.8));
  EXPECT_EQ(read.mesh.vertices[2], Vec3(0, 1, -5));
}

}  // namespace
}  // namespace lightmill
