#include "machine/detail/reader_core.h"

#include <Eigen/Geometry>

#include "design/core/errors.h"

namespace lightmill {

namespace detail {

namespace {
constexpr double kChordError_mm = 1e-4;
constexpr double kTipError_mm = 5e-5;
constexpr int kMostChords = 100000;
constexpr int kMostHalvings = 24;
constexpr double kGreatCircleStep_rad = 0.5 * kRadPerDegree;
constexpr double kOpposite_rad = 1e-6;
}  // namespace

bool read_digits(const char*& at, const char* end, double& value, bool* has_point) {
  static constexpr double kPowers[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8, 1e9,
                                       1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18};
  const char* p = at;
  std::uint64_t digits = 0;
  int decimals = 0, count = 0;
  bool point = false, any = false;
  for (; p != end; ++p) {
    if (*p >= '0' && *p <= '9') {
      any = true;
      if (count >= 18 || decimals >= 18) {
        if (!point) return false;
        continue;  // beyond what a double holds
      }
      digits = digits * 10 + static_cast<std::uint64_t>(*p - '0');
      if (digits != 0) ++count;
      if (point) ++decimals;
    } else if (*p == '.' && !point) {
      point = true;
    } else {
      break;
    }
  }
  if (!any) return false;
  value = static_cast<double>(digits) / kPowers[decimals];
  if (has_point != nullptr) *has_point = point;
  at = p;
  return true;
}

ReaderCore::ReaderCore(const MachineModel& m, const ReaderSetup& s,
                       const std::function<void(const ProgramStep&)>& on_step)
    : setup(s), machine(m), on_step_(on_step), view_(m, Vec3::Zero()), joints_(s.start) {
  renew();
}

int ReaderCore::axis_of(char letter) const {
  if (letter >= 'X' && letter <= 'Z') return letter - 'X';
  if (!machine.has_rotary()) return -1;
  if (letter == machine.outer.letter) return 3;
  return letter == machine.inner.letter ? 4 : -1;
}

AxisValues ReaderCore::to_joints(const AxisValues& program) {
  AxisValues q = program;
  if (framed_) {
    const Vec3 p = frame_.turn * Vec3(q[0], q[1], q[2]) + frame_.origin_mm;
    for (int i = 0; i < 3; ++i) q[static_cast<std::size_t>(i)] = p[i];
  }
  for (std::size_t i = 0; i < 5; ++i) q[i] += offset_[i];
  if (tcp_ || tilted_) {
    const JointPosition j = view_.joints({q[0], q[1], q[2]}, q[3], q[4], length_mm_);
    return {j.x_mm, j.y_mm, j.z_mm, q[3], q[4]};
  }
  q[2] += length_mm_;
  return q;
}

AxisValues ReaderCore::to_program(const AxisValues& joints) {
  AxisValues p = joints;
  if (tcp_ || tilted_) {
    const Vec3 tip = view_.cutter({joints[0], joints[1], joints[2], joints[3], joints[4]}, length_mm_).tip_mm;
    p = {tip.x(), tip.y(), tip.z(), joints[3], joints[4]};
  } else {
    p[2] -= length_mm_;
  }
  for (std::size_t i = 0; i < 5; ++i) p[i] -= offset_[i];
  if (framed_) {
    const Vec3 q = frame_.turn.transpose() * (Vec3(p[0], p[1], p[2]) - frame_.origin_mm);
    for (int i = 0; i < 3; ++i) p[static_cast<std::size_t>(i)] = q[i];
  }
  return p;
}

void ReaderCore::renew() {
  here_ = to_program(joints_);
}

void ReaderCore::pass(const AxisValues& to, bool rapid, double seconds, bool whole) {
  ProgramStep step;
  step.line = line;
  step.block = blocks;
  step.rapid = rapid;
  step.tcp = tcp_;
  step.seconds = seconds;
  step.corner_tolerance_mm = corner_tolerance_mm;
  step.number = length_of;
  int pieces = 1;
  const double turn = std::abs(to[3] - here_[3]) + std::abs(to[4] - here_[4]);
  const AxisValues from = here_;
  const auto at = [&](double t) {
    AxisValues p;
    for (std::size_t i = 0; i < 5; ++i) p[i] = from[i] + t * (to[i] - from[i]);
    return p;
  };
  if (!(turn <= kMostTurn_rad)) reject(1, "the rotary axes turn too far in one block");
  if (tcp_ && turn > 0) {
    // The axes go straight between the points they are given; the tip must not leave its own line meanwhile.
    const int chunks = static_cast<int>(std::min(10000.0, 1 + turn / (5 * kRadPerDegree)));
    double worst = 0;
    for (int i = 0; i < chunks; ++i) {
      const AxisValues a = to_joints(at(static_cast<double>(i) / chunks)), b = to_joints(at((i + 1.0) / chunks)),
                       m = to_joints(at((i + 0.5) / chunks));
      worst = std::max(worst, std::hypot(m[0] - (a[0] + b[0]) / 2, m[1] - (a[1] + b[1]) / 2, m[2] - (a[2] + b[2]) / 2));
    }
    const double finer = std::ceil(std::sqrt(worst / kTipError_mm));
    if (!(finer * chunks <= kMostChords)) reject(1, "the rotary axes turn too far in one block");
    pieces = std::max(1, static_cast<int>(finer)) * chunks;
    if (worst < kTipError_mm && chunks == 1) pieces = 1;
  }
  step.seconds /= pieces;
  for (int i = 1; i <= pieces; ++i) {
    step.whole = whole && i == pieces;
    step.exact_stop = exact_stop && step.whole;
    step.programmed = i == pieces ? to : at(static_cast<double>(i) / pieces);
    step.target = to_joints(step.programmed);
    for (const double q : step.target) {
      if (!(std::abs(q) < 1e7)) reject(1, "a coordinate beyond any machine");
    }
    on_step_(step);
  }
  here_ = to;
  joints_ = step.target;
}

void ReaderCore::move(const AxisValues& to, bool rapid, double seconds) {
  if (tilted_ && !tcp_ && (to[3] != here_[3] || to[4] != here_[4])) {
    if (!std::equal(to.begin(), to.begin() + 3, here_.begin()))
      reject(1, "in a tilted plane the rotary axes turn by themselves");
    AxisValues joints = joints_;
    for (std::size_t i = 3; i < 5; ++i) joints[i] = to[i] + offset_[i];
    return move_joints(joints, rapid, seconds);
  }
  pass(to, rapid, seconds, true);
}

void ReaderCore::move_joints(const AxisValues& to, bool rapid, double seconds) {
  if (tcp_) reject(1, "machine coordinates while tool-centre-point control is on");
  pass(to_program(to), rapid, seconds, true);
}

void ReaderCore::arc(const AxisValues& to, int u, int v, double cu, double cv, double turn, double seconds) {
  const AxisValues from = here_;
  const double r0 = std::hypot(from[u] - cu, from[v] - cv), r1 = std::hypot(to[u] - cu, to[v] - cv),
               r = std::max(r0, r1);
  const double a0 = std::atan2(from[v] - cv, from[u] - cu);
  const double most = r > kChordError_mm ? 2 * std::acos(1 - kChordError_mm / r) : kPi;
  const double wanted = std::ceil(std::abs(turn) / most);
  if (!(wanted <= kMostChords)) reject(1, "the arc is too long");
  const int count = std::max(1, static_cast<int>(wanted));
  for (int n = 1; n <= count; ++n) {
    const double t = static_cast<double>(n) / count, radius = r0 + t * (r1 - r0);
    AxisValues p = to;
    if (n < count) {
      for (std::size_t i = 0; i < 5; ++i) p[i] = from[i] + t * (to[i] - from[i]);
      p[u] = cu + radius * std::cos(a0 + t * turn);
      p[v] = cv + radius * std::sin(a0 + t * turn);
    }
    pass(p, false, seconds / count, n == count);
  }
}

void ReaderCore::curve(const AxisValues& to, int spans, const std::function<AxisValues(double)>& point,
                       double feed_per_min, bool inverse_time) {
  const auto way = [](const AxisValues& a, const AxisValues& b) {
    return std::hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
  };
  const auto between = [](const AxisValues& a, const AxisValues& b, double t) {
    AxisValues p = a;
    for (std::size_t i = 0; i < 5; ++i) p[i] += t * (b[i] - a[i]);
    return p;
  };
  std::vector<AxisValues> chords;
  // Halves a piece until the curve is within the tolerance of its chord, in place and not only in shape.
  const auto halve = [&](auto& self, double t0, const AxisValues& a, double t1, const AxisValues& b, int depth) -> void {
    double off = 0;
    for (const double s : {0.25, 0.5, 0.75}) {
      const AxisValues p = point(t0 + s * (t1 - t0));
      double along = 0, square = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        along += (p[i] - a[i]) * (b[i] - a[i]);
        square += (b[i] - a[i]) * (b[i] - a[i]);
      }
      off = std::max(off, way(p, between(a, b, square > 0 ? std::clamp(along / square, 0.0, 1.0) : 0)));
    }
    if (depth == 0 || off > kChordError_mm) {
      if (depth >= kMostHalvings || chords.size() > kMostChords) reject(1, "the spline is too long");
      const double middle = (t0 + t1) / 2;
      const AxisValues p = point(middle);
      self(self, t0, a, middle, p, depth + 1);
      return self(self, middle, p, t1, b, depth + 1);
    }
    chords.push_back(b);
  };
  AxisValues from = here_;
  for (int i = 0; i < spans; ++i) {
    const AxisValues end = i + 1 == spans ? to : point(i + 1);
    halve(halve, i, from, i + 1, end, 0);
    from = end;
  }
  double length = 0;
  from = here_;
  for (const AxisValues& p : chords) {
    length += way(from, p);
    from = p;
  }
  const double seconds = inverse_time ? 60 / feed_per_min : length * 60 / feed_per_min;
  for (std::size_t i = 0; i < chords.size(); ++i) {
    const double share = length > 0 ? way(here_, chords[i]) / length : 1.0 / static_cast<double>(chords.size());
    pass(chords[i], false, seconds * share, i + 1 == chords.size());
  }
}

void ReaderCore::say(ProgramStep::Kind kind, int number, double value) {
  ProgramStep step;
  step.kind = kind;
  step.line = line;
  step.block = blocks;
  step.number = number;
  if (kind == ProgramStep::kDwell) step.seconds = value;
  if (kind == ProgramStep::kSpindle) step.rpm = value;
  step.target = joints_;
  step.programmed = here_;
  on_step_(step);
}

void ReaderCore::set_offset(const AxisValues& offset) {
  offset_ = offset;
  renew();
}
void ReaderCore::set_length(double length_mm) {
  length_mm_ = length_mm;
  renew();
}
void ReaderCore::set_tcp(bool on) {
  tcp_ = on;
  renew();
}
void ReaderCore::set_frame(const WorkFrame& frame, bool on_work) {
  frame_ = frame;
  framed_ = !frame.is_identity();
  tilted_ = on_work;
  renew();
}

std::vector<RotaryAngles> ReaderCore::angles_for(const Vec3& direction) {
  if (!(direction.norm() > 0)) return {};
  if (!machine.has_rotary()) {
    const Vec3 axis = frame_.turn * direction.normalized();
    return (axis - Vec3::UnitZ()).norm() < kSameAngle_rad ? std::vector<RotaryAngles>{{here_[3], here_[4]}}
                                                          : std::vector<RotaryAngles>{};
  }
  std::vector<RotaryAngles> found =
      detail::angles_for(machine, view_, frame_.turn * direction, {joints_[3], joints_[4]});
  const auto way = [&](const RotaryAngles& a) {
    return std::max(std::abs(a.outer_rad - joints_[3]), std::abs(a.inner_rad - joints_[4]));
  };
  std::stable_sort(found.begin(), found.end(),
                   [&](const RotaryAngles& a, const RotaryAngles& b) { return way(a) < way(b); });
  for (RotaryAngles& angles : found) angles = {angles.outer_rad - offset_[3], angles.inner_rad - offset_[4]};
  return found;
}

void ReaderCore::move_on_great_circle(const AxisValues& to, const Vec3& direction, bool rapid, double seconds) {
  const AxisValues from = here_;
  const Vec3 axis = view_.cutter({0, 0, 0, joints_[3], joints_[4]}, 0).axis;
  const Vec3 before = frame_.turn.transpose() * axis, after = direction.normalized();
  const double turn = std::atan2(before.cross(after).norm(), before.dot(after));
  if (turn > kPi - kOpposite_rad) reject(1, "a turn of the tool to the opposite side has no plane");
  const int pieces = std::max(1, static_cast<int>(std::ceil(turn / kGreatCircleStep_rad)));
  for (int i = 1; i <= pieces; ++i) {
    const double t = static_cast<double>(i) / pieces;
    AxisValues p = to;
    for (std::size_t k = 0; k < 3 && i < pieces; ++k) p[k] = from[k] + t * (to[k] - from[k]);
    const Vec3 there =
        turn > 0 ? Vec3((std::sin((1 - t) * turn) * before + std::sin(t * turn) * after) / std::sin(turn)) : after;
    const RotaryAngles angles = angles_for(there, 1, [](const RotaryAngles&) { return true; });
    p[3] = angles.outer_rad;
    p[4] = angles.inner_rad;
    pass(p, rapid, seconds / pieces, i == pieces);
  }
}

double ReaderCore::tool_length(int number, int column) const {
  if (number == 0) return 0;
  const auto found = setup.tool_length_mm.find(number);
  if (found == setup.tool_length_mm.end())
    reject(column, "tool " + std::to_string(number) + " is not in the tool table");
  return found->second;
}

double ReaderCore::seconds_at(const AxisValues& to, double feed_per_min) const {
  const double linear = std::hypot(to[0] - here_[0], to[1] - here_[1], to[2] - here_[2]);
  const double angular = std::hypot(to[3] - here_[3], to[4] - here_[4]) / kRadPerDegree;
  return (linear > 0 ? linear : angular) * 60 / feed_per_min;
}

void centre_by_radius(double u0, double v0, double u1, double v1, double r, bool clockwise, int column, double& cu,
                      double& cv) {
  const double du = u1 - u0, dv = v1 - v0, chord = std::hypot(du, dv);
  if (chord == 0) reject(column, "an arc by radius needs an end apart from its start");
  double square = 4 * r * r - chord * chord;
  if (square < -1e-3 * chord) reject(column, "the arc's radius is too small to reach its end");
  square = std::max(square, 0.0);
  double h = std::sqrt(square) / (2 * chord);
  if (clockwise != (r < 0)) h = -h;
  cu = u0 + du / 2 - dv * h;
  cv = v0 + dv / 2 + du * h;
}

void split_words(std::string_view line, std::vector<Token>& tokens) {
  constexpr std::size_t kLongestBlock = 200;
  if (line.size() > kLongestBlock) reject(kLongestBlock + 1, "block too long");
  tokens.clear();
  for (std::size_t i = 0; i < line.size() && line[i] != ';';) {
    if (line[i] == ' ' || line[i] == '\t') {
      ++i;
      continue;
    }
    const std::size_t end = std::min(line.find_first_of(" \t;", i), line.size());
    tokens.push_back({line.substr(i, end - i), static_cast<int>(i) + 1});
    i = end;
  }
}

double signed_number(std::string_view text, int column) {
  const char* p = text.data();
  const char* const end = p + text.size();
  const bool negative = p != end && *p == '-';
  if (p != end && (*p == '-' || *p == '+')) ++p;
  double v = 0;
  if (!read_digits(p, end, v) || p != end) reject(column, "bad number format");
  return negative ? -v : v;
}

const AxisValues& datum(const ReaderCore& core, double number, int column) {
  if (!(number >= 1 && number <= 9) || number != std::floor(number)) reject(column, "datums 1 to 9 are known");
  return core.setup.offsets[static_cast<std::size_t>(number) - 1];
}

std::vector<std::string_view> split_lines(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    std::string_view line = text.substr(0, end);
    if (line.ends_with('\r')) line.remove_suffix(1);
    lines.push_back(line);
    if (end == std::string_view::npos) break;
    text.remove_prefix(end + 1);
  }
  return lines;
}

}  // namespace detail

