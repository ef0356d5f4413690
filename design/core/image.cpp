#include "design/core/image.h"

#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <memory>
#include <string_view>
#include <vector>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill {

namespace fs = std::filesystem;

namespace {

float srgb_to_linear(float code) {
  return code <= 0.04045F ? code / 12.92F : std::pow((code + 0.055F) / 1.055F, 2.4F);
}

float linear_to_srgb(float light) {
  light = std::clamp(light, 0.0F, 1.0F);
  return light <= 0.0031308F ? light * 12.92F : 1.055F * std::pow(light, 1.0F / 2.4F) - 0.055F;
}

struct RawImage {
  OIIO::ImageSpec spec;
  std::vector<float> pixels;
};

/// What is wrong with a PNG as a file, "" if nothing: it is cut short or a chunk's checksum is off. libpng would say so
/// on stderr by itself, beside the one line that we owe the user. Other formats pass. [PNG specification, sec. 5.3,
/// annex D]
std::string png_damage(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  constexpr std::string_view kSignature("\x89PNG\r\n\x1a\n", 8);
  if (!bytes.starts_with(kSignature)) return "";
  static const auto table = [] {
    std::array<std::uint32_t, 256> entries{};
    for (std::uint32_t n = 0; n < 256; ++n) {
      std::uint32_t c = n;
      for (int k = 0; k < 8; ++k) c = (c & 1) != 0 ? 0xedb88320U ^ (c >> 1) : c >> 1;
      entries[n] = c;
    }
    return entries;
  }();
  const auto byte = [&](std::size_t at) { return static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[at])); };
  const auto word = [&](std::size_t at) {
    return byte(at) << 24 | byte(at + 1) << 16 | byte(at + 2) << 8 | byte(at + 3);
  };
  for (std::size_t at = kSignature.size(); at + 12 <= bytes.size();) {
    const std::size_t length = word(at);
    if (length > bytes.size() - at - 12) break;
    std::uint32_t crc = ~0U;
    for (std::size_t k = at + 4; k < at + 8 + length; ++k) crc = table[(crc ^ byte(k)) & 255] ^ (crc >> 8);
    if (~crc != word(at + 8 + length)) return "a checksum in it is wrong";
    if (bytes.compare(at + 4, 4, "IEND") == 0) return "";
    at += 12 + length;
  }
  return "it is cut short";
}

RawImage read_raw(const fs::path& path) {
  std::error_code error;
  if (!fs::exists(path, error)) throw InputError("picture " + path.string() + " does not exist; check the path");
  if (fs::is_directory(path, error)) throw InputError("picture " + path.string() + " is a folder; name a file");
  const auto fail = [&](const std::string& why) {
    std::string line = why.substr(0, why.find('\n'));
    return InputError("cannot read picture " + path.string() + ": " + line + "; give a PNG, TIFF or EXR that opens in a viewer");
  };
  if (const std::string damage = png_damage(path); !damage.empty()) throw fail(damage);
  std::unique_ptr<OIIO::ImageInput> input;
  try {
    input = OIIO::ImageInput::open(path.string());
  } catch (const std::exception& e) {
    throw fail(e.what());
  }
  if (!input) throw fail(OIIO::geterror());
  RawImage image;
  image.spec = input->spec();
  constexpr long long kMostPixels = 1LL << 28;
  const long long pixels = static_cast<long long>(image.spec.width) * image.spec.height;
  if (pixels <= 0) throw fail("it has no pixels");
  if (pixels > kMostPixels) throw fail("it has over 268 million pixels");
  image.pixels.resize(static_cast<std::size_t>(pixels) * image.spec.nchannels);
  if (!input->read_image(0, 0, 0, image.spec.nchannels, OIIO::TypeDesc::FLOAT, image.pixels.data())) {
    throw fail(input->geterror());
  }
  return image;
}

void write_pixels(const fs::path& path, int width, int height, int channels, OIIO::TypeDesc stored,
                  OIIO::TypeDesc given, const void* data, const char* colour_space) {
  write_whole(path, [&](const fs::path& partial) {
    auto out = OIIO::ImageOutput::create(partial.string());
    if (!out) throw IoError("cannot write " + path.string() + ": " + OIIO::geterror());
    OIIO::ImageSpec spec(width, height, channels, stored);
    spec.attribute("oiio:ColorSpace", colour_space);
    spec.attribute("compression", "zip");
    if (!out->open(partial.string(), spec) || !out->write_image(given, data) || !out->close()) {
      throw IoError("cannot write " + path.string() + ": " + out->geterror());
    }
  });
}

}  // namespace

