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

/// Whether a JPEG ends before its end-of-image marker: libjpeg fills what is missing with gray and is content.
/// [ITU T.81, annex B]
bool is_cut_jpeg(std::string_view bytes) {
  if (!bytes.starts_with("\xff\xd8")) return false;
  const auto byte = [&](std::size_t at) { return static_cast<unsigned char>(bytes[at]); };
  for (std::size_t at = 2; at + 4 <= bytes.size() && byte(at) == 0xff; at += 2 + (byte(at + 2) << 8 | byte(at + 3))) {
    if (byte(at + 1) == 0xda) return bytes.find("\xff\xd9", at) == std::string_view::npos;  // the picture itself begins
  }
  return true;
}

/// What is wrong with a PNG or JPEG as a file, "" if nothing: it is cut short or a chunk's checksum is off. The libraries
/// would pass over it, or say so on stderr beside the one line that we owe the user. Other formats pass. [PNG
/// specification, sec. 5.3, annex D]
std::string damage_of(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  constexpr std::string_view kSignature("\x89PNG\r\n\x1a\n", 8);
  if (!bytes.starts_with(kSignature)) return is_cut_jpeg(bytes) ? "it is cut short" : "";
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

InputError unreadable(const fs::path& path, const std::string& why) {
  return InputError("cannot read picture " + path.string() + ": " + why.substr(0, why.find('\n')) +
                    "; give a PNG, TIFF or EXR that opens in a viewer");
}

std::unique_ptr<OIIO::ImageInput> open(const fs::path& path) {
  std::error_code error;
  if (!fs::exists(path, error)) throw InputError("picture " + path.string() + " does not exist; check the path");
  if (fs::is_directory(path, error)) throw InputError("picture " + path.string() + " is a folder; name a file");
  if (const std::string damage = damage_of(path); !damage.empty()) throw unreadable(path, damage);
  OIIO::ImageSpec config;
  config.attribute("oiio:UnassociatedAlpha", 1);  // colours as the file has them
  std::unique_ptr<OIIO::ImageInput> input;
  try {
    input = OIIO::ImageInput::open(path.string(), &config);
  } catch (const std::exception& e) {
    throw unreadable(path, e.what());
  }
  if (!input) throw unreadable(path, OIIO::geterror());
  constexpr long long kMostPixels = 1LL << 28;
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.depth > 1) throw unreadable(path, "it is a volume, not a picture");
  for (const auto& [width, height] : {std::pair(spec.width, spec.height), std::pair(spec.full_width, spec.full_height)}) {
    const long long pixels = static_cast<long long>(width) * height;
    if (width <= 0 || height <= 0) throw unreadable(path, "it has no pixels");
    if (pixels > kMostPixels) throw unreadable(path, "it has over 268 million pixels");
  }
  return input;
}

/// Calls action(row, pixels of the row) from the top, a band at a time: a large picture need not be there twice.
template <typename Action>
void for_each_row(OIIO::ImageInput& input, const fs::path& path, const Action& action) {
  const OIIO::ImageSpec& spec = input.spec();
  constexpr std::size_t kBand = 1 << 22;  // values at once
  const std::size_t in_row = static_cast<std::size_t>(spec.width) * spec.nchannels;
  int rows = static_cast<int>(std::clamp<std::size_t>(kBand / in_row, 1, spec.height));
  const int tile = spec.tile_height;
  if (tile > 0) rows = (rows + tile - 1) / tile * tile;
  std::vector<float> band(in_row * std::min(rows, spec.height));
  for (int row = 0; row < spec.height; row += rows) {
    const int end = std::min(row + rows, spec.height);
    const int y = spec.y + row;
    const bool read = tile > 0 ? input.read_tiles(0, 0, spec.x, spec.x + spec.width, y, spec.y + end, 0, 1, 0, spec.nchannels,
                                                  OIIO::TypeDesc::FLOAT, band.data())
                               : input.read_scanlines(0, 0, y, spec.y + end, 0, 0, spec.nchannels, OIIO::TypeDesc::FLOAT, band.data());
    if (!read) throw unreadable(path, input.geterror());
    for (int k = row; k < end; ++k) action(k, &band[(k - row) * in_row]);
  }
}

/// Which channels are light and alpha; -1: none.
struct Channels {
  std::array<int, 3> light{0, 0, 0};
  int alpha = -1;
};

