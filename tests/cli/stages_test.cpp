// The whole chain on the tiny job: contract of the run folder, resume, interruptions, and a dry run that is no echo.
#include "cli/stages.h"

#include <gmock/gmock.h>
#include <signal.h>

#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <regex>
#include <thread>

#include "cam/toolpath.h"
#include "cli/npy.h"
#include "cli/simulation.h"
#include "command_rig.h"
#include "design/core/image.h"
#include "machine/stock_model.h"
#include "tests/design/transport_checks.h"

namespace lightmill {
namespace fs = std::filesystem;
namespace {

using nlohmann::json;
using test::CommandResult;
using test::fixture;
using test::lightmill_command;
using test::replaced;
using test::ScratchFolder;
using test::slurp;
using test::spill;
using test::start_lightmill;
using test::tiny_job;
using test::wait_for;
using ::testing::AllOf;
using ::testing::HasSubstr;

const char* const kPrograms[] = {"program/10_rough.nc", "program/20_semi_finish.nc", "program/30_finish.nc"};

json report_of(const fs::path& run) { return json::parse(slurp(run / "report.json")); }

/// Every file under its final name is whole, told by how its kind ends.
void expect_all_whole(const fs::path& run) {
  if (!fs::exists(run)) return;
  for (const auto& entry : fs::recursive_directory_iterator(run)) {
    const std::string name = entry.path().filename().string();
    // Not results: locks, partial files of the killed run, the simulated machine's link and log.
    if (!entry.is_regular_file() || name.starts_with(".") || name == "machine.log") continue;
    const std::string text = slurp(entry.path());
    const std::string extension = entry.path().extension().string();
    bool whole = false;
    if (extension == ".json") {
      whole = !json::parse(text, nullptr, false).is_discarded();
    } else if (extension == ".png") {
      whole = text.size() > 12 && text.compare(text.size() - 8, 4, "IEND") == 0;
    } else if (extension == ".html") {
      whole = text.ends_with("</html>\n");
    } else if (extension == ".nc") {
      whole = text.ends_with("M30\n") || text.ends_with("M2\n");
    } else if (extension == ".step") {
      whole = text.find("END-ISO-10303-21;") != std::string::npos;
    } else if (extension == ".toml") {
      whole = text.find("[stream]") != std::string::npos && text.ends_with("check_first = true\n");
    } else if (extension == ".npy") {
      whole = text.size() > 128 && (text.size() - 10 - static_cast<unsigned char>(text[8])) % sizeof(double) == 0;
    } else {
      whole = !text.empty();  // .ply, .exr, .tif, .bin: the resumed run reads them
    }
    EXPECT_TRUE(whole) << entry.path() << ", " << text.size() << " bytes";
  }
}

/// Milled by the machine's program and swept along the planned paths, two ways that share no code but geometry: nodes differ
/// by at most `um`, slopes taken off.
void expect_planned_stock(const fs::path& run, double um) {
  const RunFolder folder(run, false);
  const Job job = read_job(run / "job.toml");
  const MachinedSurface milled = read_machined(run / "dry_run/machined.tif");
  StockOptions options;
  options.pitch_mm = milled.pitch_mm;
  StockModel stock(shop_of(job, folder).blank, options);
  for (const ToolPath& path : read_toolpaths(run / "cam/toolpaths.bin")) {
    stock.set_cutter(path.cutter);
    for (std::size_t i = 1; i < path.moves.size(); ++i) {
      if (path.moves[i].kind == MoveKind::kRapid) continue;
      SweptMove swept;
      swept.from = path.moves[i - 1].pose;
      swept.to = path.moves[i].pose;
      swept.spindle_on = true;
      stock.move(swept);
    }
  }
  stock.flush();
  const MachinedSurface planned = stock.surface();
  ASSERT_EQ(milled.heights_mm.values.size(), planned.heights_mm.values.size());
  double worst = 0;
  for (int j = 0; j + 1 < planned.heights_mm.height; ++j) {
    for (int i = 0; i + 1 < planned.heights_mm.width; ++i) {
      const double h = planned.heights_mm.at(i, j);
      const double rise = std::hypot(planned.heights_mm.at(i + 1, j) - h, planned.heights_mm.at(i, j + 1) - h);
      worst = std::max(worst, std::abs(milled.heights_mm.at(i, j) - h) / (1 + rise / planned.pitch_mm));
    }
  }
  EXPECT_LT(worst * 1000, um);
  EXPECT_NEAR(milled.removed_mm3 / planned.removed_mm3, 1, 1e-4);
}

TEST(Chain, TinyJobKeepsTheContractOfTheRunFolderAndResumes) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  const CommandResult made = lightmill_command({"make", tiny_job(scratch).string(), "-o", run});
  ASSERT_EQ(made.code, 0) << made.err;
  for (const char* name :
       {"job.toml", "report.json", "report.html", "design/target.png", "design/surface.ply", "design/caustic.png", "design/caustic.exr",
        "design/heights.png", "design/curvature.png", "design/checkerboard.png", "design/samples.png", "design/cells.png", "design/exposures.png", "design/transport.npy", "cam/lens.step", "cam/stock.step", "cam/toolpaths.bin", "program/10_rough.nc",
        "program/20_semi_finish.nc", "program/30_finish.nc", "dry_run/machined.tif", "dry_run/caustic_machined.png",
        "dry_run/deviation.png", "dry_run/faults.json", "setup_sheet.html"}) {
    EXPECT_TRUE(fs::exists(fs::path(run) / name)) << name;
  }
  expect_all_whole(run);
  json report = report_of(run);
  for (const char* pointer :
       {"/design/transport/samples", "/design/transport/seconds", "/design/transport/iterations", "/design/transport/l1_mass_error",
        "/design/transport/max_mass_error", "/design/transport/empty_cells", "/design/surface/vertices", "/design/surface/seconds",
        "/design/surface/inverted_triangles", "/design/surface/height_range_mm", "/design/surface/min_concave_radius_mm",
        "/design/caustic/l1_error", "/design/caustic/psnr_db", "/design/caustic/flux_outside_support", "/design/caustic/flux_totally_reflected",
        "/cam/solid/volume_mm3", "/cam/solid/file_bytes", "/cam/solid/max_deviation_um", "/cam/solid/rms_deviation_um",
        "/cam/solid/rms_normal_deviation_urad", "/cam/solid/seconds", "/cam/rough/length_mm", "/cam/semi_finish/points",
        "/cam/finish/stepover_mm", "/cam/finish/predicted_cusp_um", "/cam/finish/minutes", "/postproc/rough/blocks",
        "/postproc/semi_finish/bytes", "/postproc/finish/max_tip_error_um", "/postproc/finish/max_axis_speed_ratio", "/dry_run/faults",
        "/dry_run/max_gouge_um", "/dry_run/max_cusp_um", "/dry_run/p99_cusp_um", "/dry_run/residue_um", "/dry_run/limit_violations",
        "/dry_run/collisions", "/dry_run/minutes", "/dry_run/seconds", "/dry_run/caustic/raw/l1_error", "/dry_run/caustic/polished/psnr_db",
        "/dry_run/caustic/polished/flux_outside_support", "/dry_run/rough/minutes", "/dry_run/finish/slow_share"}) {
    const json::json_pointer p(pointer);
    EXPECT_TRUE(report.contains(p) && report.at(p).is_number()) << pointer;
  }
  EXPECT_EQ(report.at("/cam/solid/valid"_json_pointer), true);
  EXPECT_EQ(report.at("/dry_run/faults"_json_pointer), 0);
  EXPECT_LT(report.at("/dry_run/max_gouge_um"_json_pointer), 1.0);
  EXPECT_LT(report.at("/dry_run/max_cusp_um"_json_pointer), 4.6) << "4 um were asked for";
  EXPECT_GT(report.at("/dry_run/max_cusp_um"_json_pointer), 2.0) << "a ball at this stepover cannot leave less";
  EXPECT_LT(report.at("/design/caustic/l1_error"_json_pointer), 0.1);
  EXPECT_LT(report.at("/cam/reachable/caustic/l1_error"_json_pointer), 0.2) << "before cusps and polish";
  EXPECT_EQ(report.at("/dry_run/link/digest_matches"_json_pointer), true);
  EXPECT_EQ(report.at("/dry_run/cusp_blur_mm"_json_pointer), blur_on_screen_mm(2, 4, 80, 1.49, 0.15)) << "of 4 um, polished with 150 um";
  double area = report.at("/dry_run/deviation_histogram/below_mm2"_json_pointer).get<double>() + report.at("/dry_run/deviation_histogram/above_mm2"_json_pointer).get<double>();
  for (const double bin : report.at("/dry_run/deviation_histogram/area_mm2"_json_pointer)) area += bin;
  EXPECT_NEAR(area, 12 * 10, 1) << "all of the lens";
  EXPECT_EQ(report.at("/dry_run/gouged_area_mm2"_json_pointer), 0);
  expect_planned_stock(run, 0.05);
  // Every block takes its time: the passes' times are the whole, and longer than what the feeds alone ask for.
  double minutes = 0;
  for (const char* pass : {"rough", "semi_finish", "finish"}) {
    const json timing = report.at("dry_run").at(pass);
    EXPECT_GT(timing.at("minutes"), timing.at("commanded_minutes")) << pass;
    EXPECT_GE(timing.at("commanded_feed_mm_per_min"), timing.at("mean_feed_mm_per_min")) << pass;
    minutes += timing.at("minutes").get<double>();
  }
  EXPECT_NEAR(report.at("/dry_run/minutes"_json_pointer).get<double>(), minutes, 1e-9);
  // Pages refer to nothing that is not there.
  const std::string page = slurp(fs::path(run) / "report.html");
  EXPECT_EQ(page.find("http"), std::string::npos) << "no resource from elsewhere";
  EXPECT_THAT(page, HasSubstr("\nconcave creases"));
  EXPECT_THAT(page, HasSubstr("Milled minus reachable, by area"));
  for (std::size_t at = page.find("src=\""); at != std::string::npos; at = page.find("src=\"", at + 1)) {
    const std::string name = page.substr(at + 5, page.find('"', at + 5) - at - 5);
    EXPECT_TRUE(fs::exists(fs::path(run) / name)) << name;
  }

