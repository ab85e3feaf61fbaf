"""digest, and compare with one in place of a cache; the golden digests of the project, and the files for CI."""

import hashlib
import json
import pathlib
import re
import subprocess

import numpy as np
import pytest
import yaml
from conftest import DISK, ENVIRONMENT, GOOD, INPUT, INVALID, PROGRAM, SOURCE, USAGE, assert_one_error, hanging, positions, read, write_hair
from test_compare import assert_differs, changed, move

SCENE = '[[region]]\nname = "left"\nstrands = {range = "0-1"}\n[[region]]\nname = "right"\n[wind]\nvelocity = [2, 0, 0]\n'


@pytest.fixture
def golden(shot):
    return shot.bake(scene=shot.scene(SCENE, frames="1-6"), out="golden.h5")


@pytest.fixture
def digest(shot, golden):
    """The digest of the golden cache, under its name, so that caches are compared with it as with the cache."""
    text = shot.run("digest", "golden.h5").out
    golden.rename(shot / "whole.h5")
    (shot / "golden.h5").write_text(text)
    return text


def checksum(values):
    return hashlib.sha256(values.tobytes()).hexdigest()[:32]


def test_a_digest_is_what_numpy_finds(shot):
    """Of more vertices than a block of the cache holds."""
    rng = np.random.default_rng(3)
    write_hair(shot / "a.hair", [hanging(1, 3 + k % 9)[0] + rng.normal(size=3) * 0.05 for k in range(5000)])
    found = read(shot.bake(scene=shot.scene(SCENE, frames="1-3")))
    run = shot.run("digest", "out.h5", "-o", "out.digest", "--step", "1e-3")
    assert run.code == GOOD and re.fullmatch(r"out\.digest: 3 frames, [\d.]+ (KiB|B)\n", run.out)
    step = 2.0**-10
    rest, frames = found["rest/position"], found["frames/position"]
    topology = found["strands/offset"].tobytes() + found["strands/region"].tobytes() + b"left\0right\0"
    lines = ["strandbake digest 1", f"step {step}", "fps 24", "strands 5000", f"vertices {len(rest)}",
             f"topology {hashlib.sha256(topology).hexdigest()[:32]}", f"rest {checksum(rest)}", "frames 3"]
    for number, frame in enumerate(frames, 1):
        rounded = (np.rint(frame.astype(float) / step) * step).astype("<f4") + np.float32(0)
        lines += [f"frame {number}", f"rounded {checksum(rounded)}", f"exact {checksum(frame)}"]
    text = [line.strip() for line in (shot / "out.digest").read_text().splitlines()]
    assert [line for line in text if line and line.split()[0] not in ("low", "high")] == lines
    bounds = {word: [[float(x) for x in line.split()[1:]] for line in text if line.startswith(word)] for word in ("low", "high")}
    np.testing.assert_array_equal(np.float32(bounds["low"]), frames.min(axis=1))
    np.testing.assert_array_equal(np.float32(bounds["high"]), frames.max(axis=1))
    assert shot.run("digest", "out.h5", "--step", "1e-3", "--threads", "1").out == (shot / "out.digest").read_text()


def test_a_bake_agrees_with_its_digest(shot, digest):
    assert len(digest.splitlines()) == 8 + 6 * 6
    for options in ([], ["--set", "cache.compression=none"], ["--threads", "3"]):
        shot.bake(*options, "--force", out="cache.h5")
        run = shot.run("compare", "golden.h5", "cache.h5")
        assert (run.code, run.err) == (GOOD, "")
        assert run.out == "frames         1 to 6, 6 in all\npositions      the same\n"
    assert shot.run("compare", "golden.h5", "golden.h5").code == GOOD
    assert shot.run("compare", "whole.h5", "golden.h5").code == GOOD
    found = json.loads(shot.run("compare", "golden.h5", "cache.h5", "--json").out)
    assert found["good"] is True and found["step"] == 2.0**-14
    assert found["frames"] == [{"frame": k, "at_least": 0, "at_most": 0} for k in range(1, 7)]


def test_a_digest_tells_positions_that_are_near_from_those_that_are_not(shot, digest):
    """Half a step beside the middle of a cell rounds to the same, 0.25 m away does not."""
    step = 2.0**-14
    x = positions(shot / "whole.h5")[2, 13, 0]
    inside = np.float32(np.rint(x / step) * step + 0.1 * step)  # of the cell that x is in
    assert inside != x
    changed(shot / "whole.h5", lambda file: file["frames/position"].__setitem__((2, 13, 0), inside), "cache.h5")
    run = shot.run("compare", "golden.h5", "cache.h5")
    assert_differs(run, "frame 3 agrees to 0.000106 m, which --tolerance 0.000107 takes")
    assert "the same in 5 of 6 frames" in run.out
    assert shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "0.000107").code == GOOD
    assert shot.run("compare", "golden.h5", "cache.h5", "--frames", "4-6").code == GOOD
    changed(shot / "whole.h5", move((4, 29, [0, -0.25, 0])), "cache.h5")
    run = shot.run("compare", "golden.h5", "cache.h5", "--tolerance", "9", "--table")
    off = positions(shot / "whole.h5")[4, :, 1].min() - positions(shot / "cache.h5")[4, :, 1].min()
    assert_differs(run, f"frame 5 is off by {off:.3g} m or more")
    assert re.search(rf"\n +5 +{off:.3g} +unknown\n +6 +0 +0\n", run.out)


