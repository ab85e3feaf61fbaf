"""bake: its options, what it says where, and what it leaves behind."""

import fcntl
import json
import os
import pty
import re
import resource
import shutil
import signal
import subprocess

import h5py
import numpy as np
import pytest
from conftest import (DISK, GOOD, INTERRUPTED, INVALID, NON_FINITE, PROGRAM, SOURCE, USAGE, assert_one_error, hanging, positions, read,
                      write_hair, write_tfx3)

LONG = "1-1000000"  # far longer than a test waits


def events_of(run):
    """What a bake told, but for the name of the schema."""
    events = [json.loads(line) for line in run.out.splitlines()]
    assert all(event.pop("schema").startswith("urn:strandbake:bake:") for event in events)
    return events


# What it says


def test_stdout_has_the_result_and_stderr_the_progress(shot):
    run = shot.run("bake", shot.scene())
    assert run.code == GOOD
    assert re.fullmatch(r"scene\.h5: 4 frames, 30 vertices, [\d.]+ KiB, [\d.]+ s\n", run.out)
    assert re.fullmatch(r"baking 4/4, 0.0 s left, frame 4\n", run.err)
    assert "\r" not in run.err and "\033" not in run.err
    assert shot.files() == ["a.hair", "scene.h5", "scene.toml"]


def test_the_summary_tells_what_was_skipped(shot):
    """A head that stands, no gravity, and a sphere that nothing is near: only the first substep has anything to do."""
    shot.scene("[forces]\ngravity = [0, 0, 0]\n[[collider]]\nsphere = {center = [9, 9, 9], radius = 0.1}\n")
    run = shot.run("bake", "scene.toml", "--threads", "1")
    # 4 frames: the first is the rest pose, and 4 substeps lead to each of the others.
    assert run.out.splitlines()[1] == ("skipped 91.7 % of the simulation: strands at rest, "
                                       "100 % of the collisions: spheres out of reach"), run.out
    done = json.loads(shot.run("bake", "scene.toml", "--json", "--force", "--threads", "1").out.splitlines()[-1])
    assert done["block_substeps"] == 12 * done["block_spheres"] and done["block_substeps_at_rest"] == 11 * done["block_spheres"]
    assert done["block_spheres_out_of_reach"] == done["block_spheres"]
    run = shot.run("bake", "scene.toml", "--force", "--no-skip", "resting,colliders")
    assert len(run.out.splitlines()) == 1


def test_quiet_says_nothing(shot):
    run = shot.run("bake", shot.scene(), "--quiet")
    assert (run.code, run.out, run.err) == (GOOD, "", "")


def test_quiet_still_says_warnings_and_errors(shot):
    write_hair(shot / "a.hair", [[[0, 0, 0], [0, 0, 0], [0, 1, 0]]])
    run = shot.run("bake", shot.scene(), "--quiet")
    assert run.code == GOOD and run.out == "" and "strandbake: warning: " in run.err
    assert_one_error(shot.run("bake", "none.toml", "--quiet"), 3, "none.toml")


def test_a_terminal_gets_a_bar_with_the_time_left(shot):
    shot.scene()
    master, slave = pty.openpty()
    process = shot.start("bake", "scene.toml", stdout=subprocess.PIPE, stderr=slave)
    os.close(slave)
    seen = b""
    try:
        while block := os.read(master, 4096):
            seen += block
    except OSError:  # the other end is closed
        pass
    os.close(master)
    assert process.communicate()[0].startswith("scene.h5: 4 frames") and process.returncode == GOOD
    bars = [bar for bar in seen.decode().split("\r\033[K") if bar]
    assert len(bars) == 4
    for done, bar in enumerate(bars, 1):
        assert re.fullmatch(rf"baking \[#*\.*\] {done}/4  [\d.]+ s left  frame {done}", bar)
    assert "." in bars[0].partition("]")[0] and "." not in bars[-1].partition("]")[0]
    assert seen.endswith(b"\r\033[K")  # the bar is taken away in the end


def test_json_events_are_one_object_a_line(shot):
    shot.scene()
    run = shot.run("bake", "scene.toml", "--json")
    events = events_of(run)
    assert run.code == GOOD and run.err == ""
    assert [e["event"] for e in events] == ["start", "frame", "frame", "frame", "frame", "done"]
    start, done = events[0], events[-1]
    assert (start["first_frame"], start["last_frame"], start["simulated_from"], start["vertices"]) == (1, 4, 1, 30)
    assert start["output"] == "scene.h5" and start["threads"] >= 1 and re.fullmatch(r"\d+\.\d+\.\d+", start["version"])
    assert [e["frame"] for e in events[1:-1]] == [1, 2, 3, 4]
    stretch = read(shot / "scene.h5")["stats/largest_stretch"]
    np.testing.assert_array_equal(np.array([e["largest_stretch"] for e in events[1:-1]], np.float32), stretch)
    assert start["substeps"] == {"least": 4, "most": 4, "total": 12}
    assert [e["substeps"] for e in events[1:-1]] == [0, 4, 4, 4]  # the first frame is where hair starts
    assert done["bytes"] == (shot / "scene.h5").stat().st_size and done["seconds"] > 0


