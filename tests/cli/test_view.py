"""view: a page that plays a cache. tests/dcc/test_browser.py opens it in a browser; here is what is in it."""

import base64
import json
import re
import shutil
import zlib

import h5py
import numpy as np
import pytest
from conftest import DISK, GOOD, INPUT, USAGE, assert_one_error, cut

SCENE = '''[[region]]
name = "left </script><b>&"
strands = {range = "0-1"}
[[region]]
name = "right"
[[collider]]
sphere = {center = [0.01, 1.53, 0.005], radius = 0.02}
'''


@pytest.fixture
def cache(shot, head):
    return shot.bake(scene=shot.scene(head + SCENE, frames="1-24"))


def unpack(path):
    """The shot of a page, and its positions in the world: frames x vertices x 3."""
    text = path.read_text()
    shot = json.loads(re.search(r'<script type="application/json" id="shot">(.*?)</script>', text, re.S)[1])
    packed = re.search(r'<script type="text/plain" id="positions">(.*?)</script>', text, re.S)[1]
    frames, vertices = len(shot["numbers"]), shot["vertices"]
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed)), np.uint8).reshape(frames, 3, 2, vertices).astype(int)
    coded = planes[:, :, 0] + 256 * planes[:, :, 1]
    change = np.where(coded % 2 == 0, coded // 2, -(coded + 1) // 2)
    places = np.cumsum(np.cumsum(change, axis=2), axis=0).transpose(0, 2, 1)
    assert places.min() >= 0 and places.max() < 16384
    points = np.array(shot["low"]) + shot["step"] * places
    heads = np.array(shot["heads"]).reshape(frames, 4, 4).transpose(0, 2, 1)
    return shot, points @ heads[:, :3, :3].transpose(0, 2, 1) + heads[:, None, :3, 3]


def test_the_page_holds_the_shot(shot, cache):
    run = shot.run("view", "out.h5", "-o", "out.html")
    assert run.code == GOOD and run.err == "" and run.out.startswith("out.html: 5 of 5 strands, 24 frames, ")
    page, points = unpack(shot / "out.html")
    with h5py.File(cache) as file:
        wanted = file["frames/position"][:]
        spheres = file["frames/collider"][:]
        assert page["numbers"] == list(file["frames/number"][:])
    assert page["counts"] == [6] * 5 and page["fps"] == 24
    assert [(r["name"], r["strands"]) for r in page["regions"]] == [("left </script><b>&", 2), ("right", 3)]
    # Half a step on each axis, and float.
    assert np.abs(points - wanted).max() < 0.9 * page["step"] and page["step"] < 1e-4
    np.testing.assert_allclose(np.array(page["spheres"])[:, 0, :3], spheres[:, 0, :3], atol=1e-6)
    np.testing.assert_allclose(np.array(page["spheres"])[:, 0, 3], 0.98 * spheres[:, 0, 3], rtol=1e-6)
    assert page["moves"]


def test_the_page_needs_nothing_else(shot, cache):
    assert shot.run("view", "out.h5", "-o", "out.html").code == GOOD
    text = (shot / "out.html").read_text()
    assert "default-src 'none'" in text and not re.search(r"https?://|src=|href=|@[A-Z]+@", text)
    assert "</script><b>" not in text
    assert shot.run("view", "out.h5", "-o", "three.html", env={"OMP_NUM_THREADS": "3"}).code == GOOD
    assert (shot / "three.html").read_text() == text


def test_frames_and_strands_are_chosen(shot, cache):
    assert shot.run("view", "out.h5", "-o", "out.html", "--frames", "5-10", "--every", "2", "--strands", "3").code == GOOD
    page, points = unpack(shot / "out.html")
    assert page["numbers"] == [5, 7, 9] and page["fps"] == 12 and points.shape == (3, 18, 3)
    assert [r["strands"] for r in page["regions"]] in ([1, 2], [2, 1])  # none is without
    with h5py.File(cache) as file:
        strands = file["frames/position"][4].reshape(5, 6, 3)
    for strand in points[0].reshape(3, 6, 3):
        assert np.abs(strands - strand).max(axis=(1, 2)).min() < page["step"]


def test_the_budget_is_kept(shot):
    assert shot.run("groom", "--style", "wavy", "--strands", "2000", "--vertices", "12", "-o", "a.hair", "--force").code == GOOD
    shot.bake(scene=shot.scene(frames="1-12"))
    sizes = []
    for budget, most in (("100kB", 100_000), ("300 KB", 300_000), ("1MB", 1_000_000)):
        run = shot.run("view", "out.h5", "-o", "out.html", "--budget", budget, "--force")
        assert run.code == GOOD, run.err
        sizes.append((shot / "out.html").stat().st_size)
        assert 0.8 * most < sizes[-1] <= most
    page, _ = unpack(shot / "out.html")
    assert page["regions"][0]["strands"] < 2000
    assert_one_error(shot.run("view", "out.h5", "-o", "new.html", "--budget", "9kB"), USAGE, "--budget", "--frames")
    assert not (shot / "new.html").exists()


def test_what_is_not_finite_or_far_away_is_left_out_and_said(shot, cache):
    shutil.copy(cache, shot / "nan.h5")
    with h5py.File(shot / "nan.h5", "r+") as file:
        positions = file["frames/position"][:]
        positions[3, 2] = np.nan
        positions[7, 8] = [0, 3e8, 0]
        file["frames/position"][:] = positions
        file["frames/head"][5] = np.nan
        file["frames/collider"][4] = np.inf
    run = shot.run("view", "nan.h5", "-o", "out.html")
    assert run.code == GOOD and run.err.count("\n") == 1 and "nan.h5: 2 of 5 strands left out" in run.err
    page, points = unpack(shot / "out.html")
    assert page["counts"] == [6] * 3 and [len(s) for s in page["spheres"]] == [1] * 4 + [0] + [1] * 19
    with h5py.File(cache) as file:
        assert np.abs(points[5] - file["frames/position"][5][12:]).max() < page["step"]
    with h5py.File(shot / "nan.h5", "r+") as file:
        file["frames/position"][:] = np.nan
    assert_one_error(shot.run("view", "nan.h5", "-o", "none.html"), INPUT, "nan.h5", "no strand")


def test_an_unfinished_cache_is_shown(shot, cache):
    cut(cache, "out.h5.part", 2)
    assert shot.run("view", "out.h5.part", "-o", "out.html").out.startswith("out.html: 5 of 5 strands, 2 frames")
    cut(cache, "none.part", 0)
    assert_one_error(shot.run("view", "none.part", "-o", "none.html"), INPUT, "none.part", "no frame")
    assert_one_error(shot.run("view", "out.h5", "-o", "none.html", "--frames", "30-40"), INPUT, "out.h5", "30-40")


def test_nothing_is_overwritten_and_what_cannot_be_written_is_said(shot, cache):
    (shot / "old.html").write_text("old")
    assert_one_error(shot.run("view", "out.h5", "-o", "old.html"), DISK, "old.html", "--force")
    assert (shot / "old.html").read_text() == "old"
    assert_one_error(shot.run("view", "out.h5", "-o", "none/out.html"), DISK, "none/out.html")
    (shot / "taken.html").mkdir()
    assert_one_error(shot.run("view", "out.h5", "-o", "taken.html", "--force"), DISK, "taken.html")
    assert not list(shot.folder.glob("taken.html*.part"))
    (shot / "other.h5.part").write_text("an unfinished bake")
    for name in ("out.h5", "other.h5", "new"):
        assert shot.run("view", "out.h5", "-o", name, "--force").code == USAGE
    (shot / "same.html").hardlink_to(shot / "out.h5")
    assert_one_error(shot.run("view", "out.h5", "-o", "same.html", "--force"), DISK, "same.html", "is the file that is read")
    (shot / "same.html").unlink()
    assert (shot / "other.h5.part").read_text() == "an unfinished bake"
    for words in (["--budget", "many"], ["--budget", "0"], ["--budget", "1TB"], ["--strands", "0"], ["--every", "0"], ["--frames", "x"]):
        assert shot.run("view", "out.h5", "-o", "new.html", *words).code == USAGE
    assert not (shot / "new.html").exists()
