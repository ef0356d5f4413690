#include "machine/block_transfer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <random>

#include "design/core/errors.h"
#include "machine/detail/fe_block.h"
#include "machine/program_lines.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using testing::HasSubstr;

SimulationOptions blockwise() {
  SimulationOptions options = test::no_stock();
  options.personality = Personality::kBlockwise;
  return options;
}

std::string klartext(int moves) {
  std::string text = "0 BEGIN PGM LENS MM\n";
  for (int i = 1; i <= moves; ++i) {
    text += std::to_string(i) + " L X" + (i % 2 ? "+" : "-") + std::to_string(i) + ".125 Y+7." + std::to_string(i % 10) + " F1500\n";
  }
  return text + std::to_string(moves + 1) + " END PGM LENS MM\n";
}

struct Outcome {
  StreamResult sender;
  SimulationResult machine;
};

Outcome transfer(const std::string& program, const std::vector<LineFault>& faults = {},
                 const BlockTransferOptions& options = {}) {
  LineOptions line;
  line.baud = 9600;
  line.even_parity = true;
  line.faults = faults;
  test::Lockstep rig(blockwise(), line);
  Outcome outcome;
  outcome.sender = transfer_blockwise(rig.link, program, options);
  rig.link.run_for(milliseconds(5000));
  outcome.machine = rig.machine.result();
  return outcome;
}

// The manual's own example: SOH H 1 5 E ETB has the check character 1F.
TEST(FeBlock, TheManualsCheckCharacter) {
  const std::string block = detail::fe_block(detail::kSoh, "H15E");
  EXPECT_EQ(block, std::string("\x01H15E\x17\x1f\x11"));
  // MP5020 bit 1: a blank before ETB, and the check character can be printed.
  EXPECT_EQ(detail::fe_block(detail::kSoh, "H15E", true), std::string("\x01H15E \x17\x3f\x11"));
}

// Whatever the text, the reader finds it again; and one byte lost, turned in a bit or doubled is never taken for sound.
RC_GTEST_PROP(FeBlock, IsReadBackAndGuardsEveryByte, (unsigned seed)) {
  std::mt19937 random(seed);
  std::string text;
  for (unsigned i = random() % 100; i > 0; --i) text += static_cast<char>(0x20 + random() % 0x5f);
  const std::string block = detail::fe_block(detail::kStx, text, random() % 2 == 0);
  const auto heard = [](const std::string& bytes) {
    detail::FeReader reader;
    std::optional<detail::FeArrival> block_heard;
    for (const char byte : bytes) {
      const auto arrival = reader.push(byte);
      if (arrival && arrival->opener == detail::kStx) block_heard = arrival;
    }
    return block_heard;
  };
  const auto whole = heard(block);
  RC_ASSERT(whole && whole->sound);
  RC_ASSERT(whole->text == text || whole->text == text + " ");
  const std::size_t at = random() % (block.size() - 1);
  std::string spoilt = block;
  switch (random() % 3) {
    case 0:
      spoilt.erase(at, 1);
      break;
    case 1:
      spoilt[at] = static_cast<char>(spoilt[at] ^ (1 << random() % 7));
      break;
    default:
      spoilt.insert(at, 1, spoilt[at]);
  }
  const auto after = heard(spoilt);
  RC_ASSERT(!after || !after->sound);
}

TEST(BlockTransfer, EveryLineOnceAndInOrder) {
  const std::string program = klartext(300);
  std::vector<std::string> traffic;
  BlockTransferOptions options;
  options.on_traffic = [&](const std::string& line) { traffic.push_back(line); };
  const Outcome outcome = transfer(program, {}, options);
  EXPECT_TRUE(outcome.sender.done()) << outcome.sender.message;
  EXPECT_EQ(outcome.machine.received_program, program);
  EXPECT_EQ(outcome.machine.received_digest, program_digest(program));
  EXPECT_FALSE(outcome.machine.alarm);
  EXPECT_EQ(outcome.sender.repeated_blocks, 0);
  ASSERT_GT(traffic.size(), 3U);
  EXPECT_EQ(traffic[0], "< <SOH>H1E");
  EXPECT_EQ(traffic[1], "> line 1");
  EXPECT_EQ(traffic[2], "< <ACK>");
  EXPECT_EQ(traffic.back(), "< <EOT>") << "ETX is answered by the control's end of transmission";
}

// A block that arrives damaged is refused and sent again; the text on the disk is the program's, or the sender says no.
TEST(BlockTransfer, NoDamageReachesTheDisk) {
  const std::string program = klartext(12);
  const long bytes = static_cast<long>(program.size()) + 14 * 3;
  long repeated = 0, stopped = 0;
  for (const auto kind : {LineFault::Kind::kDropByte, LineFault::Kind::kFlipByte, LineFault::Kind::kDoubleByte}) {
    for (const bool to_machine : {true, false}) {
      for (long at = 1; at <= (to_machine ? bytes : 8 + 15); ++at) {
        const Outcome outcome =
            transfer(program, {{.kind = kind, .to_machine = to_machine, .at = at, .bit = static_cast<int>(at % 7)}});
        repeated += outcome.sender.repeated_blocks;
        if (outcome.sender.done()) {
          EXPECT_EQ(outcome.machine.received_program, program) << at << " " << outcome.sender.message;
        } else {
          ++stopped;
          EXPECT_THAT(outcome.sender.message, HasSubstr("nothing has moved"));
        }
      }
    }
  }
  EXPECT_GT(repeated, bytes) << "most are mended";
  EXPECT_GT(stopped, 0) << "a lost or doubled acknowledgement is not guessed at";
}

TEST(BlockTransfer, GivesUpOnAHopelessLine) {
  // One byte in the middle of the second block, which has 27, and of each of its repetitions.
  std::vector<LineFault> faults;
  for (const long at : {35, 62, 89, 116}) faults.push_back({.kind = LineFault::Kind::kFlipByte, .at = at, .bit = 1});
  const Outcome outcome = transfer(klartext(12), faults);
  EXPECT_EQ(outcome.sender.end, StreamEnd::kControllerError);
  EXPECT_THAT(outcome.sender.message, HasSubstr("4 times: the line is disturbed"));
  EXPECT_EQ(outcome.sender.repeated_blocks, 3);
  EXPECT_TRUE(outcome.machine.alarm) << "it knows that the program is not whole";
}

TEST(BlockTransfer, RefusesBeforehandWhatSevenBitsDoNotHold) {
  EXPECT_THROW(transfer("0 BEGIN PGM \xc3\x84 MM\n"), InputError);
}

TEST(BlockTransfer, AControlThatDoesNotAskIsAnIoError) {
  test::Lockstep rig;  // grblHAL
  EXPECT_THAT(transfer_blockwise(rig.link, klartext(2)).message, HasSubstr("does not ask for a program"));
}

}  // namespace
}  // namespace lightmill
