#!/usr/bin/env bash
# Builds Lightmill and passes its tests. Usage: ./test.sh [release|dev|asan] [more arguments for ctest]
set -euo pipefail
cd "$(dirname "$0")"
preset=${1:-release}
shift || true
.ci/install test
cmake --preset "$preset" -DLIGHTMILL_TESTS=ON >/dev/null
cmake --build --preset "$preset" -- --quiet
export LSAN_OPTIONS="suppressions=$PWD/.ci/lsan:print_suppressions=0"
ctest --preset "$preset" -j 2 "$@"
