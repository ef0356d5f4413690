#include "cli/simulation.h"

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "cli/child_process.h"
#include "cli/commands.h"
#include "cli/errors_file.h"
#include "cli/fault_files.h"
#include "cli/line_times.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/connection.h"
#include "machine/fault_words.h"
#include "machine/lockstep.h"
#include "machine/program_lines.h"
#include "machine/program_run.h"
#include "machine/pseudo_terminal.h"
#include "machine/simulated_machine.h"
#include "postproc/kinematics.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

std::string numbers(const Vec3& v) { return compact(v.x(), 9) + "," + compact(v.y(), 9) + "," + compact(v.z(), 9); }

/// The last line of what the child said before it died.
std::string last_words(const fs::path& log) {
  std::error_code error;
  if (!fs::exists(log, error)) return "";
  std::string text = read_whole(log);
  while (!text.empty() && text.back() == '\n') text.pop_back();
  const std::size_t start = text.rfind('\n');
  const std::string line = start == std::string::npos ? text : text.substr(start + 1);
  constexpr std::string_view kName = "lightmill: ";
  return line.starts_with(kName) ? line.substr(kName.size()) : line;
}

/// Removes the link to the pseudo-terminal when the child could not do it itself.
struct LinkGuard {
  fs::path link;
  ~LinkGuard() {
    std::error_code error;
    fs::remove(link, error);
  }
};

/// The table's top where it carries the work, as a box around its disk; below the workpiece's back.
std::optional<KeepOut> table_of(const MachineModel& machine, const SimulatedShop& shop) {
  if (machine.chain == Chain::kHeadHead || !(machine.table_radius_mm > 0)) return std::nullopt;
  const Vec3 centre = machine.table_centre_mm - shop.workpiece_origin_mm;
  const Vec3 half(machine.table_radius_mm, machine.table_radius_mm, 0);
  return KeepOut{centre - half - Vec3(0, 0, 1000), centre + half};
}

StockOptions stock_options(const SimulatedShop& shop, const MachineModel& machine) {
  StockOptions options;
  options.pitch_mm = shop.pitch_um / 1000;
  options.solid_pitch_mm = shop.solid_pitch_um / 1000;
  options.table = table_of(machine, shop);
  return options;
}

constexpr const char* kLineTimes = "line_times.csv";

/// Nothing of an earlier run may be taken for this one's.
void remove_stale(const fs::path& out) {
  std::error_code error;
  for (const char* stale : {"port", "machine.log", "machined.tif", "machined_peaks.tif", "machined_peak_offsets.tif", "solid.bin", "result.json", "errors.toml", kLineTimes}) fs::remove(out / stale, error);
}

}  // namespace

SimulatedShop shop_of(const Job& job, const RunFolder& folder, const ShopOverrides& overrides) {
  const json cam = folder.report().value("cam", json::object());
  if (!cam.contains("blank")) throw InputError("the tool paths of " + folder.root().string() + " are not there; run lightmill cam");
  SimulatedShop shop;
  shop.machine_file = overrides.machine_file.value_or(job.machine.file);
  shop.cutter_files = overrides.cutter_files.empty()
                          ? std::vector{job.rough.cutter_file, job.semi_finish.cutter_file, job.finish.cutter_file}
                          : overrides.cutter_files;
  if (job.rest && overrides.cutter_files.empty()) shop.cutter_files.push_back(job.rest->cutter_file);
  shop.material = material_name(job.stock.material);
  shop.blank.size_mm = Vec2(cam["blank"]["size_mm"][0].get<double>(), cam["blank"]["size_mm"][1].get<double>());
  shop.blank.height_mm = cam["blank"]["height_mm"];
  shop.blank.keep_outs = keep_outs_of(job);
  shop.work_offset = overrides.work_offset.value_or(job.machine.work_offset);
  shop.workpiece_origin_mm = work_on_table(read_machine(job.machine.file), overrides.workpiece_origin_mm.value_or(job.machine.workpiece_origin_mm),
                                           shop.work_offset).origin_mm;
  shop.errors = job.dry_run.errors;
  shop.pitch_um = job.dry_run.pitch_um;
  shop.solid_pitch_um = solid_pitch_um(job);
  shop.starvation_mark_um = job.dry_run.starvation_mark_um;
  shop.time_factor = job.dry_run.time_factor;
  shop.baud = overrides.pace_baud.value_or(pace_baud(job));
  shop.one_at_a_time = job.stream.one_at_a_time;
  shop.line_times = overrides.line_times ? "on" : job.dry_run.line_times;
  return shop;
}

