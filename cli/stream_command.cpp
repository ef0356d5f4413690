#include "cli/stream_command.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "cli/commands.h"
#include "cli/digest.h"
#include "cli/job.h"
#include "cli/operator_keys.h"
#include "cli/restart_picture.h"
#include "cli/simulation.h"
#include "cli/stage_runs.h"
#include "cli/stages.h"
#include "cli/stream_checks.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/block_transfer.h"
#include "machine/connection.h"
#include "machine/drip_feed.h"
#include "machine/journal.h"
#include "machine/program_lines.h"
#include "machine/restart.h"
#include "machine/streamer.h"
#include "postproc/machine_model.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr double kTrialPitch_mm = 0.05;  // fine enough for collisions and rapids in the stock
constexpr double kPictureReach_mm = 8;   // beyond the overlap
constexpr const char* kJournalEnding = ".journal";

std::string now_text() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::localtime_r(&now, &parts);
  char text[32];
  return std::string(text, std::strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", &parts));
}

/// A line typed by the person at the terminal; false: there is none, or the end of it.
bool typed_line(std::string& answer) {
  if (::isatty(STDIN_FILENO) != 1) return false;
  answer.clear();
  for (int c = std::getchar(); c != '\n'; c = std::getchar()) {
    if (c == EOF) return false;
    answer += static_cast<char>(c);
  }
  return true;
}

/// A run folder's programs leave only as the dry run saw them, and only if it found no fault.
int allowed_to_mill(const RunFolder& folder) {
  const std::string again = "lightmill dry-run " + folder.root().string();
  if (folder.record(Stage::kDryRun).is_null())
    throw InputError("these programs have not been dry-run, do not mill; run: " + again);
  const json made = folder.record(Stage::kPost);
  if (made.is_null())
    throw InputError(
        "the programs' record is gone, do not mill; run: lightmill make, or lightmill post and dry-run, again");
  for (const auto& [name, what] : made["files"].items()) {
    std::error_code error;
    if (fs::exists(folder.file(name), error) && sha256_of_file(folder.file(name)) == what["sha256"]) continue;
    throw InputError(
        name +
        " is not what the dry run saw (lines lost or edited), do not mill; write it again with: lightmill post " +
        folder.root().string() + ", then: " + again);
  }
  return dry_run_verdict(folder);
}

/// The folder's journals in the order of their streams.
std::vector<fs::path> journals_of(const fs::path& folder) {
  std::vector<fs::path> journals;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder / "stream", error)) {
    if (entry.path().extension() == kJournalEnding) journals.push_back(entry.path());
  }
  std::sort(journals.begin(), journals.end());
  return journals;
}

/// Of the last stream of which a line may have gone out.
std::optional<JournalSummary> last_journal(const fs::path& folder) {
  std::vector<fs::path> journals = journals_of(folder);
  for (; !journals.empty(); journals.pop_back()) {
    try {
      return read_journal(journals.back());
    } catch (const InputError&) {
      // Its sender died before the first line.
    }
  }
  return std::nullopt;
}

/// "stream/000007_30_finish.journal": numbered, so that the last one is the last stream.
fs::path next_journal(const fs::path& folder, const std::string& program) {
  const std::vector<fs::path> journals = journals_of(folder);
  const long last = journals.empty() ? 0 : std::strtol(journals.back().filename().c_str(), nullptr, 10);
  std::string number = std::to_string(last + 1);
  number.insert(0, 6 - std::min<std::size_t>(number.size(), 6), '0');
  return folder / "stream" / (number + "_" + fs::path(program).stem().string() + kJournalEnding);
}

/// What is sent: a program, or a restart of one.
struct Sending {
  std::string program;         ///< file name
  std::string program_digest;  ///< of the program
  std::string text;
  long entry_lines = 0, first_line = 1, uncut_line = 1;
};

Sending whole(const fs::path& program, bool must_end_itself = true) {
  Sending sending{program.filename().string(), "", read_whole(program)};
  if (must_end_itself && !ends_itself(sending.text)) {
    throw InputError(
        program.string() +
        ": the last line is no M2 or M30, the file is cut short or its end is missing; copy it again or add the M30");
  }
  sending.program_digest = program_digest(sending.text);
  return sending;
}

/// Which line formats and dialects go with a way of sending.
struct Protocol {
  const char* name;
  const char* format;
  std::vector<std::string> dialects;
  [[nodiscard]] bool acknowledges_lines() const { return std::string_view(name).starts_with("grbl"); }
};

