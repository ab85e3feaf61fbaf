"""What the tests of the Python package and of the programs that take caches share.

STRANDBAKE_SOURCE names the project's folder, STRANDBAKE_PROGRAM the program, STRANDBAKE_MAKE_CACHE the one built from
tests/formats/make_cache.cpp; left out: those of the release build.
"""

import os
import pathlib
import subprocess
import sys

import pytest

SOURCE = pathlib.Path(os.environ.get("STRANDBAKE_SOURCE") or pathlib.Path(__file__).parents[2]).resolve()
MAKE_CACHE = os.environ.get("STRANDBAKE_MAKE_CACHE") or str(SOURCE / "build/release/tests/make_cache")
PROGRAM = os.environ.get("STRANDBAKE_PROGRAM") or str(SOURCE / "build/release/cli/strandbake")
PACKAGE = SOURCE / "formats/python"

sys.path.insert(0, str(PACKAGE))


def make_cache(path, strands, first, last, *options):
    """Strands of 2 to 14 vertices in three regions, of which each has every third; see cache_sample.h."""
    subprocess.run([MAKE_CACHE, path, str(strands), str(first), str(last), *options], check=True)
    return path


def run_strandcache(*words):
    """The command, in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "strandcache", *map(os.fspath, words)],
        text=True,
        capture_output=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(PACKAGE)},
        timeout=300,
    )


def pytest_sessionfinish(session, exitstatus):
    """77, by which ctest knows skipped tests, where all were skipped."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    ran = any(reporter.stats.get(kind) for kind in ("passed", "failed", "error"))
    if not ran and exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        session.exitstatus = 77


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """200 strands, frames 3 to 8 at 24 fps, with velocities."""
    return make_cache(tmp_path_factory.mktemp("sample") / "sample.h5", 200, 3, 8, "velocity")
