"""info: what is in a cache, in words."""

import hashlib
import json
import os
import re
import shutil
import subprocess

import h5py
import numpy as np
import pytest
from conftest import GOOD, INPUT, SOURCE, assert_one_error, cut, read

SCENE = '''[[region]]
name = "left"
strands = {range = "0-1"}
[[region]]
name = "right"
[[collider]]
sphere = {center = [0.01, 1.53, 0.005], radius = 0.02}
[cache]
precision = 1e-5
velocity = true
'''


@pytest.fixture
def cache(shot):
    return shot.bake(scene=shot.scene(SCENE))


# info


def test_info_says_what_is_in_a_cache(shot, cache):
    run = shot.run("info", "out.h5")
    assert run.code == GOOD and run.err == ""
    lines = [re.split(r" {2,}", line, maxsplit=1) for line in run.out.splitlines()]
    assert lines[0] == ["cache", "out.h5"]
    assert ["frames", "1 to 4, 4 in all, 24 a second"] in lines
    assert ["strands", "5"] in lines and ["vertices", "30"] in lines
    assert ["region", '"left", 2 strands'] in lines and ["region", '"right", 3 strands'] in lines
    assert re.search(r"positions +[\d.]+ [KM]?i?B, [\d.]+ : 1, deflate, rounded to 1e-05 m", run.out)
    assert ["velocities", "yes"] in lines
    assert ["substeps", "4 a frame, 12 in all"] in lines
    digest = hashlib.sha256((shot / "a.hair").read_bytes()).hexdigest()
    assert f"{digest}  a.hair" in run.out


def test_info_as_json_says_the_same(shot, cache):
    run = shot.run("info", "out.h5", "--json")
    info = json.loads(run.out)
    found = read(cache)
    assert run.code == GOOD and run.err == ""
    assert info["file"] == "out.h5" and info["complete"] is True and re.fullmatch(r"\d+\.\d+\.\d+", info["version"])
    assert (info["frames"], info["first_frame"], info["last_frame"], info["fps"]) == (4, 1, 4, 24)
    assert (info["strands"], info["vertices"], info["precision"], info["velocity"]) == (5, 30, 1e-5, True)
    assert info["regions"] == [{"name": "left", "strands": 2}, {"name": "right", "strands": 3}]
    assert info["inputs"] == [{"name": "a.hair", "sha256": hashlib.sha256((shot / "a.hair").read_bytes()).hexdigest()}]
    stretch = found["stats/largest_stretch"]
    assert info["largest_stretch"] == {"value": stretch.max(), "frame": found["frames/number"][stretch.argmax()]}


def test_info_tells_where_figures_are_worst(shot, head):
    """A sphere that the hair is thrown into, and as many substeps as that takes."""
    shot.scene(head + '[[collider]]\nsphere = {center = [0.02, 1.53, 0.01], radius = 0.02}\n', frames="1-40")
    cache = shot.bake("--set", "bake.substeps=auto", "--set", "region[0].lengths.iterations=0")
    found = read(cache)
    info = json.loads(shot.run("info", "out.h5", "--json").out)
    number = found["frames/number"]
    for name in ("largest_stretch", "deepest_penetration"):
        figures = found[f"stats/{name}"]
        assert figures.max() > 0
        assert info[name] == {"value": figures.max(), "frame": number[figures.argmax()]}
    counts = found["stats/substeps"]
    assert info["substeps"] == {"least": counts[1:].min(), "most": counts.max(), "frame": number[counts.argmax()],
                                "total": counts.sum()}
    out = shot.run("info", "out.h5").out
    assert re.search(rf"stretch +[\d.]+ % at most, in frame {info['largest_stretch']['frame']}\n", out)
    assert re.search(rf"penetration +[\d.e-]+ m at most, in frame {info['deepest_penetration']['frame']}\n", out)
    assert re.search(rf"substeps +{counts[1:].min()} to {counts.max()} a frame, {counts.sum()} in all, most in frame "
                     rf"{info['substeps']['frame']}\n", out)
    one = json.loads(shot.run("info", shot.bake("--frames", "1", out="one.h5"), "--json").out)
    assert one["substeps"] == {"least": 0, "most": 0, "frame": 1, "total": 0}


def test_info_tells_an_unfinished_cache(shot, cache):
    cut(cache, "out.h5.part", 2)
    run = shot.run("info", "out.h5.part")
    assert run.code == GOOD
    assert "out.h5.part (not finished)" in run.out and "1 to 2, 2 in all" in run.out
    assert json.loads(shot.run("info", "out.h5.part", "--json").out)["complete"] is False
    cut(cache, "none.part", 0)
    assert re.search(r"frames +none", shot.run("info", "none.part").out)
    assert json.loads(shot.run("info", "none.part", "--json").out)["frames"] == 0


@pytest.mark.parametrize("verb", [["info"], ["preview", "-o", "out.png"], ["view", "-o", "out.html"]])
def test_what_is_no_cache_is_refused(shot, cache, verb):
    (shot / "cut.h5").write_bytes(cache.read_bytes()[:3000])
    (shot / "empty.h5").write_bytes(b"")
    with h5py.File(shot / "other.h5", "w") as file:
        file["position"] = [1, 2, 3]
    shutil.copy(cache, shot / "newer.h5")
    with h5py.File(shot / "newer.h5", "r+") as file:
        file.attrs["format_version"] = np.int32(99)
    for name in ("cut.h5", "empty.h5", "other.h5", "newer.h5", "a.hair", "none.h5", "."):
        assert_one_error(shot.run(*verb, name), INPUT, name)
    assert not (shot / "out.png").exists() and not (shot / "out.html").exists()


# Stock programs


@pytest.mark.skipif(shutil.which("h5dump") is None or shutil.which("h5ls") is None, reason="needs hdf5-tools")
def test_stock_programs_read_what_bake_wrote(shot, cache):
    def run(*command):
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    assert "/frames/position         Dataset {4/Inf, 30, 3}" in run("h5ls", "-r", cache)
    text = run("h5dump", "-y", "-d", "/frames/position", "-s", "3,29,0", "-c", "1,1,3", "-m", "%.9g", cache)
    tip = np.array(re.search(r"DATA {([^}]*)}", text)[1].split(","), np.float32)
    np.testing.assert_array_equal(tip, read(cache)["frames/position"][3, 29])


def test_the_reader_of_the_page_of_the_cache_works(shot, cache):
    """The Python in docs/CACHE.md and README.md, on this cache."""
    for page, name in (("docs/CACHE.md", "ponytail.h5"), ("README.md", "shot.h5")):
        text = (SOURCE / page).read_text()
        code = re.search(r"```python\n(.*?)```", text, re.S)[1].replace(f'"{name}"', repr(os.fspath(cache)))
        assert name not in code
        exec(compile(code.replace("[10]", "[2]"), page, "exec"), {})
