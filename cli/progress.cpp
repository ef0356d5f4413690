#include "cli/progress.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "design/core/text.h"

namespace lightmill {

namespace {

using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t g_stop = 0;

void on_signal(int) { g_stop = 1; }

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// So much fits into a line that is drawn over.
int line_width() {
  constexpr int kUnknown = 110;
  winsize size{};
  return ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 1 ? size.ws_col - 1 : kUnknown;
}

}  // namespace

std::string span_of_time(double seconds) {
  const long s = std::lround(std::max(0.0, seconds));
  if (s < 90) return std::to_string(s) + " s";
  if (s < 5400) return std::to_string((s + 30) / 60) + " min";
  return fixed(static_cast<double>(s) / 3600, 1) + " h";
}

void catch_stop_signals() {
  struct sigaction action = {};
  action.sa_handler = on_signal;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  // A closed pipe on stdout shall be an error of write(), not the end of a run.
  std::signal(SIGPIPE, SIG_IGN);
}

bool stop_requested() { return g_stop != 0; }

Progress::Progress(Style style) : style_(style), terminal_(style == Style::kAuto && ::isatty(STDERR_FILENO) == 1) {}

Progress::~Progress() { clear_line(); }

Monitor Progress::stage(std::string_view name) {
  stage_ = name;
  started_ = shown_ = Clock::now();
  if (style_ == Style::kAuto && !terminal_) std::fprintf(stderr, "%s ...\n", stage_.c_str());
  event({{"event", "stage"}, {"stage", stage_}, {"state", "started"}});
  Monitor monitor;
  monitor.on_progress = [this](std::string_view what, double fraction) { show(what, fraction, std::nullopt); };
  monitor.should_stop = stop_requested;
  return monitor;
}

void Progress::show(std::string_view what, double fraction, std::optional<double> seconds_left, const nlohmann::json* details) {
  // Often enough to be alive, seldom enough not to fill a log.
  const double every = style_ == Style::kJson ? 0.5 : terminal_ ? 0.1 : 5;
  if (style_ == Style::kQuiet || seconds_since(shown_) < every) return;
  shown_ = Clock::now();
  fraction = std::clamp(fraction, 0.0, 1.0);
  const double elapsed = seconds_since(started_);
  const double left = seconds_left ? *seconds_left : fraction > 0.01 ? elapsed * (1 - fraction) / fraction : -1;
  if (style_ == Style::kJson) {
    nlohmann::json e = {{"event", "progress"}, {"stage", stage_}, {"what", what}, {"fraction", fraction}, {"seconds", elapsed}};
    if (left >= 0) e["seconds_left"] = left;
    if (details != nullptr) e.update(*details);
    event(e);
    return;
  }
  const std::string line = stage_ + ": " + std::string(what) + "  " + fixed(100 * fraction, 0) + " %  " + span_of_time(elapsed) +
                           (left >= 0 ? ", about " + span_of_time(left) + " left" : "");
  if (terminal_) {
    std::fprintf(stderr, "\r\033[K%.*s", line_width(), line.c_str());
    std::fflush(stderr);
    drawn_ = true;
  } else {
    std::fprintf(stderr, "%s\n", line.c_str());
  }
}

void Progress::done(std::string_view note) {
  const double seconds = seconds_since(started_);
  event({{"event", "stage"}, {"stage", stage_}, {"state", note.empty() ? "done" : "kept"}, {"seconds", seconds}});
  if (style_ != Style::kAuto) return;
  clear_line();
  std::fprintf(stderr, "%s: %s\n", stage_.c_str(), note.empty() ? ("done in " + fixed(seconds, 1) + " s").c_str() : std::string(note).c_str());
}

void Progress::say(std::string_view line) {
  if (style_ == Style::kJson) return event({{"event", "note"}, {"text", line}});
  clear_line();
  std::printf("%.*s\n", static_cast<int>(line.size()), line.data());
  std::fflush(stdout);
}

void Progress::event(const nlohmann::json& event) {
  if (style_ != Style::kJson) return;
  std::printf("%s\n", event.dump().c_str());
  std::fflush(stdout);
}

void Progress::clear_line() {
  if (!drawn_) return;
  std::fputs("\r\033[K", stderr);
  std::fflush(stderr);
  drawn_ = false;
}

}  // namespace lightmill
