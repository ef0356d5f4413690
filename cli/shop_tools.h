// The small commands: what is on this computer, what comes with Lightmill, can this lens be milled.
#pragma once

#include "cli/job.h"
#include "cli/run_folder.h"

namespace lightmill {

/// Each prints to stdout and returns an exit code.
int list_ports();
int list_machines();
int list_dialects();
int doctor();

/// Whether the folder's surface can be milled as its job asks, from the design alone; what is planned already is told, too. Bad input where
/// planning would refuse, or did.
int check_machinability(const Job& job, const RunFolder& folder);

}  // namespace lightmill
