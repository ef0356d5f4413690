#include "machine/detail/mill.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "design/core/text.h"

namespace lightmill::detail {

namespace {

constexpr double kDegreesPerRad = 180 / kPi;
/// Rounding of sums of program numbers (mm, rad) is no overtravel.
constexpr double kLimitSlack = 1e-6;
/// Of the machine clock: the clock counts nanoseconds.
constexpr double kTimeSlack_s = 2e-9;
constexpr double kNanosecondsPerSecond = 1e9;
constexpr std::size_t kStarvationsKept = 100;

double seconds_of(const std::vector<SweptMove>& pieces) {
  double seconds = 0;
  for (const SweptMove& piece : pieces) seconds += piece.seconds;
  return seconds;
}

/// Takes the first `share` of their time off the pieces.
std::vector<SweptMove> take_first(std::vector<SweptMove>& pieces, double share) {
  double left = share * seconds_of(pieces);
  std::size_t whole = 0;
  while (whole < pieces.size() && pieces[whole].seconds <= left) left -= pieces[whole++].seconds;
  std::vector<SweptMove> first(pieces.begin(), pieces.begin() + static_cast<std::ptrdiff_t>(whole));
  pieces.erase(pieces.begin(), pieces.begin() + static_cast<std::ptrdiff_t>(whole));
  if (pieces.empty() || !(left > 0)) return first;
  SweptMove& rest = pieces.front();
  SweptMove part = rest;
  const double done = left / rest.seconds;
  part.to.tip_mm = rest.from.tip_mm + done * (rest.to.tip_mm - rest.from.tip_mm);
  part.to.axis = (rest.from.axis + done * (rest.to.axis - rest.from.axis)).normalized();
  part.seconds = left;
  rest.from = part.to;
  rest.seconds -= left;
  first.push_back(part);
  return first;
}

}  // namespace

Mill::Mill(const MachineModel& machine, const OperatorSetup& setup, const SimulationOptions& options)
    : machine_(machine),
      setup_(setup),
      options_(options),
      clock_(options.clock != nullptr ? options.clock : &wall_clock()),
      view_(machine, setup.workpiece_origin_mm, setup.errors) {
  if (options_.remove_stock) stock_ = std::make_unique<StockWorker>(setup_.blank, options_.stock);
  joints_.x_mm = std::clamp(0.0, machine_.x.min_mm, machine_.x.max_mm);
  joints_.y_mm = std::clamp(0.0, machine_.y.min_mm, machine_.y.max_mm);
  joints_.z_mm = std::clamp(machine_.retract_z_mm, machine_.z.min_mm, machine_.z.max_mm);
  planned_ = to_joints(joints_);
}

double Mill::clock_s() const {
  return static_cast<double>(clock_->now().count()) / kNanosecondsPerSecond * options_.time_factor;
}

// --- Motion ---

double Mill::least_seconds(const Joints& from, const Joints& to) const {
  const std::array<double, 5> speeds = {machine_.x.max_speed_mm_per_s, machine_.y.max_speed_mm_per_s,
                                        machine_.z.max_speed_mm_per_s, machine_.outer.max_speed_rad_per_s,
                                        machine_.inner.max_speed_rad_per_s};
  double seconds = machine_.min_block_s;
  for (std::size_t i = 0; i < 5; ++i) {
    if (speeds[i] > 0) seconds = std::max(seconds, std::abs(to[i] - from[i]) / speeds[i]);
  }
  return seconds;
}

std::optional<Mill::Overtravel> Mill::overtravel(const Joints& target) const {
  const auto check = [&](char letter, double value, double least, double most, double unit,
                         const char* unit_name) -> std::optional<Overtravel> {
    if (value >= least - kLimitSlack && value <= most + kLimitSlack) return std::nullopt;
    const double amount = value < least ? least - value : value - most;
    return Overtravel{std::string(1, letter) + " would pass its limit " +
                          compact((value < least ? least : most) * unit, 3) + " " + unit_name + " by " +
                          compact(amount * unit, 3) + " " + unit_name,
                      amount};
  };
  const auto linear = [&](char letter, double value, const LinearAxis& axis) {
    return check(letter, value, axis.min_mm, axis.max_mm, 1, "mm");
  };
  const auto rotary = [&](double value, const RotaryAxis& axis) {
    return check(axis.letter, value, axis.min_rad, axis.max_rad, kDegreesPerRad, "deg");
  };
  if (auto found = linear('X', target[0], machine_.x)) return found;
  if (auto found = linear('Y', target[1], machine_.y)) return found;
  if (auto found = linear('Z', target[2], machine_.z)) return found;
  if (auto found = rotary(target[3], machine_.outer)) return found;
  return rotary(target[4], machine_.inner);
}

void Mill::plan_move(const Joints& target, double seconds, bool rapid, long line) {
  Planned next;
  next.motion.line = line;
  next.motion.from = to_position(planned_);
  next.motion.to = to_position(target);
  next.motion.rapid = rapid;
  next.least_s = least_seconds(planned_, target);
  next.motion.seconds = seconds;
  next.motion.spindle_rpm = rpm_;
  next.motion.tool = tool_number_;
  planned_ = target;
  add(next);
}

void Mill::plan_dwell(double seconds) {
  expect_standstill();
  Planned next;
  next.dwell = true;
  next.motion.seconds = seconds;
  add(next);
}

double Mill::duration(const Planned& planned) const {
  if (planned.dwell) return planned.motion.seconds;
  if (planned.motion.rapid) return std::max(planned.motion.seconds, planned.least_s) * 100 / overrides_.rapid;
  return std::max(planned.motion.seconds * 100 / overrides_.feed, planned.least_s);
}

/// How much of the first planned motion has been made.
double Mill::running_share() const {
  if (planner_.empty() || held_) return 0;
  const double takes = duration(planner_.front());
  return takes > 0 ? std::clamp((clock_s() - head_start_s_) / takes, 0.0, 1.0) : 1;
}

JointPosition Mill::joints() const {
  if (planner_.empty() || planner_.front().dwell) return joints_;
  const double share = running_share();
  Joints place = to_joints(planner_.front().motion.from);
  const Joints to = to_joints(planner_.front().motion.to);
  for (std::size_t i = 0; i < place.size(); ++i) place[i] += share * (to[i] - place[i]);
  return to_position(place);
}

double Mill::feed_per_min() const {
  if (planner_.empty() || held_ || planner_.front().dwell) return 0;
  const Joints from = to_joints(planner_.front().motion.from), to = to_joints(planner_.front().motion.to);
  double square = 0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    const double way = (to[i] - from[i]) * (i < 3 ? 1 : kDegreesPerRad);
    square += way * way;
  }
  return square > 0 ? std::sqrt(square) / duration(planner_.front()) * 60 : 0;
}

