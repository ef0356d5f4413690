#include "design/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <sstream>
#include <string>
#include <string_view>
#include <unordered_map>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill {

namespace {

static_assert(std::endian::native == std::endian::little, "PLY files are written in the machine's byte order");

/// Angle at `corner` between the directions to `a` and `b`; atan2 keeps slivers exact.
double corner_angle(const Vec3& corner, const Vec3& a, const Vec3& b) {
  const Vec3 u = a - corner;
  const Vec3 v = b - corner;
  return std::atan2(u.cross(v).norm(), u.dot(v));
}

}  // namespace

std::vector<Vec3> angle_weighted_normals(const std::vector<Vec3>& vertices,
                                         const std::vector<std::array<int, 3>>& triangles) {
  std::vector<Vec3> normals(vertices.size(), Vec3::Zero());
  for (const auto& t : triangles) {
    const Vec3& a = vertices[t[0]];
    const Vec3& b = vertices[t[1]];
    const Vec3& c = vertices[t[2]];
    const Vec3 area_vector = (b - a).cross(c - a);
    const double length = area_vector.norm();
    if (length == 0) continue;  // a triangle without area has no normal to give
    const Vec3 normal = area_vector / length;
    normals[t[0]] += corner_angle(a, b, c) * normal;
    normals[t[1]] += corner_angle(b, c, a) * normal;
    normals[t[2]] += corner_angle(c, a, b) * normal;
  }
  for (Vec3& n : normals) {
    const double length = n.norm();
    n = length > 0 ? Vec3(n / length) : Vec3::UnitZ();
  }
  return normals;
}

std::vector<bool> border_vertices(const SurfaceMesh& mesh) {
  std::vector<std::pair<int, int>> edges;
  edges.reserve(mesh.triangles.size() * 3);
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) edges.emplace_back(std::minmax(t[k], t[(k + 1) % 3]));
  }
  std::sort(edges.begin(), edges.end());
  std::vector<bool> border(mesh.vertices.size(), false);
  for (std::size_t first = 0; first < edges.size();) {
    std::size_t last = first + 1;
    while (last < edges.size() && edges[last] == edges[first]) ++last;
    if (last - first == 1) border[edges[first].first] = border[edges[first].second] = true;
    first = last;
  }
  return border;
}

int count_inverted(const SurfaceMesh& mesh) {
  int inverted = 0;
  for (const auto& t : mesh.triangles) {
    const Vec3 ab = mesh.vertices[t[1]] - mesh.vertices[t[0]];
    const Vec3 ac = mesh.vertices[t[2]] - mesh.vertices[t[0]];
    if (!(ab.x() * ac.y() - ab.y() * ac.x() > 0)) ++inverted;
  }
  return inverted;
}

void write_ply(const std::filesystem::path& path, const SurfaceMesh& mesh) {
  std::string content =
      "ply\nformat binary_little_endian 1.0\ncomment lightmill optical surface, mm, z towards the receiver\n"
      "element vertex " +
      std::to_string(mesh.vertices.size()) +
      "\nproperty double x\nproperty double y\nproperty double z\n"
      "property double nx\nproperty double ny\nproperty double nz\n"
      "element face " +
      std::to_string(mesh.triangles.size()) + "\nproperty list uchar int vertex_indices\nend_header\n";
  const std::size_t header = content.size();
  constexpr std::size_t kVertexBytes = 6 * sizeof(double);
  constexpr std::size_t kFaceBytes = 1 + 3 * sizeof(std::int32_t);
  content.resize(header + mesh.vertices.size() * kVertexBytes + mesh.triangles.size() * kFaceBytes);
  char* out = content.data() + header;
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v, out += kVertexBytes) {
    std::memcpy(out, mesh.vertices[v].data(), 3 * sizeof(double));
    std::memcpy(out + 3 * sizeof(double), mesh.normals[v].data(), 3 * sizeof(double));
  }
  for (const auto& t : mesh.triangles) {
    const std::int32_t corners[3] = {t[0], t[1], t[2]};
    *out++ = 3;
    std::memcpy(out, corners, sizeof corners);
    out += sizeof corners;
  }
  write_whole(path, content);
}

