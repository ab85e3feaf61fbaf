"""The add-on in Blender, installed as people do: in PyPI's bpy and in a Blender that is on the path (Debian's 3.4).

in_blender.py has what runs inside.
"""

import importlib.util
import os
import pathlib
import shutil
import subprocess
import sys

import pytest
from conftest import PROGRAM, make_cache, run_strandcache

SCRIPT = pathlib.Path(__file__).parent / "in_blender.py"

PROGRAMS = {
    "bpy": [sys.executable, SCRIPT] if importlib.util.find_spec("bpy") else None,
    "program": (
        [shutil.which("blender"), "-b", "--factory-startup", "--python-exit-code", "3", "--python", SCRIPT, "--"]
        if shutil.which("blender")
        else None
    ),
}
MISSING = {
    "bpy": "bpy is not installed; scripts/dcc-packages.sh build/dcc does it",
    "program": "there is no Blender on the path; apt-get install blender",
}


@pytest.fixture(scope="module", params=list(PROGRAMS))
def folder(request, tmp_path_factory, sample):
    if PROGRAMS[request.param] is None:
        pytest.skip(MISSING[request.param])
    folder = tmp_path_factory.mktemp(request.param)
    shutil.copy(sample, folder / "sample.h5")
    shutil.copy(SCRIPT, folder)
    make_cache(folder / "other.h5", 150, 3, 8)
    subprocess.run([PROGRAM, "groom", "--strands", "20000", "--vertices", "11", "-o", folder / "many.hair"], check=True)
    (folder / "many.toml").write_text('[bake]\nframes = "1-10"\nsubsteps = 1\n[groom]\nfiles = ["many.hair"]\n')
    subprocess.run([PROGRAM, "bake", folder / "many.toml", "-o", folder / "many.h5"], check=True, capture_output=True)
    run = run_strandcache("blender-addon", folder / "strandcache.zip")
    assert run.returncode == 0, run.stderr
    return folder


def run_inside(folder, step):
    program = PROGRAMS["bpy" if "bpy" in folder.name else "program"]
    run = subprocess.run(
        [*map(os.fspath, program), step, folder],
        text=True,
        capture_output=True,
        check=False,
        timeout=300,
        env={
            **os.environ,
            "BLENDER_USER_RESOURCES": str(folder / "user"),
            "BLENDER_USER_SCRIPTS": str(folder / "user"),
        },
    )
    assert run.returncode == 0 and f"done {step}" in run.stdout, run.stdout[-3000:] + run.stderr[-3000:]
    return run.stdout


def test_hair_is_imported_and_plays(folder):
    run_inside(folder, "import")


def test_a_saved_file_plays_when_it_is_opened_again(folder):
    """Also in it: what faulty files are told, a still, how long it takes, and Alembic read back."""
    if "bpy" in folder.name:  # Debian's Blender has no Alembic
        run = run_strandcache("to-abc", folder / "sample.h5", folder / "sample.abc", "--radius", "2e-4")
        assert run.returncode == 0, run.stderr
    print(run_inside(folder, "reopen"))