def test_json_tells_warnings_faults_and_errors(shot):
    write_hair(shot / "a.hair", [[[0, 0, 0], [0, 0, 0], [0, 1, 0]]])
    shot.scene()
    warned = events_of(shot.run("bake", "scene.toml", "--json"))
    assert warned[0]["event"] == "warning" and "coincide" in warned[0]["message"]

    again = shot.run("bake", "scene.toml", "--json")
    assert again.code == DISK
    assert events_of(again)[-1] == {"event": "error", "code": DISK,
                                    "message": "scene.h5: there is a file of this name already; --force replaces it"}
    assert events_of(again)[-1]["message"] in again.err

    faulty = shot.run("bake", "scene.toml", "--json", "--set", "bake.fps=0")
    fault, error = events_of(faulty)[-2:]
    assert faulty.code == 3
    assert fault["event"] == "fault" and fault["place"] == "--set bake.fps=0" and "more than 0" in fault["message"]
    assert error == {"event": "error", "code": 3, "message": "the scene has 1 fault"}

    missing = shot.run("bake", "none.toml", "--json")
    assert [e["event"] for e in events_of(missing)] == ["error"] and missing.code == 3


def test_json_survives_names_that_are_not_utf8(shot):
    name = os.fsdecode(b"sc\xffene.toml")
    shot.scene(name=name)
    run = shot.run("bake", name, "--json")
    assert run.code == GOOD
    assert events_of(run)[-1]["output"] == "sc\ufffdene.h5"


@pytest.mark.parametrize("setting", ["passive", "active"])
def test_threads_that_wait_sleep_unless_told_otherwise(shot, setting):
    env = {"OMP_DISPLAY_ENV": "true"} | ({"OMP_WAIT_POLICY": "active"} if setting == "active" else {})
    run = shot.run("bake", shot.scene(), "--quiet", env=env)
    assert re.search(rf"OMP_WAIT_POLICY *= *'{setting}'", run.err, re.IGNORECASE), run.err


# Usage


@pytest.mark.parametrize("arguments", [
    [], ["bake"], ["bake", "--frobnicate", "scene.toml"], ["bake", "scene.toml", "more.toml"], ["frobnicate"],
    ["bake", "scene.toml", "--threads", "0"], ["bake", "scene.toml", "--threads", "two"], ["bake", "scene.toml", "--lanes", "5"],
    ["bake", "scene.toml", "--frames", "two"], ["bake", "scene.toml", "--frames", "4-2"],
    ["bake", "scene.toml", "--frames", "0-2"], ["bake", "scene.toml", "--frames", "3-5"], ["bake", "scene.toml", "--set"],
    ["bake", "scene.toml", "--json", "--dry-run"],
])
def test_a_command_line_without_sense_ends_with_2(shot, arguments):
    shot.scene()
    run = shot.run(*arguments)
    assert run.code == USAGE
    assert run.out == "" and run.err != ""
    assert shot.files() == ["a.hair", "scene.toml"]


def test_help_and_version_go_to_stdout(shot):
    for arguments in (["--help"], ["bake", "--help"], ["--version"]):
        run = shot.run(*arguments)
        assert run.code == GOOD and run.out != "" and run.err == ""
    assert re.fullmatch(r"strandbake \d+\.\d+\.\d+\n", shot.run("--version").out)
    for word in ("--frames", "--threads", "--set", "--output", "--force", "--quiet", "--json", "--dry-run",
                 "--search", "--lanes", "--fail-on", "--resume", "--checkpoint"):
        assert word in shot.run("bake", "--help").out


def test_output_that_cannot_be_written_to_stdout_is_an_error(shot):
    for arguments in (["docs"], ["check", shot.scene()], ["bake", "scene.toml", "--json"]):
        with open("/dev/full", "w") as full:
            process = shot.start(*arguments, stdout=full, stderr=subprocess.PIPE)
            errors = process.communicate()[1]
        assert process.returncode == DISK and len(errors.splitlines()) == 1 and errors.startswith("strandbake: error: ")


# Options


def test_automatic_substeps_are_told_and_written(shot, head):
    shot.scene(head, frames="1-60")
    auto = ["--set", "bake.substeps=auto", "--set", "bake.preroll=2"]
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--json", *auto)
    start, *frames, done = events_of(run)
    found = read(shot / "out.h5")
    counts = found["stats/substeps"]
    assert counts.dtype == np.int32 and [e["substeps"] for e in frames] == list(counts)
    assert start["substeps"] == {"least": 1, "most": counts.max(), "total": counts.sum() + 1}  # one before the first
    assert counts[0] == 1 and 2 < counts.max() <= 1000 and len(set(counts)) > 5
    assert done["block_substeps"] == start["substeps"]["total"]
    assert b'bake.substeps' in found["provenance/parameters/name"] and b'"auto"' in found["provenance/parameters/value"]
    # However the bake is cut, and on whatever it runs.
    part = read(shot.bake(*auto, "--frames", "30-40", out="part.h5"))
    np.testing.assert_array_equal(part["stats/substeps"], counts[29:40])
    np.testing.assert_array_equal(part["frames/position"], found["frames/position"][29:40])
    for option in (["--lanes", "4"], ["--threads", "3"]):
        assert shot.bake(*auto, *option, out="again.h5").read_bytes() == (shot / "out.h5").read_bytes()
        (shot / "again.h5").unlink()


