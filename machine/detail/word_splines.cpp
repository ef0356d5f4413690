// Splines of RS274/NGC: G5, G5.1, and G5.2 up to G5.3.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

namespace {
constexpr std::size_t kMostPoints = 10000;
constexpr int kHighestOrder = 20;
}  // namespace

AxisValues WordReader::spline_end() {
  const AxisValues from = path_.place();
  AxisValues to = from;
  for (const int axis : taken_axes()) {
    if (axis > 1) reject(1, "splines move X and Y only");
    const auto i = static_cast<std::size_t>(axis);
    const double v = target_value(axis);
    to[i] = incremental_ ? from[i] + v : v;
  }
  return to;
}

void WordReader::refuse_spline_modes(bool feed_here) const {
  if (path_.on()) reject(1, "splines while cutter compensation is on");
  if (plane_ != 0) reject(1, "splines need G17");
  static_cast<void>(feed(feed_here));
}

/// G5 and G5.1: the inner control points are seen from the start (I, J) and from the end (P, Q).
void WordReader::bezier(bool cubic, bool feed_here) {
  refuse_spline_modes(feed_here);
  const AxisValues from = path_.place(), to = spline_end();
  if (has('I') != has('J') || (!cubic && !has('I'))) reject(1, "I and J belong together in a spline");
  if (cubic && (!has('P') || !has('Q'))) reject(1, "G5 needs P and Q");
  std::vector<ControlPoint> points{{from[0], from[1]}};
  if (has('I')) {
    points.push_back({from[0] + use('I') * unit_, from[1] + use('J') * unit_});
  } else {
    points.push_back({from[0] + spline_direction_[0], from[1] + spline_direction_[1]});
  }
  if (cubic) {
    const double p = use('P') * unit_, q = use('Q') * unit_;
    points.push_back({to[0] + p, to[1] + q});
    spline_direction_ = {-p, -q};
  }
  points.push_back({to[0], to[1]});
  follow_spline(points, cubic ? 4 : 3, to);
}

/// G5.2: one more control point; the first block may give the start's weight.
void WordReader::add_control_point(bool fresh, bool feed_here) {
  refuse_spline_modes(feed_here);
  if (fresh) control_points_.clear();
  const bool first = control_points_.empty(), x = has('X'), y = has('Y');
  if (x != y) reject(1, "a control point needs X and Y");
  const double weight = has('P') ? use('P') : -1;
  if (!first && !(weight > 0)) reject(1, "a control point needs a positive weight P");
  if (!first && !x) reject(1, "P alone is for the first control point");
  if (x && !(weight > 0)) reject(1, "a control point needs a positive weight P");
  if (first) {
    spline_order_ = 3;
    const AxisValues from = path_.place();
    control_points_.push_back({from[0], from[1], !x && weight > 0 ? weight : 1});
  }
  if (has('L')) {
    const double l = use('L');
    if (l != std::floor(l) || l > kHighestOrder) reject(column_of('L'), "L is the spline's order");
    if (l > 3) spline_order_ = static_cast<int>(l);
  }
  if (!x) return;
  const AxisValues to = spline_end();
  if (control_points_.size() >= kMostPoints) reject(1, "a spline with too many control points");
  control_points_.push_back({to[0], to[1], weight});
}

/// G5.3.
void WordReader::end_spline(bool after_points) {
  if (!after_points) reject(1, "G5.3 without G5.2 before it");
  if (control_points_.size() < static_cast<std::size_t>(spline_order_))
    reject(1, "a spline of order " + std::to_string(spline_order_) + " needs as many control points");
  AxisValues to = path_.place();
  to[0] = control_points_.back().x;
  to[1] = control_points_.back().y;
  follow_spline(control_points_, spline_order_, to);
  control_points_.clear();
}

void WordReader::follow_spline(const std::vector<ControlPoint>& points, int order, const AxisValues& to) {
  path_.allow_arcs();
  const Feed given = feed();
  AxisValues at = path_.place();
  path_.forget_lead();
  core_.curve(
      to, static_cast<int>(points.size()) - order + 1,
      [&](double t) {
        const auto [x, y] = spline_point(points, order, t);
        at[0] = x;
        at[1] = y;
        return at;
      },
      given.value, given.inverse_time);
}

}  // namespace lightmill::detail
