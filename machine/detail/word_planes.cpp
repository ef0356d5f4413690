// Fanuc's tilted working planes and tool directions by vectors.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

/// G68.2 X Y Z I J K: a plane by Euler angles about Z, the new X and the new Z; G69 ends it.
void WordReader::take_plane(int tenths) {
  if (tenths == 690) return core_.set_frame({}, false);
  if (core_.tilted()) reject(1, "G68.2 while a tilted plane is on");
  if (core_.tcp()) reject(1, "G68.2 while tool-centre-point control is on");
  if (has('P') && use('P') != 0) reject(column_of('P'), "G68.2 is understood with Euler angles, P0");
  WorkFrame frame;
  for (int i = 0; i < 3; ++i) {
    const char letter = static_cast<char>('X' + i);
    if (has(letter)) frame.origin_mm[i] = use(letter) * unit_;
  }
  double angles[3] = {};
  for (int i = 0; i < 3; ++i) {
    const char letter = static_cast<char>('I' + i);
    if (has(letter)) angles[i] = use(letter) * kRadPerDegree;
  }
  frame.turn = turn_about(2, angles[0]) * turn_about(0, angles[1]) * turn_about(2, angles[2]);
  core_.set_frame(frame, true);
}

/// G53.1: the rotary axes turn the tool square to the plane; P1 and P2 want the outer angle not below or not above
/// zero.
void WordReader::turn_to_plane() {
  if (!core_.tilted() || core_.tcp()) reject(1, "G53.1 needs a plane of G68.2 and no tool-centre-point control");
  const double p = has('P') ? use('P') : 0;
  if (p != 0 && p != 1 && p != 2) reject(column_of('P'), "G53.1 takes P0, P1 or P2");
  const RotaryAngles angles = core_.angles_for(Vec3::UnitZ(), 1, [&](const RotaryAngles& a) {
    return p == 0 || (p == 1 ? a.outer_rad >= -kSameAngle_rad : a.outer_rad <= kSameAngle_rad);
  });
  AxisValues to = core_.here();
  to[3] = angles.outer_rad;
  to[4] = angles.inner_rad;
  core_.move(to, true, 0);
}

/// G43.5: I, J and K are the direction of the tool at the block's end.
void WordReader::turn_to_direction(AxisValues& to) {
  if (!has('I') && !has('J') && !has('K')) return;
  Vec3 direction = Vec3::Zero();
  int column = 1;
  for (int i = 0; i < 3; ++i) {
    const char letter = static_cast<char>('I' + i);
    if (!has(letter)) continue;
    column = column_of(letter);
    direction[i] = use(letter);
  }
  if (to[3] != path_.place()[3] || to[4] != path_.place()[4]) reject(column, "a tool direction beside a rotary axis");
  const RotaryAngles angles = core_.angles_for(direction, column, [](const RotaryAngles&) { return true; });
  to[3] = angles.outer_rad;
  to[4] = angles.inner_rad;
}

void WordReader::refuse_in_tilted_plane(const Request& request) const {
  if (!core_.tilted()) return;
  const char* what = request.shot == 100                          ? "G10"
                     : request.shot == 520                        ? "G52"
                     : request.shot == 920 || request.shot == 921 ? "G92"
                     : request.offset >= 0                        ? "a change of the work offset"
                     : request.change                             ? "a tool change"
                                                                  : nullptr;
  if (what != nullptr) reject(1, std::string(what) + " while a tilted plane is on");
}

}  // namespace lightmill::detail
