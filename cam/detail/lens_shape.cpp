#include "cam/detail/lens_shape.h"

#include <BRepAdaptor_Surface.hxx>
#include <BRepBuilderAPI_MakeEdge.hxx>
#include <BRepBuilderAPI_MakeFace.hxx>
#include <BRepBuilderAPI_MakeWire.hxx>
#include <BRepFilletAPI_MakeChamfer.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRepPrimAPI_MakePrism.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <Geom2d_BSplineCurve.hxx>
#include <Geom2d_Line.hxx>
#include <Geom_BSplineCurve.hxx>
#include <Geom_BSplineSurface.hxx>
#include <Geom_Circle.hxx>
#include <Geom_CylindricalSurface.hxx>
#include <Geom_Line.hxx>
#include <Geom_Plane.hxx>
#include <Geom_SurfaceOfLinearExtrusion.hxx>
#include <TColgp_Array1OfPnt.hxx>
#include <TColgp_Array1OfPnt2d.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopLoc_Location.hxx>
#include <TopTools_IndexedMapOfShape.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Shell.hxx>
#include <TopoDS_Solid.hxx>
#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "cam/detail/spline_refinement.h"
#include "cam/detail/wall_curve.h"
#include "design/core/text.h"

namespace lightmill::detail {

namespace {

// Spans of one tile: one face of 640 spans takes FreeCAD 106 s to tessellate, tiles of 80 take 4.6 s.
constexpr int kTileSpans = 80;
// Coefficients of a tile that differ by less from those of a surface of half as many spans are rounding.
constexpr double kSameMm = 1e-11;
// Of the edges along a trimmed top from the surface.
constexpr double kOnSurfaceMm = 2e-8;
// Share of a span that borders of tiles keep from where the outline turns around or has corners.
constexpr double kClearSpans = 0.05;

/// Coefficients first..first+spans+2 of a uniform cubic, with the knots at both ends inserted until the end points are
/// poles. Ends depend on the same three coefficients from either side in the same order, so neighbours agree to the
/// bit.
template <typename Coefficient>
std::vector<double> clamped_poles(int spans, Coefficient c) {
  const auto end_point = [](double a, double b, double d) { return (a + d + 4 * b) / 6; };
  std::vector<double> poles(spans + 3);
  for (int i = 2; i <= spans; ++i) poles[i] = c(i);
  poles[0] = end_point(c(0), c(1), c(2));
  poles[1] = (2 * c(1) + c(2)) / 3;
  poles[spans + 1] = (c(spans) + 2 * c(spans + 1)) / 3;
  poles[spans + 2] = end_point(c(spans), c(spans + 1), c(spans + 2));
  return poles;
}

/// One axis of the tiling: borders in spans, and where a knot lies in mm.
struct Axis {
  double from_mm, to_mm;
  int spans;
  std::vector<int> borders;  ///< of the tiles, in spans

  Axis(double from, double to, int count) : from_mm(from), to_mm(to), spans(count) { divide(0, count, {}); }

  /// Of what lies between the lowest and the highest of these places, and at least half a span more on both sides. Borders
  /// in between keep clear of all of them.
  Axis(double from, double to, int count, const std::vector<double>& places_mm) : from_mm(from), to_mm(to), spans(count) {
    const auto [lowest, highest] = std::minmax_element(places_mm.begin(), places_mm.end());
    const auto units = [&](double place) { return (place - from) / (to - from) * spans / unit(); };
    divide(unit() * static_cast<int>(std::floor(units(*lowest) - 0.5)), unit() * static_cast<int>(std::ceil(units(*highest) + 0.5)), places_mm);
  }

  /// Spans of twice the size fit an even tile.
  [[nodiscard]] int unit() const { return spans % 2 == 0 ? 2 : 1; }

  void divide(int first, int last, const std::vector<double>& clear_of_mm) {
    const int tiles = std::max(1, static_cast<int>(std::lround(static_cast<double>(last - first) / kTileSpans)));
    const double clear_mm = kClearSpans * (to_mm - from_mm) / spans;
    for (int t = 0; t <= tiles; ++t) {
      const int even = first + unit() * static_cast<int>(static_cast<long>((last - first) / unit()) * t / tiles);
      int best = even;
      double room = -1;
      for (int step = 0; step < kTileSpans / 3 && room < clear_mm && t > 0 && t < tiles; ++step) {
        const int border = even + unit() * (step % 2 == 0 ? step / 2 : -(step + 1) / 2);
        if (border <= first || border >= last) continue;
        double least = clear_mm;
        for (const double place : clear_of_mm) least = std::min(least, std::abs(place - knot_mm(border)));
        if (least <= room) continue;
        room = least;
        best = border;
      }
      borders.push_back(best);
    }
  }

  [[nodiscard]] int tiles() const { return static_cast<int>(borders.size()) - 1; }
  [[nodiscard]] double knot_mm(int span) const {
    return span == spans ? to_mm : from_mm + (to_mm - from_mm) * span / spans;
  }
  [[nodiscard]] double border_mm(int border) const { return knot_mm(borders[border]); }

  [[nodiscard]] int tile_spans(int tile) const { return borders[tile + 1] - borders[tile]; }