Picture read_picture(const fs::path& path, Transfer transfer) {
  const RawImage image = read_raw(path);
  const int channels = image.spec.nchannels;
  const bool srgb = transfer == Transfer::kSrgb ||
                    (transfer == Transfer::kAuto && image.spec.format.basetype == OIIO::TypeDesc::UINT8);
  const int alpha = image.spec.alpha_channel >= 0 ? image.spec.alpha_channel : (channels == 2 ? 1 : channels == 4 ? 3 : -1);
  const bool colour = channels >= 3;

  Picture picture;
  const int w = image.spec.width;
  const int h = image.spec.height;
  picture.gray = Grid<float>(w, h);
  if (colour) picture.red = picture.green = picture.blue = Grid<float>(w, h);
  for (std::size_t i = 0; i < picture.gray.values.size(); ++i) {
    const float* pixel = &image.pixels[i * channels];
    for (int c = 0; c < channels; ++c) {
      if (!std::isfinite(pixel[c]) || pixel[c] < 0) {
        throw InputError("picture " + path.string() + " has a negative or not finite value at column " +
                         std::to_string(i % w) + ", row " + std::to_string(i / w) + "; light is never below zero");
      }
    }
    // OpenImageIO hands out colour with alpha already multiplied in code values: undo it, linearise, multiply in light.
    const float a = alpha >= 0 ? std::min(pixel[alpha], 1.0F) : 1.0F;
    const auto light = [&](float code) {
      if (a <= 0) return 0.0F;
      const float straight = alpha >= 0 ? code / a : code;
      return a * (srgb ? srgb_to_linear(straight) : straight);
    };
    if (colour) {
      const float r = light(pixel[0]);
      const float g = light(pixel[1]);
      const float b = light(pixel[2]);
      picture.red.values[i] = r;
      picture.green.values[i] = g;
      picture.blue.values[i] = b;
      picture.gray.values[i] = 0.2126F * r + 0.7152F * g + 0.0722F * b;
    } else {
      picture.gray.values[i] = light(pixel[0]);
    }
  }
  return picture;
}

Grid<float> read_float_image(const fs::path& path) {
  const RawImage image = read_raw(path);
  Grid<float> grid(image.spec.width, image.spec.height);
  for (std::size_t i = 0; i < grid.values.size(); ++i) grid.values[i] = image.pixels[i * image.spec.nchannels];
  return grid;
}

void write_png8(const fs::path& path, const Grid<float>& linear_light) {
  std::vector<std::uint8_t> codes(linear_light.values.size());
  for (std::size_t i = 0; i < codes.size(); ++i) {
    codes[i] = static_cast<std::uint8_t>(std::lround(255 * linear_to_srgb(linear_light.values[i])));
  }
  write_pixels(path, linear_light.width, linear_light.height, 1, OIIO::TypeDesc::UINT8, OIIO::TypeDesc::UINT8, codes.data(), "sRGB");
}

void write_png8(const fs::path& path, const Grid<float>& red, const Grid<float>& green, const Grid<float>& blue) {
  std::vector<std::uint8_t> codes(red.values.size() * 3);
  const Grid<float>* planes[] = {&red, &green, &blue};
  for (std::size_t i = 0; i < red.values.size(); ++i) {
    for (int c = 0; c < 3; ++c) {
      codes[3 * i + c] = static_cast<std::uint8_t>(std::lround(255 * linear_to_srgb(planes[c]->values[i])));
    }
  }
  write_pixels(path, red.width, red.height, 3, OIIO::TypeDesc::UINT8, OIIO::TypeDesc::UINT8, codes.data(), "sRGB");
}

void write_png16(const fs::path& path, const Grid<float>& linear) {
  std::vector<std::uint16_t> codes(linear.values.size());
  for (std::size_t i = 0; i < codes.size(); ++i) {
    codes[i] = static_cast<std::uint16_t>(std::lround(65535 * std::clamp(linear.values[i], 0.0F, 1.0F)));
  }
  write_pixels(path, linear.width, linear.height, 1, OIIO::TypeDesc::UINT16, OIIO::TypeDesc::UINT16, codes.data(), "Linear");
}

void write_float_image(const fs::path& path, const Grid<float>& values) {
  write_pixels(path, values.width, values.height, 1, OIIO::TypeDesc::FLOAT, OIIO::TypeDesc::FLOAT, values.values.data(), "Linear");
}

}  // namespace lightmill
