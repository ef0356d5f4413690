#include "design/detail/svg_style.h"

#include <algorithm>
#include <iterator>

#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

/// Comments as blanks, lines kept.
std::string without_comments(std::string_view css) {
  std::string plain(css);
  for (std::size_t at = 0; (at = plain.find("/*", at)) != std::string::npos;) {
    const std::size_t end = plain.find("*/", at + 2);
    const std::size_t stop = end == std::string::npos ? plain.size() : end + 2;
    for (; at < stop; ++at) {
      if (plain[at] != '\n') plain[at] = ' ';
    }
  }
  return plain;
}

bool is_name(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) {
    return c == '-' || c == '_' || (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
           static_cast<unsigned char>(c) >= 128;
  });
}

}  // namespace

bool is_known_property(std::string_view name) {
  // Those that the reader handles or warns of by their value, and those that do not matter: strokes are lines without
  // ends or corners, and text is not drawn.
  static constexpr std::string_view known[] = {"fill",
                                               "stroke",
                                               "color",
                                               "stroke-width",
                                               "fill-opacity",
                                               "stroke-opacity",
                                               "opacity",
                                               "fill-rule",
                                               "clip-rule",
                                               "visibility",
                                               "display",
                                               "clip-path",
                                               "mask",
                                               "filter",
                                               "stroke-dasharray",
                                               "stroke-dashoffset",
                                               "marker",
                                               "marker-start",
                                               "marker-mid",
                                               "marker-end",
                                               "mix-blend-mode",
                                               "vector-effect",
                                               "transform",
                                               "overflow",
                                               "stop-color",
                                               "stop-opacity",
                                               "color-interpolation",
                                               "stroke-linecap",
                                               "stroke-linejoin",
                                               "stroke-miterlimit",
                                               "paint-order",
                                               "isolation",
                                               "enable-background",
                                               "shape-rendering",
                                               "image-rendering",
                                               "text-rendering",
                                               "color-rendering",
                                               "color-interpolation-filters",
                                               "color-profile",
                                               "cursor",
                                               "pointer-events",
                                               "will-change",
                                               "solid-color",
                                               "solid-opacity",
                                               "flood-color",
                                               "flood-opacity",
                                               "lighting-color",
                                               "letter-spacing",
                                               "word-spacing",
                                               "line-height",
                                               "writing-mode",
                                               "direction",
                                               "unicode-bidi",
                                               "dominant-baseline",
                                               "alignment-baseline",
                                               "baseline-shift",
                                               "kerning",
                                               "white-space",
                                               "shape-padding",
                                               "shape-margin",
                                               "inline-size",
                                               "user-select",
                                               "background",
                                               "background-color"};
  static constexpr std::string_view families[] = {"font",     "text-", "glyph-", "-inkscape-",
                                                  "-webkit-", "-moz-", "-ms-",   "--"};
  return std::find(std::begin(known), std::end(known), name) != std::end(known) ||
         std::any_of(std::begin(families), std::end(families),
                     [&](std::string_view family) { return name.starts_with(family); });
}

std::vector<Declaration> parse_declarations(std::string_view css, const StyleComplaint& complain) {
  std::vector<Declaration> declarations;
  const std::string plain = without_comments(css);
  for (std::size_t at = 0; at < plain.size();) {
    // A semicolon in brackets belongs to an address.
    std::size_t end = at;
    for (int depth = 0; end < plain.size() && (plain[end] != ';' || depth > 0); ++end)
      depth += plain[end] == '(' ? 1 : plain[end] == ')' ? -1 : 0;
    const std::string_view text = std::string_view(plain).substr(at, end - at);
    const std::size_t colon = text.find(':');
    if (colon != std::string_view::npos) {
      Declaration declaration;
      declaration.property = lower_case(trimmed(text.substr(0, colon)));
      std::string_view value = trimmed(text.substr(colon + 1));
      if (const std::size_t mark = value.rfind('!');
          mark != std::string_view::npos && lower_case(trimmed(value.substr(mark + 1))) == "important") {
        declaration.important = true;
        value = trimmed(value.substr(0, mark));
      }
      declaration.value = value;
      if (is_known_property(declaration.property)) {
        declarations.push_back(std::move(declaration));
      } else {
        complain(at + text.find(trimmed(text)),
                 "property \"" + declaration.property + "\" is not understood and ignored");
      }
    } else if (!trimmed(text).empty()) {
      complain(at + text.find(trimmed(text)),
               "style \"" + std::string(trimmed(text)) + "\" is not understood and ignored");
    }
    at = end + 1;
  }
  return declarations;
}

