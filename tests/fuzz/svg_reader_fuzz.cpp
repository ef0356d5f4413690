// Fuzzes the SVG reader.
#include "design/core/errors.h"
#include "design/detail/svg.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace lightmill;
  try {
    const Vec2 picture(120, 80);
    const detail::Drawing drawing =
        detail::parse_drawing({reinterpret_cast<const char*>(data), size}, "fuzz", picture, ViewedFrom::kLens);
    detail::borders_of(drawing.shapes, Box2::centred(picture));
  } catch (const InputError&) {
  }
  return 0;
}
