// Text inside HTML and XML.
#pragma once

#include <string>
#include <string_view>

namespace lightmill {

/// With what would be markup written as entities: for text and quoted attributes.
std::string escaped(std::string_view text);

}  // namespace lightmill