  /// Knots of a tile, every `stride`th; the parameter is the coordinate itself.
  [[nodiscard]] TColStd_Array1OfReal knots(int tile, int stride) const {
    TColStd_Array1OfReal result(1, tile_spans(tile) / stride + 1);
    for (int k = 1; k <= result.Upper(); ++k) result(k) = knot_mm(borders[tile] + (k - 1) * stride);
    return result;
  }
  [[nodiscard]] TColStd_Array1OfInteger multiplicities(int tile, int stride) const {
    TColStd_Array1OfInteger result(1, tile_spans(tile) / stride + 1);
    result.Init(1);
    result(1) = result(result.Upper()) = 4;
    return result;
  }
  /// The coordinate of every pole (Greville abscissae of the clamped knots).
  [[nodiscard]] std::vector<double> pole_mm(int tile, int stride) const {
    const int first = borders[tile], last = borders[tile + 1];
    const auto knot = [&](int k) { return knot_mm(std::clamp(first + k * stride, first, last)); };
    std::vector<double> result(tile_spans(tile) / stride + 3);
    for (int i = 0; i < static_cast<int>(result.size()); ++i) result[i] = (knot(i - 2) + knot(i - 1) + knot(i)) / 3;
    result.front() = knot_mm(first);
    result.back() = knot_mm(last);
    return result;
  }
};

/// The surface between the axes' borders; the parameters of every tile are x and y.
Grid<Handle(Geom_BSplineSurface)> tiles_of(const SplineSurface& surface, const Axis& x, const Axis& y) {
  const auto make_tile = [&](int ti, int tj) -> Handle(Geom_BSplineSurface) {
    Grid<double> coefficients(x.tile_spans(ti) + 3, y.tile_spans(tj) + 3);
    for (int j = 0; j < coefficients.height; ++j) {
      for (int i = 0; i < coefficients.width; ++i) {
        coefficients.at(i, j) = surface.padded_coefficients().at(surface.padding() + x.borders[ti] + i, surface.padding() + y.borders[tj] + j);
      }
    }
    // Where the fit went without finer spans, the file does, too: a quarter of the poles for the very same surface, its edges included.
    int stride = 1;
    if (auto fewer = with_spans_doubled(coefficients, kSameMm)) {
      coefficients = std::move(*fewer);
      stride = 2;
    }
    // Clamp along x, then along y.
    for (int j = 0; j < coefficients.height; ++j) {
      const auto row = clamped_poles(coefficients.width - 3, [&](int i) { return coefficients.at(i, j); });
      std::copy(row.begin(), row.end(), &coefficients.at(0, j));
    }
    const std::vector<double> pole_x = x.pole_mm(ti, stride), pole_y = y.pole_mm(tj, stride);
    TColgp_Array2OfPnt poles(1, coefficients.width, 1, coefficients.height);
    for (int i = 0; i < coefficients.width; ++i) {
      const auto column = clamped_poles(coefficients.height - 3, [&](int j) { return coefficients.at(i, j); });
      for (int j = 0; j < coefficients.height; ++j) poles(i + 1, j + 1) = gp_Pnt(pole_x[i], pole_y[j], column[j]);
    }
    return new Geom_BSplineSurface(poles, x.knots(ti, stride), y.knots(tj, stride), x.multiplicities(ti, stride),
                                   y.multiplicities(tj, stride), 3, 3);
  };
  Grid<Handle(Geom_BSplineSurface)> tiles(x.tiles(), y.tiles());
  for (int j = 0; j < tiles.height; ++j) {
    for (int i = 0; i < tiles.width; ++i) tiles.at(i, j) = make_tile(i, j);
  }
  return tiles;
}

/// Vertices, edges, wires and planar faces that know each other.
class TopologyBuilder {
 protected:
  /// An edge as a wire uses it.
  struct Use {
    TopoDS_Edge edge;
    bool forward;
  };

  TopoDS_Vertex vertex(const gp_Pnt& p) {
    TopoDS_Vertex v;
    builder_.MakeVertex(v, p, kToleranceMm);
    return v;
  }

  TopoDS_Edge edge(const Handle(Geom_Curve) & curve, const TopoDS_Vertex& from, const TopoDS_Vertex& to, double first,
                   double last) {
    TopoDS_Edge e;
    builder_.MakeEdge(e, curve, kToleranceMm);
    builder_.Add(e, from.Oriented(TopAbs_FORWARD));
    builder_.Add(e, to.Oriented(TopAbs_REVERSED));
    builder_.Range(e, first, last);
    return e;
  }

  TopoDS_Edge straight_edge(const TopoDS_Vertex& from, const TopoDS_Vertex& to) {
    const gp_Pnt a = BRep_Tool::Pnt(from);
    const gp_Pnt b = BRep_Tool::Pnt(to);
    return edge(new Geom_Line(a, gp_Dir(gp_Vec(a, b))), from, to, 0, a.Distance(b));
  }

  TopoDS_Wire wire(const std::vector<Use>& uses) {
    TopoDS_Wire w;
    builder_.MakeWire(w);
    for (const Use& use : uses) builder_.Add(w, use.edge.Oriented(use.forward ? TopAbs_FORWARD : TopAbs_REVERSED));
    w.Closed(true);
    return w;
  }

  /// A plane through `point` whose normal points out of the solid.
  TopoDS_Face planar_face(const gp_Pnt& point, const gp_Dir& outwards, const std::vector<Use>& uses) {
    TopoDS_Face face;
    builder_.MakeFace(face, new Geom_Plane(point, outwards), kToleranceMm);
    builder_.Add(face, wire(uses));
    return face;
  }

  TopoDS_Solid solid(TopoDS_Shell& shell) {
    shell.Closed(true);
    TopoDS_Solid solid;
    builder_.MakeSolid(solid);
    builder_.Add(solid, shell);
    return solid;
  }

  BRep_Builder builder_;
};

/// Builds the solid of all of the surface: shared vertices and edges first, then faces that use them.
class LensBuilder : private TopologyBuilder {
 public:
  /// Flat below in z = `base_z`.
  LensBuilder(const SplineSurface& surface, double base_z)
      : base_z_(base_z),
        x_(surface.extent().min.x(), surface.extent().max.x(), surface.spans_x()),
        y_(surface.extent().min.y(), surface.extent().max.y(), surface.spans_y()),
        tiles_(tiles_of(surface, x_, y_)) {}

