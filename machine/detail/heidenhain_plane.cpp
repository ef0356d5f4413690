// Heidenhain conversational: tilted planes.
#include "machine/detail/heidenhain_reader.h"

namespace lightmill::detail {

/// PLANE SPATIAL SPA SPB SPC and PLANE RESET, with STAY, TURN or MOVE for the rotary axes.
void HeidenhainReader::plane() {
  const int column = tokens_[0].column;
  refuse_beside_compensation("PLANE");
  if (core_.tcp()) reject(column, "PLANE needs M129 before it");
  const bool reset = is(1, "RESET");
  if (!reset && !is(1, "SPATIAL"))
    reject(tokens_[std::min<std::size_t>(1, tokens_.size() - 1)].column, "PLANE is understood with SPATIAL and RESET");
  std::array<std::optional<double>, 3> angles;
  std::string_view how;
  double distance_mm = 0, feed = 0;
  int sequence = 0;
  fmax_ = false;
  for (std::size_t i = 2; i < tokens_.size(); ++i) {
    const Token& token = tokens_[i];
    const std::string_view text = token.text;
    if (!reset && text.starts_with("SP") && text.size() > 3 && text[2] >= 'A' && text[2] <= 'C') {
      angles[static_cast<std::size_t>(text[2] - 'A')] = number(text.substr(3), token.column) * kRadPerDegree;
    } else if (text == "MOVE" || text == "TURN" || text == "STAY") {
      how = text;
    } else if (text.starts_with("DIST") || text.starts_with("ABST")) {
      distance_mm = number(text.substr(4), token.column) * unit_;
    } else if (text == "FMAX") {
      fmax_ = true;
    } else if (text == "SEQ+" || text == "SEQ-") {
      sequence = text[3] == '+' ? 1 : -1;
    } else if (text == "COORD" && is(i + 1, "ROT")) {
      ++i;
    } else if (text[0] == 'F') {
      feed = number(text.substr(1), token.column) * unit_;
      if (!(feed > 0)) reject(token.column, "the feed must be above 0");
    } else {
      expect_end(i);
    }
  }
  if (how.empty()) {
    if (!reset) reject(column, "PLANE SPATIAL needs MOVE, TURN or STAY");
    how = "STAY";
  }
  if (how != "STAY" && !fmax_ && feed == 0) reject(column, "MOVE and TURN need F or FMAX");
  if (!reset && !(angles[0] && angles[1] && angles[2])) reject(column, "PLANE SPATIAL needs SPA, SPB and SPC");
  if (!tilted_shift_.isZero(0)) reject(column, "a datum shift in the tilted plane must be taken back first");
  path_.forget_lead();
  has_heading_ = has_centre_ = false;
  plane_turn_ = reset ? Eigen::Matrix3d::Identity() : turn_xyz(*angles[0], *angles[1], *angles[2]);
  core_.set_frame({plane_turn_, Vec3::Zero()}, !reset);
  RotaryAngles to{0, 0};
  if (!reset) {
    to = core_.angles_for(Vec3::UnitZ(), column, [&](const RotaryAngles& a) {
      return sequence == 0 || a.outer_rad * sequence >= -kSameAngle_rad;
    });
  }
  if (core_.machine.has_rotary()) {  // Q120 to Q122 tell A, B and C
    for (int i = 120; i <= 122; ++i) q_[i] = 0;
    q_[120 + core_.machine.outer.letter - 'A'] = to.outer_rad / kRadPerDegree;
    q_[120 + core_.machine.inner.letter - 'A'] = to.inner_rad / kRadPerDegree;
  }
  if (how != "STAY") turn_to_plane(how, distance_mm, feed, to);
}

/// TURN turns the rotary axes alone. With MOVE the place in the work that is `distance_mm` beyond the tip stays: as if
/// the tool were so much longer under tool-centre-point control.
void HeidenhainReader::turn_to_plane(std::string_view how, double distance_mm, double feed,
                                     const RotaryAngles& angles) {
  const double length = core_.length_mm();
  if (how == "MOVE") {
    core_.set_length(length + distance_mm);
    core_.set_tcp(true);
  }
  AxisValues to = core_.here();
  to[3] = angles.outer_rad;
  to[4] = angles.inner_rad;
  core_.move(to, fmax_, fmax_ ? 0 : core_.seconds_at(to, feed));
  core_.set_tcp(false);
  core_.set_length(length);
}

}  // namespace lightmill::detail
