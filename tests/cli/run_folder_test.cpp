#include "cli/run_folder.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "command_rig.h"
#include "design/core/errors.h"

namespace lightmill {
namespace {

using nlohmann::json;
using test::ScratchFolder;
using test::spill;

void finish_all(RunFolder& folder) {
  for (const Stage stage : kAllStages) {
    const std::string name = "out/" + std::string(stage_name(stage));
    spill(folder.file(name), "result");
    folder.finish(stage, "digest", {name}, {{"stage", {{std::string(stage_name(stage)), 1}}}});
  }
}

TEST(RunFolder, AStageIsDoneWhileRecordDigestAndFilesAgree) {
  const ScratchFolder scratch;
  RunFolder folder(scratch / "run", true);
  EXPECT_FALSE(folder.is_done(Stage::kCam, "digest"));
  finish_all(folder);
  EXPECT_TRUE(folder.is_done(Stage::kCam, "digest"));
  EXPECT_FALSE(folder.is_done(Stage::kCam, "another digest"));
  spill(folder.file("out/cam"), "shorter or longer");
  EXPECT_FALSE(folder.is_done(Stage::kCam, "digest"));
  std::filesystem::remove(folder.file("out/post"));
  EXPECT_FALSE(folder.is_done(Stage::kPost, "digest"));
  spill(folder.file("stages/surface.json"), "{ \"digest\": \"digest\", ");
  EXPECT_FALSE(folder.is_done(Stage::kSurface, "digest")) << "a broken record is as good as none";
}

TEST(RunFolder, BeginningAStageTakesItsResultsAndLaterOnesAway) {
  const ScratchFolder scratch;
  RunFolder folder(scratch / "run", true);
  finish_all(folder);
  spill(folder.file("out/.junk.partial.png"), "left by a killed run");
  folder.begin(Stage::kCam);
  for (const Stage stage : kAllStages) {
    const bool earlier = stage < Stage::kCam;
    EXPECT_EQ(folder.is_done(stage, "digest"), earlier) << stage_name(stage);
    EXPECT_EQ(std::filesystem::exists(folder.file("out/" + std::string(stage_name(stage)))), earlier) << stage_name(stage);
    EXPECT_EQ(folder.report()["stage"].contains(std::string(stage_name(stage))), earlier);
  }
  EXPECT_FALSE(std::filesystem::exists(folder.file("out/.junk.partial.png")));
  EXPECT_EQ(json::parse(test::slurp(folder.file("report.json"))), folder.report());
}

TEST(RunFolder, OneProcessAtATime) {
  const ScratchFolder scratch;
  const RunFolder folder(scratch / "run", true);
  EXPECT_THROW(RunFolder(scratch / "run", true), IoError);
}

TEST(RunFolder, AStrangeFolderIsRefused) {
  const ScratchFolder scratch;
  EXPECT_THROW(RunFolder(scratch / "absent", false), InputError);
  EXPECT_THROW(RunFolder(scratch.root(), false), InputError);
  spill(scratch / "file", "");
  EXPECT_THROW(RunFolder(scratch / "file", true), InputError);
}

}  // namespace
}  // namespace lightmill
