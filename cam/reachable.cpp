#include "cam/reachable.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "cam/detail/ball_contact.h"
#include "cam/detail/spline_hull.h"
#include "cam/outline_region.h"
#include "design/core/parallel.h"

namespace lightmill {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// A ball that touches the surface at a point and must be lifted by less than this to touch nowhere else has reached the
// point: 0.02 um, a tenth of what the result promises.
constexpr double kReachedMm = 2e-5;
// The search for the lowest ball over a point ends when the model promises less than this: 0.005 um.
constexpr double kGainMm = 5e-6;

// ------------------------------------------------------------------------------------------------------------------
// Where the ball fits everywhere.

/// Says whether a region has no place where the surface is too hollow for the ball.
class HollowMap {
 public:
  /// Of regions that lie at most 2 R outside the lens.
  HollowMap(const SplineSurface& surface, double radius_mm) : hull_(surface, 2 * radius_mm) {
    const int nx = hull_.cells_x(), ny = hull_.cells_y();
    sums_ = Grid<int>(nx + 1, ny + 1, 0);
    std::vector<double> steepest2(ny, 0);
    Grid<unsigned char> hollow(nx, ny, 0);
    parallel_blocks(ny, 8, [&](std::size_t begin, std::size_t end) {
      for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
        for (int i = 0; i < nx; ++i) {
          const auto slopes = hull_.slopes(i, j);
          const double hx = slopes.x.magnitude(), hy = slopes.y.magnitude();
          steepest2[j] = std::max(steepest2[j], hx * hx + hy * hy);
          // The largest eigenvalue of the Hessian grows with hxx, hyy and |hxy|.
          const auto bends = hull_.curvatures(i, j);
          const double hxx = bends.xx.most, hyy = bends.yy.most;
          hollow.at(i, j) = (hxx + hyy) / 2 + std::hypot((hxx - hyy) / 2, bends.xy.magnitude()) >= 1 / radius_mm;
        }
      }
    });
    steepest_ = std::sqrt(*std::max_element(steepest2.begin(), steepest2.end()));
    for (int j = 0; j < ny; ++j) {
      for (int i = 0; i < nx; ++i) {
        sums_.at(i + 1, j + 1) = hollow.at(i, j) + sums_.at(i, j + 1) + sums_.at(i + 1, j) - sums_.at(i, j);
      }
    }
  }

  [[nodiscard]] double steepest() const { return steepest_; }

  /// No point within `half_mm` of (x, y), along x and y, has a second derivative in any direction of 1 / R or more.
  [[nodiscard]] bool fits(double x, double y, double half_mm) const {
    const int i0 = hull_.column(x - half_mm), i1 = hull_.column(x + half_mm) + 1;
    const int j0 = hull_.row(y - half_mm), j1 = hull_.row(y + half_mm) + 1;
    return sums_.at(i1, j1) - sums_.at(i0, j1) - sums_.at(i1, j0) + sums_.at(i0, j0) == 0;
  }

 private:
  detail::SplineHull hull_;
  double steepest_ = 0;
  Grid<int> sums_;  ///< of hollow cells left of and below
};

// ------------------------------------------------------------------------------------------------------------------
// The lowest ball over a point that the ball cannot touch: min over centres c of D(c) - sqrt(R^2 - |p - c|^2).

/// Value, gradient and Hessian of a function of the ball's centre.
struct Quadratic {
  double value = 0;
  Vec2 gradient = Vec2::Zero();
  Eigen::Matrix2d hessian = Eigen::Matrix2d::Zero();

  [[nodiscard]] double at(const Vec2& d) const { return value + gradient.dot(d) + 0.5 * d.dot(hessian * d); }
};

/// S(u) = sqrt(R^2 - u^2): the ball above its equator.
Quadratic sphere(double radius, const Vec2& u) {
  const double height = std::sqrt(radius * radius - u.squaredNorm());
  Quadratic s;
  s.value = height;
  s.gradient = -u / height;
  s.hessian = -Eigen::Matrix2d::Identity() / height - u * u.transpose() / (height * height * height);
  return s;
}

Eigen::Matrix2d inverse(const Eigen::Matrix2d& m) {
  Eigen::Matrix2d r;
  r << m(1, 1), -m(0, 1), -m(1, 0), m(0, 0);
  return r / (m(0, 0) * m(1, 1) - m(0, 1) * m(1, 0));
}