namespace {

/// The k-th corner of a polygon that is cut into a fan of triangles around its first.
void add_to_fan(SurfaceMesh& mesh, std::array<int, 3>& fan, std::size_t k, int corner) {
  if (k == 0) fan[0] = corner;
  if (k >= 2) mesh.triangles.push_back({fan[0], fan[2], corner});
  fan[2] = corner;
}

enum class PlyFormat { kAscii, kLittle, kBig };

struct PlyType {
  int bytes = 0;
  bool is_float = false;
  bool is_signed = false;
};

struct PlyProperty {
  std::string name;
  PlyType type;
  bool is_list = false;
  PlyType count_type;
};

struct PlyElement {
  std::string name;
  std::size_t count = 0;
  std::vector<PlyProperty> properties;
};

class PlyReader {
 public:
  PlyReader(const std::filesystem::path& path, const std::string& content) : path_(path), content_(content) {}

  SurfaceMesh read() {
    read_header();
    SurfaceMesh mesh;
    bool has_normals = false;
    for (const PlyElement& element : elements_) {
      if (element.name == "vertex") {
        has_normals = read_vertices(element, mesh);
      } else if (element.name == "face") {
        read_faces(element, mesh);
      } else {
        skip(element);
      }
    }
    if (mesh.vertices.empty()) fail("it has no vertices");
    if (mesh.triangles.empty()) fail("it has no triangles");
    for (const auto& t : mesh.triangles) {
      for (int corner : t) {
        if (corner < 0 || static_cast<std::size_t>(corner) >= mesh.vertices.size()) {
          fail("a face names vertex " + std::to_string(corner) + " of " + std::to_string(mesh.vertices.size()));
        }
      }
    }
    if (!has_normals) mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
    return mesh;
  }
  [[nodiscard]] const std::vector<double>& intensities() const { return intensities_; }

 private:
  std::vector<double> intensities_;

  [[noreturn]] void fail(const std::string& reason) const {
    throw InputError(path_.string() + ": not a readable PLY surface: " + reason);
  }

  std::string next_line() {
    const std::size_t end = content_.find('\n', position_);
    if (end == std::string::npos) fail("the header does not end");
    std::string line = content_.substr(position_, end - position_);
    position_ = end + 1;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    return line;
  }

  PlyType type_of(const std::string& name) const {
    static const std::unordered_map<std::string, PlyType> types = {
        {"char", {1, false, true}},    {"int8", {1, false, true}},    {"uchar", {1, false, false}},
        {"uint8", {1, false, false}},  {"short", {2, false, true}},   {"int16", {2, false, true}},
        {"ushort", {2, false, false}}, {"uint16", {2, false, false}}, {"int", {4, false, true}},
        {"int32", {4, false, true}},   {"uint", {4, false, false}},   {"uint32", {4, false, false}},
        {"float", {4, true, true}},    {"float32", {4, true, true}},  {"double", {8, true, true}},
        {"float64", {8, true, true}}};
    const auto found = types.find(name);
    if (found == types.end()) fail("unknown property type '" + name + "'");
    return found->second;
  }

  void read_header() {
    if (next_line() != "ply") fail("it does not begin with 'ply'");
    bool has_format = false;
    for (std::string line = next_line(); line != "end_header"; line = next_line()) {
      std::istringstream words(line);
      std::string word;
      words >> word;
      if (word == "format") {
        std::string format;
        words >> format;
        has_format = true;
        if (format == "ascii") {
          format_ = PlyFormat::kAscii;
        } else if (format == "binary_little_endian") {
          format_ = PlyFormat::kLittle;
        } else if (format == "binary_big_endian") {
          format_ = PlyFormat::kBig;
        } else {
          fail("unknown format '" + format + "'");
        }
      } else if (word == "element") {
        PlyElement element;
        if (!(words >> element.name >> element.count)) fail("bad line '" + line + "'");
        elements_.push_back(element);
      } else if (word == "property") {
        if (elements_.empty()) fail("a property before any element");
        PlyProperty property;
        std::string type;
        words >> type;
        if (type == "list") {
          std::string count_type;
          words >> count_type >> type;
          property.is_list = true;
          property.count_type = type_of(count_type);
        }
        property.type = type_of(type);
        if (!(words >> property.name)) fail("bad line '" + line + "'");
        elements_.back().properties.push_back(property);
      }  // comment, obj_info: nothing to learn
    }
    if (!has_format) fail("the header names no format");
  }

