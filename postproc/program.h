// Axis motion to program text in the machine's dialect.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "postproc/axis_motion.h"

namespace lightmill {

struct ProgramOptions {
  int decimals = 5;            ///< of mm and degrees
  bool block_numbers = false;  ///< N words where the control does not ask for them anyway
  bool tcp = false;            ///< by the control's tool-centre-point control: X, Y, Z in the workpiece frame
  std::string job_name;
  std::string job_hash;
  double warm_up_s = 8;         ///< spindle dwell before the first cut; the machine's own start time if that is longer
  double smoothing_mm = 0.002;  ///< what the control may leave its path by: G64 P, cycle 32, CYCLE832
  double smoothing_deg = 0.02;  ///< the same for rotary axes
  double arc_tolerance_mm = 0;  ///< G2 and G3 replace straight moves that stay this near; 0: none
  int part = 0, parts = 0;      ///< of a pass in several programs, from 1; 0: whole
};

/// Of a program, or of what it has for one pass.
struct ProgramFigures {
  std::size_t blocks = 0;           ///< blocks for the control, without comments
  std::size_t bytes = 0;
  std::vector<double> feed_seconds; ///< planned, of each feed block
  std::size_t arcs = 0;             ///< blocks of G2 and G3
  double rounding_s = 0;            ///< that whole milliseconds (FT) add to the planned times,
  double worst_rounding = 1;        ///< and the greatest factor for one block
  double max_arc_error_mm = 0;      ///< between arcs and the straight moves that they replace

  ProgramFigures& operator+=(const ProgramFigures& other);
};

struct Program : ProgramFigures {
  std::string file_name;                ///< "30_finish.nc", "30_FINISH.H", "LM_30_FINISH.MPF"
  std::string text;                     ///< ASCII
  std::vector<std::string> passes;      ///< that it makes, or a part of
  std::vector<ProgramFigures> by_pass;  ///< as `passes`; its head counts for the first, its end for the last
};

/// The name of a pass' program: "10_rough", "20_semi_finish", "30_finish", "40_<pass>", as the dialect wants it.
std::string program_file_name(const std::string& pass, const std::string& controller);

/// One program for the passes in their order, each with its tool: header, tool change, spindle with dwell, air,
/// smoothing, machine-top Z before any rotary move, the cut, safe end. Without tool-centre-point control words are axis
/// positions (the gauge point less the work offset's zero and, in Z, less the tool's length); feeds are per minute if
/// no rotary joint moves in the cut of the pass, otherwise every block carries its time (G93, FT), rounded to the
/// slower side. With it words are the tip in the workpiece frame (on Heidenhain the ball's centre) and feeds those of
/// that point. Only words that changed. With `arc_tolerance_mm`, runs of straight cuts at one feed and with still rotary
/// axes become arcs in the plane they bend in. Throws InputError for what machine, tool or control do not allow, and
/// NumericalError if the finished text fails check_program_text().
Program write_program(const MachineModel& machine, const WorkSetup& setup, std::span<const AxisMotion> passes,
                      const ProgramOptions& options = {});
Program write_program(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                      const ProgramOptions& options = {});

/// Throws InputError for what the options ask of a control that cannot, whatever the path: decimals, arcs,
/// tool-centre-point control.
void check_program_options(const MachineModel& machine, const ProgramOptions& options);

/// Does write_program() use tool-centre-point control for this pass? M128 takes ball cutters only, so a Heidenhain
/// control gets other cutters' fixed passes through the kinematics. Throws InputError where the control cannot.
bool uses_tcp(const MachineModel& machine, const AxisMotion& motion, const ProgramOptions& options);

/// A dialect as `lightmill dialects` lists it.
struct DialectFacts {
  std::string name;
  std::string title;
  std::string extension;
  int most_decimals = 0;
  bool tcp = false;  ///< can have tool-centre-point control
};
std::vector<DialectFacts> dialects();

}  // namespace lightmill
