// What a test found, as a table in a README that it keeps true.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "design/core/files.h"

namespace lightmill::test {

/// Expects `found` in a file of the repository, from the line `begin`, with which it starts, to `end`, with which it
/// closes; written there first if LIGHTMILL_WRITE_README is set.
inline void expect_in_readme(const std::string& file, const std::string& begin, const std::string& end,
                             const std::string& found) {
  const std::filesystem::path path = std::filesystem::path(LIGHTMILL_SOURCE_DIR) / file;
  std::string readme = read_whole(path);
  const std::size_t open = readme.find(begin), close = readme.find(end);
  ASSERT_TRUE(open != std::string::npos && close != std::string::npos);
  const std::size_t length = close + end.size() - open;
  const std::string stands = readme.substr(open, length);
  if (std::getenv("LIGHTMILL_WRITE_README") != nullptr) {
    readme.replace(open, length, found);
    write_whole(path, readme);
  }
  EXPECT_EQ(stands, found) << "write it anew with LIGHTMILL_WRITE_README=1, and look at the difference";
}

}  // namespace lightmill::test
