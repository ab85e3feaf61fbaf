"""The package strandcache reads what h5py reads, and says in one sentence what is wrong with a file."""

import random
import re
import shutil
import subprocess

import h5py
import numpy as np
import pytest
from conftest import MAKE_CACHE, PACKAGE, SOURCE, make_cache, run_strandcache

import strandcache
from strandcache import Cache, CacheError

STEP = np.array([0.25, 0.5, -0.125], np.float32)


@pytest.mark.parametrize("options", [["deflate=0"], ["deflate=6", "velocity"], ["nostats", "deflate=1"]])
def test_all_values_are_those_of_h5py(tmp_path, options):
    path = make_cache(tmp_path / "a.h5", 5000, 3, 7, *options)
    with h5py.File(path, "r", locking=False) as file, Cache(path) as cache:
        assert len(cache) == 5 and cache.fps == 24 and cache.complete and cache.precision == 0
        assert (cache.strand_count, cache.vertex_count) == (5000, len(file["rest/position"]))
        np.testing.assert_array_equal(cache.offset, file["strands/offset"][:])
        np.testing.assert_array_equal(cache.strand_region, file["strands/region"][:])
        np.testing.assert_array_equal(cache.root_uv, file["strands/root_uv"][:])
        np.testing.assert_array_equal(cache.rest, file["rest/position"][:])
        for name, values in ("number", cache.numbers), ("time", cache.times), ("head", cache.heads), ("collider", cache.colliders):
            np.testing.assert_array_equal(values, file["frames"][name][:])
        for frame in cache:
            np.testing.assert_array_equal(frame.positions, file["frames/position"][frame.index])
            assert frame.positions.dtype == np.float32 and frame.number == 3 + frame.index
            np.testing.assert_array_equal(frame.head, file["frames/head"][frame.index])
            np.testing.assert_array_equal(frame.colliders, file["frames/collider"][frame.index])
            if "velocity" in options:
                np.testing.assert_array_equal(frame.velocities, file["frames/velocity"][frame.index])
        assert cache.has_velocities == ("velocity" in options)
        if "nostats" in options:
            assert cache.stats is None
        else:
            np.testing.assert_array_equal(cache.stats.largest_stretch, file["stats/largest_stretch"][:])
            np.testing.assert_array_equal(cache.stats.residual, file["stats/residual"][:])
            np.testing.assert_array_equal(cache.stats.deepest_penetration, file["stats/deepest_penetration"][:])
            np.testing.assert_array_equal(cache.stats.substeps, file["stats/substeps"][:])


