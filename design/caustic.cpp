#include "design/caustic.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>
#include <utility>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/light_grid.h"

namespace lightmill {

namespace {

using detail::LightGrid;

/// The grid that light is collected on: the caller's extent, and a margin as wide as the light's own blur, whose light
/// may be blurred into the extent.
struct Screen {
  Vec2 origin;  // of pixel (0, 0) with its margin, mm
  Vec2 pixel_mm;
  int width = 0;  // without margin
  int height = 0;
  int margin = 0;
  Vec2 blur_radius_px{0, 0};

  [[nodiscard]] int full_width() const { return width + 2 * margin; }
  [[nodiscard]] int full_height() const { return height + 2 * margin; }
};

Screen make_screen(const Box2& extent, const Receiver& receiver, const CausticOptions& options) {
  const Vec2 size = extent.size();
  if (options.pixels < 1)
    throw InputError("caustic: pixels is " + std::to_string(options.pixels) + ", must be at least 1");
  if (!(size.x() > 0 && size.y() > 0)) throw InputError("caustic: the picture's extent is empty");
  Screen screen;
  const double pixel = size.maxCoeff() / options.pixels;
  screen.width = std::max(1, static_cast<int>(std::lround(size.x() / pixel)));
  screen.height = std::max(1, static_cast<int>(std::lround(size.y() / pixel)));
  screen.pixel_mm = {size.x() / screen.width, size.y() / screen.height};
  const double blur_radius_mm = receiver.distance_mm * options.angular_diameter_rad / 2;
  screen.blur_radius_px = blur_radius_mm * screen.pixel_mm.cwiseInverse();
  screen.margin = blur_radius_mm > 0 ? static_cast<int>(std::ceil(screen.blur_radius_px.maxCoeff())) + 1 : 0;
  screen.origin = extent.min - screen.margin * screen.pixel_mm;
  return screen;
}

enum class Fate : char { kLands, kReflected, kNeverArrives, kEntersByRim, kUnlit };

/// Light along +Z onto an upright receiver: where the ray that leaves (x, y, z) through a surface with this normal lands, in
/// pixels of the screen. False: totally reflected.
struct Optics {
  double ratio = 1;  // index before over index after
  double receiver_z = 0;
  Vec2 origin;
  Vec2 pixels_per_mm;

  Optics(const Lens& lens, const Receiver& receiver, const Screen& screen)
      : ratio(lens.refractive_index),
        receiver_z(lens.thickness_mm + receiver.distance_mm),
        origin(screen.origin),
        pixels_per_mm(screen.pixel_mm.cwiseInverse()) {}

  Fate land(const Vec3& point, const Vec3& normal, Vec3& flux, Vec2& landed) const {
    flux = Vec3::UnitZ();
    return land(point.x(), point.y(), point.z(), normal.x(), normal.y(), normal.z(), landed) ? Fate::kLands : Fate::kReflected;
  }

  /// refract() for light along +Z: the direction is (-a nx, -a ny, ratio - a nz) with a = ratio nz - cos(angle after).
  bool land(double x, double y, double z, double nx, double ny, double nz, Vec2& landed) const {
    const double cos_squared = 1 - ratio * ratio * (1 - nz * nz);
    if (!(cos_squared >= 0)) return false;
    const double along = ratio * nz - std::sqrt(cos_squared);
    const double way = (receiver_z - z) / (ratio - along * nz);
    landed = {(x - way * along * nx - origin.x()) * pixels_per_mm.x(),
              (y - way * along * ny - origin.y()) * pixels_per_mm.y()};
    return true;
  }
};

/// The same for any light and receiver.
class LitOptics {
 public:
  LitOptics(const Lens& lens, const Light& light, const Receiver& receiver, const Screen& screen)
      : lens_(lens),
        illumination_(light, lens),
        frame_(receiver_frame(lens, receiver)),
        origin_(screen.origin),
        pixels_per_mm_(screen.pixel_mm.cwiseInverse()) {}