OperatorSetup setup_of(const SimulatedShop& shop, const MachineModel& machine) {
  OperatorSetup setup;
  for (const auto& file : shop.cutter_files) setup.cutters.push_back(as_it_turns(read_cutter(file, shop.material), shop.errors));
  if (machine.spindle_nose_radius_mm > 0) {
    for (Cutter& cutter : setup.cutters) {
      cutter.holder.push_back({cutter.length_mm, cutter.length_mm + machine.spindle_nose_length_mm, machine.spindle_nose_radius_mm,
                               machine.spindle_nose_radius_mm});
    }
  }
  setup.errors = shop.errors;
  setup.blank = shop.blank;
  setup.workpiece_origin_mm = shop.workpiece_origin_mm;
  setup.work_offset = shop.work_offset;
  return setup;
}

std::string stream_end_name(StreamEnd end) {
  switch (end) {
    case StreamEnd::kDone: return "done";
    case StreamEnd::kControllerError: return "controller error";
    case StreamEnd::kAlarm: return "alarm";
    case StreamEnd::kLostAcknowledgement: return "lost acknowledgement";
    case StreamEnd::kReset: return "controller reset";
    case StreamEnd::kHungUp: return "line hung up";
    case StreamEnd::kStopped: return "stopped by the user";
    case StreamEnd::kAborted: return "given up by the user";
    case StreamEnd::kJournal: return "journal not written";
    case StreamEnd::kWrongPlace: return "wrong place";
  }
  return "";
}

std::vector<std::string> machine_arguments(const SimulatedShop& shop, const fs::path& link, const fs::path& out) {
  std::vector<std::string> arguments = {"machine", "--pty", link.string(), "--machine", shop.machine_file.string()};
  for (const auto& file : shop.cutter_files) {
    arguments.emplace_back("--cutters");
    arguments.push_back(file.string());
  }
  if (!shop.material.empty()) arguments.push_back("--material=" + shop.material);
  for (const KeepOut& box : shop.blank.keep_outs) arguments.push_back("--keep-out=" + numbers(box.min_mm) + "," + numbers(box.max_mm));
  const std::vector<std::string> rest = {
      "--blank=" + compact(shop.blank.size_mm.x(), 6) + "x" + compact(shop.blank.size_mm.y(), 6) + "x" + compact(shop.blank.height_mm, 6),
      "--origin=" + numbers(shop.workpiece_origin_mm),
      "--work-offset=" + std::to_string(shop.work_offset),
      "--pitch-um=" + compact(shop.pitch_um, 6),
      "--solid-pitch-um=" + compact(shop.solid_pitch_um, 6),
      "--starvation-mark-um=" + compact(shop.starvation_mark_um, 6),
      "--time-factor=" + compact(shop.time_factor, 6),
      "--pace-baud=" + std::to_string(shop.baud),
      "--out=" + out.string()};
  arguments.insert(arguments.end(), rest.begin(), rest.end());
  return arguments;
}

namespace {

/// The simulated machine under power, and what its planner makes of the motions' times.
struct TimedMachine {
  SimulatedMachine simulated;
  MotionTimer timer;

  TimedMachine(const SimulatedShop& shop, const MachineModel& machine, const SimulationOptions& options)
      : simulated(machine, setup_of(shop, machine), options), timer(machine) {
    simulated.on_motion = [this](const Motion& motion, const std::vector<SweptMove>& pieces) {
      timer.move(motion, pieces.front(), pieces.back());
    };
    simulated.start();
  }
  TimedMachine(const TimedMachine&) = delete;
  TimedMachine& operator=(const TimedMachine&) = delete;

