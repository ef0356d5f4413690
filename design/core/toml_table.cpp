#include "design/core/toml_table.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>
#include <vector>

// Where toml++ asserts what a text need not fulfil it goes on with undefined behaviour, or ends the program; here it throws.
struct TomlGaveUp {};
[[noreturn]] static void give_up() { throw TomlGaveUp(); }
#pragma push_macro("NDEBUG")
#undef NDEBUG
#define TOML_ASSERT(expr) ((expr) ? void() : give_up())
#include <toml++/toml.h>
#pragma pop_macro("NDEBUG")

#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

/// As toml++ writes it, which cannot be trusted with numbers in arrays: it takes their logarithm for a count of letters.
void write_value(std::ostream& out, const toml::node& node) {
  if (const toml::array* const array = node.as_array()) {
    out << '[';
    const char* before = " ";
    for (const toml::node& each : *array) {
      out << before;
      write_value(out, each);
      before = ", ";
    }
    out << (array->empty() ? "]" : " ]");
  } else if (node.is_table()) {
    out << "{ ... }";
  } else {
    node.visit([&](const auto& value) {
      if constexpr (toml::is_value<decltype(value)>) out << value;
    });
  }
}

}  // namespace

struct TomlTable::Node {
  std::shared_ptr<toml::table> root;  // keeps `table` alive
  const toml::table* table = nullptr;
  std::string file;
  std::filesystem::path folder;
  std::string prefix;  // "lens." for messages
  std::set<std::string, std::less<>> known;
  std::vector<std::shared_ptr<Node>> children;

  [[nodiscard]] const toml::node* find(std::string_view key) {
    known.emplace(key);
    return table ? table->get(key) : nullptr;
  }
  [[nodiscard]] std::string where(const toml::node& node) const {
    return file + ":" + std::to_string(node.source().begin.line) + ": ";
  }
  [[nodiscard]] std::string complain(std::string_view key, std::string_view rule) const {
    const toml::node* node = table ? table->get(key) : nullptr;
    std::ostringstream value;
    if (node) write_value(value, *node);
    return (node ? where(*node) : file + ": ") + prefix + std::string(key) + (node ? " = " + value.str() : "") + ": " +
           std::string(rule);
  }
  void finish() const {
    if (table) {
      for (const auto& [key, value] : *table) {
        if (known.contains(key.str())) continue;
        std::string names;
        for (const auto& name : known) names += (names.empty() ? "" : ", ") + name;
        throw InputError(where(value) + "unknown key '" + prefix + std::string(key.str()) + "'; known here: " + names);
      }
    }
    for (const auto& child : children) child->finish();
  }
};

namespace {

std::string span_rule(double least, double most) {
  if (std::isinf(most)) return "must be a number of at least " + compact(least, 9);
  if (std::isinf(least)) return "must be a number of at most " + compact(most, 9);
  return "must be a number from " + compact(least, 9) + " to " + compact(most, 9);
}

/// toml++ 3 runs into undefined behaviour at some letters where only ASCII may stand: outside of strings and comments.
void refuse_letters_outside_strings(std::string_view text, std::string_view name) {
  std::size_t line = 1, line_start = 0;
  std::string quote;  // of the string that is open
  for (std::size_t i = text.starts_with("\xEF\xBB\xBF") ? 3 : 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '\n') {
      ++line;
      line_start = i + 1;
      if (quote.size() == 1) quote.clear();  // which is an error of its own
    } else if (!quote.empty()) {
      if (c == '\\' && quote[0] == '"' && i + 1 < text.size() && text[i + 1] != '\n') {
        ++i;
      } else if (text.substr(i).starts_with(quote)) {
        i += quote.size() - 1;
        quote.clear();
      }
    } else if (c == '"' || c == '\'') {
      const std::string three(3, c);
      quote = text.substr(i).starts_with(three) ? three : std::string(1, c);
      i += quote.size() - 1;
    } else if (c == '#') {
      i = std::min(text.find('\n', i), text.size()) - 1;
    } else if (static_cast<unsigned char>(c) >= 0x80) {
      throw InputError(std::string(name) + ":" + std::to_string(line) + ":" + std::to_string(i - line_start + 1) +
                       ": not valid TOML: letters other than ASCII stand in strings and comments only");
    }
  }
}

