// The blank as a height field in the workpiece frame, and what swept cutters leave of it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "cam/blank.h"
#include "cam/cutter.h"
#include "design/core/grid.h"
#include "machine/motion.h"
#include "machine/solid_stock.h"

namespace lightmill {

struct StockOptions {
  double pitch_mm = 0.02;
  double rapid_clearance_mm = 0.0;  ///< a rapid whose cutter comes nearer to material than this is a fault
  std::optional<KeepOut> table{};   ///< the machine's, workpiece frame: nothing of a cutter may enter it
  double solid_pitch_mm = 0.0;      ///< of a true solid that is milled beside the height field; 0: none
};

/// Where in its node's cell a peak is.
struct PeakOffset {
  static constexpr int kMost = 127;  ///< half a pitch
  std::int8_t x = 0, y = 0;
  friend bool operator==(const PeakOffset&, const PeakOffset&) = default;
};

/// What is left after the program: node (i, j) at extent.min + pitch * (i, j), row 0 at the smallest y.
struct MachinedSurface {
  Box2 extent;
  double pitch_mm = 0;
  Grid<float> heights_mm;  ///< analytic at the nodes (lower envelope of the swept cutter)
  /// Highest place within half a pitch of the node, as seen along the surface: of the ridges between ball passes, which are intersected
  /// analytically, and the node itself. Its height is that of the place: minus the design there it is the cusp.
  Grid<float> peaks_mm;
  Grid<PeakOffset> peak_offsets;
  double removed_mm3 = 0;

  [[nodiscard]] Vec2 node_place_mm(int i, int j) const { return extent.min + pitch_mm * Vec2(i, j); }
  [[nodiscard]] Vec2 peak_place_mm(int i, int j) const {
    const PeakOffset& offset = peak_offsets.at(i, j);
    return node_place_mm(i, j) + pitch_mm / 2 / PeakOffset::kMost * Vec2(offset.x, offset.y);
  }
};

/// Removes material move by move. Cuts are collected and applied in batches on all threads; results do not depend on either.
class StockModel {
 public:
  StockModel(const Blank& blank, const StockOptions& options);
  ~StockModel();
  StockModel(const StockModel&) = delete;
  StockModel& operator=(const StockModel&) = delete;

  /// A blank that was milled before: nothing stands higher than this. Before the first move; the solid stays whole.
  void lower_to(const std::function<double(const Vec2&)>& height_mm);
  /// The cutter that the next moves use.
  void set_cutter(const Cutter& cutter);
  /// A move of the current cutter: feed moves cut; rapids must not touch. Shank and holder must never touch. Faults are of the
  /// kinds "rapid_in_stock", "spindle_off_in_cut", "collision" (shank, holder or spindle nose in the stock, anything in a keep-out or the table), "table" (below the blank's back)
  /// and "feed" (in the cut at more than three times the cutter's feed per tooth, where that and the speed are known); one that
  /// repeats on consecutive moves or lines, or until the spindle is switched on, is one entry with a count. Throws InputError before the first set_cutter().
  void move(const SweptMove& move);
  /// Applies what is still collected; only then are the faults complete.
  void flush();

  [[nodiscard]] const std::vector<Fault>& faults() const;
  /// flush() first. Throws nothing; the model stays usable.
  [[nodiscard]] MachinedSurface surface() const;
  /// flush() first. Null without one; changed by further moves.
  [[nodiscard]] std::shared_ptr<const SolidStock> solid() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// machined.tif (heights, float mm, top row at the largest y), machined_peaks.tif, machined_peak_offsets.tif (x + 256 y, each from 0
/// to 254 for a pitch, 127 the node) and machined.json (pitch, extent, volume) beside it. Each is whole or absent, the heights come last: where they are, the others are.
void write_machined(const std::filesystem::path& heights_path, const MachinedSurface& surface);
MachinedSurface read_machined(const std::filesystem::path& heights_path);

}  // namespace lightmill