/// One place of contact as a function of the centre: D is the highest of these.
struct Branch {
  Vec2 contact = Vec2::Zero();
  Quadratic height;  ///< of the ball's centre when it rests there
};

/// Moves the contact to where a ball over `centre` touches near it. False where that contact has ceased to exist.
bool follow(const SplineSurface& surface, double radius, const Vec2& centre, Branch& branch) {
  Vec2 q = branch.contact;
  for (int iteration = 0; iteration < 12; ++iteration) {
    if ((q - centre).norm() > 0.99 * radius) return false;
    const SplineSurface::Sample h = surface.sample(q.x(), q.y());
    const Quadratic s = sphere(radius, q - centre);
    Eigen::Matrix2d f = s.hessian;
    f(0, 0) += h.hxx;
    f(0, 1) += h.hxy;
    f(1, 0) += h.hxy;
    f(1, 1) += h.hyy;
    if (!(f(0, 0) < 0 && f(0, 0) * f(1, 1) - f(0, 1) * f(1, 0) > 1e-4 / (radius * radius))) return false;
    const Eigen::Matrix2d f_inverse = inverse(f);
    const Vec2 step = -f_inverse * (Vec2(h.hx, h.hy) + s.gradient);
    if (step.norm() < 1e-7) {
      branch.contact = q;
      branch.height.value = h.h + s.value;
      branch.height.gradient = Vec2(h.hx, h.hy);  // envelope theorem
      branch.height.hessian = s.hessian - s.hessian * f_inverse * s.hessian;
      return true;
    }
    if (step.norm() > radius / 4) return false;
    q += step;
  }
  return false;
}

class LowestBall {
 public:
  LowestBall(const detail::BallContact& balls, double reach_mm)
      : balls_(balls), surface_(balls.surface()), radius_(balls.radius_mm()), reach_(reach_mm) {}

  /// Rests balls on a coarse grid wherever one could cover one of the points.
  void prepare(const std::vector<Vec2>& points, const Monitor& monitor) {
    pitch_ = radius_ / 20;
    window_ = static_cast<int>(std::ceil(reach_ / pitch_)) + 1;
    Box2 box = surface_.extent();
    first_ = box.min - Vec2::Constant((window_ + 1) * pitch_);
    const Vec2 size = box.size() + Vec2::Constant(2 * (window_ + 1) * pitch_);
    const int nx = static_cast<int>(std::ceil(size.x() / pitch_)) + 2;
    const int ny = static_cast<int>(std::ceil(size.y() / pitch_)) + 2;
    // Wanted: everything within the window around a point, grown along x, then along y.
    Grid<int> wanted(nx + 1, ny + 1, 0);
    for (const Vec2& p : points) {
      const auto [i, j] = nearest(p);
      wanted.at(i, j) = 1;
    }
    Grid<unsigned char> grown(nx, ny, 0);
    for (int j = 0; j < ny; ++j) {
      int until = -1;
      for (int i = -window_; i < nx; ++i) {
        if (i + window_ < nx && wanted.at(i + window_, j)) until = i + 2 * window_;
        if (i >= 0) grown.at(i, j) = i <= until;
      }
    }
    resting_ = Grid<detail::Contact>(nx, ny);
    std::vector<std::pair<int, int>> nodes;
    for (int j = 0; j < ny; ++j) {
      for (int i = 0; i < nx; ++i) {
        resting_.at(i, j).z = kInfinity;
        bool want = false;
        for (int k = std::max(0, j - window_); k <= std::min(ny - 1, j + window_) && !want; ++k) want = grown.at(i, k);
        if (want) nodes.emplace_back(i, j);
      }
    }
    constexpr std::size_t kBand = 100000;
    for (std::size_t from = 0; from < nodes.size(); from += kBand) {
      monitor.report("resting balls on the surface", static_cast<double>(from) / static_cast<double>(nodes.size()));
      parallel_blocks(std::min(kBand, nodes.size() - from), 256, [&](std::size_t begin, std::size_t end) {
        for (std::size_t n = from + begin; n < from + end; ++n) {
          const Vec2 c = first_ + pitch_ * Vec2(nodes[n].first, nodes[n].second);
          resting_.at(nodes[n].first, nodes[n].second) = balls_.at(c.x(), c.y());
        }
      });
    }
  }

