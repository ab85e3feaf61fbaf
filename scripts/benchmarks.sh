#!/usr/bin/env bash
# Builds, runs every benchmark, and renews what docs/PERFORMANCE.md and docs/ACCURACY.md show: the tables in them, and the
# plots and figures in docs/performance/. Wants a quiet machine and about fifteen minutes; --quick is a first look that
# changes nothing in docs/.
set -euo pipefail
cd "$(dirname "$0")/.."

quick=()
out=docs/performance
if [ "${1:-}" = --quick ]; then
  quick=(--quick)
  out=build/benchmarks
fi
mkdir -p build/release "$out"
cmake --preset release -DSTRANDBAKE_TESTS=OFF >build/release/configure.log 2>&1 || { cat build/release/configure.log >&2; exit 1; }
cmake --build --preset release --target strandbake

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
for name in table2 passes scaling bake features error stability; do
  build/release/cli/strandbake bench "$name" ${quick[@]+"${quick[@]}"} --folder "$scratch" --force --csv "$out/$name.csv" \
    --svg "$out/$name.svg" | tee "$scratch/$name.txt"
  echo
done
[ ${#quick[@]} -eq 0 ] || exit 0

# What stands between "<!-- NAME -->" and "<!-- end -->" is replaced by what the benchmark has printed.
for page in PERFORMANCE ACCURACY; do
  awk -v folder="$scratch" '
  /^<!-- end -->$/ { skipping = 0 }
  !skipping { print }
  /^<!-- [a-z0-9]+ -->$/ && !/end/ {
    file = folder "/" $2 ".txt"
    print "```text"
    while ((getline line < file) > 0) print line
    print "```"
    skipping = 1
  }
' "docs/$page.md" >"$scratch/$page.md"
  cp "$scratch/$page.md" "docs/$page.md"
done
