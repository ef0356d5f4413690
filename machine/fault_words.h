// Where in a program a fault is, in words: the same in text, pages and over pictures.
#pragma once

#include <string>

#include "machine/motion.h"
#include "machine/program_lines.h"

namespace lightmill {

/// "line 8", "lines 8 to 12" or "lines 8 to 12, worst in 9", as an editor counts them; empty where the fault has no line.
std::string lines_in_words(const Fault& fault);
/// "limit in 30_finish.nc, line 8".
std::string heading(const Fault& fault);
/// The heading and the message.
std::string described(const Fault& fault);
/// The picture under heading and message; empty if it has none.
std::string headed_picture(const Fault& fault);

/// From a machine's count of the lines sent to it to the program and its lines.
void locate(Fault& fault, const SentLines& sent);

}  // namespace lightmill
