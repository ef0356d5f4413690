// Laws of whole plans, against closed forms and against searches that share nothing with the planner.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck.h>
#include <unistd.h>

#include <filesystem>
#include <map>
#include <random>
#include <sstream>

#include "cam/creases.h"
#include "cam/finishing.h"
#include "cam/rest.h"
#include "cam/roughing.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::cutter;
using test::spline_of;
using test::SweptBall;
using ::testing::HasSubstr;

constexpr double kLocationMm = 5e-5;  // 0.05 um
constexpr double kChordMm = 1e-5;     // chords in the laws: 0.01 um

Cutter ball() { return cutter("finish_4mm_ball"); }
Cutter mill() { return cutter("rough_10mm"); }

Blank blank_for(const SplineSurface& s) { return {s.extent().size(), s.highest() + 0.4}; }

bool cuts(const Move& move) { return move.kind == MoveKind::kCut || move.kind == MoveKind::kPlunge; }

/// A function of x and y with its derivatives.
struct Form {
  std::function<double(double, double)> h;
  std::function<Vec2(double, double)> slope;
};

Form quadric(double a, double b, double kx, double ky, double kxy) {
  return {[=](double x, double y) { return 12 + a * x + b * y + kx * x * x / 2 + ky * y * y / 2 + kxy * x * y; },
          [=](double x, double y) { return Vec2(a + kx * x + kxy * y, b + ky * y + kxy * x); }};
}

/// A cap of a sphere of radius rho, a hill (rho > 0) or a bowl.
Form cap(double rho) {
  const auto w = [rho](double x, double y) { return std::sqrt(rho * rho - (x - 1) * (x - 1) - (y + 0.5) * (y + 0.5)); };
  const double sign = rho > 0 ? 1 : -1;
  return {[=](double x, double y) { return 12 + sign * (w(x, y) - std::abs(rho)); },
          [=](double x, double y) { return Vec2(-sign * (x - 1) / w(x, y), -sign * (y + 0.5) / w(x, y)); }};
}

/// The place whose offset by the radius along the normal is the centre, seen from above: Newton by differences.
Vec2 contact_below(const Form& f, double radius, const Vec2& centre) {
  const auto offset = [&](const Vec2& p) {
    const Vec2 g = f.slope(p.x(), p.y());
    return Vec2(p - radius / std::sqrt(1 + g.squaredNorm()) * g);
  };
  Vec2 p = centre;
  for (int k = 0; k < 60; ++k) p += centre - offset(p);
  return p;
}

struct NamedForm {
  const char* name;
  Form form;
};

class CutterLocations : public ::testing::TestWithParam<NamedForm> {};

TEST_P(CutterLocations, OfAWholePlanLieOnTheOffsetOfTheClosedForm) {
  const Form& f = GetParam().form;
  const auto s = spline_of(Box2::centred({7, 6}), 70, 60, f.h);
  FinishOptions options;
  options.axis = AxisPolicy::kVertical;
  options.chord_tolerance_mm = kChordMm;
  const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
  int judged = 0;
  for (std::size_t k = 1; k < path.moves.size(); k += 7) {
    if (!cuts(path.moves[k])) continue;
    for (const double t : {1.0, 0.5}) {  // at the vertex and half-way to it
      const Vec3 tip = path.moves[k - 1].pose.tip_mm + t * (path.moves[k].pose.tip_mm - path.moves[k - 1].pose.tip_mm);
      const Vec3 c = tip + 2 * Vec3::UnitZ();
      const Vec2 p = contact_below(f, 2, c.head<2>());
      if (!s.extent().contains(p)) continue;
      ++judged;
      EXPECT_NEAR((c - Vec3(p.x(), p.y(), f.h(p.x(), p.y()))).norm(), 2, kLocationMm) << "contact " << p.transpose();
    }
  }
  EXPECT_GT(judged, 200);
}

INSTANTIATE_TEST_SUITE_P(Forms, CutterLocations,
                         ::testing::Values(NamedForm{"plane", quadric(0.3, -0.2, 0, 0, 0)}, NamedForm{"hill", cap(147)},
                                           NamedForm{"bowl", cap(-20)}, NamedForm{"cylinder", quadric(0, 0, 0, 0.12, 0)},
                                           NamedForm{"oblique_cylinder", quadric(0.1, 0, -0.05, -0.05, 0.05)},
                                           NamedForm{"saddle", quadric(0, 0.05, 0.08, -0.06, 0.02)}),
                         [](const auto& test) { return std::string(test.param.name); });

