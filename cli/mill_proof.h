// May these programs be milled? Only as the dry run saw them, on the machine and the stock of the dry run, and when it
// found no fault.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "cli/job.h"
#include "cli/run_folder.h"
#include "cli/simulation.h"

namespace lightmill {

/// What speaks against it, in one line with the remedy, and the exit code of a command that obeys it.
struct NoProof {
  std::string why;
  int exit_code;
};

/// Of a run folder's programs, by the digests of its stages.
std::optional<NoProof> lacks_proof(const RunFolder& folder, const Job& job);

/// `dry-run PROGRAM... -o OUT` leaves OUT/proof.json: digests of programs, machine and cutters, and how many faults.
void write_proof(const std::filesystem::path& out, const SimulatedShop& shop,
                 const std::vector<std::filesystem::path>& programs, std::size_t faults);
/// Of a single program by such a folder (empty: none was named).
std::optional<NoProof> lacks_proof(const std::filesystem::path& program, const std::filesystem::path& proof_folder);

/// Tells about the first fault of the folder's dry run; the exit code says the same.
int dry_run_verdict(const RunFolder& folder);

}  // namespace lightmill
