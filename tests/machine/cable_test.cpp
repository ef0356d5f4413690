#include "machine/cable.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <random>

#include "design/core/errors.h"

namespace lightmill {
namespace {

using Kind = LineFault::Kind;

std::string through(const std::string& text, std::vector<LineFault> faults, bool to_machine = false) {
  Cable cable({.baud = 0, .faults = std::move(faults)}, to_machine);
  cable.put(text, ClockTime(0));
  return cable.take(kNever);
}

TEST(Cable, PacesByTheByte) {
  Cable cable({.baud = 115200, .faults = {}}, true);
  cable.put("abcd", ClockTime(1000));
  EXPECT_EQ(cable.next_arrival(), ClockTime(1000 + 86806)) << "ten bits at 115,200 a second";
  EXPECT_EQ(cable.take(ClockTime(86805)), "");
  EXPECT_EQ(cable.take(ClockTime(200000)), "ab");
  // What comes later queues behind.
  cable.put("e", ClockTime(200000));
  EXPECT_EQ(cable.take(ClockTime(1000 + 4 * 86806)), "cd");
  EXPECT_EQ(cable.take(ClockTime(1000 + 5 * 86806)), "e");
  EXPECT_EQ(cable.next_arrival(), kNever);
}

// However the bytes are handed over and taken, a sound line changes nothing and is never faster than its baud rate.
RC_GTEST_PROP(Cable, IsTrueToTheByte, (const std::string& text, unsigned seed)) {
  std::mt19937 random(seed);
  Cable cable({.baud = 9600, .faults = {}}, true);
  std::string arrived;
  ClockTime now{0};
  std::size_t put = 0;
  while (arrived.size() < text.size()) {
    const auto count = std::min<std::size_t>(random() % 40, text.size() - put);
    cable.put(std::string_view(text).substr(put, count), now);
    put += count;
    now += std::chrono::microseconds(1 + random() % 20000);
    arrived += cable.take(now);
    RC_ASSERT(static_cast<double>(arrived.size()) * 10 / 9600 <= 1e-9 * static_cast<double>(now.count()) + 1e-9);
  }
  RC_ASSERT(arrived == text);
}

TEST(Cable, EachFaultDoesWhatItSays) {
  EXPECT_EQ(through("abcdef", {{.kind = Kind::kDropByte, .to_machine = false, .at = 3}}), "abdef");
  EXPECT_EQ(through("abcdef", {{.kind = Kind::kDoubleByte, .to_machine = false, .at = 3}}), "abccdef");
  EXPECT_EQ(through("X11", {{.kind = Kind::kFlipByte, .to_machine = false, .at = 2, .bit = 3}}), "X91");
  EXPECT_EQ(through("ok\r\n<ok>\r\nok\r\nok\r\n", {{.kind = Kind::kDropOk, .to_machine = false, .at = 2}}),
            "ok\r\n<ok>\r\nok\r\n");
  EXPECT_EQ(through("ok\r\nok\r\n", {{.kind = Kind::kDoubleOk, .to_machine = false, .at = 2}}), "ok\r\nok\r\nok\r\n");
  EXPECT_EQ(through("\x13\x11\x13\x11\x11", {{.kind = Kind::kDropXon, .to_machine = false, .at = 2}}), "\x13\x11\x13");
  EXPECT_EQ(through("abcdef", {{.kind = Kind::kHangUp, .to_machine = false, .at = 3}}), "ab");
  EXPECT_EQ(through("abcdef", {{.kind = Kind::kHangUp, .to_machine = true, .at = 3}}), "abcdef") << "the other way";
}

TEST(Cable, ALateOkHoldsUpAllBehindIt) {
  Cable cable({.baud = 0, .faults = {{.kind = Kind::kLateOk, .to_machine = false, .at = 2, .seconds = 3}}}, false);
  cable.put("ok\r\nok\r\nok\r\n", ClockTime(0));
  EXPECT_EQ(cable.take(std::chrono::milliseconds(2999)), "ok\r\n");
  EXPECT_EQ(cable.take(std::chrono::milliseconds(3000)), "ok\r\nok\r\n");
}

TEST(Cable, ASlowLineStaysSlow) {
  Cable cable({.baud = 10000, .faults = {{.kind = Kind::kSlow, .to_machine = true, .at = 3, .seconds = 0.1}}}, true);
  cable.put("abcd", ClockTime(0));
  EXPECT_EQ(cable.take(std::chrono::milliseconds(2)), "ab");
  EXPECT_EQ(cable.take(std::chrono::milliseconds(102)), "");
  EXPECT_EQ(cable.take(std::chrono::milliseconds(103)), "c");
  EXPECT_EQ(cable.take(std::chrono::milliseconds(204)), "d");
}

TEST(Cable, FaultsAreReadFromText) {
  EXPECT_EQ(line_fault("flip@120", 1).at, 120);
  EXPECT_EQ(line_fault("flip@120", 1).kind, Kind::kFlipByte);
  EXPECT_TRUE(line_fault("flip@120", 1).to_machine);
  EXPECT_FALSE(line_fault("drop-ok@3", 1).to_machine);
  EXPECT_EQ(line_fault("late-ok@3", 1).seconds, 2);
  // Without a place the seed chooses one, and again the same.
  EXPECT_EQ(line_fault("drop", 7).at, line_fault("drop", 7).at);
  EXPECT_NE(line_fault("drop", 7).at, line_fault("drop", 8).at);
  for (const char* bad : {"", "flip@", "flip@0", "flip@x", "melt@3", "flip@3 "}) {
    EXPECT_THROW(line_fault(bad, 1), InputError) << bad;
  }
}

}  // namespace
}  // namespace lightmill