/// The spline of -m |y| on knots `span` apart, by the basis's own formula: its coefficients are the values, m span / 3 higher at the edge.
double rounded_ridge(double m, double span, double y) {
  const auto basis = [](double t) {
    t = std::abs(t);
    return t < 1 ? 2.0 / 3 - t * t + t * t * t / 2 : t < 2 ? std::pow(2 - t, 3) / 6 : 0;
  };
  const double t = y / span;
  double h = m * span / 3 * basis(t);
  const int middle = static_cast<int>(std::floor(t));
  for (int j = middle - 1; j <= middle + 2; ++j) h -= m * span * std::abs(j) * basis(t - j);
  return h;
}

TEST(CutterLocations, InAValleyAndOverARidgeAreTheClosedForms) {
  // Planes of slope m on both sides of y = 0, on knots: the spline rounds two spans beside it, here 0.1 mm.
  const double m = 0.3, radius = 2, span = 0.05;
  for (const double sign : {1.0, -1.0}) {
    const auto s = spline_of(Box2::centred({6, 5}), 120, 100, [&](double, double y) { return 12 + sign * m * std::abs(y); });
    FinishOptions options;
    options.axis = AxisPolicy::kVertical;
    options.chord_tolerance_mm = kChordMm;
    const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
    int judged = 0, over_the_edge = 0;
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      if (!cuts(path.moves[k])) continue;
      const Vec3 c = path.moves[k].pose.tip_mm + radius * Vec3::UnitZ();
      const double from_crease = std::abs(c.y());
      if (std::abs(c.x()) > 3 || from_crease > 2.4) continue;
      const double rolls_within = radius * m / std::sqrt(1 + m * m);
      if (sign > 0) {
        EXPECT_NEAR(c.z(), 12 + m * from_crease + radius * std::sqrt(1 + m * m), kLocationMm);
      } else if (from_crease > rolls_within + 0.15) {
        EXPECT_NEAR(c.z(), 12 - m * from_crease + radius * std::sqrt(1 + m * m), kLocationMm);
      } else if (++over_the_edge % 5 == 0) {
        // Over the spline's own rounded edge the ball rests where the dilation of that curve is.
        double rests = 0;
        for (double y = c.y() - 0.8; y <= c.y() + 0.8; y += 5e-4) {
          rests = std::max(rests, 12 + rounded_ridge(m, span, y) + std::sqrt(radius * radius - (y - c.y()) * (y - c.y())));
        }
        EXPECT_NEAR(c.z(), rests, kLocationMm) << "y " << c.y();
      }
      ++judged;
    }
    EXPECT_GT(judged, 200);
    EXPECT_EQ(over_the_edge > 0, sign < 0);
  }
}

/// The ways of the ball's centre by their y, for plans with one vertical axis.
std::map<double, std::vector<Vec3>> ways_of(const ToolPath& path, double least_mm) {
  std::map<double, std::vector<Vec3>> ways;
  std::vector<Vec3> way;
  const auto close = [&] {
    if (way.size() > 1 && way.back().x() - way.front().x() > least_mm) ways[way.front().y()] = way;
    way.clear();
  };
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (!cuts(path.moves[k])) {
      close();
      continue;
    }
    if (way.empty()) way.push_back(path.moves[k - 1].pose.tip_mm + path.cutter.radius_mm() * path.moves[k - 1].pose.axis);
    way.push_back(path.moves[k].pose.tip_mm + path.cutter.radius_mm() * path.moves[k].pose.axis);
  }
  close();
  return ways;
}

double height_at(const std::vector<Vec3>& way, double x) {
  const auto after = std::lower_bound(way.begin(), way.end(), x, [](const Vec3& p, double at) { return p.x() < at; });
  if (after == way.begin()) return way.front().z();
  if (after == way.end()) return way.back().z();
  const Vec3 &a = after[-1], &b = *after;
  return a.z() + (b.z() - a.z()) * (x - a.x()) / (b.x() - a.x());
}