def test_frames_writes_the_same_frames_as_the_full_bake(shot, head):
    shot.scene(head + "[wind]\nvelocity = [2, 0, 0]\ngust = 0.5\n[cache]\nvelocity = true\n", frames="-1-6")
    full = read(shot.bake("--set", "bake.preroll=2", out="full.h5"))
    for first, last in ((-1, -1), (2, 4), (6, 6)):
        asked = f"{first}-{last}" if last > first else f"{first}"
        run = shot.run("bake", "scene.toml", "--set", "bake.preroll=2", "--frames", asked, "-o", "part.h5", "--force")
        assert run.code == GOOD, run.err
        if first > -1:
            assert f"simulating frames -1 to {first - 1} first" in run.err
        part = read(shot / "part.h5")
        for name in ("position", "velocity", "head", "time", "number"):
            np.testing.assert_array_equal(part[f"frames/{name}"], full[f"frames/{name}"][first + 1:last + 2])
        for name in ("largest_stretch", "deepest_penetration", "substeps"):
            np.testing.assert_array_equal(part[f"stats/{name}"], full[f"stats/{name}"][first + 1:last + 2])


def test_the_cache_is_named_after_the_scene_or_by_o(shot):
    (shot / "sub").mkdir()
    shot.scene(name="sub/tail.toml", files='["../a.hair"]')
    assert shot.run("bake", "sub/tail.toml").code == GOOD
    assert shot.run("bake", "sub/tail.toml", "-o", "sub/b.cache").code == GOOD
    assert (shot / "tail.h5").read_bytes() == (shot / "sub/b.cache").read_bytes()
    assert sorted(p.name for p in (shot / "sub").iterdir()) == ["b.cache", "tail.toml"]


def test_an_existing_cache_stays_without_force(shot):
    old = shot.bake(scene=shot.scene()).read_bytes()
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--set", "bake.substeps=7")
    assert_one_error(run, DISK, "out.h5", "--force")
    assert (shot / "out.h5").read_bytes() == old
    assert shot.bake("--set", "bake.substeps=7", "--force").read_bytes() != old
    assert shot.files() == ["a.hair", "out.h5", "scene.toml"]


def test_set_overrides_a_parameter_by_name_and_by_number(shot):
    shot.scene('[[region]]\nname = "tail"\ndamping = 0.4\n[[collider]]\nsphere = {radius = 0.2}\n')
    cache = shot.bake("--set", "bake.substeps=3", "--set", "region.tail.damping=0.3", "--set", "region[0].drag=2", "--set",
                      "collider[0].sphere.radius={1 = 0.1, 2 = 0.12}", "--set", "groom.units=cm")
    found = read(cache)
    in_force = dict(zip(found["provenance/parameters/name"].astype(str), found["provenance/parameters/value"].astype(str)))
    assert in_force["bake.substeps"] == "3"
    assert in_force["region[0].damping"] == "0.3" and in_force["region[0].drag"] == "2"
    assert in_force["collider[0].sphere.radius"] == "{1 = 0.1, 2 = 0.12}"
    assert in_force["groom.units"] == '"cm"'
    scene = found["provenance/scene"].decode()
    assert scene.startswith((shot / "scene.toml").read_text()) and "# --set region.tail.damping=0.3\n" in scene
    np.testing.assert_allclose(found["rest/position"], hanging().reshape(-1, 3) / 100, rtol=1e-6)


def test_files_are_found_through_search_and_the_environment(shot):
    for folder in ("one", "two"):
        (shot / folder).mkdir()
    (shot / "a.hair").rename(shot / "one/a.hair")
    write_hair(shot / "two/a.hair", hanging(strands=2))
    shot.scene()
    assert shot.run("bake", "scene.toml").code == 3

    def strands(*arguments, **more):
        return len(read(shot.bake("--force", *arguments, **more))["strands/region"])

    assert strands("--search", "one") == 5
    assert strands("--search", shot / "two") == 2
    assert strands(env={"STRANDBAKE_PATH": f"nowhere:{shot / 'two'}"}) == 2
    assert strands("--search", "one", env={"STRANDBAKE_PATH": "two"}) == 5  # the command line goes first
    assert strands("--search", "none", "--search", "two", env={"STRANDBAKE_PATH": "one"}) == 2


def test_dry_run_tells_the_plan_and_writes_nothing(shot):
    shot.scene()
    run = shot.run("bake", "scene.toml", "--dry-run")
    assert run.code == GOOD and run.err == ""
    assert re.search(r"memory +about [\d.]+ [KM]?i?B", run.out) and re.search(r"disk +less than about [\d.]+ [KM]?i?B", run.out)
    assert run.out == shot.run("check", "scene.toml").out
    assert shot.files() == ["a.hair", "scene.toml"]


