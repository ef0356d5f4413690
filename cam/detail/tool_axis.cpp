#include "cam/detail/tool_axis.h"

#include <Eigen/Geometry>

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

constexpr int kGivesWayDegrees = 20;

/// The lean asked for, then others by how little they differ from it, up to so many degrees.
std::vector<Lean> leans_around(double angle_rad, double direction_rad, int step_degrees, int most_degrees = kGivesWayDegrees) {
  std::vector<std::pair<int, Lean>> others;
  for (int da = -most_degrees; da <= most_degrees; da += step_degrees) {
    const double angle = angle_rad + da * kDegree;
    if (angle < 12 * kDegree || angle > 50 * kDegree) continue;
    for (int dd = -12; dd < 12; ++dd) {
      if (da != 0 || dd != 0) others.push_back({std::abs(da) + std::abs(dd), {angle, direction_rad + dd * 15 * kDegree}});
    }
  }
  std::stable_sort(others.begin(), others.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<Lean> leans{{angle_rad, direction_rad}};
  for (const auto& [cost, lean] : others) leans.push_back(lean);
  return leans;
}

bool keeps_window(const Lean& lean) {
  constexpr double kRounding = 0.0022;  // of slopes in bins
  return lean.least_contact_rad >= kLeastContactAngle + kRounding && lean.most_contact_rad <= kMostContactAngle - kRounding;
}

void set_contact(Lean& lean, double least_cosine, double most_cosine) {
  lean.least_contact_rad = std::acos(std::clamp(most_cosine, -1.0, 1.0));
  lean.most_contact_rad = std::acos(std::clamp(least_cosine, -1.0, 1.0));
}

}  // namespace

Vec3 fixed_axis(const Lean& lean) {
  return {std::sin(lean.angle_rad) * std::cos(lean.direction_rad), std::sin(lean.angle_rad) * std::sin(lean.direction_rad),
          std::cos(lean.angle_rad)};
}

std::vector<Lean> fixed_tilts(const SplineSurface& surface, double tilt_rad, double direction_rad,
                              const OutlineRegion* within, const std::string& pass) {
  const std::vector<Vec3> normals = distinct_normals(surface, within);
  const auto measured = [&](std::vector<Lean> leans) {
    for (Lean& lean : leans) {
      const Vec3 axis = fixed_axis(lean);
      double least = 1, most = -1;
      for (const Vec3& n : normals) {
        const double c = n.dot(axis);
        least = std::min(least, c);
        most = std::max(most, c);
      }
      set_contact(lean, least, most);
    }
    return leans;
  };
  std::vector<Lean> leans = measured(leans_around(tilt_rad, direction_rad, 1));
  const Lean wished = leans.front();
  std::erase_if(leans, [](const Lean& lean) { return !keeps_window(lean); });
  if (leans.empty()) {
    constexpr int kAnyDegrees = 90;
    const std::vector<Lean> farther = measured(leans_around(tilt_rad, direction_rad, 1, kAnyDegrees));
    const auto would_do = std::find_if(farther.begin(), farther.end(), keeps_window);
    std::string remedy = "use axis = \"lead_tilt\", or a longer focal distance or a smaller picture";
    if (would_do != farther.end()) {
      const double turn = would_do->direction_rad - direction_rad;
      remedy = std::string("use ") + (would_do->angle_rad < tilt_rad ? "less" : "more") + " tilt: " + pass + ".tilt_deg = " + degrees(would_do->angle_rad) +
               " would do" + (std::abs(turn) > 1e-9 ? " with tilt_direction_deg changed by " + degrees(turn) : "");
    }
    throw InputError(pass + ".axis: no fixed tilt within " + std::to_string(kGivesWayDegrees) + " degrees of the one asked for keeps the ball's contact between " +
                     degrees(kLeastContactAngle) + " and " + degrees(kMostContactAngle) + " degrees from the axis; the surface is up to " +
                     degrees(steepest_of(normals)) + " degrees steep, and " + degrees(tilt_rad) +
                     " degrees of tilt give " + degrees(wished.least_contact_rad) + " to " +
                     degrees(wished.most_contact_rad) + "; " + remedy);
  }
  return leans;
}

LeadField::LeadField(const SplineSurface& surface, const Vec2& along) : surface_(surface), along_(along) {
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
}

std::vector<Lean> LeadField::leans(double angle_rad, double direction_rad, const OutlineRegion* within, const std::string& pass) const {
  constexpr double kLeastFromVertical = 5 * kDegree;
  constexpr int kStepDegrees = 4;
  constexpr std::size_t kMostFound = 12;
  const Box2& extent = surface_.extent();
  const int nx = std::clamp(surface_.spans_x(), 16, 800);
  const int ny = std::clamp(surface_.spans_y(), 16, 800);
  std::vector<std::pair<Vec3, Vec2>> places;  // normal, and the slope that the axis follows
  for (int j = 0; j <= ny; ++j) {
    for (int i = 0; i <= nx; ++i) {
      const Vec2 p = extent.min + extent.size().cwiseProduct(Vec2(i, j)).cwiseQuotient(Vec2(nx, ny));
      if (!within || within->contains(p)) places.emplace_back(surface_.normal(p.x(), p.y()), slope(p.x(), p.y()));
    }
  }
  std::vector<Lean> found;
  std::string wished;
  for (Lean lean : leans_around(angle_rad, direction_rad, kStepDegrees)) {
    double least = 1, most = -1, upright = -1;
    for (const auto& [normal, followed] : places) {
      const Vec3 a = axis(followed, lean);
      const double c = normal.dot(a);
      least = std::min(least, c);
      most = std::max(most, c);
      upright = std::max(upright, a.z());
    }
    set_contact(lean, least, most);
    const double from_vertical = std::acos(std::clamp(upright, -1.0, 1.0));
    if (wished.empty()) {
      wished = "a lean of " + degrees(angle_rad) + " degrees gives contact angles from " + degrees(lean.least_contact_rad) + " to " +
               degrees(lean.most_contact_rad) + " degrees and an axis down to " + degrees(from_vertical) + " degrees from vertical";
    }
    if (keeps_window(lean) && from_vertical >= kLeastFromVertical) found.push_back(lean);
    if (found.size() == kMostFound) break;
  }
  if (found.empty()) {
    throw InputError(pass + ".axis: no lean from the normal keeps the ball's contact between " + degrees(kLeastContactAngle) +
                     " and " + degrees(kMostContactAngle) + " degrees and the axis " + degrees(kLeastFromVertical) +
                     " degrees from vertical (" + wished + "); use axis = \"fixed\", or a longer focal distance");
  }
  return found;
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

Vec3 LeadField::axis(const Vec2& slope, const Lean& lean) const {
  const Vec3 normal = Vec3(-slope.x(), -slope.y(), 1).normalized();
  const Vec3 forward = Vec3(along_.x(), along_.y(), slope.dot(along_)).normalized();  // along the pass, in the surface
  const Vec3 towards = std::cos(lean.direction_rad) * forward + std::sin(lean.direction_rad) * normal.cross(forward);
  return std::cos(lean.angle_rad) * normal + std::sin(lean.angle_rad) * towards;
}

Vec3 LeadField::axis(double x, double y, const Lean& lean) const {
  return axis(slope(x, y), lean);
}

}  // namespace lightmill::detail