  // Again: nothing to do. The resolved job, re-read, is the same job.
  const CommandResult again = lightmill_command({"resume", run});
  EXPECT_EQ(again.code, 0) << again.err;
  EXPECT_THAT(again.err, HasSubstr("dry-run: nothing changed, kept"));
  EXPECT_EQ(report_of(run), report);

  // Studies keep what the folder holds. Coarser cusps take less time and show more where nothing is polished.
  const std::string job = tiny_job(scratch).string();
  const CommandResult cusps = lightmill_command({"study", "cusp", job, "-o", run, "--pitch-um", "40", "--cusps-um", "2", "10", "--polish-um", "0", "150"});
  ASSERT_EQ(cusps.code, 0) << cusps.err;
  EXPECT_THAT(cusps.err, HasSubstr("post: nothing changed, kept"));
  const json rows = json::parse(slurp(run + "/study/study_cusp.json")).at("rows");
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_GT(rows[0].at("minutes").get<double>(), 1.5 * rows[1].at("minutes").get<double>());
  EXPECT_LT(rows[0].at("l1_error")[0].at("l1_error"), rows[1].at("l1_error")[0].at("l1_error"));
  EXPECT_GT(rows[1].at("hiding_polish_um").get<double>(), rows[0].at("hiding_polish_um").get<double>());
  EXPECT_THAT(slurp(run + "/study/study_cusp.html"), HasSubstr("<polyline"));
  const CommandResult errors = lightmill_command({"study", "errors", job, "-o", run, "--pitch-um", "80"});
  ASSERT_EQ(errors.code, 0) << errors.err;
  const json harms = json::parse(slurp(run + "/study/study_errors.json")).at("rows");
  ASSERT_GT(harms.size(), 10U);
  EXPECT_EQ(harms[0].at("error"), "none");
  for (std::size_t k = 2; k < harms.size(); ++k) EXPECT_GE(harms[k - 1].at("harm"), harms[k].at("harm"));
  EXPECT_THAT(slurp(run + "/study/study_errors.html"), HasSubstr("<rect"));
  // The slow vibration is worst, beyond what so coarse a stock's grid makes of it; that is never nothing.
  EXPECT_GT(harms[1].at("harm"), 2 * harms[1].at("noise").get<double>());
  EXPECT_GT(harms[1].at("noise"), 0);
  EXPECT_EQ(report_of(run), report);

