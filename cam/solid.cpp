#include "cam/solid.h"

#include <APIHeaderSection_MakeHeader.hxx>
#include <BRepAdaptor_Curve2d.hxx>
#include <BRepAdaptor_Surface.hxx>
#include <BRepAlgoAPI_Common.hxx>
#include <BRepAlgoAPI_Fuse.hxx>
#include <BRepBuilderAPI_MakeEdge.hxx>
#include <BRepBuilderAPI_MakeFace.hxx>
#include <BRepBuilderAPI_MakeWire.hxx>
#include <BRepCheck_Analyzer.hxx>
#include <BRepGProp.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRepPrimAPI_MakePrism.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <GProp_GProps.hxx>
#include <Geom2d_Line.hxx>
#include <GeomAPI_Interpolate.hxx>
#include <GeomAdaptor_Surface.hxx>
#include <Geom_BSplineCurve.hxx>
#include <Geom_BSplineSurface.hxx>
#include <Geom_Line.hxx>
#include <Geom_Plane.hxx>
#include <IFSelect_ReturnStatus.hxx>
#include <Interface_InterfaceModel.hxx>
#include <Interface_Static.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Poly_Triangulation.hxx>
#include <STEPControl_Controller.hxx>
#include <STEPControl_Reader.hxx>
#include <STEPControl_Writer.hxx>
#include <Standard_Failure.hxx>
#include <StepBasic_Product.hxx>
#include <StepData_StepModel.hxx>
#include <TColgp_HArray1OfPnt.hxx>
#include <TCollection_HAsciiString.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopLoc_Location.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Shell.hxx>
#include <TopoDS_Solid.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <chrono>
#include <array>
#include <cmath>
#include <map>
#include <mutex>
#include <vector>

#include "design/core/files.h"

namespace lightmill {

namespace {

// Spans of one tile: one face of 640 spans takes FreeCAD 106 s to tessellate, tiles of 80 take 4.6 s.
constexpr int kTileSpans = 80;
// Of edges and vertices. Neighbours share exact poles, so that this only covers rounding in the file's decimals.
constexpr double kToleranceMm = 1e-7;
// Largest relative difference between the solid's volume and the spline's own integral.
constexpr double kVolumeTolerance = 1e-6;
// The same within an outline, where the integral goes by rows.
constexpr double kTrimmedVolumeTolerance = 1e-5;
// An outline's places where it turns by more than this, and pieces longer than this, are corners and straight walls.
constexpr double kCornerRad = 0.25;
constexpr double kStraightMm = 3;
// Largest distance of the faces read back from the spline: what 15 decimals in the file can explain, and more.
constexpr double kDeviationToleranceUm = 1e-3;

/// OpenCASCADE's settings and printers are global: one exchange at a time, and silence while it lasts.
class ExchangeSession {
 public:
  explicit ExchangeSession(StepSchema schema) : lock_(mutex()), printers_(Message::DefaultMessenger()->Printers()) {
    Message::DefaultMessenger()->ChangePrinters().Clear();
    STEPControl_Controller::Init();
    Interface_Static::SetCVal("write.step.schema", schema == StepSchema::kAp214 ? "AP214IS" : "AP242DIS");
    Interface_Static::SetCVal("write.step.unit", "MM");
    Interface_Static::SetCVal("xstep.cascade.unit", "MM");
    Interface_Static::SetIVal("write.surfacecurve.mode", 0);  // readers rebuild curves on faces: half the file
    Interface_Static::SetIVal("write.precision.mode", 1);
    Interface_Static::SetRVal("write.precision.val", kToleranceMm);
  }
  ~ExchangeSession() { Message::DefaultMessenger()->ChangePrinters() = printers_; }
  ExchangeSession(const ExchangeSession&) = delete;
  ExchangeSession& operator=(const ExchangeSession&) = delete;

