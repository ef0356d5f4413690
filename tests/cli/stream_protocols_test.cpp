#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <termios.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <thread>

#include "command_rig.h"
#include "machine/program_lines.h"

namespace lightmill::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;

/// A program through two processes and a pseudo-terminal; what the machine says of it.
json streamed(const ScratchFolder& scratch, const std::string& protocol, const std::string& machine_file,
              const fs::path& program, const std::vector<std::string>& more = {}) {
  const std::string port = (scratch / "port").string();
  const pid_t machine = start_lightmill(
      {"machine", "--pty", port, "--machine", fixture("machines/" + machine_file).string(), "--protocol", protocol,
       "--blank", "12x10x5", "--pitch-um", "200", "--out", (scratch / "milled").string()},
      scratch / "log");
  for (int tries = 0; tries < 3000 && !fs::exists(port); ++tries) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  std::vector<std::string> arguments{"stream", program.string(), "--port", port, "--protocol", protocol, "--unproven"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  const CommandResult sent = typed_command(arguments, "unproven\n");
  EXPECT_EQ(sent.code, 0) << sent.out;
  // The last bytes are still being read.
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  kill(machine, SIGTERM);
  EXPECT_EQ(wait_for(machine), 0) << slurp(scratch / "log");
  return json::parse(slurp(scratch / "milled/result.json"));
}

TEST(StreamProtocols, BlockwiseOntoAHeidenhainsDisk) {
  const ScratchFolder scratch;
  const std::string program =
      "0 BEGIN PGM PART MM\n1 TOOL CALL 1 Z S12000\n2 L Z-1 R0 FMAX M91\n3 L X+10 Y+5 R0 FMAX M3\n"
      "4 L X+20 R0 F500\n5 L Z-1 R0 FMAX M91 M5\n6 L M30\n7 END PGM PART MM\n";
  spill(scratch / "part.h", program);
  const json result = streamed(scratch, "fe", "mikron_hsm400u_itnc530.toml", scratch / "part.h");
  EXPECT_EQ(slurp(scratch / "milled/received.nc"), program);
  EXPECT_EQ(result["faults"].size(), 0U) << result["faults"].dump(1);
  EXPECT_GT(result["lines"], 0);
}

TEST(StreamProtocols, DripFeedToAFanuc) {
  const ScratchFolder scratch;
  const std::string program =
      "%\nO1000\nG21 G90 G94 G54\nT1 M6\nS12000 M3\nG4 P9000\nG53 G0 Z0.\nG0 X-12. Y0.\nG1 X12. F500.\nG53 G0 Z0.\nM5\nM30\n%\n";
  spill(scratch / "part.nc", program);
  const json result = streamed(scratch, "drip", "vmc_ac_fanuc.toml", scratch / "part.nc");
  EXPECT_EQ(slurp(scratch / "milled/received.nc"), program);
  EXPECT_EQ(result["faults"].size(), 0U) << result["faults"].dump(1);
}

TEST(StreamProtocols, OneLineAtATimeToAGrbl) {
  const ScratchFolder scratch;
  std::string program = "G21 G90 G94\nG53 G0 Z0\nG0 X-12 Y0\n";
  for (int i = 0; i < 100; ++i) program += "G1 X" + std::to_string(i % 7) + ".25 Y0." + std::to_string(i + 1) + " F3000\n";
  program += "G53 G0 Z0\nM5\nM2\n";
  spill(scratch / "part.nc", program);
  const json result = streamed(scratch, "grbl", "hsm400u_grblhal.toml", scratch / "part.nc", {"--one-at-a-time"});
  EXPECT_EQ(result["received_digest"], program_digest(program));
}

/// What came out of a port, byte for byte, while `action` was done with it.
std::string bytes_of_port(const std::function<void(const std::string& port)>& action) {
  int near = -1, far = -1;
  std::array<char, 256> name{};
  termios raw{};
  cfmakeraw(&raw);
  if (openpty(&near, &far, name.data(), &raw, nullptr) != 0) throw std::runtime_error("no pseudo-terminal");
  std::string bytes;
  std::atomic<bool> done = false;
  std::thread reader([&] {
    std::array<char, 4096> buffer;
    for (;;) {
      const bool last = done;
      pollfd poll_near{near, POLLIN, 0};
      const bool there = poll(&poll_near, 1, 20) > 0;
      if (there) bytes.append(buffer.data(), static_cast<std::size_t>(std::max<ssize_t>(0, read(near, buffer.data(), buffer.size()))));
      if (last && !there) return;
    }
  });
  action(name.data());
  done = true;
  reader.join();
  close(far);
  close(near);
  return bytes;
}

// Heidenhain's text mode: no tape marks, CR LF, and ETX EOT behind the last line, once.
TEST(StreamProtocols, DripFeedToAHeidenhainEndsWithEtxEot) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  const fs::path job = tiny_job_on(scratch, "mikron_hsm400u_itnc530.toml", "heidenhain");
  const CommandResult made = lightmill_command({"make", job.string(), "-o", run.string(), "-q"});
  ASSERT_EQ(made.code, 0) << made.err;
  for (const char* name : {"20_SEMI_FINISH.H", "30_FINISH.H"}) fs::remove(run / "program" / name);
  const std::string bytes = bytes_of_port([&](const std::string& port) {
    const CommandResult sent = typed_command(
        {"stream", run.string(), "--port", port, "--protocol", "drip", "--unproven", "--confirm-all"}, "unproven\n");
    EXPECT_EQ(sent.code, 0) << sent.out;
  });
  std::string expected;
  const std::string program = slurp(run / "program/10_ROUGH.H");
  for (const ProgramLine& line : program_lines(program)) expected += std::string(line.text) + "\r\n";
  EXPECT_TRUE(bytes == expected + "\x03\x04") << bytes.size() << " bytes of " << expected.size() + 2;

  // As if the sender had died at its end: what it has sent is in the journal, what is cut the operator reads at the control.
  const fs::path journal = run / "stream/000001_10_ROUGH.journal";
  const std::string records = slurp(journal);
  spill(journal, records.substr(0, records.size() - 5));
  const CommandResult asked = lightmill_command({"resume", run.string(), "--unproven"});
  EXPECT_EQ(asked.code, 2);
  const long lines = std::count(program.begin(), program.end(), '\n');
  EXPECT_THAT(asked.out, HasSubstr("the sender died"));
  EXPECT_THAT(asked.out, HasSubstr("at most to line " + std::to_string(lines) + "; how much of it is cut only the control knows"));
  EXPECT_THAT(asked.err, HasSubstr("name its line of the text with --from"));
}

