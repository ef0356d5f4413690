#include "cam/solid.h"

#include <APIHeaderSection_MakeHeader.hxx>
#include <BRepAdaptor_Curve.hxx>
#include <BRepAdaptor_Surface.hxx>
#include <BRepCheck_Analyzer.hxx>
#include <BRepBndLib.hxx>
#include <BRepGProp.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRep_Tool.hxx>
#include <Bnd_Box.hxx>
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
#include "cam/detail/wall_curve.h"
#include "design/core/files.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

// Largest relative difference between the solid's volume and the spline's own integral.
constexpr double kVolumeTolerance = 1e-6;
// The same with a chamfer, which we know by the chords of the land's border only.
constexpr double kChamferedVolumeTolerance = 1e-5;
// Largest distance of the faces read back from the spline: what 15 decimals in the file can explain, and more.
constexpr double kDeviationToleranceUm = 1e-3;

const char* const kRemedy = "; take another surface.mesh, or simplify lens.outline";

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

/// The middle of a face's bounds, for the reader of an error.
std::string place_of(const TopoDS_Face& face) {
  Bnd_Box box;
  BRepBndLib::Add(face, box, false);
  if (box.IsVoid()) return "nowhere";
  const gp_XYZ middle = (box.CornerMin().XYZ() + box.CornerMax().XYZ()) / 2;
  return "x " + fixed(middle.X(), 2) + ", y " + fixed(middle.Y(), 2) + ", z " + fixed(middle.Z(), 2) + " mm";
}

/// Triangles of a face by its own side: `visit(a, b, c)` counter-clockwise seen from outside the solid. The face must be meshed.
template <typename Visit>
void for_triangles(const TopoDS_Face& face, const Visit& visit) {
  TopLoc_Location location;
  const Handle(Poly_Triangulation) part = BRep_Tool::Triangulation(face, location);
  if (part.IsNull()) throw NumericalError("lens solid: OpenCASCADE cannot mesh the face around " + place_of(face) + kRemedy);
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
      const BRepAdaptor_Curve curve(edge);  // in space: a reader's curves on faces are approximations
      const double sign = edge.Orientation() == TopAbs_REVERSED ? -1 : 1;
      TColStd_Array1OfReal pieces(1, curve.NbIntervals(GeomAbs_CN) + 1);  // from knot to knot
      curve.Intervals(pieces, GeomAbs_CN);
      for (int k = 1; k < pieces.Upper(); ++k) {
        const double length = pieces(k + 1) - pieces(k);
        for (int g = 0; g < 3; ++g) {
          gp_Pnt at;
          gp_Vec speed;
          curve.D1(pieces(k) + kGauss[g] * length, at, speed);
          if (speed.Y() != 0) volume += sign * length * kWeight[g] * speed.Y() * along_x(at.X(), at.Y());
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
  if (!is_watertight(mesh)) throw NumericalError("lens solid: the mesh for the printer is not closed; set solid.mesh_tolerance_mm to another value, or to 0 for none");
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
  }
  const std::vector<detail::WallPiece> walls = detail::wall_pieces(optical);
  summary.expected_volume_mm3 = options.outline ? detail::volume_within(surface, walls) : surface.volume_mm3();
  if (options.land_mm > 0) {
    summary.expected_volume_mm3 += land.z_mm * (detail::area_within_mm2(detail::wall_pieces(land.part)) - detail::area_within_mm2(walls));
  }
  summary.expected_volume_mm3 -= mount_volume_mm3(options.mount, land);
  const ExchangeSession session(options.schema);
  with_cascade_errors([&] {
    monitor.report("building the solid", 0);
    const TopoDS_Shape solid = detail::lens_shape(surface, options);
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
      const double volume_tolerance = options.mount.chamfer_mm > 0 ? kChamferedVolumeTolerance : kVolumeTolerance;
      if (!summary.valid) throw NumericalError(path.string() + ": OpenCASCADE calls the solid read back invalid or open" + kRemedy);
      if (std::abs(summary.volume_mm3 - summary.expected_volume_mm3) > volume_tolerance * summary.expected_volume_mm3) {
        throw NumericalError(path.string() + ": the volume read back is " + std::to_string(summary.volume_mm3) +
                             " mm^3, the spline's own integral is " + std::to_string(summary.expected_volume_mm3) + kRemedy);
      }
      if (summary.max_deviation_um > kDeviationToleranceUm) {
        throw NumericalError(path.string() + ": faces read back are off by " + std::to_string(summary.max_deviation_um) +
                             " um" + kRemedy);
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