  double next_value(const PlyType& type) {
    if (format_ == PlyFormat::kAscii) {
      while (position_ < content_.size() && std::isspace(static_cast<unsigned char>(content_[position_]))) ++position_;
      double value = 0;
      const auto [end, error] = std::from_chars(content_.data() + position_, content_.data() + content_.size(), value);
      if (error != std::errc()) fail("a number is missing or malformed");
      position_ = static_cast<std::size_t>(end - content_.data());
      return value;
    }
    if (position_ + type.bytes > content_.size()) fail("it ends too early");
    unsigned char bytes[8] = {};
    std::memcpy(bytes, content_.data() + position_, type.bytes);
    position_ += type.bytes;
    if (format_ == PlyFormat::kBig) std::reverse(bytes, bytes + type.bytes);
    if (type.is_float) {
      if (type.bytes == 4) return std::bit_cast<float>(std::array{bytes[0], bytes[1], bytes[2], bytes[3]});
      double value;
      std::memcpy(&value, bytes, 8);
      return value;
    }
    std::uint64_t raw = 0;
    std::memcpy(&raw, bytes, 8);
    if (!type.is_signed) return static_cast<double>(raw);
    const int shift = 64 - 8 * type.bytes;
    return static_cast<double>(static_cast<std::int64_t>(raw << shift) >> shift);
  }

  std::size_t next_count(const PlyType& type) {
    const double count = next_value(type);
    if (!(count >= 0 && count <= 1e6)) fail("a list has an impossible length");
    return static_cast<std::size_t>(count);
  }

  /// Every item takes at least a byte: a count beyond the file's size is a lie that must not be believed with memory.
  void check_count(const PlyElement& element) const {
    if (element.count > content_.size()) fail("it announces more items than it can hold");
  }

  void skip(const PlyElement& element) {
    check_count(element);
    for (std::size_t i = 0; i < element.count; ++i) {
      for (const PlyProperty& property : element.properties) {
        const std::size_t values = property.is_list ? next_count(property.count_type) : 1;
        for (std::size_t k = 0; k < values; ++k) next_value(property.type);
      }
    }
  }

  bool read_vertices(const PlyElement& element, SurfaceMesh& mesh) {
    check_count(element);
    const char* names[7] = {"x", "y", "z", "nx", "ny", "nz", "intensity"};
    bool present[7] = {};
    std::vector<int> role(element.properties.size(), -1);
    for (std::size_t p = 0; p < element.properties.size(); ++p) {
      for (int k = 0; k < 7; ++k) {
        if (element.properties[p].name == names[k] && !element.properties[p].is_list) {
          role[p] = k;
          present[k] = true;
        }
      }
    }
    if (!(present[0] && present[1] && present[2])) fail("its vertices lack x, y or z");
    const bool has_normals = present[3] && present[4] && present[5];
    mesh.vertices.resize(element.count);
    if (has_normals) mesh.normals.resize(element.count);
    for (std::size_t v = 0; v < element.count; ++v) {
      double values[7] = {};
      for (std::size_t p = 0; p < element.properties.size(); ++p) {
        const PlyProperty& property = element.properties[p];
        const std::size_t count = property.is_list ? next_count(property.count_type) : 1;
        for (std::size_t k = 0; k < count; ++k) {
          const double value = next_value(property.type);
          if (role[p] >= 0) values[role[p]] = value;
        }
      }
      for (double value : values) {
        if (!std::isfinite(value)) fail("vertex " + std::to_string(v) + " is not finite");
      }
      mesh.vertices[v] = {values[0], values[1], values[2]};
      if (present[6]) intensities_.push_back(values[6]);
      if (has_normals) {
        const Vec3 normal(values[3], values[4], values[5]);
        const double length = normal.norm();
        constexpr double kRounded = 1e-9;  // what is unit in double stays as it is, to the bit
        mesh.normals[v] = !(length > 0)                     ? Vec3(0, 0, 1)
                          : std::abs(length - 1) < kRounded ? normal
                                                            : Vec3(normal / length);
      }
    }
    return has_normals;
  }

  void read_faces(const PlyElement& element, SurfaceMesh& mesh) {
    check_count(element);
    mesh.triangles.reserve(element.count);
    bool found = false;
    for (std::size_t f = 0; f < element.count; ++f) {
      for (const PlyProperty& property : element.properties) {
        const bool is_face = property.is_list && (property.name == "vertex_indices" || property.name == "vertex_index");
        const std::size_t count = property.is_list ? next_count(property.count_type) : 1;
        if (is_face && count < 3) {
          fail("face " + std::to_string(f) + " has " + std::to_string(count) + " corners, a surface needs at least 3");
        }
        std::array<int, 3> corners{};
        for (std::size_t k = 0; k < count; ++k) {
          const double value = next_value(property.type);
          if (!is_face) continue;
          const int corner = std::abs(value) < 2e9 ? static_cast<int>(value) : -1;
          add_to_fan(mesh, corners, k, corner);
        }
        found = found || is_face;
      }
    }
    if (element.count > 0 && !found) fail("its faces lack vertex_indices");
  }

