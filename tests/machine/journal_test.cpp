#include "machine/journal.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <thread>
#include <vector>

#include "machine/program_lines.h"
#include "machine/streamer.h"
#include "tests/machine/machine_rig.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

class JournalTest : public ::testing::Test {
 protected:
  JournalTest() {
    std::string pattern = (fs::temp_directory_path() / "lightmill_journal_XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) std::abort();
    folder_ = pattern;
  }
  ~JournalTest() override {
    std::error_code error;
    fs::remove_all(folder_, error);
  }
  [[nodiscard]] fs::path file(const std::string& name) const { return folder_ / name; }

  static std::string bytes(const fs::path& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  static void spill(const fs::path& path, const std::string& text) { std::ofstream(path, std::ios::binary) << text; }
  static std::vector<std::string> records(const fs::path& path) {
    std::vector<std::string> all;
    read_records(path, [&](const JournalRecord& r) { all.push_back(r.kind + " " + r.text); });
    return all;
  }

 private:
  fs::path folder_;
};

JournalHeader header() {
  JournalHeader h;
  h.program = "30_finish with blanks.nc";
  h.program_digest = "0123";
  h.sent_digest = "4567";
  h.machine_digest = "89ab";
  h.job_digest = "cdef";
  h.started = "2026-01-02 03:04:05";
  h.lines = 900;
  h.planner_blocks = 100;
  h.entry_lines = 12;
  h.first_line = 345;
  h.uncut_line = 350;
  return h;
}

JournalOptions every_record() {
  JournalOptions options;
  options.record_every = std::chrono::milliseconds(0);
  return options;
}

void write_example(const fs::path& path) {
  Journal journal(path, header(), every_record());
  journal.sending(1);
  journal.sending(2);  // announced already
  journal.acknowledged(1);
  journal.reported("<Run|MPos:1.000,2.000,3.000,0.000,0.000,0.000|Bf:97,1000|FS:0,0>");
  journal.acknowledged(40);
  journal.note("the operator\nsaid yes");
  journal.sending(65);
  journal.end("alarm", "ALARM:1 at or before line 41");
}

TEST_F(JournalTest, TellsWhatWasWritten) {
  write_example(file("j"));
  const JournalSummary summary = read_journal(file("j"));
  EXPECT_EQ(summary.header.program, header().program);
  EXPECT_EQ(summary.header.job_digest, "cdef");
  EXPECT_EQ(summary.header.entry_lines, 12);
  EXPECT_EQ(summary.header.first_line, 345);
  EXPECT_EQ(summary.header.uncut_line, 350);
  EXPECT_EQ(summary.header.planner_blocks, 100);
  EXPECT_EQ(summary.sent, 128) << "an announcement, never less than what went out";
  EXPECT_EQ(summary.acknowledged, 40);
  EXPECT_EQ(summary.acknowledged_at_report, 1);
  EXPECT_EQ(summary.report.substr(0, 5), "<Run|");
  ASSERT_EQ(summary.last_notes.size(), 1U);
  EXPECT_EQ(summary.last_notes[0].text, "the operator_said yes");
  EXPECT_EQ(summary.end, "alarm");
  EXPECT_EQ(summary.torn_bytes, 0U);
  EXPECT_FALSE(summary.done());
}

// A power cut at any byte leaves the records before it, and nothing else.
TEST_F(JournalTest, EveryTruncationIsAPrefix) {
  write_example(file("whole"));
  const std::string all = bytes(file("whole"));
  const auto whole = records(file("whole"));
  std::size_t before = 0;
  for (std::size_t size = 0; size <= all.size(); ++size) {
    spill(file("cut"), all.substr(0, size));
    std::vector<std::string> some;
    const std::size_t torn =
        read_records(file("cut"), [&](const JournalRecord& r) { some.push_back(r.kind + " " + r.text); });
    ASSERT_LE(some.size(), whole.size());
    ASSERT_TRUE(std::equal(some.begin(), some.end(), whole.begin())) << size;
    ASSERT_GE(some.size(), before);
    ASSERT_EQ(torn == 0, size == 0 || all[size - 1] == '\n') << size;
    before = some.size();
  }
  EXPECT_EQ(before, whole.size());
}

// A changed, lost or doubled record and all that follow it are not believed.
TEST_F(JournalTest, DamageIsNeverBelieved) {
  write_example(file("whole"));
  const std::string all = bytes(file("whole"));
  const auto whole = records(file("whole"));
  for (std::size_t at = 0; at < all.size(); at += 7) {
    std::string damaged = all;
    damaged[at] = static_cast<char>(damaged[at] ^ 1);
    spill(file("damaged"), damaged);
    const auto some = records(file("damaged"));
    const auto intact = static_cast<std::size_t>(std::count(all.begin(), all.begin() + static_cast<long>(at), '\n'));
    ASSERT_EQ(some.size(), intact) << at;
    ASSERT_TRUE(std::equal(some.begin(), some.end(), whole.begin()));
  }
  const std::size_t second = all.find('\n') + 1, third = all.find('\n', second) + 1;
  spill(file("damaged"), all.substr(0, second) + all.substr(third));
  EXPECT_EQ(records(file("damaged")).size(), 1U);
  spill(file("damaged"), all.substr(0, third) + all.substr(second));
  EXPECT_EQ(records(file("damaged")).size(), 2U);
}

TEST_F(JournalTest, WhatIsNoJournalIsAnError) {
  spill(file("empty"), "");
  EXPECT_THROW(read_journal(file("empty")), InputError);
  EXPECT_THROW(read_journal(file("none")), InputError);
  spill(file("long"), std::string(100000, 'x'));
  EXPECT_THROW(read_journal(file("long")), InputError);
  write_example(file("j"));
  EXPECT_THROW(Journal(file("j"), header()), JournalError) << "never over an old one";
}

// Bounded: a fast stream costs one record for so many lines, a report in the same state none.
TEST_F(JournalTest, IsShort) {
  JournalOptions options;
  options.record_every = std::chrono::hours(1);
  {
    Journal journal(file("j"), header(), options);
    for (long i = 1; i <= 64000; ++i) {
      journal.sending(i);
      journal.acknowledged(i);
      journal.reported("<Run|Bf:1,2>");
    }
    journal.note("the end");
  }
  const JournalSummary summary = read_journal(file("j"));
  EXPECT_LT(summary.records, 1000 + 20);
  EXPECT_EQ(summary.acknowledged, 64000) << "a note says all that was counted first";
}

TEST_F(JournalTest, FullDiskIsLoudAndLasting) {
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit old{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &old), 0);
  Journal journal(file("j"), header(), every_record());
  const std::size_t size = bytes(file("j")).size();
  const rlimit tight{size + 100, old.rlim_max};
  setrlimit(RLIMIT_FSIZE, &tight);
  std::string message;
  int failures = 0;
  for (long i = 1; i < 10; ++i) {
    try {
      journal.acknowledged(i);
    } catch (const JournalError& error) {
      message = error.what();
      ++failures;
    }
  }
  setrlimit(RLIMIT_FSIZE, &old);
  std::signal(SIGXFSZ, old_handler);
  EXPECT_GE(failures, 7);
  EXPECT_NE(message.find("cannot be written"), std::string::npos);
  EXPECT_THROW(journal.note("room again"), JournalError) << "a torn record is never written behind";
  const JournalSummary summary = read_journal(file("j"));
  EXPECT_GE(summary.acknowledged, 1);
}

std::string rows(int count) {
  std::string text = "G21 G90 G94 G54\nG1 X0 F1000\n";
  for (int i = 0; i < count; ++i) text += "X" + std::to_string(i % 50 + 1) + " Y" + std::to_string(i % 7) + "\n";
  return text + "M2\n";
}

TEST_F(JournalTest, FollowsAStream) {
  test::MachineRig rig;
  rig.serve_in_thread();
  const auto connection = rig.connect();
  const std::string program = rows(500);
  JournalHeader h = header();
  h.lines = static_cast<long>(program_lines(program).size());
  StreamResult result;
  {
    Journal journal(file("j"), h);
    StreamOptions options;
    options.journal = &journal;
    result = stream_program(*connection, program, options);
    journal.end(result.done() ? "done" : "early", result.message);
  }
  ASSERT_TRUE(result.done()) << result.message;
  const JournalSummary summary = read_journal(file("j"));
  EXPECT_TRUE(summary.done());
  EXPECT_EQ(summary.acknowledged, h.lines);
  EXPECT_EQ(summary.sent, h.lines);
  EXPECT_EQ(summary.acknowledged_at_report, h.lines);
  StatusReport report;
  EXPECT_TRUE(parse_status(summary.report, report)) << summary.report;
  EXPECT_EQ(report.state, "Idle");
}

TEST_F(JournalTest, FullDiskHoldsTheMachine) {
  test::MachineRig rig;
  rig.serve_in_thread();
  const auto connection = rig.connect();
  const std::string program = rows(4000);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit old{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &old), 0);
  Journal journal(file("j"), header());
  const rlimit tight{bytes(file("j")).size() + 400, old.rlim_max};
  StreamOptions options;
  options.journal = &journal;
  setrlimit(RLIMIT_FSIZE, &tight);
  const StreamResult result = stream_program(*connection, program, options);
  setrlimit(RLIMIT_FSIZE, &old);
  std::signal(SIGXFSZ, old_handler);
  EXPECT_EQ(result.end, StreamEnd::kJournal);
  EXPECT_NE(result.message.find("the machine is held"), std::string::npos) << result.message;
  EXPECT_LT(result.lines_acknowledged, 4000);
  // The hold is on its way; the machine then says so.
  std::string answer;
  for (int i = 0; i < 50 && answer.find("<Hold") == std::string::npos; ++i) {
    connection->write_some(std::string_view("?"), std::chrono::milliseconds(100));
    std::array<char, 4096> buffer;
    const std::size_t count = connection->read_some(buffer, std::chrono::milliseconds(100));
    answer.append(buffer.data(), count);
  }
  EXPECT_NE(answer.find("<Hold"), std::string::npos);
}

}  // namespace
}  // namespace lightmill
