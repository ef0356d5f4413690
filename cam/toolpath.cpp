#include "cam/toolpath.h"

#include <bit>
#include <cstring>
#include <fstream>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill {

namespace {

static_assert(std::endian::native == std::endian::little, "the file is written as memory holds it");

constexpr char kMagic[8] = {'L', 'M', 'P', 'A', 'T', 'H', 'S', '\n'};
constexpr std::uint32_t kVersion = 2;

/// FNV-1a over the whole file but its last eight bytes: finds a flipped bit, no protection against intent.
std::uint64_t digest(std::string_view bytes) {
  std::uint64_t hash = 14695981039346656037ull;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ull;
  return hash;
}

class Writer {
 public:
  template <typename T>
  void put(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void put(const std::string& text) {
    put(static_cast<std::uint64_t>(text.size()));
    bytes_ += text;
  }
  [[nodiscard]] std::string& bytes() { return bytes_; }

 private:
  std::string bytes_;
};

class Reader {
 public:
  Reader(std::string_view bytes, std::string file) : bytes_(bytes), file_(std::move(file)) {}
  template <typename T>
  T get() {
    static_assert(std::is_trivially_copyable_v<T>);
    T value;
    std::memcpy(&value, take(sizeof value).data(), sizeof value);
    return value;
  }
  std::string text() { return std::string(take(count(1))); }
  /// A count of things of which each takes at least `each` bytes of what is left.
  std::uint64_t count(std::uint64_t each) {
    const auto n = get<std::uint64_t>();
    if (n > bytes_.size() / each) broken("a count is larger than the file");
    return n;
  }
  [[nodiscard]] bool done() const { return bytes_.empty(); }
  [[noreturn]] void broken(const std::string& why) const {
    throw InputError(file_ + ": not a whole tool path file (" + why + "); run 'lightmill cam' again");
  }