  /// z of the lowest point over p that a ball at rest can have.
  [[nodiscard]] double over(const Vec2& p) const {
    const auto [ci, cj] = nearest(p);
    const int side = 2 * window_ + 1;
    std::vector<double> g(static_cast<std::size_t>(side) * side, kInfinity);
    double best = kInfinity;
    for (int b = 0; b < side; ++b) {
      const int j = cj - window_ + b;
      if (j < 0 || j >= resting_.height) continue;
      const double dy = first_.y() + pitch_ * j - p.y();
      for (int a = 0; a < side; ++a) {
        const int i = ci - window_ + a;
        if (i < 0 || i >= resting_.width) continue;
        const double dx = first_.x() + pitch_ * i - p.x();
        const double inside = radius_ * radius_ - dx * dx - dy * dy;
        if (inside <= 0) continue;
        const double value = resting_.at(i, j).z - std::sqrt(inside);
        g[static_cast<std::size_t>(b) * side + a] = value;
        best = std::min(best, value);
      }
    }
    // The lowest place between nodes may be lower than at them by the jump of D's slope (at most twice the steepest
    // slope, seldom above 0.5) times the distance: every local minimum that may win is followed.
    const double enough = best + 0.25 * pitch_;
    struct Start {
      double value;
      int i, j;
    };
    std::vector<Start> starts;
    for (int b = 0; b < side; ++b) {
      for (int a = 0; a < side; ++a) {
        const double value = g[static_cast<std::size_t>(b) * side + a];
        if (!(value <= enough)) continue;
        bool lowest = true;
        for (int bb = std::max(0, b - 1); bb <= std::min(side - 1, b + 1) && lowest; ++bb) {
          for (int aa = std::max(0, a - 1); aa <= std::min(side - 1, a + 1); ++aa) {
            if (g[static_cast<std::size_t>(bb) * side + aa] < value) {
              lowest = false;
              break;
            }
          }
        }
        if (lowest) starts.push_back({value, ci - window_ + a, cj - window_ + b});
      }
    }
    std::sort(starts.begin(), starts.end(), [](const Start& s, const Start& t) { return s.value < t.value; });
    constexpr std::size_t kMostStarts = 4;
    if (starts.size() > kMostStarts) starts.resize(kMostStarts);
    for (const Start& start : starts) best = std::min(best, descend(p, start.i, start.j));
    return best;
  }

 private:
  [[nodiscard]] std::pair<int, int> nearest(const Vec2& p) const {
    return {static_cast<int>(std::lround((p.x() - first_.x()) / pitch_)),
            static_cast<int>(std::lround((p.y() - first_.y()) / pitch_))};
  }

  /// Adds a contact near `q` as a branch at `centre`, unless it is there already.
  void add_branch(std::vector<Branch>& branches, const Vec2& centre, const Vec2& q) const {
    Branch branch;
    branch.contact = q;
    if (!follow(surface_, radius_, centre, branch)) return;
    for (const Branch& other : branches) {
      if ((other.contact - branch.contact).squaredNorm() < 1e-8) return;
    }
    branches.push_back(branch);
  }

