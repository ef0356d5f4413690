#include "cam/detail/lens_shape.h"

#include <BRepAdaptor_Surface.hxx>
#include <BRepAlgoAPI_Common.hxx>
#include <BRepBuilderAPI_MakeEdge.hxx>
#include <BRepBuilderAPI_MakeFace.hxx>
#include <BRepBuilderAPI_MakeWire.hxx>
#include <BRepFilletAPI_MakeChamfer.hxx>
#include <BRepGProp.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRepPrimAPI_MakePrism.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <GProp_GProps.hxx>
#include <Geom2d_Line.hxx>
#include <GeomAPI_Interpolate.hxx>
#include <Geom_BSplineCurve.hxx>
#include <Geom_BSplineSurface.hxx>
#include <Geom_Circle.hxx>
#include <Geom_CylindricalSurface.hxx>
#include <Geom_Line.hxx>
#include <Geom_Plane.hxx>
#include <TColgp_HArray1OfPnt.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_IndexedMapOfShape.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Shell.hxx>
#include <TopoDS_Solid.hxx>
#include <algorithm>
#include <cmath>
#include <vector>

#include "cam/detail/spline_refinement.h"

namespace lightmill::detail {

namespace {

// Spans of one tile: one face of 640 spans takes FreeCAD 106 s to tessellate, tiles of 80 take 4.6 s.
constexpr int kTileSpans = 80;
// Coefficients of a tile that differ by less from those of a surface of half as many spans are rounding.
constexpr double kSameMm = 1e-11;
// An outline's places where it turns by more than this, and pieces longer than this, are corners and straight walls.
constexpr double kCornerRad = 0.25;
constexpr double kStraightMm = 3;

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