/// Splits the running motion where it is: the first part is made, the rest is still planned. Both sweep the same pieces as
/// the whole would.
void Mill::make_running_part() {
  advance();
  const double share = running_share();
  if (share == 0) return;
  const double now = clock_s();
  Planned& rest = planner_.front();
  if (!rest.dwell && rest.swept.empty()) {
    Motion whole = rest.motion;
    whole.seconds = duration(rest);
    sweep(whole, rest.swept);
  }
  Planned part = rest;
  part.motion.to = joints();
  part.swept = take_first(rest.swept, share);
  perform(part, now - head_start_s_);
  rest.motion.from = part.motion.to;
  rest.motion.seconds *= 1 - share;
  rest.least_s *= 1 - share;
  head_start_s_ = now;
}

void Mill::add(Planned planned) {
  if (!paced()) {
    perform(planned, duration(planned));
    return;
  }
  if (planner_.empty()) {
    head_start_s_ = clock_s();
    if (cut_ended_s_ && !planned.dwell) {
      // A motion whose line came in time begins where the last one has ended, between two ticks of the clock.
      if (head_start_s_ - *cut_ended_s_ > options_.least_starvation_s) {
        note_starvation(*cut_ended_s_, head_start_s_);
      } else {
        head_start_s_ = *cut_ended_s_;
      }
    }
  }
  cut_ended_s_.reset();
  planner_.push_back(std::move(planned));
}