TEST(Scallop, IsTheFormulaCorrectedForCurvature) {
  // Across the passes at the top of caps and cylinders of curvature kappa (convex positive): contacts are s apart, the
  // cusp is (R - sqrt(R^2 - s^2 / 4)) (1 + kappa R).
  for (const auto& [form, kappa] : {std::pair{cap(147), 1 / 147.0}, std::pair{cap(-20), -1 / 20.0}, std::pair{cap(9), 1 / 9.0},
                                    std::pair{quadric(0, 0, 0, -0.08, 0), 0.08}, std::pair{quadric(0, 0, 0.1, 0, 0), 0.0}}) {
    const auto s = spline_of(Box2::centred({5, 4}), 50, 40, form.h);
    FinishOptions options;
    options.axis = AxisPolicy::kVertical;
    const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
    const auto ways = ways_of(path, 5);
    ASSERT_GT(ways.size(), 10U);
    const SweptBall swept(path);
    auto a = ways.begin();
    for (auto b = std::next(a); b != ways.end(); a = b++) {
      const double x = 1;  // the caps' middle
      const double ya = contact_below(form, 2, {x, a->first}).y();
      const double yb = contact_below(form, 2, {x, b->first}).y();
      // Near the level place, so that lengths on the surface are those in y.
      const double middle = (ya + yb) / 2;
      if (std::abs(form.slope(x, middle).y()) > 0.03) continue;
      double most = 0;
      for (int k = 0; k <= 40; ++k) {
        const double y = ya + (yb - ya) * k / 40;
        most = std::max(most, swept.left_mm({x, y, s.height(x, y)}));
      }
      const double spacing = yb - ya;
      const double formula = (2 - std::sqrt(4 - spacing * spacing / 4)) * (1 + 2 * kappa);
      EXPECT_NEAR(most, formula, 0.02 * formula) << "curvature " << kappa << " at y " << middle;
    }
  }
}

/// Hills with creases through them, both kinds: random, seeded.
SplineSurface creased(std::uint32_t seed, const Vec2& size) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(-1, 1);
  struct Crease {
    Vec2 across;
    double at, jump;
  };
  std::vector<Crease> creases;
  for (int k = 0; k < 3; ++k) {
    const double angle = kPi * u(random);
    creases.push_back({{std::cos(angle), std::sin(angle)}, 0.3 * size.minCoeff() * u(random), 0.12 * u(random) + (k % 2 ? 0.1 : -0.1)});
  }
  const double kx = 0.5 + 0.2 * u(random), ky = 0.5 + 0.2 * u(random), phase = 3 * u(random);
  return spline_of(Box2::centred(size), static_cast<int>(size.x() / 0.2), static_cast<int>(size.y() / 0.2), [&](double x, double y) {
    double h = 12 + 0.05 * x - 0.04 * y + 0.08 * std::sin(kx * x + phase) * std::cos(ky * y);
    for (const Crease& c : creases) h += c.jump * std::abs(c.across.dot(Vec2(x, y)) - c.at);
    return h;
  });
}

/// How deep a ball with its centre at c is below the surface, along z, by narrowing grids: nothing of the planner's.
double depth_under(const SplineSurface& s, double radius, const Vec3& c) {
  Vec2 at = c.head<2>();
  double half = radius / 2, most = -1;
  for (const double pitch : {0.05, 0.006, 0.0008}) {
    const Vec2 middle = at;
    for (double v = -half; v <= half; v += pitch) {
      for (double w = -half; w <= half; w += pitch) {
        const Vec2 q = middle + Vec2(v, w);
        const double inside = radius * radius - (q - c.head<2>()).squaredNorm();
        if (inside <= 0 || !s.extent().contains(q)) continue;
        const double depth = s.height(q.x(), q.y()) - (c.z() - std::sqrt(inside));
        if (depth > most) most = depth, at = q;
      }
    }
    half = pitch;
  }
  return most;
}

/// The deepest under balls anywhere on every n-th move of the way that cuts.
double deepest_under(const SplineSurface& s, const ToolPath& path, std::size_t every, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  const double radius = path.cutter.radius_mm();
  double deepest = 0;
  for (std::size_t k = 1 + seed % every; k < path.moves.size(); k += every) {
    if (!cuts(path.moves[k])) continue;
    const ToolPose &from = path.moves[k - 1].pose, &to = path.moves[k].pose;
    const double t = u(random);
    const Vec3 axis = (from.axis + t * (to.axis - from.axis)).normalized();
    deepest = std::max(deepest, depth_under(s, radius, from.tip_mm + t * (to.tip_mm - from.tip_mm) + radius * axis));
  }
  return deepest;
}

