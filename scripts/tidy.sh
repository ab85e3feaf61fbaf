#!/usr/bin/env bash
# clang-tidy over our own sources; takes the folder of a configured build.
set -euo pipefail
cd "$(dirname "$0")/.."
git ls-files 'sim/*.cpp' 'formats/*.cpp' 'cli/*.cpp' | grep -v '^sim/lanes_' |
  xargs -P "$(nproc)" -n 4 clang-tidy-14 -p "$1" --quiet 2>/dev/null