  TopoDS_Solid build() {
    make_vertices();
    make_edges();
    TopoDS_Shell shell;
    builder_.MakeShell(shell);
    for (int j = 0; j < y_.tiles(); ++j) {
      for (int i = 0; i < x_.tiles(); ++i) builder_.Add(shell, tile_face(i, j));
    }
    add_walls(shell);
    builder_.Add(shell, back_face());
    return solid(shell);
  }

 private:
  /// The corner of tiles where borders i and j cross.
  [[nodiscard]] gp_Pnt corner(int i, int j) const {
    const int ti = std::min(i, x_.tiles() - 1);
    const int tj = std::min(j, y_.tiles() - 1);
    const auto& s = tiles_.at(ti, tj);
    return s->Pole(i == ti ? 1 : s->NbUPoles(), j == tj ? 1 : s->NbVPoles());
  }

  void make_vertices() {
    top_vertices_ = Grid<TopoDS_Vertex>(x_.tiles() + 1, y_.tiles() + 1);
    for (int j = 0; j <= y_.tiles(); ++j) {
      for (int i = 0; i <= x_.tiles(); ++i) top_vertices_.at(i, j) = vertex(corner(i, j));
    }
    // Of the back, counter-clockwise seen from +Z.
    const double x[4] = {x_.from_mm, x_.to_mm, x_.to_mm, x_.from_mm};
    const double y[4] = {y_.from_mm, y_.from_mm, y_.to_mm, y_.to_mm};
    for (int k = 0; k < 4; ++k) back_vertices_[k] = vertex(gp_Pnt(x[k], y[k], base_z_));
  }

  void make_edges() {
    along_x_ = Grid<TopoDS_Edge>(x_.tiles(), y_.tiles() + 1);
    for (int j = 0; j <= y_.tiles(); ++j) {
      for (int i = 0; i < x_.tiles(); ++i) {
        const auto& s = tiles_.at(i, std::min(j, y_.tiles() - 1));
        along_x_.at(i, j) = edge(s->VIso(y_.border_mm(j)), top_vertices_.at(i, j), top_vertices_.at(i + 1, j),
                                 x_.border_mm(i), x_.border_mm(i + 1));
      }
    }
    along_y_ = Grid<TopoDS_Edge>(x_.tiles() + 1, y_.tiles());
    for (int j = 0; j < y_.tiles(); ++j) {
      for (int i = 0; i <= x_.tiles(); ++i) {
        const auto& s = tiles_.at(std::min(i, x_.tiles() - 1), j);
        along_y_.at(i, j) = edge(s->UIso(x_.border_mm(i)), top_vertices_.at(i, j), top_vertices_.at(i, j + 1),
                                 y_.border_mm(j), y_.border_mm(j + 1));
      }
    }
    const int nx = x_.tiles(), ny = y_.tiles();
    const TopoDS_Vertex tops[4] = {top_vertices_.at(0, 0), top_vertices_.at(nx, 0), top_vertices_.at(nx, ny),
                                   top_vertices_.at(0, ny)};
    for (int k = 0; k < 4; ++k) {
      upright_[k] = straight_edge(back_vertices_[k], tops[k]);
      back_[k] = straight_edge(back_vertices_[k], back_vertices_[(k + 1) % 4]);
    }
  }

  TopoDS_Face tile_face(int i, int j) {
    TopoDS_Face face;
    builder_.MakeFace(face, tiles_.at(i, j), kToleranceMm);
    const double x0 = x_.border_mm(i), x1 = x_.border_mm(i + 1), y0 = y_.border_mm(j), y1 = y_.border_mm(j + 1);
    // The curves on the face: parameters are x and y, and an edge's parameter is the coordinate that runs.
    const auto on_face = [&](const TopoDS_Edge& e, const gp_Pnt2d& origin, const gp_Dir2d& along) {
      builder_.UpdateEdge(e, new Geom2d_Line(origin, along), face, kToleranceMm);
    };
    on_face(along_x_.at(i, j), {0, y0}, {1, 0});
    on_face(along_x_.at(i, j + 1), {0, y1}, {1, 0});
    on_face(along_y_.at(i, j), {x0, 0}, {0, 1});
    on_face(along_y_.at(i + 1, j), {x1, 0}, {0, 1});
    builder_.Add(face, wire({{along_x_.at(i, j), true},
                             {along_y_.at(i + 1, j), true},
                             {along_x_.at(i, j + 1), false},
                             {along_y_.at(i, j), false}}));
    return face;
  }

  void add_walls(TopoDS_Shell& shell) {
    const gp_Dir outwards[4] = {{0, -1, 0}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}};
    for (int k = 0; k < 4; ++k) {
      // Counter-clockwise seen from outside: along the back, up, along the top the other way, down.
      std::vector<Use> uses{{back_[k], true}, {upright_[(k + 1) % 4], true}};
      switch (k) {
        case 0:
          for (int i = x_.tiles() - 1; i >= 0; --i) uses.push_back({along_x_.at(i, 0), false});
          break;
        case 1:
          for (int j = y_.tiles() - 1; j >= 0; --j) uses.push_back({along_y_.at(x_.tiles(), j), false});
          break;
        case 2:
          for (int i = 0; i < x_.tiles(); ++i) uses.push_back({along_x_.at(i, y_.tiles()), true});
          break;
        default:
          for (int j = 0; j < y_.tiles(); ++j) uses.push_back({along_y_.at(0, j), true});
      }
      uses.push_back({upright_[k], false});
      builder_.Add(shell, planar_face(BRep_Tool::Pnt(back_vertices_[k]), outwards[k], uses));
    }
  }

  TopoDS_Face back_face() {
    std::vector<Use> uses;
    for (int k = 3; k >= 0; --k) uses.push_back({back_[k], false});
    return planar_face(BRep_Tool::Pnt(back_vertices_[0]), gp_Dir(0, 0, -1), uses);
  }

