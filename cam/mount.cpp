#include "cam/mount.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <utility>

#include "cam/outline_region.h"
#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kWallMm = 0.3;       ///< that stays between a hole and anything else
constexpr double kDotShare = 0.75;    ///< of a dot's diameter in the distance from dot to dot
constexpr int kColumns = 5, kRows = 7;

struct Glyph {
  char letter;
  std::array<std::uint8_t, kRows> rows;  ///< from the top; the leftmost dot is 16
};

constexpr Glyph kGlyphs[] = {
    {' ', {0, 0, 0, 0, 0, 0, 0}},        {'A', {14, 17, 17, 31, 17, 17, 17}}, {'B', {30, 17, 17, 30, 17, 17, 30}},
    {'C', {14, 17, 16, 16, 16, 17, 14}}, {'D', {30, 17, 17, 17, 17, 17, 30}}, {'E', {31, 16, 16, 30, 16, 16, 31}},
    {'F', {31, 16, 16, 30, 16, 16, 16}}, {'G', {14, 17, 16, 23, 17, 17, 14}}, {'H', {17, 17, 17, 31, 17, 17, 17}},
    {'I', {14, 4, 4, 4, 4, 4, 14}},      {'J', {7, 2, 2, 2, 2, 18, 12}},      {'K', {17, 18, 20, 24, 20, 18, 17}},
    {'L', {16, 16, 16, 16, 16, 16, 31}}, {'M', {17, 27, 21, 21, 17, 17, 17}}, {'N', {17, 25, 21, 19, 17, 17, 17}},
    {'O', {14, 17, 17, 17, 17, 17, 14}}, {'P', {30, 17, 17, 30, 16, 16, 16}}, {'Q', {14, 17, 17, 17, 21, 18, 13}},
    {'R', {30, 17, 17, 30, 20, 18, 17}}, {'S', {15, 16, 16, 14, 1, 1, 30}},   {'T', {31, 4, 4, 4, 4, 4, 4}},
    {'U', {17, 17, 17, 17, 17, 17, 14}}, {'V', {17, 17, 17, 17, 10, 10, 4}},  {'W', {17, 17, 17, 21, 21, 27, 17}},
    {'X', {17, 17, 10, 4, 10, 17, 17}},  {'Y', {17, 17, 10, 4, 4, 4, 4}},     {'Z', {31, 1, 2, 4, 8, 16, 31}},
    {'0', {14, 17, 19, 21, 25, 17, 14}}, {'1', {4, 12, 4, 4, 4, 4, 14}},      {'2', {14, 17, 1, 6, 8, 16, 31}},
    {'3', {31, 2, 4, 2, 1, 17, 14}},     {'4', {2, 6, 10, 18, 31, 2, 2}},     {'5', {31, 16, 30, 1, 1, 17, 14}},
    {'6', {6, 8, 16, 30, 17, 17, 14}},   {'7', {31, 1, 2, 4, 4, 4, 4}},       {'8', {14, 17, 17, 14, 17, 17, 14}},
    {'9', {14, 17, 17, 15, 1, 2, 12}},   {'.', {0, 0, 0, 0, 0, 0, 4}},        {',', {0, 0, 0, 0, 4, 4, 8}},
    {':', {0, 0, 4, 0, 4, 0, 0}},        {'-', {0, 0, 0, 31, 0, 0, 0}},       {'+', {0, 4, 4, 31, 4, 4, 0}},
    {'/', {1, 1, 2, 4, 8, 16, 16}},      {'_', {0, 0, 0, 0, 0, 0, 31}},       {'#', {10, 10, 31, 10, 31, 10, 10}},
};

const Glyph& glyph_of(char c) {
  const char capital = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  for (const Glyph& glyph : kGlyphs) {
    if (glyph.letter == capital) return glyph;
  }
  throw InputError("mount.label: '" + std::string(1, c) + "' is not among the letters that can be drilled: A to Z, 0 to 9, space and . , : - + / _ #");
}

/// Middles of a label's dots about its own middle, read with x to the right.
std::vector<Vec2> label_dots(const std::string& label, double pitch_mm) {
  std::vector<Vec2> dots;
  const int columns = static_cast<int>(label.size()) * (kColumns + 1) - 1;
  for (std::size_t k = 0; k < label.size(); ++k) {
    const Glyph& glyph = glyph_of(label[k]);
    for (int row = 0; row < kRows; ++row) {
      for (int column = 0; column < kColumns; ++column) {
        if (!(glyph.rows[row] >> (kColumns - 1 - column) & 1)) continue;
        const int right = static_cast<int>(k) * (kColumns + 1) + column;
        dots.emplace_back(pitch_mm * (right - (columns - 1) / 2.0), pitch_mm * ((kRows - 1) / 2.0 - row));
      }
    }
  }
  return dots;
}

/// In the middle of the land, where the lens reaches lowest.
Vec2 below_the_lens(const Land& land) {
  const auto lowest = [](const Outline& outline) {
    Vec2 best(0, 0);
    for (const Vec2& p : outline_places(outline, 0.1)) {
      const bool level = std::abs(p.y() - best.y()) < 1e-9;
      if (level ? std::abs(p.x()) < std::abs(best.x()) : p.y() < best.y()) best = p;
    }
    return best;
  };
  return (lowest(land.optical) + lowest(land.part)) / 2;
}

std::string told(const Vec2& p) { return "x " + fixed(p.x(), 2) + ", y " + fixed(p.y(), 2) + " mm"; }

}  // namespace