/// The first line that the parser gives up at, which it does not tell; it reads from the start on.
std::size_t line_given_up(std::string_view text) {
  std::vector<std::size_t> ends;  // of the lines
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\n' || i + 1 == text.size()) ends.push_back(i + 1);
  }
  const auto gives_up = [&](std::size_t, std::size_t end) {
    try {
      static_cast<void>(toml::parse(text.substr(0, end)));
    } catch (const TomlGaveUp&) {
      return true;
    } catch (const toml::parse_error&) {
    }
    return false;
  };
  const auto found = std::upper_bound(ends.begin(), ends.end(), std::size_t{0}, gives_up);
  return static_cast<std::size_t>(found - ends.begin()) + 1;
}

}  // namespace

TomlTable TomlTable::from_text(std::string_view text, std::string_view name) {
  refuse_letters_outside_strings(text, name);
  auto node = std::make_shared<Node>();
  node->file = name;
  try {
    node->root = std::make_shared<toml::table>(toml::parse(text, name));
  } catch (const toml::parse_error& e) {
    std::string what(e.description());
    throw InputError(std::string(name) + ":" + std::to_string(e.source().begin.line) + ":" +
                     std::to_string(e.source().begin.column) + ": not valid TOML: " + what.substr(0, what.find('\n')));
  } catch (const TomlGaveUp&) {
    throw InputError(std::string(name) + ":" + std::to_string(line_given_up(text)) + ": not valid TOML: something stands where it cannot");
  }
  node->table = node->root.get();
  return TomlTable(node);
}

TomlTable TomlTable::from_file(const std::filesystem::path& path) {
  TomlTable table = from_text(read_whole(path), path.string());
  table.node_->folder = path.parent_path();
  return table;
}

std::vector<std::string> TomlTable::keys() const {
  std::vector<std::string> names;
  if (!node_->table) return names;
  for (const auto& [key, value] : *node_->table) names.emplace_back(key.str());
  return names;
}

bool TomlTable::has(std::string_view key) const { return node_->table && node_->table->contains(key); }

TomlTable TomlTable::table(std::string_view key) {
  auto child = std::make_shared<Node>();
  child->root = node_->root;
  child->file = node_->file;
  child->folder = node_->folder;
  child->prefix = node_->prefix + std::string(key) + ".";
  if (const toml::node* node = node_->find(key)) {
    if (!node->is_table()) throw InputError(node_->complain(key, "must be a table [" + node_->prefix + std::string(key) + "]"));
    child->table = node->as_table();
  }
  node_->children.push_back(child);
  return TomlTable(child);
}

std::vector<TomlTable> TomlTable::tables(std::string_view key) {
  std::vector<TomlTable> result;
  const toml::node* node = node_->find(key);
  if (!node) return result;
  if (!node->is_array_of_tables()) throw InputError(node_->complain(key, "must be an array of tables"));
  for (const auto& element : *node->as_array()) {
    auto child = std::make_shared<Node>();
    child->root = node_->root;
    child->file = node_->file;
    child->folder = node_->folder;
    child->prefix = node_->prefix + std::string(key) + "[" + std::to_string(result.size()) + "].";
    child->table = element.as_table();
    node_->children.push_back(child);
    result.push_back(TomlTable(child));
  }
  return result;
}

double TomlTable::number(std::string_view key, double fallback) {
  return number_in(key, fallback, -std::numeric_limits<double>::max(), std::numeric_limits<double>::max());
}

double TomlTable::number_in(std::string_view key, double fallback, double least, double most) {
  const toml::node* node = node_->find(key);
  if (!node) return fallback;
  const bool any = most == std::numeric_limits<double>::max() && least == -most;
  if (!node->is_number()) throw InputError(node_->complain(key, any ? "must be a number" : span_rule(least, most)));
  const double value = *node->value<double>();
  if (!(std::isfinite(value) && value >= least && value <= most)) {
    throw InputError(node_->complain(key, any ? "must be a finite number" : span_rule(least, most)));
  }
  return value;
}