  /// OUT/machined.tif, OUT/solid.bin if there is a solid, and OUT/result.json.
  void write(const fs::path& out) {
    const SimulationResult result = simulated.result();
    const MachinedSurface surface = simulated.machined();
    write_machined(out / "machined.tif", surface);
    if (const auto solid = simulated.solid()) solid->write(out / "solid.bin");
    json record = {{"lines", result.lines},
                   {"timing", json::array()},
                   {"received_bytes", result.received_bytes},
                   {"overflowed_bytes", result.overflowed_bytes},
                   {"highest_buffer_fill", result.highest_buffer_fill},
                   {"received_digest", result.received_digest},
                   {"removed_mm3", surface.removed_mm3},
                   {"starvations", result.starvations},
                   {"starved_seconds", result.starved_seconds},
                   {"worst_starvations", json::array()},
                   {"faults", json::array()}};
    for (const Starvation& mark : result.worst_starvations) {
      record["worst_starvations"].push_back({{"line", mark.line},
                                             {"place_mm", {mark.place_mm.x(), mark.place_mm.y(), mark.place_mm.z()}},
                                             {"seconds", mark.seconds}});
    }
    for (const Fault& fault : result.faults) record["faults"].push_back(to_json(fault));
    timer.finish();
    for (const SectionTiming& section : timer.sections()) record["timing"].push_back(to_json(section));
    write_whole(out / "result.json", record.dump(1) + "\n");
  }
};

bool wants_line_times(const SimulatedShop& shop, std::size_t lines) {
  return shop.line_times == "on" || (shop.line_times == "auto" && lines <= kMostTimedLines);
}

SimulationOptions simulation_options(const SimulatedShop& shop, const MachineModel& machine) {
  SimulationOptions options;
  options.personality = personality(shop.protocol);
  options.time_factor = shop.time_factor;
  options.stock = stock_options(shop, machine);
  options.starvation_mark_mm = shop.starvation_mark_um / 1000;
  return options;
}

/// With the faults that are planted on it; those of the control go to `planted`.
LineOptions line_options(const SimulatedShop& shop, PlantedFaults& planted) {
  LineOptions line;
  line.baud = shop.baud;
  for (const std::string& fault : shop.line_faults) plant_fault(fault, shop.fault_seed, line, planted);
  return line;
}

}  // namespace

void serve_machine(const SimulatedShop& shop, const fs::path& link, const fs::path& out, const std::function<bool()>& should_end) {
  const MachineModel machine = read_machine(shop.machine_file);
  SimulationOptions options = simulation_options(shop, machine);
  LineOptions line = line_options(shop, options.planted);
  // Controls that take a program as a text mill it afterwards, by the reader of the machine's dialect.
  const bool takes_text =
      options.personality == Personality::kBlockwise || options.personality == Personality::kDripFeed;
  if (takes_text) {
    reader_dialect(machine.controller);  // says now what cannot be read
    options.remove_stock = false;
    line.even_parity = true;
  }
  TimedMachine served(shop, machine, options);
  {
    PseudoTerminal terminal(link);
    serve(served.simulated, terminal, line, should_end);
  }
  if (!takes_text) {
    served.write(out);
    return;
  }
  const SimulationResult result = served.simulated.result();
  const fs::path received = out / "received.nc";
  write_whole(received, result.received_program);
  if (result.received_program.empty()) throw InputError("no program was received");
  run_program_files(shop, machine.controller, {received}, out, {});
  json record = json::parse(read_whole(out / "result.json"));
  for (const Fault& fault : result.faults) record["faults"].push_back(to_json(fault));
  record["received_digest"] = result.received_digest;
  write_whole(out / "result.json", record.dump(1) + "\n");
}

namespace {

/// What the streamer sends.
struct Programs {
  const std::vector<fs::path>& files;
  std::vector<std::string> texts;
  std::size_t bytes = 0, lines = 0;