def test_threads_are_as_many_as_asked_for(shot):
    events = events_of(shot.run("bake", shot.scene(), "--json", "--threads", "3"))
    assert events[0]["threads"] == 3


def test_a_cache_has_only_what_was_asked_for(shot):
    shot.scene("[cache]\nstats = false\n")
    with h5py.File(shot.bake()) as file:
        assert "stats" not in file and "velocity" not in file["frames"]
        assert file["frames/position"].compression == "gzip" and file["frames/position"].shuffle
    plain = shot.bake("--set", "cache.compression=none", "--set", "cache.velocity=true", "--set", "cache.stats=true", "--force")
    with h5py.File(plain) as file:
        assert "stats" in file and file["frames/velocity"].shape == (4, 30, 3)
        assert file["frames/position"].compression is None


# What it leaves behind where it ends early


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_bake_leaves_its_finished_frames(shot, stop):
    shot.scene(frames=LONG)
    process = shot.start("bake", "scene.toml", "-o", "out.h5", "--json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while json.loads(process.stdout.readline()).get("frame") != 5:
        pass
    process.send_signal(stop)
    out, err = process.communicate(timeout=100)
    assert process.returncode == INTERRUPTED
    error = json.loads(out.splitlines()[-1])
    assert error["event"] == "error" and error["code"] == INTERRUPTED and "out.h5.part" in error["message"]
    assert err == f"strandbake: error: {error['message']}\n"
    assert shot.files() == ["a.hair", "out.h5.part", "out.h5.part.state", "scene.toml"]

    with h5py.File(shot / "out.h5.part") as file:
        assert file.attrs["complete"] == 0
        number = file["frames/number"][:]
        found = file["frames/position"][:]
    told = [event["frame"] for event in map(json.loads, out.splitlines()) if event["event"] == "frame"]
    assert told[-1] == number[-1]  # what is said to be written is, and nothing else
    assert len(number) >= 5 and f"before frame {number[-1] + 1}" in error["message"]
    undisturbed = positions(shot.bake("--set", f"bake.frames=1-{number[-1]}", out="whole.h5"))
    np.testing.assert_array_equal(found, undisturbed)
    assert "(not finished)" in shot.run("info", "out.h5.part").out

    # The next bake does not throw away what was left, unless it is told to.
    assert shot.run("bake", "scene.toml", "-o", "out.h5", "--set", "bake.frames=1-2").code == DISK
    shot.bake("--force", "--set", "bake.frames=1-2")
    assert shot.files() == ["a.hair", "out.h5", "scene.toml", "whole.h5"]


def test_a_stopped_bake_leaves_the_old_cache_alone(shot):
    old = shot.bake(scene=shot.scene()).read_bytes()
    process = shot.start("bake", "scene.toml", "-o", "out.h5", "--json", "--force", "--set", f"bake.frames={LONG}",
                         stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=100)
    assert process.returncode == INTERRUPTED
    assert (shot / "out.h5").read_bytes() == old


def test_two_bakes_do_not_write_one_cache(shot):
    shot.scene(frames=LONG)
    process = shot.start("bake", "scene.toml", "-o", "out.h5", "--json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.readline()
    second = shot.run("bake", "scene.toml", "-o", "out.h5", "--set", "bake.frames=1-2", "--quiet", "--force")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=100)
    assert_one_error(second, DISK, "out.h5.part", "written by another program")
    assert process.returncode == INTERRUPTED
    assert len(read(shot / "out.h5.part")["frames/number"]) > 0


@pytest.mark.parametrize("precision", ["float", "double"])
def test_a_bake_that_leaves_the_numbers_names_strand_vertex_frame_and_substep(shot, precision):
    gravity = {"float": "1e38", "double": "1e308"}[precision]
    shot.scene(f'[solver]\nprecision = "{precision}"\n[forces]\ngravity = {{2 = [0, 0, 0], 3 = [0, {gravity}, 0]}}\n')
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--json", "--set", "bake.substeps=3")
    assert run.code == NON_FINITE
    where = r"frame 3, substep \d of 3: strand \d+, vertex \d+ is no longer a finite number"
    assert re.fullmatch(rf"strandbake: error: {where}; .*out\.h5\.part.*\n", run.err)
    *_, found, error = events_of(run)
    assert error["code"] == NON_FINITE
    told = f"frame 3, substep {found['substep']} of 3: strand {found['strand']}, vertex {found['vertex']} is"
    assert found["event"] == "non_finite" and found["frame"] == 3 and told in run.err
    assert shot.files() == ["a.hair", "out.h5.part", "scene.toml"]
    found = read(shot / "out.h5.part")
    np.testing.assert_array_equal(found["frames/number"], [1, 2])
    assert np.isfinite(found["frames/position"]).all()


# Nothing but gravity, which is 0 up to frame 3 and g in frame 4: after k of its 4 substeps of h, what is free has fallen
# k (k + 1) / 2 g h^2. The largest float is 3.4e38.
@pytest.mark.parametrize("substep", [1, 2, 3, 4])
def test_the_substep_that_leaves_the_numbers_is_the_one_that_falls_too_far(shot, substep):
    gravity = 3.4028e38 * 1.2 / (substep * (substep + 1) / 2) * (24 * 4) ** 2
    shot.scene("[forces]\ngravity = {3 = [0, 0, 0], 4 = [0, %r, 0]}\n" % -gravity + """
[[region]]
name = "hair"
damping = 0
local.stiffness = 0
global.stiffness = 0
lengths = {iterations = 0}
""")
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--set", "bake.substeps=4", "--set", "bake.fps=24", "--quiet")
    assert run.code == NON_FINITE and f"frame 4, substep {substep} of 4: strand 0, vertex 2 is" in run.err


def test_a_bake_that_leaves_the_numbers_when_its_groom_is_gone_names_the_frame(shot):
    shot.scene("[forces]\ngravity = {199 = [0, 0, 0], 200 = [0, 1e38, 0]}\n", frames="1-300")
    process = shot.start("bake", "scene.toml", "-o", "out.h5", "--json", "--set", "bake.substeps=2", stdout=subprocess.PIPE,
                         stderr=subprocess.PIPE)
    fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)  # too small for 200 frames, so the bake waits for us
    process.stdout.readline()
    (shot / "a.hair").unlink()
    out, err = process.communicate(timeout=100)
    assert process.returncode == NON_FINITE
    assert "frame 200, in one of its 2 substeps: strand 0, vertex " in err
    assert json.loads(out.splitlines()[-2])["substep"] is None


