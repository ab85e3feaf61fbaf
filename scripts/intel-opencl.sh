#!/usr/bin/env bash
# Installs Intel's OpenCL for CPUs into a folder, as a second implementation for the tests of gpu/ beside PoCL. Where it
# cannot be had, says so and goes on; the test skips then.
#   scripts/intel-opencl.sh build/intel-opencl
set -euo pipefail

folder=${1:?"usage: scripts/intel-opencl.sh FOLDER"}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
[ -e "$folder/intel.icd" ] && exit 0
if /usr/bin/python3 -m venv "$folder/venv" >"$folder/install.log" 2>&1 &&
  timeout 600 "$folder/venv/bin/pip" install --disable-pip-version-check intel-opencl-rt==2026.2.0 intel-cmplr-lib-rt==2026.2.0 \
    >>"$folder/install.log" 2>&1 &&
  [ -e "$folder/venv/lib/libintelocl.so" ]; then
  echo "$folder/venv/lib/libintelocl.so" >"$folder/intel.icd"
else
  echo "Intel's OpenCL cannot be installed, its test will be skipped: $(tail -n 1 "$folder/install.log")"
fi
