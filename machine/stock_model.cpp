#include "machine/stock_model.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/image.h"
#include "design/core/parallel.h"
#include "design/core/text.h"
#include "machine/detail/fault_picture.h"
#include "machine/detail/stock_field.h"
#include "machine/detail/stock_peaks.h"
#include "machine/detail/stock_tool.h"
#include "machine/detail/swept_body.h"

namespace lightmill {

namespace {

/// Moves that are collected before they are applied. More spread better over threads; fewer keep the upper bounds of
/// the stock fresher, so that more of a tool's footprint is known to be air.
constexpr std::size_t kBatchMoves = 2048;
/// A ball's centre leaves the straight line between its ends by at most R angle^2 / 8 while the axis turns: 0.008 um at
/// 2 mm.
constexpr double kBallTurn_rad = 0.0056;
/// Other cutters are swept with the axis of the piece's middle: their rim is off by R angle / 2, 0.5 um at 5 mm.
constexpr double kMillTurn_rad = 2e-4;
/// A mill whose axis leans by less is swept as vertical: 0.5 um at 5 mm.
constexpr double kVertical_rad = 1e-4;
/// Long motions of tilted mills are cut into pieces so that tiles can be left out.
constexpr double kTiltedPiece_mm = 1.0;
/// Pieces in which a cutter that must not cut is held against the solid.
constexpr double kSolidPiece_mm = 4.0;
/// Moves in which shank or holder might meet what their own cutter removes are taken apart this finely.
constexpr double kCollisionPiece_mm = 0.5;
/// Ends that are nearer than this are one vertex of a path.
constexpr double kSameVertex_mm = 1e-6;
/// The tip may be this far below the back of the blank before that is a fault.
constexpr double kTable_mm = 1e-3;
/// Poses along a move at which the tool is held against keep-outs, and points of a box per side.
constexpr double kObstacleSpacing_mm = 0.5;
constexpr int kObstaclePoints = 24;
/// A feed per tooth that is so many times the cutter's is a fault where more than this is cut. Plans stay below the cutter's;
/// links through air do not.
constexpr double kMostChip = 3;
constexpr double kChip_mm = 5e-3;
/// Each such move is cut by itself; after so many of them it is known.
constexpr long kMostFastMoves = 300;
/// Of faults in all, and the first of every kind and part besides.
constexpr std::size_t kMostPictures = 12;
constexpr const char* kSpindleOff = "spindle_off_in_cut";
/// A fault that has got deeper by this factor is drawn again.
constexpr double kDrawnAgain = 1.3;

}  // namespace

struct StockModel::Impl {
  struct Piece {
    SweptMove move;
    int tool = 0;
    long number = 0;  ///< of the move, pieces of one move share it
  };

  /// A fault with all the consecutive moves that repeat it.
  struct FaultRun {
    std::string what;     ///< kind and part
    int tool = 0;         ///< what and tool: what counts as the same fault
    std::string message;  ///< without the count
    long last_move = 0;
    long moves = 0;
    bool is_drawn = false;
    double drawn_mm = 0;  ///< depth in the picture
  };

  /// Where the path of cuts stands, so that only the wedge at a vertex is looked at and not a whole sphere.
  struct OpenPath {
    bool open = false;
    bool capped = false;  ///< its last vertex has been cut as a whole
    int tool = -1;
    Sweep::Shape shape = Sweep::Shape::kBall;
    Vec3 end = Vec3::Zero();
    Vec3 direction = Vec3::Zero();
    bool level = false;
  };

  /// What might meet the stock in a move, from upper bounds only.
  struct Suspicion {
    bool tip = false;
    bool flutes = false;
    bool body = false;   ///< shank and holder
    bool solid = false;  ///< tip or flutes, in the solid
    [[nodiscard]] bool cutter() const { return tip || flutes || solid; }
  };
  struct Hit {
    StockField::Probe probe;
    const char* part = "";
    bool inside = false;  ///< as deep inside the solid; else below the top of the heights
    [[nodiscard]] std::string says() const;
  };
  struct Hits {
    Hit cutter, others;
  };

  Impl(const Blank& blank, const StockOptions& stock_options)
      : field(blank, stock_options.pitch_mm), options(stock_options), obstacles(blank.keep_outs) {
    if (options.table) obstacles.push_back(*options.table);
    if (options.solid_pitch_mm > 0) solid = std::make_shared<SolidStock>(blank, options.solid_pitch_mm);
  }

  StockField field;
  StockOptions options;
  std::vector<KeepOut> obstacles;  ///< clamps, then the table
  std::vector<Cutter> cutters;
  std::vector<Tool> tools;  ///< made of the cutters
  std::shared_ptr<SolidStock> solid;
  int solid_tool = -1;      ///< the one that the solid was told of
  std::vector<Piece> pieces;
  std::vector<Sweep> sweeps;  ///< not yet cut
  OpenPath path;
  long moves = 0;
  long turning_move = 0;  ///< the last one with the spindle on
  long fast_moves = 0;  ///< in the cut
  std::vector<Fault> faults;
  std::vector<FaultRun> runs;