  double base_z_;
  Axis x_, y_;
  Grid<Handle(Geom_BSplineSurface)> tiles_;
  Grid<TopoDS_Vertex> top_vertices_;  ///< where tile borders cross
  TopoDS_Vertex back_vertices_[4];
  Grid<TopoDS_Edge> along_x_, along_y_;  ///< tile borders
  TopoDS_Edge upright_[4], back_[4];
};

/// A C1 cubic through places with these speeds at the knots, Curve being Geom_ or Geom2d_BSplineCurve.
template <typename Curve, typename Points, typename Place>
Handle(Curve) cubic_through(const std::vector<double>& knots, const std::vector<Place>& places, const std::vector<Place>& speeds) {
  const int n = static_cast<int>(knots.size());
  TColStd_Array1OfReal k(1, n);
  TColStd_Array1OfInteger multiplicities(1, n);
  Points poles(1, 2 * n);
  const auto set = [&](int pole, const Place& p) {
    for (int axis = 0; axis < p.size(); ++axis) poles.ChangeValue(pole).SetCoord(axis + 1, p[axis]);
  };
  set(1, places[0]);
  set(2 * n, places[n - 1]);
  for (int i = 0; i < n; ++i) {
    k(i + 1) = knots[i];
    multiplicities(i + 1) = i == 0 || i == n - 1 ? 4 : 2;
    if (i > 0) set(2 * i + 1, places[i] - speeds[i] * ((knots[i] - knots[i - 1]) / 3));
    if (i + 1 < n) set(2 * i + 2, places[i] + speeds[i] * ((knots[i + 1] - knots[i]) / 3));
  }
  return new Curve(poles, k, multiplicities, 3);
}

/// A cubic in space by its knots, and what faces see of it.
struct SpaceCubic {
  std::vector<double> knots;
  std::vector<Vec3> places, speeds;

  [[nodiscard]] Handle(Geom_Curve) curve() const { return cubic_through<Geom_BSplineCurve, TColgp_Array1OfPnt>(knots, places, speeds); }
  [[nodiscard]] Handle(Geom2d_Curve) seen_along_z() const {
    return flat([](double, const Vec3& p) { return Vec2(p.x(), p.y()); }, [](const Vec3& v) { return Vec2(v.x(), v.y()); });
  }
  /// On an upright wall of the same parameter, by height above its base.
  [[nodiscard]] Handle(Geom2d_Curve) on_wall(double base_z) const {
    return flat([&](double t, const Vec3& p) { return Vec2(t, p.z() - base_z); }, [](const Vec3& v) { return Vec2(1, v.z()); });
  }

 private:
  template <typename Place, typename Speed>
  [[nodiscard]] Handle(Geom2d_Curve) flat(const Place& place, const Speed& speed) const {
    std::vector<Vec2> at, along;
    for (std::size_t k = 0; k < knots.size(); ++k) {
      at.push_back(place(knots[k], places[k]));
      along.push_back(speed(speeds[k]));
    }
    return cubic_through<Geom2d_BSplineCurve, TColgp_Array1OfPnt2d>(knots, at, along);
  }
};

/// A wall's line in the height `z`.
Handle(Geom_Curve) level_curve(const WallPiece& piece, double z) {
  if (piece.radius_mm > 0) {
    return new Geom_Circle(gp_Ax2(gp_Pnt(0, 0, z), gp_Dir(0, 0, 1), gp_Dir(1, 0, 0)), piece.radius_mm);
  }
  SpaceCubic cubic{piece.knots, {}, {}};
  for (std::size_t k = 0; k < piece.knots.size(); ++k) {
    cubic.places.emplace_back(piece.places[k].x(), piece.places[k].y(), z);
    cubic.speeds.emplace_back(piece.speeds[k].x(), piece.speeds[k].y(), 0);
  }
  if (!piece.straight()) return cubic.curve();
  const Vec3 &a = cubic.places[0], &along = cubic.speeds[0];
  return new Geom_Line(gp_Pnt(a.x(), a.y(), a.z()), gp_Dir(along.x(), along.y(), 0));
}

/// Builds the solid of what lies within an outline, without booleans. Over each tile the surface's parameters are x and y, so that
/// the wall's line as seen from above is its curve on the tile. It is cut where it crosses the tiles' borders, which keep clear
/// of where it turns around: every crossing is a true one. A face is a loop of such pieces and of pieces of borders.
class TrimmedLensBuilder : private TopologyBuilder {
 public:
  TrimmedLensBuilder(const SplineSurface& surface, const std::vector<WallPiece>& walls, double base_z)
      : surface_(surface),
        walls_(walls),
        base_z_(base_z),
        axes_{Axis(surface.extent().min.x(), surface.extent().max.x(), surface.spans_x(), turning_places(0)),
              Axis(surface.extent().min.y(), surface.extent().max.y(), surface.spans_y(), turning_places(1))},
        tiles_(tiles_of(surface, axes_[0], axes_[1])),
        used_(tiles_.width, tiles_.height) {}

  TopoDS_Solid build() {
    TopoDS_Shell shell;
    builder_.MakeShell(shell);
    for (const WallPiece& wall : walls_) {
      const Vec2& p = wall.places.front();
      tops_.push_back(top_vertex(p));
      backs_.push_back(vertex(gp_Pnt(p.x(), p.y(), base_z_)));
      uprights_.push_back(straight_edge(backs_.back(), vertices_[tops_.back()]));
    }
    for (int w = 0; w < static_cast<int>(walls_.size()); ++w) add_wall(shell, w);
    for (const int axis : {0, 1}) cut_borders(axis);
    for (int j = 0; j < tiles_.height; ++j) {
      for (int i = 0; i < tiles_.width; ++i) add_faces(shell, i, j);
    }
    std::vector<Use> around;
    for (auto edge = back_edges_.rbegin(); edge != back_edges_.rend(); ++edge) around.push_back({*edge, false});
    builder_.Add(shell, planar_face(BRep_Tool::Pnt(backs_[0]), gp_Dir(0, 0, -1), around));
    return solid(shell);
  }