  // A coarser finish: design stays, cam and what follows are made again.
  const CommandResult coarser = lightmill_command({"make", tiny_job(scratch, "cusp_um = 4", "cusp_um = 6").string(), "-o", run, "--until", "post"});
  EXPECT_EQ(coarser.code, 0) << coarser.err;
  EXPECT_THAT(coarser.err, HasSubstr("surface: nothing changed, kept"));
  EXPECT_THAT(coarser.err, ::testing::Not(HasSubstr("cam: nothing changed")));
  EXPECT_FALSE(fs::exists(fs::path(run) / "dry_run/machined.tif")) << "milled from other programs";
  EXPECT_FALSE(report_of(run).contains("dry_run"));
  EXPECT_LT(report_of(run).at("/cam/finish/length_mm"_json_pointer), report.at("/cam/finish/length_mm"_json_pointer));
}

TEST(Chain, ADiskWithALandIsMilledAndCutOut) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  const fs::path job = tiny_job(scratch, "[lens]\nsize_mm = [12, 10]",
                                "[profile]\ntabs = 1\ntab_height_mm = 0.4\ntab_width_mm = 2\n\n"
                                "[mount]\nchamfer_mm = 0.2\ndowel_diameter_mm = 0.8\ndowels_mm = [[6.5, 0], [-6.5, 0]]\n"
                                "label = \"7\"\nlabel_height_mm = 0.8\n\n[lens]\nshape = \"disk\"\nsize_mm = [11, 11]\n"
                                "land_mm = 2\nland_drop_mm = 0.5");
  // The mill goes around the part: three times as wide a blank as the lens, on a grid half as fine.
  spill(job, replaced(slurp(job), "pitch_um = 40", "pitch_um = 80"));
  const CommandResult made = lightmill_command({"make", job.string(), "-o", run});
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_TRUE(fs::exists(fs::path(run) / "program/40_profile.nc"));
  const json report = report_of(run);
  EXPECT_EQ(report.at("/cam/solid/valid"_json_pointer), true);
  for (const char* page : {"setup_sheet.html", "report.html"}) {
    EXPECT_THAT(slurp(fs::path(run) / page), AllOf(HasSubstr("ot milled by the"), HasSubstr("holes of 0.8 mm, through, at x 6.50, y 0.00 mm"))) << page;
  }
  EXPECT_EQ(report.at("/dry_run/faults"_json_pointer), 0);
  EXPECT_LT(report.at("/dry_run/max_gouge_um"_json_pointer), 1.0);
  EXPECT_LT(report.at("/dry_run/max_cusp_um"_json_pointer), 4.6) << "4 um were asked for";
  EXPECT_LT(report.at("/dry_run/caustic/polished/l1_error"_json_pointer), 0.4);
  EXPECT_NEAR(report.at("/cam/blank/size_mm/0"_json_pointer), 11 + 2 * (2 + 12), 1e-9);
  const json cut_out = report.at("/dry_run/cut_out"_json_pointer);
  EXPECT_EQ(cut_out.at("held"), true);
  EXPECT_EQ(cut_out.at("pieces"), 1);
  ASSERT_EQ(cut_out.at("tabs").size(), 1U);
  EXPECT_NEAR(cut_out.at("tabs")[0].at("height_mm"), 0.4, 0.005);
  EXPECT_LT(cut_out.at("walls").at("max_left_um"), 7);
  EXPECT_LT(cut_out.at("walls").at("max_gouge_um"), 1);
  EXPECT_THAT(slurp(fs::path(run) / "report.html"), AllOf(HasSubstr("part's wall: most left outside it"), HasSubstr("hold the part in its blank")));
  EXPECT_GT(report.at("/dry_run/polish_removal_um"_json_pointer), 0.5);
  EXPECT_LT(report.at("/dry_run/polish_removal_um"_json_pointer), 4);