  /// `flux`: along the ray inside the lens, per mm^2 of a plane at right angles.
  Fate land(const Vec3& point, const Vec3& normal, Vec3& flux, Vec2& landed) const {
    const IncomingRay ray = illumination_.at(point);
    flux = ray.irradiance / ray.direction.z() * ray.direction;
    if (!(ray.irradiance > 0)) return Fate::kUnlit;
    if (!enters_back(lens_, ray.entry_mm, point.head<2>())) return Fate::kEntersByRim;
    Vec3 after;
    if (!refract(ray.direction, normal, {lens_.refractive_index, 1}, after)) return Fate::kReflected;
    if (!frame_.meet(point, after, landed)) return Fate::kNeverArrives;
    landed = (landed - origin_).cwiseProduct(pixels_per_mm_);
    return Fate::kLands;
  }

 private:
  const Lens& lens_;
  Illumination illumination_;
  ReceiverFrame frame_;
  Vec2 origin_;
  Vec2 pixels_per_mm_;
};

/// Box kernel of a disk, row by row with prefix sums; each row's half-width is the chord's mean over the pixel row.
/// Light that leaves the grid is added to `outside`.
Grid<double> blurred(const Grid<double>& flux, const Vec2& radius_px, double& outside) {
  const int rows = static_cast<int>(std::ceil(radius_px.y() + 0.5));
  std::vector<double> half_width(2 * rows + 1, 0.0);
  double area = 0;
  for (int d = -rows; d <= rows; ++d) {
    constexpr int kSamples = 16;
    double mean = 0;
    for (int s = 0; s < kSamples; ++s) {
      const double y = (d - 0.5 + (s + 0.5) / kSamples) / radius_px.y();
      if (std::abs(y) < 1) mean += std::sqrt(1 - y * y) / kSamples;
    }
    half_width[d + rows] = mean * radius_px.x();
    area += 2 * half_width[d + rows];
  }
  Grid<double> result(flux.width, flux.height);
  const double total = [&] {
    double sum = 0;
    for (double f : flux.values) sum += f;
    return sum;
  }();
  // prefix.at(i) is the light left of pixel line i.
  Grid<double> prefix(flux.width + 1, flux.height);
  for (int j = 0; j < flux.height; ++j) {
    for (int i = 0; i < flux.width; ++i) prefix.at(i + 1, j) = prefix.at(i, j) + flux.at(i, j);
  }
  const auto light_left_of = [&](double x, int j) {
    const double clamped = std::clamp(x, 0.0, static_cast<double>(flux.width));
    const int i = std::min(static_cast<int>(clamped), flux.width - 1);
    return prefix.at(i, j) + (clamped - i) * flux.at(i, j);
  };
  // What a pixel gets from a row is the light within the chord around it; summed over pixels that is chord times light.
  parallel_blocks(flux.height, 16, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int d = -rows; d <= rows; ++d) {
        const int from = j + d;
        const double w = half_width[d + rows];
        if (from < 0 || from >= flux.height || w <= 0) continue;
        for (int i = 0; i < flux.width; ++i) {
          result.at(i, j) += (light_left_of(i + 0.5 + w, from) - light_left_of(i + 0.5 - w, from)) / area;
        }
      }
    }
  });
  double kept = 0;
  for (double f : result.values) kept += f;
  outside += total - kept;
  return result;
}

/// Sums the blocks' grids in their order, blurs, and cuts the margin off.
Caustic collect(std::vector<LightGrid>& parts, const Screen& screen, const Box2& extent) {
  Caustic caustic;
  caustic.extent = extent;
  Grid<double> sum = std::move(parts.front().flux);
  double outside = parts.front().outside;
  for (std::size_t p = 1; p < parts.size(); ++p) {
    for (std::size_t i = 0; i < sum.values.size(); ++i) sum.values[i] += parts[p].flux.values[i];
    outside += parts[p].outside;
  }
  if (screen.margin > 0) {
    sum = blurred(sum, screen.blur_radius_px, outside);
    caustic.flux = Grid<double>(screen.width, screen.height);
    for (int j = 0; j < screen.full_height(); ++j) {
      for (int i = 0; i < screen.full_width(); ++i) {
        const int column = i - screen.margin;
        const int row = j - screen.margin;
        if (column >= 0 && row >= 0 && column < screen.width && row < screen.height) {
          caustic.flux.at(column, row) = sum.at(i, j);
        } else {
          outside += sum.at(i, j);
        }
      }
    }
  } else {
    caustic.flux = std::move(sum);
  }
  caustic.outside_extent = outside;
  return caustic;
}