void Mill::advance() {
  if (planner_.empty() || held_) return;
  const double now = clock_s();
  while (!planner_.empty()) {
    const double takes = duration(planner_.front());
    if (head_start_s_ + takes > now + kTimeSlack_s) break;
    perform(planner_.front(), takes);
    head_start_s_ += takes;
    const bool cut = !planner_.front().dwell && !planner_.front().motion.rapid && rpm_ > 0;
    const long line = planner_.front().motion.line;
    planner_.pop_front();
    if (planner_.empty() && cut) {
      cut_ended_s_ = head_start_s_;
      cut_line_ = line;
    }
  }
}

ClockTime Mill::next_event() const {
  if (planner_.empty() || held_) return kNever;
  const double end_s = (head_start_s_ + duration(planner_.front())) / options_.time_factor;
  return ClockTime(static_cast<ClockTime::rep>(std::ceil(end_s * kNanosecondsPerSecond)));
}

/// The feed's force bends a cutter away from the work; where the feed stops it springs back and cuts that much deeper.
void Mill::leave_mark() {
  if (!stock_ || tool_ == nullptr || !(options_.starvation_mark_mm > 0)) return;
  SweptMove down;
  down.line = cut_line_;
  down.from = view_.cutter(joints_, tool_->length_mm);
  down.to = down.from;
  down.to.tip_mm -= options_.starvation_mark_mm * down.from.axis;
  down.spindle_on = true;
  SweptMove up = down;
  std::swap(up.from, up.to);
  stock_->move({down, up});
}

void Mill::note_starvation(double from_s, double until_s) {
  leave_mark();
  ++starvations_;
  starved_seconds_ += until_s - from_s;
  Starvation starvation{program_, cut_line_, tip_mm(), until_s - from_s};
  if (worst_starvations_.size() < kStarvationsKept) {
    worst_starvations_.push_back(std::move(starvation));
    return;
  }
  const auto shortest =
      std::min_element(worst_starvations_.begin(), worst_starvations_.end(),
                       [](const Starvation& a, const Starvation& b) { return a.seconds < b.seconds; });
  if (shortest->seconds >= starvation.seconds) return;
  worst_starvations_.erase(shortest);
  worst_starvations_.push_back(std::move(starvation));
}

void Mill::hold() {
  if (held_) return;
  make_running_part();
  held_ = true;
  expect_standstill();
}

void Mill::go_on() {
  if (!held_) return;
  head_start_s_ = clock_s();
  held_ = false;
}

void Mill::drop_motions() {
  make_running_part();
  planner_.clear();
  planned_ = to_joints(joints_);
  held_ = false;
  expect_standstill();
}

void Mill::set_overrides(const Overrides& overrides) {
  make_running_part();
  overrides_ = overrides;
}

