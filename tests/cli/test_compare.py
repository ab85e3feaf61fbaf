"""compare: how far a cache is from a golden one, against numpy."""

import json
import re
import shutil

import h5py
import numpy as np
import pytest
from conftest import GOOD, INPUT, INVALID, USAGE, assert_one_error, hanging, positions, read, write_hair

SCENE = '''[[region]]
name = "left"
strands = {range = "0-1"}
[[region]]
name = "right"
[wind]
velocity = [2, 0, 0]
'''


@pytest.fixture
def golden(shot):
    return shot.bake(scene=shot.scene(SCENE, frames="1-6"), out="golden.h5")


def changed(golden, change, name="cache.h5"):
    """A copy of the cache in which `change` has altered the open file."""
    path = golden.with_name(name)
    shutil.copy(golden, path)
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def move(*moves):
    """Moves single vertices: (index of the frame, vertex, by)."""
    def change(file):
        for frame, vertex, by in moves:
            row = file["frames/position"][frame]
            row[vertex] += np.float32(by)
            file["frames/position"][frame] = row
    return change


def assert_differs(run, *words):
    assert run.code == INVALID, run.err
    lines = run.err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("strandbake: error: cache.h5 differs from golden.h5: "), run.err
    for word in words:
        assert word in lines[0]


def compare(shot, *arguments):
    run = shot.run("compare", "golden.h5", "cache.h5", "--json", *arguments)
    return run, json.loads(run.out)


def test_a_cache_is_the_same_as_itself(shot, golden):
    shutil.copy(golden, shot / "cache.h5")
    run = shot.run("compare", "golden.h5", "cache.h5")
    assert (run.code, run.err) == (GOOD, "")
    assert run.out == "frames         1 to 6, 6 in all, 30 vertices each\npositions      the same\n"
    run, found = compare(shot)
    assert run.code == GOOD and found["good"] is True and found["mismatches"] == [] and found["frames_beyond"] == 0
    assert found["all"]["largest"] == found["all"]["rms"] == found["all"]["moved"] == 0
    assert [frame["frame"] for frame in found["frames"]] == [1, 2, 3, 4, 5, 6]


def test_how_a_cache_is_stored_makes_no_difference(shot, golden):
    for change in ("cache.compression=none", "cache.compression=deflate:9", "cache.velocity=true", "cache.stats=false"):
        other = shot.bake("--set", change, "--force", out="cache.h5")
        assert other.read_bytes() != golden.read_bytes()
        assert shot.run("compare", "golden.h5", "cache.h5").code == GOOD, change


def test_distances_are_those_that_numpy_finds(shot):
    """Two bakes of more vertices than a block holds, which gusts and a stiffness move apart."""
    rng = np.random.default_rng(3)
    write_hair(shot / "a.hair", [hanging(1, 3 + k % 9)[0] + rng.normal(size=3) * 0.05 for k in range(5000)])
    shot.scene(SCENE, frames="1-5")
    golden = shot.bake(out="golden.h5")
    cache = shot.bake("--set", "region.right.damping=0.3", out="cache.h5")
    run, found = compare(shot, "--tolerance", "1e-4")
    a, b = positions(golden).astype(float), positions(cache).astype(float)
    assert a.shape[1] > 2 * 16384
    offset = read(golden)["strands/offset"].astype(int)

    def check(figures, distance):
        worst = int(distance.argmax())
        strand = int(np.searchsorted(offset, worst, "right")) - 1
        assert (figures["strand"], figures["vertex"]) == (strand, worst - offset[strand])
        np.testing.assert_allclose([figures["largest"], figures["rms"]], [distance.max(), np.sqrt((distance**2).mean())],
                                   rtol=1e-12)
        assert figures["moved"] == np.count_nonzero(distance)
        percentile = np.percentile(distance, 99, method="inverted_cdf")
        assert percentile <= figures["percentile_99"] <= min(1.01 * percentile, distance.max())

    distance = np.linalg.norm(a - b, axis=2)
    for figures, frame in zip(found["frames"], distance):
        check(figures, frame)
    worst_frame = int(distance.max(axis=1).argmax())
    assert found["all"]["frame"] == worst_frame + 1 and found["all"]["region"] == "right"
    assert found["all"]["largest"] == found["frames"][worst_frame]["largest"]
    np.testing.assert_allclose(found["all"]["rms"], np.sqrt((distance**2).mean()), rtol=1e-12)
    percentile = np.percentile(distance, 99, method="inverted_cdf")
    assert percentile <= found["all"]["percentile_99"] <= 1.01 * percentile
    assert found["frames_beyond"] == np.count_nonzero(distance.max(axis=1) > 1e-4) > 0
    assert_differs(run, f"frame {worst_frame + 1} is up to ")
    for threads in ("1", "3"):
        assert compare(shot, "--tolerance", "1e-4", "--threads", threads)[1] == found


