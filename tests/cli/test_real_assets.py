"""Real grooms on real heads, where someone has them: STRANDBAKE_ASSETS names their folder."""

import os
import pathlib

import numpy as np
import pytest
from conftest import GOOD, SOURCE, read

ASSETS = os.environ.get("STRANDBAKE_ASSETS")
pytestmark = pytest.mark.skipif(not ASSETS or not pathlib.Path(ASSETS).is_dir(),
                                reason="STRANDBAKE_ASSETS names no folder with real grooms and animation")

SCENES = sorted(path for path in (SOURCE / "scenes").glob("*.toml") if path.name != "demo.toml")
FRAMES = 3


def bake_some(shot, scene, *arguments):
    """Checks a scene and bakes its first frames; returns what the cache holds, and the warnings."""
    settings = ["--search", shot.folder, "--search", ASSETS, *arguments]
    check = shot.run("check", scene, *settings)
    assert check.code == GOOD, check.err
    first = read_first_frame(check.out)
    run = shot.run("bake", scene, "-o", "out.h5", "--force", "--quiet", "--frames", f"{first}-{first + FRAMES - 1}", *settings)
    assert run.code == GOOD, run.err
    found = read(shot / "out.h5")
    assert found["frames/position"].shape[0] == FRAMES and np.isfinite(found["frames/position"]).all()
    return found, run.err


def read_first_frame(plan):
    line = next(line for line in plan.splitlines() if line.startswith("  frames "))
    return int(line.split()[1])


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_the_scenes_of_the_project_bake(shot, scene):
    shot.groom_of(scene)
    found, _ = bake_some(shot, scene)
    moved = found["frames/position"][-1] - found["frames/position"][0]
    assert np.abs(moved).max() > 0 and np.linalg.norm(moved, axis=1).max() < 5  # metres; hair that explodes goes farther


def check_units(found, lower, upper):
    """The size of the groom in metres."""
    size = np.ptp(found["rest/position"], axis=0).max()
    assert lower < size < upper


ANIMATIONS = {
    "robot": 'animation = "animation/robot_expressive.glb"\nclip = "Dance"\nnode = "Neck/Head"\n',
    "walk": 'animation = "animation/cmu_01_01.bvh"\nnode = "Head"\n',
    "fbx": 'animation = "animation/crackhead.fbx"\nnode = "Head"\n',
}


@pytest.mark.parametrize("animation", ANIMATIONS)
def test_the_ponytail_on_each_head(shot, animation):
    files = [f"ponytail/{name}.tfx" for name in ("front_top", "side", "back", "tail")]
    regions = "".join(f'[[region]]\nname = "{k}"\nstrands = {{file = "{file}"}}\n' for k, file in enumerate(files))
    (shot / "scene.toml").write_text(f'[groom]\nfiles = {files}\nunits = "cm"\n[head]\n{ANIMATIONS[animation]}{regions}')
    found, _ = bake_some(shot, "scene.toml")
    assert np.bincount(found["strands/region"]).tolist() == [876, 3066, 517, 474]
    check_units(found, 0.1, 3)
    offset = found["strands/offset"].astype(int)
    # Both ends of "back" ride the head.
    rest = np.c_[found["rest/position"].astype(float), np.ones(len(found["rest/position"]))]
    off = np.linalg.norm((rest @ found["frames/head"][-1].T)[:, :3] - found["frames/position"][-1], axis=1)
    back = found["strands/region"] == 2
    size = np.abs(found["frames/position"]).max()
    assert off[offset[1:][back] - 1].max() < 1e-6 * max(1, size)


def test_the_mohawk_with_its_degenerate_strands(shot):
    (shot / "scene.toml").write_text(
        f'[groom]\nfiles = ["mohawk/Ratboy_mohawk.tfx"]\n[head]\n{ANIMATIONS["fbx"]}[bake]\nfps = 30\n')
    for method in (1, 2, 3, 4):
        found, _ = bake_some(shot, "scene.toml", "--set", f"region.hair.local.method={method}")
        assert found["strands/offset"][-1] == 2228 * 32
        check_units(found, 0.05, 3)


def test_ambiguous_heads_and_missing_clips_are_told_apart(shot):
    (shot / "scene.toml").write_text(f'[groom]\nfiles = ["a.hair"]\n[head]\n{ANIMATIONS["robot"]}')
    for override, words in (("head.node=Head", ["2 nodes", "Neck/Head"]), ("head.clip=", ["14", '"Robot_Dance"']),
                            ("head.clip=Tango", ['"Tango"'])):
        run = shot.run("check", "scene.toml", "--search", ASSETS, "--set", override)
        assert run.code == 3
        assert all(word in run.err for word in words), run.err


@pytest.mark.parametrize("clip, words", [
    ("Step Scale", ["STEP"]), ("CubicSpline Translation", ["CUBICSPLINE"]), ("Linear Translation", [])])
def test_flattened_key_types_are_told(shot, clip, words):
    (shot / "scene.toml").write_text('[groom]\nfiles = ["a.hair"]\n[head]\nanimation = "animation/interpolation_test.gltf"\n'
                                     f'node = "Cube"\nclip = "{clip}"\n')
    run = shot.run("check", "scene.toml", "--search", ASSETS)
    assert run.code == GOOD
    assert all(word in run.err for word in words) and bool(run.err) == bool(words), run.err
