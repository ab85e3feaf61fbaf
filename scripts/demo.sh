#!/usr/bin/env bash
# Installs, builds, bakes the demo scene, and leaves a picture of it. Everything goes into build/.
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/install-packages.sh build
mkdir -p build/release
cmake --preset release -DSTRANDBAKE_TESTS=OFF >build/release/configure.log 2>&1 || { cat build/release/configure.log >&2; exit 1; }
cmake --build --preset release --target strandbake

out=build/demo
mkdir -p "$out"
program=build/release/cli/strandbake
"$program" groom --style wavy --strands 12000 --vertices 24 --seed 7 -o "$out/demo.hair" --force
"$program" bake scenes/demo.toml --search "$out" -o "$out/demo.h5" --force
"$program" preview "$out/demo.h5" -o "$out/demo.png" --force

echo
echo "The cache:   $out/demo.h5"
echo "The picture: $out/demo.png"
