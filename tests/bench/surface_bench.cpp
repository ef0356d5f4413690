// Benchmarks of the surface stage at full size: surface_bench [CASE]... [--mesh N] [--samples N] [--turns N] [--smooth]
// [--picture-turns N] [--out DIR].
//   point, slanted, near, sphere, line, two, five   against the law of equal optical paths (targets given)
//   circle                                          against its profile (targets given); circle_map: by the transport
//   circles                                         circle_map over 20,480, 81,920 and 327,680 samples, plotted
//   cone                                            a point light's even cone into an even disk, against its profile (targets
//                                                   given); cone_map: by the transport
//   portrait, horse, rings, letter, signed          the light behind the lens, transport included, and seconds per phase
//   heights, rays                                   tracing of milled heights, of 100 million beams
// Prints one line per figure; pictures go to the folder named by --out, if any. --smooth: a height field without
// creases.
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "design/beams.h"
#include "design/core/files.h"
#include "design/core/image.h"
#include "design/source.h"
#include "design/surface.h"

using namespace lightmill;

namespace {

struct Setting {
  int mesh = 321;
  int samples = 65536;
  SurfaceSolver solver = SurfaceSolver::kCreases;
  int turns = SurfaceOptions{}.outer_iterations;
  int picture_turns = SurfaceOptions{}.picture_turns;
  std::string out;
};

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_utime.tv_sec + usage.ru_stime.tv_sec + 1e-6 * (usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

double peak_gb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss / 1048576.0;
}

SurfaceOptions options_of(const Setting& setting) {
  SurfaceOptions options;
  options.mesh = setting.mesh;
  options.outer_iterations = setting.turns;
  options.solver = setting.solver;
  options.picture_turns = setting.picture_turns;
  return options;
}

/// Of heights, in micrometres.
struct HeightErrors {
  double rms = 0, p999 = 0, most = 0;
};

HeightErrors print_errors(const char* name, std::vector<double> errors_um) {
  HeightErrors result;
  for (double& e : errors_um) {
    e = std::abs(e);
    result.rms += e * e / static_cast<double>(errors_um.size());
  }
  result.rms = std::sqrt(result.rms);
  std::sort(errors_um.begin(), errors_um.end());
  result.p999 = errors_um[static_cast<std::size_t>(0.999 * static_cast<double>(errors_um.size() - 1))];
  result.most = errors_um.back();
  std::printf("%s: RMS height error %.4f um, 99.9th percentile %.3f um, maximum %.3f um\n", name, result.rms, result.p999,
              result.most);
  return result;
}

/// How far vertices stand, in z, off the surface on which every path from the light to its target is as long as any
/// other. `end_of` is where the light of a vertex shall end, lens frame.
HeightErrors print_equal_paths(const char* name, const OpticalSurface& surface, const Lens& lens, const Light& light,
                       const std::function<Vec3(std::size_t)>& end_of) {
  const Illumination illumination(light, lens);
  const auto& vertices = surface.mesh.vertices;
  double sum = 0, weight = 0;
  std::vector<double> paths, rises;
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const Vec3& p = vertices[v];
    const IncomingRay ray = illumination.at(p);
    const Vec3 entry(ray.entry_mm.x(), ray.entry_mm.y(), 0);
    const double before = light.kind == Light::Kind::kPoint ? (entry - light.position_mm).norm()
                                                            : light.direction.normalized().dot(entry);
    const Vec3 way = end_of(v) - p;
    paths.push_back(before + lens.refractive_index * (p - entry).norm() + way.norm());
    rises.push_back(lens.refractive_index * ray.direction.z() - way.normalized().z());
    sum += paths[v] / (rises[v] * rises[v]);
    weight += 1 / (rises[v] * rises[v]);
  }
  std::vector<double> errors;
  for (std::size_t v = 0; v < vertices.size(); ++v) errors.push_back(1000 * (paths[v] - sum / weight) / rises[v]);
  return print_errors(name, errors);
}

void print_surface(const char* name, const OpticalSurface& s, double cpu) {
  std::printf(
      "%s: %d vertices, %.1f s wall, %.1f s CPU, peak %.2f GB, %d turns (%s), last change %.3g um, relief %.3f mm, "
      "concave radius %.2f mm, %d inverted, energies",
      name, s.summary.vertices, s.summary.seconds, cpu, peak_gb(), s.summary.outer_iterations, s.summary.reason.c_str(),
      s.summary.final_height_change_mm * 1000, s.summary.height_range_mm, s.summary.min_concave_radius_mm,
      s.summary.inverted_triangles);
  for (double e : s.summary.energy_history) std::printf(" %.5g", e);
  std::printf("\n");
}