  const std::filesystem::path& path_;
  const std::string& content_;
  std::size_t position_ = 0;
  PlyFormat format_ = PlyFormat::kAscii;
  std::vector<PlyElement> elements_;
};

}  // namespace

SurfaceMesh read_ply(const std::filesystem::path& path) {
  const std::string content = read_whole(path);
  return PlyReader(path, content).read();
}

namespace {

/// Numbers and names of one line of text, separated by blanks.
std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  std::size_t at = 0;
  while (true) {
    at = line.find_first_not_of(" \t\r", at);
    if (at == std::string_view::npos) return words;
    const std::size_t end = std::min(line.find_first_of(" \t\r", at), line.size());
    words.push_back(line.substr(at, end - at));
    at = end;
  }
}

/// Calls visit(words, line number) for every line that is not empty.
void each_line(std::string_view content, const auto& visit) {
  int number = 0;
  for (std::size_t at = 0; at < content.size();) {
    const std::size_t end = std::min(content.find('\n', at), content.size());
    ++number;
    const auto words = words_of(content.substr(at, end - at));
    if (!words.empty()) visit(words, number);
    at = end + 1;
  }
}

template <typename T>
bool parse(std::string_view text, T& value) {
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

bool parse_place(const std::vector<std::string_view>& words, Vec3& place) {
  if (words.size() < 4) return false;
  for (int axis = 0; axis < 3; ++axis) {
    if (!parse(words[axis + 1], place[axis]) || !std::isfinite(place[axis])) return false;
  }
  return true;
}

[[noreturn]] void refuse(const std::filesystem::path& path, const std::string& where, const std::string& reason) {
  throw InputError(path.string() + ": " + where + ": " + reason);
}

SurfaceMesh read_obj(const std::filesystem::path& path, const std::string& content) {
  SurfaceMesh mesh;
  each_line(content, [&](const std::vector<std::string_view>& words, int number) {
    const std::string where = "line " + std::to_string(number);
    if (words[0] == "v") {
      Vec3 place;
      if (!parse_place(words, place)) refuse(path, where, "a vertex needs three finite numbers after 'v'");
      mesh.vertices.push_back(place);
    } else if (words[0] == "f") {
      if (words.size() < 4) refuse(path, where, "a face needs at least three vertices");
      std::array<int, 3> fan{};
      const long known = static_cast<long>(mesh.vertices.size());
      for (std::size_t k = 1; k < words.size(); ++k) {
        // vertex/texture/normal; below 0 counts back from the last vertex so far.
        const std::string_view index = words[k].substr(0, words[k].find('/'));
        long vertex = 0;
        if (!parse(index, vertex) || vertex == 0 || vertex > known || vertex < -known) {
          refuse(path, where, "the face names vertex '" + std::string(index) + "' of " + std::to_string(known) + " given so far");
        }
        add_to_fan(mesh, fan, k - 1, static_cast<int>(vertex > 0 ? vertex - 1 : known + vertex));
      }
    }
  });
  return mesh;
}

/// Gives every place one vertex.
class Welder {
 public:
  explicit Welder(SurfaceMesh& mesh) : mesh_(mesh) {}
  int vertex(const Vec3& place) {
    const Vec3 clean = place + Vec3::Zero();  // -0 becomes 0
    const auto [found, fresh] = known_.try_emplace({clean.x(), clean.y(), clean.z()}, static_cast<int>(mesh_.vertices.size()));
    if (fresh) mesh_.vertices.push_back(clean);
    return found->second;
  }

 private:
  struct Hash {
    std::size_t operator()(const std::array<double, 3>& p) const {
      std::uint64_t sum = 0;
      for (const double value : p) sum = (sum ^ std::bit_cast<std::uint64_t>(value)) * 0x9E3779B97F4A7C15ull, sum ^= sum >> 29;
      return static_cast<std::size_t>(sum);
    }
  };
  SurfaceMesh& mesh_;
  std::unordered_map<std::array<double, 3>, int, Hash> known_;
};

SurfaceMesh read_stl(const std::filesystem::path& path, const std::string& content) {
  constexpr std::size_t kHeader = 84;
  constexpr std::size_t kFacet = 50;
  SurfaceMesh mesh;
  Welder welder(mesh);
  std::uint32_t count = 0;
  if (content.size() >= kHeader) std::memcpy(&count, content.data() + 80, 4);
  // Binary files may begin with "solid" too: the size decides.
  const bool binary = content.size() >= kHeader && content.size() == kHeader + kFacet * static_cast<std::size_t>(count);
  if (!binary && (content.compare(0, 5, "solid") != 0 || content.find('\0') != std::string::npos)) {
    refuse(path, "byte 80",
           "neither text ('solid ...') nor binary STL: " + std::to_string(count) + " triangles announced, " +
               std::to_string(content.size()) + " bytes there");
  }
  if (binary) {
    for (std::uint32_t f = 0; f < count; ++f) {
      const std::size_t at = kHeader + kFacet * f;
      float values[12];
      std::memcpy(values, content.data() + at, sizeof values);
      std::array<int, 3> corners{};
      for (int k = 0; k < 3; ++k) {
        const Vec3 place(values[3 + 3 * k], values[4 + 3 * k], values[5 + 3 * k]);
        if (!place.allFinite()) refuse(path, "byte " + std::to_string(at), "a corner is not finite");
        corners[k] = welder.vertex(place);
      }
      mesh.triangles.push_back(corners);
    }
    return mesh;
  }
  std::vector<int> loop;
  each_line(content, [&](const std::vector<std::string_view>& words, int number) {
    const std::string where = "line " + std::to_string(number);
    if (words[0] == "vertex") {
      Vec3 place;
      if (!parse_place(words, place)) refuse(path, where, "a corner needs three finite numbers after 'vertex'");
      loop.push_back(welder.vertex(place));
    } else if (words[0] == "endloop") {
      if (loop.size() != 3) refuse(path, where, "a facet has " + std::to_string(loop.size()) + " corners, must be 3");
      mesh.triangles.push_back({loop[0], loop[1], loop[2]});
      loop.clear();
    }
  });
  if (!loop.empty()) refuse(path, "end of file", "the last facet does not end");
  return mesh;
}

}  // namespace