std::vector<RoundHole> mount_holes(const MountOptions& options, const Land& land) {
  const bool wanted = options.chamfer_mm > 0 || !options.dowels_mm.empty() || !options.label.empty();
  if (!wanted) return {};
  const std::vector<Vec2> optical = outline_places(land.optical, 0.1), part = outline_places(land.part, 0.1);
  double width = std::numeric_limits<double>::infinity();
  for (const Vec2& p : optical) width = std::min(width, distance_to_loop(part, p));
  if (!(width > kWallMm)) throw InputError("mount.chamfer_mm, mount.dowels_mm and mount.label need a land to be cut into: set lens.land_mm");
  if (options.chamfer_mm > std::min(width - kWallMm, land.z_mm / 2 - kWallMm)) {
    throw InputError("mount.chamfer_mm = " + compact(options.chamfer_mm, 3) + " is too large for a land " + compact(width, 3) + " mm wide and " +
                     compact(land.z_mm, 3) + " mm high");
  }

  std::vector<RoundHole> holes;
  const auto add = [&](const std::string& key, const RoundHole& hole) {
    const double room = hole.radius_mm + kWallMm;
    const bool inside = land.part.contains(hole.middle_mm) && distance_to_loop(part, hole.middle_mm) >= room + options.chamfer_mm;
    if (!inside || land.optical.contains(hole.middle_mm) || distance_to_loop(optical, hole.middle_mm) < room) {
      throw InputError(key + ": the hole at " + told(hole.middle_mm) + " (" + compact(2 * hole.radius_mm, 3) + " mm) is not within the land, " +
                       compact(kWallMm, 2) + " mm from its borders: move it, make it smaller, or make lens.land_mm larger");
    }
    for (const RoundHole& other : holes) {
      const bool same_height = hole.from_mm < other.to_mm + kWallMm && other.from_mm < hole.to_mm + kWallMm;
      // Dots of a label may stand as near to each other as they are drawn.
      const double wall = key == "mount.label" && other.radius_mm == hole.radius_mm ? 0 : kWallMm;
      if (same_height && (hole.middle_mm - other.middle_mm).norm() < hole.radius_mm + other.radius_mm + wall) {
        throw InputError(key + ": the hole at " + told(hole.middle_mm) + " runs into the one at " + told(other.middle_mm));
      }
    }
    holes.push_back(hole);
  };

  const bool through = options.dowel_depth_mm == 0;
  if (!through && options.dowel_depth_mm > land.z_mm - kWallMm) {
    throw InputError("mount.dowel_depth_mm = " + compact(options.dowel_depth_mm, 3) + " leaves no bottom in a land " + compact(land.z_mm, 3) +
                     " mm high; 0 drills through");
  }
  for (const Vec2& p : options.dowels_mm) {
    add("mount.dowels_mm", {p, options.dowel_diameter_mm / 2, 0, through ? land.z_mm : options.dowel_depth_mm, true, through});
  }
  if (!options.label.empty()) {
    if (options.label_depth_mm > land.z_mm / 2) throw InputError("mount.label_depth_mm must be at most half of the land's height");
    const double pitch = options.label_height_mm / (kRows - 1 + kDotShare);
    const Vec2 middle = options.label_at_mm ? *options.label_at_mm : below_the_lens(land);
    for (const Vec2& dot : label_dots(options.label, pitch)) {
      if (options.label_on_back) {
        add("mount.label", {middle + Vec2(-dot.x(), dot.y()), kDotShare * pitch / 2, 0, options.label_depth_mm, true, false});
      } else {
        add("mount.label", {middle + dot, kDotShare * pitch / 2, land.z_mm - options.label_depth_mm, land.z_mm, false, true});
      }
    }
  }
  return holes;
}

double mount_volume_mm3(const MountOptions& options, const Land& land) {
  double volume = 0;
  for (const RoundHole& hole : mount_holes(options, land)) volume += kPi * hole.radius_mm * hole.radius_mm * (hole.to_mm - hole.from_mm);
  // Moved inwards by t, the border encloses perimeter t - sum tan(turn / 2) t^2 less; a disk's turns sum up to pi.
  double perimeter = kPi * land.part.size_mm.x(), turns = kPi;
  if (land.part.shape != Outline::Shape::kDisk) {
    perimeter = turns = 0;
    const std::vector<Vec2> loop = outline_places(land.part, std::numeric_limits<double>::infinity());
    for (std::size_t k = 0; k < loop.size(); ++k) {
      const Vec2 before = loop[k] - loop[(k + loop.size() - 1) % loop.size()], after = loop[(k + 1) % loop.size()] - loop[k];
      perimeter += after.norm();
      turns += std::tan(std::atan2(before.x() * after.y() - before.y() * after.x(), before.dot(after)) / 2);
    }
  }
  const double c = options.chamfer_mm;
  return volume + 2 * (perimeter * c * c / 2 - turns * c * c * c / 3);
}

std::string mount_words(const MountOptions& options) {
  std::string words;
  const auto add = [&](const std::string& what) { words += (words.empty() ? "" : "; ") + what; };
  if (options.chamfer_mm > 0) add("chamfer " + compact(options.chamfer_mm, 2) + " mm along the outer edges of back and land");
  if (!options.dowels_mm.empty()) {
    std::string places;
    for (const Vec2& p : options.dowels_mm) places += (places.empty() ? "" : " and ") + told(p);
    add("from the back, holes of " + compact(options.dowel_diameter_mm, 2) + " mm, " +
        (options.dowel_depth_mm > 0 ? compact(options.dowel_depth_mm, 2) + " mm deep" : std::string("through")) + ", at " + places);
  }
  if (!options.label.empty()) {
    add("label \"" + options.label + "\" " + (options.label_on_back ? "on the back" : "on the land") + ", dots " + compact(options.label_depth_mm, 2) + " mm deep");
  }
  return words;
}

}  // namespace lightmill
