#!/usr/bin/env bash
# Fuzzes the program readers, the simulated machine's protocol, the SVG reader and those of jobs, cutters, machines and meshes.
#   run.sh [seconds of each, 60] [folder for what it finds]   with libFuzzer; needs make and clang with compiler-rt (Debian:
#                                                             make clang libclang-rt-14-dev)
#   run.sh --brief [seconds of each, 8] [folder]              with what ./test.sh asan has built: mutations of seeds, not guided
#                                                             by coverage (without_libfuzzer.cpp)
# What is found: folder/TARGET-crash-... or folder/TARGET.found; the programs take such a file as their only argument.
set -euo pipefail
cd "$(dirname "$0")/../.."
brief=
if [[ ${1:-} == --brief ]]; then
  brief=yes
  shift
fi
seconds=${1:-$([[ $brief ]] && echo 8 || echo 60)}
targets="program_reader machine_protocol svg_reader file_reader"
work=$(realpath -m "${2:-build/fuzz}")

seeds() { # of a target
  if [[ $1 == svg_reader ]]; then ls fixtures/pictures/*.svg; else ls tests/fuzz/seeds/"$1"/*; fi
}
dictionary() {
  case $1 in
    svg_reader) echo tests/fuzz/svg_reader.dict ;;
    file_reader) echo tests/fuzz/files.dict ;;
    *) echo tests/fuzz/words.dict ;;
  esac
}

if [[ $brief ]]; then
  export LSAN_OPTIONS="suppressions=$PWD/.ci/lsan:print_suppressions=0"
  for target in $targets; do
    rm -rf "$work/$target.seeds"
    mkdir -p "$work/$target.seeds"
    cp $(seeds $target) "$work/$target.seeds/"
    build/asan/tests/fuzz/${target}_fuzz "$seconds" "$work/$target.seeds" "$(dictionary $target)" "$work/$target.found"
  done
  exit
fi

work=$work targets="$targets" make -s -j2 -f - <<'MAKE'
core := $(patsubst %,design/core/%.cpp,files image markup parallel text toml_table)
readers := $(wildcard machine/detail/*reader*.cpp machine/detail/word_*.cpp machine/detail/heidenhain_*.cpp machine/detail/siemens_*.cpp) \
  $(patsubst %,machine/detail/%.cpp,contour_corner cutter_compensation expressions plane_paths splines work_frame) machine/kinematics.cpp machine/machine_errors.cpp
machine := $(patsubst %,machine/detail/%.cpp,fault_picture grbl_controller interpreter mill receiving_controllers sent_text) \
  $(wildcard machine/detail/stock_*.cpp) machine/detail/swept_body.cpp $(patsubst %,machine/%.cpp,simulated_machine stock_model \
  solid_stock ray_bundle clock cable pseudo_terminal program_lines kinematics machine_errors) postproc/machine_model.cpp cam/cutter.cpp
drawing := $(wildcard design/detail/svg*.cpp) design/detail/fills.cpp design/detail/coverage.cpp design/target.cpp
files := $(wildcard postproc/detail/*.cpp) $(patsubst %,postproc/%.cpp,machine_model program program_check kinematics) \
  $(patsubst %,cam/%.cpp,cutter finishing outline outline_region spline_surface work_holding) \
  $(patsubst %,cam/detail/%.cpp,ball_contact ball_passes feeds grooves spline_hull tool_axis tool_clearance) \
  $(patsubst %,cli/%.cpp,job errors_file npy) design/mesh.cpp machine/serial_connection.cpp machine/clock.cpp
objects = $(patsubst %.cpp,$(work)/objects/%.o,$(1))
every := $(sort $(call objects,$(core) $(readers) $(machine) $(drawing) $(files) $(targets:%=tests/fuzz/%_fuzz.cpp)))
link = clang++ -fsanitize=fuzzer,address,undefined $^ -ltbb -lOpenImageIO -lOpenImageIO_Util -l2geom -lpugixml -lserial -o $@
all: $(targets:%=$(work)/%)
$(work)/program_reader: $(call objects,tests/fuzz/program_reader_fuzz.cpp $(readers) $(core))
	$(link)
$(work)/machine_protocol: $(call objects,tests/fuzz/machine_protocol_fuzz.cpp $(machine) $(core))
	$(link)
$(work)/svg_reader: $(call objects,tests/fuzz/svg_reader_fuzz.cpp $(drawing) $(core))
	$(link)
$(work)/file_reader: $(call objects,tests/fuzz/file_reader_fuzz.cpp $(files) $(core))
	$(link)
$(every): $(work)/objects/%.o: %.cpp
	@mkdir -p $(@D)
	$(shell command -v ccache) clang++ -std=c++20 -O1 -g -DNDEBUG -ffp-contract=off -fsanitize=fuzzer-no-link,address,undefined \
	  -fno-sanitize-recover=undefined -DLIGHTMILL_FIXTURES='"$(CURDIR)/fixtures"' -DLIGHTMILL_VERSION='"0"' -I. -isystem /usr/include/eigen3 $$(pkg-config --cflags 2geom pugixml OpenImageIO) -MMD -c $< -o $@
-include $(every:.o=.d)
MAKE

for target in $targets; do
  mkdir -p "$work/$target.corpus"
  cp -n $(seeds $target) "$work/$target.corpus/"
  "$work/$target" -max_total_time="$seconds" -max_len=4000 -rss_limit_mb=1000 -timeout=30 -dict="$(dictionary $target)" \
    -artifact_prefix="$work/$target-" -print_final_stats=1 "$work/$target.corpus"
done
