#!/usr/bin/env bash
# headless.sh PROGRAM "G10 L2 P1 X.. Y.. Z.." TOOL_TABLE FOLDER: runs a program on LinuxCNC without a screen, with the kinematics of
# the B/C trunnion (xyzbc-trt-kins, C axis through Z-380, B at X-20 Z-15 from it), and samples the joints into FOLDER/joints.txt:
# "line X Y Z B C". As root with libfaketime eight times as fast, otherwise in real time. 77: LinuxCNC is not here.
set -euo pipefail
program=$(realpath "$1"); zero=$2; table=$(realpath "$3"); folder=$4
here=$(dirname "$(realpath "$0")")
samples=/usr/share/doc/linuxcnc/examples/sample-configs/sim/axis/vismach/5axis/table-rotary-tilting
command -v linuxcnc > /dev/null && [ -d "$samples/remap_subs" ] && /usr/bin/python3 -c 'import linuxcnc' 2> /dev/null || exit 77

mkdir -p "$folder"; cd "$folder"
rm -rf joints.txt remap_subs; cp -r "$samples/remap_subs" .
cp "$program" program.ngc; cp "$table" tools.tbl; cp "$here/run_program.py" .; chmod +x run_program.py
printf '%s\n' "$zero" > zero.mdi
{
  cat <<'INI'
[EMC]
VERSION = 1.1
MACHINE = trunnion
[DISPLAY]
DISPLAY = ./run_program.py
[RS274NGC]
SUBROUTINE_PATH = ./remap_subs
HAL_PIN_VARS = 1
REMAP = M428 modalgroup=10 ngc=428remap
REMAP = M429 modalgroup=10 ngc=429remap
PARAMETER_FILE = parameters.var
[KINS]
KINEMATICS = xyzbc-trt-kins sparm=identityfirst
JOINTS = 5
[HAL]
HALFILE = LIB:basic_sim.tcl -no_use_hal_manualtoolchange
HALCMD = net :kinstype-select <= motion.analog-out-03 => motion.switchkins-type
HALCMD = net :tool-offset motion.tooloffset.z => xyzbc-trt-kins.tool-offset
HALCMD = setp xyzbc-trt-kins.x-offset -20
HALCMD = setp xyzbc-trt-kins.z-offset -15
HALCMD = setp xyzbc-trt-kins.z-rot-point -380
[TRAJ]
COORDINATES = XYZBC
LINEAR_UNITS = mm
ANGULAR_UNITS = deg
DEFAULT_LINEAR_VELOCITY = 200
MAX_LINEAR_VELOCITY = 200
MAX_LINEAR_ACCELERATION = 4000
NO_FORCE_HOMING = 1
[EMCMOT]
EMCMOT = motmod
SERVO_PERIOD = 1000000
COMM_TIMEOUT = 1
[TASK]
TASK = milltask
CYCLE_TIME = 0.010
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = tools.tbl
INI
  limits() { printf 'MAX_VELOCITY = %s\nMAX_ACCELERATION = %s\nMIN_LIMIT = -%s\nMAX_LIMIT = %s\n' "$1" "$2" "$3" "$3"; }
  joint=0
  for axis in X Y Z B C; do
    values="200 4000 1000"; type=LINEAR
    case $axis in B | C) values="120 2000 36000"; type=ANGULAR ;; esac
    printf '[AXIS_%s]\n' "$axis"; limits $values
    printf '[JOINT_%s]\nTYPE = %s\nHOME = 0\nHOME_SEARCH_VEL = 0\nHOME_SEQUENCE = 0\n' "$joint" "$type"; limits $values
    joint=$((joint + 1))
  done
} > machine.ini

export HOME=$PWD  # LinuxCNC keeps a tool table and a log there
faster=$(ls /usr/lib/*/faketime/libfaketimeMT.so.1 2> /dev/null | head -1 || true)
if [ "$(id -u)" = 0 ]; then
  chmod a+rwx .
  export RTAPI_UID=65534 RTAPI_FIFO_PATH=$PWD/fifo
  # The dynamic loader keeps a preloaded library out of set-user-id programs, so that only root can hurry the clock.
  [ -z "$faster" ] || export LD_PRELOAD=$faster FAKETIME="+0 x8"
fi
timeout 240 linuxcnc -r machine.ini > linuxcnc.log 2>&1
grep -q "^the program has ended$" linuxcnc.log