STRETCHY = """[forces]
gravity = {4 = [0, 0, 0], 5 = [0, -9.81, 0]}
[[region]]
name = "hair"
lengths.iterations = 0
"""
IN_THE_WAY = "[[collider]]\nsphere = {center = [0.01, 1.51, 0], radius = 0.02}\n"


def tied_at_both_ends(path):
    points = hanging(strands=3, vertices=12)
    points[:, -1, 0] += 0.02
    write_tfx3(path, points, both_ends=True)


ONE_SWEEP = '[[region]]\nname = "hair"\nlengths.iterations = 1\n'


def test_the_residual_is_that_of_segments_between_pinned_vertices(shot):
    tied_at_both_ends(shot / "tied.tfx")
    shot.scene("[forces]\ngravity = {4 = [0, 0, 0], 5 = [-20, -9.81, 0]}\n" + ONE_SWEEP, files='["tied.tfx", "a.hair"]',
               frames="1-12")
    found = read(shot.bake())
    residual, stretch = found["stats/residual"], found["stats/largest_stretch"]
    np.testing.assert_array_equal(residual[:4] < 1e-5, True)
    assert residual[4:].max() > 1e-3 and (stretch >= residual).all()
    offset = found["strands/offset"].astype(int)[:4]  # those of tied.tfx
    tied = found["frames/position"][:, :offset[3]].reshape(12, 3, 12, 3).astype(float)
    rest = found["rest/position"][:offset[3]].reshape(3, 12, 3).astype(float)
    lengths, rest_lengths = (np.linalg.norm(np.diff(points, axis=-2), axis=-1) for points in (tied, rest))
    error = np.abs(lengths / rest_lengths - 1).max(axis=(1, 2))
    np.testing.assert_allclose(residual, error, atol=1e-4)  # floats in the world tell 1e-5 of 9 mm
    info = json.loads(shot.run("info", "out.h5", "--json").out)
    assert info["residual"] == {"value": residual.max(), "frame": found["frames/number"][residual.argmax()]}
    assert re.search(r"residual +[\d.]+ % at most between pinned vertices, in frame \d+\n", shot.run("info", "out.h5").out)
    most = float(residual.max())
    run = shot.run("bake", "scene.toml", "-o", "new.h5", "--quiet", "--fail-on", f"residual={most / 2}")
    assert run.code == INVALID and "the largest residual is " in run.err
    alone = read(shot.bake("--set", 'groom.files=["a.hair"]', out="alone.h5"))
    np.testing.assert_array_equal(alone["stats/residual"], 0)
    assert "residual" not in shot.run("info", "alone.h5").out


def test_figures_far_from_the_origin_have_no_noise_of_float(shot):
    tied_at_both_ends(shot / "tied.tfx")
    scene = """[bake]
frames = "1-12"
[groom]
files = ["tied.tfx", "a.hair"]
translate = [%r, 0, %r]
[[collider]]
sphere = {center = [%r, 1.5, %r], radius = 0.05}
"""
    figures = []
    for name, x, z in [("near", 0.0, 0.0), ("far", 131072.0, -65536.0)]:
        (shot / "scene.toml").write_text(scene % (x, z, x + 0.01, z) + ONE_SWEEP)
        figures.append(read(shot.bake(out=f"{name}.h5")))
    near, far = figures
    assert near["stats/residual"].max() > 1e-3 and near["stats/deepest_penetration"].max() > 1e-4
    for name in ("largest_stretch", "residual", "deepest_penetration"):
        np.testing.assert_allclose(far[f"stats/{name}"], near[f"stats/{name}"], rtol=1e-3, atol=2e-5)