  explicit Programs(const std::vector<fs::path>& programs) : files(programs) {
    for (const auto& program : files) {
      texts.push_back(read_whole(program));
      const std::size_t count = program_lines(texts.back()).size();
      if (count == 0) throw InputError(program.string() + " is empty; name a program");
      lines += count;
      bytes += texts.back().size();
    }
  }
  [[nodiscard]] SentLines sent() const {
    SentLines sent;
    for (std::size_t i = 0; i < files.size(); ++i) sent.add(files[i].filename().string(), texts[i]);
    return sent;
  }
};

/// One after the other, until one does not end well.
void stream_programs(Connection& connection, const Programs& programs, StreamOptions options, SimulationOutcome& outcome,
                     const Monitor& monitor) {
  options.on_operator = [](const std::string&) { return true; };  // the right tool is always at hand here
  const auto started = std::chrono::steady_clock::now();
  double done_share = 0;
  for (std::size_t i = 0; i < programs.files.size(); ++i) {
    const double share = static_cast<double>(programs.texts[i].size()) / static_cast<double>(programs.bytes);
    // One reset at the start only: so the machine counts its lines through all programs, and a fault finds its place.
    if (i > 0) options.greeting = Greeting::kNone;
    outcome.streams.push_back(stream_program(connection, programs.texts[i], options, monitor.part(done_share, done_share + share)));
    done_share += share;
    outcome.stream_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
    const StreamResult& stream = outcome.streams.back();
    if (stream.end == StreamEnd::kStopped) {
      monitor.check();
      throw IoError("the dry run stopped: " + stream.message);
    }
    if (stream.done()) continue;
    Fault fault;
    fault.kind = "stream";
    fault.program = programs.files[i].filename().string();
    fault.line = stream.error_line;
    fault.message = stream_end_name(stream.end) + ": " + stream.message;
    outcome.faults.push_back(fault);
    return;
  }
}

/// The machine in another process, reached as a serial port is.
void stream_to_child(const SimulatedShop& shop, const Programs& programs, const fs::path& out, SimulationOutcome& outcome,
                     const Monitor& monitor) {
  const fs::path link = out / "port";
  const fs::path log = out / "machine.log";
  std::vector<std::string> arguments = machine_arguments(shop, link, out);
  if (const std::string errors = machine_errors_text(shop.errors, ""); errors != machine_errors_text({}, "")) {
    write_whole(out / "errors.toml", errors);
    arguments.push_back("--errors=" + (out / "errors.toml").string());
  }
  arguments.insert(arguments.begin(), fs::read_symlink("/proc/self/exe").string());
  const LinkGuard guard{link};
  ChildProcess child(arguments, log);
  std::error_code error;
  for (int tries = 0; !fs::exists(link, error); ++tries) {
    monitor.check();
    if (const auto code = child.wait(std::chrono::milliseconds(10))) {
      if (*code == kExitBadInput) throw InputError(last_words(log));
      throw IoError("the simulated machine did not start (exit code " + std::to_string(*code) + "): " + last_words(log));
    }
    if (tries > 3000) throw IoError("the simulated machine did not start within 30 s; see " + log.string());
  }
  {
    const auto connection = open_serial(link.string(), StreamSpec{}.baud);
    StreamOptions options;
    options.most_queued_bytes = 1 << 16;  // nobody presses hold here
    options.one_at_a_time = shop.one_at_a_time;
    stream_programs(*connection, programs, options, outcome, monitor);
  }
  // The operator ends the machine; it writes what it has become of the blank.
  child.terminate();
  std::optional<int> code;
  while (!(code = child.wait(std::chrono::milliseconds(200)))) monitor.check();
  if (*code != 0) {
    throw IoError("the simulated machine ended with exit code " + std::to_string(*code) + ": " + last_words(log));
  }
}

/// Sender and machine in this process on one virtual clock: motions and bytes take their true time on it, the result does not
/// depend on this computer's.
void stream_in_lockstep(const SimulatedShop& shop, const Programs& programs, const fs::path& out, SimulationOutcome& outcome,
                        const Monitor& monitor) {
  const MachineModel machine = read_machine(shop.machine_file);
  VirtualClock clock;
  SimulationOptions options = simulation_options(shop, machine);
  options.clock = &clock;
  options.time_factor = 1;
  const LineOptions line = line_options(shop, options.planted);
  TimedMachine timed(shop, machine, options);
  LineTimes times([sent = programs.sent()](const TimedBlock& block) {
    const auto place = sent.find(block.motion.line);
    return place ? TextLine{place->program, place->line} : TextLine{};
  });
  const bool writes_times = wants_line_times(shop, programs.lines);
  if (writes_times) timed.timer.on_block = [&times](const TimedBlock& block) { times.add(block); };
  LockstepLink link(timed.simulated, clock, line);
  Monitor paced = monitor;
  if (shop.time_factor > 0) {
    const auto start = std::chrono::steady_clock::now();
    paced.should_stop = [&monitor, &clock, start, factor = shop.time_factor] {
      std::this_thread::sleep_until(start + std::chrono::duration_cast<std::chrono::nanoseconds>(clock.now() / factor));
      return monitor.should_stop && monitor.should_stop();
    };
  }
  StreamOptions sender;
  sender.one_at_a_time = shop.one_at_a_time;
  stream_programs(link, programs, sender, outcome, paced);
  timed.write(out);
  if (writes_times) write_whole(out / kLineTimes, times.table());
}

/// What the machine has left in OUT/result.json, its lines as those of the programs' texts.
void read_result(const fs::path& out, const Programs& programs, SimulationOutcome& outcome) {
  json result = json::parse(read_whole(out / "result.json"));
  outcome.lines = result.at("lines");
  outcome.bytes_received = result.at("received_bytes");
  outcome.bytes_lost = result.at("overflowed_bytes");
  outcome.highest_buffer_fill = result.at("highest_buffer_fill");
  outcome.removed_mm3 = result.at("removed_mm3");
  outcome.starvations = result.at("starvations");
  outcome.starved_seconds = result.at("starved_seconds");
  // The machine counts lines through all programs; everybody else names a program and a line of its text.
  const SentLines sent = programs.sent();
  for (json& record : result.at("faults")) {
    Fault fault = fault_from(record);
    locate(fault, sent);
    record = to_json(fault);
    outcome.faults.push_back(fault);
  }
  for (json& mark : result.at("worst_starvations")) {
    if (const auto place = sent.find(mark.at("line"))) mark.update({{"program", place->program}, {"line", place->line}});
  }
  write_whole(out / "result.json", result.dump(1) + "\n");
  for (const auto& record : result.at("timing")) {
    ProgramSection found{"", section_from(record)};
    for (long* line : {&found.section.timing.slow_line, &found.section.line}) {
      const auto place = sent.find(*line);
      if (!place) continue;
      *line = place->line;
      found.program = place->program;
    }
    outcome.timing.push_back(found);
  }

  // The machine must have executed the very lines of the programs, each once and in order.
  std::string all;
  for (const auto& text : programs.texts) all += text + "\n";
  outcome.digest_matches = result.at("received_digest") == program_digest(all);
  const bool all_done = outcome.streams.size() == programs.files.size() && outcome.streams.back().done();
  if (all_done && !outcome.digest_matches) {
    Fault fault;
    fault.kind = "digest";
    fault.message = "the machine did not execute the programs' lines: its digest is " + result.at("received_digest").get<std::string>() +
                    ", the programs' is " + program_digest(all) + "; check the line and stream again";
    outcome.faults.push_back(fault);
  }
}

}  // namespace