  void report(const std::string& kind, const std::string& part, const Piece& piece, const std::string& message,
              const Vec3& place, double amount);
  void apply();
  void execute(const Piece& piece, const Suspicion& suspicion);
  [[nodiscard]] Hits hits_of(const Piece& piece, const Suspicion& suspicion, double margin) const;
  void cut_collected();
  void cut_solid(const Piece& piece);
  void add_cut(const Piece& piece);
  void add_flutes(const Piece& piece);
  void end_path();
  void check_obstacles(const Piece& piece);
  [[nodiscard]] double feed_per_tooth(const Piece& piece) const;
  [[nodiscard]] bool is_too_fast(const Piece& piece) const;
  void check_feed(const Piece& piece);
  void check_tip(const Piece& piece, double margin, const std::string& kind, const std::string& says);
  [[nodiscard]] std::vector<Sweep> tip_sweeps(const Piece& piece, double margin) const;
  [[nodiscard]] std::vector<SweptBody> solid_bodies(const Piece& piece, double margin) const;
  [[nodiscard]] double lowest_of_tip(const Piece& piece) const;
};

namespace {

bool leans(const ToolPose& pose) {
  return std::hypot(pose.axis.x(), pose.axis.y()) > kVertical_rad;
}

double turn(const ToolPose& a, const ToolPose& b) {
  return 2 * std::asin(std::min(1.0, (b.axis - a.axis).norm() / 2));
}

/// The pose at share t of a move: the tip on the line, the axis turned evenly.
ToolPose pose_at(const SweptMove& move, double angle, double t) {
  ToolPose pose{move.from.tip_mm + t * (move.to.tip_mm - move.from.tip_mm), move.from.axis};
  if (angle > 1e-12) {
    pose.axis = (std::sin((1 - t) * angle) * move.from.axis + std::sin(t * angle) * move.to.axis) / std::sin(angle);
    pose.axis.normalize();
  }
  return pose;
}

std::string mm(double value) {
  return compact(value, 3) + " mm";
}

const char* name_of(Tool::Part part) {
  switch (part) {
    case Tool::Part::kFlutes:
      return "flutes";
    case Tool::Part::kShank:
      return "shank";
    case Tool::Part::kNose:
      return "spindle nose";
    case Tool::Part::kHolder:
      break;
  }
  return "holder";
}

}  // namespace

void StockModel::Impl::report(const std::string& kind, const std::string& part, const Piece& piece,
                              const std::string& message, const Vec3& place, double amount) {
  const std::string what = kind + "/" + part;
  std::size_t k = runs.size();
  // The latest run of this kind goes on if this is the same move, the next one, or on the next line; with the spindle off until it
  // turns again.
  for (std::size_t back = runs.size(); back-- > 0;) {
    if (runs[back].what != what || runs[back].tool != piece.tool) continue;
    const long last_line = faults[back].last_line;
    const bool still_off = kind == kSpindleOff && runs[back].last_move > turning_move;
    if (still_off || piece.number <= runs[back].last_move + 1 || (piece.move.line >= last_line && piece.move.line <= last_line + 1)) k = back;
    break;
  }
  if (k == runs.size()) {
    const bool first_of_its_kind = std::none_of(runs.begin(), runs.end(), [&](const FaultRun& run) { return run.what == what; });
    runs.push_back({what, piece.tool, message, piece.number, 1, k < kMostPictures || first_of_its_kind});
    Fault fault;
    fault.kind = kind;
    fault.line = fault.last_line = fault.worst_line = piece.move.line;
    fault.place_mm = place;
    fault.amount_mm = amount;
    faults.push_back(fault);
  } else {
    FaultRun& run = runs[k];
    faults[k].last_line = std::max(faults[k].last_line, piece.move.line);
    if (piece.number != run.last_move) ++run.moves;
    run.last_move = piece.number;
    if (amount > faults[k].amount_mm) {
      run.message = message;
      faults[k].worst_line = piece.move.line;
      faults[k].amount_mm = amount;
      faults[k].place_mm = place;
    }
  }
  if (runs[k].is_drawn && faults[k].amount_mm > kDrawnAgain * runs[k].drawn_mm) {
    runs[k].drawn_mm = faults[k].amount_mm;
    // The tool where it passes the place.
    const Vec3 way = piece.move.to.tip_mm - piece.move.from.tip_mm;
    const double share = way.squaredNorm() > 0 ? std::clamp((place - piece.move.from.tip_mm).dot(way) / way.squaredNorm(), 0.0, 1.0) : 1;
    const ToolPose pose = pose_at(piece.move, turn(piece.move.from, piece.move.to), share);
    faults[k].picture = fault_picture(field, solid.get(), tools[piece.tool], pose, way, place, obstacles);
  }
  const FaultRun& run = runs[k];
  const Vec3& p = faults[k].place_mm;
  std::string text = run.message + " at X" + compact(p.x(), 3) + " Y" + compact(p.y(), 3) + " Z" + compact(p.z(), 3);
  if (run.moves > 1) text += " (the worst of " + std::to_string(run.moves) + " moves)";
  faults[k].message = text;
}

std::string StockModel::Impl::Hit::says() const {
  return mm(probe.depth_mm) + (inside ? " inside the material" : " below the top of the stock");
}

/// Everything of the cutter that its motion covers, as sweeps grown by a margin. A ball's flutes are checked as slices.
std::vector<Sweep> StockModel::Impl::tip_sweeps(const Piece& piece, double margin) const {
  const Tool& tool = tools[piece.tool];
  const SweptMove& move = piece.move;
  Sweep sweep;
  sweep.whole = true;
  if (tool.ball) {
    sweep.shape = Sweep::Shape::kBall;
    sweep.radius_mm = tool.radius_mm + margin;
    sweep.from = move.from.tip_mm + tool.radius_mm * move.from.axis;
    sweep.to = move.to.tip_mm + tool.radius_mm * move.to.axis;
    if (sweep.radius_mm <= 0) return {};
    sweep.prepare();
    return {sweep};
  }
  // A corner that would shrink below nothing takes from the flat.
  sweep.corner_mm = std::max(0.0, tool.corner_mm + margin);
  sweep.flat_mm = tool.radius_mm + margin - sweep.corner_mm;
  if (sweep.flat_mm < 0) return {};
  sweep.radius_mm = tool.radius_mm + margin;
  if (!leans(move.from) && !leans(move.to)) {
    sweep.shape = Sweep::Shape::kMill;
    sweep.from = move.from.tip_mm - Vec3(0, 0, margin);
    sweep.to = move.to.tip_mm - Vec3(0, 0, margin);
    sweep.prepare();
    return {sweep};
  }
  sweep.shape = Sweep::Shape::kTilted;
  sweep.axis = (move.from.axis + move.to.axis).normalized();
  sweep.body = {sweep.flat_mm, sweep.corner_mm,
                std::max(sweep.corner_mm, tool.flute_length_mm + 2 * margin - sweep.corner_mm)};
  const Vec3 from = move.from.tip_mm - margin * sweep.axis;
  const Vec3 to = move.to.tip_mm - margin * sweep.axis;
  const int count = std::max(1, static_cast<int>(std::ceil((to - from).norm() / kTiltedPiece_mm)));
  std::vector<Sweep> result;
  for (int k = 0; k < count; ++k) {
    sweep.from = from + (to - from) * (static_cast<double>(k) / count);
    sweep.to = from + (to - from) * (static_cast<double>(k + 1) / count);
    sweep.prepare();
    result.push_back(sweep);
  }
  return result;
}

/// The parts of a move's cutter that may meet the solid. What leaning flutes have left may stand off by half a step of the turn
/// of those that cut it.
std::vector<SweptBody> StockModel::Impl::solid_bodies(const Piece& piece, double margin) const {
  const Tool& tool = tools[piece.tool];
  const SweptMove& move = piece.move;
  if (leans(move.from) || leans(move.to)) margin -= tool.flute_length_mm * (tool.ball ? kBallTurn_rad : kMillTurn_rad) / 2;
  const Vec3 way = move.to.tip_mm - move.from.tip_mm;
  const double angle = turn(move.from, move.to);
  const int count = std::max(1, static_cast<int>(std::ceil(way.norm() / kSolidPiece_mm)));
  std::vector<SweptBody> bodies;
  ToolPose last = move.from;
  for (int k = 1; k <= count; ++k) {
    const ToolPose next = pose_at(move, angle, static_cast<double>(k) / count);
    SweptBody body(tool, last, next, margin);
    if (body.low().z() < solid->highest({body.low().head<2>(), body.high().head<2>()})) bodies.push_back(body);
    last = next;
  }
  return bodies;
}

double StockModel::Impl::lowest_of_tip(const Piece& piece) const {
  const Tool& tool = tools[piece.tool];
  double lowest = kNothing;
  for (const ToolPose* pose : {&piece.move.from, &piece.move.to}) {
    const double core = pose->tip_mm.z() + tool.corner_mm * pose->axis.z();
    const double rim = (tool.radius_mm - tool.corner_mm) * std::hypot(pose->axis.x(), pose->axis.y());
    lowest = std::min(lowest, core - rim - tool.corner_mm);
  }
  return lowest;
}

/// The cutter standing at the end of the path: the wedge of the last vertex opens to everything beyond it.
void StockModel::Impl::end_path() {
  if (path.open && !path.capped && path.shape != Sweep::Shape::kTilted) {
    const Tool& tool = tools[path.tool];
    Sweep cap;
    cap.shape = path.shape;
    cap.radius_mm = tool.radius_mm;
    cap.corner_mm = tool.corner_mm;
    cap.flat_mm = tool.radius_mm - tool.corner_mm;
    cap.from = cap.to = path.end;
    cap.prepare();
    if (field.may_touch(cap)) sweeps.push_back(cap);
  }
  path.capped = true;
}

void StockModel::Impl::add_cut(const Piece& piece) {
  const Tool& tool = tools[piece.tool];
  for (Sweep& sweep : tip_sweeps(piece, 0)) {
    const Vec3 motion = sweep.to - sweep.from;
    Vec3 from = sweep.from;
    Vec3 to = sweep.to;
    if (sweep.shape == Sweep::Shape::kBall) {
      // prepare() reduces a plunge to its lower end; the path goes on from where the ball really is.
      from = piece.move.from.tip_mm + tool.radius_mm * piece.move.from.axis;
      to = piece.move.to.tip_mm + tool.radius_mm * piece.move.to.axis;
    } else if (sweep.shape == Sweep::Shape::kMill) {
      from = piece.move.from.tip_mm;
      to = piece.move.to.tip_mm;
    }
    const double length = (to - from).norm();
    const bool goes_on =
        path.open && path.tool == piece.tool && path.shape == sweep.shape && (path.end - from).norm() < kSameVertex_mm;
    if (goes_on && length < kSameVertex_mm / 10) continue;
    if (!goes_on) end_path();
    const Vec3 direction = length > 0 ? Vec3((to - from) / length) : Vec3(Vec3::Zero());
    const bool level = from.z() == to.z();
    if (goes_on && motion.head<2>().norm() > 0) {
      if (sweep.shape == Sweep::Shape::kBall) {
        sweep.whole = false;
        sweep.back_mm = ball_wedge(path.direction, direction, tool.radius_mm);
      } else if (sweep.shape == Sweep::Shape::kMill && level && path.level) {
        // Level motions look across at right angles: p . direction >= p . (direction - before) >= -R |direction -
        // before|.
        sweep.whole = false;
        sweep.back_mm = tool.radius_mm * (direction - path.direction).norm();
      }
    }
    path = {true, length == 0, piece.tool, sweep.shape, to, direction, level};
    if (field.may_touch(sweep)) sweeps.push_back(sweep);
  }
}

/// The flutes above a leaning ball's equator, as the capsule that ball and flutes are together, or a tapered ball's flank, as
/// the rounded cone.
void StockModel::Impl::add_flutes(const Piece& piece) {
  const Tool& tool = tools[piece.tool];
  Sweep sweep;
  sweep.shape = Sweep::Shape::kTilted;
  sweep.axis = (piece.move.from.axis + piece.move.to.axis).normalized();
  sweep.corner_mm = tool.corner_mm;
  sweep.flat_mm = 0;
  sweep.radius_mm = tool.radius_mm;
  sweep.from_height_mm = tool.side_from_mm;
  sweep.body = {0, tool.corner_mm, std::max(tool.corner_mm, tool.flute_length_mm - tool.corner_mm), tool.spread};
  const Vec3 motion = piece.move.to.tip_mm - piece.move.from.tip_mm;
  const int count = std::max(1, static_cast<int>(std::ceil(motion.norm() / kTiltedPiece_mm)));
  for (int k = 0; k < count; ++k) {
    sweep.from = piece.move.from.tip_mm + motion * (static_cast<double>(k) / count);
    sweep.to = piece.move.from.tip_mm + motion * (static_cast<double>(k + 1) / count);
    sweep.prepare();
    sweeps.push_back(sweep);
  }
}

void StockModel::Impl::cut_collected() {
  field.cut(sweeps);
  sweeps.clear();
}

void StockModel::Impl::cut_solid(const Piece& piece) {
  if (solid_tool != piece.tool) solid->set_cutter(cutters[piece.tool]);
  solid_tool = piece.tool;
  solid->cut(piece.move.from, piece.move.to);
}

void StockModel::Impl::apply() {
  // Which bodies might meet the stock as it was before this batch? The stock only shrinks: what is clear now stays
  // clear.
  std::vector<Suspicion> suspicions(pieces.size());
  parallel_blocks(pieces.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const Piece& piece = pieces[k];
      const Tool& tool = tools[piece.tool];
      const bool cutting = !piece.move.rapid && piece.move.spindle_on;
      const double margin = piece.move.rapid ? options.rapid_clearance_mm : 0.0;
      if (!cutting || is_too_fast(piece)) {
        for (const Sweep& sweep : tip_sweeps(piece, margin)) suspicions[k].tip |= field.may_touch(sweep);
      }
      suspicions[k].solid = solid && !cutting && !solid_bodies(piece, margin).empty();
      const bool leaning = leans(piece.move.from) || leans(piece.move.to);
      for (const Tool::Slice& slice : tool.slices) {
        const bool flutes = slice.part == Tool::Part::kFlutes;
        // A vertical cutter's flutes are above its tip's footprint, unless tapered; a leaning mill's are cut with its tip.
        if (flutes && ((!leaning && tool.spread <= 0) || !tool.ball) && margin <= 0) continue;
        bool& suspicious = flutes ? suspicions[k].flutes : suspicions[k].body;
        if (!suspicious) suspicious = may_touch(field, slice.body, piece.move.from, piece.move.to, margin);
        if (!suspicious && solid && !flutes) suspicious = may_touch(*solid, slice.body, piece.move.from, piece.move.to, margin);
      }
    }
  });

  for (std::size_t k = 0; k < pieces.size(); ++k) execute(pieces[k], suspicions[k]);
  cut_collected();
  pieces.clear();
}