/// All light into the nearest of some points of the receiver: equal ovals that meet along straight lines.
void points(const char* name, const Lens& lens, const Light& light, const Receiver& receiver,
            const std::vector<Vec2>& places, const Setting& setting) {
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  const auto nearest = [&](const Vec2& p) {
    std::size_t best = 0;
    for (std::size_t k = 1; k < places.size(); ++k) {
      if ((p - places[k]).norm() < (p - places[best]).norm()) best = k;
    }
    return best;
  };
  const auto target = [&](const std::vector<Vec2>& from) {
    std::vector<Vec2> targets;
    for (const Vec2& p : from) targets.push_back(places[nearest(p)]);
    return targets;
  };
  const double before = cpu_seconds();
  const OpticalSurface s = solve_surface(lens, light, receiver, target, options_of(setting));
  print_surface(name, s, cpu_seconds() - before);
  print_equal_paths(name, s, lens, light, [&](std::size_t v) {
    const Vec2& t = s.targets_mm[v];
    return Vec3(frame.origin_mm + t.x() * frame.x_axis + t.y() * frame.y_axis);
  });
}

void point(const std::string& name, const Setting& setting) {
  Lens lens;
  Light light;
  Receiver receiver;
  std::vector<Vec2> places{{0, 0}};
  if (name == "slanted") {
    light.direction = {0.15, -0.1, 1};
    receiver.tilt_rad = {0.2, 0.1};
    places = {{12, -30}};
  }
  if (name == "near") {
    light.kind = Light::Kind::kPoint;
    light.position_mm = {40, 10, -400};
    places = {{-12, 20}};
  }
  if (name == "sphere") {
    lens.base.kind = Base::Kind::kSphere;
    lens.base.radius_mm = 250;
  }
  if (name == "two") places = {{-25, -6}, {25, 6}};
  if (name == "five") places = {{-30, -20}, {30, -25}, {2, 3}, {-28, 27}, {33, 30}};
  points(name.c_str(), lens, light, receiver, places, setting);
}

void line(const Setting& setting) {
  const Lens lens;
  const Receiver receiver;
  const auto target = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.emplace_back(p.x(), 0);
    return targets;
  };
  const double before = cpu_seconds();
  const OpticalSurface s = solve_surface(lens, {}, receiver, target, options_of(setting));
  print_surface("line", s, cpu_seconds() - before);
  print_equal_paths("line", s, lens, {}, [&](std::size_t v) {
    return Vec3(s.mesh.vertices[v].x(), 0, lens.thickness_mm + receiver.distance_mm);
  });
}

/// A disk of light into a circle; the profile of a radius is a Cartesian oval.
HeightErrors circle(bool by_transport, const Setting& setting) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  const Receiver receiver;
  constexpr double kRho = 25;
  const auto onto_circle = [](const Vec2& p) { return p.norm() > 0 ? Vec2(p * (kRho / p.norm())) : Vec2(0, 0); };
  const auto target = [&](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.push_back(onto_circle(p));
    return targets;
  };
  const char* name = by_transport ? "circle_map" : "circle";
  TransportMap map;
  if (by_transport) {
    TargetLight light;
    light.extent = Box2::centred({100, 100});
    constexpr int kSides = 3600;
    CurveLight curve;
    for (int k = 0; k <= kSides; ++k)
      curve.vertices_mm.emplace_back(kRho * std::cos(2 * kPi * k / kSides), kRho * std::sin(2 * kPi * k / kSides));
    curve.density_per_mm.assign(curve.vertices_mm.size(), 1.0);
    curve.density_per_mm.assign(curve.vertices_mm.size(), 1 / curve.flux());
    light.curves.push_back(curve);
    TransportOptions options;
    options.samples = setting.samples;
    map = solve_transport({SourceLight::Shape::kDisk, lens.size_mm}, light, options);
  }
  const double before = cpu_seconds();
  const OpticalSurface s = by_transport ? solve_surface(lens, {}, receiver, map, options_of(setting))
                                        : solve_surface(lens, {}, receiver, target, options_of(setting));
  print_surface(name, s, cpu_seconds() - before);
  if (by_transport) std::printf("%s: %zu samples\n", name, map.sites_mm.size());
  return print_equal_paths(name, s, lens, {}, [&](std::size_t v) {
    const Vec2 p = s.mesh.vertices[v].head<2>();
    const Vec2 t = p.norm() > 0 ? onto_circle(p) : Vec2(kRho, 0);  // the tip belongs to every radius
    return Vec3(t.x(), t.y(), lens.thickness_mm + receiver.distance_mm);
  });
}

