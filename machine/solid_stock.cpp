#include "machine/solid_stock.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <optional>
#include <string>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/parallel.h"
#include "design/core/text.h"
#include "machine/detail/swept_body.h"

namespace lightmill {

namespace {

constexpr double kMostRays = 1e8;      ///< 1.2 GB
constexpr std::size_t kBatch = 1024;   ///< bodies that are collected before they are applied
constexpr std::size_t kRowBlock = 8;   ///< rows that a thread takes at once
/// Longer moves are cut so: the box around a slanting one holds much that it does not touch.
constexpr double kLongestBody_mm = 4;
/// Moves are swept as one while no vertex between leaves the straight way by more.
constexpr double kStraight_mm = 2e-4;
constexpr std::size_t kMostInRun = 64;
constexpr double kSameAxis = 1e-9;

double distance_to_way(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 way = b - a;
  const double length2 = way.squaredNorm();
  const double share = length2 > 0 ? std::clamp((p - a).dot(way) / length2, 0.0, 1.0) : 0;
  return (a + share * way - p).norm();
}

/// What of the solid a body may meet.
struct Reach {
  std::array<SolidStock::Cells, 3> cells;
  std::vector<Box2> below;  ///< by rows of z: what of the body is no higher than their cells
};

}  // namespace

struct SolidStock::Collected {
  std::optional<Tool> tool;
  std::vector<SweptBody> bodies;
  std::vector<ToolPose> run;  ///< moves that go straight on, from the first pose to the last