SurfaceMesh read_surface(const std::filesystem::path& path) {
  std::string kind = path.extension().string();
  std::transform(kind.begin(), kind.end(), kind.begin(), [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  if (kind == ".ply") return read_ply(path);
  if (kind != ".obj" && kind != ".stl") throw InputError(path.string() + ": must be a .ply, .obj or .stl file");
  const std::string content = read_whole(path);
  SurfaceMesh mesh = kind == ".obj" ? read_obj(path, content) : read_stl(path, content);
  if (mesh.triangles.empty()) throw InputError(path.string() + ": it has no triangles");
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  return mesh;
}

OpticalPart optical_part(const SurfaceMesh& mesh) {
  constexpr double kWall = 1e-3;  // a normal that rises by less belongs to a wall
  OpticalPart part;
  for (const auto& t : mesh.triangles) {
    const Vec3 area = (mesh.vertices[t[1]] - mesh.vertices[t[0]]).cross(mesh.vertices[t[2]] - mesh.vertices[t[0]]);
    if (area.z() > kWall * area.norm()) {
      part.mesh.triangles.push_back(t);
    } else {
      ++part.walls_and_bottom;
    }
  }
  if (part.mesh.triangles.empty()) throw InputError("the surface has no triangle that faces +Z, where the light leaves");
  if (part.walls_and_bottom == 0) {
    part.mesh = mesh;
    return part;
  }
  std::vector<int> number(mesh.vertices.size(), -1);
  for (auto& t : part.mesh.triangles) {
    for (int& v : t) {
      if (number[v] < 0) {
        number[v] = static_cast<int>(part.mesh.vertices.size());
        part.mesh.vertices.push_back(mesh.vertices[v]);
      }
      v = number[v];
    }
  }
  // Normals at the rim must not lean towards the walls.
  part.mesh.normals = angle_weighted_normals(part.mesh.vertices, part.mesh.triangles);
  return part;
}

IntensityMesh read_intensity_ply(const std::filesystem::path& path) {
  const std::string content = read_whole(path);
  PlyReader reader(path, content);
  IntensityMesh result;
  result.mesh = reader.read();
  result.intensities = reader.intensities();
  return result;
}

}  // namespace lightmill
