// Offsets, lengths, moves and arcs of RS274/NGC and Fanuc.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

void WordReader::renew_offset() {
  AxisValues sum = offsets_[offset_];
  for (std::size_t i = 0; i < 5; ++i) sum[i] += shift_[i] + local_shift_[i];
  core_.set_offset(sum);
}

/// G40, G41, G42, G41.1, G42.1.
void WordReader::set_compensation(int tenths) {
  if (tenths == 400) return path_.leave();
  if (path_.on()) reject(1, "cutter compensation is on already");
  if (plane_ == 2) reject(1, "cutter compensation needs G17 or G18");
  double diameter = 0;
  if (tenths % 10 == 1) {
    diameter = need('D', "G41.1 and G42.1") * unit_;
    if (has('L')) {
      if (plane_ != 1) reject(column_of('L'), "L beside a diameter needs G18");
      const double l = use('L');
      if (l != 0 && l != 9) reject(column_of('L'), "orientations of lathe tools are not for this machine");
    }
  } else {
    if (has('L')) use('L');  // as the control does
    const double d = has('D') ? use('D') : 0;
    if (d != std::floor(d) || d < 0 || d > 99999) reject(column_of('D'), "D names a tool");
    const int number = d == 0 ? tool_ : static_cast<int>(d);
    const auto found = core_.setup.tool_diameter_mm.find(number);
    if (number != 0 && found == core_.setup.tool_diameter_mm.end())
      reject(d == 0 ? 1 : column_of('D'), "tool " + std::to_string(number) + " has no diameter in the tool table");
    if (number != 0) diameter = found->second;
  }
  const int side = (tenths / 10 == 41) == (diameter >= 0) ? 1 : -1;
  const AxisValues from = path_.place();
  path_.start(side, std::abs(diameter) / 2, kPlanes[plane_][0], kPlanes[plane_][1], from);
}

/// G54.1 P: the offset's place behind the others.
int WordReader::more_offset() {
  const double p = need('P', "G54.1");
  if (!(p >= 1 && p <= kMoreOffsets) || p != std::floor(p)) reject(column_of('P'), "G54.1 takes P1 to P48");
  return 8 + static_cast<int>(p);
}

/// G43, G43.1, G43.2, G43.4, G49; true if the axis words are its own.
bool WordReader::set_length(int tenths) {
  if (tenths == 490) {
    core_.set_tcp(false);
    core_.set_length(0);
    core_.length_of = 0;
    directions_ = false;
    return false;
  }
  if (tenths == 431) {
    core_.set_length(need('Z', "G43.1") * unit_);
    core_.length_of = 0;
    return true;
  }
  double h = tool_;
  if (has('H'))
    h = use('H');
  else if (fanuc_ || tenths == 432)
    reject(1, "G43 needs H");
  if (h != std::floor(h) || h < 0 || h > 99999) reject(column_of('H'), "H names a tool");
  const double length = core_.tool_length(static_cast<int>(h), column_of('H'));
  core_.set_length(tenths == 432 ? core_.length_mm() + length : length);
  if (tenths != 432) core_.length_of = static_cast<int>(h);  // G43.2 adds what has worn
  directions_ = tenths == 435;
  if (fanuc_) core_.set_tcp(tenths >= 434);
  return false;
}

/// G10, G28, G30, G92 and its likes; true if the axis words are its own.
bool WordReader::shift(int tenths) {
  switch (tenths) {
    case 100:
      set_data();
      return true;
    case 280:
    case 300:
      reference(references_[tenths == 300]);
      return true;
    case 281:
    case 301:
      references_[tenths == 301] = core_.joints();
      return false;
    case 520: {
      AxisValues& local = fanuc_ ? local_shift_ : shift_;
      for (const int axis : taken_axes()) local[static_cast<std::size_t>(axis)] = target_value(axis);
      renew_offset();
      return true;
    }
    case 920:
      for (const int axis : taken_axes()) {
        const auto i = static_cast<std::size_t>(axis);
        shift_[i] += path_.place()[i] - target_value(axis);
      }
      renew_offset();
      return true;
    case 921:
    case 922:
      if (fanuc_) {  // names the axes, with zeros
        for (const int axis : taken_axes()) {
          if (target_value(axis) != 0) reject(1, "G92.1 takes its axes with 0");
          shift_[static_cast<std::size_t>(axis)] = local_shift_[static_cast<std::size_t>(axis)] = 0;
        }
        renew_offset();
        return true;
      }
      kept_shift_ = tenths == 922 ? shift_ : AxisValues{};
      shift_ = {};
      renew_offset();
      return false;
    case 923:
      shift_ = kept_shift_;
      renew_offset();
      return false;
    default:
      return false;
  }
}

