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
    terminal.type("hr+-0xq\n");
    EXPECT_EQ(keys.pressed(), "!~\x91\x92\x90") << "as they are pressed, without Enter; other keys do nothing";
    EXPECT_EQ(keys.pressed(), "");
  }
  ::tcgetattr(terminal.slave, &after);
  EXPECT_EQ(after.c_lflag, before.c_lflag);
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