/// How many grids of their own the blocks of beams may have: enough for the cores, within 256 MB. Depends on the screen
/// only, so that sums are made in the same order whatever the thread count.
std::size_t block_count(const Screen& screen) {
  const double bytes = 8.0 * screen.full_width() * screen.full_height();
  return static_cast<std::size_t>(std::clamp(256e6 / bytes, 2.0, 16.0));
}

}  // namespace

Caustic trace_mesh(const SurfaceMesh& mesh, const Lens& lens, const Receiver& receiver, const Box2& extent,
                   const CausticOptions& options, const Monitor& monitor) {
  const Screen screen = make_screen(extent, receiver, options);
  const Optics optics(lens, receiver, screen);

  // Where every vertex's ray lands.
  std::vector<Vec2> landed(mesh.vertices.size());
  std::vector<char> passes(mesh.vertices.size());
  parallel_blocks(mesh.vertices.size(), 8192, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      const Vec3& p = mesh.vertices[v];
      const Vec3& n = mesh.normals[v];
      passes[v] = optics.land(p.x(), p.y(), p.z(), n.x(), n.y(), n.z(), landed[v]);
    }
  });

  // Every triangle's share of the lens area; one that is folded over still carries the light that falls on it.
  std::vector<double> share(mesh.triangles.size());
  double lens_area = 0;
  for (std::size_t t = 0; t < share.size(); ++t) {
    const Vec3 ab = mesh.vertices[mesh.triangles[t][1]] - mesh.vertices[mesh.triangles[t][0]];
    const Vec3 ac = mesh.vertices[mesh.triangles[t][2]] - mesh.vertices[mesh.triangles[t][0]];
    share[t] = std::abs(ab.x() * ac.y() - ab.y() * ac.x());
    lens_area += share[t];
  }
  if (!(lens_area > 0)) throw InputError("caustic: the surface has no area");

  const std::size_t block = (share.size() + block_count(screen) - 1) / block_count(screen);
  const std::size_t blocks = (share.size() + block - 1) / block;
  std::vector<LightGrid> parts(blocks, LightGrid(screen.full_width(), screen.full_height()));
  std::vector<double> reflected(blocks, 0.0);
  monitor.report("tracing light", 0.0);
  parallel_blocks(share.size(), block, [&](std::size_t begin, std::size_t end) {
    LightGrid& grid = parts[begin / block];
    for (std::size_t t = begin; t < end; ++t) {
      const double amount = share[t] / lens_area;
      std::array<Vec2, 3> corners;
      int passing = 0;
      for (int corner : mesh.triangles[t]) {
        if (passes[corner]) corners[passing++] = landed[corner];
      }
      // Each corner stands for a third of the beam: what its surface reflects is lost, the rest goes where it points.
      if (passing == 3) {
        grid.add_triangle(corners[0], corners[1], corners[2], amount);
        continue;
      }
      reflected[begin / block] += amount * (3 - passing) / 3;
      if (passing == 2) grid.add_triangle(corners[0], corners[1], (corners[0] + corners[1]) / 2, amount * 2 / 3);
      if (passing == 1) grid.add_point(corners[0], amount / 3);
    }
  });
  monitor.report("tracing light", 1.0);
  Caustic caustic = collect(parts, screen, extent);
  for (const double r : reflected) caustic.totally_reflected += r;
  return caustic;
}