 private:
  /// An edge as a tile uses it, from vertex to vertex.
  struct Step {
    Use use;
    int from, to;
  };
  struct Cut {
    double at;  ///< along the curve or border
    int vertex;
  };

  /// Along one axis: where walls begin or turn around, and, along the second, where they cross the first one's borders, too.
  [[nodiscard]] std::vector<double> turning_places(int axis) const {
    std::vector<double> places;
    for (const WallPiece& wall : walls_) {
      for (const double t : wall.turns(axis)) places.push_back(wall.place(t)[axis]);
      if (axis == 0) continue;
      for (std::size_t border = 1; border + 1 < axes_[0].borders.size(); ++border) {
        for (const double t : crossings(wall, 0, axes_[0].border_mm(static_cast<int>(border)))) places.push_back(wall.place(t).y());
      }
    }
    return places;
  }

  /// Where a wall crosses a coordinate, in order.
  static std::vector<double> crossings(const WallPiece& wall, int axis, double at_mm) {
    std::vector<double> result;
    const std::vector<double> turns = wall.turns(axis);
    for (std::size_t k = 0; k + 1 < turns.size(); ++k) {
      double from = turns[k], to = turns[k + 1];
      const bool above = wall.place(from)[axis] > at_mm;
      if (above == (wall.place(to)[axis] > at_mm)) continue;
      for (int halving = 0; halving < 60; ++halving) {
        const double middle = (from + to) / 2;
        ((wall.place(middle)[axis] > at_mm) == above ? from : to) = middle;
      }
      result.push_back((from + to) / 2);
    }
    return result;
  }

  int top_vertex(const Vec2& p) {
    vertices_.push_back(vertex(gp_Pnt(p.x(), p.y(), surface_.height(p.x(), p.y()))));
    return static_cast<int>(vertices_.size()) - 1;
  }

  /// The tile along an axis that a coordinate lies in.
  [[nodiscard]] int tile_at(int axis, double at_mm) const {
    int tile = 0;
    while (tile + 1 < axes_[axis].tiles() && axes_[axis].border_mm(tile + 1) < at_mm) ++tile;
    return tile;
  }

  /// The surface over a wall from one parameter to another.
  [[nodiscard]] SpaceCubic over(const WallPiece& wall, double from, double to) const {
    SpaceCubic cubic;
    const auto add = [&](double t) {
      const Vec2 p = wall.place(t), v = wall.speed(t);
      const SplineSurface::Sample s = surface_.sample(p.x(), p.y());
      cubic.knots.push_back(t);
      cubic.places.emplace_back(p.x(), p.y(), s.h);
      cubic.speeds.emplace_back(v.x(), v.y(), s.hx * v.x() + s.hy * v.y());
    };
    // Halved until it keeps to wall and surface.
    const auto go_to = [&](const auto& self, double t, int depth) -> void {
      const SpaceCubic before{{cubic.knots.back()}, {cubic.places.back()}, {cubic.speeds.back()}};
      add(t);
      const double a = before.knots[0], h = t - a;
      double worst = 0;
      for (const double u : {0.2, 0.4, 0.5, 0.6, 0.8}) {
        const double v = 1 - u;
        const Vec3 p = v * v * (1 + 2 * u) * before.places[0] + u * u * (1 + 2 * v) * cubic.places.back() +
                       u * v * h * (v * before.speeds[0] - u * cubic.speeds.back());
        const Vec2 q = wall.place(a + u * h);
        worst = std::max(worst, (p - Vec3(q.x(), q.y(), surface_.height(q.x(), q.y()))).norm());
      }
      if (worst <= kOnSurfaceMm || depth == 0) return;
      for (auto* values : {&cubic.places, &cubic.speeds}) values->pop_back();
      cubic.knots.pop_back();
      self(self, a + h / 2, depth - 1);
      self(self, t, depth - 1);
    };
    const double span_mm = surface_.span_mm().minCoeff();
    add(from);
    for (std::size_t k = 0; k < wall.knots.size(); ++k) {
      // Knots next to an end are none.
      const double knot = k + 1 < wall.knots.size() && wall.knots[k + 1] < to - kToleranceMm ? wall.knots[k + 1] : to;
      const double start = cubic.knots.back();
      if (knot <= start + kToleranceMm) continue;
      const double length = (knot - start) * (wall.radius_mm > 0 ? wall.radius_mm : 1);
      const int steps = std::max(1, static_cast<int>(std::ceil(length / span_mm)));
      for (int m = 1; m <= steps; ++m) go_to(go_to, m == steps ? knot : start + (knot - start) * m / steps, 8);
      if (knot == to) break;
    }
    return cubic;
  }

