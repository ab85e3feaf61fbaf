"""What the tests of the Python package and of the programs that take caches share.

STRANDBAKE_SOURCE names the project's folder, STRANDBAKE_MAKE_CACHE the program built from tests/formats/make_cache.cpp.
"""

import os
import pathlib
import subprocess
import sys

import pytest

SOURCE = pathlib.Path(os.environ.get("STRANDBAKE_SOURCE") or pathlib.Path(__file__).parents[2]).resolve()
MAKE_CACHE = os.environ.get("STRANDBAKE_MAKE_CACHE") or str(SOURCE / "build/release/tests/make_cache")
PACKAGE = SOURCE / "formats/python"

sys.path.insert(0, str(PACKAGE))


def make_cache(path, strands, first, last, *options):
    """Strands of 2 to 14 vertices in three regions, of which each has every third; see cache_sample.h."""
    subprocess.run([MAKE_CACHE, path, str(strands), str(first), str(last), *options], check=True)
    return path


def run_strandcache(*words):
    """The command, in a process of its own."""
    return subprocess.run([sys.executable, "-m", "strandcache", *map(os.fspath, words)], text=True, capture_output=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(PACKAGE)}, timeout=300)


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """200 strands, frames 3 to 8 at 24 fps, with velocities."""
    return make_cache(tmp_path_factory.mktemp("sample") / "sample.h5", 200, 3, 8, "velocity")