/// The whole tool against clamps and table, at poses along the move. A box is taken as reaching down to the table; the lowest
/// point of a body over its rectangle is looked for on a grid, as the underside is convex.
void StockModel::Impl::check_obstacles(const Piece& piece) {
  const Tool& tool = tools[piece.tool];
  const Vec3 way = piece.move.to.tip_mm - piece.move.from.tip_mm;
  const auto low_of = [&](const Frustum& body, const ToolPose& pose, const Box2& over, double& x, double& y) {
    double lowest = kNothing;
    for (int i = 0; i <= kObstaclePoints; ++i) {
      for (int j = 0; j <= kObstaclePoints; ++j) {
        const Vec2 p = over.min + over.size().cwiseProduct(Vec2(i, j)) / kObstaclePoints;
        const double z = underside(body, pose.tip_mm, pose.axis, p.x(), p.y());
        if (z >= lowest) continue;
        lowest = z;
        x = p.x();
        y = p.y();
      }
    }
    return lowest;
  };
  const auto check = [&](const char* part, const Frustum& body) {
    const double radius = std::max(body.from_radius_mm, body.to_radius_mm);
    for (std::size_t k = 0; k < obstacles.size(); ++k) {
      const KeepOut& box = obstacles[k];
      const auto near = [&](const ToolPose& a, const ToolPose& b) -> std::optional<Box2> {
        Box2 bounds;
        double lowest = kNothing;
        for (const ToolPose* pose : {&a, &b}) {
          for (const double h : {body.from_mm, body.to_mm}) {
            const Vec3 c = pose->tip_mm + h * pose->axis;
            const Vec2 half = radius * (Vec2::Ones() - pose->axis.head<2>().cwiseAbs2()).cwiseMax(0).cwiseSqrt();
            bounds.include(c.head<2>() - half);
            bounds.include(c.head<2>() + half);
            lowest = std::min(lowest, c.z() - radius * std::hypot(pose->axis.x(), pose->axis.y()));
          }
        }
        if (lowest >= box.max_mm.z()) return std::nullopt;
        bounds.min = bounds.min.cwiseMax(box.min_mm.head<2>());
        bounds.max = bounds.max.cwiseMin(box.max_mm.head<2>());
        if ((bounds.size().array() <= 0).any()) return std::nullopt;
        return bounds;
      };
      if (!near(piece.move.from, piece.move.to)) continue;
      const double angle = turn(piece.move.from, piece.move.to);
      const int count = std::clamp(static_cast<int>(std::ceil((way.norm() + angle * body.to_mm) / kObstacleSpacing_mm)), 1, 10000);
      double deepest = 0;
      Vec3 place = Vec3::Zero();
      for (int n = 0; n <= count; ++n) {
        const ToolPose pose = pose_at(piece.move, angle, static_cast<double>(n) / count);
        const auto over = near(pose, pose);
        if (!over) continue;
        double x = 0, y = 0;
        const double depth = box.max_mm.z() - low_of(body, pose, *over, x, y);
        if (depth <= deepest) continue;
        deepest = depth;
        place = {x, y, box.max_mm.z()};
      }
      if (deepest <= kTouch_mm) continue;
      const bool table = options.table && k + 1 == obstacles.size();
      const std::string what = table ? "the table" : "keep-out " + std::to_string(k + 1);
      report("collision", std::string(part) + " in " + what, piece,
             "the " + std::string(part) + " is " + mm(deepest) + " below the top of " + what, place, deepest);
    }
  };
  // A ball's end is a short frustum within it, exact where it is lowest if upright and at most a tenth of a mm small beside.
  constexpr int kRings = 6;
  const double core = tool.radius_mm - tool.corner_mm;
  for (int n = 0; n < kRings && tool.corner_mm > 0; ++n) {
    const auto radius = [&](double h) { return core + std::sqrt(std::max(0.0, tool.corner_mm * tool.corner_mm - (tool.corner_mm - h) * (tool.corner_mm - h))); };
    const auto up = [&](int ring) { return tool.corner_mm * ring * ring / (kRings * kRings); };
    check("cutter", {up(n), up(n + 1), radius(up(n)), radius(up(n + 1))});
  }
  for (const Tool::Slice& slice : tool.slices) {
    check(slice.part == Tool::Part::kFlutes ? "cutter" : name_of(slice.part), slice.body);
  }
}