Channels channels_of(const OIIO::ImageSpec& spec, const fs::path& path, std::vector<std::string>& warnings) {
  Channels channels;
  channels.alpha = spec.alpha_channel;
  const auto named = [&](const char* name) { return spec.channelindex(name); };
  const int count = spec.nchannels;
  if (named("R") >= 0 && named("G") >= 0 && named("B") >= 0) {
    channels.light = {named("R"), named("G"), named("B")};
  } else if (named("Y") >= 0 && count <= 2) {
    channels.light.fill(named("Y"));
  } else if (count > 2) {
    std::string names;
    for (const auto& name : spec.channelnames) names += (names.empty() ? "" : ", ") + name;
    throw InputError("picture " + path.string() + " has " + std::to_string(count) + " channels (" + names +
                     "), which is neither gray nor RGB; save it as gray, RGB or RGBA");
  }
  const int light = channels.light[0] == channels.light[1] ? 1 : 3;
  if (channels.alpha < 0 && count == light + 1) {
    channels.alpha = light;
    warnings.push_back("picture " + path.string() + ": its last channel (" + spec.channelnames[light] + ") is taken as alpha");
  } else if (count > light + (channels.alpha >= 0 ? 1 : 0)) {
    warnings.push_back("picture " + path.string() + ": of its " + std::to_string(count) + " channels only R, G, B and alpha are used");
  }
  return channels;
}

/// A picture turned and mirrored as the TIFF and EXIF tag says [TIFF 6.0, Orientation].
Grid<float> upright(Grid<float> stored, int orientation) {
  if (orientation < 2 || orientation > 8) return stored;
  const bool turned = orientation >= 5;
  const int w = stored.width;
  const int h = stored.height;
  Grid<float> seen(turned ? h : w, turned ? w : h);
  for (int row = 0; row < h; ++row) {
    for (int column = 0; column < w; ++column) {
      const int x = orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8 ? w - 1 - column : column;
      const int y = orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7 ? h - 1 - row : row;
      (turned ? seen.at(y, x) : seen.at(x, y)) = stored.at(column, row);
    }
  }
  return seen;
}

void write_pixels(const fs::path& path, int width, int height, int channels, OIIO::TypeDesc stored,
                  OIIO::TypeDesc given, const void* data, const char* colour_space, double dots_per_inch = 0) {
  write_whole(path, [&](const fs::path& partial) {
    auto out = OIIO::ImageOutput::create(partial.string());
    if (!out) throw IoError("cannot write " + path.string() + ": " + OIIO::geterror());
    OIIO::ImageSpec spec(width, height, channels, stored);
    spec.attribute("oiio:ColorSpace", colour_space);
    spec.attribute("compression", "zip");
    if (dots_per_inch > 0) {
      spec.attribute("XResolution", static_cast<float>(dots_per_inch));
      spec.attribute("YResolution", static_cast<float>(dots_per_inch));
      spec.attribute("ResolutionUnit", "in");
    }
    if (!out->open(partial.string(), spec) || !out->write_image(given, data) || !out->close()) {
      throw IoError("cannot write " + path.string() + ": " + out->geterror());
    }
  });
}

}  // namespace

