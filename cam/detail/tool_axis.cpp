#include "cam/detail/tool_axis.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill::detail {

namespace {

constexpr double kDegree = kPi / 180;

std::string degrees(double rad) {
  return fixed(rad / kDegree, 1);
}

/// The normals of the surface, those that differ by less than 0.003 in slope as one.
std::vector<Vec3> distinct_normals(const SplineSurface& surface, const OutlineRegion* within) {
  constexpr double kBin = 0.003;
  const Box2& extent = surface.extent();
  const int nx = std::clamp(surface.spans_x() * 2, 16, 2000);
  const int ny = std::clamp(surface.spans_y() * 2, 16, 2000);
  std::vector<std::pair<int, int>> bins;
  for (int j = 0; j <= ny; ++j) {
    for (int i = 0; i <= nx; ++i) {
      const Vec2 p = extent.min + extent.size().cwiseProduct(Vec2(i, j)).cwiseQuotient(Vec2(nx, ny));
      if (within && !within->contains(p)) continue;
      const auto s = surface.sample(p.x(), p.y());
      const std::pair<int, int> bin(static_cast<int>(std::lround(s.hx / kBin)),
                                    static_cast<int>(std::lround(s.hy / kBin)));
      if (bins.empty() || bins.back() != bin) bins.push_back(bin);
    }
    if (j % 64 == 0 || j == ny) {
      std::sort(bins.begin(), bins.end());
      bins.erase(std::unique(bins.begin(), bins.end()), bins.end());
    }
  }
  std::vector<Vec3> normals;
  for (const auto& [hx, hy] : bins) normals.push_back(Vec3(-hx * kBin, -hy * kBin, 1).normalized());
  return normals;
}

double steepest_of(const std::vector<Vec3>& normals) {
  double least = 1;
  for (const Vec3& n : normals) least = std::min(least, n.z());
  return std::acos(least);
}

}  // namespace

Vec3 FixedTilt::axis() const {
  return {std::sin(tilt_rad) * std::cos(direction_rad), std::sin(tilt_rad) * std::sin(direction_rad),
          std::cos(tilt_rad)};
}

std::vector<FixedTilt> fixed_tilts(const SplineSurface& surface, double tilt_rad, double direction_rad,
                                   const OutlineRegion* within) {
  const std::vector<Vec3> normals = distinct_normals(surface, within);
  const auto measured = [&](double tilt, double direction) {
    FixedTilt t{tilt, direction, 0, 0};
    const Vec3 axis = t.axis();
    double least = 1, most = -1;
    for (const Vec3& n : normals) {
      const double c = n.dot(axis);
      least = std::min(least, c);
      most = std::max(most, c);
    }
    t.least_contact_rad = std::acos(std::clamp(most, -1.0, 1.0));
    t.most_contact_rad = std::acos(std::clamp(least, -1.0, 1.0));
    return t;
  };
  const auto keeps = [](const FixedTilt& t) {
    return t.least_contact_rad >= kLeastContactAngle && t.most_contact_rad <= kMostContactAngle;
  };
  std::vector<FixedTilt> found;
  const FixedTilt wished = measured(tilt_rad, direction_rad);
  if (keeps(wished)) found.push_back(wished);
  std::vector<std::pair<double, FixedTilt>> others;
  for (int dt = -20; dt <= 20; ++dt) {
    const double tilt = tilt_rad + dt * kDegree;
    if (tilt < 12 * kDegree || tilt > 50 * kDegree) continue;
    for (int dd = -12; dd < 12; ++dd) {
      if (dt == 0 && dd == 0) continue;
      const FixedTilt t = measured(tilt, direction_rad + dd * 15 * kDegree);
      if (keeps(t)) others.emplace_back(std::abs(dt) + std::abs(dd), t);
    }
  }
  std::stable_sort(others.begin(), others.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [cost, t] : others) found.push_back(t);
  if (found.empty()) {
    throw InputError("finish.axis: no fixed tilt keeps the ball's contact between " + degrees(kLeastContactAngle) +
                     " and " + degrees(kMostContactAngle) + " degrees from the axis; the surface is up to " +
                     degrees(steepest_of(normals)) + " degrees steep, and " + degrees(tilt_rad) +
                     " degrees of tilt give " + degrees(wished.least_contact_rad) + " to " +
                     degrees(wished.most_contact_rad) +
                     "; use axis = \"lead_tilt\", or a longer focal distance or a smaller picture");
  }
  return found;
}

