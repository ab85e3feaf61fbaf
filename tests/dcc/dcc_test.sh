#!/usr/bin/env bash
# dcc_test.sh FOLDER MODULE FILE: runs the tests of a file in the Python where scripts/dcc-packages.sh FOLDER has installed MODULE.
set -euo pipefail
python=$1/bin/python
if ! [ -x "$python" ] || ! "$python" -c "import importlib.util, sys; sys.exit(importlib.util.find_spec('$2') is None)"; then
  echo "skipped: scripts/dcc-packages.sh $1 has not installed $2"
  exit 77
fi
exec "$python" -m pytest -q -p no:cacheprovider -rs "$3"