/// 0 where speed or time are not known.
double StockModel::Impl::feed_per_tooth(const Piece& piece) const {
  const SweptMove& move = piece.move;
  const double teeth = move.seconds * move.spindle_rpm / 60 * cutters[piece.tool].edges;
  return teeth > 0 ? (move.to.tip_mm - move.from.tip_mm).norm() / teeth : 0;
}

bool StockModel::Impl::is_too_fast(const Piece& piece) const {
  const double data = cutters[piece.tool].feed_per_tooth_mm;
  return !piece.move.rapid && piece.move.spindle_on && data > 0 && feed_per_tooth(piece) > kMostChip * data;
}

void StockModel::Impl::check_feed(const Piece& piece) {
  if (fast_moves >= kMostFastMoves) return;
  cut_collected();
  StockField::Probe deepest;
  for (const Sweep& sweep : tip_sweeps(piece, 0)) {
    const auto probe = field.probe(sweep);
    if (probe.depth_mm > deepest.depth_mm) deepest = probe;
  }
  if (deepest.depth_mm <= kChip_mm) return;
  ++fast_moves;
  const double chip = feed_per_tooth(piece), data = cutters[piece.tool].feed_per_tooth_mm;
  report("feed", "", piece, "cuts with " + mm(chip) + " a tooth, " + compact(chip / data, 1) + " times the " + compact(data, 4) + " mm of '" +
                                cutters[piece.tool].name + "'", deepest.place_mm, chip);
}

