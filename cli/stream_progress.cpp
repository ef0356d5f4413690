#include "cli/stream_progress.h"

#include <ctime>
#include <nlohmann/json.hpp>

#include "design/core/text.h"

namespace lightmill {

using nlohmann::json;

namespace {

constexpr double kLogEvery_s = 10;
constexpr std::string_view kAxes = "XYZABC";

std::string percent(double share) {
  return fixed(100 * share, 1) + " %";
}

}  // namespace

std::string now_text() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::localtime_r(&now, &parts);
  char text[32];
  return std::string(text, std::strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", &parts));
}

StreamProgress::StreamProgress(Progress& progress, ProgramSchedule schedule, const std::filesystem::path& log)
    : progress_(progress), schedule_(std::move(schedule)), started_(std::chrono::steady_clock::now()) {
  if (log.empty()) return;
  std::error_code error;
  std::filesystem::create_directories(log.parent_path(), error);
  log_.open(log);
  if (!log_) throw IoError("cannot write " + log.string());
  note("begins; " + span_of_time(schedule_.total_s()) + " by the dry run's times");
}

void StreamProgress::begin() {
  started_ = std::chrono::steady_clock::now();
  logged_s_ = seen_s_ = held_s_ = 0;
  note("checked by the controller; the stream begins");
}

double StreamProgress::elapsed_s() const {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - started_).count();
}

void StreamProgress::note(std::string_view what) {
  if (log_.is_open()) log_ << now_text() << "  " << what << std::endl;
}

void StreamProgress::traffic(std::string_view line) {
  // Lines are in the program, acknowledgements and reports are counted elsewhere.
  const std::string_view text = line.substr(2);
  const bool acts_at_once =
      line.front() == '>' && (text == "<reset>" || text == "!" || text == "~" || static_cast<unsigned char>(text.front()) >= 0x80);
  const bool reply = line.front() == '<' && text != "ok" && text.front() != '<';
  if (!acts_at_once && !reply) return;
  if (const auto byte = static_cast<unsigned char>(text.front()); byte >= 0x80) {
    note("> real-time byte " + std::to_string(byte));
  } else {
    note(line);
  }
}

void StreamProgress::status(const StreamStatus& status) {
  const StatusReport& report = status.report;
  const bool moving = report.state == "Run" || report.state == "Idle";
  std::string what = "line " + std::to_string(status.line);
  json position = json::object();
  for (std::size_t i = 0; i < report.machine_position.size() && i < kAxes.size(); ++i) {
    what += std::string(i == 0 ? ", " : " ") + kAxes[i] + compact(report.machine_position[i], 2);
    position[std::string(1, kAxes[i])] = report.machine_position[i];
  }
  if (report.feed_mm_per_min >= 0) what += " F" + compact(report.feed_mm_per_min, 0);
  if (!report.overrides.empty() && report.overrides.front() != 100) what += " (" + compact(report.overrides.front(), 0) + " %)";
  const double fill = static_cast<double>(status.under_way_bytes) / std::max(1, status.receive_buffer_bytes - 1);
  what += ", buffer " + fixed(100 * fill, 0) + " %, starved " + std::to_string(status.starved_reports);
  if (report.state != "Run") what = report.state + ", " + what;
  const json details = {{"line", status.line},
                        {"state", report.state},
                        {"position", position},
                        {"feed_mm_per_min", report.feed_mm_per_min},
                        {"buffer_fill", fill},
                        {"starved_reports", status.starved_reports}};
  const bool changed = report.state != state_;
  state_ = report.state;
  show(status.lines_executed, status.lines_total, moving, what, details, changed);
}

void StreamProgress::sent(long lines, long lines_total) {
  show(lines, lines_total, true, "line " + std::to_string(lines) + " sent", {{"lines_sent", lines}}, false);
}

void StreamProgress::show(long lines, long lines_total, bool moving, const std::string& what, json details, bool log_now) {
  const double now_s = elapsed_s();
  if (!moving) held_s_ += now_s - seen_s_;
  seen_s_ = now_s;
  double share = static_cast<double>(lines) / static_cast<double>(std::max(1L, lines_total));
  std::optional<double> left_s;
  if (schedule_.total_s() > 0) {
    const double done_s = schedule_.at(lines);
    pace_.observe(done_s, now_s, moving);
    share = done_s / schedule_.total_s();
    left_s = (schedule_.total_s() - done_s) * pace_.factor();
  }
  progress_.show(what, share, left_s, &details);
  if (!log_now && now_s - logged_s_ < kLogEvery_s) return;
  logged_s_ = now_s;
  note(percent(share) + ", " + what + (left_s ? ", about " + span_of_time(*left_s) + " left" : ""));
}

json StreamProgress::summary() const {
  return {{"planned_seconds", schedule_.total_s()}, {"held_seconds", held_s_}, {"pace", pace_.factor()}};
}

}  // namespace lightmill
