#include "cli/fault_files.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "command_rig.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;
using test::ScratchFolder;
using test::slurp;

Fault fault_of(const std::string& kind, long line, const std::string& picture = "") {
  Fault fault;
  fault.kind = kind;
  fault.program = "a.nc";
  fault.line = line;
  fault.message = "what " + kind;
  fault.picture = picture;
  return fault;
}

std::string text_of(const std::string& name) {
  std::string text;
  for (int k = 1; name == "a.nc" && k <= 100; ++k) text += "N" + std::to_string(k) + "\n";
  return text;
}

TEST(FaultFiles, EveryKindHasAPictureBeforeAnyHasASecond) {
  const ScratchFolder scratch;
  const std::string section = "<svg></svg>";
  std::vector<Fault> faults;
  for (long k = 1; k <= 40; ++k) faults.push_back(fault_of("error", k));
  faults.push_back(fault_of("collision", 50));
  for (long k = 51; k <= 60; ++k) faults.push_back(fault_of("collision", k, section));
  faults.push_back(fault_of("gouge", 0, "dry_run/deviation.png"));
  faults.push_back(fault_of("digest", 0));
  const FaultFiles files = write_fault_pictures(scratch.root(), "out_", faults, text_of);
  ASSERT_EQ(files.list.size(), faults.size());
  EXPECT_EQ(files.pictures.size(), static_cast<std::size_t>(kMostFaultPictures));
  EXPECT_EQ(files.left_out, 51 - kMostFaultPictures);
  EXPECT_EQ(files.list[0]["picture"], "out_fault_01.svg");
  EXPECT_EQ(files.list[40]["picture"], "") << "a collision with a section comes first";
  EXPECT_EQ(files.list[41]["picture"], "out_fault_24.svg");
  EXPECT_EQ(files.list[51]["picture"], "dry_run/deviation.png");
  EXPECT_EQ(files.list[52]["picture"], "");
  EXPECT_THAT(slurp(scratch / "out_fault_24.svg"), HasSubstr("collision in a.nc, line 51"));
  EXPECT_THAT(slurp(scratch / "out_fault_03.svg"), HasSubstr("error in a.nc, line 3"));

  // Fewer in the next run: nothing of this one stays.
  faults.resize(2);
  EXPECT_EQ(write_fault_pictures(scratch.root(), "out_", faults, text_of).left_out, 0);
  EXPECT_TRUE(std::filesystem::exists(scratch / "out_fault_02.svg"));
  EXPECT_FALSE(std::filesystem::exists(scratch / "out_fault_03.svg"));
}

TEST(FaultFiles, FaultsReadBackAsWritten) {
  Fault fault = fault_of("limit", 7, "<svg/>");
  fault.last_line = 9;
  fault.worst_line = 8;
  fault.amount_mm = 0.25;
  fault.place_mm = Vec3(1, -2, 3);
  EXPECT_EQ(to_json(fault_from(to_json(fault))), to_json(fault));
}

}  // namespace
}  // namespace lightmill
