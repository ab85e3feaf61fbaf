#!/usr/bin/env bash
# Installs the wheels of tests/dcc/requirements.txt into a folder: the programs and libraries that take caches, for the tests.
# What cannot be had is named, and its test skips then.
#   scripts/dcc-packages.sh build/dcc
set -euo pipefail

folder=${1:?"usage: scripts/dcc-packages.sh FOLDER"}
requirements=$(dirname "$0")/../tests/dcc/requirements.txt
mkdir -p "$folder"
log=$folder/install.log
: >"$log"
if ! [ -x "$folder/bin/pip" ] && ! /usr/bin/python3 -m venv --system-site-packages "$folder" >>"$log" 2>&1; then
  echo "no virtual environment in $folder, the tests in other programs will be skipped: $(tail -n 1 "$log")"
  exit 0
fi
install() {
  for pause in 0 5 20; do
    sleep "$pause"
    local code=0
    timeout 600 "$folder/bin/pip" install --disable-pip-version-check --no-deps --no-compile --only-binary :all: "$1" \
      >>"$log" 2>&1 || code=$?
    [ $code -eq 0 ] && return
    [ $code -eq 124 ] && break  # a line so slow will not be faster the next time
  done
  return 1
}
grep -v '^#' "$requirements" | while read -r wheel; do
  # As pip names what it has installed.
  [ -d "$(echo "$folder"/lib/python3*/site-packages/"$(echo "$wheel" | sed 's/-/_/; s/==/-/')".dist-info)" ] && continue
  install "$wheel" || echo "$wheel cannot be installed, its tests will be skipped: $(tail -n 1 "$log")"
done
