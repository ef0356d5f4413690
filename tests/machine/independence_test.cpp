// The dry run is no echo: the machine room knows of the post only the plain data of the machine file.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace {

TEST(Independence, TheMachineReadsNothingOfThePostButTheMachineFile) {
  namespace fs = std::filesystem;
  int files = 0, model = 0;
  for (const auto& entry : fs::recursive_directory_iterator(fs::path(LIGHTMILL_SOURCE_DIR) / "machine")) {
    if (entry.path().extension() != ".h" && entry.path().extension() != ".cpp") continue;
    ++files;
    std::ifstream in(entry.path());
    for (std::string line; std::getline(in, line);) {
      if (line.find("#include \"postproc/") == std::string::npos) continue;
      EXPECT_EQ(line, "#include \"postproc/machine_model.h\"") << entry.path();
      ++model;
    }
  }
  EXPECT_GT(files, 20);
  EXPECT_GT(model, 0);
}

}  // namespace