  /// The step that lowers the highest of the models most: one, two or three of them are equal there.
  static Vec2 best_step(const std::vector<Quadratic>& models, double trust) {
    const auto highest = [&](const Vec2& d) {
      double value = -kInfinity;
      for (const Quadratic& m : models) value = std::max(value, m.at(d));
      return value;
    };
    Vec2 best = Vec2::Zero();
    double best_value = highest(best);
    const auto consider = [&](Vec2 d) {
      if (!d.allFinite()) return;
      const double length = d.norm();
      if (length > trust) d *= trust / length;
      const double value = highest(d);
      if (value < best_value) {
        best_value = value;
        best = d;
      }
    };
    const std::size_t n = models.size();
    for (std::size_t i = 0; i < n; ++i) {
      consider(-inverse(models[i].hessian) * models[i].gradient);
      consider(-models[i].gradient * (trust / std::max(models[i].gradient.norm(), 1e-300)));
      for (std::size_t j = i + 1; j < n; ++j) {
        // Equal along a line (then, with the second order put in, along a curve): the minimum on it.
        const Vec2 across = models[i].gradient - models[j].gradient;
        const double across2 = across.squaredNorm();
        if (across2 < 1e-16) continue;
        const Vec2 along(-across.y(), across.x());
        Vec2 d = Vec2::Zero();
        for (int pass = 0; pass < 4; ++pass) {
          const double gap = models[i].at(d) - models[j].at(d);
          const Vec2 slope_i = models[i].gradient + models[i].hessian * d;
          const Vec2 slope_j = models[j].gradient + models[j].hessian * d;
          const Vec2 normal = slope_i - slope_j;
          const double normal2 = normal.squaredNorm();
          if (normal2 < 1e-16) break;
          d -= normal * (gap / normal2);
          // Of weighted models, so that the weighted slope has no part across.
          const Vec2 tangent(-normal.y(), normal.x());
          const double weight = std::clamp(-slope_j.dot(normal) / normal2, 0.0, 1.0);
          const Eigen::Matrix2d mean = weight * models[i].hessian + (1 - weight) * models[j].hessian;
          const Vec2 slope = weight * (models[i].gradient + models[i].hessian * d) +
                             (1 - weight) * (models[j].gradient + models[j].hessian * d);
          const double curvature = tangent.dot(mean * tangent);
          if (curvature > 1e-9 * normal2) d -= tangent * (tangent.dot(slope) / curvature);
          if (d.norm() > 4 * trust) break;
        }
        consider(d);
        for (std::size_t k = j + 1; k < n; ++k) {
          // All three equal: Newton from where the three tangent planes meet.
          Vec2 e = Vec2::Zero();
          for (int pass = 0; pass < 4; ++pass) {
            Eigen::Matrix2d a;
            const Vec2 gi = models[i].gradient + models[i].hessian * e;
            a.row(0) = (gi - models[j].gradient - models[j].hessian * e).transpose();
            a.row(1) = (gi - models[k].gradient - models[k].hessian * e).transpose();
            if (std::abs(a(0, 0) * a(1, 1) - a(0, 1) * a(1, 0)) < 1e-12) break;
            e -= inverse(a) * Vec2(models[i].at(e) - models[j].at(e), models[i].at(e) - models[k].at(e));
            if (!(e.norm() < 4 * trust)) break;
          }
          consider(e);
        }
      }
    }
    return best;
  }

  /// Lowers D(c) - S(p - c) from a node of the coarse grid: a trust region about the highest of the contacts known so
  /// far. Every value returned is of a real ball at rest, so that the result is never too low.
  [[nodiscard]] double descend(const Vec2& p, int i, int j) const {
    Vec2 c = first_ + pitch_ * Vec2(i, j);
    double value = resting_.at(i, j).z - sphere(radius_, p - c).value;
    std::vector<Branch> branches;
    for (int b = std::max(0, j - 1); b <= std::min(resting_.height - 1, j + 1); ++b) {
      for (int a = std::max(0, i - 1); a <= std::min(resting_.width - 1, i + 1); ++a) {
        if (resting_.at(a, b).z < kInfinity) add_branch(branches, c, resting_.at(a, b).point);
      }
    }
    double trust = pitch_;
    std::vector<Quadratic> models;
    for (int iteration = 0; iteration < 30 && !branches.empty(); ++iteration) {
      const Quadratic s = sphere(radius_, p - c);
      models.clear();
      double before = -kInfinity;
      for (const Branch& branch : branches) {
        // S depends on p - c: its gradient by c has the other sign.
        models.push_back(
            {branch.height.value - s.value, branch.height.gradient + s.gradient, branch.height.hessian - s.hessian});
        before = std::max(before, models.back().value);
      }
      const Vec2 d = best_step(models, trust);
      double after = -kInfinity;
      for (const Quadratic& m : models) after = std::max(after, m.at(d));
      if (before - after < kGainMm && value - after < kGainMm) break;

      const Vec2 next = c + d;
      if ((p - next).norm() > 0.99 * radius_) {
        trust /= 2;
        continue;
      }
      const detail::Contact rest = balls_.at(next.x(), next.y());
      const double next_value = rest.z - sphere(radius_, p - next).value;
      if (next_value < value - 0.1 * (value - after)) {
        if (d.norm() > 0.9 * trust) trust = std::min(2 * trust, radius_ / 10);
        c = next;
        value = next_value;
        std::vector<Branch> moved;
        add_branch(moved, c, rest.point);
        for (const Branch& branch : branches) add_branch(moved, c, branch.contact);
        branches = std::move(moved);
        // Few can be the highest together.
        std::sort(branches.begin(), branches.end(),
                  [](const Branch& a, const Branch& b) { return a.height.value > b.height.value; });
        if (branches.size() > 5) branches.resize(5);
      } else {
        // A contact that nobody knew of is in the way, or the models reach too far.
        const std::size_t known = branches.size();
        add_branch(branches, c, rest.point);
        if (branches.size() == known || iteration % 3 == 2) trust /= 3;
        if (trust < 1e-6) break;
      }
    }
    return value;
  }

