#include "design/core/toml_table.h"

#include <gtest/gtest.h>

#include <functional>

#include "design/core/errors.h"

namespace lightmill {
namespace {

std::string complaint_of(const std::string& text, const std::function<void(TomlTable&)>& read) {
  try {
    TomlTable table = TomlTable::from_text(text, "a.toml");
    read(table);
  } catch (const InputError& e) {
    return e.what();
  }
  return "none";
}

// Where only ASCII may stand toml++ has no defined behaviour for some letters.
TEST(TomlTable, LettersStandInStringsAndComments) {
  const auto complaint = [](const std::string& text) { return complaint_of(text, [](TomlTable&) {}); };
  EXPECT_EQ(complaint("# ä Ф\nkey = \"ü \\\" # Ф\"\n"), "none");
  EXPECT_EQ(complaint("key = 'Ф\\'\n"), "none") << "no escape in there";
  EXPECT_EQ(complaint("key = \"\"\"\nФ \" ''' # ä\n\"\"\"\n"), "none");
  EXPECT_EQ(complaint("\xEF\xBB\xBFkey = ''\n"), "none") << "a mark of the byte order";
  const std::string rule = "not valid TOML: letters other than ASCII stand in strings and comments only";
  EXPECT_EQ(complaint("key = \"\"\ncФ"), "a.toml:2:2: " + rule);
  EXPECT_EQ(complaint("[a]\n\nkey = '' ä\n"), "a.toml:3:10: " + rule);
  EXPECT_EQ(complaint("key = '\nФ = 1\n"), "a.toml:2:1: " + rule) << "a string ends with its line";
}

// toml++ takes for granted that a table's name begins like one, and a value.
TEST(TomlTable, RefusesWhatTheParserTakesForGranted) {
  const auto complaint = [](const std::string& text) { return complaint_of(text, [](TomlTable&) {}); };
  const std::string rule = "not valid TOML: something stands where it cannot";
  EXPECT_EQ(complaint("a = 1\n[^ens]\n[b]\n"), "a.toml:2: " + rule);
  EXPECT_EQ(complaint("[[ +a]]"), "a.toml:1: " + rule);
  EXPECT_EQ(complaint("\n\n[[[a]]]"), "a.toml:3: " + rule);
  EXPECT_NE(complaint("a = ,"), "none");
  EXPECT_NE(complaint("a = [,]"), "none");
  EXPECT_NE(complaint("a = [1,, 2]"), "none");
  EXPECT_EQ(complaint("['a b']\n[ \"c\".d ]\n[[e]]\n[-1]\nf = [\n[+1, 2],\n[], # [\n[3]]\n"), "none");
}

// Numbers near 0 and infinite ones in arrays, which toml++ does not write without undefined behaviour.
TEST(TomlTable, ComplainsOfArrays) {
  const auto complaint = [](const std::string& text) {
    return complaint_of(text, [](TomlTable& table) { throw InputError(table.complaint("size", "is odd")); });
  };
  EXPECT_EQ(complaint("size = [40, inf]"), "a.toml:1: size = [ 40, inf ]: is odd");
  EXPECT_EQ(complaint("size = [0.001, [], ['a', true], {b = 1}]"),
            "a.toml:1: size = [ 0.001, [], [ 'a', true ], { ... } ]: is odd");
  EXPECT_EQ(complaint("size = 0.5"), "a.toml:1: size = 0.5: is odd");
}

}  // namespace
}  // namespace lightmill
