#include "postproc/data_rate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/postproc/support.h"

namespace lightmill {
namespace {

using testing::HasSubstr;

constexpr int kBytes = 42;  // a block

// `slow` blocks of 10 ms, then `fast` ones of 1 ms.
std::vector<double> times(int slow, int fast) {
  std::vector<double> seconds(static_cast<std::size_t>(slow), 0.01);
  seconds.insert(seconds.end(), static_cast<std::size_t>(fast), 0.001);
  return seconds;
}

TEST(DataRate, PeakIsOfTheBusiestStretch) {
  MachineModel machine = test::fixture_machine();
  machine.planner_blocks = 50;
  machine.min_block_s = 0.002;
  const std::vector<double> m = times(100, 100);
  const DataRate rate = data_rate(machine, m, 42 * 200, 200, 0);
  EXPECT_DOUBLE_EQ(rate.bytes_per_block, 42);
  EXPECT_NEAR(rate.mean_blocks_per_s, 200 / 1.1, 1e-9);
  EXPECT_NEAR(rate.peak_blocks_per_s, 1000, 1e-6);
  EXPECT_DOUBLE_EQ(rate.control_blocks_per_s, 500);
  EXPECT_EQ(rate.link_blocks_per_s, 0);
  EXPECT_GT(rate.starved_share, 0.03);
  EXPECT_LT(rate.starved_share, 0.1) << "the slow moves are not";
  EXPECT_THAT(rate.remedy, HasSubstr("the control gives 500"));
  machine.planner_blocks = 1000000;
  EXPECT_NEAR(data_rate(machine, m, 1, 1, 0).peak_blocks_per_s, rate.mean_blocks_per_s, 1e-9);
}

// Ten bits a byte and a tenth spare: 500 blocks/s of 42 bytes want 233 kbaud.
TEST(DataRate, ASlowLinkIsToldTheBaudItNeeds) {
  const MachineModel machine = test::fixture_machine();
  const std::vector<double> m(500, 0.002);
  const DataRate slow = data_rate(machine, m, 42 * 500, 500, 115200);
  EXPECT_NEAR(slow.link_blocks_per_s, 115200 * 0.9 / 420, 1e-9);
  EXPECT_NEAR(slow.starved_share, 0.802, 1e-9) << "once the control's look-ahead of 100 blocks is used up";
  EXPECT_THAT(slow.remedy, HasSubstr("460800 baud"));
  const DataRate quick = data_rate(machine, m, 42 * 500, 500, 460800);
  EXPECT_EQ(quick.starved_share, 0);
  EXPECT_THAT(quick.remedy, testing::IsEmpty());
}

// The line that the remedy names starves nothing, the usual one below it does; where none is enough a lower feed is left.
TEST(DataRate, TheNamedLineIsTheSlowestThatIsEnough) {
  MachineModel machine = test::fixture_machine();
  machine.min_block_s = 0;
  int below = 57600;
  for (const int baud : {115200, 230400, 460800, 921600}) {
    const std::vector<double> m(500, kBytes * 10 / (0.95 * 0.9 * baud));
    EXPECT_EQ(least_baud(1 / m.front(), kBytes), baud);
    EXPECT_EQ(data_rate(machine, m, kBytes * 500, 500, baud).starved_share, 0);
    EXPECT_GT(data_rate(machine, m, kBytes * 500, 500, below).starved_share, 0);
    below = baud;
  }
  const std::vector<double> m(500, 1e-4);
  EXPECT_EQ(least_baud(1e4, kBytes), 0);
  EXPECT_THAT(data_rate(machine, m, kBytes * 500, 500, 115200).remedy, HasSubstr("no usual line"));
  machine.min_block_s = 0.002;
  EXPECT_THAT(data_rate(machine, m, kBytes * 500, 500, 115200).remedy, testing::Not(HasSubstr("baud"))) << "the control is too slow for any";
}

}  // namespace
}  // namespace lightmill