def test_a_digest_tells_other_strands_rest_poses_and_frames(shot, digest):
    shot.bake("--frames", "2-5", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), "frames that are missing: 1, 6")
    assert shot.run("compare", "golden.h5", "cache.h5", "--frames", "2-5").code == GOOD
    shot.bake("--set", "region.left.strands.range=0-2", "--force", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), "in another region")
    shot.bake("--set", "bake.fps=30", "--force", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), "frames a second: 30 in place of 24")
    shot.bake("--set", "groom.scale=1.1", "--force", out="cache.h5")
    assert_differs(shot.run("compare", "golden.h5", "cache.h5"), "the groom at rest is another")
    write_hair(shot / "a.hair", hanging(strands=7))
    shot.bake("--force", out="cache.h5")
    run = shot.run("compare", "golden.h5", "cache.h5")
    assert_differs(run, "strands: 7 in place of 5")
    assert "vertices: 42 in place of 30" in run.out


@pytest.mark.parametrize("line, text, words", [
    (1, "strandbake digest 2", ["version 2", "newer"]), (1, "strandbake digest 0", [":1:", "never"]),
    (1, "strandbake digest x", [":1:", '"x"']), (2, "step 0", [":2:", "above 0"]), (2, "step nan", [":2:", '"nan"']),
    (3, "fpss 24", [":3:", '"fpss" where "fps"']), (4, "strands", [":4:", "0 values"]), (4, "strands -1", [":4:", '"-1"']),
    (7, "rest 12", [":7:", "32 digits"]), (8, "frames 7", ["has 6 frames, but announced 7"]),
    (10, "frame 9", [":16:", "frame 2 comes after frame 9"]), (11, "  low 1 2", [":11:", "2 values"]),
    (11, "  low 1 inf 3", [":11:", '"inf"']), (45, "frame 7", ['ends before "low"']),
])
def test_a_digest_that_is_damaged_is_refused_with_its_line(shot, digest, line, text, words):
    lines = digest.splitlines() + [""]
    lines[line - 1] = text
    (shot / "golden.h5").write_text("\n".join(lines))
    assert_one_error(shot.run("compare", "golden.h5", "whole.h5"), INPUT, "golden.h5", *words)


def test_a_cut_digest_is_refused(shot, digest):
    for length in range(18, len(digest) - 1, 7):
        (shot / "golden.h5").write_text(digest[:length])
        assert shot.run("compare", "golden.h5", "golden.h5").code == INPUT, length


def test_a_digest_of_what_is_no_cache_or_not_finite_is_refused(shot, golden):
    changed(golden, move((4, 14, [0, np.nan, 0])), "bad.h5")
    assert_one_error(shot.run("digest", "bad.h5"), INPUT, "bad.h5: frame 5: strand 2, vertex 2 is not a finite number")
    for name in ("a.hair", "none.h5", "."):
        assert_one_error(shot.run("digest", name), INPUT, name)
    assert_one_error(shot.run("digest", "golden.h5", "--frames", "8-9"), INPUT, "golden.h5", "8-9")


def test_a_digest_writes_over_nothing_and_says_where_it_cannot_write(shot, golden):
    (shot / "old").write_text("old")
    assert_one_error(shot.run("digest", "golden.h5", "-o", "old"), DISK, "old", "--force")
    assert (shot / "old").read_text() == "old"
    assert shot.run("digest", "golden.h5", "-o", "old", "--force").code == GOOD
    assert_one_error(shot.run("digest", "golden.h5", "-o", "golden.h5", "--force"), DISK, "golden.h5", "is the file that is read")
    assert_one_error(shot.run("digest", "golden.h5", "-o", "none/new"), DISK, "none/new", "cannot be written")
    assert_one_error(shot.run("digest", "golden.h5", "-o", "/dev/full", "--force"), DISK, "/dev/full")


@pytest.mark.parametrize("arguments", [["digest"], ["digest", "golden.h5", "--step", "0"], ["digest", "golden.h5", "--step", "nan"],
                                       ["digest", "golden.h5", "--frames", "x"],
                                       ["compare", "golden.h5", "whole.h5", "--region", "left"]])
def test_a_command_line_without_sense_ends_with_2(shot, digest, arguments):
    run = shot.run(*arguments)
    assert run.code == USAGE and run.out == "" and run.err != ""


# In CI


def steps_of(name):
    """The shell of the step that bakes and compares."""
    text = yaml.safe_load((SOURCE / "docs/ci" / name).read_text())
    if name.startswith("github"):
        return next(step["run"] for step in text["jobs"]["golden"]["steps"] if "compare" in step.get("run", ""))
    return "\n".join(text["golden hair"]["script"])


@pytest.mark.parametrize("name", ["github-actions.yml", "gitlab-ci.yml"])
def test_the_files_for_ci_compare_shots_with_their_digests(shot, name):
    (shot / "shots").mkdir()
    (shot / "a.hair").rename(shot / "shots/a.hair")
    shot.scene(SCENE, name="shots/tail.toml")
    shot.bake(scene="shots/tail.toml", out="good.h5")
    assert shot.run("digest", "good.h5", "-o", "shots/tail.digest").code == GOOD

    def run():
        path = f"{pathlib.Path(PROGRAM).parent}:{ENVIRONMENT['PATH']}"
        return subprocess.run(["sh", "-e", "-c", steps_of(name)], cwd=shot.folder, env=ENVIRONMENT | {"PATH": path},
                              capture_output=True, text=True, check=False)

    good = run()
    assert good.returncode == GOOD, good.stderr
    (shot / "shots/tail.toml").write_text((shot / "shots/tail.toml").read_text() + "gust = 0.5\n")
    bad = run()
    assert bad.returncode == INVALID and "bakes/tail.h5 differs from shots/tail.digest: frame " in bad.stderr
    assert (shot / "bakes/tail.h5").exists()
