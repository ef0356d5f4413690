#include "cli/job.h"

#include <gmock/gmock.h>

#include <clocale>

#include "command_rig.h"
#include "design/core/errors.h"
#include "design/source.h"

namespace lightmill {
namespace {

using test::fixture;
using test::replaced;
using test::ScratchFolder;
using test::slurp;
using test::spill;
using ::testing::AllOf;
using ::testing::HasSubstr;

const std::string kPicture = "[target]\nimage = \"/a/portrait.png\"\n";

std::string refusal(const std::string& toml) {
  try {
    read_job_text(toml, "job.toml", "/a");
  } catch (const InputError& e) {
    return e.what();
  }
  return "accepted";
}

TEST(Job, EveryDefaultIsTheContractsAndThePictureIsEnough) {
  const Job job = read_job_text(kPicture, "portrait.toml", "/a");
  EXPECT_EQ(job.name, "portrait");
  EXPECT_EQ(job.lens.size_mm, Vec2(100, 100));
  EXPECT_EQ(job.lens.thickness_mm, 10);
  EXPECT_EQ(job.lens.refractive_index, 1.49);
  EXPECT_EQ(job.receiver.distance_mm, 300);
  EXPECT_EQ(job.receiver.viewed_from, ViewedFrom::kLens);
  EXPECT_EQ(job.transport.samples, 65536);
  EXPECT_EQ(job.surface.mesh, 321);
  EXPECT_EQ(job.surface.weights.direction, 1e-4);
  EXPECT_EQ(job.semi_finish.options.pass, "semi_finish");
  EXPECT_EQ(job.finish.options.pass, "finish");
  EXPECT_EQ(job.dry_run.cusp_limit_um, 1.5) << "what is promised for the planned 1.3 um";
  EXPECT_FALSE(job.stock.height_mm.has_value());
}

TEST(Job, ResolvedJobReadsBackAsItself) {
  const std::string toml =
      "[job]\nname = \"tab\\tquote \\\" and \\\\\"\n" + kPicture +
      "drawing = \"sig.svg\"\nsize_mm = [90, 61.7]\ncurve_flux = 0.13\nbackground = 0.07\ntransfer = \"linear\"\n"
      "[lens]\nsize_mm = [80.1, 50.3]\nthickness_mm = 7.7\nrefractive_index = 1.523\n"
      "[light]\nangular_diameter_deg = 0.53\n[receiver]\ndistance_mm = 217.3\nviewed_from = \"behind\"\n"
      "[transport]\nsamples = 1234\nseed = 7\nl1_tolerance = 3e-5\n"
      "[surface]\nmesh = 77\nheight_tolerance_um = 0.07\nweights = { flux = 0, smoothness = 3e-6 }\n"
      "[stock]\nheight_mm = 21.3\nallowance_mm = 0.9\nmaterial = \"PMMA, extruded\"\nkeep_outs = [[-60, -5, 0, -50.5, 5, 20], [50.5, -5, 0, 60, 5, 21]]\n"
      "[rough]\nallowance_mm = 0.41\nlink_feed_mm_per_min = 777\n[semi_finish]\ncusp_um = 7\nstrategy = \"zig_zag\"\nangle_deg = 33\nmax_feed_mm_per_min = 1234\nacceleration_mm_per_s2 = 777\n"
      "[profile]\ntabs = 3\n[finish]\naxis = \"lead_tilt\"\ntilt_deg = 23\ntilt_direction_deg = 77\nchord_tolerance_um = 0.07\nfeed_per_tooth_mm = 0.017\n"
      "[solid]\nfiner_creases = true\n[machine]\nworkpiece_origin_mm = [12, -7, 3.3]\nwork_offset = 57\n[controller]\ndecimals = 4\nblock_numbers = true\n"
      "[dry_run]\npitch_um = 17\npolish_sigma_um = 0\ntime_factor = 2.5\n[stream]\nport = \"/dev/ttyACM0\"\nbaud = 9600\nprotocol = \"drip\"\nformat = \"7E2\"\nrts_cts = true\n"
      "one_at_a_time = true\nleader_nulls = 40\ncheck_first = false\n";
  const Job job = read_job_text(toml, "x.toml", "/a/b");
  EXPECT_EQ(job.target.drawing, "/a/b/sig.svg") << "relative to the job file";
  const std::string once = resolved_toml(job);
  const Job again = read_job_text(once, "job.toml", "/elsewhere");
  EXPECT_EQ(resolved_toml(again), once);
  EXPECT_EQ(again.name, "tab\tquote \" and \\");
  EXPECT_EQ(again.receiver.viewed_from, ViewedFrom::kBehind);
  EXPECT_EQ(again.target.viewed_from, ViewedFrom::kBehind);
  EXPECT_NEAR(again.finish.options.tilt_rad, 23 * kPi / 180, 1e-12);
  EXPECT_EQ(again.semi_finish.options.strategy, Strategy::kZigZag);
  EXPECT_NEAR(again.semi_finish.options.angle_rad, 33 * kPi / 180, 1e-12);
  EXPECT_NEAR(again.semi_finish.options.max_feed_mm_per_s, 1234 / 60.0, 1e-9);
  EXPECT_EQ(again.semi_finish.options.acceleration_mm_per_s2, 777);
  EXPECT_NEAR(again.rough.options.link_feed_mm_per_s, 777 / 60.0, 1e-9);
  EXPECT_NEAR(again.finish.cutter.feed_per_tooth_mm, 0.017, 1e-15);
  EXPECT_EQ(again.stock.height_mm, 21.3);
  EXPECT_TRUE(again.spline_fit.finer_creases);
  ASSERT_EQ(again.stock.keep_outs.size(), 2);
  EXPECT_EQ(again.stock.keep_outs[0].max_mm, Vec3(-50.5, 5, 20));
  EXPECT_EQ(again.stock.keep_outs[1].min_mm, Vec3(50.5, -5, 0));
  EXPECT_EQ(again.machine.workpiece_origin_mm, Vec3(12, -7, 3.3));
}

TEST(Job, EverySourceLightReadsBackAsItself) {
  for (const char* section :
       {"[light]\nkind = \"point\"\nposition_mm = [1.5, -2, -77]\nprofile = \"gaussian\"\nsigma_mm = 12.5\ncentre_mm = [3, -4]\n",
        "[light]\ndirection = [0.1, -0.2, 1]\nprofile = \"image\"\nimage = \"spot.png\"\n", "[light]\nkind = \"mesh\"\nmesh = \"lamp.ply\"\n",
        "[lens]\noutline = \"brain.svg\"\nbase = \"sphere\"\nbase_radius_mm = -321.5\n",
        "[lens]\nbase = \"cylinder\"\nbase_radius_mm = 99\nbase_axis_deg = 33\n",
        "[lens]\nbase = \"image\"\nbase_file = \"relief.exr\"\nbase_scale_mm = 0.25\n[receiver]\ntilt_deg = [3, -7.5]\nshift_mm = [11, 5]\n",
        "[lens]\nbase = \"mesh\"\nbase_file = \"base.ply\"\n"}) {
    const Job job = read_job_text(kPicture + section, "x.toml", "/a/b");
    const std::string once = resolved_toml(job);
    const Job again = read_job_text(once, "job.toml", "/elsewhere");
    EXPECT_EQ(resolved_toml(again), once) << section;
    EXPECT_FALSE(is_plain_source(again.lens, again.light.beam, again.receiver)) << section;
    // Every line of the section is in the resolved job, files with their folder.
    EXPECT_NE(once, resolved_toml(read_job_text(kPicture, "x.toml", "/a/b")));
  }
  const Job job = read_job_text(kPicture + "[lens]\noutline = \"brain.svg\"\n[receiver]\ntilt_deg = [3, -7.5]\n", "x.toml", "/a/b");
  EXPECT_EQ(job.lens.shape, Lens::Shape::kOutline);
  EXPECT_EQ(job.source_files.outline, "/a/b/brain.svg");
  EXPECT_NEAR(job.receiver.tilt_rad.y(), -7.5 * kPi / 180, 1e-15);
}

TEST(Job, MountingFeaturesReadBackAsThemselvesAndNeedALand) {
  const std::string mount = "[mount]\nchamfer_mm = 0.4\ndowels_mm = [[52.5, 0], [-52.5, 1.25]]\ndowel_depth_mm = 5\nlabel = \"A-7\"\nlabel_side = \"back\"\nlabel_at_mm = [1, -53]\n";
  const std::string once = resolved_toml(read_job_text(kPicture + "[lens]\nland_mm = 6\n" + mount, "x.toml", "/a/b"));
  const Job again = read_job_text(once, "job.toml", "/elsewhere");
  EXPECT_EQ(resolved_toml(again), once);
  EXPECT_EQ(again.mount.dowels_mm, (std::vector<Vec2>{{52.5, 0}, {-52.5, 1.25}}));
  EXPECT_TRUE(again.mount.label_on_back);
  EXPECT_EQ(again.mount.label_at_mm, Vec2(1, -53));
  EXPECT_THAT(refusal(kPicture + mount), AllOf(HasSubstr("mount.chamfer_mm"), HasSubstr("lens.land_mm")));
  EXPECT_THAT(refusal(kPicture + "[mount]\nlabel_side = \"wall\"\n"), HasSubstr("mount.label_side"));
}

TEST(Job, ItsMaterialChoosesTheCuttersData) {
  EXPECT_THAT(refusal(kPicture + "[stock]\nmaterial = \"glass, clear\"\n"), AllOf(HasSubstr("'glass'"), HasSubstr("only for PMMA")));
  const ScratchFolder scratch;
  spill(scratch / "ball.toml", slurp(fixture("cutters/finish_4mm_ball.toml")) +
                                   "[material.PC]\nspindle_rpm = 20000\nfeed_per_tooth_mm = 0.02\nplunge_feed_mm_per_min = 100\n");
  std::string text = kPicture + "[stock]\nmaterial = \"PC\"\n";
  for (const char* pass : {"rough", "semi_finish", "finish"}) text += "[" + std::string(pass) + "]\ncutter = \"" + (scratch / (std::string(pass) + ".toml")).string() + "\"\n";
  for (const char* pass : {"rough", "semi_finish", "finish"}) spill(scratch / (std::string(pass) + ".toml"), slurp(scratch / "ball.toml"));
  EXPECT_EQ(read_job_text(text, "x.toml", "/a/b").finish.cutter.spindle_rpm, 20000);
}

TEST(Job, RefusesWhatWouldPlanForWeeksOrFillTheMemory) {
  for (const auto& [section, line] : std::initializer_list<std::pair<std::string, std::string>>{{"finish", "longest_segment_mm = 1e-9"},
                                                                                               {"finish", "max_feed_mm_per_min = 0.0001"},
                                                                                               {"finish", "link_feed_mm_per_min = 0.0001"},
                                                                                               {"finish", "clearance_mm = 1e-9"},
                                                                                               {"finish", "feed_per_tooth_mm = 1e-7"},
                                                                                               {"semi_finish", "cusp_um = 1e-6"},
                                                                                               {"semi_finish", "chord_tolerance_um = 1e-6"},
                                                                                               {"rough", "stepdown_mm = 1e-9"},
                                                                                               {"rough", "stepover_mm = 1e-9"},
                                                                                               {"rough", "max_feed_mm_per_min = 0.0001"},
                                                                                               {"rough", "clearance_mm = 1e-9"}}) {
    EXPECT_THAT(refusal(kPicture + "[" + section + "]\n" + line + "\n"), HasSubstr(section + "." + line.substr(0, line.find(' '))));
  }
}

TEST(Job, TheDesignIsHeldAgainstTheFinishingBall) {
  const ScratchFolder scratch;
  spill(scratch / "ball.toml", replaced(replaced(slurp(fixture("cutters/finish_4mm_ball.toml")), "\ndiameter_mm = 4.0", "\ndiameter_mm = 3.0"),
                                        "corner_radius_mm = 2.0", "corner_radius_mm = 1.5"));
  const std::string ball = "[finish]\ncutter = \"" + (scratch / "ball.toml").string() + "\"\n";
  EXPECT_EQ(read_job_text(kPicture, "x.toml", "/a/b").surface.min_concave_radius_mm, 2);
  EXPECT_EQ(read_job_text(kPicture + ball, "x.toml", "/a/b").surface.min_concave_radius_mm, 1.5);
  EXPECT_EQ(read_job_text(kPicture + ball + "[surface]\nmin_concave_radius_mm = 7\n", "x.toml", "/a/b").surface.min_concave_radius_mm, 7);
}

TEST(Job, AnImpossibleSourceLightIsRefused) {
  EXPECT_THAT(refusal(kPicture + "[light]\ndirection = [1, 0, 0]\n"), HasSubstr("light.direction"));
  EXPECT_THAT(refusal(kPicture + "[light]\nkind = \"point\"\nposition_mm = [0, 0, 5]\n"), HasSubstr("light.position_mm"));
  EXPECT_THAT(refusal(kPicture + "[light]\nkind = \"mesh\"\n"), HasSubstr("light.mesh"));
  EXPECT_THAT(refusal(kPicture + "[light]\nprofile = \"image\"\n"), HasSubstr("light.image"));
  EXPECT_THAT(refusal(kPicture + "[light]\nsigma_mm = 3\n"), HasSubstr("sigma_mm")) << "only a gaussian has one";
  EXPECT_THAT(refusal(kPicture + "[lens]\nshape = \"outline\"\n"), HasSubstr("lens.shape"));
  EXPECT_THAT(refusal(kPicture + "[lens]\nbase = \"sphere\"\nbase_radius_mm = 0\n"), HasSubstr("base_radius_mm"));
  EXPECT_THAT(refusal(kPicture + "[lens]\nbase = \"mesh\"\n"), HasSubstr("base_file"));
  EXPECT_THAT(refusal(kPicture + "[receiver]\ntilt_deg = [90, 0]\n"), HasSubstr("receiver.tilt_deg"));
}

TEST(Job, EveryResolvedValueIsExplicit) {
  // A resolved job must not lean on a default that a later version may change: every line is read back.
  const std::string resolved = resolved_toml(read_job_text(kPicture, "p.toml", "/a"));
  for (const char* key : {"curve_flux", "refractive_index", "angular_diameter_deg", "viewed_from", "seed", "smoothness", "allowance_mm",
                          "cutter", "cusp_um", "tilt_direction_deg", "work_offset", "decimals", "polish_sigma_um", "baud"}) {
    EXPECT_THAT(resolved, HasSubstr(key));
  }
}

TEST(Job, ADecimalCommaLocaleChangesNothing) {
  const Job job = read_job_text(kPicture, "p.toml", "/a");
  const std::string plain = resolved_toml(job);
  const char* german = std::setlocale(LC_ALL, "de_DE.UTF-8");
  const std::string there = resolved_toml(read_job_text(plain, "p.toml", "/a"));
  std::setlocale(LC_ALL, "C");
  EXPECT_EQ(there, plain) << (german ? "" : "(the locale is not installed: this proved little)");
}

TEST(Job, ErrorsNameLineKeyAndRule) {
  EXPECT_THAT(refusal(kPicture + "[lens]\ntickness_mm = 3\n"), AllOf(HasSubstr("job.toml:4"), HasSubstr("lens.tickness_mm"), HasSubstr("thickness_mm")));
  EXPECT_THAT(refusal(kPicture + "[lens]\nsize_mm = [100, -1]\n"), AllOf(HasSubstr("lens.size_mm"), HasSubstr("above 0")));
  EXPECT_THAT(refusal(kPicture + "[lens]\nsize_mm = \"big\"\n"), HasSubstr("lens.size_mm"));
  EXPECT_THAT(refusal(kPicture + "[surface]\nmesh = 32.5\n"), HasSubstr("surface.mesh"));
  EXPECT_THAT(refusal(kPicture + "[surface.weights]\nflix = 1\n"), HasSubstr("surface.weights.flix"));
  EXPECT_THAT(refusal("[lens]\n"), HasSubstr("target.image"));
  EXPECT_THAT(refusal(kPicture + "[finish]\ncusp_um = 0\n"), HasSubstr("finish.cusp_um"));
  EXPECT_THAT(refusal(kPicture + "[stock]\nheight_mm = \"tall\"\n"), HasSubstr("stock.height_mm"));
  EXPECT_THAT(refusal(kPicture + "[stock]\nkeep_outs = [[0, 0, 0, 1, 1]]\n"), HasSubstr("keep_outs"));
  EXPECT_THAT(refusal(kPicture + "[stock]\nkeep_outs = [[0, 0, 0, 1, -1, 1]]\n"), AllOf(HasSubstr("keep_outs"), HasSubstr("below the second")));
  EXPECT_THAT(refusal(kPicture + "[rough]\nallowance_mm = 0.05\n"), HasSubstr("rough.allowance_mm"));
  EXPECT_THAT(refusal(kPicture + "[lense]\n"), HasSubstr("lense"));
}

TEST(Job, ARestPassTakesTheFinishingsKeysAndASmallerBall) {
  EXPECT_FALSE(read_job_text(kPicture, "a.toml", "/").rest.has_value());
  const Job job = read_job_text(kPicture + "[finish]\nblur_mm = 0.33\naxis = \"vertical\"\nstrategy = \"spiral\"\nalong_creases = true\n[rest]\n[dry_run]\npolish_sigma_um = 50\n", "a.toml", "/");
  ASSERT_TRUE(job.rest.has_value());
  EXPECT_EQ(job.rest->options.pass, "rest");
  EXPECT_EQ(job.rest->options.axis, AxisPolicy::kVertical);
  EXPECT_EQ(job.rest->options.strategy, Strategy::kOneWay);
  EXPECT_EQ(job.rest->options.cusp_um, job.finish.options.cusp_um);
  EXPECT_TRUE(job.finish.along_creases);
  const std::string once = resolved_toml(job);
  EXPECT_EQ(resolved_toml(read_job_text(once, "job.toml", "/elsewhere")), once);
  EXPECT_THAT(refusal(kPicture + "[rest]\ncutter = \"" + (fixtures_folder() / "cutters/semi_finish_4mm_ball.toml").string() + "\"\n"), HasSubstr("smaller ball"));
  EXPECT_THAT(refusal(kPicture + "[rest]\nstrategy = \"spiral\"\n"), HasSubstr("rest.strategy"));
  EXPECT_THAT(refusal(kPicture + "[semi_finish]\nalong_creases = true\n"), HasSubstr("semi_finish.along_creases"));
}

TEST(Job, AViseStandsBesideTheBlankAndClampsNeedTheirRoom) {
  const Job job = read_job_text(kPicture + "[stock]\nwork_holding = \"vise\"\njaw_mm = [60, 15, 4]\nmargin_mm = 3\nkeep_outs = [[-70, 0, 0, -60, 5, 9]]\n", "a.toml", "/");
  const std::vector<KeepOut> all = keep_outs_of(job);
  ASSERT_EQ(all.size(), 3U);
  EXPECT_EQ(all[1].min_mm, Vec3(-30, -53 - 15, 0));
  EXPECT_EQ(all[1].max_mm, Vec3(30, -53, 4));
  EXPECT_EQ(all[2].min_mm, Vec3(-30, 53, 0));
  const std::string once = resolved_toml(job);
  EXPECT_EQ(resolved_toml(read_job_text(once, "job.toml", "/elsewhere")), once);
  EXPECT_THAT(refusal(kPicture + "[stock]\nwork_holding = \"clamps\"\n"), HasSubstr("keep_outs"));
  EXPECT_THAT(refusal(kPicture + "[stock]\nwork_holding = \"glue\"\n"), HasSubstr("work_holding"));
  EXPECT_TRUE(keep_outs_of(read_job_text(kPicture, "a.toml", "/")).empty());
}

TEST(Job, WhatIsForeseenButNotThereSaysSo) {
  const std::string soon = "not supported yet";
  for (const char* section : {"[semi_finish]\nblur_mm = 0.3\n", "[rough]\naxis = \"fixed\"\n", "[dry_run]\nerror_model = \"x\"\n"}) {
    EXPECT_THAT(refusal(kPicture + section), HasSubstr(soon)) << section;
  }
}

TEST(Job, AVibrationNeedsItsFrequency) {
  const std::string section = kPicture + "[dry_run]\nerrors.vibration_um = [0, 0, 1]\n";
  EXPECT_THAT(refusal(section), HasSubstr("vibration_hz"));
  EXPECT_EQ(read_job_text(section + "errors.vibration_hz = 10\n", "a.toml", "/").dry_run.errors.vibration_hz, 10);
  EXPECT_EQ(read_job_text(kPicture + "[dry_run]\nerrors.vibration_hz = 10\n", "a.toml", "/").dry_run.errors.vibration_mm.z(), 0);
}

TEST(Job, ABlurOnTheWallGivesTheCusp) {
  // 1.5 um at 300 mm: 3.3 mm raw, 0.33 mm after a polish of 50 um.
  const Job raw = read_job_text(kPicture + "[finish]\nblur_mm = 3.29\n[dry_run]\npolish_sigma_um = 0\n", "a.toml", "/");
  EXPECT_NEAR(raw.finish.options.cusp_um, 1.5, 0.02);
  const Job polished = read_job_text(kPicture + "[finish]\nblur_mm = 0.33\n[dry_run]\npolish_sigma_um = 50\n", "a.toml", "/");
  EXPECT_NEAR(polished.finish.options.cusp_um, 1.5, 0.03);
  EXPECT_GT(polished.dry_run.cusp_limit_um, polished.finish.options.cusp_um);
  EXPECT_NEAR(read_job_text(resolved_toml(polished), "a.toml", "/").finish.options.cusp_um, polished.finish.options.cusp_um, 1e-9);
  EXPECT_THAT(refusal(kPicture + "[finish]\nblur_mm = 1\ncusp_um = 1\n"), HasSubstr("one of them"));
  EXPECT_THAT(refusal(kPicture + "[finish]\nblur_mm = 0.001\n[dry_run]\npolish_sigma_um = 0\n"), HasSubstr("polish more"));
}

TEST(Job, APictureIsAJob) {
  const ScratchFolder folder;
  spill(folder / "cat.PNG", "not read here");
  EXPECT_EQ(read_job(folder / "cat.PNG").target.image, folder / "cat.PNG");
  spill(folder / "ink.svg", "not read here");
  const Job drawn = read_job(folder / "ink.svg");
  EXPECT_EQ(drawn.target.drawing, folder / "ink.svg");
  EXPECT_TRUE(drawn.target.image.empty());
  EXPECT_THROW(read_job(folder / "absent.png"), InputError);
}

}  // namespace
}  // namespace lightmill
