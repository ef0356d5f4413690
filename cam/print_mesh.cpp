#include "cam/print_mesh.h"

#include <Eigen/Geometry>
#include <bit>
#include <cstdint>
#include <unordered_map>

#include "design/core/files.h"
#include "design/core/markup.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

static_assert(std::endian::native == std::endian::little);

template <typename T>
void put(std::string& out, T value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof value);
}

/// CRC-32 of ISO 3309, as ZIP wants it.
std::uint32_t crc32(const std::string& bytes) {
  std::uint32_t crc = 0xFFFFFFFFU;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

/// A ZIP archive of stored files; its times are the format's first, so that the same mesh gives the same bytes.
class StoredZip {
 public:
  void add(const std::string& name, const std::string& content) {
    const auto offset = static_cast<std::uint32_t>(bytes_.size());
    std::string fields;
    put<std::uint16_t>(fields, 20);      // version needed
    put<std::uint16_t>(fields, 0);       // flags
    put<std::uint16_t>(fields, 0);       // stored
    put<std::uint16_t>(fields, 0);       // time
    put<std::uint16_t>(fields, 0x21);    // 1 January 1980
    put<std::uint32_t>(fields, crc32(content));
    put<std::uint32_t>(fields, static_cast<std::uint32_t>(content.size()));
    put<std::uint32_t>(fields, static_cast<std::uint32_t>(content.size()));
    put<std::uint16_t>(fields, static_cast<std::uint16_t>(name.size()));
    put<std::uint16_t>(fields, 0);       // extra field
    put<std::uint32_t>(bytes_, 0x04034B50U);
    bytes_ += fields + name + content;
    put<std::uint32_t>(directory_, 0x02014B50U);
    put<std::uint16_t>(directory_, 20);  // made by
    directory_ += fields;
    put<std::uint16_t>(directory_, 0);   // comment
    put<std::uint16_t>(directory_, 0);   // disk
    put<std::uint16_t>(directory_, 0);   // internal attributes
    put<std::uint32_t>(directory_, 0);   // external attributes
    put<std::uint32_t>(directory_, offset);
    directory_ += name;
    ++count_;
  }
  [[nodiscard]] std::string bytes() const {
    std::string all = bytes_ + directory_;
    put<std::uint32_t>(all, 0x06054B50U);
    put<std::uint16_t>(all, 0);
    put<std::uint16_t>(all, 0);
    put<std::uint16_t>(all, count_);
    put<std::uint16_t>(all, count_);
    put<std::uint32_t>(all, static_cast<std::uint32_t>(directory_.size()));
    put<std::uint32_t>(all, static_cast<std::uint32_t>(bytes_.size()));
    put<std::uint16_t>(all, 0);
    return all;
  }

 private:
  std::string bytes_, directory_;
  std::uint16_t count_ = 0;
};

}  // namespace

bool is_watertight(const PrintMesh& mesh) {
  std::unordered_map<std::uint64_t, int> runs;
  const auto key = [](int a, int b) { return static_cast<std::uint64_t>(static_cast<std::uint32_t>(a)) << 32 | static_cast<std::uint32_t>(b); };
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      if (++runs[key(t[k], t[(k + 1) % 3])] > 1) return false;
    }
  }
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      if (!runs.contains(key(t[(k + 1) % 3], t[k]))) return false;
    }
  }
  return !mesh.triangles.empty();
}

double enclosed_volume_mm3(const PrintMesh& mesh) {
  double sixfold = 0;
  for (const auto& t : mesh.triangles) sixfold += mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]]));
  return sixfold / 6;
}

void write_stl(const std::filesystem::path& path, const PrintMesh& mesh) {
  std::string bytes(80, ' ');
  put(bytes, static_cast<std::uint32_t>(mesh.triangles.size()));
  const auto put3 = [&](const Vec3& v) {
    for (int k = 0; k < 3; ++k) put(bytes, static_cast<float>(v[k]));
  };
  for (const auto& t : mesh.triangles) {
    const Vec3 &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    put3((b - a).cross(c - a).stableNormalized());
    put3(a);
    put3(b);
    put3(c);
    put<std::uint16_t>(bytes, 0);
  }
  write_whole(path, bytes);
}

void write_3mf(const std::filesystem::path& path, const PrintMesh& mesh, const std::string& title) {
  StoredZip zip;
  zip.add("[Content_Types].xml",
          "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">"
          "<Default Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/>"
          "<Default Extension=\"model\" ContentType=\"application/vnd.ms-package.3dmanufacturing-3dmodel+xml\"/></Types>\n");
  zip.add("_rels/.rels",
          "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">"
          "<Relationship Target=\"/3D/3dmodel.model\" Id=\"rel0\" Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/></Relationships>\n");
  std::string model =
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model unit=\"millimeter\" xml:lang=\"en-US\" "
      "xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\">\n<metadata name=\"Title\">" +
      escaped(title) + "</metadata>\n<resources><object id=\"1\" type=\"model\"><mesh>\n<vertices>\n";
  constexpr int kDecimals = 5;  // of mm
  for (const Vec3& v : mesh.vertices) {
    model += "<vertex x=\"" + fixed(v.x(), kDecimals) + "\" y=\"" + fixed(v.y(), kDecimals) + "\" z=\"" +
             fixed(v.z(), kDecimals) + "\"/>\n";
  }
  model += "</vertices>\n<triangles>\n";
  for (const auto& t : mesh.triangles) {
    model += "<triangle v1=\"" + std::to_string(t[0]) + "\" v2=\"" + std::to_string(t[1]) + "\" v3=\"" + std::to_string(t[2]) + "\"/>\n";
  }
  model += "</triangles>\n</mesh></object></resources>\n<build><item objectid=\"1\"/></build>\n</model>\n";
  zip.add("3D/3dmodel.model", model);
  write_whole(path, zip.bytes());
}

}  // namespace lightmill
