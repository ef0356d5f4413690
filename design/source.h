// Source light: where unbent light arrives on the receiver after the back and the base surface [paper sec. 4.2].
#pragma once

#include <array>
#include <string>
#include <vector>

#include "design/core/geometry.h"
#include "design/light.h"
#include "design/optics.h"

namespace lightmill {

/// Irradiance on the receiver, linear on each triangle. Triangles are counter-clockwise on the receiver.
struct SourceMesh {
  std::vector<Vec2> vertices_mm;          ///< receiver coordinates
  std::vector<double> irradiance_per_mm2; ///< at the vertices
  std::vector<Vec2> lens_mm;              ///< x, y on the lens that each vertex's light comes from
  std::vector<std::array<int, 3>> triangles;
  [[nodiscard]] double flux() const;
};

/// Total flux 1. A uniform rectangle or disk, or any irradiance on a mesh.
struct SourceLight {
  enum class Shape { kRectangle, kDisk, kMesh };
  Shape shape = Shape::kRectangle;
  Vec2 size_mm{100, 100};  ///< of the rectangle, or the disk's diameter twice, both centred on the receiver's origin; of the
                           ///< mesh's bounding box
  SourceMesh mesh{};
};

/// What went wrong on a part of the light, and where on the lens the first such triangle is.
struct SourceFault {
  double share = 0;        ///< of the light on the lens
  Vec2 lens_mm{0, 0};
  Vec2 receiver_mm{0, 0};  ///< of a fold
};

struct SourceReport {
  SourceFault totally_reflected;  ///< at the base surface
  SourceFault lost;               ///< leaves the base surface but never meets the receiver
  SourceFault folded;             ///< arrives mirrored to the rest: light from two places of the lens meets
  SourceFault beside_back;        ///< would have to come through the lens's side
  double unlit_share = 0;         ///< of the lens's area
  /// One line per fault, with its place.
  [[nodiscard]] std::vector<std::string> words() const;
};

struct TracedSource {
  SourceLight source;
  SourceReport report;
};

/// Whether the source is simply the lens's rectangle or disk, evenly lit.
bool is_plain_source(const Lens& lens, const Light& light, const Receiver& receiver);

/// Traces light through back and base to the receiver, with about `resolution` vertices along the lens's longer side.
/// Throws InputError when no light arrives, or the outline is none.
TracedSource trace_source(const Lens& lens, const Light& light, const Receiver& receiver, int resolution = 128);

/// The loops of an SVG's filled shapes as a lens outline: the view box is stretched onto `size_mm`, X to the right, Y up as
/// seen from the exit. Throws InputError when nothing is filled.
struct LensOutline {
  std::vector<std::vector<Vec2>> loops_mm;
  std::vector<std::string> warnings;  ///< what of the drawing was not understood, with line numbers
};
LensOutline read_outline(const std::string& path, const Vec2& size_mm);

/// Source irradiance at pixel centres over `extent`, row 0 at the smallest y: a picture for the eye.
Grid<float> rasterise_source(const SourceLight& source, const Box2& extent, int width, int height);

}  // namespace lightmill