int TomlTable::integer_in(std::string_view key, int fallback, int least, int most) {
  const toml::node* node = node_->find(key);
  if (!node) return fallback;
  const auto value = node->is_integer() ? node->value<std::int64_t>() : std::nullopt;
  if (!value || *value < least || *value > most) {
    throw InputError(node_->complain(key, "must be a whole number from " + std::to_string(least) + " to " + std::to_string(most)));
  }
  return static_cast<int>(*value);
}

bool TomlTable::boolean(std::string_view key, bool fallback) {
  const toml::node* node = node_->find(key);
  if (!node) return fallback;
  if (!node->is_boolean()) throw InputError(node_->complain(key, "must be true or false"));
  return *node->value<bool>();
}

std::string TomlTable::text(std::string_view key, std::string_view fallback) {
  const toml::node* node = node_->find(key);
  if (!node) return std::string(fallback);
  if (!node->is_string()) throw InputError(node_->complain(key, "must be a text in quotes"));
  return *node->value<std::string>();
}

std::string TomlTable::choice(std::string_view key, std::string_view fallback, const std::vector<std::string_view>& choices) {
  const toml::node* node = node_->find(key);
  if (!node) return std::string(fallback);
  const auto value = node->is_string() ? node->value<std::string>() : std::nullopt;
  std::string list;
  for (const auto c : choices) {
    if (value && *value == c) return *value;
    list += (list.empty() ? "\"" : ", \"") + std::string(c) + "\"";
  }
  throw InputError(node_->complain(key, "must be one of " + list));
}

Vec2 TomlTable::vector2(std::string_view key, const Vec2& fallback) {
  const toml::node* node = node_->find(key);
  if (!node) return fallback;
  const toml::array* array = node->as_array();
  if (!array || array->size() != 2 || !(*array)[0].is_number() || !(*array)[1].is_number()) {
    throw InputError(node_->complain(key, "must be two numbers [x, y]"));
  }
  return {*(*array)[0].value<double>(), *(*array)[1].value<double>()};
}

Vec3 TomlTable::vector3(std::string_view key, const Vec3& fallback) {
  const toml::node* node = node_->find(key);
  if (!node) return fallback;
  const toml::array* array = node->as_array();
  if (!array || array->size() != 3 || !(*array)[0].is_number() || !(*array)[1].is_number() || !(*array)[2].is_number()) {
    throw InputError(node_->complain(key, "must be three numbers [x, y, z]"));
  }
  return {*(*array)[0].value<double>(), *(*array)[1].value<double>(), *(*array)[2].value<double>()};
}

std::vector<std::vector<double>> TomlTable::number_rows(std::string_view key, std::size_t columns) {
  std::vector<std::vector<double>> result;
  const toml::node* node = node_->find(key);
  if (!node) return result;
  const std::string rule = "must be an array of rows of " + std::to_string(columns) + " finite numbers each";
  const toml::array* rows = node->as_array();
  if (!rows) throw InputError(node_->complain(key, rule));
  for (const auto& element : *rows) {
    const toml::array* row = element.as_array();
    if (!row || row->size() != columns) throw InputError(node_->complain(key, rule));
    result.emplace_back();
    for (const auto& cell : *row) {
      const auto value = cell.is_number() ? cell.value<double>() : std::nullopt;
      if (!value || !std::isfinite(*value)) throw InputError(node_->complain(key, rule));
      result.back().push_back(*value);
    }
  }
  return result;
}

bool TomlTable::is_text(std::string_view key) const {
  return node_->table && node_->table->get(key) && node_->table->get(key)->is_string();
}

void TomlTable::finish() const { node_->finish(); }

std::string TomlTable::complaint(std::string_view key, std::string_view rule) const { return node_->complain(key, rule); }

std::filesystem::path TomlTable::folder() const { return node_->folder; }

}  // namespace lightmill
