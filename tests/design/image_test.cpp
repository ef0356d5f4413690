#include "design/core/image.h"

#include <OpenImageIO/imageio.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "design/core/errors.h"
#include "tests/design/drawing_fixture.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace fs = std::filesystem;

double srgb_to_linear(double code) {
  return code <= 0.04045 ? code / 12.92 : std::pow((code + 0.055) / 1.055, 2.4);
}

class ImageTest : public DrawingFixture {
 protected:
  /// 3 x 2 pixels that all differ, with the given channels.
  fs::path file(const std::string& name, OIIO::TypeDesc type, std::vector<std::string> channels,
                const std::function<void(OIIO::ImageSpec&)>& more = {}, std::vector<float> values = {}) const {
    OIIO::ImageSpec spec(3, 2, static_cast<int>(channels.size()), type);
    spec.channelnames = channels;
    spec.alpha_channel = -1;
    for (std::size_t k = 0; k < channels.size(); ++k) {
      if (channels[k] == "A") spec.alpha_channel = static_cast<int>(k);
    }
    spec.attribute("oiio:UnassociatedAlpha", 1);
    if (more) more(spec);
    if (values.empty()) values = codes(channels.size());
    const fs::path path = folder_ / name;
    const auto out = OIIO::ImageOutput::create(path.string());
    EXPECT_TRUE(out && out->open(path.string(), spec) && out->write_image(OIIO::TypeDesc::FLOAT, values.data()) &&
                out->close())
        << name << OIIO::geterror();
    return path;
  }
  /// Multiples of 1 / 255, so that every depth holds them.
  static std::vector<float> codes(std::size_t channels) {
    std::vector<float> values(6 * channels);
    for (std::size_t k = 0; k < values.size(); ++k) values[k] = static_cast<float>((k * 47 + 20) % 256) / 255;
    return values;
  }
  static std::string complaint(const fs::path& path) {
    try {
      read_picture(path);
    } catch (const InputError& e) {
      return e.what();
    }
    return "no complaint";
  }
};

TEST_F(ImageTest, EveryDepthAndLayoutIsItsLight) {
  using OIIO::TypeDesc;
  const std::vector<std::string> gray{"Y"};
  const std::vector<std::string> gray_alpha{"Y", "A"};
  const std::vector<std::string> rgb{"R", "G", "B"};
  const std::vector<std::string> rgba{"R", "G", "B", "A"};
  struct Kind {
    const char* name;
    TypeDesc type;
    double accuracy;
  };
  for (const Kind& kind : {Kind{"a.png", TypeDesc::UINT8, 2e-6}, Kind{"b.png", TypeDesc::UINT16, 2e-5},
                           Kind{"a.tif", TypeDesc::UINT8, 2e-6}, Kind{"b.tif", TypeDesc::UINT16, 2e-5},
                           Kind{"c.tif", TypeDesc::UINT32, 1e-6}, Kind{"d.tif", TypeDesc::FLOAT, 1e-6},
                           Kind{"e.exr", TypeDesc::HALF, 1e-3}, Kind{"f.exr", TypeDesc::FLOAT, 1e-6}}) {
    for (const auto& channels : {gray, gray_alpha, rgb, rgba}) {
      const std::size_t n = channels.size();
      const Picture picture = read_picture(file(kind.name, kind.type, channels));
      EXPECT_THAT(picture.warnings, IsEmpty()) << kind.name << n;
      ASSERT_EQ(picture.gray.width, 3);
      ASSERT_EQ(picture.gray.height, 2);
      const std::vector<float> values = codes(n);
      const bool premultiplied = std::string(kind.name).ends_with(".exr");  // as that format always is
      for (int i = 0; i < 6; ++i) {
        const float* pixel = &values[i * n];
        const auto linear = [&](double code) { return kind.type == TypeDesc::UINT8 ? srgb_to_linear(code) : code; };
        double light = n <= 2 ? linear(pixel[0])
                              : 0.2126 * linear(pixel[0]) + 0.7152 * linear(pixel[1]) + 0.0722 * linear(pixel[2]);
        if (n % 2 == 0 && !premultiplied) light *= pixel[n - 1];
        EXPECT_NEAR(picture.gray.values[i], light, kind.accuracy) << kind.name << ", " << n << " channels, pixel " << i;
      }
    }
  }
}