 private:
  static std::mutex& mutex() {
    static std::mutex m;
    return m;
  }
  std::lock_guard<std::mutex> lock_;
  Message_SequenceOfPrinters printers_;
};

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
    for (int t = 0; t <= tiles; ++t) borders.push_back(static_cast<int>(static_cast<long>(count) * t / tiles));
  }
  [[nodiscard]] int tiles() const { return static_cast<int>(borders.size()) - 1; }
  [[nodiscard]] double knot_mm(int span) const {
    return span == spans ? to_mm : from_mm + (to_mm - from_mm) * span / spans;
  }
  [[nodiscard]] double border_mm(int border) const { return knot_mm(borders[border]); }

  /// Knots of a tile; the parameter is the coordinate itself.
  [[nodiscard]] TColStd_Array1OfReal knots(int tile) const {
    TColStd_Array1OfReal result(1, borders[tile + 1] - borders[tile] + 1);
    for (int k = 1; k <= result.Upper(); ++k) result(k) = knot_mm(borders[tile] + k - 1);
    return result;
  }
  [[nodiscard]] TColStd_Array1OfInteger multiplicities(int tile) const {
    TColStd_Array1OfInteger result(1, borders[tile + 1] - borders[tile] + 1);
    result.Init(1);
    result(1) = result(result.Upper()) = 4;
    return result;
  }
  /// The coordinate of every pole (Greville abscissae of the clamped knots).
  [[nodiscard]] std::vector<double> pole_mm(int tile) const {
    const int first = borders[tile], last = borders[tile + 1];
    const auto knot = [&](int k) { return knot_mm(std::clamp(first + k, first, last)); };
    std::vector<double> result(last - first + 3);
    for (int i = 0; i < static_cast<int>(result.size()); ++i) result[i] = (knot(i - 2) + knot(i - 1) + knot(i)) / 3;
    result.front() = knot_mm(first);
    result.back() = knot_mm(last);
    return result;
  }
};

/// Builds the solid: shared vertices and edges first, then faces that use them.
class LensBuilder {
 public:
  explicit LensBuilder(const SplineSurface& surface)
      : surface_(surface),
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
      const int spans_y = y_.borders[tj + 1] - y_.borders[tj];
      const std::vector<double> pole_y = y_.pole_mm(tj);
      for (int ti = 0; ti < x_.tiles(); ++ti) {
        const int spans_x = x_.borders[ti + 1] - x_.borders[ti];
        const std::vector<double> pole_x = x_.pole_mm(ti);
        // Clamp along x, then along y.
        Grid<double> along_x(spans_x + 3, spans_y + 3);
        for (int j = 0; j < along_x.height; ++j) {
          const auto row = clamped_poles(
              spans_x, [&](int i) { return surface_.coefficients().at(x_.borders[ti] + i, y_.borders[tj] + j); });
          std::copy(row.begin(), row.end(), &along_x.at(0, j));
        }
        TColgp_Array2OfPnt poles(1, spans_x + 3, 1, spans_y + 3);
        for (int i = 0; i < along_x.width; ++i) {
          const auto column = clamped_poles(spans_y, [&](int j) { return along_x.at(i, j); });
          for (int j = 0; j < along_x.height; ++j) poles(i + 1, j + 1) = gp_Pnt(pole_x[i], pole_y[j], column[j]);
        }
        tiles_[static_cast<std::size_t>(tj) * x_.tiles() + ti] = new Geom_BSplineSurface(
            poles, x_.knots(ti), y_.knots(tj), x_.multiplicities(ti), y_.multiplicities(tj), 3, 3);
      }
    }
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
    for (int k = 0; k < 4; ++k) back_vertices_[k] = vertex(gp_Pnt(x[k], y[k], 0));
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