/// Checks a move against the stock as it stands and cuts. Runs in the order of time.
void StockModel::Impl::execute(const Piece& piece, const Suspicion& suspicion) {
  const Tool& tool = tools[piece.tool];
  const bool cutting = !piece.move.rapid && piece.move.spindle_on;
  if (piece.move.spindle_on) turning_move = piece.number;
  if (!cutting) {
    end_path();
    path.open = false;
  }

  const double below_table = -lowest_of_tip(piece);
  if (below_table > kTable_mm) {
    report("table", "", piece, "the cutter goes " + mm(below_table) + " below the back of the blank",
           piece.move.to.tip_mm, below_table);
  }

  if (!obstacles.empty()) check_obstacles(piece);
  if (cutting && suspicion.tip) check_feed(piece);

  bool removes = cutting;
  if (suspicion.body || (!cutting && suspicion.cutter())) {
    cut_collected();  // the stock as it stands when this move starts
    if (solid) solid->flush();
    const double clearance = piece.move.rapid ? options.rapid_clearance_mm : 0.0;
    const Hits hits = hits_of(piece, suspicion, clearance - kTouch_mm);
    const double length = (piece.move.to.tip_mm - piece.move.from.tip_mm).norm();
    if (cutting && hits.others.probe.depth_mm > 0 && length > kCollisionPiece_mm) {
      // A shank that leans back passes where the cutter of this very move has been: piece by piece, then.
      const int count = static_cast<int>(std::ceil(length / kCollisionPiece_mm));
      const double angle = turn(piece.move.from, piece.move.to);
      Piece part = piece;
      for (int k = 1; k <= count; ++k) {
        part.move.to = k == count ? piece.move.to : pose_at(piece.move, angle, static_cast<double>(k) / count);
        execute(part, suspicion);
        part.move.from = part.move.to;
      }
      return;
    }
    if (piece.move.rapid) {
      const Hit& worst = hits.cutter.probe.depth_mm >= hits.others.probe.depth_mm ? hits.cutter : hits.others;
      if (worst.probe.depth_mm > 0) {
        report("rapid_in_stock", "", piece,
               "rapid with the " + std::string(worst.part) + " " + worst.says() +
                   (clearance > 0 ? " (or nearer than " + mm(clearance) + " to it)" : ""),
               worst.probe.place_mm, worst.probe.depth_mm);
      }
    } else {
      if (hits.cutter.probe.depth_mm > 0) {
        report(kSpindleOff, "", piece,
               "feed with the spindle off and the cutter " + hits.cutter.says(), hits.cutter.probe.place_mm, hits.cutter.probe.depth_mm);
      }
      if (hits.others.probe.depth_mm > 0) {
        report("collision", hits.others.part, piece,
               "the " + std::string(hits.others.part) + " is " + hits.others.says(),
               hits.others.probe.place_mm, hits.others.probe.depth_mm);
      }
    }
    // Whatever should not have touched but did has taken its material along.
    removes = removes || hits.cutter.probe.depth_mm > 0;
  }
  if (removes) {
    add_cut(piece);
    if (suspicion.flutes && tool.ball) add_flutes(piece);
    if (solid) cut_solid(piece);
  }
  if (!cutting) {
    end_path();
    path.open = false;
  }
}