TEST_F(ImageTest, TheTransferCanBeSaid) {
  const fs::path eight = file("a.png", OIIO::TypeDesc::UINT8, {"Y"});
  const fs::path sixteen = file("b.png", OIIO::TypeDesc::UINT16, {"Y"});
  const float code = codes(1)[3];
  EXPECT_NEAR(read_picture(eight, Transfer::kLinear).gray.at(0, 1), code, 1e-6);
  EXPECT_NEAR(read_picture(sixteen, Transfer::kSrgb).gray.at(0, 1), srgb_to_linear(code), 1e-5);
}

TEST_F(ImageTest, TransparentIsBlack) {
  const auto path = file("a.png", OIIO::TypeDesc::UINT8, {"R", "G", "B", "A"}, {},
                         std::vector<float>{1, 1, 1, 0, 1, 1, 1, 1, 1, 1, 1, 0.2F, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 1, 0});
  const Picture picture = read_picture(path);
  const std::vector<float> wanted{0, 1, 0.2F, 0, 0, 0};
  for (int k = 0; k < 6; ++k) EXPECT_NEAR(picture.gray.values[k], wanted[k], 1e-6);
}

TEST_F(ImageTest, AFileIsTurnedAsItAsks) {
  // Where the stored first row and first column are seen [TIFF 6.0, Orientation].
  const auto codes = this->codes(1);
  for (int orientation = 1; orientation <= 8; ++orientation) {
    const auto path = file("a.tif", OIIO::TypeDesc::FLOAT, {"Y"},
                           [&](OIIO::ImageSpec& spec) { spec.attribute("Orientation", orientation); });
    const Grid<float> seen = read_picture(path).gray;
    ASSERT_EQ(seen.width, orientation < 5 ? 3 : 2);
    const int right = seen.width - 1;
    const int bottom = seen.height - 1;
    const Vec2 first = std::vector<Vec2>{{0, 0}, {right, 0}, {right, bottom}, {0, bottom},
                                         {0, 0}, {right, 0}, {right, bottom}, {0, bottom}}[orientation - 1];
    const Vec2 along =
        std::vector<Vec2>{{1, 0}, {-1, 0}, {-1, 0}, {1, 0}, {0, 1}, {0, 1}, {0, -1}, {0, -1}}[orientation - 1];
    for (int k = 0; k < 3; ++k) {
      const Vec2 at = first + k * along;
      EXPECT_EQ(seen.at(int(at.x()), int(at.y())), codes[k]) << orientation;
    }
  }
}

TEST_F(ImageTest, ADataWindowLiesInItsDisplayWindow) {
  const auto path = file("a.exr", OIIO::TypeDesc::FLOAT, {"Y"}, [](OIIO::ImageSpec& spec) {
    spec.x = 2;
    spec.y = 1;
    spec.full_width = 7;
    spec.full_height = 4;
  });
  const Picture picture = read_picture(path);
  ASSERT_EQ(picture.gray.width, 7);
  ASSERT_EQ(picture.gray.height, 4);
  EXPECT_EQ(picture.gray.at(1, 1), 0);
  EXPECT_EQ(picture.gray.at(2, 1), codes(1)[0]);
  EXPECT_EQ(picture.gray.at(4, 2), codes(1)[5]);
  EXPECT_THAT(picture.warnings, IsEmpty());
}