TEST(CreasedSurfacesInGeneral, NoBallOfAnyStrategyAndAxisIsBelowThem) {
  const auto law = [] {
    const auto seed = static_cast<std::uint32_t>(*rc::gen::inRange(0, 1000000));
    const Vec2 size(*rc::gen::inRange(30, 50) / 10.0, *rc::gen::inRange(30, 45) / 10.0);
    const auto s = creased(seed, size);
    FinishOptions options;
    options.cusp_um = *rc::gen::element(1.3, 5.0);
    options.strategy = *rc::gen::element(Strategy::kOneWay, Strategy::kZigZag, Strategy::kSpiral);
    options.axis = *rc::gen::element(AxisPolicy::kVertical, AxisPolicy::kFixed, AxisPolicy::kLeadTilt);
    options.angle_rad = *rc::gen::element(0, 40, 90) * kPi / 180;
    const bool along_creases = *rc::gen::inRange(0, 2);
    if (along_creases) {
      for (const Crease& crease : concave_creases(s, reachable_surface(s, 2, 0.05))) options.also_along.push_back(line_to_follow(crease));
    }
    RC_LOG() << "surface " << seed << ", " << size.transpose() << " mm, strategy " << static_cast<int>(options.strategy) << ", axis "
             << static_cast<int>(options.axis) << ", angle " << options.angle_rad << ", along creases " << along_creases << "\n";
    const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
    const double deepest = deepest_under(s, path, std::max<std::size_t>(7, path.moves.size() / 150), seed);
    RC_LOG() << "deepest " << deepest << " mm\n";
    RC_ASSERT(deepest <= kLocationMm);
  };
  // A plan takes a hundred times as long as a property that is meant to be tried a hundred times.
  rc::detail::TestParams params = rc::detail::configuration().testParams;
  if (params.maxSuccess == rc::detail::TestParams().maxSuccess) params.maxSuccess = 12;
  params.disableShrinking = true;
  const auto result = rc::detail::checkTestable(law, rc::detail::TestMetadata{"CreasedSurfaces", "no ball is below them"}, params);
  std::ostringstream words;
  rc::detail::printResultMessage(result, words);
  EXPECT_TRUE(result.is<rc::detail::SuccessResult>()) << words.str();
}

class CreasedSurfaces : public ::testing::TestWithParam<int> {};

TEST_P(CreasedSurfaces, TheBallStaysOutAndCoversWhatItCanReach) {
  const Vec2 size(7, 6);
  const auto s = creased(GetParam(), size);
  FinishOptions options;
  options.axis = AxisPolicy::kVertical;
  const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
  EXPECT_LE(deepest_under(s, path, 23, GetParam()), kLocationMm);
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> u(0, 1);

  // Every place that a ball at rest touches is cut down to the cusp: balls at random, by a search of the test's own.
  const SweptBall swept(path);
  double most_left = 0;
  int touched = 0;
  for (int k = 0; k < 800; ++k) {
    const Vec2 p = (Vec2(u(random), u(random)) - Vec2(0.5, 0.5)).cwiseProduct(size);
    const Vec3 on(p.x(), p.y(), s.height(p.x(), p.y()));
    const Vec3 centre = on + 2 * s.normal(p.x(), p.y());
    // Does a ball tangent here go below the surface anywhere near?
    bool free = true;
    for (double v = -1; v <= 1 && free; v += 0.08) {
      for (double w = -1; w <= 1 && free; w += 0.08) {
        const Vec2 q = centre.head<2>() + Vec2(v, w);
        free = (Vec3(q.x(), q.y(), s.height(q.x(), q.y())) - centre).norm() > 2 - 2e-5;
      }
    }
    if (!free) continue;
    ++touched;
    most_left = std::max(most_left, swept.left_mm(on));
  }
  EXPECT_GT(touched, 250);
  EXPECT_LE(most_left, 1.3e-3 + 4e-5);
}

INSTANTIATE_TEST_SUITE_P(Seeds, CreasedSurfaces, ::testing::Values(3, 4, 5, 6));

// ---- the same job again, elsewhere, in a mirror ----------------------------------------------------------------------

