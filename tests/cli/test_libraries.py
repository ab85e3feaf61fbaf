"""The libraries that a run loads, and where it finds its own."""

import pathlib
import re
import shutil
import subprocess

import pytest
from conftest import GOOD, INPUT, PROGRAM

BUILD = pathlib.Path(PROGRAM).parents[1]
# Of this version: a build folder keeps those of earlier ones.
MODULE = max((BUILD / "lib/strandbake").glob("strandbake_assimp-*.so"), key=lambda path: path.stat().st_mtime)


def loaded(shot, *arguments):
    """Names of the shared libraries that a good run of the program loads."""
    log = shot / "linker"
    run = shot.run(*arguments, env={"LD_DEBUG": "files", "LD_DEBUG_OUTPUT": str(log)})
    assert run.code == GOOD, run.err
    text = "".join(part.read_text() for part in shot.folder.glob("linker.*"))
    for part in shot.folder.glob("linker.*"):
        part.unlink()
    names = {pathlib.Path(found).name.split(".so")[0] for found in re.findall(r"calling init: (\S+)", text)}
    assert "libc" in names
    return names


@pytest.mark.parametrize("verb", [["bake", "--force"], ["check"]])
def test_only_an_animation_loads_the_importer(shot, head, verb):
    standing = loaded(shot, verb[0], shot.scene(), *verb[1:])
    moving = loaded(shot, verb[0], shot.scene(head), *verb[1:])
    assert not any("assimp" in name for name in standing)
    assert "libassimp" in moving and standing < moving


def test_hdf5_does_not_bring_a_network_along(shot):
    assert not loaded(shot, "bake", shot.scene()) & {"libcurl", "libcrypto", "libssl", "libldap-2.5"}


def check_with(program, shot, scene):
    return subprocess.run([program, "check", scene], cwd=shot.folder, capture_output=True, text=True, timeout=60, check=False)


def test_a_program_without_its_importer_says_so_where_it_needs_one(shot, head):
    alone = shot / "bin/strandbake"
    alone.parent.mkdir()
    shutil.copy2(PROGRAM, alone)
    assert check_with(alone, shot, shot.scene()).returncode == GOOD
    lost = check_with(alone, shot, shot.scene(head))
    assert lost.returncode == INPUT and len(lost.stderr.splitlines()) == 2
    for words in ("head.gltf: ", MODULE.name, f"{shot / 'bin'} ", str(shot / "lib/strandbake"), "install strandbake again"):
        assert words in lost.stderr

    (alone.parent / MODULE.name).write_text("no library")
    broken = check_with(alone, shot, "scene.toml")
    assert broken.returncode == INPUT and "cannot be loaded" in broken.stderr and len(broken.stderr.splitlines()) == 2

    shutil.copy2(MODULE, alone.parent)
    assert check_with(alone, shot, "scene.toml").returncode == GOOD


def test_an_installed_program_finds_its_importer(shot, head):
    subprocess.run(["cmake", "--install", BUILD, "--prefix", shot / "first"], stdout=subprocess.DEVNULL, check=True)
    (shot / "first").rename(shot / "second")  # it can be moved,
    (shot / "program").symlink_to(shot / "second/bin/strandbake")  # and called by another name
    run = check_with(shot / "program", shot, shot.scene(head))
    assert run.returncode == GOOD, run.stderr
