"""One scene, one cache: the same bytes on any number of threads and lanes, in any run and from any folder."""

import getpass
import hashlib
import os
import re
import socket
import time

import h5py
import numpy as np
import pytest
from conftest import GOOD, PROGRAM, read, write_hair, write_tfx3, write_tfx4

# Everything that a scene can have.
EVERYTHING = '''[bake]
frames = "-2-3"
fps = 29.97
substeps = 3
preroll = 2

[groom]
files = ["mixed.hair", {file = "pinned.tfx", units = "cm"}, {file = "both_ends.tfx", up = "+Z"}, "lines.obj"]
space = "head"
scale = 1.1
rotate = [3, 40, -7]
translate = [0, 0.05, 0.01]

[head]
animation = "head.gltf"
node = "Neck/Head"
start = -20.5
rest_frame = -1.5

[forces]
gravity = {-2 = [0, -9.81, 0], 2 = [1, -9, 0.5]}

[wind]
velocity = {-2 = [2, 0, 0], 1 = [3, 1, -2]}
gust = {1 = 0.5, 3 = 1}
period = 0.05

[[region]]
name = "exact"
strands = {range = "0-699"}
damping = {-1 = 0.05, "0.5" = 0.3}
drag = {1 = 1, 2 = 2}
local = {stiffness = {1 = 0.3, 3 = 0.9}, iterations = 4, method = 1}
global = {stiffness = {1 = 0.05, 3 = 0.5}, range = 0.6, fade = 0.5}
lengths = {iterations = 3}

[[region]]
name = "lagged"
strands = {file = "pinned.tfx"}
local = {method = 2}

[[region]]
name = "turned"
strands = {file = "both_ends.tfx", range = "0-9", box = {min = [-9, -9, -9]}}
local = {method = 3}

[[region]]
name = "scanned"
strands = {range = "900-1199"}
local = {method = 4}

[[region]]
name = "ridden"
strands = {range = "1400-1460"}
simulate = false

[[region]]
name = "rest"
global = {stiffness = 0}

[[collider]]
sphere = {center = {1 = [0, 1.65, 0], 3 = [0, 1.66, 0]}, radius = {1 = 0.1, 3 = 0.12}}

[[collider]]
sphere = {center = [0, 1.6, 0.01], radius = 0.09}
node = "Head"

[[collider]]
sphere = {center = [0, 0.1, 0], radius = 0.1}
node = "Head"
space = "node"

[[collider]]
sphere = {center = [0, 0.1, 0], radius = 0.09}
node = "Neck"
space = "groom"

[cache]
precision = 1e-6
compression = "deflate:2"
velocity = true
'''


def curls(counts, scale=1.0):
    """Strands with so many vertices, on a ball of 0.1."""
    rng = np.random.default_rng(11)
    strands = []
    for count in counts:
        out = rng.normal(size=3)
        out *= 0.101 / np.linalg.norm(out)
        along = np.linspace(0, 0.2, count)[:, None]
        curl = 0.004 * np.c_[np.sin(90 * along), np.cos(90 * along) - 1, np.sin(50 * along)]
        strands.append(scale * (out + along * out * 10 + curl))
    return strands


@pytest.fixture
def everything(shot, head):
    """More vertices than one block of the cache holds, in numbers that fill no vector evenly."""
    write_hair(shot / "mixed.hair", curls(2 + np.arange(1501) % 19))
    points = np.array(curls([17] * 203, scale=100))
    free = np.ones(points.shape[:2])
    free[:, :2] = free[::2, -1] = free[::3, 8] = 0
    write_tfx4(shot / "pinned.tfx", points, free)
    write_tfx3(shot / "both_ends.tfx", np.array(curls([9] * 37)), both_ends=True)
    with open(shot / "lines.obj", "w") as obj:
        for n, strand in enumerate(curls([5, 2, 11])):
            first = [1, 6, 8][n]
            obj.writelines(f"v {x} {y} {z}\n" for x, y, z in strand)
            obj.write("l " + " ".join(str(first + k) for k in range(len(strand))) + "\n")
    (shot / "scene.toml").write_text(EVERYTHING)
    return shot