Form hills() {
  return {[](double x, double y) { return 12 + 0.1 * std::sin(0.7 * x + 0.4) * std::cos(0.5 * y) + 0.05 * std::sin(0.9 * y) + 0.04 * x; }, {}};
}

std::string bytes_of(const std::vector<ToolPath>& passes) {
  const auto file = std::filesystem::path(::testing::TempDir()) / ("plan_" + std::to_string(::getpid()) + ".bin");
  write_toolpaths(file, passes);
  std::string bytes = read_whole(file);
  std::filesystem::remove(file);
  return bytes;
}

TEST(Plans, AreTheSameBytesWhenMadeAgain) {
  const auto s = creased(9, {6, 5});
  const Blank blank{{8, 6}, s.highest() + 1};
  const auto all = [&] {
    FinishOptions semi;
    semi.pass = "semi_finish";
    semi.allowance_mm = 0.05;
    semi.cusp_um = 10;
    return bytes_of({plan_roughing(s, blank, mill(), {}), plan_finishing(s, blank, cutter("semi_finish_4mm_ball"), semi),
                     plan_finishing(s, blank, ball(), {})});
  };
  EXPECT_EQ(all(), all());
}

TEST(Plans, TakeTheSumOfTheirMoves) {
  const auto s = creased(9, {9, 8});
  const Blank blank{{12, 10}, s.highest() + 1};
  for (const ToolPath& path : {plan_roughing(s, blank, mill(), {}), plan_finishing(s, blank, ball(), {})}) {
    double seconds = 0, length = 0;
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      const double way = (path.moves[k].pose.tip_mm - path.moves[k - 1].pose.tip_mm).norm();
      ASSERT_EQ(path.moves[k].feed_mm_per_s > 0, path.moves[k].kind != MoveKind::kRapid);
      seconds += way / (path.moves[k].kind == MoveKind::kRapid ? 250 : path.moves[k].feed_mm_per_s);
      length += way;
    }
    EXPECT_NEAR(path.minutes(250) * 60, seconds, 1e-9 * seconds);
    EXPECT_NEAR(path.length_mm(), length, 1e-9 * length);
  }
}

/// `other` is `one` carried by x' = sign x + shift: as many passes, at the same places up to `apart_mm`, and every centre
/// where the first job's ball would rest.
void expect_same_ways(const ToolPath& one, const SplineSurface& surface, const ToolPath& other, double half_x, const Vec2& sign,
                      const Vec3& shift, double apart_mm) {
  const auto ways = ways_of(one, half_x);
  const auto others = ways_of(other, half_x);
  ASSERT_GT(ways.size(), 20U);
  ASSERT_EQ(ways.size(), others.size());
  for (const auto& [y, way] : ways) {
    const double there = sign.y() * y + shift.y();
    const auto near = others.lower_bound(there - apart_mm);
    ASSERT_NE(near, others.end());
    ASSERT_NEAR(near->first, there, apart_mm);
    const double back = sign.y() * (near->first - shift.y());
    for (double x = -half_x; x <= half_x; x += 0.31) {
      EXPECT_NEAR(height_at(near->second, sign.x() * x + shift.x()), ball_centre_height(surface, 2, x, back) + shift.z(), 6e-5)
          << "y " << y << " x " << x;
    }
  }
}

TEST(Plans, OfAMirroredJobAreMirroredAndOfAShiftedOneShifted) {
  const Vec2 size(8, 7);
  const auto f = hills().h;
  FinishOptions options;
  options.axis = AxisPolicy::kVertical;
  const auto surface = [&](const Box2& extent, const std::function<double(double, double)>& form) { return spline_of(extent, 32, 28, form); };
  const auto planned = [&](const SplineSurface& s, double over) { return plan_finishing(s, Blank{{14, 13}, 13 + over}, ball(), options); };
  const Box2 here = Box2::centred(size);
  const SplineSurface s = surface(here, f);
  const ToolPath path = planned(s, 0);
  // Ways, not moves: in a mirror passes still run along +X, from -y to +y, leaning to the same side (climb milling).
  constexpr double kMirroredMm = 1e-6;
  const auto mirrored = [&](double sx, double sy) { return planned(surface(here, [&](double x, double y) { return f(sx * x, sy * y); }), 0); };
  expect_same_ways(path, s, mirrored(-1, 1), 3.9, {-1, 1}, {0, 0, 0}, kMirroredMm);
  expect_same_ways(path, s, mirrored(1, -1), 3.9, {1, -1}, {0, 0, 0}, kMirroredMm);
  expect_same_ways(path, s, mirrored(-1, -1), 3.9, {-1, -1}, {0, 0, 0}, kMirroredMm);  // half a turn
  expect_same_ways(path, s, planned(surface(here, [&](double x, double y) { return f(x, y) + 2.5; }), 2.5), 3.9, {1, 1}, {0, 0, 2.5}, 1e-5);
  Box2 there = here;
  there.min += Vec2(1.25, -0.75);
  there.max += Vec2(1.25, -0.75);
  expect_same_ways(path, s, planned(surface(there, [&](double x, double y) { return f(x - 1.25, y + 0.75); }), 0), 3.9, {1, 1},
                   {1.25, -0.75, 0}, kMirroredMm);
}