TEST(StreamProtocols, WrongOnesAreTheUsersMistake) {
  const ScratchFolder scratch;
  spill(scratch / "part.nc", "G21\nM2\n");
  const std::string part = (scratch / "part.nc").string();
  EXPECT_EQ(lightmill_command({"stream", part, "--port", "/dev/ttyNotThere", "--protocol", "lsv2"}).code, 2);
  EXPECT_EQ(lightmill_command({"stream", part, "--port", "/dev/ttyNotThere", "--format", "9N1"}).code, 2);
  EXPECT_EQ(typed_command({"stream", part, "--port", "tcp://nowhere", "--unproven"}, "unproven\n").code, 2);
  EXPECT_EQ(typed_command({"stream", part, "--port", "tcp://127.0.0.1:1", "--unproven"}, "unproven\n").code, 3);
  EXPECT_EQ(typed_command({"stream", part, "--port", "tcp://127.0.0.1:1", "--unproven"}, "yes\n").code, 2);
  EXPECT_EQ(lightmill_command({"stream", part, "--port", "tcp://127.0.0.1:1", "--unproven"}).code, 2) << "nobody types it";
  const CommandResult fault = lightmill_command({"machine", "--pty", (scratch / "p").string(), "--blank", "12x10x5", "--out",
                                                 (scratch / "o").string(), "--line-fault", "melt@3"});
  EXPECT_EQ(fault.code, 2);
  EXPECT_THAT(fault.err, testing::AllOf(HasSubstr("flip@120"), HasSubstr("reset")));
}

}  // namespace
}  // namespace lightmill::test
