#!/usr/bin/env bash
# Builds Lightmill and makes the main job: a portrait with a signature, from picture to milled lens.
# Usage: ./demo.sh [output folder]   (default: out/portrait)
set -euo pipefail
cd "$(dirname "$0")"
out=${1:-out/portrait}
.ci/install build
cmake --preset release -DLIGHTMILL_TESTS=OFF >/dev/null
cmake --build --preset release --target lightmill -- --quiet
build/release/lightmill make fixtures/jobs/portrait.toml -o "$out"