/// How much larger the outline is by the curves through its places than by its chords.
double area_beside_chords_mm2(const Outline& outline) {
  if (outline.shape != Outline::Shape::kLoop) return 0;
  GProp_GProps properties;
  BRepGProp::SurfaceProperties(flat_face(outline, 0), properties, 1e-9);
  return properties.Mass() - outline.area_mm2();
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

template <typename Operation>
TopoDS_Shape combined(const TopoDS_Shape& a, const TopoDS_Shape& b) {
  Operation operation(a, b);
  if (!operation.IsDone() || operation.HasErrors()) throw NumericalError("lens solid: OpenCASCADE cannot cut it along the outline");
  return operation.Shape();
}

/// The block under the whole surface, cut along the outline and set on its land.
TopoDS_Shape trimmed(TopoDS_Shape shape, const SolidOptions& options, double top_z) {
  if (options.outline) shape = combined<BRepAlgoAPI_Common>(shape, prism(*options.outline, -1, top_z + 1));
  if (options.land_mm > 0) shape = combined<BRepAlgoAPI_Fuse>(shape, prism(with_land(*options.outline, options.land_mm), 0, options.land_z_mm));
  // A boolean's result is a compound of one solid.
  TopExp_Explorer solids(shape, TopAbs_SOLID);
  if (!solids.More()) throw NumericalError("lens solid: nothing is left within the outline");
  return solids.Current();
}

/// Integral of the surface's height within the outline: exact along x, rows of even distance in y.
double volume_within(const SplineSurface& surface, const Outline& outline) {
  constexpr int kRows = 4000;
  constexpr double kGauss[3] = {0.5 - 0.3872983346207417, 0.5, 0.5 + 0.3872983346207417};
  constexpr double kWeight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  const std::vector<Vec2> places = outline_places(outline, 0.05);
  Box2 box;
  for (const Vec2& p : places) box.include(p);
  const double dy = box.size().y() / kRows;
  const double span = surface.span_mm().x();
  double volume = 0;
  for (int row = 0; row < kRows; ++row) {
    const double y = box.min.y() + (row + 0.5) * dy;
    std::vector<double> crossings;
    if (outline.shape == Outline::Shape::kDisk) {
      const double radius = outline.size_mm.x() / 2;
      const double half = std::sqrt(std::max(0.0, radius * radius - y * y));
      crossings = {-half, half};
    } else {
      for (std::size_t k = 0; k < places.size(); ++k) {
        const Vec2& a = places[k];
        const Vec2& b = places[(k + 1) % places.size()];
        if ((a.y() > y) != (b.y() > y)) crossings.push_back(a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
      }
      std::sort(crossings.begin(), crossings.end());
    }
    for (std::size_t c = 0; c + 1 < crossings.size(); c += 2) {
      double x = crossings[c];
      while (x < crossings[c + 1]) {
        const double knot = surface.extent().min.x() + span * (std::floor((x - surface.extent().min.x()) / span + 1e-9) + 1);
        const double next = std::min(knot, crossings[c + 1]);
        for (int g = 0; g < 3; ++g) volume += dy * (next - x) * kWeight[g] * surface.height(x + kGauss[g] * (next - x), y);
        x = next;
      }
    }
  }
  return volume;
}

void write_step(const std::filesystem::path& path, const TopoDS_Shape& shape, const SolidOptions& options) {
  STEPControl_Writer writer;
  if (writer.Transfer(shape, STEPControl_AsIs) != IFSelect_RetDone) {
    throw NumericalError("STEP: OpenCASCADE cannot transfer the solid");
  }
  const auto text = [](const std::string& words) { return new TCollection_HAsciiString(words.c_str()); };
  // Not by the setting write.step.product.name: that one counts the products of the process into the name.
  const Handle(TCollection_HAsciiString) name = text(options.product_name);
  const Handle(Interface_InterfaceModel) model = writer.WS()->Model();
  for (int e = 1; e <= model->NbEntities(); ++e) {
    const Handle(StepBasic_Product) product = Handle(StepBasic_Product)::DownCast(model->Value(e));
    if (product.IsNull()) continue;
    product->SetId(name);
    product->SetName(name);
    if (!options.material.empty()) product->SetDescription(text("material: " + options.material));
  }
  APIHeaderSection_MakeHeader header(Handle(StepData_StepModel)::DownCast(model));
  header.SetName(name);
  if (!options.author.empty()) header.SetAuthorValue(1, text(options.author));
  header.SetOriginatingSystem(text("lightmill"));
  if (writer.Write(path.c_str()) != IFSelect_RetDone) throw IoError("cannot write STEP file " + path.string());
}

TopoDS_Shape read_step(const std::filesystem::path& path) {
  STEPControl_Reader reader;
  if (reader.ReadFile(path.c_str()) != IFSelect_RetDone) throw IoError("cannot read back STEP file " + path.string());
  reader.TransferRoots();
  return reader.OneShape();
}

/// Edges that do not lie between two faces.
int count_free_edges(const TopoDS_Shape& shape) {
  TopTools_IndexedDataMapOfShapeListOfShape faces_of_edge;
  TopExp::MapShapesAndAncestors(shape, TopAbs_EDGE, TopAbs_FACE, faces_of_edge);
  int count = 0;
  for (int e = 1; e <= faces_of_edge.Extent(); ++e) count += faces_of_edge(e).Extent() != 2;
  return count;
}

int count_shapes(const TopoDS_Shape& shape, TopAbs_ShapeEnum kind) {
  int count = 0;
  for (TopExp_Explorer it(shape, kind); it.More(); it.Next()) ++count;
  return count;
}

double volume_mm3(const TopoDS_Shape& shape) {
  // The default rule is wrong by 2.7e-4 on a face of many spans.
  GProp_GProps properties;
  BRepGProp::VolumeProperties(shape, properties, 1e-8, true);
  return properties.Mass();
}

/// Volume between z = 0 and the faces that look up, walls being upright: OpenCASCADE's own integral is off by a per cent on
/// walls through many places. Over a B-spline face, whose parameters are x and y, by Green's theorem: the integral of z
/// along x, exact on every span, around its wires.
double volume_under_mm3(const TopoDS_Shape& shape) {
  constexpr double kGauss[3] = {0.5 - 0.3872983346207415, 0.5, 0.5 + 0.3872983346207415};
  constexpr double kWeight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  constexpr int kPiecesPerEdge = 200;  // at least; a tile's border has 80 spans
  double volume = 0;
  for (TopExp_Explorer faces(shape, TopAbs_FACE); faces.More(); faces.Next()) {
    const TopoDS_Face face = TopoDS::Face(faces.Current());
    const BRepAdaptor_Surface surface(face, false);
    if (surface.GetType() == GeomAbs_Plane) {
      const double up = surface.Plane().Axis().Direction().Z() * (face.Orientation() == TopAbs_REVERSED ? -1 : 1);
      if (std::abs(up) < 0.5) continue;
      GProp_GProps area;
      BRepGProp::SurfaceProperties(face, area, 1e-9);
      volume += up * area.Mass() * surface.Plane().Location().Z();
    }
    if (surface.GetType() != GeomAbs_BSplineSurface) continue;
    TColStd_Array1OfReal knots(1, surface.NbUKnots());
    surface.BSpline()->UKnots(knots);
    const auto along_x = [&](double u, double v) {
      double sum = 0;
      for (int k = 1; k < knots.Upper() && knots(k) < u; ++k) {
        const double length = std::min(knots(k + 1), u) - knots(k);
        for (int g = 0; g < 3; ++g) sum += length * kWeight[g] * surface.Value(knots(k) + kGauss[g] * length, v).Z();
      }
      return sum;
    };
    for (TopExp_Explorer edges(face.Oriented(TopAbs_FORWARD), TopAbs_EDGE); edges.More(); edges.Next()) {
      const TopoDS_Edge edge = TopoDS::Edge(edges.Current());
      const BRepAdaptor_Curve2d curve(edge, face);
      const double first = curve.FirstParameter();
      const double step = (curve.LastParameter() - first) / kPiecesPerEdge;
      const double sign = edge.Orientation() == TopAbs_REVERSED ? -1 : 1;
      for (int k = 0; k < kPiecesPerEdge; ++k) {
        for (int g = 0; g < 3; ++g) {
          gp_Pnt2d at;
          gp_Vec2d speed;
          curve.D1(first + (k + kGauss[g]) * step, at, speed);
          if (speed.Y() != 0) volume += sign * step * kWeight[g] * speed.Y() * along_x(at.X(), at.Y());
        }
      }
    }
  }
  return volume;
}

/// Triangles of all faces; places that neighbouring faces share are one vertex.
PrintMesh meshed(const TopoDS_Shape& shape, double tolerance_mm) {
  constexpr double kAngle = 0.3;    // between neighbouring triangles on round walls
  constexpr double kWeldMm = 1e-5;  // edges are cut once, for both of their faces
  BRepMesh_IncrementalMesh(shape, tolerance_mm, false, kAngle, false);
  PrintMesh mesh;
  std::map<std::array<long long, 3>, int> numbers;
  for (TopExp_Explorer faces(shape, TopAbs_FACE); faces.More(); faces.Next()) {
    const TopoDS_Face face = TopoDS::Face(faces.Current());
    TopLoc_Location location;
    const Handle(Poly_Triangulation) part = BRep_Tool::Triangulation(face, location);
    if (part.IsNull()) throw NumericalError("lens solid: OpenCASCADE cannot mesh a face");
    std::vector<int> number(part->NbNodes() + 1);
    for (int n = 1; n <= part->NbNodes(); ++n) {
      const gp_Pnt p = part->Node(n).Transformed(location.Transformation());
      const std::array<long long, 3> key{std::llround(p.X() / kWeldMm), std::llround(p.Y() / kWeldMm), std::llround(p.Z() / kWeldMm)};
      const auto [found, fresh] = numbers.try_emplace(key, static_cast<int>(mesh.vertices.size()));
      if (fresh) mesh.vertices.emplace_back(p.X(), p.Y(), p.Z());
      number[n] = found->second;
    }
    for (int t = 1; t <= part->NbTriangles(); ++t) {
      int a, b, c;
      part->Triangle(t).Get(a, b, c);
      if (face.Orientation() == TopAbs_REVERSED) std::swap(b, c);
      if (number[a] != number[b] && number[b] != number[c] && number[c] != number[a]) mesh.triangles.push_back({number[a], number[b], number[c]});
    }
  }
  if (!is_watertight(mesh)) throw NumericalError("lens solid: the mesh for the printer is not closed");
  return mesh;
}

/// Largest distance along z of the B-spline faces from the spline, at points inside spans and on knots.
double deviation_um(const TopoDS_Shape& shape, const SplineSurface& surface) {
  constexpr int kPerSpan = 3;
  double worst = 0;
  for (TopExp_Explorer it(shape, TopAbs_FACE); it.More(); it.Next()) {
    const GeomAdaptor_Surface face(BRep_Tool::Surface(TopoDS::Face(it.Current())));
    if (face.GetType() != GeomAbs_BSplineSurface) continue;
    const int nu = kPerSpan * (face.NbUKnots() - 1);
    const int nv = kPerSpan * (face.NbVKnots() - 1);
    for (int j = 0; j <= nv; ++j) {
      const double v = face.FirstVParameter() + (face.LastVParameter() - face.FirstVParameter()) * j / nv;
      for (int i = 0; i <= nu; ++i) {
        const gp_Pnt p =
            face.Value(face.FirstUParameter() + (face.LastUParameter() - face.FirstUParameter()) * i / nu, v);
        worst = std::max(worst, std::abs(p.Z() - surface.height(p.X(), p.Y())));
      }
    }
  }
  return 1e3 * worst;
}

/// OpenCASCADE's own exceptions are not std::exceptions.
template <typename F>
void with_cascade_errors(F body) {
  try {
    body();
  } catch (const Standard_Failure& failure) {
    throw NumericalError(std::string("OpenCASCADE: ") + failure.GetMessageString());
  }
}

}  // namespace

SolidSummary write_lens_step(const std::filesystem::path& path, const SplineSurface& surface,
                             const SolidOptions& options, const Monitor& monitor) {
  const auto start = std::chrono::steady_clock::now();
  SolidSummary summary;
  const double lowest = surface.lowest();
  if (!(lowest > 0)) {
    throw InputError("lens solid: the optical surface comes down to z = " + std::to_string(lowest) +
                     " mm, through the flat back in z = 0: make lens.thickness_mm larger");
  }
  summary.expected_volume_mm3 = options.outline ? volume_within(surface, *options.outline) : surface.volume_mm3();
  if (options.land_mm > 0) {
    if (!options.outline) throw InputError("lens solid: a land needs an outline");
    for (const Vec2& p : outline_places(*options.outline, 0.2)) {
      if (!(options.land_z_mm > 0 && options.land_z_mm < surface.height(p.x(), p.y()))) {
        throw InputError("lens solid: the land in z = " + std::to_string(options.land_z_mm) +
                         " mm must lie above the back and below the whole border of the optical surface");
      }
    }
    summary.expected_volume_mm3 += options.land_z_mm * (with_land(*options.outline, options.land_mm).area_mm2() - options.outline->area_mm2());
  }
  const ExchangeSession session(options.schema);
  with_cascade_errors([&] {
    monitor.report("building the solid", 0);
    TopoDS_Shape solid = LensBuilder(surface).build();
    double volume_tolerance = kVolumeTolerance * summary.expected_volume_mm3;
    if (options.outline) {
      solid = trimmed(solid, options, surface.highest());
      // The walls are curves through the outline's places; along them the surface is anywhere between lowest and highest.
      const double beside = area_beside_chords_mm2(*options.outline);
      summary.expected_volume_mm3 += beside * (lowest + surface.highest()) / 2;
      volume_tolerance = kTrimmedVolumeTolerance * summary.expected_volume_mm3 + std::abs(beside) * (surface.highest() - lowest);
      if (options.land_mm > 0) {
        summary.expected_volume_mm3 += options.land_z_mm * (area_beside_chords_mm2(with_land(*options.outline, options.land_mm)) - beside);
      }
    }
    if (options.mesh_tolerance_mm > 0) {
      monitor.report("meshing the solid", 0.05);
      summary.mesh = meshed(solid, options.mesh_tolerance_mm);
    }
    write_whole(path, [&](const std::filesystem::path& temporary) {
      monitor.report("writing STEP", 0.1);
      write_step(temporary, solid, options);
      summary.file_bytes = std::filesystem::file_size(temporary);

      // Everything is judged by what another reader will find in the file.
      monitor.report("reading STEP back", 0.4);
      const TopoDS_Shape read = read_step(temporary);
      monitor.report("checking the solid", 0.7);
      summary.faces = count_shapes(read, TopAbs_FACE);
      summary.free_edges = count_free_edges(read);
      summary.valid = BRepCheck_Analyzer(read).IsValid() && count_shapes(read, TopAbs_SOLID) == 1 &&
                      count_shapes(read, TopAbs_SHELL) == 1 && summary.free_edges == 0;
      monitor.check();
      summary.volume_mm3 = options.outline ? volume_under_mm3(read) : volume_mm3(read);
      monitor.check();
      summary.max_deviation_um = deviation_um(read, surface);
      if (!summary.valid) throw NumericalError("lens solid: OpenCASCADE calls the solid read back invalid or open");
      if (std::abs(summary.volume_mm3 - summary.expected_volume_mm3) > volume_tolerance) {
        throw NumericalError("lens solid: the volume read back is " + std::to_string(summary.volume_mm3) +
                             " mm^3, the spline's own integral is " + std::to_string(summary.expected_volume_mm3));
      }
      if (summary.max_deviation_um > kDeviationToleranceUm) {
        throw NumericalError("lens solid: faces read back are off by " + std::to_string(summary.max_deviation_um) +
                             " um");
      }
    });
  });
  summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  monitor.report("solid written", 1);
  return summary;
}

void write_blank_step(const std::filesystem::path& path, const Blank& blank) {
  if (!(blank.size_mm.x() > 0 && blank.size_mm.y() > 0 && blank.height_mm > 0)) {
    throw InputError("blank: sizes must be above 0");
  }
  const ExchangeSession session(StepSchema::kAp242);
  with_cascade_errors([&] {
    const gp_Pnt corner(-blank.size_mm.x() / 2, -blank.size_mm.y() / 2, 0);
    const TopoDS_Shape box = BRepPrimAPI_MakeBox(corner, blank.size_mm.x(), blank.size_mm.y(), blank.height_mm).Solid();
    write_whole(path, [&](const std::filesystem::path& temporary) {
      write_step(temporary, box, {.product_name = "blank"});
      const TopoDS_Shape read = read_step(temporary);
      if (!BRepCheck_Analyzer(read).IsValid() || count_free_edges(read) != 0) {
        throw NumericalError("blank: OpenCASCADE calls the solid read back invalid");
      }
    });
  });
}

}  // namespace lightmill