def test_a_tolerance_is_for_each_vertex(shot, golden):
    cache = changed(golden, move((2, 13, [0, 3e-3, 4e-3]), (3, 2, [1e-3, 0, 0])))
    distance = np.linalg.norm(positions(golden).astype(float) - positions(cache), axis=2).max()
    assert distance == pytest.approx(5e-3, rel=1e-3)
    run = shot.run("compare", "golden.h5", "cache.h5", "--table")
    assert_differs(run, "frame 3 is up to 0.005 m off")
    assert 'largest        0.005 m: frame 3, strand 2 ("right"), vertex 1\n' in run.out
    assert "beyond         2 of 6 frames are more than 0 m apart\n" in run.out
    assert re.search(r"\n +3 +0\.005 +2 +1 .* 1\n +4 +0\.001 +0 +2 .* 1\n", run.out)
    assert shot.run("compare", "golden.h5", "cache.h5", "--tolerance", repr(distance)).code == GOOD
    assert shot.run("compare", "golden.h5", "cache.h5", "--tolerance", repr(distance * (1 - 1e-9))).code == INVALID
    assert_differs(shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "2e-3"), "frame 3")


def test_the_plot_shows_where_errors_grow(shot, golden):
    changed(golden, move((2, 0, [1e-6, 0, 0]), (3, 0, [1e-5, 0, 0]), (4, 0, [1e-4, 0, 0]), (5, 0, [1e-3, 0, 0])))
    out = shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "5e-5").out
    bars = [line.partition("|")[2] for line in out.splitlines() if "|" in line]
    assert [sum(bar[k:k + 1] == "#" for bar in bars) for k in range(6)][:2] == [0, 0]
    heights = [sum(bar[k:k + 1] == "#" for bar in bars) for k in range(2, 6)]
    assert heights == sorted(set(heights)) and heights[0] == 1 and heights[-1] == len(bars)
    assert "largest distance [m], --- the tolerance of 5e-05\n" in out  and out.splitlines()[-1].split() == ["frame", "1", "6"]


def test_frames_and_regions_choose_what_is_compared(shot, golden):
    changed(golden, move((2, 13, [0.01, 0, 0])))  # of "right", in frame 3
    for chosen, code in (([], INVALID), (["--frames", "3"], INVALID), (["--frames", "4-6"], GOOD), (["--region", "left"], GOOD),
                         (["--region", "right"], INVALID), (["--region", "left", "--region", "right"], INVALID)):
        assert shot.run("compare", "golden.h5", "cache.h5", *chosen).code == code, chosen
    assert compare(shot, "--region", "left")[1]["vertices"] == 12
    assert_one_error(shot.run("compare", "golden.h5", "cache.h5", "--region", "top"), INPUT, "golden.h5", '"top"', '"left", "right"')
    assert_one_error(shot.run("compare", "golden.h5", "cache.h5", "--frames", "8-9"), INPUT, "golden.h5", "no frame from 8 to 9")


