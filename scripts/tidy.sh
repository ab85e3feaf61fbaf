#!/usr/bin/env bash
# clang-tidy over our own sources; takes the folder of a build that clang configured.
set -euo pipefail
cd "$(dirname "$0")/.."
git ls-files 'sim/*.cpp' 'formats/*.cpp' 'cli/*.cpp' | grep -vE '^(sim/lanes|cli/bench/probe)_' |
  xargs -P "$(nproc)" -n 2 clang-tidy-14 -p "$1" --quiet
