// What the sender makes of states and answers recorded from grbl and grblHAL that the simulated machine does not give.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "design/core/errors.h"
#include "machine/streamer.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::AllOf;
using testing::HasSubstr;

constexpr char kSoftReset = 0x18, kJogCancel = '\x85';

/// Plays a grblHAL of the recorded answers: the test says in which state it is at each moment. Lines wait while it is
/// held; time passes while the sender waits.
class RecordedController final : public Connection {
 public:
  VirtualClock time;
  std::function<std::string()> state = [] { return "Idle"; };
  std::string answer = "ok";        ///< to every line of a program
  std::vector<std::string> lines;   ///< of programs
  std::string real_time;            ///< bytes that act at once, without ?
  std::vector<std::string> resets;  ///< the state at each

  std::size_t write_some(std::span<const char> bytes, milliseconds) override {
    for (const char byte : bytes) take(byte);
    return bytes.size();
  }
  std::size_t read_some(std::span<char> buffer, milliseconds deadline) override {
    if (!held()) replies_ += std::exchange(waiting_, "");
    if (replies_.empty()) time.advance_to(time.now() + deadline);
    const std::size_t count = replies_.copy(buffer.data(), buffer.size());
    replies_.erase(0, count);
    return count;
  }
  bool wait(bool, milliseconds) override { return true; }
  [[nodiscard]] std::string name() const override { return "recorded"; }
  [[nodiscard]] const Clock& clock() const override { return time; }

 private:
  std::string line_, replies_, waiting_;

  [[nodiscard]] bool held() const { return state().starts_with("Hold") || state().starts_with("Door"); }

  void take(char byte) {
    if (byte == '?') {
      replies_ += "<" + state() + "|MPos:0.000,0.000,0.000,0.000,0.000,0.000|Bf:" + (state() == "Idle" ? "100" : "99") +
                  ",1023|FS:0,0|WCO:0.000,0.000,0.000,0.000,0.000,0.000>\r\n";
    } else if (byte == '\n') {
      take_line(std::exchange(line_, ""));
    } else if (byte == '!' || byte == '~' || byte == kSoftReset || byte == kJogCancel) {
      real_time += byte;
      if (byte != kSoftReset) return;
      resets.push_back(state());
      waiting_.clear();
      replies_ += "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n";
    } else {
      line_ += byte;
    }
  }
  void take_line(const std::string& line) {
    if (line == "$I") replies_ += "[OPT:VNML+,100,1024,6,0]\r\n";
    if (line.empty() || line.front() == '$') {
      replies_ += "ok\r\n";
    } else {
      lines.push_back(line);
      waiting_ += answer + "\r\n";
    }
  }
};

const std::string kProgram = "G21 G90\nG1 X1 F600\nX2\nX3\n";
const std::vector<std::string> kLines{"G21 G90", "G1 X1 F600", "X2", "X3"};

TEST(RecordedStates, AreRead) {
  StatusReport report;
  for (const auto& [text, state, substate] : std::vector<std::tuple<std::string, std::string, int>>{
           {"<Idle|MPos:0.000,0.000,0.000|FS:0,0|Pn:PXYZRHS|WCO:0.000,0.000,0.000>", "Idle", -1},
           {"<Run|MPos:13.476,0,0,0,0,0|Bf:99,1023|FS:1000,0|Ov:100,100,100|A:|TLR:0>", "Run", -1},
           {"<Jog|MPos:1.000,0.000,0.000|FS:500,0>", "Jog", -1},
           {"<Hold:1|MPos:1.000,0.000,0.000|FS:300,0>", "Hold", 1},
           {"<Hold:0|MPos:1.000,0.000,0.000|FS:0,0>", "Hold", 0},
           {"<Door:0|MPos:1.000,0.000,0.000|FS:0,0>", "Door", 0},
           {"<Door:1|MPos:1.000,0.000,0.000|FS:0,0>", "Door", 1},
           {"<Door:2|MPos:1.000,0.000,0.000|FS:0,0>", "Door", 2},
           {"<Door:3|MPos:1.000,0.000,0.000|FS:0,0>", "Door", 3},
           {"<Door:4|MPos:1.000,0.000,0.000|FS:0,0>", "Door", 4},
           {"<Tool|MPos:1.000,0.000,0.000|FS:0,0>", "Tool", -1}}) {
    ASSERT_TRUE(parse_status(text, report)) << text;
    EXPECT_EQ(report.state, state);
    EXPECT_EQ(report.substate, substate) << text;
  }
}

// A reset while it moves would cost it its place.
TEST(RecordedController, IsNotResetWhileItMoves) {
  for (const std::string state : {"Run", "Jog", "Hold:1", "Door:0", "Door:4"}) {
    RecordedController controller;
    controller.state = [&] { return state; };
    try {
      stream_program(controller, kProgram);
      FAIL() << state;
    } catch (const IoError& error) {
      EXPECT_THAT(error.what(), AllOf(HasSubstr("is busy (" + state.substr(0, state.find(':')) + ")"), HasSubstr("wait or stop it first")));
    }
    EXPECT_EQ(controller.real_time, "") << state;
    EXPECT_TRUE(controller.lines.empty()) << state;
  }
  RecordedController rests;
  rests.state = [&] { return rests.resets.empty() ? "Hold:0" : "Idle"; };
  EXPECT_TRUE(stream_program(rests, kProgram).done()) << "at rest a reset keeps the place";
  EXPECT_EQ(rests.lines, kLines);
}

