#!/usr/bin/env bash
# Installs what the project needs on Debian 12, and nothing that is there already.
#   scripts/install-packages.sh build     to build and run the program
#   scripts/install-packages.sh test      also to test it
set -euo pipefail

packages=(g++ cmake ninja-build pkg-config libeigen3-dev libassimp-dev libhdf5-dev libdeflate-dev libtomlplusplus-dev
  libcli11-dev libfmt-dev nlohmann-json3-dev libgif-dev libpng-dev nettle-dev opencl-c-headers)
if [ "${1:-build}" = test ]; then
  packages+=(catch2 clang-14 llvm-14 libclang-rt-14-dev libomp-14-dev clang-format-14 clang-tidy-14 gcovr hdf5-tools binutils
    valgrind pocl-opencl-icd ocl-icd-libopencl1 oclgrind python3 python3-venv python3-h5py python3-numpy python3-pytest
    python3-yaml python3-jsonschema assimp-testmodels zsh fish mandoc dpkg-dev python3-pil ffmpeg
    chromium)
  packages+=(libegl1 libgl1 libgl1-mesa-dri libsm6 libxfixes3 libxi6 libxkbcommon0 libxrender1)  # what PyPI's bpy and vtk link
fi

missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0

root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "install-packages.sh: needs root or sudo for: ${missing[*]}" >&2; exit 1; }
  root=(sudo)
fi
echo "installing: ${missing[*]}"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
export DEBIAN_FRONTEND=noninteractive
apt=(apt-get -q -o Acquire::Retries=5 -o DPkg::Lock::Timeout=300)
# A fresh machine may be at its own updates, and a mirror away for a moment.
for pause in 0 10 60; do
  sleep "$pause"
  if { "${root[@]}" "${apt[@]}" update && "${root[@]}" "${apt[@]}" install -y --no-install-recommends "${missing[@]}"; } \
    >"$log" 2>&1; then
    exit 0
  fi
done
tail -n 30 "$log" >&2
exit 1