  // The tab cut through, and the finish ten times too fast: both are said with a picture.
  const fs::path profile = fs::path(run) / "program/40_profile.nc", finish = fs::path(run) / "program/30_finish.nc";
  spill(profile, std::regex_replace(slurp(profile), std::regex("Z0\\.[1234]\\d*"), "Z0.1"));
  spill(finish, std::regex_replace(slurp(finish), std::regex("F(\\d+)"), "F$010"));
  EXPECT_EQ(lightmill_command({"dry-run", run}).code, 5);
  std::map<std::string, json> first;
  const json list = json::parse(slurp(fs::path(run) / "dry_run/faults.json"));
  for (const json& fault : list["faults"]) first.try_emplace(fault["kind"], fault);
  ASSERT_TRUE(first.contains("tabs") && first.contains("feed"));
  EXPECT_GT(first["feed"]["line"], 20);
  for (const char* kind : {"tabs", "feed"}) EXPECT_TRUE(fs::exists(fs::path(run) / first[kind]["picture"].get<std::string>())) << kind;
}

TEST(Chain, ARestPassTakesWhatTheFinishingBallLeavesInACrease) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  // Two points of light ask for two domes that meet in a valley, which the border cuts off at a slant.
  spill(scratch / "two.svg", R"(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 12 10"><circle class="point" cx="3" cy="6" r="0.5"/><circle class="point" cx="9.5" cy="4" r="0.5"/></svg>)");
  std::string text = replaced(slurp(tiny_job(scratch)), "image = \"" + fixture("pictures/tiny.png").string() + "\"", "drawing = \"" + (scratch / "two.svg").string() + "\"");
  text = replaced(text, "mesh = 33", "mesh = 65");
  text = replaced(text, "distance_mm = 80", "distance_mm = 60");
  spill(scratch / "two.toml", text + "\n[rest]\ncutter = \"" + fixture("cutters/rest_1mm_ball.toml").string() + "\"\n[stream]\nbaud = 230400\n");
  const CommandResult made = lightmill_command({"make", (scratch / "two.toml").string(), "-o", run});
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_TRUE(fs::exists(run + "/program/35_rest.nc"));
  const json report = report_of(run);
  EXPECT_EQ(report.at("/dry_run/faults"_json_pointer), 0);
  EXPECT_GT(report.at("/cam/creases/rest/highest_before_um"_json_pointer), 8);
  // The small ball fits everywhere: nothing above the 4 um of its cusps stays, planned or milled.
  EXPECT_LT(report.at("/cam/creases/rest/highest_after_um"_json_pointer), 4);
  EXPECT_LT(report.at("/dry_run/residue_um"_json_pointer), 4.5);
  // Along the valley 400 blocks of 0.01 mm follow each other at 828 a second; 115200 baud bring half of them.
  EXPECT_EQ(lightmill_command({"dry-run", run, "--pace-baud", "115200"}).code, 5);
  EXPECT_EQ(report_of(run).at("/dry_run/fault_kinds"_json_pointer), json({{"starved", 1}}));
}

TEST(Chain, ZigZagAndSpiralAreMilledWithoutAFault) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  const fs::path job = tiny_job(scratch, "cusp_um = 20\n\n[finish]", "cusp_um = 20\nstrategy = \"zig_zag\"\nangle_deg = 90\n\n[finish]\nstrategy = \"spiral\"");
  const CommandResult made = lightmill_command({"make", job.string(), "-o", run});
  ASSERT_EQ(made.code, 0) << made.err;
  const json report = report_of(run);
  EXPECT_EQ(report.at("/dry_run/faults"_json_pointer), 0);
  EXPECT_LT(report.at("/dry_run/max_gouge_um"_json_pointer), 0.3);
  EXPECT_LT(report.at("/dry_run/max_cusp_um"_json_pointer), 4.6) << "4 um were asked for";
}

