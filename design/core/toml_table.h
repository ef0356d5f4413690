// Strict reading of TOML: unknown keys, wrong types and impossible values are errors that name the key and the rule.
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill {

/// A table of a TOML file that is being read. Every get_*() marks its key as known; finish() throws InputError for keys
/// that nobody asked for ("job.toml:12: unknown key 'lens.tickness_mm'; known here: ..."). Errors name file, line, key, rule.
class TomlTable {
 public:
  /// Parses a file. Throws InputError with file, line and column.
  static TomlTable from_file(const std::filesystem::path& path);
  /// Parses text; `name` stands for the file in messages.
  static TomlTable from_text(std::string_view text, std::string_view name);

  [[nodiscard]] bool has(std::string_view key) const;
  /// A sub-table; an absent one is empty, so that defaults apply.
  TomlTable table(std::string_view key);
  /// The names of all keys, in the order of the alphabet; none of them counts as known by this.
  [[nodiscard]] std::vector<std::string> keys() const;
  /// An array of tables; an absent one is empty.
  std::vector<TomlTable> tables(std::string_view key);

  double number(std::string_view key, double fallback);
  /// A number that must lie in [least, most].
  double number_in(std::string_view key, double fallback, double least, double most);
  int integer_in(std::string_view key, int fallback, int least, int most);
  bool boolean(std::string_view key, bool fallback);
  std::string text(std::string_view key, std::string_view fallback);
  /// A text that must be one of `choices`.
  std::string choice(std::string_view key, std::string_view fallback, const std::vector<std::string_view>& choices);
  Vec2 vector2(std::string_view key, const Vec2& fallback);
  Vec3 vector3(std::string_view key, const Vec3& fallback);
  /// An array of rows of `columns` numbers each ([[1, 2], [3, 4]]); an absent one is empty.
  std::vector<std::vector<double>> number_rows(std::string_view key, std::size_t columns);
  /// A number or a text (for `height_mm = "auto"`).
  [[nodiscard]] bool is_text(std::string_view key) const;

  /// Throws InputError unless every key, here and in sub-tables handed out, was asked for.
  void finish() const;
  /// An InputError about `key`: file, line, key, value and `rule`.
  [[nodiscard]] std::string complaint(std::string_view key, std::string_view rule) const;
  /// The folder of the file: relative paths in it are relative to this.
  [[nodiscard]] std::filesystem::path folder() const;

 private:
  struct Node;
  explicit TomlTable(std::shared_ptr<Node> node) : node_(std::move(node)) {}
  std::shared_ptr<Node> node_;
};

}  // namespace lightmill
