// A hundred kinds of faults, one at a time, in a small finishing program or on the shop floor: what the dry run says to each.
// Those that it cannot see are listed with the reason.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <set>

#include "design/core/text.h"
#include "machine/program_run.h"
#include "postproc/program.h"
#include "tests/machine/readme_table.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

constexpr const char* kBegin = "<!-- planted faults: written by tests/machine/planted_faults_test.cpp -->\n";
constexpr const char* kEnd = "<!-- end of planted faults -->";
constexpr double kPitch_mm = 0.4;
/// The dry run's bar for gouges and cusps.
constexpr double kDeviation_mm = 1e-3;

struct World {
  std::vector<std::string> lines;
  MachineModel machine;
  OperatorSetup setup;
};

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

World clean_world() {
  World world;
  world.machine = test::hostile_machine();
  world.machine.controller = "linuxcnc";
  const WorkSetup work = work_on_table(world.machine, {23, -17, 30}, 54);
  ProgramOptions options;
  options.decimals = 4;
  const ToolPath path = test::fixed_rows(15 * test::kDeg, 70 * test::kDeg, 2, 6, 16);
  const std::string text = write_program(world.machine, work, plan_motion(world.machine, work, path), options).text;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = text.find('\n', at);
    if (text[at] != '(') world.lines.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  Cutter mill = test::ball();
  mill.name = "6 mm mill";
  mill.number = 1;
  mill.diameter_mm = 6;
  mill.corner_radius_mm = 0;
  mill.length_mm = 95;
  Cutter ball = test::ball();
  ball.feed_per_tooth_mm = 0.03;  // twice the program's
  world.setup.cutters = {mill, ball};
  world.setup.blank.size_mm = {30, 26};
  world.setup.blank.height_mm = 15;
  world.setup.workpiece_origin_mm = work.origin_mm;
  return world;
}

// --- Edits ---

using Edit = std::function<void(World&)>;

std::size_t line_with(const World& world, const std::string& what, std::size_t from = 0) {
  for (std::size_t i = from; i < world.lines.size(); ++i) {
    if (world.lines[i].find(what) != std::string::npos) return i;
  }
  throw std::runtime_error("no line has '" + what + "'");
}

/// The k-th cutting block of the first row.
std::size_t cut(const World& world, std::size_t k) { return line_with(world, "F1080") + k; }

Edit replace(const std::string& from, const std::string& to) {
  return [=](World& world) {
    std::string& line = world.lines[line_with(world, from)];
    line.replace(line.find(from), from.size(), to);
  };
}
Edit replace_all(const std::string& from, const std::string& to) {
  return [=](World& world) {
    line_with(world, from);
    for (std::string& line : world.lines) {
      for (std::size_t at = line.find(from); at != std::string::npos; at = line.find(from, at + to.size())) line.replace(at, from.size(), to);
    }
  };
}
Edit drop(const std::string& what) {
  return [=](World& world) { world.lines.erase(world.lines.begin() + static_cast<long>(line_with(world, what))); };
}
Edit drop_cut(std::size_t k, std::size_t count = 1) {
  return [=](World& world) {
    const auto at = world.lines.begin() + static_cast<long>(cut(world, k));
    world.lines.erase(at, at + static_cast<long>(count));
  };
}

/// Changes the words of a letter; `in` chooses the lines.
void change_words(World& world, char letter, const std::function<std::string(double, const std::string&)>& change,
                  const std::function<bool(std::size_t)>& in) {
  const std::size_t begin = line_with(world, "G43") + 1;
  for (std::size_t i = begin; i < world.lines.size(); ++i) {
    if (!in(i) || world.lines[i].find("G53") != std::string::npos) continue;
    std::string& line = world.lines[i];
    const std::size_t at = line.find(letter);
    if (at == std::string::npos) continue;
    const std::size_t end = std::min(line.find(' ', at), line.size());
    const std::string number = line.substr(at + 1, end - at - 1);
    line.replace(at, end - at, change(std::strtod(number.c_str(), nullptr), number));
  }
}
Edit everywhere(char letter, const std::function<double(double)>& change) {
  return [=](World& world) {
    change_words(world, letter, [&](double v, const std::string&) { return std::string(1, letter) + compact(change(v), 4); },
                 [](std::size_t) { return true; });
  };
}
Edit once(char letter, const std::function<std::string(double, const std::string&)>& change) {
  return [=](World& world) {
    const std::size_t at = cut(world, 1);
    change_words(world, letter, change, [&](std::size_t i) { return i == at; });
  };
}
Edit once_number(char letter, const std::function<double(double)>& change) {
  return once(letter, [=](double v, const std::string&) { return std::string(1, letter) + compact(change(v), 4); });
}