  /// One wall with its edges; cuts its upper line at the tiles' borders.
  void add_wall(TopoDS_Shell& shell, int w) {
    const WallPiece& wall = walls_[w];
    const int next = (w + 1) % static_cast<int>(walls_.size());
    const double first = wall.knots.front(), last = wall.knots.back();
    std::vector<Cut> cuts{{first, tops_[w]}, {last, tops_[next]}};
    for (const int axis : {0, 1}) {
      for (int border = 1; border < axes_[axis].tiles(); ++border) {
        const double at_mm = axes_[axis].border_mm(border);
        for (const double t : crossings(wall, axis, at_mm)) {
          Vec2 place = wall.place(t);
          place[axis] = at_mm;
          const int v = top_vertex(place);
          cuts.push_back({t, v});
          border_cuts_[axis][border].push_back({place[1 - axis], v});
        }
      }
    }
    std::sort(cuts.begin(), cuts.end(), [](const Cut& a, const Cut& b) { return a.at < b.at; });

    const gp_Pnt foot = BRep_Tool::Pnt(backs_[w]);
    const Handle(Geom_Curve) below = level_curve(wall, base_z_);
    back_edges_.push_back(edge(below, backs_[w], backs_[next], first, last));
    std::vector<Use> uses{{back_edges_.back(), true}, {uprights_[next], true}};
    std::vector<SpaceCubic> cubics;
    for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
      const SpaceCubic& cubic = cubics.emplace_back(over(wall, cuts[k].at, cuts[k + 1].at));
      const TopoDS_Edge top = edge(cubic.curve(), vertices_[cuts[k].vertex], vertices_[cuts[k + 1].vertex], cuts[k].at, cuts[k + 1].at);
      const Vec2 middle = wall.place((cuts[k].at + cuts[k + 1].at) / 2);
      const int i = tile_at(0, middle.x()), j = tile_at(1, middle.y());
      builder_.UpdateEdge(top, cubic.seen_along_z(), tiles_.at(i, j), TopLoc_Location(), kToleranceMm);
      used_.at(i, j).push_back({{top, true}, cuts[k].vertex, cuts[k + 1].vertex});
      uses.insert(uses.begin() + 2, {top, false});
    }
    uses.push_back({uprights_[w], false});
    if (wall.straight()) {
      builder_.Add(shell, planar_face(foot, gp_Dir(wall.speeds[0].y(), -wall.speeds[0].x(), 0), uses));
      return;
    }
    // Parameters are the wall's own and the height.
    const gp_Dir up(0, 0, 1);
    Handle(Geom_Surface) upright;
    if (wall.radius_mm > 0) {
      upright = new Geom_CylindricalSurface(gp_Ax3(gp_Pnt(0, 0, base_z_), up, gp_Dir(1, 0, 0)), wall.radius_mm);
    } else {
      upright = new Geom_SurfaceOfLinearExtrusion(below, up);
    }
    const auto on_wall = [&](const TopoDS_Edge& e, const Handle(Geom2d_Curve) & curve) {
      builder_.UpdateEdge(e, curve, upright, TopLoc_Location(), kToleranceMm);
    };
    on_wall(back_edges_.back(), new Geom2d_Line(gp_Pnt2d(0, 0), gp_Dir2d(1, 0)));
    on_wall(uprights_[w], new Geom2d_Line(gp_Pnt2d(first, 0), gp_Dir2d(0, 1)));
    on_wall(uprights_[next], new Geom2d_Line(gp_Pnt2d(last, 0), gp_Dir2d(0, 1)));
    for (std::size_t k = 0; k < cubics.size(); ++k) on_wall(uses[uses.size() - 2 - k].edge, cubics[k].on_wall(base_z_));
    TopoDS_Face face;
    builder_.MakeFace(face, upright, kToleranceMm);
    builder_.Add(face, wire(uses));
    builder_.Add(shell, face);
  }

  /// Where borders of the two axes cross within the outline.
  int tile_corner(int i, int j) {
    const auto [found, fresh] = corners_.try_emplace({i, j}, -1);
    if (fresh) found->second = top_vertex({axes_[0].border_mm(i), axes_[1].border_mm(j)});
    return found->second;
  }

  /// The pieces of an axis' borders that lie within the outline, for the tiles on both sides.
  void cut_borders(int axis) {
    const Axis& across = axes_[1 - axis];
    for (int border = 1; border < axes_[axis].tiles(); ++border) {
      std::vector<Cut>& cuts = border_cuts_[axis][border];
      const auto before = [](const Cut& a, const Cut& b) { return a.at < b.at; };
      std::sort(cuts.begin(), cuts.end(), before);
      for (std::size_t c = 0; c + 1 < cuts.size(); c += 2) {
        std::vector<Cut> ends{cuts[c], cuts[c + 1]};
        for (int other = 1; other < across.tiles(); ++other) {
          const double at = across.border_mm(other);
          if (at > cuts[c].at && at < cuts[c + 1].at) ends.push_back({at, axis == 0 ? tile_corner(border, other) : tile_corner(other, border)});
        }
        std::sort(ends.begin(), ends.end(), before);
        for (std::size_t k = 0; k + 1 < ends.size(); ++k) add_border(axis, border, ends[k], ends[k + 1]);
      }
    }
  }

  void add_border(int axis, int border, const Cut& from, const Cut& to) {
    const double at_mm = axes_[axis].border_mm(border);
    const int along = tile_at(1 - axis, (from.at + to.at) / 2);
    const auto tile = [&](int beside) { return axis == 0 ? std::pair(beside, along) : std::pair(along, beside); };
    const auto [i, j] = tile(border);
    const auto& s = tiles_.at(i, j);
    const TopoDS_Edge e = edge(axis == 0 ? s->UIso(at_mm) : s->VIso(at_mm), vertices_[from.vertex], vertices_[to.vertex], from.at, to.at);
    for (const int beside : {border - 1, border}) {
      const auto [ti, tj] = tile(beside);
      const Handle(Geom2d_Line) seen = axis == 0 ? new Geom2d_Line(gp_Pnt2d(at_mm, 0), gp_Dir2d(0, 1)) : new Geom2d_Line(gp_Pnt2d(0, at_mm), gp_Dir2d(1, 0));
      builder_.UpdateEdge(e, seen, tiles_.at(ti, tj), TopLoc_Location(), kToleranceMm);
      // Counter-clockwise: up along a tile's right side, to the right along its lower one.
      const bool forward = (axis == 0) == (beside < border);
      used_.at(ti, tj).push_back({{e, forward}, forward ? from.vertex : to.vertex, forward ? to.vertex : from.vertex});
    }
  }

