"""Stock HDF5 programs read a cache: h5py, h5dump and h5ls, none of which knows Strandbake.

STRANDBAKE_MAKE_CACHE names the program built from make_cache.cpp, which writes the caches.
"""

import os
import re
import shutil
import subprocess

import h5py
import numpy as np
import pytest

MAKE_CACHE = os.environ.get("STRANDBAKE_MAKE_CACHE")
pytestmark = pytest.mark.skipif(MAKE_CACHE is None, reason="STRANDBAKE_MAKE_CACHE is not set")

STEP = np.array([0.25, 0.5, -0.125], np.float32)


def make(path, strands, first, last, *options):
    subprocess.run([MAKE_CACHE, path, str(strands), str(first), str(last), *options], check=True)
    return path


def check_positions(file, first, count, grid=None):
    rest = file["rest/position"][:]
    positions = file["frames/position"]
    for index in range(count):
        expected = rest + np.float32(first + index) * STEP
        if grid:
            expected = (np.rint(expected.astype(np.float64) / grid) * grid).astype(np.float32)
        np.testing.assert_array_equal(positions[index], expected)


@pytest.mark.parametrize("options", [["deflate=0"], ["deflate=1"], ["deflate=6", "threads=3"], ["deflate=12"]])
def test_h5py_reads_every_value(tmp_path, options):
    path = make(tmp_path / "a.h5", 5000, 3, 7, "velocity", *options)
    with h5py.File(path) as file:
        assert file.attrs["format"] == b"strandbake"
        assert file.attrs["format_version"] == 1
        assert file.attrs["units"] == b"m" and file.attrs["up"] == b"+Y"
        assert file.attrs["fps"] == 24 and file.attrs["complete"] == 1

        offset = file["strands/offset"][:]
        counts = 2 + 7 * np.arange(5000) % 13
        np.testing.assert_array_equal(offset, np.concatenate([[0], np.cumsum(counts)]))
        np.testing.assert_array_equal(file["strands/region"][:], np.arange(5000) % 3)
        assert file["strands/root_uv"].shape == (5000, 2)
        assert list(file["regions/name"].asstr()[:]) == ["top", "tail", "Stirnzöpfchen"]

        frames = file["frames"]
        vertices = int(offset[-1])
        assert file["rest/position"].shape == (vertices, 3)
        assert frames["position"].shape == (5, vertices, 3) and frames["position"].dtype == "<f4"
        np.testing.assert_array_equal(frames["number"][:], [3, 4, 5, 6, 7])
        np.testing.assert_array_equal(frames["time"][:], np.arange(3, 8) / 24)
        check_positions(file, 3, 5)
        np.testing.assert_array_equal(frames["velocity"][4], file["rest/position"][:] + 24 * STEP)
        np.testing.assert_array_equal(
            frames["head"][2], [[0, 0, 1, 5], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])  # frame 5: one quarter turn
        np.testing.assert_array_equal(frames["collider"][2], [[5, 0, -5, 1 / 8], [5, 1, -5, 1 / 4]])
        np.testing.assert_array_equal(file["stats/largest_stretch"][:], np.arange(3, 8) / 2)
        np.testing.assert_array_equal(file["stats/residual"][:], np.arange(3, 8) / 8)
        np.testing.assert_array_equal(file["stats/deepest_penetration"][:], np.arange(3, 8) / 4)
        np.testing.assert_array_equal(file["stats/substeps"][:], 3 * np.arange(3, 8))

        provenance = file["provenance"]
        assert provenance.attrs["version"] == b"0.1.0"
        assert provenance["scene"].asstr()[()] == '[bake]\nframes = "1-5"  # Haar für den Test\n'
        assert list(provenance["inputs/name"].asstr()[:]) == ["groom/top.hair", "head.glb"]
        assert list(provenance["inputs/sha256"].asstr()[:]) == ["a" * 64, "7" * 64]
        assert list(provenance["parameters/name"].asstr()[:]) == ["bake.substeps", "region.tail.damping", "wind.gust"]
        assert list(provenance["parameters/value"].asstr()[:]) == ["8", "0.1", ""]


