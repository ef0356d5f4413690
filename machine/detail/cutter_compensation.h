// Cutter radius compensation (G41, G42) as LinuxCNC does it: the contour as programmed in, the path of the cutter's
// centre out.
#pragma once

#include <optional>

#include "machine/detail/reader_core.h"

namespace lightmill::detail {

/// A move of the contour, in program coordinates.
struct ContourMove {
  struct Arc {
    double u, v;      ///< centre
    double turn_rad;  ///< its sign is the sense from u to v
  };
  AxisValues to{};
  bool rapid = false;
  double feed_per_min = 0;
  std::optional<Arc> arc;
};

/// How a move's feed is meant.
struct Feed {
  double value = 0;
  bool inverse_time = false;  ///< per minute of the whole move, else mm (or degrees) per minute
};

/// F as it stands from block to block, and what it counts: G93 moves a minute, G94 mm a minute, G95 mm a revolution.
struct ModalFeed {
  double value = 0;  ///< 0: not given in this mode
  int mode = 94;
  void set_mode(int g) {
    if (g != mode) value = 0;
    mode = g;
  }
  [[nodiscard]] bool inverse_time() const { return mode == 93; }
  /// Of a move; `said_here`: its block has an F. Rejects a feed that moves nothing.
  [[nodiscard]] Feed at(double rpm, bool spindle_turns, bool said_here) const {
    if (inverse_time() && !said_here) reject(1, "F is missing in a block with inverse-time feed");
    if (value == 0) reject(1, "feed not given or zero");
    if (mode == 95 && !(spindle_turns && rpm > 0)) reject(1, "a feed per revolution while the spindle stands");
    return {mode == 95 ? value * rpm : value, inverse_time()};
  }
};

/// All that moves in a program passes here, compensated or not. One move is held back, because a concave corner to the
/// next shortens it; what the program says meanwhile waits behind it.
class CutterCompensation {
 public:
  /// Who begins and ends `in_plane` does so with the next move in the plane: moves across it before leave the cutter
  /// beside its path. LinuxCNC takes any move.
  CutterCompensation(ReaderCore& core, bool in_plane) : core_(core), in_plane_only_(in_plane) {}

  /// From here on the centre keeps `radius_mm` to the left (side 1) or right (-1) of the contour in the plane u, v.
  void start(int side, double radius_mm, int u, int v, const AxisValues& from);
  /// The same in X and Y for a machine that stands already as the next move wants it: square to its beginning, which is
  /// at `contour`.
  void start_beside(int side, double radius_mm, const AxisValues& contour);
  /// Lets go what was held back. The machine stands beside programmed() by the radius.
  void stop();
  /// G40: the next move, which must be straight, leaves from there.
  void leave();
  [[nodiscard]] bool on() const { return side_ != 0; }
  [[nodiscard]] bool entered() const { return on() && !entering_; }
  [[nodiscard]] int side() const { return side_; }
  [[nodiscard]] double radius_mm() const { return radius_; }

  /// The contour's last point, and the centre's place beside it.
  [[nodiscard]] const AxisValues& programmed() const { return programmed_; }
  [[nodiscard]] const AxisValues& centre() const { return centre_; }

  /// Where the program means to stand.
  [[nodiscard]] AxisValues place() const;
  /// From where the machine stands to there: none but between leave() and the move that follows.
  [[nodiscard]] const AxisValues& lead() const { return lead_; }
  void forget_lead() { lead_ = {}; }
  void allow_arcs() { arc_refused_ = false; }

  /// In program coordinates; an arc as in ReaderCore.
  void straight(const AxisValues& to, bool rapid, const Feed& feed);
  void arc(const AxisValues& to, int u, int v, double centre_u, double centre_v, double turn_rad, const Feed& feed);
  /// Either of them, at its feed per minute; an arc in the plane u, v.
  void follow(const ContourMove& move, int u, int v);
  /// Behind the move that is held back.
  void say(ProgramStep::Kind kind, int number, double value = 0);
  void flush();

 private:
  struct Point {
    double u, v;
  };
  struct Held {
    bool moves = true;
    ContourMove move;      ///< of the centre; its arc's turn gives the sense only
    double sweep_rad = 0;  ///< of the programmed arc
    int extra_turns = 0;
    Point direction{};  ///< of the programmed line
    bool entry = false;
    long line = 0;
    ProgramStep::Kind kind{};
    int number = 0;
    double value = 0;
  };
  void move(const ContourMove& move);
  [[nodiscard]] bool stays_in_plane(const AxisValues& to) const {
    const AxisValues from = place();
    return to[u_] == from[u_] && to[v_] == from[v_];
  }
  [[nodiscard]] Point in_plane(const AxisValues& p) const { return {p[u_], p[v_]}; }
  void enter(const ContourMove& move, Held next);
  void turn_corner(const ContourMove& move, const Held& next);
  [[nodiscard]] Point trimmed(const Held& before, const Held& next, Point corner, Point ahead) const;
  void end_at(Point p);
  void hold(Held next);

  ReaderCore& core_;
  bool in_plane_only_;
  int side_ = 0;
  double radius_ = 0;
  std::size_t u_ = 0, v_ = 1;
  bool entering_ = false;
  AxisValues programmed_{}, centre_{}, lead_{};
  bool arc_refused_ = false;   ///< by the move after leave()
  std::optional<Point> from_;  ///< where the move held back begins
  std::vector<Held> held_;
};

}  // namespace lightmill::detail