SimulationOutcome simulate_programs(const SimulatedShop& shop, const std::vector<fs::path>& files, const fs::path& out,
                                    const Monitor& monitor) {
  const Programs programs(files);
  if (shop.line_times == "on" && !shop.in_lockstep()) {
    throw InputError("the lines' times are told by a paced line only; leave out --pace-baud 0 (pace_baud = 0 in the job), or the table (line_times)");
  }
  std::error_code error;
  fs::create_directories(out, error);
  if (error) throw IoError("cannot create folder " + out.string() + ": " + error.message());
  remove_stale(out);

  SimulationOutcome outcome;
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (ends_itself(programs.texts[i])) continue;
    Fault fault;
    fault.kind = "no_program_end";
    fault.program = files[i].filename().string();
    fault.line = program_lines(programs.texts[i]).back().number;
    fault.message =
        "the last line is no M2 or M30: the file is cut short, or its end is missing; write or copy it again";
    outcome.faults.push_back(fault);
  }
  (shop.in_lockstep() ? stream_in_lockstep : stream_to_child)(shop, programs, out, outcome, monitor);
  read_result(out, programs, outcome);
  return outcome;
}

SimulationOutcome run_program_files(const SimulatedShop& shop, const std::string& dialect, const std::vector<fs::path>& programs,
                                    const fs::path& out, const Monitor& monitor) {
  std::error_code error;
  fs::create_directories(out, error);
  if (error) throw IoError("cannot create folder " + out.string() + ": " + error.message());
  remove_stale(out);
  const MachineModel machine = read_machine(shop.machine_file);
  const OperatorSetup setup = setup_of(shop, machine);
  std::vector<ProgramFile> files;
  SimulationOutcome outcome;
  std::size_t lines = 0;
  for (const auto& program : programs) {
    files.push_back({program.filename().string(), read_whole(program)});
    const std::string& text = files.back().text;
    outcome.bytes_received += static_cast<long>(text.size());
    lines += static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
  }
  LineTimes times([&files](const TimedBlock& block) {
    return TextLine{files[static_cast<std::size_t>(block.program - 1)].name, block.motion.line};
  });
  const bool writes_times = wants_line_times(shop, lines);
  std::function<void(const TimedBlock&)> on_block;
  if (writes_times) on_block = [&times](const TimedBlock& block) { times.add(block); };
  ProgramRun run = run_programs(machine, reader_dialect(dialect), setup, files, stock_options(shop, machine), monitor, {}, on_block);
  if (writes_times) write_whole(out / kLineTimes, times.table());
  write_machined(out / "machined.tif", run.surface);
  if (run.solid) run.solid->write(out / "solid.bin");
  outcome.faults = std::move(run.faults);
  outcome.lines = run.blocks;
  for (const SectionTiming& section : run.timing) {
    outcome.timing.push_back({files[static_cast<std::size_t>(std::max(section.program, 1) - 1)].name, section});
  }
  outcome.removed_mm3 = run.surface.removed_mm3;
  outcome.digest_matches = true;  // the very files
  json record = {{"lines", run.blocks}, {"removed_mm3", run.surface.removed_mm3}, {"timing", json::array()}, {"faults", json::array()}};
  for (const SectionTiming& section : run.timing) record["timing"].push_back(to_json(section));
  for (const Fault& fault : outcome.faults) record["faults"].push_back(to_json(fault));
  write_whole(out / "result.json", record.dump(1) + "\n");
  return outcome;
}

}  // namespace lightmill