LeadField::LeadField(const SplineSurface& surface, double lead_rad, const Vec2& along, const OutlineRegion* within)
    : lead_(lead_rad), along_(along) {
  constexpr double kSigmaMm = 3;
  constexpr double kPitchMm = 0.5;
  constexpr double kMarginMm = 6;
  const Box2& extent = surface.extent();
  pitch_ = kPitchMm;
  first_ = extent.min - Vec2::Constant(kMarginMm);
  const int nx = static_cast<int>(std::ceil((extent.size().x() + 2 * kMarginMm) / kPitchMm)) + 1;
  const int ny = static_cast<int>(std::ceil((extent.size().y() + 2 * kMarginMm) / kPitchMm)) + 1;
  slopes_ = Grid<Vec2>(nx, ny, Vec2::Zero());
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      // Beyond the border the slope of the border.
      const double x = std::clamp(first_.x() + i * pitch_, extent.min.x(), extent.max.x());
      const double y = std::clamp(first_.y() + j * pitch_, extent.min.y(), extent.max.y());
      const auto s = surface.sample(x, y);
      slopes_.at(i, j) = {s.hx, s.hy};
    }
  }
  // Gaussian low-pass, one direction after the other, the border value going on.
  const int half = static_cast<int>(std::ceil(3 * kSigmaMm / kPitchMm));
  std::vector<double> kernel(2 * half + 1);
  double sum = 0;
  for (int k = -half; k <= half; ++k) {
    const double t = k * kPitchMm / kSigmaMm;
    sum += kernel[k + half] = std::exp(-t * t / 2);
  }
  for (double& k : kernel) k /= sum;
  Grid<Vec2> turned(nx, ny, Vec2::Zero());
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      Vec2 value = Vec2::Zero();
      for (int k = -half; k <= half; ++k) value += kernel[k + half] * slopes_.at(std::clamp(i + k, 0, nx - 1), j);
      turned.at(i, j) = value;
    }
  }
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      Vec2 value = Vec2::Zero();
      for (int k = -half; k <= half; ++k) value += kernel[k + half] * turned.at(i, std::clamp(j + k, 0, ny - 1));
      slopes_.at(i, j) = value;
    }
  }

  // The least lead that keeps the window everywhere and stays clear of the pole, where a rotary table would spin.
  constexpr double kLeastFromVertical = 5 * kDegree;
  const int sx = std::clamp(surface.spans_x(), 16, 800);
  const int sy = std::clamp(surface.spans_y(), 16, 800);
  std::string why;
  for (int raise = 0; raise <= 15; ++raise) {
    lead_ = lead_rad + raise * kDegree;
    double least = kPi, most = 0, upright = kPi;
    for (int j = 0; j <= sy; ++j) {
      for (int i = 0; i <= sx; ++i) {
        const double x = extent.min.x() + extent.size().x() * i / sx;
        const double y = extent.min.y() + extent.size().y() * j / sy;
        if (within && !within->contains({x, y})) continue;
        const Vec3 a = axis(x, y);
        const double contact = std::acos(std::clamp(a.dot(surface.normal(x, y)), -1.0, 1.0));
        least = std::min(least, contact);
        most = std::max(most, contact);
        upright = std::min(upright, std::acos(std::clamp(a.z(), -1.0, 1.0)));
      }
    }
    if (least >= kLeastContactAngle && most <= kMostContactAngle && upright >= kLeastFromVertical) return;
    if (raise == 0) {
      why = "a lead of " + degrees(lead_) + " degrees gives contact angles from " + degrees(least) + " to " +
            degrees(most) + " degrees and an axis down to " + degrees(upright) + " degrees from vertical";
    }
  }
  throw InputError("finish.axis: no lead keeps the ball's contact between " + degrees(kLeastContactAngle) + " and " +
                   degrees(kMostContactAngle) + " degrees and the axis " + degrees(kLeastFromVertical) +
                   " degrees from vertical (" + why + "); use axis = \"fixed\", or a longer focal distance");
}

Vec2 LeadField::slope(double x, double y) const {
  const double u = std::clamp((x - first_.x()) / pitch_, 0.0, slopes_.width - 1.001);
  const double v = std::clamp((y - first_.y()) / pitch_, 0.0, slopes_.height - 1.001);
  const int i = static_cast<int>(u);
  const int j = static_cast<int>(v);
  const double a = u - i;
  const double b = v - j;
  return (1 - b) * ((1 - a) * slopes_.at(i, j) + a * slopes_.at(i + 1, j)) +
         b * ((1 - a) * slopes_.at(i, j + 1) + a * slopes_.at(i + 1, j + 1));
}

Vec3 LeadField::axis(double x, double y) const {
  const Vec2 g = slope(x, y);
  const Vec3 normal = Vec3(-g.x(), -g.y(), 1).normalized();
  const Vec3 forward = Vec3(along_.x(), along_.y(), g.dot(along_)).normalized();  // along the pass, in the surface
  return (std::cos(lead_) * normal + std::sin(lead_) * forward).normalized();
}

}  // namespace lightmill::detail