def test_a_bake_fails_on_the_first_frame_beyond_a_limit(shot):
    shot.scene(STRETCHY, frames="1-12")
    whole = shot.bake(out="whole.h5")
    figures = read(whole)["stats/largest_stretch"]
    assert figures[:4].max() < 0.01 < figures[4:].max()
    frame = int(np.argmax(figures > 0.01)) + 1
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--json", "--fail-on", "stretch=0.01")
    assert run.code == INVALID
    message = (f"frame {frame}: the largest stretch is {figures[frame - 1]!s}, but --fail-on stretch=0.01 allows no more; "
               "more substeps may help, and lengths = \"direct\" where they are iterated; out.h5.part holds the frames up to it")
    assert run.err == f"strandbake: error: {message}\n"
    *_, last, limit, error = events_of(run)
    assert last["event"] == "frame" and last["frame"] == frame
    assert limit == {"event": "limit", "frame": frame, "figure": "stretch", "value": limit["value"], "limit": 0.01}
    assert np.float32(limit["value"]) == figures[frame - 1]
    assert error == {"event": "error", "code": INVALID, "message": message}
    assert shot.files() == ["a.hair", "out.h5.part", "scene.toml", "whole.h5"]
    part = read(shot / "out.h5.part")
    np.testing.assert_array_equal(part["frames/number"], range(1, frame + 1))
    np.testing.assert_array_equal(part["frames/position"], positions(whole)[:frame])
    assert "(not finished)" in shot.run("info", "out.h5.part").out


def test_a_limit_holds_for_the_last_frame_and_for_each_figure(shot):
    shot.scene(STRETCHY + IN_THE_WAY, frames="1-12")
    found = read(shot.bake(out="whole.h5"))
    deepest = found["stats/deepest_penetration"]
    assert deepest.max() > 0
    frame = int(np.argmax(deepest > 0)) + 1
    for more in ([], ["--fail-on", "stretch=1e9"], ["--fail-on", "penetration=1"]):  # the strictest counts
        run = shot.run("bake", "scene.toml", "--frames", str(frame), "--force", "--quiet", "--fail-on", "penetration=0", *more)
        assert_one_error(run, INVALID, f"frame {frame}: the deepest penetration is {deepest[frame - 1]!s} m, but --fail-on "
                         "penetration=0 allows no more", "colliders", "scene.h5.part")
        np.testing.assert_array_equal(read(shot / "scene.h5.part")["frames/number"], [frame])


def test_a_bake_within_its_limits_is_the_same_as_one_without(shot):
    shot.scene(STRETCHY, frames="1-12")
    plain = read(shot.bake(out="plain.h5"))
    most = max(plain["stats/largest_stretch"])
    bounded = shot.bake("--fail-on", f"stretch={float(most)}", "--fail-on", "penetration=0.1", out="bounded.h5")
    assert bounded.read_bytes() == (shot / "plain.h5").read_bytes()
    # Figures that are not written are measured all the same.
    bare = shot.bake("--set", "cache.stats=false", "--fail-on", "stretch=1e9", out="bare.h5")
    assert bare.read_bytes() == shot.bake("--set", "cache.stats=false", out="stats.h5").read_bytes()
    run = shot.run("bake", "scene.toml", "--set", "cache.stats=false", "--fail-on", "stretch=0.01")
    assert_one_error(run, INVALID, "the largest stretch is ")


@pytest.mark.parametrize("text, words", [
    ("stretch", '"stretch" has no "="'), ("=1", '"" is no figure'), ("length=1", '"length" is no figure of a frame'),
    ("stretch=", 'the limit of stretch is ""'), ("stretch=1%", 'is "1%", but must be a number from 0'),
    ("penetration=-0.1", 'the limit of penetration is "-0.1"'), ("stretch=nan", '"nan"'), ("stretch=inf", '"inf"'),
    ("stretch=1e999", '"1e999"'), ("stretch=1,penetration=1", '"1,penetration=1"'), ("", '"" has no "="'),
])
def test_a_limit_without_sense_is_a_usage_error(shot, text, words):
    run = shot.run("bake", shot.scene(), "--fail-on", text)
    assert run.code == USAGE and run.out == ""
    assert words in run.err and "write stretch=0.01 or residual=0.01 (shares of the length), or penetration=0.001 (metres)" in run.err
    assert shot.files() == ["a.hair", "scene.toml"]


# Disks


def test_a_folder_that_is_not_there_is_said(shot):
    assert_one_error(shot.run("bake", shot.scene(), "-o", "none/out.h5"), DISK, "none/out.h5", "folder")
    (shot / "sub").mkdir()
    assert_one_error(shot.run("bake", "scene.toml", "-o", "sub"), DISK, "sub")
    assert_one_error(shot.run("bake", "scene.toml", "-o", "sub", "--force"), DISK, "sub", "folder")
    assert_one_error(shot.run("bake", "scene.toml", "-o", "a.hair/out.h5", "--force"), DISK, "a.hair/out.h5")


def test_a_folder_that_cannot_be_written_is_said(shot):
    if os.geteuid() != 0:
        (shot / "sub").mkdir()
        (shot / "sub").chmod(0o555)
        output = "sub/out.h5"
    else:  # nothing stops root but a file system that takes no files
        output = "/proc/out.h5"
    assert_one_error(shot.run("bake", shot.scene(), "-o", output), DISK, output, "cannot be created")


