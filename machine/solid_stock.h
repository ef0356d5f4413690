// The blank as a true solid: walls, undercuts, tabs and loose pieces, which a height field cannot hold.
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <vector>

#include "cam/blank.h"
#include "cam/cutter.h"
#include "cam/toolpath.h"
#include "machine/ray_bundle.h"

namespace lightmill {

/// Material along rays parallel to x, y and z through the middles of cells of about `pitch_mm` (they fill the blank exactly):
/// across a ray places are as coarse as the pitch, along it they are exact to a float. Walls are thus read off x and y rays,
/// floors and undercuts off z rays. What a cut takes off a ray does not depend on order, batches or threads.
class SolidStock {
 public:
  SolidStock(const Blank& blank, double pitch_mm);
  ~SolidStock();
  SolidStock(SolidStock&&) noexcept;
  SolidStock& operator=(SolidStock&&) noexcept;

  /// The cutter that the next cuts use.
  void set_cutter(const Cutter& cutter);
  /// Takes away what the flutes sweep; the axis, that of the move's middle, should turn little. Moves that go straight on within
  /// 0.2 um are swept as one.
  void cut(const ToolPose& from, const ToolPose& to);
  /// Applies what is still collected; before anything is asked.
  void flush();

  [[nodiscard]] const Blank& blank() const { return blank_; }
  [[nodiscard]] const Vec3& pitch_mm() const { return pitch_; }
  /// The axes that the columns and the rows of the rays along axis 0, 1 or 2 run along.
  static constexpr std::array<int, 3> kColumnAxis{1, 0, 0}, kRowAxis{2, 2, 1};
  [[nodiscard]] const RayBundle& rays(int along) const { return rays_[along]; }
  [[nodiscard]] double place_mm(int axis, int cell) const { return low_[axis] + (cell + 0.5) * pitch_[axis]; }
  /// Cells along an axis whose middle lies from `low` to `high`.
  struct Cells {
    int from = 0, to = -1;  ///< inclusive
    [[nodiscard]] bool empty() const { return to < from; }
  };
  [[nodiscard]] Cells cells(int axis, double low_mm, double high_mm) const;
  /// The mean of what the three bundles say.
  [[nodiscard]] double volume_mm3() const;
  [[nodiscard]] std::size_t bytes() const;

  /// Connected material: rays of z side by side whose spans overlap by more than `least_bridge_mm`. Largest first.
  struct Piece {
    double volume_mm3 = 0;
    Vec3 low_mm = Vec3::Zero(), high_mm = Vec3::Zero();
  };
  [[nodiscard]] std::vector<Piece> pieces(double least_bridge_mm = 0) const;

  /// No material over a rectangle is higher; -infinity beside the blank. From tiles of kTile x kTile z rays.
  [[nodiscard]] double highest(const Box2& rectangle) const;
  static constexpr int kTile = 16;
  [[nodiscard]] float tile_highest(int i, int j) const { return tops_.at(i, j); }

  /// One binary file (little-endian, versioned), whole or absent.
  void write(const std::filesystem::path& path) const;
  static SolidStock read(const std::filesystem::path& path);

 private:
  void apply();
  void end_run();
  void refresh_tops(const Box2& changed);

  Blank blank_;
  Vec3 low_, pitch_;
  std::array<int, 3> count_{};
  std::array<RayBundle, 3> rays_;
  Grid<float> tops_;  ///< highest material of tiles of z rays
  struct Collected;
  std::unique_ptr<Collected> collected_;  ///< cuts that are not applied yet
};

}  // namespace lightmill