TEST(Chain, ADryRunIsNoEcho) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  ASSERT_EQ(lightmill_command({"make", tiny_job(scratch).string(), "-o", run}).code, 0);
  const auto kinds_of = [&] {
    std::string kinds;
    const json list = json::parse(slurp(run + "/dry_run/faults.json"));
    for (const auto& fault : list["faults"]) kinds += fault["kind"].get<std::string>() + " ";
    return kinds;
  };
  const auto expect_fault = [&](const std::string& what, const std::vector<std::string>& options) {
    std::vector<std::string> arguments = {"dry-run", run};
    arguments.insert(arguments.end(), options.begin(), options.end());
    const CommandResult result = lightmill_command(arguments);
    EXPECT_EQ(result.code, 5) << what << " was not caught: " << result.out << result.err;
    if (result.code != 5) return std::string();
    EXPECT_GT(report_of(run).at("/dry_run/faults"_json_pointer), 0) << what;
    EXPECT_THAT(slurp(run + "/report.html"), HasSubstr("Do not mill")) << what;
    EXPECT_THAT(slurp(run + "/setup_sheet.html"), HasSubstr("Do not mill")) << what;
    return kinds_of();
  };
  const std::string machine = slurp(fixture("machines/hsm400u_grblhal.toml"));

  // A rotary axis that turns the other way.
  std::string flipped = machine;
  const std::size_t outer = flipped.find("[outer]");
  flipped.replace(flipped.find("direction = -1", outer), 14, "direction = 1 ");
  spill(scratch / "flipped_outer.toml", flipped);
  expect_fault("a flipped outer sign", {"--machine", (scratch / "flipped_outer.toml").string()});
  flipped = machine;
  const std::size_t inner = flipped.find("[inner]");
  flipped.replace(flipped.find("direction = -1", inner), 14, "direction = 1 ");
  spill(scratch / "flipped_inner.toml", flipped);
  expect_fault("a flipped inner sign", {"--machine", (scratch / "flipped_inner.toml").string()});

  // A pivot 20 um from where the post believes it: half of that in height at 30 degrees.
  spill(scratch / "shifted.toml", replaced(machine, "point_mm = [0.0, 0.0, -380.0]", "point_mm = [0.02, 0.0, -380.0]"));
  EXPECT_THAT(expect_fault("a shifted pivot", {"--machine", (scratch / "shifted.toml").string()}), ::testing::AnyOf(HasSubstr("gouge"), HasSubstr("cusp")));

  // A finishing tool 10 um longer, then shorter, than the program believes.
  for (const char* length : {"85.01", "84.99"}) {
    spill(scratch / "tool.toml", replaced(slurp(fixture("cutters/finish_4mm_ball.toml")), "\nlength_mm = 85.0", std::string("\nlength_mm = ") + length));
    EXPECT_THAT(expect_fault(length, {"--cutters", fixture("cutters/rough_10mm.toml").string(), "--cutters",
                                      fixture("cutters/semi_finish_4mm_ball.toml").string(), "--cutters", (scratch / "tool.toml").string()}),
                ::testing::AnyOf(HasSubstr("gouge"), HasSubstr("cusp")));
  }

  // The operator has zeroed another offset than the program uses.
  expect_fault("a swapped work offset", {"--work-offset", "55"});
  // What the dry run objects to does not leave for a machine; exit code 3: all is well but for the port.
  const auto stream_code = [&] { return lightmill_command({"stream", run, "--port", "/dev/ttyNotThere"}).code; };
  EXPECT_EQ(stream_code(), 5);

  spill(scratch / "slower.toml", replaced(slurp(fixture("machines/hsm400u_grblhal.toml")), "max_rpm = 36000", "max_rpm = 36001"));

  // Nothing of that stays: the shop floor of the job is clean.
  EXPECT_EQ(lightmill_command({"dry-run", run}).code, 0);
  EXPECT_EQ(stream_code(), 3);

  // Another machine than the dry run's: a speed in its file.
  EXPECT_EQ(lightmill_command({"dry-run", run, "--machine", (scratch / "slower.toml").string()}).code, 0);
  EXPECT_EQ(stream_code(), 2) << "proven elsewhere";
  EXPECT_EQ(lightmill_command({"dry-run", run}).code, 0);

  // A block lost from the program.
  const std::string program = slurp(run + "/program/30_finish.nc");
  std::size_t line = program.size() / 2;
  line = program.find('\n', line) + 1;
  spill(run + "/program/30_finish.nc", program.substr(0, line) + program.substr(program.find('\n', line) + 1));
  EXPECT_EQ(stream_code(), 2);
  EXPECT_THAT(expect_fault("a lost block", {}), HasSubstr("program_changed"));
  const json changed = json::parse(slurp(run + "/dry_run/faults.json"))["faults"][0];
  EXPECT_EQ(changed["line"], 1 + std::count(program.begin(), program.begin() + static_cast<std::ptrdiff_t>(line), '\n'));
  EXPECT_GT(changed["place_mm"][2], 3) << "over the lens";
  EXPECT_THAT(slurp(run + "/" + changed["picture"].get<std::string>()), HasSubstr("fill=\"#fbe3e1\"")) << "the line marked";

  // The semi-finishing ball in the finishing one's place: it is as long and cuts the same way.
  spill(run + "/program/30_finish.nc", replaced(program, "\nT3 M6", "\nT2 M6"));
  EXPECT_EQ(expect_fault("a swapped tool", {}), "program_changed wrong_tool ");
  const json swapped = json::parse(slurp(run + "/dry_run/faults.json"))["faults"][1];
  EXPECT_EQ(swapped["program"], "30_finish.nc");
  EXPECT_THAT(swapped["message"].get<std::string>(), HasSubstr("change to T3"));
  for (const int axis : {0, 1}) EXPECT_LT(std::abs(swapped["place_mm"][axis].get<double>()), 15) << "over the blank, at its first feed";
  EXPECT_THAT(slurp(run + "/" + swapped["picture"].get<std::string>()), HasSubstr("fill=\"#fbe3e1\"")) << "the line marked";

  spill(run + "/program/30_finish.nc", program);
  EXPECT_EQ(lightmill_command({"dry-run", run}).code, 0);
  EXPECT_EQ(lightmill_command({"post", run}).code, 0);
  EXPECT_EQ(stream_code(), 2) << "posted again, not dry-run";
  EXPECT_EQ(lightmill_command({"dry-run", run}).code, 0);

  // A cutter 20 um too large: with its length measured at the tip it gouges beside it.
  const std::string resolved = slurp(run + "/job.toml");
  spill(run + "/job.toml", test::replaced(resolved, "errors.tool_radius_um = 0", "errors.tool_radius_um = 20"));
  EXPECT_THAT(expect_fault("a wrong radius", {}), HasSubstr("gouge"));
  const json gouge = json::parse(slurp(run + "/dry_run/faults.json"))["faults"][0];
  EXPECT_EQ(gouge["kind"], "gouge");
  EXPECT_EQ(gouge["program"], "30_finish.nc");
  EXPECT_GT(gouge["line"], 20);
  EXPECT_GT(gouge["amount_mm"], 1e-3);
  EXPECT_NEAR(gouge["place_mm"][2], 4.1, 0.2) << "on the surface";
  EXPECT_THAT(slurp(run + "/" + gouge["picture"].get<std::string>()), HasSubstr("5 mm")) << "a section";
  spill(run + "/job.toml", resolved);

  // A later run that fails leaves no sheet that praises the programs of this one.
  const fs::path low = scratch / "low.toml";
  spill(low, slurp(tiny_job(scratch)) + "\n[stock]\nheight_mm = 4.05\n");
  EXPECT_EQ(lightmill_command({"make", low.string(), "-o", run}).code, 2);
  EXPECT_FALSE(fs::exists(run + "/setup_sheet.html"));
  EXPECT_THAT(slurp(run + "/report.html"), ::testing::Not(HasSubstr("found no fault")));
}

