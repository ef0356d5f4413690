// Whatever comes over the wire, the machine answers and stays whole.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "machine_rig.h"

namespace lightmill {
namespace {

// Seeded mutations of a conversation, real-time bytes among them, in pieces of any length: every motion is a number,
// answers stay in proportion, and a reset brings the machine back.
TEST(MachineProtocol, SurvivesMutatedBytes) {
  const std::string conversation =
      "$I\n?$X\nG21 G90 G94 G17 G54\nT1 M6\n~G43.1 Z80\nS20000 M3\nG4 P8\nG53 G0 Z0\nG0 X1 B10 C20\nG93 G1 X2 Y3 B11 "
      "C21 F20\n"
      "!~G94 G2 X2 Y3 I1 J0 F500\n?M0\n~$C\nG1 X1\n$C\n$$\n$#\n$G\nM5 M9\nM2\n";
  const MachineModel machine = test::skew_machine();
  long motions = 0;
  for (unsigned seed = 1; seed <= 150; ++seed) {
    std::mt19937 random(seed);
    std::string bytes = conversation;
    for (unsigned n = random() % 12; n > 0; --n) {
      const std::size_t at = random() % bytes.size();
      switch (random() % 4) {
        case 0:
          bytes[at] = static_cast<char>(random());
          break;
        case 1:
          bytes.erase(at, random() % 9 + 1);
          break;
        case 2:
          bytes.insert(at, bytes.substr(random() % bytes.size(), random() % 30));
          break;
        default:
          bytes.insert(at, 1, "?!~\x18\x84\x85\x90\x91\n0123456789."[random() % 20]);
          break;
      }
      if (bytes.empty()) bytes = "?";
    }
    SimulationOptions options = test::no_stock();
    options.personality = seed % 2 == 0 ? Personality::kGrbl : Personality::kGrblHal;
    SimulatedMachine simulated(machine, test::skew_setup(), options);
    simulated.on_motion = [&](const Motion& motion, const std::vector<SweptMove>&) {
      const JointPosition& q = motion.to;
      ++motions;
      for (const double v : {q.x_mm, q.y_mm, q.z_mm, q.outer_rad, q.inner_rad}) ASSERT_TRUE(std::isfinite(v)) << seed;
    };
    simulated.start();
    std::size_t said = simulated.take_replies().size();
    for (std::size_t at = 0; at < bytes.size();) {
      const std::size_t piece = 1 + random() % 40;
      simulated.receive(std::string_view(bytes).substr(at, piece));
      simulated.work(3);
      if (random() % 3 == 0) simulated.receive("~");  // the operator goes on behind M0 and M6
      said += simulated.take_replies().size();
      at += piece;
    }
    EXPECT_LT(said, 5000 * bytes.size()) << seed;
    simulated.receive("\x18");
    simulated.work(100);
    EXPECT_NE(simulated.take_replies().find("rbl"), std::string::npos) << "the banner, seed " << seed;
  }
  EXPECT_GT(motions, 100);
}

// A block that would turn an axis without end is refused before its pieces fill the memory.
TEST(MachineProtocol, EndlessTurnsAreRefused) {
  SimulatedMachine machine(test::skew_machine(), test::skew_setup(), test::no_stock());
  machine.start();
  machine.receive("G0 C99999999999\n");
  machine.work(1);
  EXPECT_NE(machine.take_replies().find("error:33"), std::string::npos);
}

}  // namespace
}  // namespace lightmill