def test_a_cache_may_be_without_colliders(tmp_path, sample):
    path = shutil.copy(sample, tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        del file["frames/collider"]
    with Cache(path) as cache:
        assert cache.colliders.shape == (6, 0, 4) and cache[5].colliders.shape == (0, 4)


def test_the_provenance_is_at_hand(sample):
    with Cache(sample) as cache:
        found = cache.provenance
    assert found.version == "0.1.0" and found.scene == '[bake]\nframes = "1-5"  # Haar für den Test\n'
    assert found.inputs == {"groom/top.hair": "a" * 64, "head.glb": "7" * 64}
    assert found.parameters == {"bake.substeps": "8", "region.tail.damping": "0.1", "wind.gust": ""}


def test_strands_are_views(sample):
    with Cache(sample) as cache:
        frame = cache[2]
        strands = frame.strands
        assert len(strands) == 200 and all(np.shares_memory(strand, frame.positions) for strand in strands)
        np.testing.assert_array_equal(np.concatenate(list(strands)), frame.positions)
        np.testing.assert_array_equal(strands[-1], strands[199])
        assert [len(s) for s in strands[3:5]] == [len(strands[3]), len(strands[4])]
        with pytest.raises(IndexError, match="strand 200 of 200"):
            strands[200]


def test_a_region_is_a_view_where_its_strands_follow_each_other(tmp_path, sample):
    with Cache(sample) as cache:  # each region has every third strand
        frame = cache[0]
        tail = cache.region("tail")
        np.testing.assert_array_equal(frame.region("tail"), np.concatenate(frame.strands[1::3]))
        np.testing.assert_array_equal(cache.offset[:-1][tail.strands], cache.offset[1:-1:3])
        with pytest.raises(KeyError, match="has no region Tail; it has top, tail, Stirnzöpfchen"):
            cache.region("Tail")
    path = shutil.copy(sample, tmp_path / "sorted.h5")
    with h5py.File(path, "r+") as file:
        file["strands/region"][:] = np.repeat([0, 2], [60, 140])
    with Cache(path) as cache:
        frame = cache[0]
        assert np.shares_memory(frame.region("Stirnzöpfchen"), frame.positions)
        np.testing.assert_array_equal(frame.region("Stirnzöpfchen"), np.concatenate(frame.strands[60:]))
        assert frame.region("tail").shape == (0, 3)


def test_frames_are_found_by_index_and_by_number(sample):
    with Cache(sample) as cache:
        assert cache.at(5).index == 2 and cache[-1].number == 8
        assert [frame.number for frame in cache[1:3]] == [4, 5]
        with pytest.raises(KeyError, match="has no frame 9; it has 3 to 8"):
            cache.at(9)
        with pytest.raises(IndexError, match="frame index 6 of 6"):
            cache[6]
        room = np.empty((cache.vertex_count, 3), np.float32)
        assert cache.positions(1, out=room) is room
        np.testing.assert_array_equal(room, cache[1].positions)
        with pytest.raises(ValueError, match="out needs to be float32"):
            cache.positions(1, out=np.empty((3, 3), np.float32))


def test_what_a_killed_bake_leaves_is_a_cache(tmp_path):
    subprocess.run([MAKE_CACHE, tmp_path / "a.h5", "50", "1", "70", "kill"], check=False)
    with Cache(tmp_path / "a.h5.part") as cache:
        assert not cache.complete and len(cache) == 70
        np.testing.assert_array_equal(cache.at(70).positions, cache.rest + np.float32(70) * STEP)


def test_a_closed_cache_says_so(sample):
    with Cache(sample) as cache:
        pass
    with pytest.raises(CacheError, match="was closed"):
        cache.positions(0)


def fault(path):
    """What reading all of a file says."""
    try:
        with Cache(path) as cache:
            for frame in cache:
                frame.positions.sum()
                if cache.has_velocities:
                    frame.velocities.sum()
            cache.rest.sum()
    except CacheError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error), str(error)
        return str(error)[len(str(path)) + 2 :]
    return None


def test_what_is_no_cache_is_named(tmp_path):
    assert fault(tmp_path / "none.h5") == "there is no such file"
    assert fault(tmp_path) == "is a folder, not a cache"
    (tmp_path / "text").write_text("hair")
    assert fault(tmp_path / "text").startswith("is not an HDF5 file")
    (tmp_path / "empty").touch()
    assert fault(tmp_path / "empty").startswith("is not an HDF5 file")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["frames"] = [1, 2]
    assert fault(tmp_path / "other.h5") == "is an HDF5 file, but not a Strandbake cache"


