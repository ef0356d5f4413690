// The blank as a height field in the workpiece frame, and what swept cutters leave of it.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "cam/blank.h"
#include "cam/cutter.h"
#include "design/core/grid.h"
#include "machine/motion.h"

namespace lightmill {

struct StockOptions {
  double pitch_mm = 0.02;
  double rapid_clearance_mm = 0.0;  ///< a rapid whose cutter comes nearer to material than this is a fault
};

/// What is left after the program: node (i, j) at extent.min + pitch * (i, j), row 0 at the smallest y.
struct MachinedSurface {
  Box2 extent;
  double pitch_mm = 0;
  Grid<float> heights_mm;      ///< analytic at the nodes (lower envelope of the swept cutter)
  Grid<float> peaks_mm;        ///< highest height within half a pitch of the node, ridges between passes intersected analytically
  double removed_mm3 = 0;
};

/// Removes material move by move. Cuts are collected and applied in batches on all threads; results do not depend on either.
class StockModel {
 public:
  StockModel(const Blank& blank, const StockOptions& options);
  ~StockModel();
  StockModel(const StockModel&) = delete;
  StockModel& operator=(const StockModel&) = delete;

  /// The cutter that the next moves use.
  void set_cutter(const Cutter& cutter);
  /// A move of the current cutter: feed moves cut; rapids must not touch. Shank and holder must never touch.
  void move(const SweptMove& move);
  /// Applies what is still collected.
  void flush();

  [[nodiscard]] const std::vector<Fault>& faults() const;
  /// flush() first. Throws nothing; the model stays usable.
  [[nodiscard]] MachinedSurface surface() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// machined.tif (heights) and machined_peaks.tif beside it; whole or absent.
void write_machined(const std::filesystem::path& heights_path, const MachinedSurface& surface);
MachinedSurface read_machined(const std::filesystem::path& heights_path);

}  // namespace lightmill