/// Lines over logarithmic axes: micrometres against samples.
void plot_errors(const std::filesystem::path& path, const std::vector<std::pair<double, HeightErrors>>& rows) {
  constexpr double kWidth = 600, kHeight = 360, kLeft = 70, kTop = 20, kDecade = 70;
  const auto x = [&](double samples) { return kLeft + 40 + 85 * std::log2(samples / rows.front().first); };
  const auto y = [&](double um) { return kTop + kDecade * (2 - std::log10(um)); };
  std::string svg;
  char text[256];
  const auto add = [&](auto... parts) {
    std::snprintf(text, sizeof text, parts...);
    svg += text;
  };
  add("<svg xmlns='http://www.w3.org/2000/svg' width='%g' height='%g' font-family='sans-serif' font-size='12'>\n"
      "<rect width='%g' height='%g' fill='white'/>\n",
      kWidth, kHeight, kWidth, kHeight);
  for (const double um : {0.01, 0.1, 1.0, 10.0, 100.0}) {
    add("<path d='M%g %gH%g' stroke='#ccc'/><text x='8' y='%g'>%g um</text>\n", kLeft, y(um), kWidth - 10, y(um) + 4, um);
  }
  for (const auto& [samples, errors] : rows) add("<text x='%g' y='%g' text-anchor='middle'>%.0f</text>\n", x(samples), kHeight - 35, samples);
  add("<text x='%g' y='%g' text-anchor='middle'>samples</text>\n", kWidth / 2, kHeight - 15);
  const struct {
    const char* name;
    const char* colour;
    double HeightErrors::*value;
  } lines[] = {{"RMS", "#1a6", &HeightErrors::rms}, {"99.9th percentile", "#26c", &HeightErrors::p999}, {"maximum", "#c33", &HeightErrors::most}};
  for (const auto& line : lines) {
    for (std::size_t k = 0; k < rows.size(); ++k) {
      add("<circle cx='%g' cy='%g' r='3' fill='%s'/>\n", x(rows[k].first), y(rows[k].second.*line.value), line.colour);
      if (k > 0) {
        add("<path d='M%g %gL%g %g' stroke='%s'/>\n", x(rows[k - 1].first), y(rows[k - 1].second.*line.value), x(rows[k].first),
            y(rows[k].second.*line.value), line.colour);
      }
    }
    add("<text x='%g' y='%g' fill='%s'>%s</text>\n", x(rows.back().first) + 8, y(rows.back().second.*line.value) + 4, line.colour,
        line.name);
  }
  write_whole(path, svg + "</svg>\n");
}

void circles(Setting setting) {
  std::vector<std::pair<double, HeightErrors>> rows;
  for (const int samples : {20480, 81920, 327680}) {
    setting.samples = samples;
    rows.emplace_back(samples, circle(true, setting));
  }
  if (!setting.out.empty()) plot_errors(std::filesystem::path(setting.out) / "circles.svg", rows);
}

/// A point light on the axis whose cone through a round lens becomes an even disk. A ray at angle t to the axis belongs to the
/// radius on the disk that keeps 1 - cos t even over its area; the profile follows from Snell's law along a radius.
class Cone {
 public:
  static constexpr double kAway = 400, kSpot = 40;  // mm: lamp before the back, radius of the disk

  Cone(const Lens& lens, const Receiver& receiver)
      : lens_(lens), receiver_z_(lens.thickness_mm + receiver.distance_mm), rim_mm_(lens.size_mm.x() / 2) {
    // The gauge, and the rim's height that says which ray is the outermost, by repetition.
    double centre = lens.thickness_mm;
    widest_ = angle_at(rim_mm_, lens.thickness_mm);
    for (int turn = 0; turn < 60; ++turn) {
      integrate(centre);
      widest_ = angle_at(rim_mm_, heights_.back());
      centre += lens.thickness_mm - *std::min_element(heights_.begin(), heights_.end());
    }
  }

