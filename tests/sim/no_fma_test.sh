#!/bin/sh
# Fails where the given object files or static libraries hold a fused multiply-add (it rounds once where two roundings are promised, so
# results would depend on the machine), or where nothing was there to look at.
# Usage: no_fma_test.sh FILE...
set -eu

if [ $# -eq 0 ]; then
  echo "usage: $0 FILE..." >&2
  exit 2
fi

code=$(mktemp)
trap 'rm -f "$code"' EXIT
objdump --disassemble --no-show-raw-insn "$@" >"$code"

# The mnemonic is the first word after the address: vfmadd132ps, vfmsubadd213pd, vfnmadd231ss, and vfmaddps of FMA4.
if grep -E '^ *[0-9a-f]+:[[:space:]]+(\{[a-z0-9]+\} )?vfn?m(add|sub)' "$code"; then
  echo "fused multiply-add found" >&2
  exit 1
fi
# Proof that this was code in lanes.
if ! grep -qE '^ *[0-9a-f]+:[[:space:]]+v?mulps' "$code"; then
  echo "no packed multiplication found: is this the solver?" >&2
  exit 1
fi