TEST(Chain, ABlankAsHighAsTheLensIsNotRoughed) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  const fs::path low = scratch / "low.toml";
  spill(low, slurp(tiny_job(scratch)) + "\n[stock]\nheight_mm = 4.2\n");
  const CommandResult made = lightmill_command({"make", low.string(), "-o", run});
  ASSERT_EQ(made.code, 0) << made.err;
  const json report = report_of(run);
  EXPECT_FALSE(report.at("/cam/blank/roughed"_json_pointer).get<bool>());
  EXPECT_FALSE(report.at("cam").contains("rough"));
  EXPECT_FALSE(fs::exists(run + "/program/10_rough.nc"));
  EXPECT_EQ(report.at("/dry_run/faults"_json_pointer).get<int>(), 0);
  EXPECT_THAT(slurp(run + "/report.html"), HasSubstr("Nothing to rough"));
  EXPECT_EQ(lightmill_command({"check", run}).code, 0);
}

TEST(Chain, KillingItAnywhereLeavesWholeFilesAndItResumes) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch);
  const auto started = std::chrono::steady_clock::now();
  ASSERT_EQ(lightmill_command({"make", job.string(), "-o", (scratch / "whole").string()}).code, 0);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();

  constexpr int kSeed = 20;
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> moment(0.02, 0.3 * seconds);
  const std::vector<std::string> arguments = {"make", job.string(), "-o", (scratch / "run").string(), "--quiet"};
  int killed = 0;
  for (int round = 0; round < 10; ++round) {
    const pid_t child = start_lightmill(arguments, scratch / "log");
    std::this_thread::sleep_for(std::chrono::duration<double>(moment(random)));
    kill(child, SIGKILL);
    killed += wait_for(child) == 128 + SIGKILL;
    SCOPED_TRACE("seed " + std::to_string(kSeed) + ", round " + std::to_string(round));
    expect_all_whole(scratch / "run");
  }
  EXPECT_GE(killed, 2) << "the moments must hit the run";
  const CommandResult last = lightmill_command(arguments);
  EXPECT_EQ(last.code, 0) << last.err;
  expect_all_whole(scratch / "run");
  // As if nothing had happened. (STEP and TIFF files carry the time.)
  for (const char* name : kPrograms) EXPECT_TRUE(slurp(scratch.root() / "run" / name) == slurp(scratch.root() / "whole" / name)) << name;
  for (const char* name : {"design/surface.ply", "cam/spline.bin", "cam/toolpaths.bin", "dry_run/caustic_machined.png"}) {
    EXPECT_TRUE(slurp(scratch.root() / "run" / name) == slurp(scratch.root() / "whole" / name)) << name;
  }
  EXPECT_TRUE(read_float_image(scratch.root() / "run/dry_run/machined.tif").values ==
              read_float_image(scratch.root() / "whole/dry_run/machined.tif").values);
  for (const auto& entry : fs::recursive_directory_iterator(scratch / "run")) {
    EXPECT_EQ(entry.path().filename().string().find(".partial"), std::string::npos) << entry.path();
    EXPECT_FALSE(entry.is_symlink()) << entry.path() << ": the simulated machine's port is gone with it";
  }
}

TEST(Chain, CtrlCKeepsFinishedStages) {
  const ScratchFolder scratch;
  const fs::path job = tiny_job(scratch, "samples = 1024", "samples = 20000");
  const pid_t child = start_lightmill({"make", job.string(), "-o", (scratch / "run").string()}, scratch / "log");
  for (int tries = 0; tries < 6000 && !fs::exists(scratch / "run/stages/transport.json"); ++tries) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  kill(child, SIGINT);
  EXPECT_EQ(wait_for(child), 130);
  EXPECT_THAT(slurp(scratch / "log"), HasSubstr("lightmill: stopped"));
  expect_all_whole(scratch / "run");
  const CommandResult last = lightmill_command({"make", job.string(), "-o", (scratch / "run").string(), "--until", "design"});
  EXPECT_EQ(last.code, 0) << last.err;
  EXPECT_THAT(last.err, HasSubstr("transport: nothing changed, kept"));
}

