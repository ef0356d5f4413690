// A whole job, picture to dry run, on every machine that comes with Lightmill and in every dialect, axes fixed and simultaneous.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/cli/command_rig.h"

namespace lightmill {
namespace {

using nlohmann::json;
using test::fixture;
using test::lightmill_command;
using test::replaced;
using test::ScratchFolder;
using test::slurp;
using test::spill;

struct Shop {
  std::string machine, dialect;
  bool tcp;      // the control has tool-centre-point control
  bool untimed;  // no word for a block's time: turning axes need it
  std::string program;
};

const std::vector<Shop> kShops{{"mikron_hsm400u_itnc530", "heidenhain", true, false, "30_FINISH.H"},
                               {"mikron_hsm400u_itnc530", "heidenhain_iso", true, true, "30_FINISH.I"},
                               {"trunnion_linuxcnc", "linuxcnc", true, false, "30_finish.ngc"},
                               {"vmc_ac_fanuc", "fanuc", true, false, "30_finish.nc"},
                               {"head_table_siemens840d", "siemens", true, false, "LM_30_FINISH.MPF"},
                               {"desktop_5axis_grblhal", "grblhal", false, false, "30_finish.nc"},
                               {"router_grblhal", "grblhal", false, false, "30_finish.nc"}};

std::string job_text(const Shop& shop, const std::string& axis, bool tcp, bool arcs) {
  std::string text =
      replaced(slurp(fixture("jobs/tiny.toml")), "../pictures/tiny.png", fixture("pictures/tiny.png").string());
  text = replaced(text, "workpiece_origin_mm = [7, -4, 0]",
                  "file = \"" + fixture("machines/" + shop.machine + ".toml").string() +
                      "\"\nworkpiece_origin_mm = [7, -4, 30]");
  const std::string rpm = "\nspindle_rpm = 12000";  // every spindle here turns so, and tool paths serve several machines
  text = replaced(text, "[rough]", "[rough]" + rpm);
  text = replaced(text, "[semi_finish]", "[semi_finish]\naxis = \"" + std::string(axis == "lead_tilt" ? "fixed" : axis) +
                                             "\"" + rpm);
  text = replaced(text, "[finish]", "[finish]\naxis = \"" + axis + "\"" + rpm);
  return text + "\n[controller]\ndialect = \"" + shop.dialect + "\"\ntcp = \"" + (tcp ? "on" : "off") +
         "\"\narcs = " + (arcs ? "true" : "false") + "\n";
}

TEST(Controllers, EveryMachineAndDialectRunsTheWholeJob) {
  const ScratchFolder folder;
  for (const std::string axis : {"vertical", "fixed", "lead_tilt"}) {
    for (const Shop& shop : kShops) {
      const bool router = shop.machine == "router_grblhal";
      if (router != (axis == "vertical")) continue;
      for (const bool tcp : {false, true}) {
        if ((tcp && !shop.tcp) || (!tcp && shop.untimed && axis == "lead_tilt")) continue;
        if (!tcp && shop.tcp && axis == "fixed" && !shop.untimed && shop.dialect != "linuxcnc") continue;  // to be quick
        const bool arcs = !tcp && (shop.dialect == "grblhal" || shop.dialect == "linuxcnc" || shop.dialect == "fanuc");
        const std::string what = shop.machine + ", " + shop.dialect + ", " + axis + (tcp ? ", tcp" : "");
        spill(folder / "job.toml", job_text(shop, axis, tcp, arcs));
        const auto run = lightmill_command({"make", (folder / "job.toml").string(), "-o", (folder / "out").string()});
        ASSERT_EQ(run.code, 0) << what << ": " << run.err;
        const json report = json::parse(slurp(folder / "out/report.json"));
        const json& finish = report["postproc"]["finish"];
        EXPECT_EQ(finish["dialect"], shop.dialect) << what;
        EXPECT_EQ(finish["tcp"], tcp) << what;
        EXPECT_EQ(finish["file"], "program/" + shop.program) << what;
        EXPECT_LE(finish["max_tip_error_um"], 0.2) << what;
        EXPECT_LE(finish["max_axis_speed_ratio"], 1) << what;
        if (arcs && axis != "lead_tilt") {
          EXPECT_GT(finish["arcs"]["bytes_saved"], 0) << what;
        }
        if (finish["slowed_moves"] > 0) {
          EXPECT_NE(slurp(folder / "out/report.html").find("finish: feeds are lowered in"), std::string::npos) << what;
        }
        EXPECT_EQ(report["dry_run"]["faults"], 0) << what;
        EXPECT_LT(report["dry_run"]["max_gouge_um"], 0.6) << what;
        EXPECT_LT(report["dry_run"]["max_cusp_um"], 5) << what;  // planned 4
        // What the operator must know stands at the head, in the characters and line ends of the control.
        std::string text = slurp(folder / ("out/program/" + shop.program));
        for (const char c : text) ASSERT_TRUE(c == '\n' || c == '\r' || (c >= ' ' && c <= '~')) << what;
        EXPECT_EQ(text.find('\r') != std::string::npos, shop.dialect.starts_with("heidenhain")) << what;
        for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
        for (const char* said : {"JOB TINY", "HASH OF THE JOB", "MAKES THE FINISH PASS", "TIME ABOUT", "STICK-OUT", "ZERO IN MACHINE",
                                 "TOOL T3", "MACHINE"}) {
          EXPECT_NE(text.find(said), std::string::npos) << what << ": " << said;
        }
      }
    }
  }
}

}  // namespace
}  // namespace lightmill