def test_what_was_not_asked_for_is_not_in_the_file(tmp_path):
    with h5py.File(make(tmp_path / "a.h5", 10, 1, 2, "nostats")) as file:
        assert "stats" not in file and "velocity" not in file["frames"]


def test_rounded_positions_are_plain_floats_within_half_the_precision(tmp_path):
    with h5py.File(make(tmp_path / "a.h5", 3000, 1, 3, "precision=1e-5")) as file:
        assert file["frames/position"].attrs["precision"] == 1e-5
        check_positions(file, 1, 3, grid=2.0**-17)
        exact = file["rest/position"][:].astype(np.float64) + 2 * STEP
        assert np.abs(file["frames/position"][1] - exact).max() <= 0.5e-5


def test_h5py_reads_what_a_killed_bake_leaves(tmp_path):
    subprocess.run([MAKE_CACHE, tmp_path / "a.h5", "500", "1", "70", "kill"], check=False)
    assert not (tmp_path / "a.h5").exists()
    with h5py.File(tmp_path / "a.h5.part") as file:
        assert file.attrs["complete"] == 0
        assert file["frames/number"].shape == (70,)
        check_positions(file, 1, 70)


@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace to kill at a chosen write")
def test_killed_at_any_single_write_a_bake_leaves_whole_frames(tmp_path):
    """The chunk tree of the positions splits for the first time at frame 65, where the small data sets get new chunks."""

    def writes(last, *options):
        command = ["strace", "-qq", "-e", "trace=pwrite64", *options, MAKE_CACHE, tmp_path / "a.h5", "20", "1", str(last)]
        run = subprocess.run(command, stderr=subprocess.PIPE, check=False)
        return [line for line in run.stderr.splitlines() if b"pwrite64(" in line]

    all_writes = writes(70)
    first, last = len(writes(0)) + 1, len(all_writes)  # before the first one there is nothing to lose
    if last == 0:
        pytest.skip("strace may not trace here")
    split = first + (last - first) * 64 // 70
    # A node of a tree that ends with a page goes on in the next one.
    places = [(line, re.search(rb", (\d+), (\d+)\) = ", line)) for line in all_writes]
    cut = [k for k, (line, place) in enumerate(places, 1) if b'"TREE' in line and (int(place[1]) + int(place[2])) % 4096 == 0]
    cut = [k for k in cut if k > first][::16]
    assert cut
    counts = set()
    for write in [*range(first, last, 151), *range(split - 2, split + 24), *range(last - 30, last + 1, 3), *cut, *(k + 1 for k in cut)]:
        (tmp_path / "a.h5").unlink(missing_ok=True)
        writes(70, "-e", f"inject=pwrite64:signal=KILL:when={write}")
        with h5py.File(tmp_path / "a.h5.part") as file:
            sets = [file["frames"][name] for name in ("number", "time", "head", "position")]
            count = min(len(one) for one in sets + list(file["stats"].values()))
            np.testing.assert_array_equal(file["frames/number"][:count], np.arange(1, count + 1))
            check_positions(file, 1, count)
            assert len(file["frames/number"]) == count  # the frame's number is the last thing that appears
            counts.add(count)
    assert len(counts) > 5