const Protocol& protocol_of(const std::string& name) {
  static const std::vector<Protocol> kProtocols = {{"grblhal", "8N1", {"grblhal"}},
                                                   {"grbl", "8N1", {"grblhal"}},
                                                   {"drip", "7E2", {"fanuc", "siemens", "heidenhain_iso"}},
                                                   {"fe", "7E1", {"heidenhain", "heidenhain_iso"}}};
  for (const Protocol& protocol : kProtocols) {
    if (name == protocol.name) return protocol;
  }
  throw InputError("--protocol " + name + ": must be grblhal, grbl, drip or fe");
}

/// Sends one program and says how it ended.
StreamResult send_program(Connection& connection, const std::string& text, const StreamChoices& choices,
                          const MachineModel* machine, OperatorKeys& keys, Journal* journal, const Monitor& monitor) {
  const auto ask = [&](const std::string& what) {
    const bool go_on = choices.confirm_all || keys.ask(what);
    if (journal != nullptr) journal->note(what + (go_on ? ": the operator goes on" : ": nobody goes on"));
    return go_on;
  };
  if (choices.protocol == "fe") return transfer_blockwise(connection, text, {}, monitor);
  if (choices.protocol == "drip") {
    DripOptions options;
    options.on_operator = ask;
    return drip_feed(connection, text, options, monitor);
  }
  StreamOptions options;
  options.on_operator = ask;
  options.commands = [&] { return keys.pressed(); };
  options.machine = machine;
  if (!choices.no_check) {
    const StreamResult checked = check_program(connection, text, options, monitor.part(0, 0.1));
    if (!checked.done()) return checked;
  }
  options.journal = journal;
  options.pause_before = [&](const ProgramLine& line, std::string_view before) {
    const auto& at = choices.pause_at;
    return choices.single_block || (choices.optional_stops && is_optional_stop(before)) ||
           std::find(at.begin(), at.end(), line.number) != at.end();
  };
  return stream_program(connection, text, options, monitor.part(choices.no_check ? 0 : 0.1, 1));
}

/// Streams in order; with a folder, each with its journal and a line of summary.
int send_all(const std::vector<Sending>& sendings, const RunFolder* folder, const Job* job,
             const StreamChoices& choices, Progress& progress) {
  const Protocol& protocol = protocol_of(choices.protocol);
  SerialFormat format = serial_format(choices.format.empty() ? protocol.format : choices.format);
  format.software_flow = choices.protocol == "drip";
  const int baud = choices.baud == 0 ? 115200 : choices.baud;
  const auto connection = open_connection(choices.port, baud, format);
  std::optional<MachineModel> machine;
  if (job != nullptr) machine = read_machine(job->machine.file);
  OperatorKeys keys(STDIN_FILENO);
  if (protocol.acknowledges_lines() && ::isatty(STDIN_FILENO) == 1) progress.say(OperatorKeys::kHelp);
  if (folder != nullptr) {
    if (const std::string slow = slow_link(folder->report(), baud); !slow.empty()) progress.say("warning: " + slow);
    if (!choices.confirm_all && !keys.ask(checklist(*job))) {
      std::fprintf(stderr, "lightmill: nobody confirmed the checklist, nothing was sent (--confirm-all leaves it out)\n");
      return kExitStreamEnded;
    }
  }
  for (const Sending& sending : sendings) {
    std::unique_ptr<Journal> journal;
    if (folder != nullptr && protocol.acknowledges_lines()) {
      JournalHeader header;
      header.program = sending.program;
      header.program_digest = sending.program_digest;
      header.sent_digest = program_digest(sending.text);
      header.machine_digest = sha256_of_file(job->machine.file);
      header.job_digest = making_digest(*job);
      header.started = now_text();
      header.lines = static_cast<long>(program_lines(sending.text).size());
      header.planner_blocks = machine->planner_blocks;
      header.entry_lines = sending.entry_lines;
      header.first_line = sending.first_line;
      header.uncut_line = sending.uncut_line;
      journal = std::make_unique<Journal>(next_journal(folder->root(), sending.program), header);
    }
    StreamResult result;
    try {
      result = send_program(*connection, sending.text, choices, machine ? &*machine : nullptr, keys, journal.get(),
                            progress.stage(sending.program));
    } catch (const std::exception& error) {
      if (journal) journal->end("not started", error.what());
      throw;
    }
    if (journal && result.end != StreamEnd::kJournal) journal->end(stream_end_name(result.end), result.message);
    const json summary = {{"event", "stream"},
                          {"program", sending.program},
                          {"from_line", sending.first_line},
                          {"end", stream_end_name(result.end)},
                          {"message", result.message},
                          {"lines", result.lines_total},
                          {"sent", result.lines_sent},
                          {"acknowledged", result.lines_acknowledged},
                          {"executed", result.lines_executed},
                          {"error_line", result.error_line},
                          {"seconds", result.seconds},
                          {"starved_reports", result.starved_reports},
                          {"repeated_blocks", result.repeated_blocks}};
    progress.event(summary);
    if (folder != nullptr) {
      std::ofstream log(folder->file("streams.jsonl"), std::ios::app);
      log << summary.dump() << std::endl;
      if (!log) throw IoError("cannot add to " + folder->file("streams.jsonl").string());
    }
    if (result.end == StreamEnd::kStopped && stop_requested()) throw Stopped();
    if (!result.done()) {
      std::fprintf(stderr, "lightmill: %s ended early (%s): %s; %ld of %ld lines are acknowledged%s\n",
                   sending.program.c_str(), stream_end_name(result.end).c_str(), result.message.c_str(),
                   result.lines_acknowledged, result.lines_total,
                   journal ? ("; go on with: lightmill resume " + folder->root().string()).c_str() : "");
      return kExitStreamEnded;
    }
    progress.done();
    progress.say(sending.program + ": " + result.message + "; " + fixed(result.seconds, 1) + " s");
  }
  return kExitDone;
}

