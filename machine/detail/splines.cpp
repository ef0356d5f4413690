#include "machine/detail/splines.h"

#include <algorithm>
#include <cmath>

namespace lightmill::detail {

std::array<double, 2> spline_point(const std::vector<ControlPoint>& points, int order, double t) {
  const int degree = order - 1, spans = static_cast<int>(points.size()) - degree;
  const int span = std::clamp(static_cast<int>(std::floor(t)), 0, spans - 1);
  const auto knot = [&](int i) { return static_cast<double>(std::clamp(i - degree, 0, spans)); };
  struct Weighted {
    double x, y, w;
  };
  std::vector<Weighted> p;
  for (int i = span; i <= span + degree; ++i) {
    const ControlPoint& c = points[static_cast<std::size_t>(i)];
    p.push_back({c.x * c.weight, c.y * c.weight, c.weight});
  }
  for (int level = 1; level <= degree; ++level) {
    for (int i = degree; i >= level; --i) {
      const double from = knot(span + i), to = knot(span + i + degree - level + 1), s = (t - from) / (to - from);
      Weighted& q = p[static_cast<std::size_t>(i)];
      const Weighted& o = p[static_cast<std::size_t>(i) - 1];
      q = {o.x + s * (q.x - o.x), o.y + s * (q.y - o.y), o.w + s * (q.w - o.w)};
    }
  }
  return {p.back().x / p.back().w, p.back().y / p.back().w};
}

}  // namespace lightmill::detail