namespace {

/// Which squares of a row of the height map lie on the lens, by their centres.
std::vector<char> squares_on_lens(const Lens& lens, double y, double first_x, double pitch, int count) {
  std::vector<char> on(count, lens.shape == Lens::Shape::kRectangle);
  if (lens.shape == Lens::Shape::kDisk) {
    for (int i = 0; i < count; ++i) on[i] = Vec2(first_x + i * pitch, y).cwiseQuotient(lens.size_mm / 2).squaredNorm() <= 1;
  }
  if (lens.shape == Lens::Shape::kOutline) {
    std::vector<double> crossings;
    for (const auto& loop : lens.outline_mm) {
      for (std::size_t k = 0; k < loop.size(); ++k) {
        const Vec2& p = loop[k];
        const Vec2& q = loop[(k + 1) % loop.size()];
        if ((p.y() > y) != (q.y() > y)) crossings.push_back(p.x() + (y - p.y()) / (q.y() - p.y()) * (q.x() - p.x()));
      }
    }
    std::sort(crossings.begin(), crossings.end());
    std::size_t passed = 0;
    for (int i = 0; i < count; ++i) {
      while (passed < crossings.size() && crossings[passed] <= first_x + i * pitch) ++passed;
      on[i] = passed % 2 == 1;
    }
  }
  return on;
}

/// What becomes of the light at a row of nodes.
struct NodeRow {
  explicit NodeRow(int width) : points(width), landed(width), flux(width), fate(width) {}
  std::vector<Vec3> points;
  std::vector<Vec2> landed;
  std::vector<Vec3> flux;
  std::vector<Fate> fate;
};

struct Lost {
  double reflected = 0, never = 0, rim = 0;
  double light = 0;  // all, whatever became of it
};

template <typename OpticsOfLight>
Caustic spread_heights(const OpticsOfLight& optics, const Screen& screen, const Grid<float>& heights_mm, const Box2& lens_extent,
                       const Lens& lens, const Box2& picture_extent, const Monitor& monitor) {
  const int width = heights_mm.width;
  const int height = heights_mm.height;
  const Vec2 pitch = lens_extent.size().cwiseQuotient(Vec2(width - 1, height - 1));

  // One row of nodes: where the rays land. Slopes by central differences, one-sided (second order) at the rim.
  const auto slope = [](double before, double here, double after, double step) {
    if (std::isfinite(before) && std::isfinite(after)) return (after - before) / (2 * step);
    if (std::isfinite(after)) return (after - here) / step;
    if (std::isfinite(before)) return (here - before) / step;
    return 0.0;
  };
  const auto rim_slope = [](double here, double one, double two, double step) {
    return std::isfinite(two) ? (4 * one - 3 * here - two) / (2 * step) : (one - here) / step;
  };
  const auto land_row = [&](int j, NodeRow& row) {
    const double y = lens_extent.min.y() + pitch.y() * j;
    for (int i = 0; i < width; ++i) {
      const double here = heights_mm.at(i, j);
      double gx, gy;
      if (i == 0) {
        gx = rim_slope(here, heights_mm.at(1, j), width > 2 ? heights_mm.at(2, j) : NAN, pitch.x());
      } else if (i + 1 == width) {
        gx = -rim_slope(here, heights_mm.at(i - 1, j), width > 2 ? heights_mm.at(i - 2, j) : NAN, pitch.x());
      } else {
        gx = slope(heights_mm.at(i - 1, j), here, heights_mm.at(i + 1, j), pitch.x());
      }
      if (j == 0) {
        gy = rim_slope(here, heights_mm.at(i, 1), height > 2 ? heights_mm.at(i, 2) : NAN, pitch.y());
      } else if (j + 1 == height) {
        gy = -rim_slope(here, heights_mm.at(i, j - 1), height > 2 ? heights_mm.at(i, j - 2) : NAN, pitch.y());
      } else {
        gy = slope(heights_mm.at(i, j - 1), here, heights_mm.at(i, j + 1), pitch.y());
      }
      const double nz = 1 / std::sqrt(1 + gx * gx + gy * gy);
      row.points[i] = {lens_extent.min.x() + pitch.x() * i, y, here};
      row.fate[i] = std::isfinite(here) ? optics.land(row.points[i], {-gx * nz, -gy * nz, nz}, row.flux[i], row.landed[i]) : Fate::kUnlit;
    }
  };

  const std::size_t rows = height - 1;
  const std::size_t block = (rows + block_count(screen) - 1) / block_count(screen);
  const std::size_t blocks = (rows + block - 1) / block;
  std::vector<LightGrid> parts(blocks, LightGrid(screen.full_width(), screen.full_height()));
  std::vector<Lost> losses(blocks);
  monitor.report("tracing light", 0.0);
  parallel_blocks(rows, block, [&](std::size_t begin, std::size_t end) {
    LightGrid& grid = parts[begin / block];
    Lost& lost = losses[begin / block];
    NodeRow low(width), high(width);
    land_row(static_cast<int>(begin), low);
    for (std::size_t j = begin; j < end; ++j) {
      land_row(static_cast<int>(j + 1), high);
      const std::vector<char> on_lens =
          squares_on_lens(lens, lens_extent.min.y() + pitch.y() * (static_cast<double>(j) + 0.5), lens_extent.min.x() + pitch.x() / 2, pitch.x(), width - 1);
      double outside_before = grid.outside;  // summed row by row: 25 million equal terms in one sum would lose digits
      grid.outside = 0;
      Lost in_row;
      for (int i = 0; i + 1 < width; ++i) {
        // No light beside the lens or where there is no material.
        if (!on_lens[i] || !std::isfinite(low.points[i].z() + low.points[i + 1].z() + high.points[i].z() + high.points[i + 1].z())) continue;
        const std::array<std::pair<const NodeRow*, int>, 4> nodes{{{&low, i}, {&low, i + 1}, {&high, i}, {&high, i + 1}}};
        const Vec3 area = (high.points[i + 1] - low.points[i]).cross(high.points[i] - low.points[i + 1]) / 2;
        std::array<double, 4> quarter{};
        double amount = 0;
        int passing = 0;
        for (int k = 0; k < 4; ++k) {
          const auto& [row, column] = nodes[k];
          quarter[k] = std::is_same_v<OpticsOfLight, Optics> ? pitch.prod() / 4 : std::abs(row->flux[column].dot(area)) / 4;
          amount += quarter[k];
          passing += row->fate[column] == Fate::kLands;
        }
        in_row.light += amount;
        if (passing < 4) {
          for (int k = 0; k < 4; ++k) {
            const auto& [row, column] = nodes[k];
            switch (row->fate[column]) {
              case Fate::kUnlit: break;
              case Fate::kLands: grid.add_point(row->landed[column], quarter[k]); break;
              case Fate::kReflected: in_row.reflected += quarter[k]; break;
              case Fate::kNeverArrives: in_row.never += quarter[k]; break;
              case Fate::kEntersByRim: in_row.rim += quarter[k]; break;
            }
          }
          continue;
        }
        // The image of the square is bilinear. It is cut into parts no larger than a pixel, and each part is spread
        // over the box with the part's own width and height: neighbours' boxes tile, and no light moves by more than a
        // pixel.
        const Vec2& a = low.landed[i];
        const Vec2& b = low.landed[i + 1];
        const Vec2& c = high.landed[i];
        const Vec2& d = high.landed[i + 1];
        const double along_u = std::max((b - a).cwiseAbs().maxCoeff(), (d - c).cwiseAbs().maxCoeff());
        const double along_v = std::max((c - a).cwiseAbs().maxCoeff(), (d - b).cwiseAbs().maxCoeff());
        constexpr double kMostParts = 16;  // a beam torn wider than so many pixels leaves gaps: it is scatter
        const int parts_u = static_cast<int>(std::clamp(std::ceil(along_u), 1.0, kMostParts));
        const int parts_v = static_cast<int>(std::clamp(std::ceil(along_v), 1.0, kMostParts));
        if (parts_u == 1 && parts_v == 1) {
          const Vec2 eu = (b - a + d - c) / 2;
          const Vec2 ev = (c - a + d - b) / 2;
          const Vec2 half = (eu.cwiseAbs() + ev.cwiseAbs()).cwiseMin(Vec2::Ones()) / 2;
          grid.add_small_box((a + b + c + d) / 4, half.x(), half.y(), amount);
          continue;
        }
        const double part = amount / (parts_u * parts_v);
        for (int v = 0; v < parts_v; ++v) {
          const double tv = (v + 0.5) / parts_v;
          const Vec2 start = a + (c - a) * tv;
          const Vec2 along = b + (d - b) * tv - start;
          const Vec2 ev_left = (c - a) / parts_v;
          const Vec2 ev_right = (d - b) / parts_v;
          for (int u = 0; u < parts_u; ++u) {
            const double tu = (u + 0.5) / parts_u;
            const Vec2 ev = ev_left + (ev_right - ev_left) * tu;
            const Vec2 half = ((along / parts_u).cwiseAbs() + ev.cwiseAbs()).cwiseMin(Vec2::Ones()) / 2;
            grid.add_small_box(start + along * tu, half.x(), half.y(), part);
          }
        }
      }
      grid.outside += outside_before;
      lost.reflected += in_row.reflected;
      lost.never += in_row.never;
      lost.rim += in_row.rim;
      lost.light += in_row.light;
      std::swap(low, high);
    }
  });
  monitor.report("tracing light", 1.0);

  Lost all;
  for (const Lost& lost : losses) {
    all.reflected += lost.reflected;
    all.never += lost.never;
    all.rim += lost.rim;
    all.light += lost.light;
  }
  if (!(all.light > 0)) throw InputError("caustic: no square of the height map carries light");
  Caustic caustic = collect(parts, screen, picture_extent);
  for (double& f : caustic.flux.values) f /= all.light;
  caustic.outside_extent = (caustic.outside_extent + all.never) / all.light;
  caustic.totally_reflected = all.reflected / all.light;
  caustic.enters_by_rim = all.rim / all.light;
  return caustic;
}

}  // namespace

