// Style sheets of an SVG drawing: simple selectors, and which declarations apply to an element.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace lightmill::detail {

struct Declaration {
  std::string property;
  std::string value;
  bool important = false;
};

/// Called with what is not understood and where in the text it stands.
using StyleComplaint = std::function<void(std::size_t offset, const std::string& what)>;

/// Whether a property changes what is drawn in a way we know, or does not change it. Other properties are not
/// understood.
bool is_known_property(std::string_view name);

/// "property: value; ..." as in a style attribute; without properties that are not understood.
std::vector<Declaration> parse_declarations(std::string_view css, const StyleComplaint& complain);

/// Rules whose selectors are a type, classes, an id or the three joined ("path.thin#a"), or lists of those.
class StyleSheet {
 public:
  void add(std::string_view css, const StyleComplaint& complain);

  /// Declarations for an element, weakest first; `classes` are separated by blanks.
  [[nodiscard]] std::vector<Declaration> matching(const std::string& type, const std::string& id,
                                                  std::string_view classes) const;

 private:
  struct Rule {
    std::string type, id;
    std::vector<std::string> classes;
    int specificity = 0;
    int order = 0;
    std::vector<Declaration> declarations;
  };
  std::vector<Rule> rules_;
  std::map<std::string, std::vector<int>, std::less<>> by_key_;  // "#id", ".class", "type" or "*"
};

}  // namespace lightmill::detail