/// The deepest place of the cutter (unless it may cut) and of the rest in the stock.
StockModel::Impl::Hits StockModel::Impl::hits_of(const Piece& piece, const Suspicion& suspicion, double margin) const {
  const Tool& tool = tools[piece.tool];
  const bool cutting = !piece.move.rapid && piece.move.spindle_on;
  Hits hits;
  if (suspicion.tip && !cutting) {
    for (const Sweep& sweep : tip_sweeps(piece, margin)) {
      const auto probe = field.probe(sweep);
      if (probe.depth_mm > hits.cutter.probe.depth_mm) hits.cutter = {probe, "cutter"};
    }
  }
  if (suspicion.solid && !cutting) {
    for (const SweptBody& body : solid_bodies(piece, margin)) {
      const auto probe = touch(*solid, body);
      if (probe.depth_mm > hits.cutter.probe.depth_mm) hits.cutter = {probe, "cutter", true};
    }
  }
  for (const Tool::Slice& slice : tool.slices) {
    const bool flutes = slice.part == Tool::Part::kFlutes;
    if (flutes ? (cutting || !suspicion.flutes) : !suspicion.body) continue;
    Hit& hit = flutes ? hits.cutter : hits.others;
    const auto look = [&](const auto& stock, bool inside) {
      if (!may_touch(stock, slice.body, piece.move.from, piece.move.to, margin)) return;
      const auto probe = touch(stock, slice.body, piece.move.from, piece.move.to, margin);
      if (probe.depth_mm > hit.probe.depth_mm) hit = {probe, name_of(slice.part), inside};
    };
    look(field, false);
    if (solid && !flutes) look(*solid, true);
  }
  return hits;
}

