#include "machine/journal.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <condition_variable>
#include <cstring>
#include <fstream>
#include <mutex>
#include <thread>
#include <utility>

#include "design/core/text.h"
#include "machine/program_lines.h"

namespace lightmill {

namespace {

constexpr std::string_view kTitle = "lightmill journal 1";
constexpr std::size_t kLongestText = 400;
constexpr std::size_t kKeptNotes = 20;
constexpr std::size_t kDigestLength = 16;
constexpr std::size_t kLongestRecord = 16 + 16 + kLongestText + 2 + kDigestLength;

/// One line of printable characters.
std::string plain(std::string_view text) {
  std::string result(text.substr(0, kLongestText));
  for (char& c : result) {
    if (static_cast<unsigned char>(c) < ' ' || c == 0x7F) c = '_';
  }
  return result;
}

bool read_long(std::string_view text, long& value) {
  return std::from_chars(text.data(), text.data() + text.size(), value).ptr == text.data() + text.size() &&
         !text.empty();
}

}  // namespace

struct Journal::Impl {
  std::filesystem::path path;
  JournalOptions options;
  int file = -1;
  LineDigest digest;
  ClockTime start{0};
  ClockTime last_acknowledged{0}, last_report{0};
  long announced = 0, counted = 0, recorded = 0;
  long counted_audited = 0, recorded_audited = 0;
  std::string state;           ///< of the last report recorded
  std::string waiting_report;  ///< came too soon after it
  long counted_at_waiting_report = 0;
  bool broken = false;

  // The syncing thread.
  std::mutex mutex;
  std::condition_variable wake;
  bool dirty = false, ending = false;
  std::atomic<int> sync_error{0};
  std::thread thread;

  [[noreturn]] void fail(int error) {
    broken = true;
    throw JournalError("the journal " + path.string() + " cannot be written (" + std::strerror(error) +
                       "); free some space, then: lightmill resume");
  }

  [[nodiscard]] ClockTime now() const { return (options.clock != nullptr ? *options.clock : wall_clock()).now(); }

  void sync_now() {
    if (::fdatasync(file) != 0) fail(errno);
  }

  void sync_in_background() {
    std::unique_lock lock(mutex);
    while (!ending) {
      wake.wait(lock, [this] { return dirty || ending; });
      if (ending) return;
      dirty = false;
      lock.unlock();
      if (::fdatasync(file) != 0) sync_error = errno;
      lock.lock();
      wake.wait_for(lock, options.sync_every, [this] { return ending; });
    }
  }

  void append(std::string_view kind, std::string_view text) {
    if (broken) fail(EIO);
    if (const int error = sync_error) fail(error);
    std::string record = fixed(std::chrono::duration<double>(now() - start).count(), 3);
    record += ' ';
    record += kind;
    record += ' ';
    record += plain(text);
    digest.add(record);
    record += " *" + digest.hex() + "\n";
    std::string_view rest = record;
    while (!rest.empty()) {
      const ssize_t written = ::write(file, rest.data(), rest.size());
      if (written < 0 && errno == EINTR) continue;
      if (written <= 0) fail(written < 0 ? errno : ENOSPC);
      rest.remove_prefix(static_cast<std::size_t>(written));
    }
    {
      const std::lock_guard lock(mutex);
      dirty = true;
    }
    wake.notify_one();
  }

  /// Before anything else is said, what has been counted but not recorded.
  void catch_up() {
    if (counted == recorded) return;
    recorded = counted;
    last_acknowledged = now();
    append("acknowledged", std::to_string(counted));
    if (counted_audited == recorded_audited) return;
    recorded_audited = counted_audited;
    append("audited", std::to_string(counted_audited));
  }

  /// The last report, unless lines have been acknowledged since: it would be taken for younger than it is.
  void catch_up_with_report() {
    catch_up();
    if (!waiting_report.empty() && counted == counted_at_waiting_report) append("reported", waiting_report);
    waiting_report.clear();
  }
};

Journal::Journal(const std::filesystem::path& path, const JournalHeader& header, const JournalOptions& options)
    : impl_(std::make_unique<Impl>()) {
  impl_->path = path;
  impl_->options = options;
  impl_->start = impl_->now();
  // The first of each is never too early.
  impl_->last_acknowledged = impl_->last_report = impl_->start - options.record_every;
  std::error_code error;
  std::filesystem::create_directories(path.parent_path(), error);
  impl_->file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0644);
  if (impl_->file < 0) impl_->fail(errno);
  try {
    impl_->append("title", kTitle);
    impl_->append("program", header.program);
    impl_->append("program_digest", header.program_digest);
    impl_->append("sent_digest", header.sent_digest);
    impl_->append("machine_digest", header.machine_digest);
    impl_->append("job_digest", header.job_digest);
    impl_->append("started", header.started);
    impl_->append("lines", std::to_string(header.lines));
    impl_->append("planner_blocks", std::to_string(header.planner_blocks));
    impl_->append("entry_lines", std::to_string(header.entry_lines));
    impl_->append("first_line", std::to_string(header.first_line));
    impl_->append("uncut_line", std::to_string(header.uncut_line));
    impl_->append("begin", "");
    impl_->sync_now();
    // The file's name must survive, too.
    const int folder =
        ::open(path.parent_path().empty() ? "." : path.parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (folder >= 0) {
      ::fsync(folder);
      ::close(folder);
    }
  } catch (...) {
    ::close(impl_->file);
    throw;
  }
  impl_->thread = std::thread([impl = impl_.get()] { impl->sync_in_background(); });
}

Journal::~Journal() {
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->ending = true;
  }
  impl_->wake.notify_one();
  if (impl_->thread.joinable()) impl_->thread.join();
  ::fdatasync(impl_->file);
  ::close(impl_->file);
}

