// libFuzzer on the SVG reader. From the project's folder:
//   clang++ -std=c++20 -O1 -g -fsanitize=fuzzer,address,undefined -I. $(pkg-config --cflags eigen3 2geom pugixml OpenImageIO)
//   tests/fuzz/svg_reader_fuzz.cpp design/detail/svg*.cpp design/detail/{fills,coverage}.cpp design/target.cpp
//     design/core/{files,text,image}.cpp
//     $(pkg-config --libs 2geom pugixml OpenImageIO) -o /tmp/svg_reader_fuzz
//   /tmp/svg_reader_fuzz -max_total_time=600 -rss_limit_mb=3000 -timeout=20 fixtures/pictures
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