struct Planted {
  std::string what;
  Edit edit;
  std::string cannot;  ///< why it is not caught; empty: it must be
};

std::vector<Planted> planted() {
  std::vector<Planted> all;
  const auto add = [&](const std::string& what, Edit edit, const std::string& cannot = "") {
    all.push_back({what, std::move(edit), cannot});
  };
  const std::string same = "the same way of the tip";
  // Axis words.
  for (const char axis : {'X', 'Y', 'Z', 'B', 'C'}) {
    const std::string a(1, axis);
    add(a + ": sign flipped everywhere", everywhere(axis, [](double v) { return -v; }));
    add(a + ": " + (axis < 'X' ? "1 degree" : "0.1 mm") + " off everywhere", everywhere(axis, [&, axis](double v) { return v + (axis < 'X' ? 1 : 0.1); }));
    add(a + ": a thousandth too long", everywhere(axis, [](double v) { return v * 1.001; }));
  }
  for (const char axis : {'X', 'Y', 'Z'}) {
    const std::string a(1, axis);
    add(a + ": sign flipped in one block", once_number(axis, [](double v) { return -v; }));
    add(a + ": one block 10 times as far", once_number(axis, [](double v) { return 10 * v; }));
    add(a + ": one block a tenth as far", once_number(axis, [](double v) { return v / 10; }));
    add(a + ": 0.02 mm off in one block", once_number(axis, [](double v) { return v + 0.02; }));
    add(a + ": comma for point", once(axis, [=](double, std::string n) {
          n[n.find('.')] = ',';
          return a + n;
        }));
    add(a + ": point lost", once(axis, [=](double, std::string n) {
          n.erase(n.find('.'), 1);
          return a + n;
        }));
    add(a + ": two points", once(axis, [=](double, const std::string& n) { return a + n + "."; }));
    add(a + ": letter O for a zero", once(axis, [=](double, const std::string& n) { return a + n + "O"; }));
    add(a + ": digits swapped", once(axis, [=](double, std::string n) {
          const std::size_t at = n.find('.');
          std::swap(n[at - 1], n[at + 1]);
          return a + n;
        }));
    add(a + ": word lost in one block", once(axis, [](double, const std::string&) { return std::string(); }));
    add(a + ": word twice in a block", once(axis, [=](double, const std::string& n) { return a + n + " " + a + n; }));
    add(a + ": number lost", once(axis, [=](double, const std::string&) { return a; }));
  }
  add("X and Y swapped", [](World& w) {
    for (std::size_t i = line_with(w, "G43") + 1; i < w.lines.size(); ++i) {
      for (char& c : w.lines[i]) c = c == 'X' ? 'Y' : c == 'Y' ? 'X' : c;
    }
  });
  add("an axis that the machine has not got", once('X', [](double, const std::string& n) { return "A" + n; }));
  add("a letter for nothing", once('X', [](double, const std::string& n) { return "W" + n; }));
  // Blocks.
  add("a cutting block lost", drop_cut(1));
  add("three cutting blocks lost", drop_cut(1, 3));
  add("the first cutting block lost", drop_cut(0));
  add("the way down lost", drop("G1 "));
  add("the plunge lost", [](World& w) { w.lines.erase(w.lines.begin() + static_cast<long>(cut(w, 0)) - 1); });
  add("the way up after a row lost", [](World& w) { w.lines.erase(w.lines.begin() + static_cast<long>(cut(w, 6))); },
      "the rapid after it leads up the same way");
  add("a block twice", [](World& w) { w.lines.insert(w.lines.begin() + static_cast<long>(cut(w, 2)), w.lines[cut(w, 2)]); }, same);
  add("two blocks swapped", [](World& w) { std::swap(w.lines[cut(w, 2)], w.lines[cut(w, 3)]); });
  add("a row backwards", [](World& w) {
    const auto at = w.lines.begin() + static_cast<long>(cut(w, 1));
    std::reverse(at, at + 4);
  });
  add("feed down instead of rapid", replace("G1 X", "X"));
  add("rapid into the cut", replace("F1080", "F1080 G0"));
  add("safe height first lost", [](World& w) { w.lines.erase(w.lines.begin() + static_cast<long>(line_with(w, "G43")) - 1); }, "Z stands at the top already");
  add("the turn of B and C lost", drop("B15 C70"));
  add("the turn comes after the way down", [](World& w) {
    const std::size_t at = line_with(w, "B15 C70");
    std::rotate(w.lines.begin() + static_cast<long>(at), w.lines.begin() + static_cast<long>(at) + 1, w.lines.begin() + static_cast<long>(at) + 4);
  });
  // Modes.
  add("inches", replace("G21", "G20"));
  add("G21 lost", replace("G21 ", ""), "the control starts in mm");
  add("incremental", replace("G90", "G91"));
  add("G90 lost", replace("G90 ", ""), "the control starts with absolute words");
  add("wrong work offset", replace("G54", "G55"));
  add("G54 lost", replace("G54 ", ""), "the control starts in G54");
  add("inverse time without F", replace("G94", "G93"));
  add("wrong plane", replace("G17", "G18"), "planes matter to arcs and cycles only");
  add("G43 missing", drop("G43 H3"));
  add("length of another tool", replace("G43 H3", "G43 H1"));
  add("length of a tool that is not there", replace("G43 H3", "G43 H7"));
  add("G43 without H", replace("G43 H3", "G43"), "it means the tool in the spindle");
  add("G49 lost at the end", drop("G49"), "nothing moves after it");
  add("G53 lost before the tool change", replace("G53 G0 X", "G0 X"), "the tool is changed elsewhere, in free air");
  add("G53 lost at the end", [](World& w) {
    std::string& line = w.lines[line_with(w, "G53", cut(w, 0))];
    line.replace(line.find("G53 "), 4, "");
  });
  add("corners rounded by 2 mm (G64 P2)", replace("P0.002", "P2"));
  add("G64 lost", replace(" G64 P0.002", ""), "the control blends as it likes, which plain G64 asks for, too; the stock sees corners sharp");
  add("cutter compensation on", replace("G40", "G41 D3"));
  add("a cycle that is not known", replace("G80", "G88"));
  add("an unknown G code", replace("G80", "G187"));
  // Spindle, tool, feed.
  add("M3 lost", replace(" M3", ""));
  add("spindle the wrong way", replace("M3", "M4"));
  add("spindle off early", [](World& w) { w.lines.insert(w.lines.begin() + static_cast<long>(cut(w, 2)), "M5"); });
  add("S lost", replace("S36000 ", ""));
  add("S0", replace("S36000", "S0"));
  add("no wait for the spindle", drop("G4 P8"));
  add("too short a wait", replace("G4 P8", "G4 P.08"));
  add("wrong tool", replace("T3 M6", "T1 M6"));
  add("wrong tool with its own length", [](World& w) {
    replace("T3 M6", "T1 M6")(w);
    replace("G43 H3", "G43 H1")(w);
  });
  add("tool change lost", drop("T3 M6"));
  add("M6 lost", replace("T3 M6", "T3"));
  add("a tool that is not there", replace("T3 M6", "T8 M6"));
  add("feed 10 times as high", replace_all("F1080", "F10800"));
  add("feed a tenth", replace_all("F1080", "F108"), same + ", only slower; a run folder's minutes are held against the plan");
  add("feed lost in the first block", replace(" F4800", ""));
  add("air off (M7 lost)", drop("M7"), "chips and heat are not simulated");
  // The file.
  add("cut off within a block", [](World& w) {
    w.lines.resize(cut(w, 3) + 1);
    w.lines.back().resize(w.lines.back().size() / 2);
  });
  add("cut off after a block", [](World& w) { w.lines.resize(cut(w, 3)); });
  add("cut off after the last cut", [](World& w) { w.lines.resize(line_with(w, "M5 M9")); });
  add("M30 lost", drop("M30"), "the closing % ends a program, too; the spindle is off by then");
  add("M30 and % lost", [](World& w) { w.lines.resize(line_with(w, "M30")); });
  add("M30 in the middle", [](World& w) { w.lines.insert(w.lines.begin() + static_cast<long>(cut(w, 3)), "M30"); });
  add("empty", [](World& w) { w.lines.clear(); });
  add("twice in one file", [](World& w) {
    const auto once_more = w.lines;
    w.lines.insert(w.lines.end(), once_more.begin(), once_more.end());
  });
  add("a control character", [](World& w) { w.lines[cut(w, 2)].insert(1, 1, '\x01'); });
  add("a byte above 127", [](World& w) { w.lines[cut(w, 2)][2] = static_cast<char>(w.lines[cut(w, 2)][2] | 0x80); });
  add("a line of 300 characters", [](World& w) { w.lines[cut(w, 2)] += std::string(300, ' '); });
  add("a comment that does not end", [](World& w) { w.lines[cut(w, 2)] += " (cut"; });
  add("a comment swallows a word", [](World& w) { w.lines[cut(w, 1)].insert(0, "(").append(")"); });
  add("a block skipped (/)", [](World& w) { w.lines[cut(w, 1)].insert(0, "/"); });
  add("line feeds lost", [](World& w) {
    w.lines[cut(w, 2)] += " " + w.lines[cut(w, 3)];
    w.lines.erase(w.lines.begin() + static_cast<long>(cut(w, 3)));
  });
  // The shop floor.
  add("zero 0.1 mm too high", [](World& w) { w.setup.workpiece_origin_mm.z() += 0.1; });
  add("blank 25 mm too high", [](World& w) { w.setup.blank.height_mm += 25; });
  add("the other offset zeroed", [](World& w) { w.setup.work_offset = 55; });
  add("ball 0.1 mm too large", [](World& w) {
    w.setup.cutters[1].diameter_mm += 0.1;
    w.setup.cutters[1].corner_radius_mm += 0.05;
  });
  add("a flat mill in the ball's place", [](World& w) { w.setup.cutters[1].corner_radius_mm = 0; });
  add("a holder that is too low", [](World& w) { w.setup.cutters[1].holder.front().from_mm = 3; });
  add("a clamp in the way", [](World& w) { w.setup.blank.keep_outs.push_back({{-4, -12, 0}, {4, 12, 16}}); });
  add("outer axis turns the other way", [](World& w) { w.machine.outer.direction *= -1; });
  add("inner axis turns the other way", [](World& w) { w.machine.inner.direction *= -1; });
  add("outer pivot 0.5 mm off", [](World& w) { w.machine.outer.point_mm.x() += 0.5; });
  add("inner pivot 0.5 mm off", [](World& w) { w.machine.inner.point_mm.y() += 0.5; });
  add("a shorter X travel", [](World& w) { w.machine.x.min_mm = -52; });
  add("a shorter B travel", [](World& w) { w.machine.outer.max_rad = 10 * test::kDeg; });
  add("a machine with A for B", [](World& w) { w.machine.outer.letter = 'A'; });
  return all;
}

