#!/usr/bin/env bash
# Installs, builds and passes every test: the sanitizers, the fuzz targets, coverage and style first, the release build last, so
# that the output ends with its summary. Everything goes into build/.
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/install-packages.sh test
scripts/intel-opencl.sh build/intel-opencl
scripts/dcc-packages.sh build/dcc &  # half a minute or more, most of it waiting
dcc=$!
trap 'kill "$dcc" 2>/dev/null || true' EXIT
jobs=$(nproc)
step() { printf '\n== %s (%s s)\n' "$1" "$SECONDS"; }
configure() {
  mkdir -p "build/$1"
  cmake --preset "$1" -DSTRANDBAKE_TESTS=ON >"build/$1/configure.log" 2>&1 || { cat "build/$1/configure.log" >&2; return 1; }
}

step "format"
git ls-files '*.h' '*.cpp' | xargs clang-format-14 --dry-run --Werror

step "address and undefined-behaviour sanitizers"
configure asan-ubsan
cmake --build --preset asan-ubsan -j "$jobs"
step "tests under the sanitizers, and every reader fuzzed for a while"
ctest --preset asan-ubsan -j "$jobs" --no-tests=error

step "coverage of sim and formats by those tests"
gcovr --root . --object-directory build/asan-ubsan --gcov-executable 'llvm-cov-14 gcov' --filter 'sim/' --filter 'formats/' \
  --print-summary --fail-under-line 90 --exclude-unreachable-branches --txt build/asan-ubsan/coverage.txt
grep -E '^(File|TOTAL|sim|formats)' build/asan-ubsan/coverage.txt || true

step "release"
configure release
cmake --build --preset release -j "$jobs"
step "instructions of a small bake"
scripts/count_instructions.py
wait "$dcc"
step "tests"
ctest --preset release -j "$jobs" --no-tests=error