  [[nodiscard]] double height(double radius) const {
    const double at = std::min(radius / rim_mm_, 1.0) * kSteps;
    const int k = std::min(static_cast<int>(at), kSteps - 1);
    // Cubic through both ends with their slopes.
    const double h = rim_mm_ / kSteps, u = at - k;
    return heights_[k] * (1 + 2 * u) * (1 - u) * (1 - u) + heights_[k + 1] * u * u * (3 - 2 * u) +
           h * (slopes_[k] * u * (1 - u) * (1 - u) - slopes_[k + 1] * u * u * (1 - u));
  }
  /// Where on the receiver the light goes that would land there unbent.
  [[nodiscard]] Vec2 target(const Vec2& unbent) const {
    if (!(unbent.norm() > 0)) return {0, 0};
    double low = 0, high = kPi / 4;
    for (int halving = 0; halving < 60; ++halving) {
      const double middle = (low + high) / 2;
      const double lands = (kAway + receiver_z_ - lens_.thickness_mm) * std::tan(middle) + lens_.thickness_mm * inside(middle);
      (lands < unbent.norm() ? low : high) = middle;
    }
    return unbent / unbent.norm() * spot(low);
  }

 private:
  static constexpr int kSteps = 2000;
  [[nodiscard]] double inside(double angle) const {
    const double sine = std::sin(angle) / lens_.refractive_index;
    return sine / std::sqrt(1 - sine * sine);
  }
  [[nodiscard]] double spot(double angle) const {
    return kSpot * std::sin(angle / 2) / std::sin(widest_ / 2);
  }
  /// Angle in air of the ray that comes through (radius, z).
  [[nodiscard]] double angle_at(double radius, double z) const {
    double low = 0, high = kPi / 4;
    for (int halving = 0; halving < 60; ++halving) {
      const double middle = (low + high) / 2;
      (kAway * std::tan(middle) + z * inside(middle) < radius ? low : high) = middle;
    }
    return (low + high) / 2;
  }
  [[nodiscard]] double slope(double radius, double z) const {
    const double angle = angle_at(radius, z);
    const Vec3 before = Vec3(inside(angle), 0, 1).normalized();
    const Vec3 after = Vec3(spot(angle) - radius, 0, receiver_z_ - z).normalized();
    const Vec3 normal = bending_normal(before, after, {lens_.refractive_index, 1});
    return -normal.x() / normal.z();
  }
  void integrate(double centre) {  // Runge and Kutta
    heights_.assign(1, centre);
    slopes_.assign(1, 0.0);
    const double h = rim_mm_ / kSteps;
    for (int k = 0; k < kSteps; ++k) {
      const double r = k * h, z = heights_.back();
      const double a = slope(r, z), b = slope(r + h / 2, z + h / 2 * a);
      const double c = slope(r + h / 2, z + h / 2 * b), d = slope(r + h, z + h * c);
      heights_.push_back(z + h / 6 * (a + 2 * b + 2 * c + d));
      slopes_.push_back(slope(r + h, heights_.back()));
    }
  }

  Lens lens_;
  double receiver_z_;
  double rim_mm_;
  double widest_ = 0;
  std::vector<double> heights_, slopes_;
};

void cone(bool by_transport, const Setting& setting) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  Light light;
  light.kind = Light::Kind::kPoint;
  light.position_mm = {0, 0, -Cone::kAway};
  const Receiver receiver;
  const Cone truth(lens, receiver);
  const char* name = by_transport ? "cone_map" : "cone";
  TransportMap map;
  if (by_transport) {
    TargetSpec spec;
    spec.drawing = std::filesystem::temp_directory_path() / "cone.svg";
    write_whole(spec.drawing, "<svg xmlns='http://www.w3.org/2000/svg' viewBox='-50 -50 100 100'><circle r='40' fill='white'/></svg>");
    TransportOptions options;
    options.samples = setting.samples;
    map = solve_transport(trace_source(lens, light, receiver, 512).source, load_target(spec), options);
  }
  const auto target = [&](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.push_back(truth.target(p));
    return targets;
  };
  const double before = cpu_seconds();
  const OpticalSurface s = by_transport ? solve_surface(lens, light, receiver, map, options_of(setting))
                                        : solve_surface(lens, light, receiver, target, options_of(setting));
  print_surface(name, s, cpu_seconds() - before);
  std::vector<double> errors;
  double mean = 0;
  for (const Vec3& p : s.mesh.vertices) {
    errors.push_back(1000 * (p.z() - truth.height(p.head<2>().norm())));
    mean += errors.back() / static_cast<double>(s.mesh.vertices.size());
  }
  for (double& e : errors) e -= mean;
  print_errors(name, errors);
}