void StyleSheet::add(std::string_view css, const StyleComplaint& complain) {
  std::string plain = without_comments(css);
  for (const std::string_view mark : {"<!--", "-->"}) {
    for (std::size_t at = 0; (at = plain.find(mark, at)) != std::string::npos;)
      plain.replace(at, mark.size(), mark.size(), ' ');
  }
  for (std::size_t at = 0; at < plain.size();) {
    at = std::min(plain.find_first_not_of(" \t\r\n\f", at), plain.size());
    if (at == plain.size()) break;
    const std::size_t open = plain.find_first_of("{;", at);
    if (plain[at] == '@') {
      // To its semicolon, or past its block and those inside.
      std::size_t end = open == std::string::npos ? plain.size() : open + 1;
      if (open != std::string::npos && plain[open] == '{') {
        for (int depth = 1; end < plain.size() && depth > 0; ++end)
          depth += plain[end] == '{' ? 1 : plain[end] == '}' ? -1 : 0;
      }
      const std::string_view head = std::string_view(plain).substr(at, std::min(open, plain.size()) - at);
      const bool of_text_only =
          head.starts_with("@charset") || head.starts_with("@namespace") || head.starts_with("@font-face");
      if (!of_text_only)
        complain(at, "style rule \"" + std::string(trimmed(head)) + "\" is not understood and ignored");
      at = end;
      continue;
    }
    if (open == std::string::npos || plain[open] == ';') {
      const std::size_t end = open == std::string::npos ? plain.size() : open + 1;
      complain(at, "style rule \"" +
                       std::string(trimmed(std::string_view(plain).substr(at, std::min<std::size_t>(end - at, 60)))) +
                       "\" has no block and is ignored");
      at = end;
      continue;
    }
    const std::size_t close = std::min(plain.find('}', open), plain.size());
    const std::vector<Declaration> declarations =
        parse_declarations(std::string_view(plain).substr(open + 1, close - open - 1),
                           [&](std::size_t offset, const std::string& what) { complain(open + 1 + offset, what); });
    std::string_view selectors = std::string_view(plain).substr(at, open - at);
    while (!selectors.empty()) {
      const std::size_t comma = std::min(selectors.find(','), selectors.size());
      const std::string_view selector = trimmed(selectors.substr(0, comma));
      selectors.remove_prefix(std::min(comma + 1, selectors.size()));
      Rule rule;
      rule.order = static_cast<int>(rules_.size());
      rule.declarations = declarations;
      bool understood = !selector.empty();
      std::size_t from = 0;
      while (understood && from < selector.size()) {
        const std::size_t to = std::min(selector.find_first_of(".#", from + 1), selector.size());
        const std::string_view part = selector.substr(from, to - from);
        if (part.front() == '.' && is_name(part.substr(1))) {
          rule.classes.emplace_back(part.substr(1));
          rule.specificity += 100;
        } else if (part.front() == '#' && is_name(part.substr(1)) && rule.id.empty()) {
          rule.id = part.substr(1);
          rule.specificity += 10000;
        } else if (from == 0 && is_name(part)) {
          rule.type = part;
          rule.specificity += 1;
        } else if (from != 0 || part != "*") {
          understood = false;
        }
        from = to;
      }
      if (!understood) {
        complain(at, "selector \"" + std::string(selector) +
                         "\" is not understood and its rule ignored; select by type, class or id");
        continue;
      }
      const std::string key = !rule.id.empty()        ? "#" + rule.id
                              : !rule.classes.empty() ? "." + rule.classes.front()
                              : !rule.type.empty()    ? rule.type
                                                      : "*";
      by_key_[key].push_back(rule.order);
      rules_.push_back(std::move(rule));
    }
    at = close + 1;
  }
}

std::vector<Declaration> StyleSheet::matching(const std::string& type, const std::string& id,
                                              std::string_view classes) const {
  if (rules_.empty()) return {};
  std::vector<std::string_view> own;
  while (!(classes = trimmed(classes)).empty()) {
    const std::size_t end = std::min(classes.find_first_of(" \t\r\n\f"), classes.size());
    own.push_back(classes.substr(0, end));
    classes.remove_prefix(end);
  }
  std::vector<int> found;
  const auto look = [&](const std::string& key) {
    if (const auto rules = by_key_.find(key); rules != by_key_.end())
      found.insert(found.end(), rules->second.begin(), rules->second.end());
  };
  look("*");
  look(type);
  if (!id.empty()) look("#" + id);
  for (const auto name : own) look("." + std::string(name));
  std::erase_if(found, [&](int k) {
    const Rule& rule = rules_[k];
    return !((rule.type.empty() || rule.type == type) && (rule.id.empty() || rule.id == id) &&
             std::all_of(rule.classes.begin(), rule.classes.end(), [&](const std::string& name) {
               return std::find(own.begin(), own.end(), name) != own.end();
             }));
  });
  std::sort(found.begin(), found.end(), [&](int a, int b) {
    return rules_[a].specificity != rules_[b].specificity ? rules_[a].specificity < rules_[b].specificity : a < b;
  });
  found.erase(std::unique(found.begin(), found.end()), found.end());
  std::vector<Declaration> declarations;
  for (const int k : found)
    declarations.insert(declarations.end(), rules_[k].declarations.begin(), rules_[k].declarations.end());
  return declarations;
}

}  // namespace lightmill::detail