/// What the command line leaves to the job.
void complete(StreamChoices& choices, const Job& job, const RunFolder& folder) {
  if (choices.port.empty()) choices.port = job.stream.port;
  if (choices.baud == 0) choices.baud = job.stream.baud;
  const Protocol& protocol = protocol_of(choices.protocol);
  const std::string& dialect = job.controller.dialect;
  if (std::find(protocol.dialects.begin(), protocol.dialects.end(), dialect) == protocol.dialects.end()) {
    throw InputError("programs in the dialect " + dialect + " are files for the control's own disk; copy " +
                     folder.file("program").string() + " to it (" + choices.protocol + " feeds " +
                     protocol.dialects.front() + " programs; see --protocol)");
  }
}

void need_port(const StreamChoices& choices) {
  if (choices.port.empty())
    throw InputError(
        "no port given; name it with --port, for example --port /dev/ttyUSB0 (lightmill ports lists them)");
}

// --- Resume ---

std::string degrees_word(char letter, double rad) {
  return std::string(" ") + letter + fixed(rad * 180 / kPi, 3);
}

std::string position_text(const MachineModel& machine, const JointPosition& j) {
  std::string text = "X" + fixed(j.x_mm, 3) + " Y" + fixed(j.y_mm, 3) + " Z" + fixed(j.z_mm, 3);
  if (machine.has_rotary())
    text += degrees_word(machine.outer.letter, j.outer_rad) + degrees_word(machine.inner.letter, j.inner_rad);
  return text;
}

/// What the journal says and what it cannot know, for the person who decides.
void say_what_is_known(const JournalSummary& journal, const StreamPlace& place, const MachineModel& machine,
                       Progress& progress) {
  const std::string last = journal.end.empty() ? "the sender died" : journal.end;
  progress.say("program       " + journal.header.program + ", streamed " + journal.header.started);
  progress.say("ended         " + last + " after " + fixed(journal.seconds, 1) + " s" +
               (journal.end_message.empty() ? "" : ": " + journal.end_message));
  if (journal.torn_bytes > 0)
    progress.say("journal       its last " + std::to_string(journal.torn_bytes) + " bytes are torn and do not count");
  progress.say("acknowledged  " +
               (place.acknowledged_line > 0 ? "line " + std::to_string(place.acknowledged_line) : "no line"));
  progress.say("surely cut    " +
               (place.executed_line > 0 ? "to line " + std::to_string(place.executed_line) : "nothing") + " (" +
               place.reason + ")");
  if (place.reported) {
    progress.say("last position " + position_text(machine, *place.reported) + " in machine coordinates, reported " +
                 fixed(place.report_age_s, 1) + " s before the journal ends" +
                 (place.reported_line > 0 ? ", on the way of line " + std::to_string(place.reported_line) : ""));
  } else {
    progress.say("last position not known: no status report was recorded");
  }
  if (place.uncut_line > 0 && place.sent_line >= place.uncut_line) {
    progress.say("not known     whether lines " + std::to_string(place.uncut_line) + " to " +
                 std::to_string(place.sent_line) +
                 " are cut; a controller that kept its power goes on with what it holds");
  }
  if (journal.end != "done" && journal.end != "stopped by the user")
    progress.say(
        "not known     where the axes stand, if the controller was reset or lost its power: home it, check the zero");
}

