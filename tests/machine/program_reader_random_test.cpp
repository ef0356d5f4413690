// Random programs of what is hard to read, by our reader and by LinuxCNC's rs274: the same motion, and the same end.
// Skipped where LinuxCNC is not installed.
// LIGHTMILL_PROGRAMS=1000 reads more of them.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "design/core/text.h"
#include "machine_rig.h"
#include "rs274.h"

namespace lightmill {
namespace {

using test::CanonMove;

// rs274 prints four decimals; where two paths meet at a small angle, they decide less.
constexpr double kEnd_mm = 5e-3, kMiddle_mm = 1e-2, kFeed = 1e-2;

struct Dice {
  std::mt19937 random;
  double any(double least, double most) { return std::uniform_real_distribution<>(least, most)(random); }
  int pick(int n) { return std::uniform_int_distribution<>(0, n - 1)(random); }
  std::string one_of(std::initializer_list<const char*> words) {
    return words.begin()[pick(static_cast<int>(words.size()))];
  }
};

/// Moves that go somewhere.
std::vector<CanonMove> going(const std::vector<CanonMove>& moves) {
  std::vector<CanonMove> out;
  Vec3 at = Vec3::Zero();
  for (const CanonMove& move : moves) {
    if (move.length > 5e-3 || (move.to - at).norm() > 5e-3) out.push_back(move);
    at = move.to;
  }
  return out;
}

/// What the two make differently; empty if nothing.
std::string difference(const test::Rs274& rs274, const std::string& program) {
  ReaderSetup setup;
  for (int n = 1; n <= 55; ++n) {
    setup.tool_length_mm[n] = 0;
    setup.tool_diameter_mm[n] = 4;
  }
  const test::CanonRun theirs = rs274.run(program);
  const test::OwnRun ours = test::read_as_canon(program, test::skew_machine(), setup);
  const auto a = going(ours.moves), b = going(theirs.moves);
  std::ostringstream out;
  const auto told = [&] {
    out << " of\n"
        << program << "\nours: " << (ours.result.error ? ours.result.error->rule : "") << "\ntheirs: " << theirs.error;
    return out.str();
  };
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    const CanonMove &m = a[i], &n = b[i];
    if ((m.to - n.to).norm() > kEnd_mm) out << "ends " << m.to.transpose() << " against " << n.to.transpose();
    if ((m.middle - n.middle).norm() > kMiddle_mm)
      out << ", middles " << m.middle.transpose() << " against " << n.middle.transpose();
    if (m.rapid != n.rapid) out << ", a rapid or not";
    if (!m.rapid && m.length > 0.5 && std::abs(m.feed - n.feed) > kFeed * n.feed)
      out << ", feeds " << m.feed << " against " << n.feed;
    if (out.tellp() > 0) {
      out << ", move " << i + 1;
      return told();
    }
  }
  // What both refuse, rs274 refuses sometimes behind its first moves.
  if (ours.result.error && !theirs.error.empty()) return "";
  if (a.size() != b.size() || ours.result.error.has_value() == theirs.error.empty()) {
    out << a.size() << " moves against " << b.size();
    return told();
  }
  if (ours.calls != theirs.calls) {
    out << "dwells, stops and the spindle's starts:";
    for (const std::string& said : ours.calls) out << " " << said;
    out << " against";
    for (const std::string& said : theirs.calls) out << " " << said;
    return told();
  }
  return "";
}

/// Many programs of a kind.
template <typename Write>
void expect_agreement(unsigned programs, Write write) {
  if (!test::Rs274::installed()) GTEST_SKIP() << "LinuxCNC is not installed";
  static const test::Rs274 rs274(4);
  if (const char* more = std::getenv("LIGHTMILL_PROGRAMS")) programs = static_cast<unsigned>(std::atoi(more));
  for (unsigned seed = 1; seed <= programs; ++seed) {
    Dice dice{std::mt19937(seed)};
    EXPECT_EQ(difference(rs274, write(dice)), "") << "seed " << seed;
  }
}

std::string word(char letter, double v) {
  return letter + fixed(v, 4);
}

// Contours under G41 and G42 in both planes: lines, arcs either way, rapids, moves along the cutter, full circles,
// dwells between; corners of any angle, many of them too narrow.
std::string compensated_contour(Dice& dice) {
  const auto any = [&](double a, double b) { return dice.any(a, b); };
  const auto pick = [&](int n) { return dice.pick(n); };
  const bool xz = pick(4) == 0;
  const char u = xz ? 'Z' : 'X', v = xz ? 'X' : 'Y', w = xz ? 'Y' : 'Z', iu = xz ? 'K' : 'I', iv = xz ? 'I' : 'J';
  std::string program = std::string("G21 G64 F300 T1 M6\n") + (xz ? "G18" : "G17") + "\nG0 " + u + "0 " + v + "0\n";
  double pu = 0, pv = 0, heading = any(-3, 3);
  program += dice.one_of({"G41", "G42", "G41.1 D3", "G42.1 D5"}) + "\n";
  if (pick(3) == 0) program += "G93\n";
  const bool inverse = program.ends_with("G93\n");
  const int moves = 1 + pick(6);
  for (int i = 0; i < moves; ++i) {
    const int kind = pick(12);
    if (i > 0) heading += pick(5) == 0 ? any(-3.1, 3.1) : any(-1.2, 1.2);
    std::string block;
    if (kind < 5 || (kind < 7 && i == 0)) {  // a line
      const double length = any(2.5, 20);
      pu += length * std::cos(heading);
      pv += length * std::sin(heading);
      block = (kind == 0 ? "G0 " : "G1 ") + word(u, pu) + " " + word(v, pv);
    } else if (kind < 7) {  // across
      block = "G1 " + word(w, any(-5, 5));
    } else if (kind == 7) {
      block = "G4 P0.5";
    } else {  // an arc whose tangent starts at the heading
      const bool clockwise = pick(2) == 0;
      const double radius = i == 0 ? any(6, 15) : any(1, 15),
                   sweep = kind == 8 && i > 0 ? 2 * kPi : any(i == 0 ? 1 : 0.3, 5), side = clockwise ? -1 : 1;
      const double cu = pu - side * radius * std::sin(heading), cv = pv + side * radius * std::cos(heading);
      block = (clockwise ? "G2 " : "G3 ");
      const double from_u = pu, from_v = pv, angle = std::atan2(pv - cv, pu - cu) + side * sweep;
      if (kind != 8 || i == 0) {
        pu = cu + radius * std::cos(angle);
        pv = cv + radius * std::sin(angle);
        heading += side * sweep;
      }
      block += word(u, pu) + " " + word(v, pv) + " ";
      if (kind == 9 && sweep < 2.8)
        block += word('R', radius);
      else
        block += word(iu, cu - from_u) + " " + word(iv, cv - from_v);
    }
    program += block + (inverse ? " F" + fixed(any(1, 30), 2) : "") + "\n";
  }
  program += "G94 F200 G40\n";
  program += dice.one_of({"G1 X40 Y30 Z20\n", "G0 Z5\n", "G3 X1 Y1 R40\n", ""});
  return program + "M2\n";
}

// Holes in every plane: all cycles, absolute and incremental, sticky words, repeats, both retracts, inches.
std::string holes(Dice& dice) {
  const auto any = [&](double a, double b) { return dice.any(a, b); };
  const auto pick = [&](int n) { return dice.pick(n); };
  const int plane = pick(3);
  const char u = "XZY"[plane], v = "YXZ"[plane], w = "ZYX"[plane];
  std::string program = "G21 F300 T1 M6 S500 " + dice.one_of({"M3", "M4", "M3", ""}) + "\n" +
                        dice.one_of({"G17", "G18", "G19"}).substr(0, 2) + "789"[plane] + "\nG0 X1 Y2 Z3\n" +
                        dice.one_of({"", "G20 F20\n"}) + dice.one_of({"G98\n", "G99\n", ""});
  const int blocks = 1 + pick(6);
  std::string cycle;
  for (int i = 0; i < blocks; ++i) {
    if (pick(5) == 0) program += dice.one_of({"G90\n", "G91\n", "G98\n", "G99\n"});
    const bool fresh = i == 0 || pick(3) == 0;
    if (fresh && plane != 0) cycle = dice.one_of({"G73", "G81", "G82", "G83", "G85", "G86", "G87", "G89"});
    if (fresh && plane == 0) cycle = dice.one_of({"G73", "G74", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G89"});
    std::string block = fresh ? cycle : "";
    const auto maybe = [&](int often, char letter, double value) {
      if (fresh ? pick(20) > 0 : pick(often) == 0) block += " " + word(letter, value);
    };
    if (fresh ? pick(10) > 0 : true) block += " " + word(u, any(-9, 9));
    maybe(2, v, any(-9, 9));
    maybe(4, w, any(-8, 0.5));
    maybe(4, 'R', any(0, 5));
    if (cycle == "G73" || cycle == "G83") maybe(3, 'Q', any(0.4, 3));
    if (cycle == "G82" || cycle == "G86" || cycle == "G89" || cycle == "G74" || cycle == "G84")
      maybe(3, 'P', any(0.1, 2));
    if (cycle == "G87") {
      maybe(3, 'I', any(-1, 1));
      maybe(3, 'J', any(-1, 1));
      maybe(3, 'K', any(-3, 1));
    }
    if (cycle != "G74" && pick(4) == 0) block += " L" + std::to_string(1 + pick(3));
    program += block + "\n";
    if (pick(8) == 0) program += dice.one_of({"G80\n", "G1 X3 Y4 Z5\n"});
  }
  return program + "M2\n";
}

TEST(ProgramReaderRandom, CannedCycles) {
  expect_agreement(25, holes);
}

// Arcs and helices in every plane by centre and by radius, of several turns, in inches and G91, G90.1, by inverse time;
// some with ends that do not fit.
std::string arcs(Dice& dice) {
  const auto any = [&](double a, double b) { return dice.any(a, b); };
  const auto pick = [&](int n) { return dice.pick(n); };
  std::string program = "G21 F300\n" + dice.one_of({"", "G20 F20\n"});
  program += dice.one_of({"G90.1\n", "", "G93\n"});
  const bool absolute = program.find("G90.1") != std::string::npos, inverse = program.find("G93") != std::string::npos;
  bool incremental = false;
  double p[3] = {};
  for (int n = 1 + pick(6); n > 0; --n) {
    const int plane = pick(3);
    const int axes[3][3] = {{0, 1, 2}, {2, 0, 1}, {1, 2, 0}};
    const int u = axes[plane][0], v = axes[plane][1], w = axes[plane][2];
    if (pick(4) == 0) {
      incremental = !incremental;
      program += incremental ? "G91\n" : "G90\n";
    }
    const bool clockwise = pick(2) == 0;
    const double radius = any(0.5, 20), start = any(-3, 3),
                 sweep = (clockwise ? -1 : 1) * (pick(5) == 0 ? 2 * kPi : any(0.2, 6));
    const double cu = p[u] - radius * std::cos(start), cv = p[v] - radius * std::sin(start);
    double to[3] = {p[0], p[1], p[2]};
    to[u] = cu + radius * std::cos(start + sweep);
    to[v] = cv + radius * std::sin(start + sweep);
    if (pick(2) == 0) to[w] += any(-5, 5);
    if (pick(15) == 0) to[u] += any(-1, 1);
    std::string block = std::string("G1") + "789"[plane] + (clockwise ? " G2" : " G3");
    for (int i = 0; i < 3; ++i) {
      if (i != w || to[i] != p[i]) block += " " + word("XYZ"[i], to[i] - (incremental ? p[i] : 0));
    }
    if (pick(3) == 0) {
      block += " " + word('R', std::abs(sweep) > kPi ? -radius : radius);
    } else {
      block += " " + word("IJK"[u], cu - (absolute ? 0 : p[u])) + " " + word("IJK"[v], cv - (absolute ? 0 : p[v]));
    }
    if (pick(4) == 0) block += " P" + std::to_string(1 + pick(3));
    if (inverse) block += " F" + fixed(any(0.5, 20), 3);
    program += block + "\n";
    std::copy(to, to + 3, p);
  }
  return program + "M2\n";
}

TEST(ProgramReaderRandom, Arcs) {
  expect_agreement(25, arcs);
}

TEST(ProgramReaderRandom, CutterCompensation) {
  expect_agreement(30, compensated_contour);
}

}  // namespace
}  // namespace lightmill
