// An SVG file as a tree: its elements by name and id, its style sheets, and what is said about it, by line.
#pragma once

#include <cstddef>
#include <map>
#include <pugixml.hpp>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "design/detail/svg_style.h"

namespace lightmill::detail {

class SvgDocument {
 public:
  /// Throws InputError with the line when the text is not XML, not SVG or nested too deeply; `name` is what messages
  /// call it.
  SvgDocument(std::string text, std::string name);
  SvgDocument(const SvgDocument&) = delete;
  SvgDocument& operator=(const SvgDocument&) = delete;

  [[nodiscard]] pugi::xml_node root() const { return document_.document_element(); }
  [[nodiscard]] const StyleSheet& sheet() const { return sheet_; }

  /// The element that an address such as "#leaf" or "url(#leaf)" names; none, with no word, when it is not in the file.
  [[nodiscard]] pugi::xml_node named(std::string_view address) const;

  [[nodiscard]] int line_of(const pugi::xml_node& node) const { return line_at(node.offset_debug()); }
  /// "file:line: what", as all messages are.
  [[nodiscard]] std::string message(int line, const std::string& what) const;
  /// Notes a warning, each once and only so many.
  void warn(const pugi::xml_node& node, const std::string& what) { warn_at(line_of(node), what); }
  /// Throws InputError.
  [[noreturn]] void refuse(const pugi::xml_node& node, const std::string& what) const;
  /// Warnings in the order of their finding, the last one saying how many are not listed.
  [[nodiscard]] std::vector<std::string> warnings() const;

  /// A length attribute in user units; a percentage is of `whole`, an em is `font_size`. The fallback, with a warning
  /// if it is not understood, when it is not given.
  double length(const pugi::xml_node& node, const char* attribute, double font_size, double whole, double fallback = 0);

 private:
  [[nodiscard]] int line_at(std::ptrdiff_t offset) const;
  void warn_at(int line, const std::string& what);
  void collect(const pugi::xml_node& node, int depth);
  void add_sheet(const pugi::xml_node& node);

  std::string text_;
  std::string name_;
  std::vector<std::size_t> line_ends_;
  pugi::xml_document document_;
  std::map<std::string, pugi::xml_node, std::less<>> ids_;
  StyleSheet sheet_;
  std::vector<std::string> warnings_;
  std::set<std::string> warned_;
};

/// An element's name without the prefix of SVG's own namespace; with any other.
std::string local_name(const pugi::xml_node& node);

/// Whether the prefix of an element's name is that of what editors note beside the drawing.
bool is_editors(const pugi::xml_node& node);

/// The address of what an element refers to; empty without one.
std::string href_of(const pugi::xml_node& node);

/// Whether the element is of a class.
bool has_class(const pugi::xml_node& node, std::string_view wanted);

}  // namespace lightmill::detail
