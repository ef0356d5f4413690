// The frame and the style that the pages for a screen share.
#pragma once

#include <string>

namespace lightmill {

/// A whole page: `title` is plain text, `body` is HTML.
std::string html_page(const std::string& title, const std::string& body);

}  // namespace lightmill
