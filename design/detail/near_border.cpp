#include "design/detail/near_border.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace lightmill::detail {

namespace {

struct Way {
  double length = 0;
  bool inside = false;  // meets the segment's inside
  Vec2 way;
};

Way way_to(const Segment& segment, const Vec2& point) {
  const Vec2 along = segment[1] - segment[0];
  const double length2 = along.squaredNorm();
  const double t = length2 > 0 ? (point - segment[0]).dot(along) / length2 : 0;
  const Vec2 way = segment[0] + std::clamp(t, 0.0, 1.0) * along - point;
  return {way.norm(), t >= 0 && t <= 1, way};
}

}  // namespace

NearBorder::NearBorder(std::vector<Segment> segments, double reach) : segments_(std::move(segments)), reach_(reach) {
  for (const Segment& s : segments_) {
    for (const Vec2& end : s) box_.include(end);
  }
  if (!segments_.empty()) {
    constexpr int kMostBuckets = 1024;
    pitch_ = std::max(reach, box_.size().maxCoeff() / kMostBuckets);
    columns_ = static_cast<int>(box_.size().x() / pitch_) + 1;
    rows_ = static_cast<int>(box_.size().y() / pitch_) + 1;
  }
  buckets_.resize(static_cast<std::size_t>(columns_) * rows_);
  for (std::size_t s = 0; s < segments_.size(); ++s) {
    const Vec2 low = segments_[s][0].cwiseMin(segments_[s][1]).array() - reach;
    const Vec2 high = segments_[s][0].cwiseMax(segments_[s][1]).array() + reach;
    for (int j = row(low.y()); j <= row(high.y()); ++j) {
      for (int i = column(low.x()); i <= column(high.x()); ++i)
        buckets_[j * columns_ + i].push_back(static_cast<int>(s));
    }
  }
}

int NearBorder::column(double x) const {
  return static_cast<int>(std::clamp((x - box_.min.x()) / pitch_, 0.0, columns_ - 1.0));
}

int NearBorder::row(double y) const {
  return static_cast<int>(std::clamp((y - box_.min.y()) / pitch_, 0.0, rows_ - 1.0));
}

const std::vector<int>& NearBorder::bucket(const Vec2& point) const {
  return buckets_[row(point.y()) * columns_ + column(point.x())];
}

bool NearBorder::near(const Vec2& point) const {
  return !segments_.empty() && std::any_of(bucket(point).begin(), bucket(point).end(),
                                           [&](int s) { return way_to(segments_[s], point).length < reach_; });
}

std::vector<Vec2> NearBorder::ways(const Vec2& point, double reach) const {
  if (segments_.empty()) return {};
  std::vector<Way> candidates;
  for (int s : bucket(point)) {
    const Way way = way_to(segments_[s], point);
    if (way.length < reach) candidates.push_back(way);
  }
  std::sort(candidates.begin(), candidates.end(), [](const Way& a, const Way& b) { return a.length < b.length; });
  std::vector<Vec2> result;
  for (const Way& c : candidates) {
    bool fresh = c.length > 0;
    for (const Vec2& other : result) fresh &= c.inside && c.way.dot(other) < std::sqrt(0.5) * c.length * other.norm();
    if (fresh) result.push_back(c.way);
  }
  return result;
}

}  // namespace lightmill::detail