TEST(Chain, TwoProcessesStreamToAMachineThatAnotherRuns) {
  const ScratchFolder scratch;
  const std::string port = (scratch / "port").string();
  const pid_t machine = start_lightmill({"machine", "--pty", port, "--blank", "12x10x5", "--out", (scratch / "milled").string()}, scratch / "log");
  for (int tries = 0; tries < 3000 && !fs::exists(port); ++tries) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  // A groove 0.5 mm deep along X with the 10 mm mill, from beside the blank.
  spill(scratch / "groove.nc",
        "G21 G90 G94 G17 G54\nG53 G0 Z0\nT1 M6\nG43.1 Z90\nS12000 M3\nG4 P9\nM7\nG0 X-12 Y0\nG0 Z10\nG1 Z4.5 F1200\nG1 X12 F1920\nG53 G0 Z0\nM5 M9\nM30\n");
  const std::string groove = (scratch / "groove.nc").string(), check = (scratch / "check").string();
  EXPECT_EQ(lightmill_command({"dry-run", groove, "--blank", "12x10x5", "--pitch-um", "100", "-o", check}).code, 0);
  const CommandResult unattended = lightmill_command({"stream", groove, "--proof", check, "--port", port});
  EXPECT_EQ(unattended.code, 6) << "nobody is there to change the tool" << unattended.err;
  const CommandResult streamed = lightmill_command({"stream", groove, "--proof", check, "--port", port, "--confirm-all"});
  EXPECT_EQ(streamed.code, 0) << streamed.err;
  kill(machine, SIGTERM);
  EXPECT_EQ(wait_for(machine), 0) << slurp(scratch / "log");
  const json result = json::parse(slurp(scratch / "milled/result.json"));
  EXPECT_EQ(result["faults"].size(), 0U) << result["faults"].dump(1);
  // All of the 10 mm width under the corner radius: 12 x 10 x 0.5 less two fillets of radius 0.5.
  const double fillets = 2 * 12 * (0.25 - 3.14159265358979 * 0.25 / 4);
  EXPECT_NEAR(result["removed_mm3"].get<double>(), 12 * 10 * 0.5 - fillets, 0.3);
  EXPECT_FALSE(fs::exists(port));
}

TEST(Chain, AnyProgramCanBeDryRun) {
  const ScratchFolder scratch;
  spill(scratch / "deep.nc", "(blank lines count where people read)\n\n\nG21 G90 G94 G17 G54\nG53 G0 Z0\nT1 M6\nG43.1 Z90\nS12000 M3\nG4 P9\nG0 X0 Y0\nG0 Z2\nG53 G0 Z0\nM5\nM30\n");
  const CommandResult crash = lightmill_command({"dry-run", (scratch / "deep.nc").string(), "--blank", "12x10x5", "-o", (scratch / "out").string()});
  EXPECT_EQ(crash.code, 5) << crash.err;
  const json faults = json::parse(slurp(scratch / "out/faults.json"))["faults"];
  ASSERT_FALSE(faults.empty());
  EXPECT_EQ(faults[0]["kind"], "rapid_in_stock");
  EXPECT_EQ(faults[0]["program"], "deep.nc");
  EXPECT_EQ(faults[0]["line"], 11);
  EXPECT_THAT(crash.err, HasSubstr("rapid_in_stock in deep.nc, line 11: rapid with the cutter"));
  EXPECT_THAT(slurp(scratch / "out" / faults[0]["picture"].get<std::string>()), HasSubstr("rapid_in_stock in deep.nc, line 11<"));
  EXPECT_EQ(json::parse(slurp(scratch / "out/result.json"))["faults"][0]["line"], 11);

  // A file that lost its tail is told from a whole one.
  spill(scratch / "tail.nc", "G21 G90 G94 G17 G54\nG53 G0 Z0\nG53 G0 X1");
  const CommandResult tail = lightmill_command(
      {"dry-run", (scratch / "tail.nc").string(), "--blank", "12x10x5", "-o", (scratch / "out").string()});
  EXPECT_EQ(tail.code, 5) << tail.err;
  EXPECT_THAT(tail.err, HasSubstr("no_program_end"));
  spill(scratch / "nothing.nc", "\n");
  EXPECT_EQ(lightmill_command(
                {"dry-run", (scratch / "nothing.nc").string(), "--blank", "12x10x5", "-o", (scratch / "out").string()})
                .code,
            2);
}