  const detail::BallContact& balls_;
  const SplineSurface& surface_;
  double radius_;
  double reach_;
  double pitch_ = 0;
  int window_ = 0;
  Vec2 first_ = Vec2::Zero();
  Grid<detail::Contact> resting_;  ///< balls on the coarse grid; z is infinite where none was wanted
};

/// Area and highest residue from the residues.
void sum_up(ReachableSurface& r) {
  r.unreachable_area_mm2 = r.max_residue_um = 0;
  const int nx = r.residue_um.width, ny = r.residue_um.height;
  for (int j = 0; j < ny; ++j) {
    // A node stands for the part of its square that lies on the lens.
    const double high = (j == 0 || j == ny - 1) ? r.pitch_mm / 2 : r.pitch_mm;
    for (int i = 0; i < nx; ++i) {
      const double residue = r.residue_um.at(i, j);
      r.max_residue_um = std::max(r.max_residue_um, residue);
      if (residue > r.threshold_um) r.unreachable_area_mm2 += high * ((i == 0 || i == nx - 1) ? r.pitch_mm / 2 : r.pitch_mm);
    }
  }
}

}  // namespace

ReachableSurface reachable_surface(const SplineSurface& surface, double ball_radius_mm, double pitch_mm,
                                   const Monitor& monitor) {
  if (!(ball_radius_mm > 0)) throw InputError("reachable surface: the ball's radius must be above 0");
  if (!(pitch_mm > 0)) throw InputError("reachable surface: the pitch must be above 0");
  const double radius = ball_radius_mm;
  ReachableSurface result;
  result.extent = surface.extent();
  result.pitch_mm = pitch_mm;
  const Vec2 size = result.extent.size();
  const int nx = static_cast<int>(std::floor(size.x() / pitch_mm + 1e-9)) + 1;
  const int ny = static_cast<int>(std::floor(size.y() / pitch_mm + 1e-9)) + 1;
  result.closing_mm = Grid<float>(nx, ny);
  result.residue_um = Grid<float>(nx, ny, 0.0F);

  monitor.report("looking for hollows", 0);
  const HollowMap hollows(surface, radius);
  // A ball over c touches where the surface is as steep as the ball: no farther from c than this.
  const double reach = radius * hollows.steepest() / std::sqrt(1 + hollows.steepest() * hollows.steepest());
  const detail::BallContact balls(surface, radius, 2 * radius);

  // The ball that touches the surface at p, its centre over c, rests there if f(q) = h(q) + sqrt(R^2 - |q - c|^2) is
  // highest at p. All maxima of f lie within `reach` of c. Where the Hessian of h is below 1 / R on that disc, f is
  // concave there (the Hessian of the root is at most -1 / R), so that p, where f has no slope, is its only maximum:
  // the ball reaches p. Elsewhere the ball is set down over c to see.
  std::vector<std::vector<Vec2>> unreached(ny);
  constexpr int kRows = 64;
  for (int from = 0; from < ny; from += kRows) {
    monitor.report("touching the surface", 0.05 + 0.35 * from / ny);
    parallel_blocks(std::min(kRows, ny - from), 1, [&](std::size_t begin, std::size_t end) {
      for (int j = from + static_cast<int>(begin); j < from + static_cast<int>(end); ++j) {
        const double y = result.extent.min.y() + pitch_mm * j;
        for (int i = 0; i < nx; ++i) {
          const double x = result.extent.min.x() + pitch_mm * i;
          const SplineSurface::Sample s = surface.sample(x, y);
          result.closing_mm.at(i, j) = static_cast<float>(s.h);
          const double up = 1 / std::sqrt(1 + s.hx * s.hx + s.hy * s.hy);
          const Vec2 c(x - radius * s.hx * up, y - radius * s.hy * up);
          if (hollows.fits(c.x(), c.y(), reach)) continue;
          if (balls.at(c.x(), c.y()).z - (s.h + radius * up) > kReachedMm) unreached[j].emplace_back(i, j);
        }
      }
    });
  }

  // What the ball cannot touch stays as high as the lowest ball over it.
  std::vector<Vec2> nodes, points;
  for (const auto& row : unreached) nodes.insert(nodes.end(), row.begin(), row.end());
  for (const Vec2& node : nodes) points.push_back(result.extent.min + pitch_mm * node);
  LowestBall lowest(balls, reach);
  if (!points.empty()) lowest.prepare(points, monitor.part(0.4, 0.6));
  constexpr std::size_t kBand = 50000;
  for (std::size_t from = 0; from < points.size(); from += kBand) {
    monitor.report("closing the surface", 0.6 + 0.4 * static_cast<double>(from) / static_cast<double>(points.size()));
    parallel_blocks(std::min(kBand, points.size() - from), 64, [&](std::size_t begin, std::size_t end) {
      for (std::size_t n = from + begin; n < from + end; ++n) {
        const Vec2& p = points[n];
        const double h = surface.height(p.x(), p.y());
        const double residue = std::max(0.0, lowest.over(p) - h);
        const int i = static_cast<int>(nodes[n].x()), j = static_cast<int>(nodes[n].y());
        result.closing_mm.at(i, j) = static_cast<float>(h + residue);
        result.residue_um.at(i, j) = static_cast<float>(1e3 * residue);
      }
    });
  }

  sum_up(result);
  monitor.report("reachable surface done", 1);
  return result;
}