Picture read_picture(const fs::path& path, Transfer transfer, bool with_colours) {
  const auto input = open(path);
  const OIIO::ImageSpec& spec = input->spec();
  Picture picture;
  const std::string name = "picture " + path.string();
  const Channels channels = channels_of(spec, path, picture.warnings);
  for (const char* tag : {"tiff:ColorSpace", "jpeg:ColorSpace"}) {
    if (spec.get_string_attribute(tag) == "CMYK")
      picture.warnings.push_back(name + " is CMYK, converted to RGB without its colour profile; save it as RGB or gray");
  }
  const bool eight_bit = spec.format.basetype == OIIO::TypeDesc::UINT8;
  const bool srgb = transfer == Transfer::kSrgb || (transfer == Transfer::kAuto && eight_bit);
  std::array<float, 256> light_of_byte{};
  for (int k = 0; k < 256; ++k) light_of_byte[k] = srgb_to_linear(static_cast<float>(k) / 255);
  const bool straight = channels.alpha < 0 || spec.get_int_attribute("oiio:UnassociatedAlpha") != 0;
  const auto light = [&](float code, float alpha) {
    if (!srgb) return straight ? alpha * code : code;
    if (alpha <= 0) return 0.0F;
    if (!straight) return alpha * srgb_to_linear(code / alpha);
    return alpha * (eight_bit ? light_of_byte[std::lround(code * 255)] : srgb_to_linear(code));
  };

  picture.gray = Grid<float>(spec.full_width, spec.full_height);
  const int left = spec.x - spec.full_x;
  const int top = spec.y - spec.full_y;
  if (left < 0 || top < 0 || left + spec.width > spec.full_width || top + spec.height > spec.full_height)
    picture.warnings.push_back(name + ": what lies outside its display window is cut");
  const bool gray = channels.light[0] == channels.light[1];
  const std::array<Grid<float>*, 3> colours{&picture.red, &picture.green, &picture.blue};
  with_colours = with_colours && !gray;
  if (with_colours) {
    for (Grid<float>* colour : colours) *colour = Grid<float>(spec.full_width, spec.full_height);
  }
  for_each_row(*input, path, [&](int row, const float* pixel) {
    for (int column = 0; column < spec.width; ++column, pixel += spec.nchannels) {
      const float alpha = channels.alpha >= 0 ? std::min(pixel[channels.alpha], 1.0F) : 1.0F;
      const auto& [r, g, b] = channels.light;
      for (const float code : {pixel[r], pixel[g], pixel[b], alpha}) {
        if (!std::isfinite(code) || code < 0) {
          throw InputError(name + " has a negative or not finite value at column " + std::to_string(left + column) + ", row " +
                           std::to_string(top + row) + "; light is never below zero");
        }
      }
      const int x = left + column;
      const int y = top + row;
      if (x < 0 || y < 0 || x >= spec.full_width || y >= spec.full_height) continue;
      picture.gray.at(x, y) = gray ? light(pixel[r], alpha)
                                   : 0.2126F * light(pixel[r], alpha) + 0.7152F * light(pixel[g], alpha) +
                                         0.0722F * light(pixel[b], alpha);
      if (!with_colours) continue;
      for (int k = 0; k < 3; ++k) colours[k]->at(x, y) = light(pixel[channels.light[k]], alpha);
    }
  });
  for (Grid<float>* grid : {&picture.gray, &picture.red, &picture.green, &picture.blue}) {
    if (!grid->empty()) *grid = upright(std::move(*grid), spec.get_int_attribute("Orientation", 1));
  }
  if (input->seek_subimage(1, 0))
    picture.warnings.push_back(name + " holds several pictures; the first is used");
  return picture;
}

Grid<float> read_float_image(const fs::path& path) {
  const auto input = open(path);
  const OIIO::ImageSpec& spec = input->spec();
  Grid<float> grid(spec.width, spec.height);
  for_each_row(*input, path, [&](int row, const float* pixel) {
    for (int column = 0; column < spec.width; ++column, pixel += spec.nchannels) grid.at(column, row) = pixel[0];
  });
  return grid;
}

void write_png8(const fs::path& path, const Grid<float>& linear_light) {
  std::vector<std::uint8_t> codes(linear_light.values.size());
  for (std::size_t i = 0; i < codes.size(); ++i) {
    codes[i] = static_cast<std::uint8_t>(std::lround(255 * linear_to_srgb(linear_light.values[i])));
  }
  write_pixels(path, linear_light.width, linear_light.height, 1, OIIO::TypeDesc::UINT8, OIIO::TypeDesc::UINT8, codes.data(), "sRGB");
}

void write_png8(const fs::path& path, const Grid<float>& red, const Grid<float>& green, const Grid<float>& blue,
                double dots_per_inch) {
  std::vector<std::uint8_t> codes(red.values.size() * 3);
  const Grid<float>* planes[] = {&red, &green, &blue};
  for (std::size_t i = 0; i < red.values.size(); ++i) {
    for (int c = 0; c < 3; ++c) {
      codes[3 * i + c] = static_cast<std::uint8_t>(std::lround(255 * linear_to_srgb(planes[c]->values[i])));
    }
  }
  write_pixels(path, red.width, red.height, 3, OIIO::TypeDesc::UINT8, OIIO::TypeDesc::UINT8, codes.data(), "sRGB", dots_per_inch);
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