/// transport.npy alone, against tiny.png on 40 x 30 mm: its sites and weights cut the picture into its masses and centroids.
void expect_map_of_picture(const fs::path& file) {
  const NpyTable table = read_npy(file);
  ASSERT_EQ(table.columns, 6);
  ASSERT_EQ(table.rows(), 1024U);
  std::vector<Vec2> sites;
  std::vector<double> weights;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    sites.emplace_back(table.values[6 * i], table.values[6 * i + 1]);
    weights.push_back(table.values[6 * i + 3]);
  }
  TargetSpec spec;
  spec.image = fixture("pictures/tiny.png");
  spec.size_mm = {40, 30};
  const std::vector<test::Portion> portions = test::portions_of(load_target(spec), 3, 0.01);
  const auto sums = [&](const auto& factor) {
    std::vector<test::Portion> scaled = portions;
    for (auto& portion : scaled) portion.flux *= factor(portion.place);
    return test::rastered_masses(sites, weights, scaled).at(0);
  };
  const auto masses = sums([](const Vec2&) { return 1.0; });
  const auto x_moments = sums([](const Vec2& p) { return p.x(); });
  const auto y_moments = sums([](const Vec2& p) { return p.y(); });
  double squares = 0, total = 0, way = 0;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const double* row = &table.values[6 * i];
    total += row[2];
    squares += std::pow(masses[i] / row[2] - 1, 2) / 1024;
    way += (Vec2(x_moments[i], y_moments[i]) / masses[i] - Vec2(row[4], row[5])).squaredNorm() / 1024;
  }
  EXPECT_NEAR(total, 1, 1e-12);
  EXPECT_LT(std::sqrt(squares), 0.04) << "the raster's own noise";
  EXPECT_LT(std::sqrt(way), 0.04) << "mm";
}

TEST(Stages, APolishAsksForNewPassesWhereTheCuspFollowsFromIt) {
  const ScratchFolder scratch;
  RunFolder folder(scratch / "run", true);
  for (const char* made : {"design/surface.ply", "cam/spline.bin"}) spill(folder.file(made), "as designed");
  const auto digest = [&](Stage stage, const std::string& finish, const std::string& polish_um) {
    const std::string text = "[target]\nimage = \"" + fixture("pictures/astronaut.png").string() + "\"\n[finish]\n" + finish + "\n[dry_run]\npolish_sigma_um = " + polish_um + "\n";
    const std::string result = stage_digest(stage, read_job_text(text, "a.toml", scratch / ""), folder);
    EXPECT_FALSE(result.empty());
    return result;
  };
  EXPECT_NE(digest(Stage::kCam, "blur_mm = 0.4", "50"), digest(Stage::kCam, "blur_mm = 0.4", "60"));
  EXPECT_EQ(digest(Stage::kCam, "cusp_um = 1.3", "50"), digest(Stage::kCam, "cusp_um = 1.3", "60"));
  EXPECT_NE(digest(Stage::kDryRun, "cusp_um = 1.3", "50"), digest(Stage::kDryRun, "cusp_um = 1.3", "60")) << "which reports what cusps and polish leave";
}

TEST(Stages, AnySourceLightIsTransportedAndBentByASurface) {
  const ScratchFolder folder;
  spill(folder / "ring.svg",
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 40 30'><path fill-rule='evenodd' "
        "d='M0 0H40V30H0Z M15 10H25V20H15Z'/></svg>");
  const fs::path job = folder / "lamp.toml";
  spill(job, "[target]\nimage = \"" + fixture("pictures/tiny.png").string() +
                 "\"\nsize_mm = [40, 30]\n[lens]\nsize_mm = [40, 30]\noutline = \"ring.svg\"\nbase = \"sphere\"\nbase_radius_mm = 400\n"
                 "[light]\nkind = \"point\"\nposition_mm = [0, 0, -300]\nprofile = \"gaussian\"\nsigma_mm = 20\n"
                 "[receiver]\ndistance_mm = 100\nshift_mm = [5, 0]\ntilt_deg = [0, 10]\n[transport]\nsamples = 1024\n[surface]\nmesh = 61\n");
  const fs::path run = folder / "run";
  const CommandResult made = lightmill_command({"make", job.string(), "-o", run.string(), "--until", "transport"});
  ASSERT_EQ(made.code, 0) << made.err;
  const json design = report_of(run)["design"];
  EXPECT_TRUE(design["transport"]["converged"]);
  EXPECT_EQ(design["transport"]["empty_cells"], 0);
  EXPECT_LT(design["transport"]["flux_spread"], 0.01);
  EXPECT_EQ(design["source"]["totally_reflected"]["share"], 0);
  EXPECT_TRUE(fs::exists(run / "design/source.png"));
  EXPECT_TRUE(fs::exists(run / "design/transport.npy"));
  EXPECT_FALSE(fs::exists(run / "design/surface.ply"));
  expect_map_of_picture(run / "design/transport.npy");
  const CommandResult bent = lightmill_command({"make", job.string(), "-o", run.string(), "--until", "design"});
  ASSERT_EQ(bent.code, 0) << bent.err;
  const json surface = report_of(run)["design"];
  EXPECT_EQ(surface["surface"]["inverted_triangles"], 0);
  EXPECT_EQ(surface["surface"]["unmapped_vertices"], 0);
  EXPECT_LT(surface["caustic"]["l1_error"], 0.3);
  EXPECT_LT(surface["caustic"]["flux_outside_support"], 0.02);
  // Light past a sphere's focus for the rim but not for the axis folds: refused with its place.
  spill(job, replaced(slurp(job), "base_radius_mm = 400", "base_radius_mm = 40"));
  const CommandResult folded = lightmill_command({"make", job.string(), "-o", run.string(), "--until", "transport"});
  EXPECT_EQ(folded.code, 2);
  EXPECT_THAT(folded.err, HasSubstr("lens x = "));
}

}  // namespace
}  // namespace lightmill