Grid<float> residue_normals_mrad(const ReachableSurface& reachable) {
  const Grid<float>& residue = reachable.residue_um;
  const int nx = residue.width, ny = residue.height;
  Grid<float> angles(nx, ny, 0);
  for (int j = 0; j < ny; ++j) {
    const int south = std::max(0, j - 1), north = std::min(ny - 1, j + 1);
    for (int i = 0; i < nx; ++i) {
      if (residue.at(i, j) <= 0) continue;
      const int west = std::max(0, i - 1), east = std::min(nx - 1, i + 1);
      const Vec2 way = reachable.pitch_mm * Vec2(std::max(1, east - west), std::max(1, north - south));
      const auto slope = [&](const auto& height_mm) -> Vec2 {
        return Vec2(height_mm(east, j) - height_mm(west, j), height_mm(i, north) - height_mm(i, south)).cwiseQuotient(way);
      };
      const Vec2 closing = slope([&](int a, int b) { return static_cast<double>(reachable.closing_mm.at(a, b)); });
      const Vec2 left = slope([&](int a, int b) { return 1e-3 * residue.at(a, b); });
      const Vec3 one = Vec3(-closing.x(), -closing.y(), 1).normalized();
      const Vec3 other = Vec3(left.x() - closing.x(), left.y() - closing.y(), 1).normalized();
      angles.at(i, j) = static_cast<float>(1e3 * std::asin(std::min(1.0, one.cross(other).norm())));
    }
  }
  return angles;
}

ReachableSurface within(ReachableSurface reachable, const Outline& outline) {
  if (outline.shape == Outline::Shape::kRectangle) return reachable;
  const OutlineRegion region(outline, 0);
  for (int j = 0; j < reachable.residue_um.height; ++j) {
    for (int i = 0; i < reachable.residue_um.width; ++i) {
      if (region.contains(reachable.extent.min + reachable.pitch_mm * Vec2(i, j))) continue;
      const float design = reachable.closing_mm.at(i, j) - 1e-3F * reachable.residue_um.at(i, j);
      reachable.closing_mm.at(i, j) = design;
      reachable.residue_um.at(i, j) = 0;
    }
  }
  sum_up(reachable);
  return reachable;
}

}  // namespace lightmill
