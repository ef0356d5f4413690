#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <filesystem>
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
  EXPECT_THAT(fault.err, HasSubstr("flip@120"));
}

}  // namespace
}  // namespace lightmill::test