 private:
  std::string_view take(std::uint64_t n) {
    if (n > bytes_.size()) broken("it ends too early");
    const std::string_view taken = bytes_.substr(0, n);
    bytes_.remove_prefix(n);
    return taken;
  }
  std::string_view bytes_;
  std::string file_;
};

void put_pieces(Writer& out, const std::vector<ToolPiece>& pieces) {
  out.put(static_cast<std::uint64_t>(pieces.size()));
  for (const ToolPiece& piece : pieces) {
    out.put(piece.from_mm);
    out.put(piece.to_mm);
    out.put(piece.from_radius_mm);
    out.put(piece.to_radius_mm);
  }
}

std::vector<ToolPiece> get_pieces(Reader& in) {
  std::vector<ToolPiece> pieces(in.count(4 * sizeof(double)));
  for (ToolPiece& piece : pieces) {
    piece.from_mm = in.get<double>();
    piece.to_mm = in.get<double>();
    piece.from_radius_mm = in.get<double>();
    piece.to_radius_mm = in.get<double>();
  }
  return pieces;
}

void put_cutter(Writer& out, const Cutter& c) {
  out.put(c.name);
  out.put(static_cast<std::int32_t>(c.number));
  out.put(c.diameter_mm);
  out.put(c.corner_radius_mm);
  out.put(static_cast<std::int32_t>(c.edges));
  out.put(c.flute_length_mm);
  out.put(c.taper_rad);
  out.put(c.shank_diameter_mm);
  out.put(c.length_mm);
  out.put(static_cast<std::uint8_t>(c.centre_cutting));
  put_pieces(out, c.shank);
  put_pieces(out, c.holder);
  out.put(c.spindle_rpm);
  out.put(c.feed_per_tooth_mm);
  out.put(c.plunge_feed_mm_per_s);
  out.put(c.most_stepover_mm);
  out.put(c.slot_depth_mm);
  out.put(c.coolant);
  out.put(c.source);
}

Cutter get_cutter(Reader& in) {
  Cutter c;
  c.name = in.text();
  c.number = in.get<std::int32_t>();
  c.diameter_mm = in.get<double>();
  c.corner_radius_mm = in.get<double>();
  c.edges = in.get<std::int32_t>();
  c.flute_length_mm = in.get<double>();
  c.taper_rad = in.get<double>();
  c.shank_diameter_mm = in.get<double>();
  c.length_mm = in.get<double>();
  c.centre_cutting = in.get<std::uint8_t>() != 0;
  c.shank = get_pieces(in);
  c.holder = get_pieces(in);
  c.spindle_rpm = in.get<double>();
  c.feed_per_tooth_mm = in.get<double>();
  c.plunge_feed_mm_per_s = in.get<double>();
  c.most_stepover_mm = in.get<double>();
  c.slot_depth_mm = in.get<double>();
  c.coolant = in.text();
  c.source = in.text();
  return c;
}

constexpr std::uint64_t kMoveBytes = 7 * sizeof(double) + 1;

void put_move(Writer& out, const Move& m) {
  for (int k = 0; k < 3; ++k) out.put(m.pose.tip_mm[k]);
  for (int k = 0; k < 3; ++k) out.put(m.pose.axis[k]);
  out.put(m.feed_mm_per_s);
  out.put(static_cast<std::uint8_t>(m.kind));
}

Move get_move(Reader& in) {
  Move m;
  for (int k = 0; k < 3; ++k) m.pose.tip_mm[k] = in.get<double>();
  for (int k = 0; k < 3; ++k) m.pose.axis[k] = in.get<double>();
  m.feed_mm_per_s = in.get<double>();
  const auto kind = in.get<std::uint8_t>();
  if (kind > static_cast<std::uint8_t>(MoveKind::kCut)) in.broken("an unknown kind of move");
  m.kind = static_cast<MoveKind>(kind);
  return m;
}

}  // namespace

double ToolPath::length_mm() const {
  double length = 0;
  for (std::size_t i = 1; i < moves.size(); ++i) {
    length += (moves[i].pose.tip_mm - moves[i - 1].pose.tip_mm).norm();
  }
  return length;
}

double ToolPath::minutes(double rapid_mm_per_s) const {
  double seconds = 0;
  for (std::size_t i = 1; i < moves.size(); ++i) {
    const double speed = moves[i].kind == MoveKind::kRapid ? rapid_mm_per_s : moves[i].feed_mm_per_s;
    seconds += (moves[i].pose.tip_mm - moves[i - 1].pose.tip_mm).norm() / speed;
  }
  return seconds / 60;
}

void write_toolpaths(const std::filesystem::path& path, const std::vector<ToolPath>& passes) {
  Writer out;
  out.bytes().append(kMagic, sizeof kMagic);
  out.put(kVersion);
  out.put(static_cast<std::uint64_t>(passes.size()));
  for (const ToolPath& pass : passes) {
    out.put(pass.pass);
    put_cutter(out, pass.cutter);
    out.put(pass.spindle_rpm);
    out.put(pass.stepover_mm);
    out.put(pass.predicted_cusp_um);
    out.put(pass.above_limit_mm2);
    out.put(pass.clearance_z_mm);
    out.put(static_cast<std::uint64_t>(pass.moves.size()));
    for (const Move& move : pass.moves) put_move(out, move);
  }
  out.put(digest(out.bytes()));
  write_whole(path, out.bytes());
}

std::vector<ToolPath> read_toolpaths(const std::filesystem::path& path) {
  const std::string bytes = read_whole(path);
  Reader in(bytes, path.string());
  for (const char c : kMagic) {
    if (in.get<char>() != c) in.broken("it starts differently");
  }
  const auto version = in.get<std::uint32_t>();
  if (version != kVersion)
    in.broken("version " + std::to_string(version) + ", this program reads " + std::to_string(kVersion));
  std::uint64_t stored = 0;
  if (bytes.size() < sizeof kMagic + sizeof version + sizeof stored) in.broken("it ends too early");
  std::memcpy(&stored, bytes.data() + bytes.size() - sizeof stored, sizeof stored);
  if (stored != digest(std::string_view(bytes).substr(0, bytes.size() - sizeof stored)))
    in.broken("its checksum is wrong");
  std::vector<ToolPath> passes(in.count(1));
  for (ToolPath& pass : passes) {
    pass.pass = in.text();
    pass.cutter = get_cutter(in);
    pass.spindle_rpm = in.get<double>();
    pass.stepover_mm = in.get<double>();
    pass.predicted_cusp_um = in.get<double>();
    pass.above_limit_mm2 = in.get<double>();
    pass.clearance_z_mm = in.get<double>();
    pass.moves.resize(in.count(kMoveBytes));
    for (Move& move : pass.moves) move = get_move(in);
  }
  in.get<std::uint64_t>();
  if (!in.done()) in.broken("it goes on after its end");
  return passes;
}

}  // namespace lightmill