  /// Takes what the bodies cover off the rays of some rows.
  void cut_rows(const SolidStock& solid, int along, std::span<const Reach> reaches, int begin, int end, RayBundle& bundle) const;
};

SolidStock::~SolidStock() = default;
SolidStock::SolidStock(SolidStock&&) noexcept = default;
SolidStock& SolidStock::operator=(SolidStock&&) noexcept = default;

SolidStock::SolidStock(const Blank& blank, double pitch_mm) : blank_(blank), collected_(std::make_unique<Collected>()) {
  if (!(pitch_mm > 0)) throw InputError("dry_run.solid_pitch_um must be above 0, not " + compact(pitch_mm * 1000, 3));
  const Vec3 size(blank.size_mm.x(), blank.size_mm.y(), blank.height_mm);
  if (!(size.minCoeff() > 0)) throw InputError("the blank must have a size and a height above 0");
  low_ = Vec3(-size.x() / 2, -size.y() / 2, 0);
  const Vec3 counts = (size / pitch_mm - Vec3::Constant(1e-6)).array().ceil().max(1.0);
  const double rays = counts.x() * counts.y() + counts.x() * counts.z() + counts.y() * counts.z();
  if (!(rays <= kMostRays)) {
    throw InputError("a pitch of " + compact(pitch_mm * 1000, 3) + " um makes " + compact(rays / 1e6, 0) +
                     " million rays through this blank; ask for a coarser dry_run.solid_pitch_um");
  }
  for (int axis = 0; axis < 3; ++axis) count_[axis] = static_cast<int>(counts[axis]);
  pitch_ = size.cwiseQuotient(counts);
  for (int along = 0; along < 3; ++along) {
    rays_[along] = RayBundle(count_[kColumnAxis[along]], count_[kRowAxis[along]],
                             {static_cast<float>(low_[along]), static_cast<float>(low_[along] + size[along])});
  }
  tops_ = Grid<float>((count_[0] + kTile - 1) / kTile, (count_[1] + kTile - 1) / kTile, static_cast<float>(blank.height_mm));
}

void SolidStock::set_cutter(const Cutter& cutter) {
  end_run();
  collected_->tool.emplace(cutter);
}

void SolidStock::cut(const ToolPose& from, const ToolPose& to) {
  if (!collected_->tool) throw InputError("a cut before any cutter is in the spindle");
  std::vector<ToolPose>& run = collected_->run;
  const auto goes_on = [&] {
    if (run.size() < 2 || run.size() > kMostInRun) return false;
    if ((run.back().tip_mm - from.tip_mm).norm() > 1e-9 || (to.tip_mm - run.front().tip_mm).norm() > kLongestBody_mm) return false;
    for (const ToolPose* pose : {&from, &to}) {
      if ((pose->axis - run.front().axis).norm() > kSameAxis) return false;
    }
    return std::all_of(run.begin() + 1, run.end(), [&](const ToolPose& pose) {
      return distance_to_way(pose.tip_mm, run.front().tip_mm, to.tip_mm) <= kStraight_mm;
    });
  };
  if (!goes_on()) {
    end_run();
    run = {from};
  }
  run.push_back(to);
}

void SolidStock::end_run() {
  std::vector<ToolPose>& run = collected_->run;
  if (run.size() < 2) return;
  const ToolPose from = run.front(), to = run.back();
  run.clear();
  const int count = std::max(1, static_cast<int>(std::ceil((to.tip_mm - from.tip_mm).norm() / kLongestBody_mm)));
  const auto at = [&](int k) {
    const double share = static_cast<double>(k) / count;
    return ToolPose{from.tip_mm + share * (to.tip_mm - from.tip_mm), (from.axis + share * (to.axis - from.axis)).normalized()};
  };
  for (int k = 0; k < count; ++k) {
    SweptBody body(*collected_->tool, at(k), at(k + 1));
    if (body.low().z() >= highest({body.low().head<2>(), body.high().head<2>()})) continue;
    collected_->bodies.push_back(body);
  }
  if (collected_->bodies.size() >= kBatch) apply();
}

void SolidStock::flush() {
  end_run();
  apply();
}

SolidStock::Cells SolidStock::cells(int axis, double low, double high) const {
  const auto cell = [&](double place) { return (place - low_[axis]) / pitch_[axis] - 0.5; };
  return {static_cast<int>(std::clamp(std::ceil(cell(low)), 0.0, static_cast<double>(count_[axis]))),
          static_cast<int>(std::clamp(std::floor(cell(high)), -1.0, count_[axis] - 1.0))};
}

void SolidStock::Collected::cut_rows(const SolidStock& solid, int along, std::span<const Reach> reaches, int begin, int end,
                                     RayBundle& bundle) const {
  const int column_axis = kColumnAxis[along], row_axis = kRowAxis[along];
  Vec3 place = Vec3::Zero();
  for (std::size_t k = 0; k < bodies.size(); ++k) {
    const SweptBody& body = bodies[k];
    const Reach& reach = reaches[k];
    const Cells rows = reach.cells[row_axis];
    Cells columns = reach.cells[column_axis];
    Span box{static_cast<float>(body.low()[along]), static_cast<float>(body.high()[along])};
    for (int row = std::max(rows.from, begin); row <= std::min(rows.to, end - 1); ++row) {
      place[row_axis] = solid.place_mm(row_axis, row);
      if (row_axis == 2) {
        const Box2& below = reach.below[row - rows.from];
        columns = solid.cells(column_axis, below.min[column_axis], below.max[column_axis]);
        box = {static_cast<float>(below.min[along]), static_cast<float>(below.max[along])};
      }
      for (int column = columns.from; column <= columns.to; ++column) {
        const auto spans = bundle.at(column, row);
        if (std::none_of(spans.begin(), spans.end(), [&](const Span& span) { return span.meets(box); })) continue;
        place[column_axis] = solid.place_mm(column_axis, column);
        if (along == 2 && !reach.below.empty()) {
          // What of the body is below the ray's top may be elsewhere.
          const Cells levels = reach.cells[2];
          const int level = static_cast<int>(std::floor(spans.back().to / solid.pitch_mm().z()));
          if (level < levels.to && !reach.below[std::max(level, levels.from) - levels.from].contains(place.head<2>())) continue;
        }
        const Chord chord = body.chord(along, place);
        if (!chord.empty()) bundle.subtract(column, row, {static_cast<float>(chord.from), static_cast<float>(chord.to)});
      }
    }
  }
}

void SolidStock::apply() {
  const std::vector<SweptBody>& bodies = collected_->bodies;
  if (bodies.empty()) return;
  std::vector<Reach> reaches(bodies.size());
  Box2 changed;
  for (std::size_t k = 0; k < bodies.size(); ++k) {
    const Vec3 &low = bodies[k].low(), &high = bodies[k].high();
    const Box2 above{low.head<2>(), high.head<2>()};
    changed.include(above.min);
    changed.include(above.max);
    // Over the highest material there is nothing to cut.
    const Cells levels = cells(2, low.z(), std::min(high.z(), highest(above)));
    reaches[k].cells = {cells(0, low.x(), high.x()), cells(1, low.y(), high.y()), levels};
    for (int level = levels.from; level <= levels.to; ++level) reaches[k].below.push_back(bodies[k].below(place_mm(2, level) + pitch_.z() / 2));
  }
  for (int along = 0; along < 3; ++along) {
    parallel_blocks(rays_[along].rows(), kRowBlock, [&](std::size_t begin, std::size_t end) {
      collected_->cut_rows(*this, along, reaches, static_cast<int>(begin), static_cast<int>(end), rays_[along]);
    });
  }
  collected_->bodies.clear();
  refresh_tops(changed);
}

void SolidStock::refresh_tops(const Box2& changed) {
  const Cells columns = cells(0, changed.min.x(), changed.max.x()), rows = cells(1, changed.min.y(), changed.max.y());
  if (columns.empty() || rows.empty()) return;
  parallel_blocks(rows.to / kTile - rows.from / kTile + 1, 1, [&](std::size_t begin, std::size_t end) {
    for (int tj = rows.from / kTile + static_cast<int>(begin); tj < rows.from / kTile + static_cast<int>(end); ++tj) {
      for (int ti = columns.from / kTile; ti <= columns.to / kTile; ++ti) {
        float most = -std::numeric_limits<float>::infinity();
        for (int j = tj * kTile; j < std::min((tj + 1) * kTile, count_[1]); ++j) {
          for (int i = ti * kTile; i < std::min((ti + 1) * kTile, count_[0]); ++i) {
            const auto spans = rays_[2].at(i, j);
            if (!spans.empty()) most = std::max(most, spans.back().to);
          }
        }
        tops_.at(ti, tj) = most;
      }
    }
  });
}

double SolidStock::highest(const Box2& rectangle) const {
  const Cells columns = cells(0, rectangle.min.x(), rectangle.max.x()), rows = cells(1, rectangle.min.y(), rectangle.max.y());
  float most = -std::numeric_limits<float>::infinity();
  if (columns.empty() || rows.empty()) return most;
  for (int tj = rows.from / kTile; tj <= rows.to / kTile; ++tj) {
    for (int ti = columns.from / kTile; ti <= columns.to / kTile; ++ti) most = std::max(most, tops_.at(ti, tj));
  }
  return most;
}

double SolidStock::volume_mm3() const {
  double volume = 0;
  for (int along = 0; along < 3; ++along) {
    volume += rays_[along].length_mm() * pitch_[kColumnAxis[along]] * pitch_[kRowAxis[along]] / 3;
  }
  return volume;
}

std::size_t SolidStock::bytes() const {
  std::size_t bytes = tops_.values.capacity() * sizeof(float) + collected_->bodies.capacity() * sizeof(SweptBody);
  for (const RayBundle& bundle : rays_) bytes += bundle.bytes();
  return bytes;
}

std::vector<SolidStock::Piece> SolidStock::pieces(double least_bridge_mm) const {
  // Spans are numbered ray by ray; each set of touching ones is a tree whose root is its least number.
  const RayBundle& bundle = rays_[2];
  Grid<std::uint32_t> first(count_[0], count_[1]);
  std::uint32_t spans = 0;
  for (int j = 0; j < count_[1]; ++j) {
    for (int i = 0; i < count_[0]; ++i) {
      first.at(i, j) = spans;
      spans += static_cast<std::uint32_t>(bundle.at(i, j).size());
    }
  }
  std::vector<std::uint32_t> parent(spans);
  std::iota(parent.begin(), parent.end(), 0U);
  const auto root = [&](std::uint32_t k) {
    while (parent[k] != k) k = parent[k] = parent[parent[k]];
    return k;
  };
  const auto join = [&](int i, int j, int i2, int j2) {
    const auto a = bundle.at(i, j), b = bundle.at(i2, j2);
    for (std::size_t p = 0, q = 0; p < a.size() && q < b.size(); (a[p].to < b[q].to ? p : q)++) {
      if (std::min(a[p].to, b[q].to) - std::max(a[p].from, b[q].from) <= least_bridge_mm) continue;
      const std::uint32_t one = root(first.at(i, j) + static_cast<std::uint32_t>(p)), other = root(first.at(i2, j2) + static_cast<std::uint32_t>(q));
      parent[std::max(one, other)] = std::min(one, other);
    }
  };
  for (int j = 0; j < count_[1]; ++j) {
    for (int i = 0; i < count_[0]; ++i) {
      if (i + 1 < count_[0]) join(i, j, i + 1, j);
      if (j + 1 < count_[1]) join(i, j, i, j + 1);
    }
  }
  std::vector<Piece> pieces;
  std::vector<std::uint32_t> piece_of(spans);
  for (int j = 0; j < count_[1]; ++j) {
    for (int i = 0; i < count_[0]; ++i) {
      std::uint32_t number = first.at(i, j);
      for (const Span& span : bundle.at(i, j)) {
        const std::uint32_t top = root(number);
        if (top == number) {
          piece_of[number] = static_cast<std::uint32_t>(pieces.size());
          pieces.push_back({0, Vec3::Constant(kNothing), Vec3::Constant(-kNothing)});
        }
        Piece& piece = pieces[piece_of[top]];
        piece.volume_mm3 += (static_cast<double>(span.to) - span.from) * pitch_.x() * pitch_.y();
        const Vec3 cell(place_mm(0, i), place_mm(1, j), 0), half(pitch_.x() / 2, pitch_.y() / 2, 0);
        piece.low_mm = piece.low_mm.cwiseMin(cell - half + Vec3(0, 0, span.from));
        piece.high_mm = piece.high_mm.cwiseMax(cell + half + Vec3(0, 0, span.to));
        ++number;
      }
    }
  }
  std::stable_sort(pieces.begin(), pieces.end(), [](const Piece& a, const Piece& b) { return a.volume_mm3 > b.volume_mm3; });
  return pieces;
}

namespace {

constexpr char kMagic[] = "lightmill solid 1\n";

template <typename T>
void put(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

template <typename T>
T get(const std::string& bytes, std::size_t& at, const std::filesystem::path& path) {
  T value;
  if (bytes.size() - at < sizeof value) throw InputError(path.string() + " ends too early; run the dry run again");
  std::memcpy(&value, bytes.data() + at, sizeof value);
  at += sizeof value;
  return value;
}

}  // namespace

void SolidStock::write(const std::filesystem::path& path) const {
  std::string bytes = kMagic;
  put(bytes, blank_.size_mm.x());
  put(bytes, blank_.size_mm.y());
  put(bytes, blank_.height_mm);
  put(bytes, pitch_.maxCoeff());
  for (const RayBundle& bundle : rays_) {
    for (int row = 0; row < bundle.rows(); ++row) {
      for (int column = 0; column < bundle.columns(); ++column) {
        const auto spans = bundle.at(column, row);
        put(bytes, static_cast<std::uint16_t>(spans.size()));
        for (const Span& span : spans) put(bytes, span);
      }
    }
  }
  write_whole(path, bytes);
}

SolidStock SolidStock::read(const std::filesystem::path& path) {
  const std::string bytes = read_whole(path);
  if (!bytes.starts_with(kMagic)) throw InputError(path.string() + " is no solid of this version; run the dry run again");
  std::size_t at = sizeof kMagic - 1;
  Blank blank;
  blank.size_mm.x() = get<double>(bytes, at, path);
  blank.size_mm.y() = get<double>(bytes, at, path);
  blank.height_mm = get<double>(bytes, at, path);
  SolidStock solid(blank, get<double>(bytes, at, path));
  std::vector<Span> spans;
  for (RayBundle& bundle : solid.rays_) {
    for (int row = 0; row < bundle.rows(); ++row) {
      for (int column = 0; column < bundle.columns(); ++column) {
        spans.resize(get<std::uint16_t>(bytes, at, path));
        for (Span& span : spans) span = get<Span>(bytes, at, path);
        bundle.set(column, row, spans);
      }
    }
  }
  solid.refresh_tops(Box2::centred(blank.size_mm));
  return solid;
}

}  // namespace lightmill