void Journal::sending(long lines) {
  if (lines <= impl_->announced) return;
  impl_->announced = lines - 1 + impl_->options.announce_lines;
  impl_->append("sending", std::to_string(impl_->announced));
}

void Journal::acknowledged(long lines) {
  impl_->counted = lines;
  if (impl_->now() - impl_->last_acknowledged >= impl_->options.record_every) impl_->catch_up();
}

void Journal::audited(long lines) {
  impl_->counted_audited = lines;
}

void Journal::reported(std::string_view status) {
  const std::string state(status.substr(0, status.find_first_of("|:>")));
  const ClockTime now = impl_->now();
  if (state == impl_->state && now - impl_->last_report < impl_->options.record_every) {
    impl_->waiting_report = status;
    impl_->counted_at_waiting_report = impl_->counted;
    return;
  }
  impl_->waiting_report.clear();
  impl_->state = state;
  impl_->last_report = now;
  impl_->catch_up();  // what is acknowledged before a report belongs to it
  impl_->append("reported", status);
}

void Journal::note(std::string_view what) {
  impl_->catch_up_with_report();
  impl_->append("note", what);
}

void Journal::end(std::string_view how, std::string_view message) {
  impl_->catch_up_with_report();
  if (!message.empty()) impl_->append("message", message);
  impl_->append("end", how);
  impl_->sync_now();
}

std::size_t read_records(const std::filesystem::path& path,
                         const std::function<void(const JournalRecord&)>& on_record) {
  std::ifstream in(path, std::ios::binary);
  if (!in) throw InputError("cannot read the journal " + path.string());
  LineDigest digest;
  std::error_code error;
  const std::size_t size = std::filesystem::file_size(path, error);
  std::size_t good = 0;
  JournalRecord record;
  // A line of a damaged file may be of any length: no more than a record's is read.
  std::array<char, kLongestRecord + 2> buffer;
  while (in.getline(buffer.data(), buffer.size()) && !in.eof()) {
    const std::string_view line(buffer.data(), static_cast<std::size_t>(in.gcount()) - 1);
    if (line.size() < kDigestLength + 2) break;
    const std::string_view content = line.substr(0, line.size() - kDigestLength - 2);
    digest.add(content);
    if (line.substr(content.size(), 2) != " *" || line.substr(content.size() + 2) != digest.hex()) break;
    const std::size_t first = content.find(' '), second = content.find(' ', first + 1);
    if (second == std::string_view::npos) break;
    const std::string_view seconds = content.substr(0, first);
    if (std::from_chars(seconds.data(), seconds.data() + seconds.size(), record.seconds).ec != std::errc()) break;
    record.kind = content.substr(first + 1, second - first - 1);
    record.text = content.substr(second + 1);
    if (good == 0 && (record.kind != "title" || record.text != kTitle)) {
      throw InputError(path.string() + " is no journal of this version");
    }
    good += line.size() + 1;
    on_record(record);
  }
  return size - good;
}

JournalSummary read_journal(const std::filesystem::path& path) {
  JournalSummary summary;
  JournalHeader& header = summary.header;
  bool begun = false;
  const std::pair<std::string_view, std::string*> texts[] = {
      {"program", &header.program},         {"program_digest", &header.program_digest},
      {"sent_digest", &header.sent_digest}, {"machine_digest", &header.machine_digest},
      {"job_digest", &header.job_digest},   {"started", &header.started},
      {"message", &summary.end_message},    {"end", &summary.end}};
  long planner_blocks = 0;
  const std::pair<std::string_view, long*> numbers[] = {{"lines", &header.lines},
                                                        {"planner_blocks", &planner_blocks},
                                                        {"entry_lines", &header.entry_lines},
                                                        {"first_line", &header.first_line},
                                                        {"uncut_line", &header.uncut_line},
                                                        {"sending", &summary.sent},
                                                        {"acknowledged", &summary.acknowledged},
                                                        {"audited", &summary.audited}};
  summary.torn_bytes = read_records(path, [&](const JournalRecord& record) {
    ++summary.records;
    summary.seconds = record.seconds;
    for (const auto& [kind, text] : texts) {
      if (record.kind == kind) *text = record.text;
    }
    for (const auto& [kind, number] : numbers) {
      if (record.kind == kind && !read_long(record.text, *number)) {
        throw InputError(path.string() + ": '" + record.text + "' where a number of lines should be");
      }
    }
    if (record.kind == "begin") begun = true;
    if (record.kind == "reported") {
      summary.report = record.text;
      summary.report_seconds = record.seconds;
      summary.acknowledged_at_report = summary.acknowledged;
    }
    if (record.kind == "note") {
      summary.last_notes.push_back(record);
      if (summary.last_notes.size() > kKeptNotes) summary.last_notes.pop_front();
    }
  });
  if (!begun) throw InputError("the journal " + path.string() + " ends before the stream began: nothing was sent");
  header.planner_blocks = static_cast<int>(planner_blocks);
  summary.sent = std::min(summary.sent, header.lines);
  return summary;
}

}  // namespace lightmill
