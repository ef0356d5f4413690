#include "cli/mill_proof.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "cli/commands.h"
#include "cli/digest.h"
#include "cli/fault_files.h"
#include "cli/stages.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "machine/fault_words.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char* kProofFile = "proof.json";

std::string first_fault(const RunFolder& folder, int faults) {
  std::string first;
  const json list = json::parse(read_whole(folder.file("dry_run/faults.json")), nullptr, false);
  if (list.is_object() && !list["faults"].empty()) {
    first = described(fault_from(list["faults"][0]));
    std::replace(first.begin(), first.end(), '\n', ' ');
  }
  return "the dry run found " + std::to_string(faults) + " fault" + (faults == 1 ? "" : "s") + ", first: " + first +
         "; see " + folder.file("report.html").string();
}

NoProof bad_input(const std::string& why) {
  return {why, kExitBadInput};
}

}  // namespace

std::optional<NoProof> lacks_proof(const RunFolder& folder, const Job& job) {
  const std::string again = "lightmill dry-run " + folder.root().string();
  if (folder.record(Stage::kDryRun).is_null())
    return bad_input("these programs have not been dry-run, do not mill; run: " + again);
  const json made = folder.record(Stage::kPost);
  if (made.is_null()) {
    return bad_input(
        "the programs' record is gone, do not mill; run: lightmill make, or lightmill post and dry-run, again");
  }
  for (const auto& [name, what] : made["files"].items()) {
    std::error_code error;
    if (fs::exists(folder.file(name), error) && sha256_of_file(folder.file(name)) == what["sha256"]) continue;
    return bad_input(
        name +
        " is not what the dry run saw (lines lost or edited), do not mill; write it again with: lightmill post " +
        folder.root().string() + ", then: " + again);
  }
  if (const int faults = count_faults(folder); faults > 0) return NoProof{first_fault(folder, faults), kExitDryRunFault};
  if (folder.record(Stage::kDryRun)["digest"] != stage_digest(Stage::kDryRun, job, folder)) {
    return bad_input(
        "the dry run was made with another machine, cutters, stock or offset than the job's, or they have changed since; do not mill; run: " +
        again);
  }
  return std::nullopt;
}

void write_proof(const fs::path& out, const SimulatedShop& shop, const std::vector<fs::path>& programs,
                 std::size_t faults) {
  json proof = {{"faults", faults}, {"programs", json::object()}, {"shop", json::object()}};
  for (const fs::path& program : programs) proof["programs"][program.filename().string()] = sha256_of_file(program);
  proof["shop"][shop.machine_file.string()] = sha256_of_file(shop.machine_file);
  for (const fs::path& cutter : shop.cutter_files) proof["shop"][cutter.string()] = sha256_of_file(cutter);
  write_whole(out / kProofFile, proof.dump(2) + "\n");
}

std::optional<NoProof> lacks_proof(const fs::path& program, const fs::path& proof_folder) {
  const std::string again =
      "; run: lightmill dry-run " + program.string() + " -o CHECK ..., then stream it with --proof CHECK";
  if (proof_folder.empty()) return bad_input("no dry run of " + program.string() + " is named, do not mill" + again);
  const json proof = json::parse(read_whole(proof_folder / kProofFile), nullptr, false);
  if (!proof.is_object() || !proof.contains("faults") || !proof.contains("programs") || !proof.contains("shop"))
    return bad_input((proof_folder / kProofFile).string() + " is damaged, do not mill" + again);
  const auto is_listed = [&](const std::string& digest) {
    return std::any_of(proof["programs"].begin(), proof["programs"].end(), [&](const json& known) { return known == digest; });
  };
  if (!is_listed(sha256_of_file(program)))
    return bad_input(program.string() + " is not what the dry run in " + proof_folder.string() + " saw, do not mill" + again);
  for (const auto& [file, digest] : proof["shop"].items()) {
    std::error_code error;
    if (fs::exists(file, error) && sha256_of_file(file) == digest) continue;
    return bad_input(file + " has changed since the dry run in " + proof_folder.string() + ", do not mill" + again);
  }
  if (proof["faults"] != 0) {
    return NoProof{"the dry run in " + proof_folder.string() + " found " + proof["faults"].dump() + " fault(s); see " +
                       (proof_folder / "faults.json").string(),
                   kExitDryRunFault};
  }
  return std::nullopt;
}

int dry_run_verdict(const RunFolder& folder) {
  const int faults = count_faults(folder);
  if (faults == 0) return kExitDone;
  std::fprintf(stderr, "lightmill: %s\n", first_fault(folder, faults).c_str());
  return kExitDryRunFault;
}

}  // namespace lightmill
