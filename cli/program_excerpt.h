// A few lines of a program as a picture, with the one that matters marked.
#pragma once

#include <string>
#include <string_view>

namespace lightmill {

/// An SVG; lines count from 1. Empty if the program has no such line.
std::string program_excerpt(std::string_view text, long line, const std::string& title);

}  // namespace lightmill
