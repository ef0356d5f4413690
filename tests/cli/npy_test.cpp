#include "cli/npy.h"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>

#include "command_rig.h"
#include "design/core/errors.h"

namespace lightmill {
namespace {

TEST(Npy, IsTheFormatOfItsDefinition) {
  // NumPy's NEP 1: magic, version, little-endian length, a header that ends in a newline at a multiple of 64, then the data.
  const test::ScratchFolder folder;
  NpyTable table{3, {1.5, -2, 1e-300, 4, std::numeric_limits<double>::max(), -0.0}};
  write_npy(folder / "t.npy", table);
  const std::string bytes = test::slurp(folder / "t.npy");
  ASSERT_GT(bytes.size(), 48U);
  EXPECT_EQ(bytes.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const std::size_t start = 10 + static_cast<unsigned char>(bytes[8]) + 256 * static_cast<unsigned char>(bytes[9]);
  EXPECT_EQ(start % 64, 0U);
  EXPECT_EQ(bytes[start - 1], '\n');
  EXPECT_NE(bytes.find("'shape': (2, 3)"), std::string::npos);
  ASSERT_EQ(bytes.size(), start + 6 * sizeof(double));
  EXPECT_EQ(std::memcmp(bytes.data() + start, table.values.data(), 6 * sizeof(double)), 0);
  const NpyTable again = read_npy(folder / "t.npy");
  EXPECT_EQ(again.columns, 3);
  EXPECT_EQ(again.rows(), 2U);
  EXPECT_EQ(again.values, table.values);
}

TEST(Npy, ACutFileIsRefused) {
  const test::ScratchFolder folder;
  write_npy(folder / "t.npy", {2, {1, 2, 3, 4}});
  const std::string bytes = test::slurp(folder / "t.npy");
  for (const std::size_t length : {std::size_t{0}, std::size_t{9}, std::size_t{40}, bytes.size() - 1}) {
    test::spill(folder / "cut.npy", bytes.substr(0, length));
    EXPECT_THROW(read_npy(folder / "cut.npy"), InputError) << length;
  }
}

}  // namespace
}  // namespace lightmill