  /// A tile's faces: one for every loop, since neither a tile nor what lies within the outline has holes.
  void add_faces(TopoDS_Shell& shell, int i, int j) {
    std::map<int, Step> from;
    for (const Step& step : used_.at(i, j)) {
      if (!from.emplace(step.from, step).second) throw NumericalError("lens solid: the outline touches itself at x " + where(step.from));
    }
    while (!from.empty()) {
      const int start = from.begin()->first;
      std::vector<Use> uses;
      for (int at = start; uses.empty() || at != start;) {
        const auto step = from.find(at);
        if (step == from.end()) throw NumericalError("lens solid: the border of the top is not closed at x " + where(at));
        uses.push_back(step->second.use);
        at = step->second.to;
        from.erase(step);
      }
      TopoDS_Face face;
      builder_.MakeFace(face, tiles_.at(i, j), kToleranceMm);
      builder_.Add(face, wire(uses));
      builder_.Add(shell, face);
    }
  }

  [[nodiscard]] std::string where(int v) const {
    const gp_Pnt p = BRep_Tool::Pnt(vertices_[v]);
    return fixed(p.X(), 2) + ", y " + fixed(p.Y(), 2) + " mm; simplify lens.outline there";
  }

  const SplineSurface& surface_;
  const std::vector<WallPiece> walls_;
  double base_z_;
  Axis axes_[2];
  Grid<Handle(Geom_BSplineSurface)> tiles_;
  Grid<std::vector<Step>> used_;             ///< by each tile, in any order
  std::vector<TopoDS_Vertex> vertices_;      ///< of the top
  std::vector<int> tops_;                    ///< where walls begin
  std::vector<TopoDS_Vertex> backs_;         ///< below them
  std::vector<TopoDS_Edge> uprights_, back_edges_;
  std::map<int, std::vector<Cut>> border_cuts_[2];
  std::map<std::pair<int, int>, int> corners_;
};

TopoDS_Face flat_face(const Outline& outline, double z) {
  BRepBuilderAPI_MakeWire wire;
  for (const WallPiece& piece : wall_pieces(outline)) wire.Add(BRepBuilderAPI_MakeEdge(level_curve(piece, z), piece.knots.front(), piece.knots.back()).Edge());
  return BRepBuilderAPI_MakeFace(wire.Wire(), true).Face();
}

/// Everything within the outline from one height to another.
TopoDS_Shape prism(const Outline& outline, double from_z, double to_z) {
  const Vec2 half = outline.size_mm / 2;
  switch (outline.shape) {
    case Outline::Shape::kRectangle:
      return BRepPrimAPI_MakeBox(gp_Pnt(-half.x(), -half.y(), from_z), gp_Pnt(half.x(), half.y(), to_z)).Shape();
    case Outline::Shape::kDisk:
      return BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(0, 0, from_z), gp_Dir(0, 0, 1)), half.x(), to_z - from_z).Shape();
    default:
      return BRepPrimAPI_MakePrism(flat_face(outline, from_z),
                                   gp_Vec(0, 0, to_z - from_z))
          .Shape();
  }
}

/// The block under the surface within an outline, flat below in z = `base_z`.
TopoDS_Shape block(const SplineSurface& surface, const Outline& outline, double base_z) {
  const bool whole = outline.shape == Outline::Shape::kRectangle && outline.size_mm == surface.extent().size();
  return whole ? LensBuilder(surface, base_z).build() : TrimmedLensBuilder(surface, wall_pieces(outline), base_z).build();
}

/// Whether a face lies level in this height.
bool is_level(const TopoDS_Shape& face, double z) {
  const BRepAdaptor_Surface surface(TopoDS::Face(face), false);
  return surface.GetType() == GeomAbs_Plane && std::abs(surface.Plane().Axis().Direction().Z()) > 0.99 &&
         std::abs(surface.Plane().Location().Z() - z) < kToleranceMm;
}

/// The faces of a solid as its shell uses them: those level in this height, and the others.
struct Faces {
  TopTools_ListOfShape level, others;
};
Faces faces_of(const TopoDS_Shape& solid, double level_z) {
  Faces faces;
  for (TopExp_Explorer it(solid, TopAbs_FACE); it.More(); it.Next()) {
    (is_level(it.Current(), level_z) ? faces.level : faces.others).Append(it.Current());
  }
  if (faces.level.IsEmpty()) throw NumericalError("lens solid: OpenCASCADE has lost a level face");
  return faces;
}

/// The block of the land with its outer edges cut at 45 degrees.
TopoDS_Shape chamfered(const TopoDS_Shape& land, double chamfer_mm, double land_z) {
  BRepFilletAPI_MakeChamfer chamfer(land);
  TopTools_IndexedMapOfShape edges;
  for (TopExp_Explorer faces(land, TopAbs_FACE); faces.More(); faces.Next()) {
    if (is_level(faces.Current(), 0) || is_level(faces.Current(), land_z)) TopExp::MapShapes(faces.Current(), TopAbs_EDGE, edges);
  }
  for (int e = 1; e <= edges.Extent(); ++e) chamfer.Add(chamfer_mm, TopoDS::Edge(edges(e)));
  chamfer.Build();
  if (!chamfer.IsDone()) throw NumericalError("lens solid: OpenCASCADE cannot cut mount.chamfer_mm along this outline; take a smaller one, or 0");
  return chamfer.Shape();
}

/// Walls and ends of a round hole, and the edges that its open ends share with level faces.
class HoleBuilder {
 public:
  explicit HoleBuilder(const RoundHole& hole) : hole_(hole), below_(rim(hole.from_mm)), above_(rim(hole.to_mm)) {}

  /// `back` and `land` are as the shell uses them.
  void cut(TopoDS_Shell& shell, TopoDS_Face& back, TopoDS_Face& land) {
    builder_.Add(shell, wall().Reversed());
    if (hole_.open_below) {
      builder_.Add(back, wire(below_.edge));
    } else {
      builder_.Add(shell, end(below_.edge, hole_.from_mm, 1));
    }
    if (hole_.open_above) {
      builder_.Add(land, wire(TopoDS::Edge(above_.edge.Reversed())));
    } else {
      builder_.Add(shell, end(TopoDS::Edge(above_.edge.Reversed()), hole_.to_mm, -1));
    }
  }