  Axis(double from, double to, int count) : from_mm(from), to_mm(to), spans(count) {
    const int tiles = std::max(1, static_cast<int>(std::lround(static_cast<double>(count) / kTileSpans)));
    const int unit = count % 2 == 0 ? 2 : 1;  // spans of twice the size fit an even tile
    for (int t = 0; t <= tiles; ++t) borders.push_back(unit * static_cast<int>(static_cast<long>(count / unit) * t / tiles));
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

/// Builds the solid: shared vertices and edges first, then faces that use them.
class LensBuilder {
 public:
  /// Flat below in z = `base_z`.
  LensBuilder(const SplineSurface& surface, double base_z)
      : surface_(surface),
        base_z_(base_z),
        x_(surface.extent().min.x(), surface.extent().max.x(), surface.spans_x()),
        y_(surface.extent().min.y(), surface.extent().max.y(), surface.spans_y()) {}

  TopoDS_Solid build() {
    make_tiles();
    make_vertices();
    make_edges();
    TopoDS_Shell shell;
    builder_.MakeShell(shell);
    for (int j = 0; j < y_.tiles(); ++j) {
      for (int i = 0; i < x_.tiles(); ++i) builder_.Add(shell, tile_face(i, j));
    }
    add_walls(shell);
    builder_.Add(shell, back_face());
    shell.Closed(true);
    TopoDS_Solid solid;
    builder_.MakeSolid(solid);
    builder_.Add(solid, shell);
    return solid;
  }

 private:
  /// An edge as a wire uses it.
  struct Use {
    TopoDS_Edge edge;
    bool forward;
  };

  void make_tiles() {
    tiles_.resize(static_cast<std::size_t>(x_.tiles()) * y_.tiles());
    for (int tj = 0; tj < y_.tiles(); ++tj) {
      for (int ti = 0; ti < x_.tiles(); ++ti) tiles_[static_cast<std::size_t>(tj) * x_.tiles() + ti] = make_tile(ti, tj);
    }
  }

  [[nodiscard]] Handle(Geom_BSplineSurface) make_tile(int ti, int tj) const {
    Grid<double> coefficients(x_.tile_spans(ti) + 3, y_.tile_spans(tj) + 3);
    for (int j = 0; j < coefficients.height; ++j) {
      for (int i = 0; i < coefficients.width; ++i) coefficients.at(i, j) = surface_.coefficients().at(x_.borders[ti] + i, y_.borders[tj] + j);
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
    const std::vector<double> pole_x = x_.pole_mm(ti, stride), pole_y = y_.pole_mm(tj, stride);
    TColgp_Array2OfPnt poles(1, coefficients.width, 1, coefficients.height);
    for (int i = 0; i < coefficients.width; ++i) {
      const auto column = clamped_poles(coefficients.height - 3, [&](int j) { return coefficients.at(i, j); });
      for (int j = 0; j < coefficients.height; ++j) poles(i + 1, j + 1) = gp_Pnt(pole_x[i], pole_y[j], column[j]);
    }
    return new Geom_BSplineSurface(poles, x_.knots(ti, stride), y_.knots(tj, stride), x_.multiplicities(ti, stride),
                                   y_.multiplicities(tj, stride), 3, 3);
  }

  [[nodiscard]] const Handle(Geom_BSplineSurface) & tile(int i, int j) const {
    return tiles_[static_cast<std::size_t>(j) * x_.tiles() + i];
  }

  /// The corner of tiles where borders i and j cross.
  [[nodiscard]] gp_Pnt corner(int i, int j) const {
    const int ti = std::min(i, x_.tiles() - 1);
    const int tj = std::min(j, y_.tiles() - 1);
    const auto& s = tile(ti, tj);
    return s->Pole(i == ti ? 1 : s->NbUPoles(), j == tj ? 1 : s->NbVPoles());
  }

  TopoDS_Vertex vertex(const gp_Pnt& p) {
    TopoDS_Vertex v;
    builder_.MakeVertex(v, p, kToleranceMm);
    return v;
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

  void make_edges() {
    along_x_ = Grid<TopoDS_Edge>(x_.tiles(), y_.tiles() + 1);
    for (int j = 0; j <= y_.tiles(); ++j) {
      for (int i = 0; i < x_.tiles(); ++i) {
        const auto& s = tile(i, std::min(j, y_.tiles() - 1));
        along_x_.at(i, j) = edge(s->VIso(y_.border_mm(j)), top_vertices_.at(i, j), top_vertices_.at(i + 1, j),
                                 x_.border_mm(i), x_.border_mm(i + 1));
      }
    }
    along_y_ = Grid<TopoDS_Edge>(x_.tiles() + 1, y_.tiles());
    for (int j = 0; j < y_.tiles(); ++j) {
      for (int i = 0; i <= x_.tiles(); ++i) {
        const auto& s = tile(std::min(i, x_.tiles() - 1), j);
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

  TopoDS_Wire wire(const std::vector<Use>& uses) {
    TopoDS_Wire w;
    builder_.MakeWire(w);
    for (const Use& use : uses) builder_.Add(w, use.edge.Oriented(use.forward ? TopAbs_FORWARD : TopAbs_REVERSED));
    w.Closed(true);
    return w;
  }

  TopoDS_Face tile_face(int i, int j) {
    TopoDS_Face face;
    builder_.MakeFace(face, tile(i, j), kToleranceMm);
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

  /// A plane through `point` whose normal points out of the solid.
  TopoDS_Face planar_face(const gp_Pnt& point, const gp_Dir& outwards, const std::vector<Use>& uses) {
    TopoDS_Face face;
    builder_.MakeFace(face, new Geom_Plane(point, outwards), kToleranceMm);
    builder_.Add(face, wire(uses));
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

  const SplineSurface& surface_;
  double base_z_;
  Axis x_, y_;
  BRep_Builder builder_;
  std::vector<Handle(Geom_BSplineSurface)> tiles_;
  Grid<TopoDS_Vertex> top_vertices_;  ///< where tile borders cross
  TopoDS_Vertex back_vertices_[4];
  Grid<TopoDS_Edge> along_x_, along_y_;  ///< tile borders
  TopoDS_Edge upright_[4], back_[4];
};

/// The closed wire through an outline's places: curves between its corners.
TopoDS_Wire wire_through(const std::vector<Vec2>& loop, double z) {
  const int n = static_cast<int>(loop.size());
  const auto at = [&](int k) -> const Vec2& { return loop[((k % n) + n) % n]; };
  const auto point = [&](int k) { return gp_Pnt(at(k).x(), at(k).y(), z); };
  std::vector<int> corners;
  for (int k = 0; k < n; ++k) {
    const Vec2 before = at(k) - at(k - 1), after = at(k + 1) - at(k);
    const double turn = std::atan2(before.x() * after.y() - before.y() * after.x(), before.dot(after));
    if (std::abs(turn) > kCornerRad || std::max(before.norm(), after.norm()) > kStraightMm) corners.push_back(k);
  }
  const auto curve = [&](int first, int last, bool closed) {
    const Handle(TColgp_HArray1OfPnt) points = new TColgp_HArray1OfPnt(1, last - first + (closed ? 0 : 1));
    for (int k = 1; k <= points->Upper(); ++k) points->SetValue(k, point(first + k - 1));
    GeomAPI_Interpolate through(points, closed, kToleranceMm);
    through.Perform();
    if (!through.IsDone()) throw NumericalError("lens solid: no curve through the outline");
    return through.Curve();
  };
  BRepBuilderAPI_MakeWire wire;
  if (corners.empty()) {
    wire.Add(BRepBuilderAPI_MakeEdge(curve(0, n, true)).Edge());
    return wire.Wire();
  }
  for (std::size_t c = 0; c < corners.size(); ++c) {
    const int first = corners[c];
    const int last = c + 1 < corners.size() ? corners[c + 1] : corners[0] + n;
    wire.Add(last - first == 1 ? BRepBuilderAPI_MakeEdge(point(first), point(last)).Edge()
                               : BRepBuilderAPI_MakeEdge(curve(first, last, false)).Edge());
  }
  return wire.Wire();
}

TopoDS_Face flat_face(const Outline& outline, double z) {
  return BRepBuilderAPI_MakeFace(wire_through(outline.loop_mm, z), true).Face();
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
  const TopoDS_Shape whole = LensBuilder(surface, base_z).build();
  if (outline.shape == Outline::Shape::kRectangle && outline.size_mm == surface.extent().size()) return whole;
  BRepAlgoAPI_Common common(whole, prism(outline, base_z - 1, surface.highest() + 1));
  if (!common.IsDone() || common.HasErrors()) throw NumericalError("lens solid: OpenCASCADE cannot cut it along the outline");
  // A boolean's result is a compound of one solid.
  TopExp_Explorer solids(common.Shape(), TopAbs_SOLID);
  if (!solids.More()) throw NumericalError("lens solid: nothing is left within the outline");
  return solids.Current();
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

/// How much larger the outline is by the curves through its places than by its chords.
double area_beside_chords_mm2(const Outline& outline) {
  if (outline.shape != Outline::Shape::kLoop) return 0;
  GProp_GProps properties;
  BRepGProp::SurfaceProperties(flat_face(outline, 0), properties, 1e-9);
  return properties.Mass() - outline.area_mm2();
}

}  // namespace lightmill::detail