/// What the dry run says: kinds of faults, then whether the surface is another one.
std::string verdict(const World& world, const MachinedSurface* clean, MachinedSurface* out = nullptr) {
  StockOptions stock;
  stock.pitch_mm = kPitch_mm;
  const ProgramRun run = run_programs(world.machine, ReaderDialect::kLinuxCnc, world.setup, {{"30_finish.ngc", joined(world.lines)}}, stock);
  std::set<std::string> kinds;
  for (const Fault& fault : run.faults) kinds.insert(fault.kind);
  if (clean != nullptr && clean->heights_mm.values.size() == run.surface.heights_mm.values.size()) {
    double deepest = 0, highest = 0;
    for (std::size_t i = 0; i < clean->heights_mm.values.size(); ++i) {
      const double off = run.surface.heights_mm.values[i] - clean->heights_mm.values[i];
      deepest = std::min(deepest, off);
      highest = std::max(highest, off);
    }
    if (deepest < -kDeviation_mm) kinds.insert("gouge");
    if (highest > kDeviation_mm) kinds.insert("material left");
  }
  if (out != nullptr) *out = run.surface;
  std::string text;
  for (const std::string& kind : kinds) text += (text.empty() ? "" : ", ") + kind;
  return text;
}

TEST(PlantedInPrograms, AreCaughtOrListedWithTheReason) {
  const World clean = clean_world();
  MachinedSurface surface;
  ASSERT_EQ(verdict(clean, nullptr, &surface), "");
  ASSERT_EQ(verdict(clean, &surface), "");

  const std::vector<Planted> all = planted();
  EXPECT_GE(all.size(), 100U);
  std::set<std::string> names;
  std::string caught, uncaught;
  int caught_count = 0;
  for (const Planted& fault : all) {
    EXPECT_TRUE(names.insert(fault.what).second) << fault.what << " is listed twice";
    World world = clean;
    fault.edit(world);
    const std::string found = verdict(world, &surface);
    if (fault.cannot.empty()) {
      EXPECT_NE(found, "") << fault.what << " was not caught";
      caught += "| " + fault.what + " | " + found + " |\n";
      ++caught_count;
    } else {
      EXPECT_EQ(found, "") << fault.what << " is caught: take it off the list of those that are not";
      uncaught += "| " + fault.what + " | " + fault.cannot + " |\n";
    }
  }
  const std::string table = std::string(kBegin) + std::to_string(caught_count) + " of " + std::to_string(all.size()) +
                            " are caught, by:\n\n| planted | the dry run's faults |\n|---|---|\n" + caught +
                            "\nThe others are not, because:\n\n| planted | why not |\n|---|---|\n" + uncaught + kEnd;
  test::expect_in_readme("machine/README.md", kBegin, kEnd, table);
}

}  // namespace
}  // namespace lightmill