/// CPU and wall seconds between reports of progress, by what they say.
class Phases {
 public:
  Monitor monitor() {
    return {[this](std::string_view what, double) { next(std::string(what)); }, {}};
  }
  void print(const char* name) {
    next("");
    std::printf("%s: seconds (CPU)", name);
    for (const std::string& what : order_) std::printf(", %s %.1f (%.1f)", what.c_str(), spent_[what].first, spent_[what].second);
    std::printf("\n");
  }

 private:
  void next(const std::string& what) {
    if (what == now_) return;
    const auto wall = std::chrono::steady_clock::now();
    const double cpu = cpu_seconds();
    if (!now_.empty()) {
      if (!spent_.contains(now_)) order_.push_back(now_);
      spent_[now_].first += std::chrono::duration<double>(wall - wall_).count();
      spent_[now_].second += cpu - cpu_;
    }
    now_ = what;
    wall_ = wall;
    cpu_ = cpu;
  }
  std::string now_;
  std::chrono::steady_clock::time_point wall_;
  double cpu_ = 0;
  std::vector<std::string> order_;
  std::map<std::string, std::pair<double, double>> spent_;
};

/// How much of the light that belongs to curves lands within half a millimetre of them, beside the area light that is wanted
/// there.
void print_curve_share(const char* name, const OpticalSurface& s, const Lens& lens, const Receiver& receiver,
                       const TargetLight& target) {
  constexpr int kPixels = 1000;
  constexpr double kBeside_mm = 0.5;
  const Caustic c = trace_mesh(s.mesh, lens, receiver, target.extent, {.pixels = kPixels});
  const Grid<double> all = rasterise(target, c.flux.width, c.flux.height);
  const Grid<double> areas = rasterise_area(target, c.flux.width, c.flux.height);
  const int reach = static_cast<int>(std::lround(kBeside_mm * c.flux.width / target.extent.size().x()));
  std::vector<char> beside(all.values.size(), 0);
  for (int j = 0; j < all.height; ++j) {
    for (int i = 0; i < all.width; ++i) {
      if (!(all.at(i, j) > areas.at(i, j) * (1 + 1e-9))) continue;
      for (int y = std::max(0, j - reach); y <= std::min(all.height - 1, j + reach); ++y) {
        for (int x = std::max(0, i - reach); x <= std::min(all.width - 1, i + reach); ++x) {
          if ((x - i) * (x - i) + (y - j) * (y - j) <= reach * reach) beside[static_cast<std::size_t>(y) * all.width + x] = 1;
        }
      }
    }
  }
  double landed = 0;
  for (std::size_t k = 0; k < beside.size(); ++k) landed += beside[k] ? c.flux.values[k] - areas.values[k] : 0;
  std::printf("%s: curves have %.4f of their light within %.1f mm\n", name, landed / target.curve_total(), kBeside_mm);
}

/// From a picture or drawing to the light behind the lens, transport included; its measures, and the picture under
/// --out.
void picture(const char* name, const std::string& image, const std::string& drawing, double white,
             const Setting& setting) {
  TargetSpec spec;
  spec.image = image;
  spec.drawing = drawing;
  const TargetLight target = load_target(spec);
  const Lens lens;
  const Receiver receiver;
  const double start = cpu_seconds();
  TransportOptions transport;
  transport.samples = setting.samples;
  const TransportMap map = solve_transport({}, target, transport);
  const double transported = cpu_seconds();
  Phases phases;
  const OpticalSurface s = solve_surface(lens, {}, receiver, map, target, options_of(setting), phases.monitor());
  print_surface(name, s, cpu_seconds() - transported);
  phases.print(name);
  const double solved = cpu_seconds();
  const Caustic c = trace_mesh(s.mesh, lens, receiver, target.extent);
  std::printf("%s: tracing %.1f s CPU\n", name, cpu_seconds() - solved);
  const CausticMeasures m = measure_caustic(c, target);
  if (target.curve_total() > 0) print_curve_share(name, s, lens, receiver, target);
  double landed = 0;
  for (double f : c.flux.values) landed += f;
  std::printf("%s: transport %.1f s CPU; l1_error %.4f, psnr %.2f dB, outside support %.4f, light - 1 = %.1e\n", name,
              transported - start, m.l1_error, m.psnr_db, m.flux_outside_support,
              landed + c.outside_extent + c.totally_reflected - 1);
  if (!setting.out.empty()) {
    write_png8(std::filesystem::path(setting.out) / (std::string(name) + ".png"),
               display_picture(c.flux, spec.viewed_from, white));
    write_ply(std::filesystem::path(setting.out) / (std::string(name) + ".ply"), s.mesh);
  }
}

