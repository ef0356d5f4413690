#include "cli/digest.h"

#include <gtest/gtest.h>

#include "command_rig.h"
#include "design/core/errors.h"

namespace lightmill {
namespace {

// FIPS 180-4's own examples.
TEST(Sha256, KnowsTheStandardsExamples) {
  EXPECT_EQ(sha256_of_text(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256_of_text("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(sha256_of_text("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq"),
            "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  EXPECT_EQ(sha256_of_text(std::string(1000000, 'a')), "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(Sha256, PiecesDoNotMatterAndFilesAreTexts) {
  std::string text;
  for (int i = 0; i < 5000; ++i) text += static_cast<char>(i * 7);
  Sha256 pieces;
  std::size_t at = 0;
  for (std::size_t length = 0; at < text.size(); ++length) {
    pieces.add(std::string_view(text).substr(at, length));
    at += length;
  }
  EXPECT_EQ(pieces.hex(), sha256_of_text(text));
  const test::ScratchFolder folder;
  test::spill(folder / "file", text);
  EXPECT_EQ(sha256_of_file(folder / "file"), sha256_of_text(text));
  EXPECT_THROW(sha256_of_file(folder / "absent"), InputError);
}

}  // namespace
}  // namespace lightmill
