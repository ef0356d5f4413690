#include "cli/operator_keys.h"

#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

namespace lightmill {
namespace {

struct Terminal {
  Terminal() { EXPECT_EQ(::openpty(&master, &slave, nullptr, nullptr, nullptr), 0); }
  ~Terminal() {
    ::close(master);
    ::close(slave);
  }
  void type(const std::string& keys) const { EXPECT_EQ(::write(master, keys.data(), keys.size()), static_cast<ssize_t>(keys.size())); }
  int master = -1, slave = -1;
};

TEST(OperatorKeys, AreRealTimeBytes) {
  const Terminal terminal;
  termios before{}, after{};
  ::tcgetattr(terminal.slave, &before);
  {
    OperatorKeys keys(terminal.slave);
    EXPECT_EQ(keys.pressed(), "");
    terminal.type("hr+-0x][=124q\n");
    EXPECT_EQ(keys.pressed(), "!~\x91\x92\x90\x9a\x9b\x99\x95\x96\x97\x18")
        << "as they are pressed, without Enter; other keys do nothing";
    EXPECT_EQ(keys.pressed(), "");
  }
  ::tcgetattr(terminal.slave, &after);
  EXPECT_EQ(after.c_lflag, before.c_lflag);
}

TEST(OperatorKeys, StopBeforeALine) {
  const Terminal terminal;
  OperatorKeys keys(terminal.slave);
  EXPECT_FALSE(keys.wants_stop());
  terminal.type("p");
  EXPECT_EQ(keys.pressed(), "");
  EXPECT_TRUE(keys.wants_stop());
  terminal.type("\n");
  EXPECT_TRUE(keys.ask("before line 3"));
  EXPECT_FALSE(keys.wants_stop()) << "a pause is asked about once";
  terminal.type("b");
  keys.pressed();
  terminal.type("\n");
  EXPECT_TRUE(keys.ask("before line 4"));
  EXPECT_TRUE(keys.wants_stop()) << "a single block stays on";
  terminal.type("b");
  keys.pressed();
  EXPECT_FALSE(keys.wants_stop());
}

TEST(OperatorKeys, AreListedInTheHelp) {
  for (const char* key : {"h  hold", "r  resume", "+  feed", "]  spindle", "1  rapids", "q  give up", "p  pause", "b  single block"})
    EXPECT_NE(key_list().find(key), std::string::npos) << key;
}

TEST(OperatorKeys, AskWantsEnterAlone) {
  const Terminal terminal;
  OperatorKeys keys(terminal.slave);
  terminal.type("\n");
  EXPECT_TRUE(keys.ask("tool change"));
  terminal.type("q\n");
  EXPECT_FALSE(keys.ask("tool change"));
  terminal.type("h");
  EXPECT_EQ(keys.pressed(), "!") << "keys act again";
}

TEST(OperatorKeys, WithoutATerminalNobodyIsThere) {
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  OperatorKeys keys(ends[0]);
  ASSERT_EQ(::write(ends[1], "h\n", 2), 2);
  EXPECT_EQ(keys.pressed(), "");
  EXPECT_FALSE(keys.ask("tool change"));
  ::close(ends[0]);
  ::close(ends[1]);
}

}  // namespace
}  // namespace lightmill
