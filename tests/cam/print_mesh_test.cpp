#include "cam/print_mesh.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstring>
#include <functional>

#include "design/core/files.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

/// A tetrahedron on three axes, volume 2 * 3 * 5 / 6.
PrintMesh tetrahedron() { return {{{0, 0, 0}, {2, 0, 0}, {0, 3, 0}, {0, 0, 5}}, {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}}}; }

template <typename T>
T at(const std::string& bytes, std::size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

std::string written(const std::string& name, const std::function<void(const fs::path&)>& write) {
  const fs::path path = fs::path(testing::TempDir()) / (std::to_string(getpid()) + name);
  write(path);
  std::string bytes = read_whole(path);
  fs::remove(path);
  return bytes;
}

TEST(PrintMesh, IsWatertightWhenEveryEdgeRunsOnceEachWay) {
  PrintMesh mesh = tetrahedron();
  EXPECT_TRUE(is_watertight(mesh));
  EXPECT_DOUBLE_EQ(enclosed_volume_mm3(mesh), 5);
  std::swap(mesh.triangles[0][0], mesh.triangles[0][1]);
  EXPECT_FALSE(is_watertight(mesh)) << "one triangle is inside out";
  mesh = tetrahedron();
  mesh.triangles.pop_back();
  EXPECT_FALSE(is_watertight(mesh)) << "a hole";
  EXPECT_FALSE(is_watertight({}));
}

TEST(PrintMesh, StlHoldsTheTrianglesWithTheirNormals) {
  const std::string bytes = written("a.stl", [](const fs::path& p) { write_stl(p, tetrahedron()); });
  ASSERT_EQ(bytes.size(), 84U + 4 * 50);
  EXPECT_EQ(at<std::uint32_t>(bytes, 80), 4U);
  EXPECT_EQ(at<float>(bytes, 84 + 8), -1) << "the bottom looks down";
  EXPECT_EQ(at<float>(bytes, 84 + 12 + 12 + 4), 3) << "y of its second corner";
}

TEST(PrintMesh, A3mfIsAZipWithTheModel) {
  const std::string bytes = written("a.3mf", [](const fs::path& p) { write_3mf(p, tetrahedron(), "a < b & c"); });
  // From the end: the directory, its entries, and what they point at.
  const std::size_t end = bytes.size() - 22;
  ASSERT_EQ(at<std::uint32_t>(bytes, end), 0x06054B50U);
  ASSERT_EQ(at<std::uint16_t>(bytes, end + 10), 3);
  std::size_t entry = at<std::uint32_t>(bytes, end + 16);
  std::vector<std::string> names;
  std::string model;
  std::uint32_t sum = 0;
  for (int k = 0; k < 3; ++k) {
    ASSERT_EQ(at<std::uint32_t>(bytes, entry), 0x02014B50U);
    const std::size_t name_length = at<std::uint16_t>(bytes, entry + 28);
    const std::size_t local = at<std::uint32_t>(bytes, entry + 42);
    ASSERT_EQ(at<std::uint32_t>(bytes, local), 0x04034B50U);
    EXPECT_EQ(at<std::uint32_t>(bytes, local + 14), at<std::uint32_t>(bytes, entry + 16)) << "both checksums";
    names.push_back(bytes.substr(local + 30, name_length));
    model = bytes.substr(local + 30 + name_length, at<std::uint32_t>(bytes, local + 18));
    sum = at<std::uint32_t>(bytes, entry + 16);
    entry += 46 + name_length;
  }
  EXPECT_EQ(names, (std::vector<std::string>{"[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"}));
  EXPECT_NE(model.find("unit=\"millimeter\""), std::string::npos);
  EXPECT_NE(model.find("a &lt; b &amp; c"), std::string::npos);
  EXPECT_NE(model.find("<vertex x=\"0.00000\" y=\"3.00000\" z=\"0.00000\"/>"), std::string::npos);
  EXPECT_NE(model.find("<triangle v1=\"1\" v2=\"2\" v3=\"3\"/>"), std::string::npos);
  // CRC-32 of the model by another way: polynomial division bit by bit, highest first, over reflected bits.
  std::uint32_t remainder = 0xFFFFFFFFU;
  for (const char c : model) {
    for (int bit = 0; bit < 8; ++bit) {
      const bool one = ((remainder >> 31) & 1U) != ((static_cast<unsigned char>(c) >> bit) & 1U);
      remainder = (remainder << 1) ^ (one ? 0x04C11DB7U : 0U);
    }
  }
  std::uint32_t reflected = 0;
  for (int bit = 0; bit < 32; ++bit) reflected |= ((~remainder >> bit) & 1U) << (31 - bit);
  EXPECT_EQ(sum, reflected);
}

}  // namespace
}  // namespace lightmill