Caustic trace_heights(const Grid<float>& heights_mm, const Box2& lens_extent, const Lens& lens, const Light& light,
                      const Receiver& receiver, const Box2& picture_extent, const CausticOptions& options,
                      const Monitor& monitor) {
  if (heights_mm.width < 2 || heights_mm.height < 2)
    throw InputError("caustic: a height map needs at least 2 x 2 nodes");
  const Screen screen = make_screen(picture_extent, receiver, options);
  const bool plain = light.kind == Light::Kind::kParallel && light.direction.head<2>().isZero(0) && light.direction.z() > 0 &&
                     light.profile.kind == Profile::Kind::kUniform && receiver.shift_mm.isZero(0) && receiver.tilt_rad.isZero(0);
  if (plain) return spread_heights(Optics(lens, receiver, screen), screen, heights_mm, lens_extent, lens, picture_extent, monitor);
  return spread_heights(LitOptics(lens, light, receiver, screen), screen, heights_mm, lens_extent, lens, picture_extent, monitor);
}

namespace {

/// Flux resampled onto `count` x `count` cells of `cell` mm from `origin`; what lies beside them is dropped.
Grid<double> resampled(const Grid<double>& flux, const Box2& extent, const Vec2& origin, const Vec2& cell, int count) {
  struct Share {
    int cell;
    double part;
  };
  // Each pixel column (row) lies in one or more cell columns (rows): the shares of its width.
  const auto shares = [&](int pixels, int axis) {
    std::vector<std::vector<Share>> result(pixels);
    const double pixel = extent.size()[axis] / pixels;
    for (int i = 0; i < pixels; ++i) {
      const double low = (extent.min[axis] + i * pixel - origin[axis]) / cell[axis];
      const double high = low + pixel / cell[axis];
      for (int c = std::max(0, static_cast<int>(std::floor(low))); c < count && c < high; ++c) {
        const double part = (std::min(high, c + 1.0) - std::max(low, static_cast<double>(c))) / (high - low);
        if (part > 0) result[i].push_back({c, part});
      }
    }
    return result;
  };
  const auto columns = shares(flux.width, 0);
  const auto rows = shares(flux.height, 1);
  Grid<double> result(count, count);
  for (int j = 0; j < flux.height; ++j) {
    for (int i = 0; i < flux.width; ++i) {
      for (const Share& row : rows[j]) {
        for (const Share& column : columns[i]) {
          result.at(column.cell, row.cell) += flux.at(i, j) * row.part * column.part;
        }
      }
    }
  }
  return result;
}

}  // namespace