 private:
  struct Rim {
    TopoDS_Vertex vertex;
    TopoDS_Edge edge;  ///< counter-clockwise seen from above
  };

  [[nodiscard]] gp_Pnt middle(double z) const { return {hole_.middle_mm.x(), hole_.middle_mm.y(), z}; }

  Rim rim(double z) {
    Rim rim;
    builder_.MakeVertex(rim.vertex, middle(z).Translated(gp_Vec(hole_.radius_mm, 0, 0)), kToleranceMm);
    builder_.MakeEdge(rim.edge, new Geom_Circle(gp_Ax2(middle(z), gp_Dir(0, 0, 1), gp_Dir(1, 0, 0)), hole_.radius_mm), kToleranceMm);
    builder_.Add(rim.edge, rim.vertex.Oriented(TopAbs_FORWARD));
    builder_.Add(rim.edge, rim.vertex.Oriented(TopAbs_REVERSED));
    builder_.Range(rim.edge, 0, 2 * kPi);
    rim.edge.Closed(true);
    return rim;
  }

  TopoDS_Wire wire(const TopoDS_Edge& edge) {
    TopoDS_Wire w;
    builder_.MakeWire(w);
    builder_.Add(w, edge);
    w.Closed(true);
    return w;
  }

  /// The cylinder, its outside out.
  TopoDS_Face wall() {
    const double height = hole_.to_mm - hole_.from_mm;
    TopoDS_Edge seam;
    builder_.MakeEdge(seam, new Geom_Line(BRep_Tool::Pnt(below_.vertex), gp_Dir(0, 0, 1)), kToleranceMm);
    builder_.Add(seam, below_.vertex.Oriented(TopAbs_FORWARD));
    builder_.Add(seam, above_.vertex.Oriented(TopAbs_REVERSED));
    builder_.Range(seam, 0, height);
    TopoDS_Face face;
    builder_.MakeFace(face, new Geom_CylindricalSurface(gp_Ax3(middle(hole_.from_mm), gp_Dir(0, 0, 1), gp_Dir(1, 0, 0)), hole_.radius_mm), kToleranceMm);
    const auto line = [](double u, double v, const gp_Dir2d& along) { return new Geom2d_Line(gp_Pnt2d(u, v), along); };
    builder_.UpdateEdge(below_.edge, line(0, 0, {1, 0}), face, kToleranceMm);
    builder_.UpdateEdge(above_.edge, line(0, height, {1, 0}), face, kToleranceMm);
    builder_.UpdateEdge(seam, line(2 * kPi, 0, {0, 1}), line(0, 0, {0, 1}), face, kToleranceMm);
    TopoDS_Wire w;
    builder_.MakeWire(w);
    builder_.Add(w, below_.edge);
    builder_.Add(w, seam);
    builder_.Add(w, above_.edge.Reversed());
    builder_.Add(w, seam.Reversed());
    w.Closed(true);
    builder_.Add(face, w);
    return face;
  }

  TopoDS_Face end(const TopoDS_Edge& edge, double z, double up) {
    TopoDS_Face face;
    builder_.MakeFace(face, new Geom_Plane(middle(z), gp_Dir(0, 0, up)), kToleranceMm);
    builder_.Add(face, wire(edge));
    return face;
  }

  const RoundHole& hole_;
  BRep_Builder builder_;
  Rim below_, above_;
};

/// A face's plane and use, with its wires as the shell uses them.
TopoDS_Face copied(const TopoDS_Shape& face, BRep_Builder& builder) {
  TopoDS_Face copy = TopoDS::Face(face.EmptyCopied());
  for (TopExp_Explorer wires(face, TopAbs_WIRE); wires.More(); wires.Next()) builder.Add(copy, wires.Current());
  return copy;
}

}  // namespace

TopoDS_Shape lens_shape(const SplineSurface& surface, const SolidOptions& options) {
  const Outline optical = options.outline.value_or(Outline{Outline::Shape::kRectangle, surface.extent().size(), {}});
  if (options.land_mm <= 0) return block(surface, optical, 0);

  // The lens stands on the land; where it stands is a hole in the land's upper face. No boolean joins them: they share its edges.
  const double z = options.land_z_mm;
  const Land land{optical, with_land(optical, options.land_mm), z};
  const std::vector<RoundHole> holes = mount_holes(options.mount, land);
  const Faces lens = faces_of(block(surface, optical, z), z);
  TopoDS_Shape base = prism(land.part, 0, z);
  if (options.mount.chamfer_mm > 0) base = chamfered(base, options.mount.chamfer_mm, z);
  const Faces above = faces_of(base, z);
  BRep_Builder builder;
  TopoDS_Shell shell;
  builder.MakeShell(shell);
  TopoDS_Face upper = copied(above.level.First(), builder), back;
  for (const TopoDS_Shape& foot : lens.level) {
    for (TopExp_Explorer wires(foot, TopAbs_WIRE); wires.More(); wires.Next()) builder.Add(upper, wires.Current());
  }
  for (const TopoDS_Shape& face : lens.others) builder.Add(shell, face);
  for (const TopoDS_Shape& face : above.others) {
    if (is_level(face, 0)) {
      back = copied(face, builder);
    } else {
      builder.Add(shell, face);
    }
  }
  for (const RoundHole& hole : holes) HoleBuilder(hole).cut(shell, back, upper);
  builder.Add(shell, upper);
  builder.Add(shell, back);
  shell.Closed(true);
  TopoDS_Solid solid;
  builder.MakeSolid(solid);
  builder.Add(solid, shell);
  return solid;
}

}  // namespace lightmill::detail
