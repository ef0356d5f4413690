#!/usr/bin/env bash
# Fuzzes the program readers and the simulated machine's protocol: run.sh [seconds of each, 60] [folder for what it finds]
# Needs clang with compiler-rt (Debian: clang libclang-rt-14-dev); the build's own compiler has no libFuzzer. The suite
# has seeded mutations of its own (SurvivesMutatedPrograms, SurvivesMutatedBytes), so that every change is fuzzed briefly.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds=${1:-60}
work=$(realpath -m "${2:-build/fuzz}")
mkdir -p "$work/objects"
flags="-std=c++20 -O1 -g -DNDEBUG -ffp-contract=off -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=undefined -I. -isystem /usr/include/eigen3"

sources="machine/detail/*.cpp machine/kinematics.cpp machine/machine_errors.cpp machine/simulated_machine.cpp machine/stock_model.cpp machine/clock.cpp
  machine/cable.cpp machine/pseudo_terminal.cpp machine/program_lines.cpp postproc/machine_model.cpp cam/cutter.cpp
  design/core/files.cpp design/core/image.cpp design/core/parallel.cpp design/core/markup.cpp design/core/text.cpp design/core/toml_table.cpp"
object() { echo "$work/objects/$(tr / _ <<< "${1%.cpp}").o"; }
export -f object
export work flags
for source in $sources tests/fuzz/program_reader_fuzz.cpp tests/fuzz/machine_protocol_fuzz.cpp; do
  [ "$(object "$source")" -nt "$source" ] || echo "$source"
done | xargs -r -P 2 -I{} bash -c 'clang++ $flags -c {} -o "$(object {})"'

objects=$(for source in $sources; do object "$source"; done)
for target in program_reader machine_protocol; do
  # shellcheck disable=SC2086
  clang++ -fsanitize=fuzzer,address,undefined $objects "$(object tests/fuzz/${target}_fuzz.cpp)" -ltbb -lOpenImageIO -lOpenImageIO_Util -o "$work/$target"
  mkdir -p "$work/$target.corpus"
  cp -n tests/fuzz/seeds/"$target"/* "$work/$target.corpus/"
  "$work/$target" -max_total_time="$seconds" -max_len=4000 -rss_limit_mb=1000 -timeout=30 -dict=tests/fuzz/words.dict \
    -artifact_prefix="$work/$target-" -print_final_stats=1 "$work/$target.corpus"
done