ReaderDialect reader_dialect(std::string_view name) {
  if (name == "linuxcnc") return ReaderDialect::kLinuxCnc;
  if (name == "fanuc") return ReaderDialect::kFanuc;
  if (name == "siemens") return ReaderDialect::kSiemens;
  if (name == "heidenhain") return ReaderDialect::kHeidenhain;
  if (name == "heidenhain_iso") return ReaderDialect::kHeidenhainIso;
  throw InputError("dialect '" + std::string(name) +
                   "' is not read: use linuxcnc, fanuc, siemens, heidenhain or heidenhain_iso");
}

ReadResult read_program(std::string_view text, ReaderDialect dialect, const MachineModel& machine,
                        const ReaderSetup& setup, const std::function<void(const ProgramStep&)>& on_step) {
  detail::ReaderCore core(machine, setup, on_step);
  switch (dialect) {
    case ReaderDialect::kHeidenhain:
      return detail::read_heidenhain(text, core);
    case ReaderDialect::kHeidenhainIso:
      return detail::read_heidenhain_iso(text, core);
    case ReaderDialect::kSiemens:
      return detail::read_siemens(text, core);
    default:
      return detail::read_word_program(text, dialect == ReaderDialect::kFanuc, core);
  }
}

}  // namespace lightmill