void say_restart(const Restart& restart, Progress& progress) {
  if (restart.entry_lines == 0) {
    progress.say("restart       from the program's first line: nothing was cut yet");
    return;
  }
  progress.say("restart       at line " + std::to_string(restart.first_line) + ": " + fixed(restart.overlap_mm, 2) +
               " mm before line " + std::to_string(restart.uncut_line) + " are gone over again");
  const Vec3 p = restart.place.tip_mm;
  progress.say("place         x " + fixed(p.x(), 3) + ", y " + fixed(p.y(), 3) + ", z " + fixed(p.z(), 3) +
               " mm of the workpiece, T" + std::to_string(restart.tool) + " " + compact(restart.tool_length_mm, 3) +
               " mm long, " + compact(restart.rpm, 0) + " rpm after " + compact(restart.dwell_s, 1) +
               " s, down the tool's axis by " + fixed((restart.stand_off.tip_mm - p).norm(), 1) + " mm");
  std::size_t at = 0;
  for (long i = 0; i < restart.entry_lines; ++i) {
    const std::size_t end = restart.text.find('\n', at);
    progress.say("    " + restart.text.substr(at, end - at));
    at = end + 1;
  }
  progress.say("    (and the program's own lines from " + std::to_string(restart.first_line) + " on)");
}

/// Before anything moves.
void need_confirmation(const Restart& restart, bool yes) {
  if (yes) return;
  std::fprintf(stderr,
               "\nBefore the machine moves:\n"
               "  the axes are referenced and the zero of the workpiece is right\n"
               "  the tool is out of the work: jog it back along its axis\n"
               "  T%d with a length of %s mm is the tool that did the cut before\n"
               "  spindle, coolant and guard are ready\n"
               "Type resume and Enter to stream, anything else to leave it: ",
               restart.tool, compact(restart.tool_length_mm, 3).c_str());
  std::string answer;
  if (!typed_line(answer) || answer != "resume")
    throw InputError("not confirmed, nothing was sent (without a terminal: --yes)");
}

}  // namespace

int dry_run_verdict(const RunFolder& folder) {
  const int faults = count_faults(folder);
  if (faults == 0) return kExitDone;
  std::string first;
  const json list = json::parse(read_whole(folder.file("dry_run/faults.json")), nullptr, false);
  if (list.is_object() && !list["faults"].empty()) {
    const json& fault = list["faults"][0];
    first = fault.value("kind", "");
    if (!fault.value("program", "").empty()) first += " in " + fault.value("program", "");
    if (fault.value("line", 0L) > 0) first += " line " + std::to_string(fault.value("line", 0L));
    first += ": " + fault.value("message", "");
    std::replace(first.begin(), first.end(), '\n', ' ');
  }
  std::fprintf(stderr, "lightmill: the dry run found %d fault%s, first: %s; see %s\n", faults, faults == 1 ? "" : "s",
               first.c_str(), folder.file("report.html").c_str());
  return kExitDryRunFault;
}

int stream(StreamChoices choices, Progress& progress) {
  const bool must_end = protocol_of(choices.protocol).acknowledges_lines();
  std::error_code error;
  if (!fs::is_directory(choices.what, error)) {
    need_port(choices);
    return send_all({whole(choices.what, must_end)}, nullptr, nullptr, choices, progress);
  }
  const RunFolder folder(choices.what, false);
  const Job job = read_job(folder.file("job.toml"));
  complete(choices, job, folder);
  const std::vector<fs::path> programs = folder.programs();
  if (programs.empty())
    throw InputError("no program in " + folder.file("program").string() + "; make them with: lightmill post " +
                     choices.what);
  if (const int code = allowed_to_mill(folder); code != kExitDone) return code;
  need_port(choices);
  if (has_broken_stream(folder.root()))
    progress.say("an earlier stream broke off; this one begins anew (lightmill resume would go on)");
  std::vector<Sending> sendings;
  for (const fs::path& program : programs) sendings.push_back(whole(program, must_end));
  return send_all(sendings, &folder, &job, choices, progress);
}