std::vector<int> WordReader::taken_axes() {
  std::vector<int> axes;
  for (std::uint32_t rest = words_ & axis_letters_; rest != 0; rest &= rest - 1)
    axes.push_back(core_.axis_of(static_cast<char>('A' + std::countr_zero(rest))));
  return axes;
}

double WordReader::target_value(int axis) {
  const char letter = axis < 3    ? static_cast<char>('X' + axis)
                      : axis == 3 ? core_.machine.outer.letter
                                  : core_.machine.inner.letter;
  return use(letter) * scale(axis);
}

/// X and Y of the words @ and ^ about the program's zero; under G91 they add to where the machine stands.
std::pair<double, double> WordReader::polar_end() {
  if (plane_ != 0) reject(polar_column_, "polar words need G17");
  if (has('X') || has('Y')) reject(polar_column_, "polar words beside X or Y");
  const double x = path_.place()[0], y = path_.place()[1];
  const bool at_zero = std::hypot(x, y) < 1e-9;
  if (at_zero && (incremental_ || !polar_angle_ || !polar_radius_)) {
    reject(polar_column_, "at zero a polar word has no radius or angle to start from");
  }
  double radius = std::hypot(x, y), angle = std::atan2(y, x);
  if (polar_radius_) radius = *polar_radius_ * unit_ + (incremental_ ? radius : 0);
  if (polar_angle_) angle = *polar_angle_ * kRadPerDegree + (incremental_ ? angle : 0);
  return {radius * std::cos(angle), radius * std::sin(angle)};
}

void WordReader::set_data() {
  const double l = need('L', "G10"), p = need('P', "G10 L2");
  if (fanuc_) return set_fanuc_offset(l, p);
  if ((l != 2 && l != 20) || p < 0 || p > 9 || p != std::floor(p))
    reject(column_of('L'), "G10 is understood with L2 and L20, P0 to P9");
  const std::size_t system = p == 0 ? offset_ : static_cast<std::size_t>(p) - 1;
  for (const int axis : taken_axes()) {
    const double v = target_value(axis);
    const double machine = core_.joints()[static_cast<std::size_t>(axis)] - (axis == 2 ? core_.length_mm() : 0);
    offsets_[system][static_cast<std::size_t>(axis)] =
        l == 2 ? v : machine - v - shift_[static_cast<std::size_t>(axis)];
  }
  renew_offset();
}

/// G10 L2 P1 to P6, L20 P1 to P48; under G91 the words add up.
void WordReader::set_fanuc_offset(double l, double p) {
  const double most = l == 2 ? 6 : l == 20 ? kMoreOffsets : 0;
  if (!(p >= 1 && p <= most) || p != std::floor(p))
    reject(column_of('L'), "G10 is understood with L2 P1 to P6 and L20 P1 to P48");
  AxisValues& system = offsets_[static_cast<std::size_t>(p) - 1 + (l == 20 ? 9 : 0)];
  for (const int axis : taken_axes()) {
    double& offset = system[static_cast<std::size_t>(axis)];
    const double v = target_value(axis);
    offset = incremental_ ? offset + v : v;
  }
  renew_offset();
}

/// G28, G30: through the point named to the reference point.
void WordReader::reference(const AxisValues& point) {
  const auto axes = taken_axes();
  if (core_.tcp()) reject(1, "reference move while tool-centre-point control is on");
  AxisValues via = path_.place();
  path_.forget_lead();
  for (const int axis : axes) {
    const double v = target_value(axis);
    via[static_cast<std::size_t>(axis)] = incremental_ ? via[static_cast<std::size_t>(axis)] + v : v;
  }
  if (!axes.empty() || via != core_.here()) core_.move(via, true, 0);
  AxisValues home = core_.joints();
  for (int axis = 0; axis < 5; ++axis) {
    if (axes.empty() || std::find(axes.begin(), axes.end(), axis) != axes.end())
      home[static_cast<std::size_t>(axis)] = point[static_cast<std::size_t>(axis)];
  }
  core_.move_joints(home, true, 0);
}