// ---- the ends of the range -------------------------------------------------------------------------------------------

TEST(EdgeCases, AFlatLensASingleCreaseAndALensSmallerThanItsCuttersArePlanned) {
  const auto flat = [](double, double) { return 10.0; };
  const auto crease = [](double x, double y) { return 10 + 0.15 * std::abs(x - 0.3 * y); };
  for (const auto& [size, form] : {std::pair<Vec2, std::function<double(double, double)>>{{6, 5}, flat}, {{6, 5}, crease}, {{1.2, 0.8}, crease}}) {
    const auto s = spline_of(Box2::centred(size), 30, 25, form);
    const Blank blank = blank_for(s);
    const ToolPath rough = plan_roughing(s, blank, mill(), {});
    EXPECT_GE(rough.predicted_cusp_um, 299);
    const ToolPath path = plan_finishing(s, blank, ball(), {});
    EXPECT_LE(path.predicted_cusp_um, 1.3);
    const SweptBall swept(path);
    for (const Vec2& corner : {Vec2(-0.5, -0.5), Vec2(0.5, -0.5), Vec2(0.5, 0.5), Vec2(-0.5, 0.5)}) {
      const Vec2 p = corner.cwiseProduct(size);
      EXPECT_LE(swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())}), 1.4e-3) << "size " << size.x();
    }
  }
}

TEST(EdgeCases, TwentyMillimetresOfReliefArePlannedOrRefusedWithTheReason) {
  FinishOptions quick;
  quick.cusp_um = 60;
  quick.longest_segment_mm = 2;
  quick.chord_tolerance_mm = 1e-3;
  // Over 110 mm the slopes stay within a fixed tilt's window; up and down in both directions within 80 mm they do not.
  const auto wave = [](double length, double y_length) {
    return [=](double x, double y) { return 20 + 10 * std::sin(x / length * kPi) * std::cos(y / y_length * kPi); };
  };
  const auto gentle = spline_of(Box2::centred({110, 20}), 110, 20, wave(110, 1e4));
  const Blank blank{{110, 20}, 30.5};
  const ToolPath path = plan_finishing(gentle, blank, ball(), quick);
  const SweptBall swept(path);
  double deepest = 0, highest = 0;
  for (double y = -9.9; y < 10; y += 0.83) {
    for (double x = -54.9; x < 55; x += 0.37) {
      const double left = swept.left_mm({x, y, gentle.height(x, y)});
      deepest = std::min(deepest, left);
      highest = std::max(highest, left);
    }
  }
  EXPECT_GE(deepest, -quick.chord_tolerance_mm - kLocationMm);
  EXPECT_LE(highest, quick.cusp_um * 1e-3 + quick.chord_tolerance_mm + kLocationMm);
  EXPECT_GT(highest, 0.5 * quick.cusp_um * 1e-3) << "no pass is wasted";
  const ToolPath rough = plan_roughing(gentle, blank, mill(), {});
  EXPECT_LE(rough.predicted_cusp_um, 1500);
  const auto steep = spline_of(Box2::centred({80, 80}), 80, 80, wave(40, 40));
  try {
    plan_finishing(steep, {{80, 80}, 30.5}, ball(), quick);
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("degrees steep"));
  }
  try {
    plan_roughing(gentle, {{110, 20}, 29}, mill(), {});
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("1 mm taller than the blank"));
  }
}

}  // namespace
}  // namespace lightmill
