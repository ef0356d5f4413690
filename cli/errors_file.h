// The errors of a real machine as text: the job's [dry_run.errors], and the file from which the simulated machine reads them.
#pragma once

#include <string>
#include <string_view>

#include "design/core/toml_table.h"
#include "machine/machine_errors.h"

namespace lightmill {

/// Micrometres, micrometres per metre, arc seconds, hours, Hz. Throws InputError naming the key.
MachineErrors read_machine_errors(TomlTable& table);

/// Every key on a line of its own after `prefix`.
std::string machine_errors_text(const MachineErrors& errors, std::string_view prefix);

}  // namespace lightmill
