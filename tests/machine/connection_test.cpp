#include "machine/connection.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <thread>

#include "design/core/errors.h"
#include "machine/pseudo_terminal.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using testing::AllOf;
using testing::HasSubstr;

template <typename Error>
std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(Serial, AbsentPortNamesItselfAndTheRemedy) {
  EXPECT_THAT(message_of<IoError>([] { open_serial("/dev/ttyNOWHERE7", 115200); }),
              AllOf(HasSubstr("/dev/ttyNOWHERE7"), HasSubstr("is not there"),
                    HasSubstr("'lightmill ports' lists what is there")));
}

TEST(Serial, AFileIsNoPort) {
  const auto path = std::filesystem::temp_directory_path() / ("lightmill_no_port_" + std::to_string(::getpid()));
  std::ofstream(path) << "x";
  EXPECT_THAT(message_of<IoError>([&] { open_serial(path.string(), 115200); }), HasSubstr("is not a serial port"));
  std::filesystem::remove(path);
}

TEST(Serial, OddBaudRatesAreTheUsersMistake) {
  const PseudoTerminal terminal{std::filesystem::path()};
  EXPECT_THAT(message_of<InputError>([&] { open_serial(terminal.far_end(), 115201); }),
              AllOf(HasSubstr("115201"), HasSubstr("115200")));
  EXPECT_NO_THROW(open_serial(terminal.far_end(), 9600));
}

TEST(Serial, AllBytesPassBothWays) {
  PseudoTerminal terminal{std::filesystem::path()};
  const auto connection = open_serial(terminal.far_end(), 115200);
  std::string all;
  for (int i = 0; i < 1024; ++i) all += static_cast<char>(i);
  EXPECT_EQ(connection->write_some(all, milliseconds(500)), all.size());
  char bytes[4096];
  std::string there, back;
  while (there.size() < all.size()) {
    const std::size_t count = terminal.read_some(bytes, milliseconds(500));
    ASSERT_GT(count, 0U);
    there.append(bytes, count);
  }
  EXPECT_EQ(there, all);
  terminal.write_some(all, milliseconds(500));
  while (back.size() < all.size()) {
    const std::size_t count = connection->read_some(bytes, milliseconds(500));
    ASSERT_GT(count, 0U);
    back.append(bytes, count);
  }
  EXPECT_EQ(back, all);
}

TEST(Serial, DeadlinesAreKept) {
  const PseudoTerminal terminal{std::filesystem::path()};
  const auto connection = open_serial(terminal.far_end(), 115200);
  char byte[1];
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(connection->read_some(byte, milliseconds(30)), 0U);
  EXPECT_FALSE(connection->wait(false, milliseconds(30)));
  EXPECT_TRUE(connection->wait(true, milliseconds(1000)));
  const std::string much(1 << 20, 'x');
  const std::size_t taken = connection->write_some(much, milliseconds(30));
  EXPECT_LT(taken, much.size());
  EXPECT_FALSE(connection->wait(true, milliseconds(30)));
  const auto elapsed = std::chrono::steady_clock::now() - start;
  EXPECT_GE(elapsed, milliseconds(110));
  EXPECT_LT(elapsed, milliseconds(2000));
}

// libserial alone would report a timeout here, and end the process when the port is closed.
TEST(Serial, AHangUpIsAnErrorAndClosingIsSafe) {
  auto terminal = std::make_unique<PseudoTerminal>(std::filesystem::path());
  auto connection = open_serial(terminal->far_end(), 115200);
  char byte[16];
  std::thread puller([&] {
    std::this_thread::sleep_for(milliseconds(30));
    terminal.reset();
  });
  EXPECT_THAT(message_of<IoError>([&] {
                for (int i = 0; i < 10; ++i) connection->read_some(byte, milliseconds(1000));
              }),
              HasSubstr("hung up"));
  puller.join();
  EXPECT_THROW(connection->write_some(std::string("x"), milliseconds(10)), IoError);
  EXPECT_THROW(connection->wait(false, milliseconds(10)), IoError);
  EXPECT_NO_THROW(connection.reset());
}

TEST(Serial, OnePortOneSender) {
  const PseudoTerminal terminal{std::filesystem::path()};
  auto first = open_serial(terminal.far_end(), 115200);
  EXPECT_THAT(message_of<IoError>([&] { open_serial(terminal.far_end(), 115200); }), HasSubstr("in use"));
  first.reset();
  EXPECT_NO_THROW(open_serial(terminal.far_end(), 115200));
  // A killed sender leaves no lock behind.
  const pid_t child = ::fork();
  if (child == 0) {
    const auto held = open_serial(terminal.far_end(), 115200);
    ::kill(::getpid(), SIGKILL);
  }
  ::waitpid(child, nullptr, 0);
  PseudoTerminal& served = const_cast<PseudoTerminal&>(terminal);
  char byte[1];
  served.read_some(byte, milliseconds(1));
  EXPECT_NO_THROW(open_serial(terminal.far_end(), 115200));
}

}  // namespace
}  // namespace lightmill
