#include "design/detail/svg_document.h"

#include <algorithm>
#include <array>

#include "design/core/errors.h"
#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

constexpr int kDeepestNesting = 512;  // of elements, well within a thread's stack
constexpr std::size_t kMostWarnings = 100;

/// The address that a prefix stands for at a node.
std::string namespace_of(pugi::xml_node node, const std::string& prefix) {
  const std::string attribute = "xmlns:" + prefix;
  for (; node; node = node.parent()) {
    if (const auto given = node.attribute(attribute.c_str())) return given.value();
  }
  return "";
}

}  // namespace

SvgDocument::SvgDocument(std::string text, std::string name) : text_(std::move(text)), name_(std::move(name)) {
  if (text_.starts_with("\x1f\x8b"))
    throw InputError(name_ + ": this drawing is compressed; save it again as plain SVG");
  for (std::size_t at = 0; at < text_.size(); ++at) {
    if (text_[at] == '\n') line_ends_.push_back(at);
  }
  const auto parsed =
      document_.load_buffer(text_.data(), text_.size(), pugi::parse_default | pugi::parse_ws_pcdata_single);
  if (!parsed) {
    throw InputError(message(line_at(parsed.offset), std::string("not valid XML: ") + parsed.description() +
                                                         "; save the drawing again as plain SVG"));
  }
  if (local_name(root()) != "svg") throw InputError(name_ + ": the root element is not <svg>; give an SVG drawing");
  collect(root(), 0);
}

int SvgDocument::line_at(std::ptrdiff_t offset) const {
  const auto at = static_cast<std::size_t>(std::max<std::ptrdiff_t>(offset, 0));
  return 1 + static_cast<int>(std::lower_bound(line_ends_.begin(), line_ends_.end(), at) - line_ends_.begin());
}

std::string SvgDocument::message(int line, const std::string& what) const {
  return name_ + ":" + std::to_string(line) + ": " + what;
}

void SvgDocument::warn_at(int line, const std::string& what) {
  std::string warning = message(line, what);
  if (!warned_.insert(warning).second) return;
  if (warnings_.size() < kMostWarnings) warnings_.push_back(std::move(warning));
}

void SvgDocument::refuse(const pugi::xml_node& node, const std::string& what) const {
  throw InputError(message(line_of(node), what));
}

std::vector<std::string> SvgDocument::warnings() const {
  std::vector<std::string> all = warnings_;
  if (warned_.size() > kMostWarnings)
    all.push_back(name_ + ": " + std::to_string(warned_.size() - kMostWarnings) + " more warnings are not listed");
  return all;
}

/// Ids and style sheets.
void SvgDocument::collect(const pugi::xml_node& node, int depth) {
  if (depth > kDeepestNesting)
    refuse(node, "elements are nested over " + std::to_string(kDeepestNesting) + " deep; ungroup the drawing");
  if (const char* id = node.attribute("id").value(); *id) ids_.emplace(id, node);
  if (node.type() == pugi::node_element && local_name(node) == "style") add_sheet(node);
  for (const auto& child : node.children()) collect(child, depth + 1);
}

void SvgDocument::add_sheet(const pugi::xml_node& node) {
  const std::string type = node.attribute("type").as_string("text/css");
  const std::string media = node.attribute("media").as_string("all");
  if (type != "text/css" || (media != "all" && media != "screen")) {
    warn(node, "<style> of type \"" + type + "\" for \"" + media + "\" is not understood and ignored");
    return;
  }
  for (const auto& part : node.children()) {
    if (part.type() != pugi::node_pcdata && part.type() != pugi::node_cdata) continue;
    const std::string_view css = part.value();
    const int line = line_of(part);
    sheet_.add(css, [&](std::size_t offset, const std::string& what) {
      const auto end = css.begin() + static_cast<std::ptrdiff_t>(std::min(offset, css.size()));
      warn_at(line + static_cast<int>(std::count(css.begin(), end, '\n')), what);
    });
  }
}

pugi::xml_node SvgDocument::named(std::string_view address) const {
  address = trimmed(address);
  if (address.starts_with("url(") && address.ends_with(')')) address = trimmed(address.substr(4, address.size() - 5));
  if (address.size() >= 2 && (address.front() == '"' || address.front() == '\''))
    address = address.substr(1, address.size() - 2);
  if (!address.starts_with('#')) return {};
  const auto found = ids_.find(address.substr(1));
  return found == ids_.end() ? pugi::xml_node() : found->second;
}

double SvgDocument::length(const pugi::xml_node& node, const char* attribute, double font_size, double whole,
                           double fallback) {
  const auto given = node.attribute(attribute);
  if (!given) return fallback;
  const auto value = parse_length(given.value(), whole, font_size);
  if (!value) warn(node, std::string(attribute) + " = \"" + given.value() + "\" is not a length");
  return value.value_or(fallback);
}

std::string local_name(const pugi::xml_node& node) {
  const std::string name = node.name();
  const std::size_t colon = name.find(':');
  if (colon == std::string::npos) return name;
  const std::string prefix = name.substr(0, colon);
  const std::string address = namespace_of(node, prefix);
  return address == "http://www.w3.org/2000/svg" || (prefix == "svg" && address.empty()) ? name.substr(colon + 1)
                                                                                         : name;
}

bool is_editors(const pugi::xml_node& node) {
  // By the address of its namespace, or by its prefix where that is an entity.
  static constexpr std::array<std::string_view, 12> addresses{"inkscape.org",        "sodipodi",
                                                              "ns.adobe.com",        "w3.org/1999/02/22-rdf-syntax-ns",
                                                              "creativecommons.org", "web.resource.org/cc",
                                                              "purl.org/dc",         "bohemiancoding.com/sketch",
                                                              "serif.com",           "boxy-svg.com",
                                                              "vectornator.io",      "figma.com"};
  static constexpr std::array<std::string_view, 11> prefixes{"inkscape", "sodipodi", "rdf", "cc",    "dc", "sketch",
                                                             "serif",    "i",        "x",   "graph", "bx"};
  const std::string name = node.name();
  const std::string prefix = name.substr(0, name.find(':'));
  const std::string address = namespace_of(node, prefix);
  if (!address.empty() && !address.starts_with('&')) {
    return std::any_of(addresses.begin(), addresses.end(),
                       [&](std::string_view known) { return address.find(known) != std::string_view::npos; });
  }
  return std::find(prefixes.begin(), prefixes.end(), prefix) != prefixes.end();
}

std::string href_of(const pugi::xml_node& node) {
  const auto plain = node.attribute("href");
  return plain ? plain.value() : node.attribute("xlink:href").value();
}

bool has_class(const pugi::xml_node& node, std::string_view wanted) {
  std::string_view classes = node.attribute("class").value();
  while (!(classes = trimmed(classes)).empty()) {
    if (take_word(classes) == wanted) return true;
  }
  return false;
}

}  // namespace lightmill::detail