void WordReader::move(bool machine_coordinates, bool feed_here) {
  AxisValues to = path_.place();
  const std::uint32_t named = words_ & axis_letters_;
  if (machine_coordinates) {
    if (motion_ > 10) reject(1, "G53 needs G0 or G1");
    if (path_.on()) reject(1, "G53 while cutter compensation is on");
    to = core_.joints();
    for (std::size_t i = 0; i < 3; ++i) to[i] += path_.lead()[i];
  }
  if (motion_ >= 730 && motion_ != 800) return drill();
  last_cycle_ = -1;
  if (motion_ == 50 || motion_ == 51) return bezier(motion_ == 50, feed_here);
  if (motion_ >= 382 && motion_ <= 385) return probe();
  if (polar()) {
    if (machine_coordinates) reject(polar_column_, "polar words name no machine coordinates");
    const auto [x, y] = polar_end();
    to[0] = x;
    to[1] = y;
  }
  for (const int axis : taken_axes()) {
    const double v = target_value(axis);
    to[static_cast<std::size_t>(axis)] =
        incremental_ && !machine_coordinates ? to[static_cast<std::size_t>(axis)] + v : v;
  }
  if (motion_ < 0 || motion_ == 800) reject(1, "axis words while motion is cancelled");
  const Feed given = motion_ == 0 ? Feed{} : feed(feed_here);
  if (directions_) {
    if (motion_ > 10) reject(1, "an arc while tool directions are given by vectors");
    turn_to_direction(to);
  }
  if (motion_ <= 10) {
    if (machine_coordinates) {
      const double seconds = motion_ == 0 ? 0 : given.inverse_time ? 60 / given.value : core_.seconds_at(to, given.value);
      path_.forget_lead();
      return core_.move_joints(to, motion_ == 0, seconds);
    }
    return path_.straight(to, motion_ == 0, given);
  }
  arc(to, named);
}

void WordReader::arc(const AxisValues& to, std::uint32_t named) {
  const int u = kPlanes[plane_][0], v = kPlanes[plane_][1];
  const AxisValues from = path_.place();
  const bool clockwise = motion_ == 20;
  double cu = 0, cv = 0, extra_turns = 0;
  if (has('P')) {
    extra_turns = use('P') - 1;
    if (extra_turns < 0 || extra_turns > 1000 || extra_turns != std::floor(extra_turns))
      reject(column_of('P'), "P counts an arc's turns");
  }
  if (has('R')) {
    if ((named & (bit(static_cast<char>('X' + u)) | bit(static_cast<char>('X' + v)))) == 0)
      reject(1, "no axis word in the arc's plane");
    centre_by_radius(from[u], from[v], to[u], to[v], use('R') * unit_, clockwise, column_of('R'), cu, cv);
  } else {
    const char iu = static_cast<char>('I' + u), iv = static_cast<char>('I' + v);
    if (!has(iu) && !has(iv)) reject(1, "arc without centre or radius");
    if (centre_absolute_ && (!has(iu) || !has(iv))) reject(1, "an absolute centre needs both words");
    cu = (has(iu) ? use(iu) * unit_ : 0) + (centre_absolute_ ? 0 : from[u]);
    cv = (has(iv) ? use(iv) * unit_ : 0) + (centre_absolute_ ? 0 : from[v]);
    const double r0 = std::hypot(from[u] - cu, from[v] - cv), r1 = std::hypot(to[u] - cu, to[v] - cv),
                 off = std::abs(r1 - r0);
    if (r0 == 0 || off > 0.5 || (off > 0.005 && off > 0.001 * r0)) reject(1, "the arc's ends do not fit its centre");
  }
  double turn = turn_between(std::atan2(from[v] - cv, from[u] - cu), std::atan2(to[v] - cv, to[u] - cu), clockwise);
  turn += (clockwise ? -2 : 2) * kPi * extra_turns;
  path_.arc(to, u, v, cu, cv, turn, feed());
}

}  // namespace lightmill::detail