StockModel::StockModel(const Blank& blank, const StockOptions& options)
    : impl_(std::make_unique<Impl>(blank, options)) {}

StockModel::~StockModel() = default;

void StockModel::lower_to(const std::function<double(const Vec2&)>& height_mm) {
  impl_->field.lower_to(height_mm);
}

void StockModel::set_cutter(const Cutter& cutter) {
  if (!(cutter.diameter_mm > 0) || cutter.corner_radius_mm < 0) {
    throw InputError("cutter '" + cutter.name + "': diameter_mm must be above 0 and corner_radius_mm at least 0, not " +
                     compact(cutter.diameter_mm, 4) + " and " + compact(cutter.corner_radius_mm, 4));
  }
  impl_->cutters.push_back(cutter);
  impl_->tools.emplace_back(cutter);
}

void StockModel::move(const SweptMove& move) {
  if (impl_->tools.empty())
    throw InputError("line " + std::to_string(move.line) + ": a move before any cutter is in the spindle");
  const Tool& tool = impl_->tools.back();
  const int index = static_cast<int>(impl_->tools.size()) - 1;
  const long number = ++impl_->moves;
  const double angle = turn(move.from, move.to);
  const double limit = tool.ball ? kBallTurn_rad : kMillTurn_rad;
  const int count = std::clamp(static_cast<int>(std::ceil(angle / limit)), 1, 100000);
  ToolPose last = move.from;
  for (int k = 1; k <= count; ++k) {
    SweptMove piece = move;
    piece.from = last;
    piece.seconds = move.seconds / count;
    piece.to = k == count ? move.to : pose_at(move, angle, static_cast<double>(k) / count);
    last = piece.to;
    impl_->pieces.push_back({piece, index, number});
    if (impl_->pieces.size() >= kBatchMoves) impl_->apply();
  }
}

void StockModel::flush() {
  impl_->apply();
  impl_->turning_move = impl_->moves;  // the faults so far are complete
  impl_->end_path();
  impl_->cut_collected();
  if (impl_->solid) impl_->solid->flush();
}

const std::vector<Fault>& StockModel::faults() const {
  return impl_->faults;
}

MachinedSurface StockModel::surface() const {
  MachinedSurface surface;
  surface.extent = impl_->field.extent();
  surface.pitch_mm = impl_->field.pitch_mm();
  surface.heights_mm = impl_->field.heights();
  RidgePeaks peaks = ridge_peaks(impl_->field);
  surface.peaks_mm = std::move(peaks.heights_mm);
  surface.peak_offsets = std::move(peaks.offsets);
  surface.removed_mm3 = impl_->field.removed_mm3();
  return surface;
}

std::shared_ptr<const SolidStock> StockModel::solid() const {
  return impl_->solid;
}