def sha256(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def available_lanes(shot):
    return re.search(r"not in {([\d,]+)}", shot.run("bake", "none.toml", "--lanes", "5").err)[1].split(",")


def test_everything_is_in_the_scene(everything):
    """Each feature leaves its mark, so that the comparisons below mean something."""
    whole = read(everything.bake())
    frames, rest = whole["frames/position"], whole["rest/position"]
    assert frames.shape[1] > 16384 and np.isfinite(frames).all()
    assert sorted(np.unique(whole["strands/region"])) == [0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(whole["frames/number"], [-2, -1, 0, 1, 2, 3])
    assert np.abs(frames[0] - rest).max() > 1e-3 and whole["stats/largest_stretch"].min() > 0
    assert (whole["frames/head"][0] != whole["frames/head"][3]).any() and (whole["frames/velocity"][0] != 0).any()

    # Pinned vertices ride the head, the others do not.
    offset = whole["strands/offset"]
    goal = np.c_[rest.astype(float), np.ones(len(rest))] @ whole["frames/head"][-1].T
    off = np.linalg.norm(frames[-1] - goal[:, :3], axis=1)
    pinned = whole["strands/region"] == 1
    tips, middles = offset[1:][pinned] - 1, offset[:-1][pinned] + 8
    assert off[offset[:-1]].max() < 2e-6 and off[tips[::2]].max() < 2e-6 and off[middles[::3]].max() < 2e-6
    assert np.median(off[tips[1::2]]) > 1e-3 and np.median(off[middles[1::3]]) > 1e-3

    for change in ("region.exact.local.method=2", "region.lagged.local.method=1", "region.turned.local.method=1", "region.exact.local.method=4",
                   "bake.preroll=0", "wind.gust=0", "wind.velocity=[0, 0, 0]", "collider[0].sphere.radius=0",
                   "collider[1].sphere.radius=0", "collider[2].sphere.radius=0", "collider[3].sphere.radius=0",
                   "region.exact.damping=0.05", "region.exact.global.stiffness=0.05", "region.exact.drag=1", "region.rest.lengths.iterations=9",
                   "forces.gravity=[0, -9.81, 0]", "solver.precision=double", "cache.precision=0", "head.start=-20"):
        changed = read(everything.bake("--set", change, "--force", out="changed.h5"))["frames/position"]
        assert (changed != frames).any(), change


@pytest.mark.parametrize("precision", ["float", "double"])
def test_any_number_of_threads_and_lanes_makes_the_same_bytes(everything, precision):
    compression = "none" if precision == "double" else "deflate:2"
    options = ["--set", f"solver.precision={precision}", "--set", f"cache.compression={compression}", "--force", "--quiet"]
    lanes = available_lanes(everything)
    assert len(lanes) >= 1
    digests = {}
    for threads in ("1", "2", "3", "7"):
        digests[f"{threads} threads"] = sha256(everything.bake("--threads", threads, *options))
    for width in lanes:
        digests[f"{width} lanes"] = sha256(everything.bake("--threads", "2", "--lanes", width, *options))
        digests[f"{width} lanes by the environment"] = sha256(everything.bake(*options, env={"STRANDBAKE_LANES": width}))
    assert len(set(digests.values())) == 1, digests


def test_what_is_skipped_changes_no_byte(everything):
    first = sha256(everything.bake())
    every = "passes,range,colliders,resting,regions"
    assert every.split(",") == re.search(r"same: ([\w, ]+)\.", " ".join(everything.run("bake", "--help").out.split()))[1].split(", ")
    for skip in (every, *every.split(",")):
        assert sha256(everything.bake("--no-skip", skip, "--force")) == first, skip


def test_another_run_from_another_folder_makes_the_same_bytes(everything):
    first = sha256(everything.bake())
    time.sleep(1.1)  # HDF5's time stamps count seconds
    (everything / "sub").mkdir()
    for scene, cwd in (("../scene.toml", everything / "sub"), (everything / "scene.toml", "/")):
        run = everything.run("bake", scene, "-o", everything / "again.h5", "--force", cwd=cwd,
                             env={"HOME": "/nowhere", "TZ": "Asia/Tokyo", "LC_ALL": "C"})
        assert run.code == GOOD, run.err
        assert sha256(everything / "again.h5") == first


def test_the_name_of_the_cache_and_what_is_seen_of_the_bake_leave_no_mark(everything):
    first = sha256(everything.bake())
    assert sha256(everything.bake("--quiet", "--search", everything.folder, out="other.h5")) == first
    assert everything.run("bake", "scene.toml", "-o", "json.h5", "--json").code == GOOD
    assert sha256(everything / "json.h5") == first


def strings_of(path):
    """Every text in the file, and its bytes between them."""
    found = []

    def add(value):
        for item in np.asarray(value).reshape(-1):
            if isinstance(item, (bytes, np.bytes_)):
                found.append(item)
            elif isinstance(item, str):
                found.append(item.encode())

    def visit(name, item):
        found.append(name.encode())
        for key, value in item.attrs.items():
            add(key)
            add(value)
        if isinstance(item, h5py.Dataset) and h5py.check_string_dtype(item.dtype):
            add(item[()])

    with h5py.File(path) as file:
        visit("/", file)
        file.visititems(visit)
    return found + [path.read_bytes()]


def test_a_cache_tells_nothing_of_the_machine(everything):
    texts = strings_of(everything.bake())
    secrets = {os.fspath(everything.folder), everything.folder.name, os.getcwd(), PROGRAM, "/usr/", "/tmp/", "/home/",
               time.strftime("%Y-%m"), socket.gethostname(), getpass.getuser(), os.path.expanduser("~")}
    for secret in secrets:
        if len(secret) < 5:  # found by chance
            continue
        assert not any(secret.encode() in text for text in texts), secret
    names = read(everything / "out.h5")["provenance/inputs/name"].astype(str)
    assert set(names) == {"mixed.hair", "pinned.tfx", "both_ends.tfx", "lines.obj", "head.gltf"}
    for name, digest in zip(names, read(everything / "out.h5")["provenance/inputs/sha256"].astype(str)):
        assert digest == sha256(everything / name)


def test_strands_do_not_see_each_other(shot):
    """What a strand does is the same alone and in company, but for its gusts, which go by its number, and for the
    origin, which goes by the groom's bounds: two stubs keep those."""
    write_hair(shot / "a.hair", curls(3 + np.arange(23) % 7))
    shot.scene("[wind]\nvelocity = [1, 0, 0]\n", frames="1-8")
    together = read(shot.bake())
    offset = together["strands/offset"]
    strands = curls(3 + np.arange(23) % 7)
    points = np.concatenate(strands)
    stubs = [np.stack([corner, corner]) for corner in (points.min(axis=0), points.max(axis=0))]
    for strand in (0, 7, 22):
        write_hair(shot / "a.hair", [strands[strand], *stubs])
        alone = read(shot.bake("--force", out="alone.h5"))["frames/position"][:, :len(strands[strand])]
        np.testing.assert_array_equal(alone, together["frames/position"][:, offset[strand]:offset[strand + 1]])
