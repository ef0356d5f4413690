#include "cli/mask_print.h"

#include <array>
#include <cmath>
#include <numbers>

#include "design/core/files.h"
#include "design/core/image.h"
#include "design/core/markup.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kMarkFromBox_mm = 5;
constexpr double kMarkRadius_mm = 2;
constexpr double kHairLength_mm = 3.5;  // from the centre
constexpr double kHairWidth_mm = 0.25;

struct Mark {
  Vec2 centre_mm;
  bool filled = false;
};

std::array<Mark, 4> marks_of(const Vec2& lens_size) {
  const Vec2 at = lens_size / 2 + Vec2(kMarkFromBox_mm, kMarkFromBox_mm);
  return {{{{-at.x(), -at.y()}, false}, {{at.x(), -at.y()}, false}, {{-at.x(), at.y()}, false}, {at, true}}};
}

bool on_mark(const Mark& mark, const Vec2& p) {
  const Vec2 d = (p - mark.centre_mm).cwiseAbs();
  const double radius = d.norm();
  if (mark.filled ? radius <= kMarkRadius_mm : std::abs(radius - kMarkRadius_mm) <= kHairWidth_mm / 2) return true;
  return d.minCoeff() <= kHairWidth_mm / 2 && d.maxCoeff() <= kHairLength_mm;
}

std::string mm(double value) {
  return compact(value, 3);
}

/// Closed paths in the page's coordinates: mm, Y down, the box's corner at (margin, margin).
std::string outline_path(const Lens& lens) {
  const auto place = [&](const Vec2& p) {
    return mm(p.x() + lens.size_mm.x() / 2 + kMaskMargin_mm) + " " + mm(lens.size_mm.y() / 2 - p.y() + kMaskMargin_mm);
  };
  std::vector<std::vector<Vec2>> loops = lens.outline_mm;
  if (lens.shape != Lens::Shape::kOutline) {
    const Vec2 half = lens.size_mm / 2;
    loops = {{-half, {half.x(), -half.y()}, half, {-half.x(), half.y()}}};
    if (lens.shape == Lens::Shape::kDisk) {
      constexpr int kCorners = 360;
      loops.front().clear();
      for (int k = 0; k < kCorners; ++k) {
        const double angle = 2 * std::numbers::pi * k / kCorners;
        loops.front().push_back(Vec2(std::cos(angle), std::sin(angle)).cwiseProduct(half));
      }
    }
  }
  std::string path;
  for (const auto& loop : loops) {
    for (std::size_t k = 0; k < loop.size(); ++k) path += (k == 0 ? "M" : "L") + place(loop[k]);
    path += "Z";
  }
  return path;
}

}  // namespace

void write_mask_png(const std::filesystem::path& path, const ColourGrid& mask) {
  ColourGrid print = mask;
  const int width = mask.red.width;
  const int height = mask.red.height;
  const Vec2 pixel = mask.extent.size().cwiseQuotient(Vec2(width, height));
  const Vec2 lens_size = mask.extent.size() - 2 * Vec2(kMaskMargin_mm, kMaskMargin_mm);
  for (const Mark& mark : marks_of(lens_size)) {
    const Vec2 first = (mark.centre_mm.array() - kHairLength_mm - mask.extent.min.array()) / pixel.array();
    const Vec2 last = (mark.centre_mm.array() + kHairLength_mm - mask.extent.min.array()) / pixel.array();
    for (int y = static_cast<int>(first.y()); y <= last.y() && y < height; ++y) {
      for (int x = static_cast<int>(first.x()); x <= last.x() && x < width; ++x) {
        if (!on_mark(mark, mask.extent.min + pixel.cwiseProduct(Vec2(x + 0.5, y + 0.5)))) continue;
        for (Grid<float>* channel : {&print.red, &print.green, &print.blue}) channel->at(x, y) = 0;
      }
    }
  }
  write_png8(path, flipped_rows(print.red), flipped_rows(print.green), flipped_rows(print.blue), kMaskDotsPerInch);
}

void write_mask_svg(const std::filesystem::path& path, const std::string& image_name, const Lens& lens,
                    const std::string& part) {
  const Vec2 page = lens.size_mm + 2 * Vec2(kMaskMargin_mm, kMaskMargin_mm);
  std::string svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"" +
                    mm(page.x()) + "mm\" height=\"" + mm(page.y()) + "mm\" viewBox=\"0 0 " + mm(page.x()) + " " +
                    mm(page.y()) + "\">\n" + "<title>Colour mask of " + escaped(part) +
                    "</title>\n<image xlink:href=\"" + escaped(image_name) + "\" width=\"" + mm(page.x()) +
                    "\" height=\"" + mm(page.y()) + "\" preserveAspectRatio=\"none\"/>\n" +
                    "<g fill=\"none\" stroke=\"black\" stroke-width=\"" + mm(kHairWidth_mm) + "\">\n";
  for (const Mark& mark : marks_of(lens.size_mm)) {
    const double x = mark.centre_mm.x() + page.x() / 2;
    const double y = page.y() / 2 - mark.centre_mm.y();
    svg += "<circle cx=\"" + mm(x) + "\" cy=\"" + mm(y) + "\" r=\"" + mm(kMarkRadius_mm) + "\"" +
           (mark.filled ? " fill=\"black\"" : "") + "/>" + "<path d=\"M" + mm(x - kHairLength_mm) + " " + mm(y) + "H" +
           mm(x + kHairLength_mm) + "M" + mm(x) + " " + mm(y - kHairLength_mm) + "V" + mm(y + kHairLength_mm) +
           "\"/>\n";
  }
  svg += "<path class=\"cut\" stroke=\"magenta\" stroke-width=\"0.1\" d=\"" + outline_path(lens) + "\"/>\n</g>\n" +
         "<text x=\"" + mm(page.x() / 2) + "\" y=\"" + mm(page.y() - 1.5) +
         "\" font-family=\"sans-serif\" font-size=\"2.2\" text-anchor=\"middle\">" + escaped(part) +
         ": printed side against the lens's flat back; filled mark at +X +Y, seen from the optical "
         "surface</text>\n</svg>\n";
  write_whole(path, svg);
}

}  // namespace lightmill