def limit_file_size():
    resource.setrlimit(resource.RLIMIT_FSIZE, (128 << 10, 128 << 10))


def test_a_disk_that_becomes_full_costs_no_finished_frame(shot):
    write_hair(shot / "a.hair", hanging(strands=200))
    old = shot.bake(scene=shot.scene('[cache]\ncompression = "none"\n', frames="1-40")).read_bytes()
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--force", "--quiet", preexec_fn=limit_file_size)
    assert_one_error(run, DISK, "out.h5.part", "cannot write frame", "File too large", "free some space")
    assert (shot / "out.h5").read_bytes() == old
    with h5py.File(shot / "out.h5.part") as file:
        number = file["frames/number"][:]
        np.testing.assert_array_equal(file["frames/position"][:], positions(shot / "out.h5")[:len(number)])
    assert f"cannot write frame {len(number) + 1}" in run.err


def test_a_full_disk_is_said(shot):
    """On a disk of 128 KiB that only the program sees."""
    script = 'mount -t tmpfs -o size=128k none disk || exit 99; "$@"; code=$?; cp disk/* kept/ 2>/dev/null; exit $code'
    for folder in ("disk", "kept"):
        (shot / folder).mkdir()
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c", script, "sh"]
    if not shutil.which("unshare") or subprocess.run([*command, "true"], cwd=shot.folder, capture_output=True).returncode != 0:
        pytest.skip("no file system may be mounted here")
    write_hair(shot / "a.hair", hanging(strands=200))
    shot.scene('[cache]\ncompression = "none"\n', frames="1-40")
    run = subprocess.run([*command, PROGRAM, "bake", "scene.toml", "-o", "disk/out.h5", "--quiet"], cwd=shot.folder,
                         capture_output=True, text=True, check=False)
    assert run.returncode == DISK and run.stdout == ""
    assert "No space left on device" in run.stderr and len(run.stderr.splitlines()) == 1
    assert [p.name for p in (shot / "kept").iterdir()] == ["out.h5.part"]
    with h5py.File(shot / "kept/out.h5.part") as file:
        assert 0 < len(file["frames/number"]) < 40


# What it computes


def test_first_frame_and_preroll(shot, head):
    """Without pre-roll the first frame is the rest pose; with it, hair has hung there as long as that under a still head."""
    moving = head + "[[collider]]\nsphere = {center = [0.01, 1.55, 0], radius = 0.02}\nnode = \"Head\"\n"
    shot.scene(moving, frames="10-20")
    plain = read(shot.bake(out="plain.h5"))
    np.testing.assert_array_equal(plain["frames/position"][0], plain["rest/position"])
    assert (plain["frames/head"][0] == np.eye(4)).all() and (plain["frames/head"][-1] != np.eye(4)).any()
    np.testing.assert_array_equal(plain["stats/largest_stretch"][0] < 1e-5, True)

    rolled = read(shot.bake("--set", "bake.preroll=6", "--frames", "10", out="rolled.h5"))
    shot.scene(moving.replace(head, "").replace('node = "Head"\n', ""), frames="4-10", name="still.toml")
    still = read(shot.bake(scene="still.toml", out="still.h5"))
    np.testing.assert_array_equal(rolled["frames/position"][0], still["frames/position"][-1])
    assert (rolled["frames/position"][0] != rolled["rest/position"]).any()
    np.testing.assert_array_equal(rolled["frames/number"], [10])
    assert rolled["stats/deepest_penetration"][0] == still["stats/deepest_penetration"][-1]


@pytest.mark.parametrize("precision", ["float", "double"])
@pytest.mark.parametrize("still_head", [False, True])
def test_where_nothing_moves_every_frame_is_the_rest_pose(shot, head, precision, still_head):
    rng = np.random.default_rng(3)
    write_hair(shot / "a.hair", [np.cumsum(rng.normal(size=(n, 3), scale=0.01), axis=0) for n in (2, 3, 9, 32, 17, 9)])
    regions = "".join(f'[[region]]\nname = "r{m}"\nlocal = {{stiffness = 0.9, method = {m}}}\nstrands = {{range = "{r}"}}\n'
                      for m, r in ((1, "0-1"), (2, "2-3"), (3, "4"), (4, "5")))
    # The clip begins after the bake, so the head stands where it stood at rest, although nowhere near the origin.
    ride = head + "start = 100\n" if still_head else ""
    shot.scene(ride + "[forces]\ngravity = [0, 0, 0]\n" + regions, frames="1-6")
    settings = ["--set", f"solver.precision={precision}", "--set", "bake.preroll=2", "--set", "groom.translate=[0.1, 1.3, -0.7]"]
    settings += ["--set", "groom.space=head"] if still_head else []
    found = read(shot.bake(*settings))
    for frame in found["frames/position"]:
        np.testing.assert_allclose(frame, found["rest/position"], rtol=0, atol=5e-7)
    assert (found["frames/head"] == np.eye(4)).all()


