#include "cli/stream_command.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "cli/commands.h"
#include "cli/digest.h"
#include "cli/job.h"
#include "cli/mill_proof.h"
#include "cli/operator_keys.h"
#include "cli/restart_picture.h"
#include "cli/simulation.h"
#include "cli/stage_runs.h"
#include "cli/stages.h"
#include "cli/stream_checks.h"
#include "cli/stream_progress.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/block_transfer.h"
#include "machine/connection.h"
#include "machine/drip_feed.h"
#include "machine/fault_words.h"
#include "machine/journal.h"
#include "machine/program_lines.h"
#include "machine/program_schedule.h"
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

/// Mills without the dry run's word for it, if somebody types that they mean it.
void confirm_unproven(const std::string& why) {
  std::fprintf(stderr,
               "\nNothing proves that these programs are safe:\n  %s\n"
               "A wrong program breaks the tool, the spindle or more. Type unproven and Enter to stream it all the same: ",
               why.c_str());
  std::string answer;
  if (!typed_line(answer) || answer != "unproven")
    throw InputError("not confirmed, nothing was sent (--unproven wants the word typed at a terminal)");
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

/// Of a folder's last journal: its program is still there as it was streamed, and not all of them were milled to their end.
bool breaks_off(const fs::path& folder, const JournalSummary& journal) {
  const fs::path program = folder / "program" / journal.header.program;
  std::error_code error;
  if (!fs::exists(program, error) || program_digest(read_whole(program)) != journal.header.program_digest) return false;
  if (!journal.done()) return true;
  for (const auto& entry : fs::directory_iterator(program.parent_path(), error)) {
    if (entry.path().filename() > program.filename()) return true;
  }
  return false;
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
  /// The machine mills while it is sent to.
  [[nodiscard]] bool feeds_lines() const { return std::string_view(name) != "fe"; }
  [[nodiscard]] bool feeds(const std::string& dialect) const {
    return std::find(dialects.begin(), dialects.end(), dialect) != dialects.end();
  }
};

/// The first one that a dialect's control takes is its "auto".
const std::vector<Protocol>& protocols() {
  static const std::vector<Protocol> all = {{"grblhal", "8N1", {"grblhal"}},
                                            {"grbl", "8N1", {"grblhal"}},
                                            {"fe", "7E1", {"heidenhain", "heidenhain_iso"}},
                                            {"drip", "7E2", {"fanuc", "siemens", "heidenhain", "heidenhain_iso"}}};
  return all;
}

const Protocol& protocol_of(const std::string& name) {
  for (const Protocol& protocol : protocols()) {
    if (name == protocol.name) return protocol;
  }
  throw InputError("--protocol " + name + ": must be grblhal, grbl, drip or fe");
}

/// How a drip-fed control wants the beginning and the end of a program.
DripOptions tape_of(const Job* job) {
  DripOptions options;
  if (job == nullptr) return options;
  options.leader_nulls = job->stream.leader_nulls;
  if (job->controller.dialect.starts_with("heidenhain")) {
    options.tape_marks = false;
    options.trailer = "\x03\x04";
  }
  return options;
}

/// A run folder's job, or a single program without one; and why it is milled unproven, if so.
struct Errand {
  const RunFolder* folder = nullptr;
  const Job* job = nullptr;
  std::optional<MachineModel> machine;
  std::string unproven;
};

/// Sends one program and says how it ended.
StreamResult send_program(Connection& connection, const std::string& text, const StreamChoices& choices,
                          const Errand& errand, OperatorKeys& keys, Journal* journal, StreamProgress& shown,
                          const Monitor& monitor) {
  const auto ask = [&](const std::string& what) {
    const bool go_on = choices.confirm_all || keys.ask(what);
    const std::string said = what + (go_on ? ": the operator goes on" : ": nobody goes on");
    shown.note(said);
    if (journal != nullptr) journal->note(said);
    return go_on;
  };
  if (choices.protocol == "fe") return transfer_blockwise(connection, text, {}, monitor);
  // What is shown comes from the sender's reports.
  Monitor silent;
  silent.should_stop = monitor.should_stop;
  if (choices.protocol == "drip") {
    DripOptions options = tape_of(errand.job);
    options.on_operator = ask;
    const auto lines = static_cast<long>(program_lines(text).size());
    options.on_sent = [&](long sent) { shown.sent(sent, lines); };
    options.journal = journal;
    return drip_feed(connection, text, options, silent);
  }
  StreamOptions options;
  options.on_operator = ask;
  options.commands = [&] { return keys.pressed(); };
  if (errand.machine) options.machine = &*errand.machine;
  if (!choices.no_check) {
    const StreamResult checked = check_program(connection, text, options, monitor);
    if (!checked.done()) return checked;
    shown.begin();
  }
  options.one_at_a_time = choices.one_at_a_time;
  options.journal = journal;
  options.on_status = [&](const StreamStatus& status) { shown.status(status); };
  options.on_traffic = [&](const std::string& line) { shown.traffic(line); };
  options.pause_before = [&](const ProgramLine& line, std::string_view before) {
    const auto& at = choices.pause_at;
    return keys.wants_stop() || (choices.optional_stops && is_optional_stop(before)) ||
           std::find(at.begin(), at.end(), line.number) != at.end();
  };
  return stream_program(connection, text, options, silent);
}

/// The journal of one program in a run folder.
std::unique_ptr<Journal> begin_journal(const fs::path& path, const Errand& errand, const Sending& sending) {
  JournalHeader header;
  header.program = sending.program;
  header.program_digest = sending.program_digest;
  header.sent_digest = program_digest(sending.text);
  header.machine_digest = sha256_of_file(errand.job->machine.file);
  header.job_digest = making_digest(*errand.job);
  header.started = now_text();
  header.lines = static_cast<long>(program_lines(sending.text).size());
  header.planner_blocks = errand.machine->planner_blocks;
  header.entry_lines = sending.entry_lines;
  header.first_line = sending.first_line;
  header.uncut_line = sending.uncut_line;
  auto journal = std::make_unique<Journal>(path, header);
  if (!errand.unproven.empty()) journal->note("unproven, as typed: " + errand.unproven);
  return journal;
}

json summary_of(const Sending& sending, const StreamResult& result, const Errand& errand, const StreamProgress& shown) {
  json summary = {{"event", "stream"},
                  {"program", sending.program},
                  {"ended", now_text()},
                  {"from_line", sending.first_line},
                  {"end", stream_end_name(result.end)},
                  {"message", result.message},
                  {"lines", result.lines_total},
                  {"sent", result.lines_sent},
                  {"acknowledged", result.lines_acknowledged},
                  {"executed", result.lines_executed},
                  {"error_line", result.error_line},
                  {"seconds", result.seconds},
                  {"bytes", result.bytes_sent},
                  {"highest_buffer_fill", result.highest_buffer_fill},
                  {"starved_reports", result.starved_reports},
                  {"recovered_acknowledgements", result.recovered_acknowledgements},
                  {"repeated_blocks", result.repeated_blocks}};
  summary.update(shown.summary());
  if (!errand.unproven.empty()) summary["unproven"] = errand.unproven;
  return summary;
}

/// Streams in order; with a folder, each with its journal, its log and a line of summary.
int send_all(const std::vector<Sending>& sendings, const Errand& errand, const StreamChoices& choices,
             Progress& progress) {
  const Protocol& protocol = protocol_of(choices.protocol);
  SerialFormat format = serial_format(choices.format);
  format.software_flow = choices.protocol == "drip";
  format.hardware_flow = errand.job != nullptr && errand.job->stream.rts_cts;
  const auto connection = open_connection(choices.port, choices.baud, format);
  OperatorKeys keys(STDIN_FILENO);
  keys.set_single_block(choices.single_block);
  if (protocol.acknowledges_lines() && ::isatty(STDIN_FILENO) == 1) progress.say("keys:\n" + key_list());
  if (errand.folder != nullptr) {
    const std::string slow = slow_link(errand.folder->report(), choices.baud);
    if (!slow.empty()) progress.say("warning: " + slow);
    if (!choices.confirm_all && !keys.ask(checklist(*errand.job))) {
      std::fprintf(stderr, "lightmill: nobody confirmed the checklist, nothing was sent (--confirm-all leaves it out)\n");
      return kExitStreamEnded;
    }
  }
  for (const Sending& sending : sendings) {
    std::unique_ptr<Journal> journal;
    ProgramSchedule schedule;
    fs::path log;
    if (errand.folder != nullptr) {
      const fs::path path = next_journal(errand.folder->root(), sending.program);
      if (protocol.feeds_lines()) journal = begin_journal(path, errand, sending);
      log = fs::path(path).replace_extension(".log");
      const OperatorSetup setup = setup_of(shop_of(*errand.job, *errand.folder), *errand.machine);
      schedule = schedule_program(*errand.machine, setup, errand.job->controller.dialect, sending.text);
    }
    StreamProgress shown(progress, std::move(schedule), log);
    StreamResult result;
    try {
      result = send_program(*connection, sending.text, choices, errand, keys, journal.get(), shown,
                            progress.stage(sending.program));
    } catch (const std::exception& error) {
      shown.note(error.what());
      if (journal) journal->end("not started", error.what());
      throw;
    }
    if (journal && result.end != StreamEnd::kJournal) journal->end(stream_end_name(result.end), result.message);
    shown.note(stream_end_name(result.end) + ": " + result.message);
    const json summary = summary_of(sending, result, errand, shown);
    progress.event(summary);
    if (errand.folder != nullptr) {
      std::ofstream all(errand.folder->file("streams.jsonl"), std::ios::app);
      all << summary.dump() << std::endl;
      if (!all) throw IoError("cannot add to " + errand.folder->file("streams.jsonl").string());
    }
    if (result.end == StreamEnd::kStopped && stop_requested()) throw Stopped();
    if (!result.done()) {
      std::fprintf(stderr, "lightmill: %s ended early (%s): %s; %ld of %ld lines are acknowledged%s\n",
                   sending.program.c_str(), stream_end_name(result.end).c_str(), result.message.c_str(),
                   result.lines_acknowledged, result.lines_total,
                   journal ? ("; go on with: lightmill resume " + errand.folder->root().string()).c_str() : "");
      return kExitStreamEnded;
    }
    progress.done();
    progress.say(sending.program + ": " + result.message + "; " + fixed(result.seconds, 1) + " s");
  }
  return kExitDone;
}

/// What the command line leaves open: by the job, then by what the dialect's control speaks.
void complete(StreamChoices& choices, const Job& job, const RunFolder& folder) {
  const std::string& dialect = job.controller.dialect;
  if (choices.port.empty()) choices.port = job.stream.port;
  if (choices.baud == 0) choices.baud = job.stream.baud;
  if (choices.format.empty() && job.stream.format != "auto") choices.format = job.stream.format;
  choices.no_check = choices.no_check || !job.stream.check_first;
  choices.one_at_a_time = choices.one_at_a_time || job.stream.one_at_a_time;
  if (choices.protocol.empty() && job.stream.protocol != "auto") choices.protocol = job.stream.protocol;
  if (choices.protocol.empty()) {
    for (const Protocol& protocol : protocols()) {
      if (choices.protocol.empty() && protocol.feeds(dialect)) choices.protocol = protocol.name;
    }
  }
  if (choices.protocol.empty() || !protocol_of(choices.protocol).feeds(dialect)) {
    throw InputError("programs in the dialect " + dialect + " are files for the control's own disk; copy " +
                     folder.file("program").string() + " to it" +
                     (choices.protocol.empty() ? "" : " (" + choices.protocol + " feeds " +
                                                          protocol_of(choices.protocol).dialects.front() +
                                                          " programs; see --protocol)"));
  }
  // Heidenhain's own text mode has one stop bit.
  if (choices.format.empty()) choices.format = dialect.starts_with("heidenhain") ? "7E1" : protocol_of(choices.protocol).format;
}

void complete(StreamChoices& choices) {
  if (choices.protocol.empty()) choices.protocol = protocols().front().name;
  if (choices.baud == 0) choices.baud = StreamSpec{}.baud;
  if (choices.format.empty()) choices.format = protocol_of(choices.protocol).format;
}

/// What is milled without a proof is said; empty: it has one. An exit code if it must not be milled.
std::optional<int> settle_proof(const std::optional<NoProof>& lacking, const StreamChoices& choices, std::string& unproven) {
  if (!lacking) return std::nullopt;
  if (choices.unproven) {
    confirm_unproven(lacking->why);
    unproven = lacking->why;
    return std::nullopt;
  }
  if (lacking->exit_code == kExitBadInput) throw InputError(lacking->why + " (--unproven overrides this)");
  std::fprintf(stderr, "lightmill: %s\n", lacking->why.c_str());
  return lacking->exit_code;
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

void say_how_it_ended(const JournalSummary& journal, Progress& progress) {
  const std::string last = journal.end.empty() ? "the sender died" : journal.end;
  progress.say("program       " + journal.header.program + ", streamed " + journal.header.started);
  progress.say("ended         " + last + " after " + fixed(journal.seconds, 1) + " s" +
               (journal.end_message.empty() ? "" : ": " + journal.end_message));
  if (journal.torn_bytes > 0)
    progress.say("journal       its last " + std::to_string(journal.torn_bytes) + " bytes are torn and do not count");
}

/// What the journal says and what it cannot know, for the person who decides.
void say_what_is_known(const JournalSummary& journal, const StreamPlace& place, const MachineModel& machine,
                       Progress& progress) {
  say_how_it_ended(journal, progress);
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
  if (journal.end != "done" && journal.end != stream_end_name(StreamEnd::kStopped) &&
      journal.end != stream_end_name(StreamEnd::kAborted))
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
  if (restart.backs_out_mm > 0)
    progress.say("first         out along the tool's axis by " + fixed(restart.backs_out_mm, 1) +
                 " mm from where it stopped; if you have jogged it away already, take that line out");
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
               "  the tool is %s\n"
               "  T%d with a length of %s mm is the tool that did the cut before\n"
               "  spindle, coolant and guard are ready\n"
               "Type resume and Enter to stream, anything else to leave it: ",
               restart.backs_out_mm > 0 ? "where it stopped: the restart backs it out along its axis first"
                                        : "out of the work: jog it back along its axis",
               restart.tool, compact(restart.tool_length_mm, 3).c_str());
  std::string answer;
  if (!typed_line(answer) || answer != "resume")
    throw InputError("not confirmed, nothing was sent (without a terminal: --yes)");
}

/// The program that broke off, what was milled before it and what comes after it.
struct BrokenProgram {
  SimulatedShop shop;
  OperatorSetup setup;
  fs::path file;
  std::string text;
  std::vector<std::string> done;
  std::vector<Sending> rest;
};

BrokenProgram broken_program(const Errand& errand, const std::string& name, bool must_end_itself) {
  BrokenProgram broken;
  broken.shop = shop_of(*errand.job, *errand.folder);
  broken.setup = setup_of(broken.shop, *errand.machine);
  for (const fs::path& file : errand.folder->programs()) {
    const std::string other = file.filename().string();
    if (other < name) broken.done.push_back(read_whole(file));
    if (other == name) {
      broken.file = file;
      broken.text = read_whole(file);
    }
    if (other > name) broken.rest.push_back(whole(file, must_end_itself));
  }
  if (broken.file.empty()) throw InputError("no program " + name + " in " + errand.folder->file("program").string());
  return broken;
}

/// Writes a restart and its picture into DIR/stream, says where, and tries it on the simulated machine. An exit code if
/// that finds a fault.
std::optional<int> show_and_try(const Errand& errand, const BrokenProgram& broken, const Restart& restart,
                                const std::string& suffix, const RestartOptions& options, Progress& progress) {
  const MachineModel& machine = *errand.machine;
  say_restart(restart, progress);
  const std::string name = "stream/" + broken.file.stem().string() + suffix;
  const fs::path text = errand.folder->file(name + broken.file.extension().string());
  const fs::path picture = errand.folder->file(name + ".svg");
  write_whole(text, restart.text);
  write_whole(picture, restart_picture(restart,
                                       path_near(machine, broken.setup, broken.text, restart.place.tip_mm,
                                                 options.overlap_mm + kPictureReach_mm, options.dialect),
                                       "restart of " + broken.file.filename().string() + " at line " +
                                           std::to_string(restart.first_line)));
  progress.say("text          " + text.string());
  progress.say("picture       " + picture.string());

  StockOptions stock;
  stock.pitch_mm = std::max(broken.shop.pitch_um / 1000, kTrialPitch_mm);
  const RestartTrial trial = try_restart(machine, broken.setup, stock, broken.done, broken.text, restart,
                                         options.dialect, progress.stage("trial"));
  progress.done();
  if (!trial.faults.empty()) {
    std::fprintf(stderr, "lightmill: the trial of the restart found %zu fault(s), first: %s; nothing was sent\n",
                 trial.faults.size(), described(trial.faults.front()).c_str());
    return kExitDryRunFault;
  }
  progress.say("trial         no fault on the simulated machine, " + fixed(trial.seconds / 60, 1) + " minutes");
  return std::nullopt;
}

/// Of a drip feed, which acknowledges nothing.
void say_what_was_sent(const JournalSummary& journal, const BrokenProgram& broken, long from_line, Progress& progress) {
  const long sent = last_line_of(broken.text, journal.header, journal.sent);
  say_how_it_ended(journal, progress);
  progress.say("sent          " + (sent > 0 ? "at most to line " + std::to_string(sent) : std::string("no line")) +
               "; how much of it is cut only the control knows");
  if (from_line > sent + 1) {
    progress.say("warning       lines " + std::to_string(sent + 1) + " to " + std::to_string(from_line - 1) +
                 " were never sent and are left out as you asked (--from " + std::to_string(from_line) + ")");
  }
}

/// Controls that run files know themselves where they stopped: the operator reads the block there.
bool runs_files(const Job& job) {
  return job.controller.dialect != "grblhal";
}

int resume_file(ResumeChoices choices, const Errand& errand, Progress& progress) {
  const std::vector<fs::path> programs = errand.folder->programs();
  const std::optional<JournalSummary> journal = last_journal(errand.folder->root());
  const bool broke_off = journal && breaks_off(errand.folder->root(), *journal);
  if (choices.program.empty() && broke_off) choices.program = journal->header.program;
  if (choices.program.empty() && programs.size() == 1) choices.program = programs.front().filename().string();
  if (choices.program.empty()) throw InputError("name the program that broke off with --program");
  const std::string& name = choices.program;
  const BrokenProgram broken = broken_program(errand, name, false);
  if (broke_off && journal->header.program == name) say_what_was_sent(*journal, broken, choices.from_line, progress);
  if (choices.from_line == 0) {
    throw InputError(
        "a control that runs files knows where it stopped: read the block there and name its line of the text with --from");
  }
  std::string unproven;
  if (const auto code = settle_proof(lacks_proof(*errand.folder, *errand.job), choices.stream, unproven)) return *code;
  RestartOptions options;
  options.overlap_mm = choices.overlap_mm;
  options.program_name = name;
  options.dialect = errand.job->controller.dialect;
  const Restart restart = write_restart(*errand.machine, broken.setup, broken.text, choices.from_line, options);
  if (const auto code = show_and_try(errand, broken, restart, "_R", options, progress)) return *code;
  const bool is_fed = options.dialect != "linuxcnc";
  if (!is_fed || (choices.stream.port.empty() && errand.job->stream.port.empty())) {
    progress.say("nothing was sent; load the text at the control" +
                 (is_fed ? ", or send it with: lightmill resume " + choices.stream.what + " --program " + name + " --from " +
                               std::to_string(choices.from_line) + " --port PORT"
                         : ""));
    return kExitDone;
  }
  complete(choices.stream, *errand.job, *errand.folder);
  need_confirmation(restart, choices.yes);
  Errand sent = errand;
  sent.unproven = unproven;
  const Sending sending{name, program_digest(broken.text), restart.text, restart.entry_lines, restart.first_line, restart.uncut_line};
  return send_all({sending}, sent, choices.stream, progress);
}

}  // namespace