void Mill::perform(const Planned& done, double seconds) {
  machine_seconds_ += seconds;
  if (done.dwell) {
    stood_s_ += seconds;
    return;
  }
  Motion motion = done.motion;
  motion.seconds = seconds;
  // Cutters are right-handed: they cut when the spindle turns clockwise and has reached its speed.
  motion.spindle_on = spindle_clockwise_ && machine_seconds_ - seconds >= at_speed_s_ - 1e-9;
  motion.spindle_rpm = turning_rpm(motion.spindle_rpm);
  motion.stood_s = std::exchange(stood_s_, 0.0);
  joints_ = motion.to;
  if (tool_ == nullptr && !motion.rapid && !told_no_tool_) {
    told_no_tool_ = true;
    add_fault("no_tool", "a feed move without a tool in the spindle", motion.line);
  }
  if (!stock_ && !on_motion) return;
  if (done.swept.empty()) {
    sweep(motion, pieces_);
  } else {
    pieces_ = done.swept;
    const double pace = seconds / seconds_of(pieces_);
    for (SweptMove& piece : pieces_) {
      piece.seconds *= pace;
      piece.spindle_on = motion.spindle_on;
      piece.spindle_rpm = motion.spindle_rpm;
    }
  }
  if (on_motion) on_motion(motion, pieces_);
  if (stock_ && tool_ != nullptr) stock_->move(pieces_);
}

void Mill::sweep(const Motion& motion, std::vector<SweptMove>& pieces) {
  pieces.clear();
  view_.sweep(motion, tool_ != nullptr ? tool_->length_mm : 0, {}, pieces);
}

// --- Spindle, tool ---

void Mill::turn_spindle(bool clockwise, double rpm) {
  if (rpm_ == 0 || clockwise != spindle_clockwise_) at_speed_s_ = machine_seconds_ + machine_.spindle_start_s;
  rpm_ = rpm;
  spindle_clockwise_ = clockwise;
}

double Mill::turning_rpm(double commanded) const {
  if (commanded == 0) return 0;
  return std::clamp(commanded * overrides_.spindle / 100, machine_.min_spindle_rpm, machine_.max_spindle_rpm);
}

void Mill::stop_spindle() {
  rpm_ = 0;
  spindle_clockwise_ = false;
}

const Cutter* Mill::find_cutter(int number) const {
  for (const Cutter& cutter : setup_.cutters) {
    if (cutter.number == number) return &cutter;
  }
  return nullptr;
}

void Mill::change_tool(int number) {
  tool_number_ = number;
  tool_ = find_cutter(number);
  if (stock_ && tool_ != nullptr) stock_->set_cutter(*tool_);
}

// --- What is known of it ---

void Mill::begin_program(const std::string& name) {
  program_ = name;
  if (stock_) stock_->begin_program(name);
}

Vec3 Mill::tip_mm() {
  return view_.cutter(joints_, tool_ != nullptr ? tool_->length_mm : 0).tip_mm;
}

Fault& Mill::add_fault(std::string kind, std::string message, long line) {
  Fault fault;
  fault.kind = std::move(kind);
  fault.program = program_;
  fault.line = line;
  fault.message = std::move(message);
  faults_.push_back(std::move(fault));
  return faults_.back();
}

void Mill::add_to(SimulationResult& result) const {
  result.machine_seconds = machine_seconds_;
  result.faults = faults_;
  result.joints = joints_;
  result.tool = tool_number_;
  result.starvations = starvations_;
  result.starved_seconds = starved_seconds_;
  result.worst_starvations = worst_starvations_;
  std::stable_sort(result.worst_starvations.begin(), result.worst_starvations.end(),
                   [](const Starvation& a, const Starvation& b) { return a.seconds > b.seconds; });
  if (starvations_ > 0) {
    const Starvation& worst = result.worst_starvations.front();
    Fault fault;
    fault.kind = "starved";
    fault.program = worst.program;
    fault.line = worst.line;
    fault.place_mm = worst.place_mm;
    fault.amount_mm = stock_ ? options_.starvation_mark_mm : 0;
    fault.message = "the cutter stood still in the cut " + std::to_string(starvations_) +
                    " times because no line came, longest " + compact(worst.seconds, 3) + " s; each leaves a mark" +
                    (fault.amount_mm > 0 ? " (taken as " + compact(fault.amount_mm * 1000, 3) + " um deep)" : "");
    result.faults.push_back(std::move(fault));
  }
}

}  // namespace lightmill::detail
