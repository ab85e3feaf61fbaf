#!/usr/bin/env bash
# intel_test.sh FOLDER TESTS...: runs tests on Intel's OpenCL for CPUs, where scripts/intel-opencl.sh has put it into FOLDER.
set -euo pipefail
folder=$1
shift
[ -e "$folder/intel.icd" ] || { echo "skipped: scripts/intel-opencl.sh $folder has not installed Intel's OpenCL"; exit 77; }
export OCL_ICD_VENDORS=$folder LD_LIBRARY_PATH=$folder/venv/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
"$@" | tee "$folder/test.log"
if grep -q 'skipped: there is no OpenCL device' "$folder/test.log"; then
  echo "Intel's OpenCL is installed but lists no device" >&2
  exit 1
fi
