#include "design/source.h"

#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "design/detail/outline_mesh.h"
#include "design/detail/svg.h"
#include "design/surface.h"

namespace lightmill {

namespace {

double doubled_area(const Vec2& a, const Vec2& b, const Vec2& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
}

detail::PlanarMesh lens_mesh(const Lens& lens, int resolution) {
  const double edge = lens.size_mm.maxCoeff() / resolution;
  if (lens.shape == Lens::Shape::kOutline) return detail::outline_mesh(lens.outline_mm, 1.3 * edge);
  if (lens.shape == Lens::Shape::kDisk) {
    // A polygon of the disk's area.
    const int corners = 4 * resolution;
    const double radius = lens.size_mm.x() / 2 * std::sqrt(2 * kPi / corners / std::sin(2 * kPi / corners));
    std::vector<Vec2> loop;
    for (int k = 0; k < corners; ++k)
      loop.emplace_back(radius * std::cos(2 * kPi * k / corners), radius * std::sin(2 * kPi * k / corners));
    return detail::outline_mesh({loop}, 1.3 * edge);
  }
  const SurfaceMesh grid = start_mesh(lens, resolution + 1);
  detail::PlanarMesh mesh;
  for (const Vec3& vertex : grid.vertices) mesh.vertices.emplace_back(vertex.head<2>());
  mesh.triangles = grid.triangles;
  return mesh;
}

/// What a vertex of the lens's mesh sends to the receiver.
struct Beam {
  enum class Fate { kArrives, kReflected, kLost };
  Fate fate = Fate::kArrives;
  Vec2 place{0, 0};
  double irradiance = 0;  // flux per mm^2 of the lens's x-y area
  bool beside_back = false;
};

std::string at(const Vec2& p) {
  return "x = " + fixed(p.x(), 2) + ", y = " + fixed(p.y(), 2) + " mm";
}

}  // namespace

double SourceMesh::flux() const {
  double sum = 0;
  for (const auto& t : triangles)
    sum += doubled_area(vertices_mm[t[0]], vertices_mm[t[1]], vertices_mm[t[2]]) / 6 *
           (irradiance_per_mm2[t[0]] + irradiance_per_mm2[t[1]] + irradiance_per_mm2[t[2]]);
  return sum;
}

std::vector<std::string> SourceReport::words() const {
  std::vector<std::string> lines;
  const auto percent = [](double share) { return compact(100 * share, 4) + " % of the light "; };
  if (totally_reflected.share > 0)
    lines.push_back(percent(totally_reflected.share) + "is totally reflected at the base surface, first at lens " +
                    at(totally_reflected.lens_mm));
  if (lost.share > 0)
    lines.push_back(percent(lost.share) + "never meets the receiver, first from lens " + at(lost.lens_mm));
  if (folded.share > 0)
    lines.push_back(percent(folded.share) + "folds over the rest, first from lens " + at(folded.lens_mm) +
                    " to receiver " + at(folded.receiver_mm));
  if (beside_back.share > 0)
    lines.push_back(percent(beside_back.share) +
                    "would have to enter through the lens's side or a hole's, first for lens " +
                    at(beside_back.lens_mm));
  if (unlit_share > 0) lines.push_back(compact(100 * unlit_share, 4) + " % of the lens is not lit");
  return lines;
}

bool is_plain_source(const Lens& lens, const Light& light, const Receiver& receiver) {
  return light.kind == Light::Kind::kParallel && light.direction.head<2>().isZero(0) &&
         light.profile.kind == Profile::Kind::kUniform && lens.base.kind == Base::Kind::kFlat &&
         lens.shape != Lens::Shape::kOutline && receiver.shift_mm.isZero(0) && receiver.tilt_rad.isZero(0);
}

TracedSource trace_source(const Lens& lens, const Light& light, const Receiver& receiver, int resolution) {
  if (!(lens.size_mm.minCoeff() > 0)) throw InputError("lens.size_mm must be above 0");
  if (!(receiver.distance_mm > 0)) throw InputError("receiver.distance_mm must be above 0");
  if (resolution < 2) throw InputError("source: at least 2 vertices along the lens's longer side");
  const Illumination illumination(light, lens);
  TracedSource traced;
  if (is_plain_source(lens, light, receiver)) {
    traced.source.shape = lens.shape == Lens::Shape::kDisk ? SourceLight::Shape::kDisk : SourceLight::Shape::kRectangle;
    traced.source.size_mm = lens.size_mm;
    return traced;
  }

  const detail::PlanarMesh plane = lens_mesh(lens, resolution);
  if (plane.triangles.empty()) throw InputError("lens.outline encloses nothing; draw a closed, filled shape");
  const std::size_t count = plane.vertices.size();
  const BaseSurface base_surface(lens.base);
  std::vector<BasePoint> base(count);
  double lowest = std::numeric_limits<double>::infinity();
  for (std::size_t v = 0; v < count; ++v) {
    base[v] = base_surface.at(plane.vertices[v]);
    lowest = std::min(lowest, base[v].height_mm);
  }

  // Each vertex's ray.
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  std::vector<Beam> beams(count);
  for (std::size_t v = 0; v < count; ++v) {
    const Vec2& p = plane.vertices[v];
    const Vec3 point(p.x(), p.y(), lens.thickness_mm + base[v].height_mm - lowest);
    const IncomingRay ray = illumination.at(point);
    const double facing = ray.direction.dot(base[v].normal);
    Beam& beam = beams[v];
    // From the plane z = const to the surface above the same x-y area.
    beam.irradiance = ray.irradiance * std::max(0.0, facing / (base[v].normal.z() * ray.direction.z()));
    beam.beside_back = beam.irradiance > 0 && !enters_back(lens, ray.entry_mm, p);
    Vec3 out;
    if (!refract(ray.direction, base[v].normal, {lens.refractive_index, 1}, out)) {
      beam.fate = Beam::Fate::kReflected;
    } else if (!frame.meet(point, out, beam.place)) {
      beam.fate = Beam::Fate::kLost;
    }
  }
  // Light that comes straight up enters where it leaves: its border is no side wall.
  const bool upright = light.kind == Light::Kind::kParallel && light.direction.head<2>().isZero(0);

  // Triangles that arrive whole; the shares of the others.
  SourceReport& report = traced.report;
  double total = 0, unlit = 0, area_sum = 0, signed_sum = 0;
  std::vector<std::array<int, 3>> arriving;
  for (const auto& t : plane.triangles) {
    const double area = doubled_area(plane.vertices[t[0]], plane.vertices[t[1]], plane.vertices[t[2]]) / 2;
    area_sum += area;
    double flux = 0;
    bool arrives = true;
    for (const int v : t) flux += area / 3 * beams[v].irradiance;
    total += flux;
    if (flux == 0) unlit += area;
    const auto note = [&](SourceFault& fault, int v) {
      if (fault.share == 0) fault.lens_mm = plane.vertices[v];
      fault.share += flux;
    };
    for (const auto& [fate, fault] :
         {std::pair{Beam::Fate::kReflected, &report.totally_reflected}, std::pair{Beam::Fate::kLost, &report.lost}}) {
      for (const int v : t) {
        if (!arrives || beams[v].fate != fate) continue;
        if (flux > 0) note(*fault, v);
        arrives = false;
      }
    }
    for (const int v : t) {
      if (upright || flux == 0 || !beams[v].beside_back) continue;
      note(report.beside_back, v);
      break;
    }
    if (!arrives || flux == 0) continue;
    arriving.push_back(t);
    signed_sum += doubled_area(beams[t[0]].place, beams[t[1]].place, beams[t[2]].place) > 0 ? flux : -flux;
  }
  if (!(total > 0)) throw InputError("light: none of it meets the lens; move the light or widen its profile");
  if (arriving.empty()) {
    std::string why;
    for (const auto& line : report.words()) why += "; " + line;
    throw InputError("light: none of it arrives on the receiver" + (why.empty() ? std::string() : why));
  }
  const double mirrored = signed_sum < 0 ? -1 : 1;  // past a line focus all light arrives mirrored; that folds nothing

  // Irradiance by the ratio of the areas around a vertex: what leaves the lens arrives, to rounding.
  std::vector<double> before(count, 0.0);
  std::vector<double> after(count, 0.0);
  for (const auto& t : arriving) {
    const double area = doubled_area(plane.vertices[t[0]], plane.vertices[t[1]], plane.vertices[t[2]]);
    const double image = mirrored * doubled_area(beams[t[0]].place, beams[t[1]].place, beams[t[2]].place);
    if (image <= 0) {
      SourceFault& fault = report.folded;
      if (fault.share == 0) {
        fault.lens_mm = plane.vertices[t[0]];
        fault.receiver_mm = beams[t[0]].place;
      }
      fault.share += area / 6 * (beams[t[0]].irradiance + beams[t[1]].irradiance + beams[t[2]].irradiance);
    }
    for (const int v : t) {
      before[v] += area;
      after[v] += std::abs(image);
    }
  }
  for (SourceFault* fault : {&report.totally_reflected, &report.lost, &report.folded, &report.beside_back})
    fault->share /= total;
  report.unlit_share = unlit / area_sum;

  SourceLight& source = traced.source;
  source.shape = SourceLight::Shape::kMesh;
  SourceMesh& mesh = source.mesh;
  std::vector<int> number(count, -1);
  Box2 box;
  for (auto t : arriving) {
    if (doubled_area(beams[t[0]].place, beams[t[1]].place, beams[t[2]].place) < 0) std::swap(t[1], t[2]);
    for (int& v : t) {
      if (number[v] < 0) {
        number[v] = static_cast<int>(mesh.vertices_mm.size());
        mesh.vertices_mm.push_back(beams[v].place);
        mesh.lens_mm.push_back(plane.vertices[v]);
        mesh.irradiance_per_mm2.push_back(after[v] > 0 ? beams[v].irradiance * before[v] / after[v] : 0);
        box.include(beams[v].place);
      }
      v = number[v];
    }
    mesh.triangles.push_back(t);
  }
  source.size_mm = box.size();
  const double flux = mesh.flux();
  if (!(flux > 0 && source.size_mm.minCoeff() > 1e-9 * lens.size_mm.maxCoeff()))
    throw InputError(
        "light: the base surface focuses all of it on a point or a line of the receiver; move the receiver "
        "(distance_mm)");
  for (double& e : mesh.irradiance_per_mm2) e /= flux;
  return traced;
}

LensOutline read_outline(const std::string& path, const Vec2& size_mm) {
  const detail::Drawing drawing = detail::read_drawing(path, size_mm, ViewedFrom::kBehind, detail::DrawingUse::kOutlines);
  LensOutline outline{{}, drawing.warnings};
  for (const auto& fill : drawing.shapes.fills) {
    for (const auto& loop : fill.shape.outlines_mm) {
      if (loop.size() >= 3) outline.loops_mm.push_back(loop);
    }
  }
  if (outline.loops_mm.empty()) throw InputError(path + ": lens.outline needs a filled path; fill the shape of the lens");
  return outline;
}

Grid<float> rasterise_source(const SourceLight& source, const Box2& extent, int width, int height) {
  Grid<float> picture(width, height, 0.0F);
  const Vec2 pitch = extent.size().cwiseQuotient(Vec2(width, height));
  const auto centre = [&](int i, int j) { return Vec2(extent.min + pitch.cwiseProduct(Vec2(i + 0.5, j + 0.5))); };
  if (source.shape != SourceLight::Shape::kMesh) {
    const bool disk = source.shape == SourceLight::Shape::kDisk;
    const double area = source.size_mm.prod() * (disk ? kPi / 4 : 1);
    for (int j = 0; j < height; ++j) {
      for (int i = 0; i < width; ++i) {
        const Vec2 p = centre(i, j).cwiseQuotient(source.size_mm);
        if (disk ? p.norm() <= 0.5 : p.cwiseAbs().maxCoeff() <= 0.5) picture.at(i, j) = static_cast<float>(1 / area);
      }
    }
    return picture;
  }
  constexpr double kRounding = 1e-6;
  const SourceMesh& mesh = source.mesh;
  for (const auto& t : mesh.triangles) {
    const Vec2 &a = mesh.vertices_mm[t[0]], &b = mesh.vertices_mm[t[1]], &c = mesh.vertices_mm[t[2]];
    const double area = doubled_area(a, b, c);
    if (!(area > 0)) continue;
    Box2 box;
    for (const Vec2& p : {a, b, c}) box.include((p - extent.min).cwiseQuotient(pitch) - Vec2(0.5, 0.5));
    for (int j = std::max(0, static_cast<int>(std::ceil(box.min.y() - kRounding)));
         j <= std::min(height - 1, static_cast<int>(std::floor(box.max.y() + kRounding))); ++j) {
      for (int i = std::max(0, static_cast<int>(std::ceil(box.min.x() - kRounding)));
           i <= std::min(width - 1, static_cast<int>(std::floor(box.max.x() + kRounding))); ++i) {
        const Vec2 p = centre(i, j);
        // Twice the signed areas change sign exactly when an edge is seen from its other side: a centre on it counts once.
        const double parts[3] = {doubled_area(p, b, c), doubled_area(p, c, a), doubled_area(p, a, b)};
        const auto beside = [](double part, const Vec2& from, const Vec2& to) {
          return part < 0 || (part == 0 && (to.y() > from.y() || (to.y() == from.y() && to.x() < from.x())));
        };
        if (beside(parts[0], b, c) || beside(parts[1], c, a) || beside(parts[2], a, b)) continue;
        const double u = parts[0] / area, v = parts[1] / area, w = 1 - u - v;
        picture.at(i, j) += static_cast<float>(u * mesh.irradiance_per_mm2[t[0]] + v * mesh.irradiance_per_mm2[t[1]] +
                                               w * mesh.irradiance_per_mm2[t[2]]);
      }
    }
  }
  return picture;
}

}  // namespace lightmill