def test_missing_frames_and_those_too_many_differ(shot, golden):
    shot.bake("--frames", "2-5", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), "frames that are missing: 1, 6")
    assert shot.run("compare", "golden.h5", "cache.h5", "--frames", "2-5").code == GOOD
    run = shot.run("compare", "cache.h5", "golden.h5")
    assert run.code == INVALID and "differs        frames that are too many: 1, 6\n" in run.out
    assert "positions      the same\n" in run.out


def test_other_strands_are_said_and_not_measured(shot, golden):
    write_hair(shot / "a.hair", hanging(strands=7))
    shot.bake(out="cache.h5")
    run, found = compare(shot)
    assert_differs(run, "strands: 7 in place of 5")
    assert found["mismatches"] == ["strands: 7 in place of 5"] and found["frames"] == [] and "all" not in found
    write_hair(shot / "a.hair", [hanging(1, n)[0] for n in (6, 5, 7, 6, 6)])
    shot.bake("--force", out="cache.h5")
    assert compare(shot)[1]["mismatches"] == ["vertices of strand 1: 5 in place of 6"]


def test_other_regions_rates_and_rest_poses_differ(shot, golden):
    shot.bake("--set", "bake.fps=30", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "9"), "frames a second: 30 in place of 24")
    shot.bake("--set", "region.left.strands.range=0-2", "--force", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "9"), "region of strand 2: left in place of right")
    shot.bake("--set", "region.left.name=top", "--force", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), 'regions: "top", "right" in place of "left", "right"')

    def move_rest(file):
        file["rest/position"][7] += np.float32([0, 0, 0.25])
    changed(golden, move_rest)
    run = shot.run("compare", "golden.h5", "cache.h5")
    assert_differs(run, "at rest it is up to 0.25 m off")
    assert "at rest        0.25 m at most, strand 1, vertex 1\n" in run.out


def test_an_unfinished_cache_is_compared_as_far_as_it_goes(shot, golden):
    def cut(file):
        file.attrs["complete"] = np.uint8(0)
        for group in (file["frames"], file["stats"]):
            for item in group.values():
                item.resize(4, axis=0)
    changed(golden, cut)
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), "frames that are missing: 5-6")
    assert shot.run("compare", "golden.h5", "cache.h5", "--frames", "1-4").code == GOOD


def test_numbers_that_are_not_finite_are_refused(shot, golden):
    changed(golden, move((4, 14, [0, np.nan, 0])))
    run = shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "1")
    assert_one_error(run, INPUT, "cache.h5: frame 5: strand 2, vertex 2 is not a finite number")
    run = shot.run("compare", "cache.h5", "cache.h5", "--tolerance", "1")
    assert_one_error(run, INPUT, "cache.h5: frame 5: strand 2, vertex 2 is not a finite number")


def test_what_is_no_cache_is_refused(shot, golden):
    (shot / "cut.h5").write_bytes(golden.read_bytes()[:3000])
    with h5py.File(shot / "other.h5", "w") as file:
        file["position"] = [1, 2, 3]
    for name in ("cut.h5", "other.h5", "a.hair", "none.h5", "."):
        assert_one_error(shot.run("compare", "golden.h5", name), INPUT, name)
        assert_one_error(shot.run("compare", name, "golden.h5"), INPUT, name)


@pytest.mark.parametrize("arguments", [
    [], ["golden.h5"], ["golden.h5", "golden.h5", "golden.h5"], ["golden.h5", "golden.h5", "--tolerance", "-1"],
    ["golden.h5", "golden.h5", "--tolerance", "nan"], ["golden.h5", "golden.h5", "--tolerance", "near"],
    ["golden.h5", "golden.h5", "--frames", "x"], ["golden.h5", "golden.h5", "--threads", "0"]])
def test_a_command_line_without_sense_ends_with_2(shot, golden, arguments):
    run = shot.run("compare", *arguments)
    assert run.code == USAGE and run.out == "" and run.err != ""