def run(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.mark.skipif(shutil.which("h5dump") is None, reason="needs hdf5-tools")
def test_h5dump_prints_the_values(tmp_path):
    path = make(tmp_path / "a.h5", 10, 1, 3)
    text = run("h5dump", "-y", "-d", "/frames/position", "-s", "2,5,0", "-c", "1,1,3", "-m", "%.9g", path)
    found = [float(x) for x in re.search(r"DATA {([^}]*)}", text)[1].split(",")]
    with h5py.File(path) as file:
        expected = file["rest/position"][5] + np.float32(3) * STEP
    np.testing.assert_array_equal(np.array(found, np.float32), expected)
    header = run("h5dump", "-p", "-H", path)
    assert "PREPROCESSING SHUFFLE" in header and "COMPRESSION DEFLATE { LEVEL 1 }" in header
    assert '"strandbake"' in run("h5dump", "-a", "/format", path)
    assert '"top"' in run("h5dump", "-d", "/regions/name", path)


@pytest.mark.skipif(shutil.which("h5ls") is None, reason="needs hdf5-tools")
def test_h5ls_lists_the_layout(tmp_path):
    listing = run("h5ls", "-r", make(tmp_path / "a.h5", 10, 1, 3))
    found = {line.split()[0]: " ".join(line.split()[1:]) for line in listing.splitlines()}
    view = {name: found.pop(name) for name in list(found) if name.startswith("/VTKHDF")}
    with h5py.File(tmp_path / "a.h5") as file:
        vertices = len(file["rest/position"])
    assert found == {
        "/": "Group",
        "/frames": "Group",
        "/frames/collider": "Dataset {3/Inf, 2, 4}",
        "/frames/head": "Dataset {3/Inf, 4, 4}",
        "/frames/number": "Dataset {3/Inf}",
        "/frames/position": f"Dataset {{3/Inf, {vertices}, 3}}",
        "/frames/time": "Dataset {3/Inf}",
        "/provenance": "Group",
        "/provenance/inputs": "Group",
        "/provenance/inputs/name": "Dataset {2}",
        "/provenance/inputs/sha256": "Dataset {2}",
        "/provenance/parameters": "Group",
        "/provenance/parameters/name": "Dataset {3}",
        "/provenance/parameters/value": "Dataset {3}",
        "/provenance/scene": "Dataset {SCALAR}",
        "/regions": "Group",
        "/regions/name": "Dataset {3}",
        "/rest": "Group",
        "/rest/position": f"Dataset {{{vertices}, 3}}",
        "/stats": "Group",
        "/stats/deepest_penetration": "Dataset {3/Inf}",
        "/stats/largest_stretch": "Dataset {3/Inf}",
        "/stats/residual": "Dataset {3/Inf}",
        "/stats/substeps": "Dataset {3/Inf}",
        "/strands": "Group",
        "/strands/offset": "Dataset {11}",
        "/strands/region": "Dataset {10}",
        "/strands/root_uv": "Dataset {10, 2}",
    }
    assert view["/VTKHDF/Points"] == f"Dataset {{{3 * vertices}, 3}}"
    assert view["/VTKHDF/Steps/Values"] == "Soft Link {/frames/time}"


def test_the_view_for_vtk_shows_positions_without_a_copy(tmp_path):
    path = make(tmp_path / "a.h5", 500, 1, 5, "velocity")
    with h5py.File(path, "r") as file:
        vertices = len(file["rest/position"])
        for view, vectors in (("Points", "position"), ("PointData/velocity", "velocity")):
            view, vectors = file["VTKHDF"][view], file["frames"][vectors][:].reshape(-1, 3)
            assert view.is_virtual and view.id.get_storage_size() == 0
            np.testing.assert_array_equal(view[:], vectors)
            part = slice(2 * vertices - 7, 2 * vertices + 5)  # of two frames
            np.testing.assert_array_equal(view[part], vectors[part])
        assert file["VTKHDF"].attrs["Type"] == b"PolyData" and list(file["VTKHDF"].attrs["Version"]) == [2, 0]
        np.testing.assert_array_equal(file["VTKHDF/Lines/Offsets"][:], file["strands/offset"][:])
        np.testing.assert_array_equal(file["VTKHDF/Lines/Connectivity"][:], np.arange(vertices))
        np.testing.assert_array_equal(file["VTKHDF/Steps/PointOffsets"][:], vertices * np.arange(5))