def test_keyed_parameters_act_at_their_frames(shot):
    shot.scene("[forces]\ngravity = {3 = [0, 0, 0], 4 = [5, 0, 0], 5 = [0, 0, 0]}\n"
               '[[region]]\nname = "hair"\nglobal = {range = 1}\n', frames="1-6")
    found = read(shot.bake())
    frames, rest = found["frames/position"], found["rest/position"]
    for index in range(3):
        np.testing.assert_array_equal(frames[index], rest)
    assert frames[3][..., 0].max() > rest[..., 0].max()

    def same_until(key, value):
        changed = positions(shot.bake("--set", f"{key}={value}", "--force", out="changed.h5"))
        return next((n for n in range(6) if (changed[n] != frames[n]).any()), None)

    assert same_until("region[0].damping", "{4 = 0.1, 5 = 0.4}") == 4
    assert same_until("region[0].local.stiffness", "{5 = 0.5, 6 = 0.1}") == 5
    assert same_until("region[0].global.stiffness", '{4 = 0.1, "4.5" = 0.4}') == 4
    assert same_until("wind.velocity", "{4 = [0, 0, 0], 5 = [0, 0, 3]}") == 4
    assert same_until("region[0].damping", "{4 = 0.1, 7 = 0.1}") is None


def test_a_collider_stays_out_of_the_hair_that_it_meets(shot):
    shot.scene('[[collider]]\nsphere = {center = {1 = [0.2, 1.55, 0], 4 = [0.02, 1.55, 0]}, radius = 0.03}\n')
    found = read(shot.bake())
    frames = found["frames/position"]
    clear = np.linalg.norm(frames[3] - np.float32([0.02, 1.55, 0]), axis=-1).reshape(5, 6)[:, 2:].min()
    assert clear >= 0.03 - 1e-6  # float32 at 1.6
    np.testing.assert_allclose(found["stats/deepest_penetration"], 0, atol=1e-6)
    free = positions(shot.bake("--set", "collider[0].sphere.radius=0", out="free.h5"))
    assert (frames[0] == free[0]).all() and (frames[3] != free[3]).any()


def test_precision_rounds_positions_by_at_most_half_of_it(shot, head):
    write_hair(shot / "a.hair", hanging(strands=50, vertices=12))
    shot.scene(head, frames="1-12")
    exact = read(shot.bake("--set", "cache.velocity=true", out="exact.h5"))
    for precision in (1e-5, 1e-3, 2**-10):
        rounded = read(shot.bake("--set", f"cache.precision={precision}", "--set", "cache.velocity=true", "--force"))
        difference = rounded["frames/position"].astype(float) - exact["frames/position"]
        assert 0 < np.abs(difference).max() <= precision / 2
        step = 2.0 ** np.floor(np.log2(precision))
        in_steps = rounded["frames/position"].astype(float) / step
        np.testing.assert_array_equal(in_steps, np.rint(in_steps))
        for name in ("rest/position", "frames/velocity", "stats/largest_stretch"):  # what is simulated stays as it is
            np.testing.assert_array_equal(rounded[name], exact[name])
        assert h5py.File(shot / "out.h5")["frames/position"].attrs["precision"] == precision
    assert (shot / "out.h5").stat().st_size < (shot / "exact.h5").stat().st_size


def test_velocity_is_the_way_from_the_frame_before(shot):
    shot.scene("[cache]\nvelocity = true\n")
    found = read(shot.bake())
    frames, velocity = found["frames/position"], found["frames/velocity"]
    np.testing.assert_array_equal(velocity[0], 0)
    np.testing.assert_array_equal(velocity[1:], (frames[1:] - frames[:-1]) * np.float32(24))
    part = read(shot.bake("--frames", "3", out="part.h5"))
    np.testing.assert_array_equal(part["frames/velocity"][0], velocity[2])
    rolled = read(shot.bake("--set", "bake.preroll=3", out="rolled.h5"))
    longer = read(shot.bake("--set", "bake.frames=-2-4", out="longer.h5"))  # the head stands still in both
    np.testing.assert_array_equal(rolled["frames/velocity"], longer["frames/velocity"][3:])


def test_time_and_frame_rate(shot):
    found = read(shot.bake(scene=shot.scene(frames="-2-1")))
    np.testing.assert_array_equal(found["frames/number"], [-2, -1, 0, 1])
    np.testing.assert_array_equal(found["frames/time"], np.array([-2, -1, 0, 1]) / 24)


def test_the_demo_scene_bakes(shot):
    """The groom of scripts/demo.sh, with fewer strands."""
    made = shot.run("groom", "--style", "wavy", "--strands", "300", "--vertices", "24", "--seed", "7", "-o", "demo.hair")
    assert made.code == GOOD
    cache = shot.bake("--search", shot.folder, "--frames", "1-12", scene=SOURCE / "scenes/demo.toml")
    found = read(cache)
    assert found["frames/position"].shape == (12, 300 * 24, 3)
    assert np.isfinite(found["frames/position"]).all()
    assert (found["frames/head"][-1] != np.eye(4)).any()
    assert set(found["provenance/inputs/name"].astype(str)) == {"demo.hair", "demo_head.gltf"}