CausticMeasures measure_caustic(const Caustic& caustic, const TargetLight& target) {
  constexpr int kCells = 256;
  constexpr int kGrown = 2;                     // cells that the support is grown by
  constexpr int kFramed = kCells + 2 * kGrown;  // the grown support may stick out of the picture
  const Vec2 cell = target.extent.size() / kCells;
  const Grid<double> light = resampled(caustic.flux, caustic.extent, target.extent.min - kGrown * cell, cell, kFramed);
  const Grid<double> wanted = rasterise(target, kCells, kCells);
  double wanted_total = 0;
  double brightest = 0;
  for (double w : wanted.values) {
    wanted_total += w;
    brightest = std::max(brightest, w);
  }
  if (!(wanted_total > 0)) throw InputError("caustic: the target has no light to compare with");

  CausticMeasures measures;
  constexpr double kCellCount = static_cast<double>(kCells) * kCells;
  double absolute = 0;
  double squared = 0;
  for (int j = 0; j < kCells; ++j) {
    for (int i = 0; i < kCells; ++i) {
      const double difference =
          light.at(i + kGrown, j + kGrown) * kCellCount - wanted.at(i, j) * kCellCount / wanted_total;
      absolute += std::abs(difference);
      squared += difference * difference;
    }
  }
  measures.l1_error = absolute / kCellCount;
  const double peak = brightest * kCellCount / wanted_total;
  // A perfect caustic would have infinite PSNR, which no report can hold.
  measures.psnr_db = squared > 0 ? std::min(200.0, 10 * std::log10(peak * peak / (squared / kCellCount))) : 200.0;

  // Light within the support grown by kGrown cells (a disk).
  double within = 0;
  for (int j = 0; j < kFramed; ++j) {
    for (int i = 0; i < kFramed; ++i) {
      bool supported = false;
      for (int dj = -kGrown; dj <= kGrown && !supported; ++dj) {
        for (int di = -kGrown; di <= kGrown && !supported; ++di) {
          const int column = i - kGrown + di;
          const int row = j - kGrown + dj;
          if (di * di + dj * dj > kGrown * kGrown || column < 0 || row < 0 || column >= kCells || row >= kCells)
            continue;
          supported = wanted.at(column, row) > 0;
        }
      }
      if (supported) within += light.at(i, j);
    }
  }
  measures.flux_outside_support = std::max(
      0.0, 1 - caustic.totally_reflected - caustic.fresnel_reflected - caustic.shadowed - caustic.enters_by_rim - within);
  measures.flux_totally_reflected = caustic.totally_reflected;
  return measures;
}

Grid<float> display_picture(const Grid<double>& flux, ViewedFrom viewed_from, double white) {
  double total = 0;
  for (double f : flux.values) total += f;
  const double scale = total > 0 && white > 0 ? static_cast<double>(flux.values.size()) / (total * white) : 0.0;
  Grid<float> scaled(flux.width, flux.height);
  for (std::size_t i = 0; i < flux.values.size(); ++i) scaled.values[i] = static_cast<float>(flux.values[i] * scale);
  return as_seen(scaled, viewed_from);
}

}  // namespace lightmill
