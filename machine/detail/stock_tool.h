// The whole tool as bodies about its axis, and where they meet the stock.
#pragma once

#include <vector>

#include "cam/cutter.h"
#include "cam/toolpath.h"
#include "machine/detail/stock_field.h"
#include "machine/solid_stock.h"

namespace lightmill {

/// Bodies that overlap the stock by less than this (at right angles to their surface) only touch it: the rotary words'
/// last decimal turns a shank 100 mm away by less.
inline constexpr double kTouch_mm = 1e-3;

struct Tool {
  enum class Part { kFlutes, kShank, kHolder, kNose };
  struct Slice {
    Part part;
    Frustum body;
  };
  double radius_mm = 0, corner_mm = 0;
  double flute_length_mm = 0;
  double spread = 0;     ///< of a tapered ball's flank: radius over height
  double side_from_mm = 0;  ///< height above the tip where the ball or the corner goes over into the side
  bool ball = false;
  std::vector<Slice> slices;  ///< everything above the ball's equator or the mill's corner, cut into short pieces

  explicit Tool(const Cutter& cutter);
};

/// False only if the body, grown by `margin_mm`, is clear of the stock on its whole way between two near poses.
bool may_touch(const StockField& field, const Frustum& body, const ToolPose& from, const ToolPose& to,
               double margin_mm);

/// Node by node at poses at most kCheckSpacing_mm apart: how far the body, grown by `margin_mm`, is below the stock's
/// top.
inline constexpr double kCheckSpacing_mm = 0.1;
StockField::Probe touch(const StockField& field, const Frustum& body, const ToolPose& from, const ToolPose& to,
                        double margin_mm);
/// The same along the z rays of a solid, where overhangs count, too: how deep it is inside material.
StockField::Probe touch(const SolidStock& solid, const Frustum& body, const ToolPose& from, const ToolPose& to,
                        double margin_mm);
bool may_touch(const SolidStock& solid, const Frustum& body, const ToolPose& from, const ToolPose& to, double margin_mm);

}  // namespace lightmill