bool has_broken_stream(const fs::path& folder) {
  const std::optional<JournalSummary> journal = last_journal(folder);
  if (!journal) return false;
  const fs::path program = folder / "program" / journal->header.program;
  std::error_code error;
  if (!fs::exists(program, error) || program_digest(read_whole(program)) != journal->header.program_digest)
    return false;
  if (!journal->done()) return true;
  for (const auto& entry : fs::directory_iterator(program.parent_path(), error)) {
    if (entry.path().filename() > program.filename()) return true;
  }
  return false;
}

int resume_stream(ResumeChoices choices, Progress& progress) {
  const RunFolder folder(choices.stream.what, false);
  const Job job = read_job(folder.file("job.toml"));
  complete(choices.stream, job, folder);
  if (const int code = allowed_to_mill(folder); code != kExitDone) return code;
  const std::optional<JournalSummary> found = last_journal(folder.root());
  if (!found)
    throw InputError("no journal in " + folder.file("stream").string() + "; begin with: lightmill stream " +
                     choices.stream.what);
  const JournalSummary& journal = *found;
  if (journal.header.machine_digest != sha256_of_file(job.machine.file)) {
    throw InputError(job.machine.file.string() +
                     " is not the machine file of the stream that broke off; put that one back");
  }
  const SimulatedShop shop = shop_of(job, folder);
  const MachineModel machine = read_machine(shop.machine_file);
  const OperatorSetup setup = setup_of(shop, machine);

  // The program that broke off, what was milled before it and what comes after it.
  std::vector<std::string> done;
  std::string program;
  std::vector<Sending> sendings;
  for (const fs::path& file : folder.programs()) {
    const std::string name = file.filename().string();
    if (name < journal.header.program) done.push_back(read_whole(file));
    if (name == journal.header.program) program = read_whole(file);
    if (name > journal.header.program) sendings.push_back(whole(file));
  }
  const StreamPlace place = find_place(machine, setup, program, journal);
  say_what_is_known(journal, place, machine, progress);
  const std::string name = fs::path(journal.header.program).stem().string() + "_resume";
  Restart restart;
  if (place.uncut_line == 0 && choices.from_line == 0) {
    progress.say("restart       " + journal.header.program + " is cut; " + sendings.front().program +
                 " comes next, from its beginning");
  } else {
    const long line = choices.from_line > 0 ? choices.from_line : place.uncut_line;
    if (place.uncut_line > 0 && line > place.uncut_line) {
      progress.say("warning       lines " + std::to_string(place.uncut_line) + " to " + std::to_string(line - 1) +
                   " may never have been cut and are left out as you asked (--from " + std::to_string(line) + ")");
    }
    RestartOptions options;
    options.overlap_mm = choices.overlap_mm;
    options.program_name = journal.header.program;
    restart = write_restart(machine, setup, program, line, options);
    say_restart(restart, progress);
    const fs::path text = folder.file("stream/" + name + fs::path(journal.header.program).extension().string());
    const fs::path picture = folder.file("stream/" + name + ".svg");
    write_whole(text, restart.text);
    write_whole(
        picture,
        restart_picture(restart,
                        path_near(machine, setup, program, restart.place.tip_mm, choices.overlap_mm + kPictureReach_mm),
                        "restart of " + journal.header.program + " at line " + std::to_string(restart.first_line)));
    progress.say("text          " + text.string());
    progress.say("picture       " + picture.string());

    StockOptions stock;
    stock.pitch_mm = std::max(shop.pitch_um / 1000, kTrialPitch_mm);
    const RestartTrial trial = try_restart(machine, setup, stock, done, program, restart, progress.stage("trial"));
    progress.done();
    if (!trial.faults.empty()) {
      const Fault& fault = trial.faults.front();
      std::fprintf(stderr,
                   "lightmill: the trial of the restart found %zu fault(s), first: %s line %ld: %s; nothing was sent\n",
                   trial.faults.size(), fault.kind.c_str(), fault.line, fault.message.c_str());
      return kExitDryRunFault;
    }
    progress.say("trial         no fault on the simulated machine, " + fixed(trial.seconds / 60, 1) +
                 " minutes at the commanded feeds");
    sendings.insert(sendings.begin(), {journal.header.program, journal.header.program_digest, restart.text,
                                       restart.entry_lines, restart.first_line, restart.uncut_line});
  }
  if (choices.stream.port.empty()) {
    progress.say("nothing was sent; stream it with: lightmill resume " + choices.stream.what + " --port PORT");
    return kExitDone;
  }
  need_confirmation(restart, choices.yes);
  return send_all(sendings, &folder, &job, choices.stream, progress);
}

}  // namespace lightmill
