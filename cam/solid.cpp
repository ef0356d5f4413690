#include "cam/solid.h"

#include <APIHeaderSection_MakeHeader.hxx>
#include <BRepAdaptor_Curve2d.hxx>
#include <BRepAdaptor_Surface.hxx>
#include <BRepCheck_Analyzer.hxx>
#include <BRepGProp.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRep_Tool.hxx>
#include <GProp_GProps.hxx>
#include <GeomAdaptor_Surface.hxx>
#include <Geom_BSplineSurface.hxx>
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
#include <TCollection_HAsciiString.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopLoc_Location.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Solid.hxx>
#include <XSControl_WorkSession.hxx>
#include <gp_Pln.hxx>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <map>
#include <mutex>
#include <vector>

#include "cam/detail/lens_shape.h"
#include "design/core/files.h"

namespace lightmill {

namespace {

// Largest relative difference between the solid's volume and the spline's own integral.
constexpr double kVolumeTolerance = 1e-6;
// The same within an outline, where the integral goes by rows.
constexpr double kTrimmedVolumeTolerance = 1e-5;
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
    Interface_Static::SetRVal("write.precision.val", detail::kToleranceMm);
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
  // Empty where unknown, as the standard has it, not OpenCASCADE's own placeholders.
  header.SetAuthorValue(1, text(options.author));
  header.SetOrganizationValue(1, text(""));
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

/// Whether a face's parameters are x and y: a tile of the surface.
bool is_tile(const Adaptor3d_Surface& face) {
  if (face.GetType() != GeomAbs_BSplineSurface) return false;
  const double u = face.LastUParameter(), v = face.LastVParameter();
  const gp_Pnt corner = face.Value(u, v);
  return std::abs(corner.X() - u) < detail::kToleranceMm && std::abs(corner.Y() - v) < detail::kToleranceMm;
}

/// Triangles of a face by its own side: `visit(a, b, c)` counter-clockwise seen from outside the solid. The face must be meshed.
template <typename Visit>
void for_triangles(const TopoDS_Face& face, const Visit& visit) {
  TopLoc_Location location;
  const Handle(Poly_Triangulation) part = BRep_Tool::Triangulation(face, location);
  if (part.IsNull()) throw NumericalError("lens solid: OpenCASCADE cannot mesh a face");
  for (int t = 1; t <= part->NbTriangles(); ++t) {
    int a, b, c;
    part->Triangle(t).Get(a, b, c);
    if (face.Orientation() == TopAbs_REVERSED) std::swap(b, c);
    const auto at = [&](int n) { return part->Node(n).Transformed(location.Transformation()); };
    visit(at(a), at(b), at(c));
  }
}

/// Volume as the integral of z over the faces as seen from above: OpenCASCADE's own integral is off by a per cent on walls
/// through many places, and on tiles by 2.7e-4, or slow with an epsilon (9 s at mesh 641, this one 2). Over a tile, whose
/// parameters are x and y, by Green's theorem: the integral of z along x, exact on every span, around its wires.
double volume_mm3(const TopoDS_Shape& shape) {
  constexpr double kGauss[3] = {0.5 - 0.3872983346207415, 0.5, 0.5 + 0.3872983346207415};
  constexpr double kWeight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  constexpr int kPiecesPerEdge = 200;  // at least; a tile's border has 80 spans
  double volume = 0;
  for (TopExp_Explorer faces(shape, TopAbs_FACE); faces.More(); faces.Next()) {
    const TopoDS_Face face = TopoDS::Face(faces.Current());
    const BRepAdaptor_Surface surface(face, false);
    if (surface.GetType() == GeomAbs_Plane) {
      const double up = surface.Plane().Axis().Direction().Z() * (face.Orientation() == TopAbs_REVERSED ? -1 : 1);
      if (std::abs(up) < 1e-9) continue;
      GProp_GProps area;
      BRepGProp::SurfaceProperties(face, area, 1e-9);
      volume += up * area.Mass() * area.CentreOfMass().Z();
      continue;
    }
    if (!is_tile(surface)) {
      gp_Pnt at;
      gp_Vec along_u, along_v;
      surface.D1((surface.FirstUParameter() + surface.LastUParameter()) / 2, (surface.FirstVParameter() + surface.LastVParameter()) / 2, at, along_u, along_v);
      const gp_Vec normal = along_u.Crossed(along_v);
      if (std::abs(normal.Z()) < 1e-9 * normal.Magnitude()) continue;  // an upright wall
      GProp_GProps above_back;
      BRepGProp::VolumePropertiesGK(face, above_back, gp_Pln(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), 1e-7, false, true);
      volume += above_back.Mass();
      continue;
    }
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
  const auto number = [&](const gp_Pnt& p) {
    const std::array<long long, 3> key{std::llround(p.X() / kWeldMm), std::llround(p.Y() / kWeldMm), std::llround(p.Z() / kWeldMm)};
    const auto [found, fresh] = numbers.try_emplace(key, static_cast<int>(mesh.vertices.size()));
    if (fresh) mesh.vertices.emplace_back(p.X(), p.Y(), p.Z());
    return found->second;
  };
  for (TopExp_Explorer faces(shape, TopAbs_FACE); faces.More(); faces.Next()) {
    for_triangles(TopoDS::Face(faces.Current()), [&](const gp_Pnt& p, const gp_Pnt& q, const gp_Pnt& r) {
      const int a = number(p), b = number(q), c = number(r);
      if (a != b && b != c && c != a) mesh.triangles.push_back({a, b, c});
    });
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
    if (!is_tile(face)) continue;
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
  const Outline optical = options.outline.value_or(Outline{Outline::Shape::kRectangle, surface.extent().size(), {}});
  const Land land{optical, with_land(optical, options.land_mm), options.land_mm > 0 ? options.land_z_mm : 0};
  if (options.land_mm > 0) {
    if (!options.outline) throw InputError("lens solid: a land needs an outline");
    for (const Vec2& p : outline_places(optical, 0.2)) {
      if (!(land.z_mm > 0 && land.z_mm < surface.height(p.x(), p.y()))) {
        throw InputError("lens solid: the land in z = " + std::to_string(land.z_mm) +
                         " mm must lie above the back and below the whole border of the optical surface");
      }
    }
    summary.expected_volume_mm3 += land.z_mm * (land.part.area_mm2() - optical.area_mm2());
  }
  summary.expected_volume_mm3 -= mount_volume_mm3(options.mount, land);
  const ExchangeSession session(options.schema);
  with_cascade_errors([&] {
    monitor.report("building the solid", 0);
    const TopoDS_Shape solid = detail::lens_shape(surface, options);
    double volume_tolerance = kVolumeTolerance * summary.expected_volume_mm3;
    if (options.outline) {
      // The walls are curves through the outline's places; along them the surface is anywhere between lowest and highest.
      const double beside = detail::area_beside_chords_mm2(optical);
      summary.expected_volume_mm3 += beside * (lowest + surface.highest()) / 2;
      volume_tolerance = kTrimmedVolumeTolerance * summary.expected_volume_mm3 + std::abs(beside) * (surface.highest() - lowest);
      if (options.land_mm > 0) {
        summary.expected_volume_mm3 += land.z_mm * (detail::area_beside_chords_mm2(land.part) - beside);
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
      summary.volume_mm3 = volume_mm3(read);
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
