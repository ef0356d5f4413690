#include "cli/spline_file.h"

#include <cstdint>
#include <cstring>
#include <string>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill {

namespace {

constexpr char kMagic[8] = {'L', 'M', 'S', 'P', 'L', 'N', '0', '2'};

struct Header {
  char magic[8];
  double extent[4];
  std::int32_t spans_x;
  std::int32_t spans_y;
  std::int64_t padding;
};

}  // namespace

void write_spline(const std::filesystem::path& path, const SplineSurface& surface) {
  Header header = {};
  std::memcpy(header.magic, kMagic, sizeof kMagic);
  const Box2& box = surface.extent();
  header.extent[0] = box.min.x();
  header.extent[1] = box.min.y();
  header.extent[2] = box.max.x();
  header.extent[3] = box.max.y();
  header.spans_x = surface.spans_x();
  header.spans_y = surface.spans_y();
  header.padding = surface.padding();
  std::string bytes(reinterpret_cast<const char*>(&header), sizeof header);
  const auto& values = surface.padded_coefficients().values;
  bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(double));
  write_whole(path, bytes);
}

SplineSurface read_spline(const std::filesystem::path& path) {
  const std::string bytes = read_whole(path);
  Header header;
  const auto fail = [&] { return InputError(path.string() + " is not a spline of this version; make it again with: lightmill cam"); };
  if (bytes.size() < sizeof header) throw fail();
  std::memcpy(&header, bytes.data(), sizeof header);
  if (std::memcmp(header.magic, kMagic, sizeof kMagic) != 0 || header.spans_x < 1 || header.spans_y < 1 ||
      header.spans_x > 100000 || header.spans_y > 100000 || header.padding < 1 || header.padding > 10000) {
    throw fail();
  }
  const int padding = static_cast<int>(header.padding);
  const std::size_t width = header.spans_x + 3 + 2 * padding, height = header.spans_y + 3 + 2 * padding;
  if (bytes.size() != sizeof header + width * height * sizeof(double)) throw fail();
  Grid<double> padded(static_cast<int>(width), static_cast<int>(height));
  std::memcpy(padded.values.data(), bytes.data() + sizeof header, padded.values.size() * sizeof(double));
  const Box2 extent{{header.extent[0], header.extent[1]}, {header.extent[2], header.extent[3]}};
  return SplineSurface::with_padded(extent, header.spans_x, header.spans_y, padding, std::move(padded));
}

}  // namespace lightmill