void heights(const Setting&) {
  // A lens of raw-milled look: waves of 0.15 mm pitch on a sphere, 25 million nodes.
  constexpr int kNodes = 5001;
  Grid<float> smooth(kNodes, kNodes), wavy(kNodes, kNodes);
  for (int j = 0; j < kNodes; ++j) {
    for (int i = 0; i < kNodes; ++i) {
      const double x = -50 + 0.02 * i, y = -50 + 0.02 * j;
      const double z = 20 - (x * x + y * y) / 600;
      const double u = std::remainder(y, 0.155);
      smooth.at(i, j) = static_cast<float>(z);
      wavy.at(i, j) = static_cast<float>(z + u * u / 4);
    }
  }
  Lens lens;
  Receiver receiver;
  const Box2 box = Box2::centred({100, 100});
  for (const auto* grid : {&smooth, &wavy}) {
    const double before = cpu_seconds();
    const Caustic c = trace_heights(*grid, box, lens, {}, receiver, box);
    double landed = 0;
    for (double f : c.flux.values) landed += f;
    std::printf("heights (%s): %.2f s CPU, light %.15f, outside %.6f\n", grid == &smooth ? "smooth" : "milled",
                cpu_seconds() - before, landed + c.outside_extent + c.totally_reflected, c.outside_extent);
  }
}

/// A wide lamp through a lens of a ball's shape: 123 places of the lamp, each a beam through every triangle.
void rays(const Setting& setting) {
  Lens lens;
  SurfaceMesh mesh = start_mesh(lens, setting.mesh);
  for (Vec3& p : mesh.vertices) p.z() += 5 - p.head<2>().squaredNorm() / 1000;
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  constexpr int kPlaces = 123;
  const auto started = std::chrono::steady_clock::now();
  const double before = cpu_seconds();
  const Caustic c = trace_beams(mesh, lens, {}, {}, Box2::centred({100, 100}), {.angular_diameter_rad = 0.0093, .lamp_samples = kPlaces});
  double landed = c.outside_extent + c.totally_reflected + c.shadowed + c.enters_by_rim;
  for (double f : c.flux.values) landed += f;
  std::printf("rays: %.1f million beams in %.1f s wall, %.1f s CPU; light - 1 = %.1e\n",
              1e-6 * kPlaces * static_cast<double>(mesh.triangles.size()),
              std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count(), cpu_seconds() - before, landed - 1);
}

}  // namespace

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);  // a run that is cut short has still said something
  Setting setting;
  std::vector<std::string> cases;
  for (int a = 1; a < argc; ++a) {
    const std::string word = argv[a];
    if (word == "--mesh" && a + 1 < argc) {
      setting.mesh = std::atoi(argv[++a]);
    } else if (word == "--samples" && a + 1 < argc) {
      setting.samples = std::atoi(argv[++a]);
    } else if (word == "--smooth") {
      setting.solver = SurfaceSolver::kHeightField;
    } else if (word == "--turns" && a + 1 < argc) {
      setting.turns = std::atoi(argv[++a]);
    } else if (word == "--picture-turns" && a + 1 < argc) {
      setting.picture_turns = std::atoi(argv[++a]);
    } else if (word == "--out" && a + 1 < argc) {
      setting.out = argv[++a];
    } else {
      cases.push_back(word);
    }
  }
  if (cases.empty()) cases = {"point", "circle", "portrait", "rings", "letter", "heights"};
  for (const std::string& name : cases) {
    if (name == "point" || name == "slanted" || name == "near" || name == "sphere" || name == "two" || name == "five")
      point(name, setting);
    if (name == "line") line(setting);
    if (name == "circle" || name == "circle_map") circle(name == "circle_map", setting);
    if (name == "circles") circles(setting);
    if (name == "cone" || name == "cone_map") cone(name == "cone_map", setting);
    if (name == "heights") heights(setting);
    if (name == "rays") rays(setting);
    const std::string pictures = std::string(LIGHTMILL_FIXTURES) + "/pictures/";
    if (name == "portrait") picture("portrait", pictures + "astronaut.png", "", 3.4, setting);
    if (name == "horse") picture("horse", pictures + "horse.png", "", 6, setting);
    if (name == "rings") picture("rings", "", pictures + "rings.svg", 12, setting);
    if (name == "signed") picture("signed", pictures + "astronaut.png", pictures + "signature.svg", 3.4, setting);
    if (name == "letter") picture("letter", "", pictures + "letter_f.svg", 8, setting);
  }
}