int stream(StreamChoices choices, Progress& progress) {
  Errand errand;
  std::error_code error;
  if (!fs::is_directory(choices.what, error)) {
    complete(choices);
    need_port(choices);
    const Sending sending = whole(choices.what, protocol_of(choices.protocol).acknowledges_lines());
    if (const auto code = settle_proof(lacks_proof(choices.what, choices.proof), choices, errand.unproven)) return *code;
    return send_all({sending}, errand, choices, progress);
  }
  const RunFolder folder(choices.what, false);
  const Job job = read_job(folder.file("job.toml"));
  complete(choices, job, folder);
  const std::vector<fs::path> programs = folder.programs();
  if (programs.empty())
    throw InputError("no program in " + folder.file("program").string() + "; make them with: lightmill post " +
                     choices.what);
  errand.folder = &folder;
  errand.job = &job;
  errand.machine = read_machine(job.machine.file);
  if (const auto code = settle_proof(lacks_proof(folder, job), choices, errand.unproven)) return *code;
  need_port(choices);
  if (has_broken_stream(folder.root()))
    progress.say("an earlier stream broke off; this one begins anew (lightmill resume would go on)");
  std::vector<Sending> sendings;
  const bool must_end = protocol_of(choices.protocol).acknowledges_lines();
  for (const fs::path& program : programs) sendings.push_back(whole(program, must_end));
  return send_all(sendings, errand, choices, progress);
}

