#!/usr/bin/env bash
# dcc_test.sh FOLDER FILE [ARGUMENTS]: runs the tests of a file in the Python of scripts/dcc-packages.sh FOLDER; 77 where
# there is none, or where all are skipped (conftest.py).
set -euo pipefail
python=$1/bin/python
shift
[ -x "$python" ] || { echo "skipped: scripts/dcc-packages.sh has not made ${python%/bin/python}"; exit 77; }
exec "$python" -m pytest -q -p no:cacheprovider -rs "$@"
