#!/usr/bin/env bash
# Fuzzes the program readers and the simulated machine's protocol: run.sh [seconds of each, 60] [folder for what it finds]
# Needs make and clang with compiler-rt (Debian: make clang libclang-rt-14-dev); the build's own compiler has no libFuzzer. The suite
# has seeded mutations of its own (SurvivesMutatedPrograms, SurvivesMutatedBytes), so that every change is fuzzed briefly.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds=${1:-60}
work=$(realpath -m "${2:-build/fuzz}")

work=$work make -s -j2 -f - <<'MAKE'
readers := $(wildcard machine/detail/*reader*.cpp machine/detail/word_*.cpp machine/detail/heidenhain_*.cpp machine/detail/siemens_*.cpp) \
  $(patsubst %,machine/detail/%.cpp,cutter_compensation expressions splines work_frame) machine/kinematics.cpp machine/machine_errors.cpp
machine := $(sort $(readers) $(wildcard machine/detail/*.cpp)) machine/simulated_machine.cpp machine/stock_model.cpp machine/solid_stock.cpp machine/ray_bundle.cpp machine/clock.cpp \
  machine/cable.cpp machine/pseudo_terminal.cpp machine/program_lines.cpp postproc/machine_model.cpp cam/cutter.cpp \
  design/core/files.cpp design/core/image.cpp design/core/markup.cpp design/core/parallel.cpp design/core/text.cpp design/core/toml_table.cpp
objects = $(patsubst %.cpp,$(work)/objects/%.o,$(1))
every := $(call objects,$(machine) tests/fuzz/program_reader_fuzz.cpp tests/fuzz/machine_protocol_fuzz.cpp)
link = clang++ -fsanitize=fuzzer,address,undefined $^ -ltbb -lOpenImageIO -lOpenImageIO_Util -o $@
all: $(work)/program_reader $(work)/machine_protocol
$(work)/program_reader: $(call objects,tests/fuzz/program_reader_fuzz.cpp $(readers))
	$(link)
$(work)/machine_protocol: $(call objects,tests/fuzz/machine_protocol_fuzz.cpp $(machine))
	$(link)
$(every): $(work)/objects/%.o: %.cpp
	@mkdir -p $(@D)
	clang++ -std=c++20 -O1 -g -DNDEBUG -ffp-contract=off -fsanitize=fuzzer-no-link,address,undefined \
	  -fno-sanitize-recover=undefined -I. -isystem /usr/include/eigen3 -MMD -c $< -o $@
-include $(every:.o=.d)
MAKE

for target in program_reader machine_protocol; do
  mkdir -p "$work/$target.corpus"
  cp -n tests/fuzz/seeds/"$target"/* "$work/$target.corpus/"
  "$work/$target" -max_total_time="$seconds" -max_len=4000 -rss_limit_mb=1000 -timeout=30 -dict=tests/fuzz/words.dict \
    -artifact_prefix="$work/$target-" -print_final_stats=1 "$work/$target.corpus"
done