bool can_resume(const ResumeChoices& choices) {
  const fs::path folder = choices.stream.what;
  return has_broken_stream(folder) || (choices.from_line > 0 && runs_files(read_job(folder / "job.toml")));
}

bool has_broken_stream(const fs::path& folder) {
  const std::optional<JournalSummary> journal = last_journal(folder);
  return journal && breaks_off(folder, *journal);
}

int resume_stream(ResumeChoices choices, Progress& progress) {
  const RunFolder folder(choices.stream.what, false);
  const Job job = read_job(folder.file("job.toml"));
  Errand errand;
  errand.folder = &folder;
  errand.job = &job;
  errand.machine = read_machine(job.machine.file);
  if (runs_files(job)) return resume_file(choices, errand, progress);
  complete(choices.stream, job, folder);
  if (const auto code = settle_proof(lacks_proof(folder, job), choices.stream, errand.unproven)) return *code;
  const std::optional<JournalSummary> found = last_journal(folder.root());
  if (!found)
    throw InputError("no journal in " + folder.file("stream").string() + "; begin with: lightmill stream " +
                     choices.stream.what);
  const JournalSummary& journal = *found;
  if (journal.header.machine_digest != sha256_of_file(job.machine.file)) {
    throw InputError(job.machine.file.string() +
                     " is not the machine file of the stream that broke off; put that one back");
  }
  BrokenProgram broken = broken_program(errand, journal.header.program, true);
  const MachineModel& machine = *errand.machine;
  const StreamPlace place = find_place(machine, broken.setup, broken.text, journal);
  say_what_is_known(journal, place, machine, progress);
  Restart restart;
  if (place.uncut_line == 0 && choices.from_line == 0) {
    progress.say("restart       " + journal.header.program + " is cut; " + broken.rest.front().program +
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
    options.stands = place.reported;
    restart = write_restart(machine, broken.setup, broken.text, line, options);
    if (const auto code = show_and_try(errand, broken, restart, "_resume", options, progress)) return *code;
    broken.rest.insert(broken.rest.begin(), {journal.header.program, journal.header.program_digest, restart.text,
                                             restart.entry_lines, restart.first_line, restart.uncut_line});
  }
  if (choices.stream.port.empty()) {
    progress.say("nothing was sent; stream it with: lightmill resume " + choices.stream.what + " --port PORT");
    return kExitDone;
  }
  need_confirmation(restart, choices.yes);
  return send_all(broken.rest, errand, choices.stream, progress);
}

}  // namespace lightmill