TEST(RecordedController, RefusesLinesWhileItIsJogged) {
  RecordedController controller;
  controller.answer = "error:9";
  controller.state = [&] { return controller.lines.empty() ? "Idle" : "Jog"; };
  const StreamResult result = stream_program(controller, kProgram);
  EXPECT_EQ(result.end, StreamEnd::kControllerError);
  EXPECT_EQ(result.error_line, 1);
  EXPECT_EQ(result.lines_acknowledged, 0);
  EXPECT_THAT(result.message, AllOf(HasSubstr("refused line 1 with error:9"), HasSubstr("executed none of the lines after it")));
  EXPECT_THAT(controller.real_time, testing::StartsWith(std::string{kSoftReset} + "!")) << "held at once";
  EXPECT_EQ(controller.real_time.find('~'), std::string::npos) << "and not let go";
}

TEST(RecordedController, JogsOnlyByTheOperatorsWish) {
  for (const std::string line : {"$J=G91 X10 F100", "X1\x85"}) {
    RecordedController controller;
    EXPECT_THROW(stream_program(controller, "G21\n" + line + "\n"), InputError);
    EXPECT_EQ(controller.real_time, "");
    EXPECT_TRUE(controller.lines.empty());
  }
  RecordedController controller;
  StreamOptions options;
  bool pressed = false;
  options.commands = [&] { return std::exchange(pressed, true) ? "" : std::string{kJogCancel}; };
  EXPECT_TRUE(stream_program(controller, kProgram, options).done());
  EXPECT_EQ(controller.real_time, std::string({kSoftReset, kJogCancel}));
  EXPECT_EQ(controller.lines, kLines) << "the byte acts at once and is no part of a line";
}

TEST(RecordedController, IsResetOnlyWhenItStands) {
  for (const auto& [moving, standing] :
       std::vector<std::pair<std::string, std::string>>{{"Hold:1", "Hold:0"}, {"Door:4", "Door:0"}, {"Hold:1", ""}}) {
    RecordedController controller;
    ClockTime held{};
    StreamOptions options;
    options.commands = [&] {
      if (controller.lines.empty() || held != ClockTime{}) return std::string();
      held = controller.time.now();
      return std::string{kSoftReset};
    };
    controller.state = [&]() -> std::string {
      if (held == ClockTime{} || controller.resets.size() > 1) return "Idle";
      return standing.empty() || controller.time.now() < held + seconds(2) ? moving : standing;
    };
    const StreamResult result = stream_program(controller, kProgram, options);
    if (standing.empty()) {
      EXPECT_EQ(result.end, StreamEnd::kStopped);
      EXPECT_THAT(result.message, HasSubstr("does not say that it stands"));
      EXPECT_EQ(controller.resets.size(), 1U) << "the greeting's";
    } else {
      EXPECT_EQ(result.end, StreamEnd::kAborted) << result.message;
      EXPECT_EQ(controller.resets, (std::vector<std::string>{"Idle", standing}));
    }
  }
}

// The door at the machine: the operator is asked once, and the spindle may take its time to come up again.
TEST(RecordedController, ADoorIsAskedForOnceAndResumes) {
  RecordedController controller;
  ClockTime let_go = kNever;
  controller.state = [&]() -> std::string {
    if (controller.lines.empty()) return "Idle";
    if (let_go == kNever) return "Door:0";
    return controller.time.now() < let_go + seconds(12) ? "Door:4" : "Idle";
  };
  StreamOptions options;
  std::vector<std::string> asked;
  options.on_operator = [&](const std::string& what) {
    asked.push_back(what);
    let_go = controller.time.now();
    return true;
  };
  const StreamResult result = stream_program(controller, kProgram, options);
  EXPECT_TRUE(result.done()) << result.message;
  EXPECT_EQ(result.recovered_acknowledgements, 0);
  EXPECT_THAT(asked, testing::ElementsAre(HasSubstr("waits (Door) although the program did not ask for it")));
  EXPECT_EQ(controller.real_time, std::string{kSoftReset} + "~");
  EXPECT_EQ(controller.lines, kLines);
}

TEST(RecordedController, AHoldAtTheMachineIsNoTimeOut) {
  RecordedController controller;
  ClockTime began = kNever;
  controller.state = [&]() -> std::string {
    if (controller.lines.empty()) return "Idle";
    if (began == kNever) began = controller.time.now();
    const ClockTime since = controller.time.now() - began;
    return since < milliseconds(300) ? "Hold:1" : since < seconds(90) ? "Hold:0" : "Idle";
  };
  const StreamResult result = stream_program(controller, kProgram);
  EXPECT_TRUE(result.done()) << result.message;
  EXPECT_GT(result.seconds, 89);
  EXPECT_EQ(controller.real_time, std::string{kSoftReset}) << "neither held nor let go by the sender";
  EXPECT_EQ(controller.lines, kLines);
}

}  // namespace
}  // namespace lightmill