namespace {

constexpr const char* kFormat = "lightmill machined surface 2";

std::filesystem::path beside(const std::filesystem::path& heights_path, const char* suffix) {
  return heights_path.parent_path() / (heights_path.stem().string() + suffix);
}

std::filesystem::path picture_beside(const std::filesystem::path& heights_path, const char* suffix) {
  return beside(heights_path, (suffix + heights_path.extension().string()).c_str());
}

constexpr int kOffsetCodes = 256;  ///< of one axis in a picture's value

Grid<float> codes_of(const Grid<PeakOffset>& offsets) {
  Grid<float> codes(offsets.width, offsets.height);
  std::transform(offsets.values.begin(), offsets.values.end(), codes.values.begin(), [](const PeakOffset& offset) {
    return static_cast<float>(offset.x + PeakOffset::kMost + kOffsetCodes * (offset.y + PeakOffset::kMost));
  });
  return codes;
}

Grid<PeakOffset> offsets_of(const Grid<float>& codes, const std::filesystem::path& path) {
  Grid<PeakOffset> offsets(codes.width, codes.height);
  std::transform(codes.values.begin(), codes.values.end(), offsets.values.begin(), [&](float value) {
    const int code = value >= 0 && value < kOffsetCodes * kOffsetCodes ? static_cast<int>(value) : -1;
    const int x = code % kOffsetCodes, y = code / kOffsetCodes;
    if (code < 0 || static_cast<float>(code) != value || std::max(x, y) > 2 * PeakOffset::kMost) {
      throw InputError(path.string() + " holds " + compact(value, 3) + ", which is no place in a cell; run the dry run again");
    }
    return PeakOffset{static_cast<std::int8_t>(x - PeakOffset::kMost), static_cast<std::int8_t>(y - PeakOffset::kMost)};
  });
  return offsets;
}

}  // namespace

// The picture of heights comes last: where it is, the rest is.
void write_machined(const std::filesystem::path& heights_path, const MachinedSurface& surface) {
  const auto peaks_path = picture_beside(heights_path, "_peaks");
  const auto offsets_path = picture_beside(heights_path, "_peak_offsets");
  const auto note_path = beside(heights_path, ".json");
  std::error_code ignored;
  std::filesystem::remove(heights_path, ignored);
  write_float_image(peaks_path, flipped_rows(surface.peaks_mm));
  write_float_image(offsets_path, codes_of(flipped_rows(surface.peak_offsets)));
  nlohmann::ordered_json note;
  note["format"] = kFormat;
  note["heights"] = heights_path.filename().string();
  note["peaks"] = peaks_path.filename().string();
  note["peak_offsets"] = offsets_path.filename().string();
  note["unit"] = "mm";
  note["rows"] = "top row at the largest y";
  note["columns_count"] = surface.heights_mm.width;
  note["rows_count"] = surface.heights_mm.height;
  note["pitch_mm"] = surface.pitch_mm;
  note["extent_mm"] = {{"min", {surface.extent.min.x(), surface.extent.min.y()}},
                       {"max", {surface.extent.max.x(), surface.extent.max.y()}}};
  note["removed_mm3"] = surface.removed_mm3;
  write_whole(note_path, note.dump(2) + "\n");
  write_float_image(heights_path, flipped_rows(surface.heights_mm));
}

MachinedSurface read_machined(const std::filesystem::path& heights_path) {
  const auto note_path = beside(heights_path, ".json");
  MachinedSurface surface;
  int columns = 0;
  int rows = 0;
  try {
    const auto note = nlohmann::json::parse(read_whole(note_path));
    if (note.at("format") != kFormat) {
      throw InputError(note_path.string() + " is not a '" + kFormat + "'; run the dry run again");
    }
    columns = note.at("columns_count");
    rows = note.at("rows_count");
    surface.pitch_mm = note.at("pitch_mm");
    for (int axis = 0; axis < 2; ++axis) {
      surface.extent.min[axis] = note.at("extent_mm").at("min").at(axis);
      surface.extent.max[axis] = note.at("extent_mm").at("max").at(axis);
    }
    surface.removed_mm3 = note.at("removed_mm3");
  } catch (const nlohmann::json::exception& error) {
    throw InputError("cannot understand " + note_path.string() + ": " + error.what() + "; run the dry run again");
  }
  surface.heights_mm = flipped_rows(read_float_image(heights_path));
  surface.peaks_mm = flipped_rows(read_float_image(picture_beside(heights_path, "_peaks")));
  const auto offsets_path = picture_beside(heights_path, "_peak_offsets");
  surface.peak_offsets = flipped_rows(offsets_of(read_float_image(offsets_path), offsets_path));
  const auto size_of = [](const auto& grid) { return std::pair(grid.width, grid.height); };
  for (const auto& size : {size_of(surface.heights_mm), size_of(surface.peaks_mm), size_of(surface.peak_offsets)}) {
    if (size != std::pair(columns, rows)) {
      throw InputError(heights_path.string() + " has another size than " + note_path.string() +
                       " says; run the dry run again");
    }
  }
  return surface;
}

}  // namespace lightmill