CHANGES = {
    "has cache format version 2, but this package reads up to 1": lambda f: f.attrs.modify(
        "format_version", np.int32(2)
    ),
    "format version 0 has never been": lambda f: f.attrs.modify("format_version", np.int32(0)),
    "fps is nan": lambda f: f.attrs.modify("fps", np.nan),
    "/strands/offset starts at 1": lambda f: f["strands/offset"].__setitem__(0, 1),
    "/strands/offset does not increase at strand 4": lambda f: f["strands/offset"].__setitem__(5, 3),
    "/strands/offset ends at": lambda f: f["strands/offset"].__setitem__(200, 10**15),
    "strand 7 is in region 3, but there are 3": lambda f: f["strands/region"].__setitem__(7, 3),
    "there is no /strands/region": lambda f: f.__delitem__("strands/region"),
    "there is no /frames/time": lambda f: f.__delitem__("frames/time"),
    "it calls itself complete, but has 5 to 6 frames": lambda f: f["frames/number"].resize(5, axis=0),
    "/frames/number does not increase": lambda f: f["frames/number"].__setitem__(3, 4),
    "/frames/time has a value that is not finite, at 2": lambda f: f["frames/time"].__setitem__(2, np.inf),
    "/frames/position of frame 5 has a value that is not finite, at 17": lambda f: f["frames/position"].__setitem__(
        (2, 17, 1), np.nan
    ),
    "/rest/position has a value that is not finite, at 0": lambda f: f["rest/position"].__setitem__((0, 2), -np.inf),
    "/frames/collider has the shape 6 x 2 x 3 in place of any x any x 4": lambda f: (
        f.__delitem__("frames/collider"),
        f["frames"].create_dataset("collider", data=np.zeros((6, 2, 3), "<f8")),
    ),
    "/frames/position has the shape": lambda f: (
        f.__delitem__("frames/position"),
        f["frames"].create_dataset("position", data=np.zeros((6, 7, 3), "<f4")),
    ),
    "claims": lambda f: (
        f.__delitem__("rest/position"),
        f["rest"].create_dataset("position", (2**40, 3), "<f4", chunks=(4096, 3), compression="gzip", shuffle=True),
    ),
    "is packed with other filters": lambda f: (
        f.__delitem__("rest/position"),
        f["rest"].create_dataset("position", data=np.zeros((5, 3), "<f4"), compression="lzf"),
    ),
    "is not stored in the file itself": lambda f: (
        f.__delitem__("rest/position"),
        f["rest"].create_dataset("position", (5, 3), "<f4", external="/etc/passwd"),
    ),
    "/regions/name does not hold strings of fixed length": lambda f: (
        f.__delitem__("regions/name"),
        f["regions"].create_dataset("name", data=["a", "b", "c"], dtype=h5py.string_dtype()),
    ),
    "has another type of numbers": lambda f: (
        f.__delitem__("frames/number"),
        f["frames"].create_dataset("number", data=np.arange(6, dtype="<i8")),
    ),
    "is not the number it should be": lambda f: f.attrs.create("complete", 1.5),
    "is not a data set": lambda f: (f.__delitem__("rest/position"), f["rest"].create_group("position")),
}


@pytest.mark.parametrize("sentence", CHANGES)
def test_what_cannot_be_is_told(tmp_path, sample, sentence):
    path = shutil.copy(sample, tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        CHANGES[sentence](file)
    assert sentence in fault(path)


def test_cut_at_any_byte_or_with_any_byte_changed_it_is_read_or_refused(tmp_path):
    """A change that no checksum covers may pass for positions; no other exception may come out, and no crash."""
    path = make_cache(tmp_path / "a.h5", 20, 1, 3, "velocity")
    whole = path.read_bytes()
    generator = random.Random(1)
    broken = tmp_path / "b.h5"
    for _ in range(60):
        broken.write_bytes(whole[: generator.randrange(len(whole))])
        assert fault(broken)
    refused = 0
    for _ in range(120):
        data = bytearray(whole)
        for _ in range(generator.randint(1, 4)):
            data[generator.randrange(len(data))] = generator.randrange(256)
        broken.write_bytes(data)
        refused += fault(broken) is not None
    assert refused > 20


def test_the_command_says_what_is_wrong_and_ends_with_strandbakes_codes(tmp_path, sample):
    (tmp_path / "text.h5").write_text("hair")
    run = run_strandcache("to-usd", tmp_path / "text.h5", tmp_path / "a.usdc")
    assert run.returncode == 3 and re.fullmatch(r"strandcache: error: .*text.h5: is not an HDF5 file.*\n", run.stderr)
    (tmp_path / "a.usdc").touch()
    run = run_strandcache("to-usd", sample, tmp_path / "a.usdc")
    assert run.returncode == 5 and "is there already; --force replaces it" in run.stderr
    assert run_strandcache("to-usd", sample).returncode == 2


def test_package_and_program_have_one_version():
    version = re.search(r"project\(strandbake VERSION ([0-9.]+)", (SOURCE / "CMakeLists.txt").read_text())[1]
    assert strandcache.__version__ == version == ".".join(map(str, strandcache.bl_info["version"]))
    assert (PACKAGE / "strandcache/py.typed").exists()