TEST_F(ImageTest, OddChannelsAreSaidOrRefused) {
  EXPECT_THAT(complaint(file("a.exr", OIIO::TypeDesc::FLOAT, {"X", "Y", "Z"})),
              HasSubstr("3 channels (X, Y, Z), which is neither gray nor RGB"));
  EXPECT_THAT(complaint(file("b.tif", OIIO::TypeDesc::FLOAT, {"a", "b", "c", "d", "e"})),
              AnyOf(HasSubstr("no complaint"), HasSubstr("5 channels")));
  const auto extra = read_picture(file("c.exr", OIIO::TypeDesc::FLOAT, {"R", "G", "B", "A", "Z"}));
  ASSERT_EQ(extra.warnings.size(), 1U);
  EXPECT_THAT(extra.warnings[0], HasSubstr("of its 5 channels only R, G, B and alpha"));
}

TEST_F(ImageTest, InkTakesLightAway) {
  const auto printed = [](OIIO::ImageSpec& spec) { spec.attribute("tiff:ColorSpace", "CMYK"); };
  // No ink, black ink; each colour alone; all colours.
  std::vector<float> ink = {0, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 1, 1, 0};
  const Picture picture = read_picture(file("cmyk.tif", OIIO::TypeDesc::UINT8, {"C", "M", "Y", "K"}, printed, ink));
  const std::vector<double> expected = {1, 0, 1 - 0.2126, 1 - 0.7152, 1 - 0.0722, 0};
  for (std::size_t k = 0; k < expected.size(); ++k) EXPECT_NEAR(picture.gray.values[k], expected[k], 1e-4) << k;
  ASSERT_EQ(picture.warnings.size(), 1U);
  EXPECT_THAT(picture.warnings[0], HasSubstr("CMYK"));
}

TEST_F(ImageTest, BadValuesAreNamedWithTheirPlace) {
  for (const float bad : {-0.5F, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN()}) {
    auto values = codes(3);
    values[3 * 4 + 1] = bad;
    for (const char* name : {"a.exr", "a.tif"}) {
      EXPECT_THAT(complaint(file(name, OIIO::TypeDesc::FLOAT, {"R", "G", "B"}, {}, values)),
                  HasSubstr("column 1, row 1"))
          << bad;
    }
  }
}

TEST_F(ImageTest, FilesThatAreCutShortAreRefused) {
  for (const auto& [name, type] :
       std::initializer_list<std::pair<const char*, OIIO::TypeDesc>>{{"a.png", OIIO::TypeDesc::UINT8},
                                                                     {"a.tif", OIIO::TypeDesc::UINT16},
                                                                     {"a.exr", OIIO::TypeDesc::HALF},
                                                                     {"a.jpg", OIIO::TypeDesc::UINT8}}) {
    OIIO::ImageSpec spec(200, 150, 3, type);
    const fs::path path = folder_ / name;
    std::vector<float> values(200 * 150 * 3);
    for (std::size_t k = 0; k < values.size(); ++k) values[k] = static_cast<float>(k * 2654435761U % 1000) / 1000;
    const auto out = OIIO::ImageOutput::create(path.string());
    ASSERT_TRUE(out->open(path.string(), spec) && out->write_image(OIIO::TypeDesc::FLOAT, values.data()) &&
                out->close());
    EXPECT_EQ(complaint(path), "no complaint");
    const auto whole = fs::file_size(path);
    for (const auto size : {whole * 2 / 3, whole / 2, std::uintmax_t{30}, std::uintmax_t{0}}) {
      fs::resize_file(path, size);
      EXPECT_THAT(complaint(path), HasSubstr(name)) << size;
    }
  }
}

TEST_F(ImageTest, OnePixelIsAPicture) {
  TargetSpec spec;
  spec.image = write("one.pgm", "P2\n1 1\n255\n255\n");
  spec.size_mm = {30, 30};
  const TargetLight target = load_target(spec);
  EXPECT_EQ(target.area_flux.values, std::vector<double>{1});
  EXPECT_THAT(target.warnings, IsEmpty());
  spec.size_mm = {30, 20};
  EXPECT_THAT(load_target(spec).warnings,
              testing::ElementsAre(HasSubstr("one.pgm of 1 x 1 pixels is stretched onto 30 x 20 mm")));
}

}  // namespace
}  // namespace lightmill
