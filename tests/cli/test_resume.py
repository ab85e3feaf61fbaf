"""Nothing is lost: bakes that are killed, interrupted or run out of disk go on with --resume, to the bytes of a bake that ran in
one go.

STRANDBAKE_KILLS says how often a bake is killed at random.
"""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import time

import h5py
import numpy as np
import pytest
from conftest import (DISK, ENVIRONMENT, GOOD, INPUT, INTERRUPTED, INVALID, PROGRAM, USAGE, assert_one_error, hanging, positions, read,
                      write_hair)
from test_bake import STRETCHY, limit_file_size
from test_same_bytes import available_lanes

KILLS = int(os.environ.get("STRANDBAKE_KILLS", "200"))

# Whatever lasts from frame to frame: every method, frames that are kept, pins, hair that rides, wind, velocities, a pre-roll.
SCENE = '''[bake]
frames = "1-24"
substeps = "auto"
preroll = 3
[groom]
files = ["a.hair"]
[head]
animation = "head.gltf"
node = "Head"
[wind]
velocity = [1, 0, 2]
gust = 0.5
[[collider]]
sphere = {center = [0.02, 1.53, 0.01], radius = 0.02}
[[region]]
name = "exact"
strands = {range = "0-9"}
lengths = {iterations = 2}
[[region]]
name = "lagged"
strands = {range = "10-19"}
local = {method = 2}
[[region]]
name = "turned"
strands = {range = "20-24"}
local = {method = 3}
[[region]]
name = "scanned"
strands = {range = "25-34"}
local = {method = 4}
sag_free = true
[[region]]
name = "ridden"
strands = {range = "35-37"}
simulate = false
[[region]]
name = "supported"
local = {method = 2}
sag_free = true
[cache]
velocity = true
precision = 1e-6
'''


@pytest.fixture
def scene(shot, head):
    """The scene, and the cache of a bake of it that nothing disturbed, as whole.h5."""
    rng = np.random.default_rng(5)
    write_hair(shot / "a.hair", [hanging(1, 2 + k % 9)[0] + rng.normal(size=3) * 0.02 for k in range(45)])
    (shot / "scene.toml").write_text(SCENE)
    shot.bake("--quiet", out="whole.h5")
    return shot


def interrupt(shot, frame, *arguments):
    """A bake that ends with SIGINT after a frame."""
    process = shot.start("bake", "scene.toml", "-o", "out.h5", "--json", *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for line in process.stdout:
        if json.loads(line).get("frame") == frame:
            break
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=100)
    assert process.returncode in (INTERRUPTED, GOOD)
    return process.returncode


def stopped(shot, *arguments, frame=8):
    """A .part of at least so many frames but not of all; the frame of the state beside it is one of them."""
    for _ in range(20):
        if interrupt(shot, frame, *arguments) == INTERRUPTED:
            assert shot.files() != []
            return
        (shot / "out.h5").unlink()
    pytest.skip("the bake is too fast to be interrupted")


def resume(shot, *arguments):
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--resume", "--json", *arguments)
    assert run.code == GOOD, run.err
    start = json.loads(run.out.splitlines()[0])
    assert (shot / "out.h5").read_bytes() == (shot / "whole.h5").read_bytes()
    assert not [name for name in shot.files() if "part" in name]
    return start


def test_a_bake_killed_at_any_moment_goes_on_to_the_same_bytes(scene):
    chance = random.Random(7)
    whole = read(scene / "whole.h5")
    start = time.monotonic()
    scene.bake("--quiet", out="timed.h5")
    longest = time.monotonic() - start
    part, out = scene / "out.h5.part", scene / "out.h5"
    kills = resumed = loaded = early = 0
    while kills < KILLS:
        # A state after every frame in one half of the runs, hardly any in the other.
        checkpoint = chance.choice(["1e-6", "1"])
        process = scene.start("bake", "scene.toml", "-o", "out.h5", "--resume", "--json", "--checkpoint", checkpoint, "--threads",
                              chance.choice("12"), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            process.wait(chance.uniform(0, longest))
        except subprocess.TimeoutExpired:
            process.kill()
            kills += 1
        output, errors = process.communicate()
        told = [json.loads(line) for line in output.splitlines() if line.endswith("}")]
        early = early + 1 if process.returncode == -signal.SIGKILL and not told else 0
        if early == 5:  # in a row before a bake has begun: the machine has more to do than when it was timed
            longest, early = longest * 1.5, 0
        resumed += bool(told and told[0]["event"] == "start" and told[0]["kept_frames"] > 0)
        loaded += bool(told and told[0]["event"] == "start" and told[0]["kept_frames"] > 0 and told[0]["simulated_from"] > -2)
        if out.exists():
            assert out.read_bytes() == (scene / "whole.h5").read_bytes()
            out.unlink()
            assert not part.exists()
        else:
            assert process.returncode == -signal.SIGKILL, errors
            if part.exists() and part.read_bytes()[:4].strip(b"\0"):  # else it was killed before the file began
                with h5py.File(part) as file:
                    number = file["frames/number"][:]
                    np.testing.assert_array_equal(number, range(1, len(number) + 1))
                    np.testing.assert_array_equal(file["frames/position"][:len(number)], whole["frames/position"][:len(number)])
                    np.testing.assert_array_equal(file["frames/velocity"][:len(number)], whole["frames/velocity"][:len(number)])
                assert len(number) >= max([event["frame"] for event in told if event["event"] == "frame"], default=0)
            else:
                assert not any(event["event"] == "frame" for event in told)
    assert resumed > KILLS / 20 and loaded > 0
    if part.exists():
        resume(scene)


@pytest.mark.parametrize("state", ["state", "none", "damaged", "another"])
def test_a_bake_goes_on_from_the_state_or_from_the_start(scene, state):
    stopped(scene, *(["--checkpoint", "0"] if state == "none" else []))
    kept = len(read(scene / "out.h5.part")["frames/number"])
    file = scene / "out.h5.part.state"
    assert file.exists() == (state != "none")
    if state == "damaged":
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
    elif state == "another":  # of a plan that nothing is left out of
        shutil.copy(file, scene / "kept")
        (scene / "out.h5.part").rename(scene / "kept.part")
        stopped(scene, "--force", "--no-skip", "regions,passes")
        (scene / "kept.part").rename(scene / "out.h5.part")
    quiet = scene.run("bake", "scene.toml", "-o", "out.h5", "--resume", "--frames", "1-24")
    assert quiet.code == GOOD and (scene / "out.h5").read_bytes() == (scene / "whole.h5").read_bytes()
    if state == "state":
        assert f"resuming after frame {kept}, from the state after frame {kept}\n" in quiet.err
    else:
        assert f"resuming after frame {kept}: simulating from frame -2 on again, as no state was kept\n" in quiet.err


def test_a_state_is_good_for_any_threads_and_lanes(scene):
    stopped(scene, "--lanes", "4", "--threads", "3")
    kept = [(scene / name, (scene / name).read_bytes()) for name in scene.files() if "part" in name]
    for lanes in available_lanes(scene):
        for path, content in kept:
            path.write_bytes(content)
        start = resume(scene, "--lanes", lanes, "--threads", "2")
        assert start["kept_frames"] > 0 and start["simulated_from"] == start["kept_frames"]
        (scene / "out.h5").unlink()


def test_double_precision_goes_on_too(scene):
    settings = ["--set", "solver.precision=double"]
    scene.bake("--quiet", "--force", *settings, out="whole.h5")
    stopped(scene, "--lanes", "4", *settings)
    assert resume(scene, *settings)["simulated_from"] > 0


def test_a_stop_before_the_first_frame_costs_nothing(scene):
    """As long as a state was kept; frames 20 to 24 grow out of those before."""
    scene.bake("--frames", "20-24", "--force", "--quiet", out="whole.h5")
    process = scene.start("bake", "scene.toml", "-o", "out.h5", "--frames", "20-24", "--checkpoint", "1e-6", stderr=subprocess.DEVNULL)
    state = scene / "out.h5.part.state"
    kept = set()  # files that have been the state: the first is where hair starts, which is as good as none
    while process.poll() is None and len(kept) < 2:
        with contextlib.suppress(FileNotFoundError):
            kept.add(state.stat().st_mtime_ns)
    process.kill()
    process.wait()
    if not (scene / "out.h5").exists():
        assert resume(scene, "--frames", "20-24")["simulated_from"] > -2


def test_without_a_part_a_bake_starts_at_the_beginning(scene):
    assert resume(scene)["kept_frames"] == 0
    assert_one_error(scene.run("bake", "scene.toml", "-o", "out.h5", "--resume"), DISK, "out.h5", "--force")
    (scene / "out.h5").unlink()
    (scene / "out.h5.part").write_bytes(bytes(3000))  # killed before the first frame
    assert resume(scene)["kept_frames"] == 0


def test_a_part_with_every_frame_is_only_finished(scene):
    shutil.copy(scene / "whole.h5", scene / "out.h5.part")  # killed before it was renamed
    run = scene.run("bake", "scene.toml", "-o", "out.h5", "--resume")
    assert run.code == GOOD and "resuming after frame 24: no frame is left\n" in run.err
    assert (scene / "out.h5").read_bytes() == (scene / "whole.h5").read_bytes()


def test_an_unfinished_bake_is_not_replaced_unless_told_to(scene):
    stopped(scene)
    assert_one_error(scene.run("bake", "scene.toml", "-o", "out.h5"), DISK, "out.h5.part", "--resume goes on with it")
    run = scene.run("bake", "scene.toml", "-o", "out.h5", "--force")
    assert run.code == GOOD and (scene / "out.h5").read_bytes() == (scene / "whole.h5").read_bytes()
    assert not [name for name in scene.files() if "part" in name]


# Refused


def assert_refused(scene, words, *arguments):
    before = (scene / "out.h5.part").read_bytes()
    run = scene.run("bake", "scene.toml", "-o", "out.h5", "--resume", "--quiet", *arguments)
    assert_one_error(run, INPUT, "out.h5.part: cannot be resumed: " + words, "--force starts anew")
    assert (scene / "out.h5.part").read_bytes() == before


def test_another_scene_input_or_version_is_refused_with_the_reason(scene):
    stopped(scene)
    assert_refused(scene, "bake.preroll was 3, and is 4 now", "--set", "bake.preroll=4")
    assert_refused(scene, 'bake.frames was "1-24", and is "1-30" now', "--set", "bake.frames=1-30")
    assert_refused(scene, "it holds frames 1 to ", "--frames", "2-24")
    assert_refused(scene, "it holds frames 1 to ", "--frames", "1-3")
    part = (scene / "out.h5.part").read_bytes()
    shutil.copy(scene / "whole.h5", scene / "out.h5.part")  # killed before it was renamed
    assert_refused(scene, "it holds frames 1 to 24", "--frames", "1-3")
    (scene / "out.h5.part").write_bytes(part)
    (scene / "scene.toml").write_text(SCENE + "# a remark\n")
    assert_refused(scene, "the text of the scene was another")
    (scene / "scene.toml").write_text(SCENE)
    hair = (scene / "a.hair").read_bytes()
    (scene / "a.hair").write_bytes(hair[:-1] + b"\x01")
    assert_refused(scene, "the input a.hair has changed")
    (scene / "a.hair").write_bytes(hair)
    with h5py.File(scene / "out.h5.part", "r+") as file:
        version = file["provenance"].attrs["version"]
        file["provenance"].attrs.modify("version", np.bytes_(version.replace(b"0.1", b"9.9")))
    assert_refused(scene, "the version was 9.9")


def test_a_part_of_other_numbers_is_refused(scene):
    """As one that was begun on a device whose division is not exact."""
    scene.bake("--quiet", "--force", "--set", "cache.compression=none", out="whole.h5")
    stopped(scene, "--set", "cache.compression=none")
    with h5py.File(scene / "out.h5.part", "r+") as file:
        last = len(file["frames/number"]) - 1
        place = file["frames/position"].id.get_chunk_info(last)
    content = bytearray((scene / "out.h5.part").read_bytes())
    content[place.byte_offset + 101] ^= 0x10
    (scene / "out.h5.part").write_bytes(content)
    run = scene.run("bake", "scene.toml", "-o", "out.h5", "--resume", "--quiet", "--set", "cache.compression=none")
    assert_one_error(run, INPUT, f"frame {last + 1} of the .part is not what is baked here")
    assert (scene / "out.h5.part").exists()


def test_what_is_no_part_is_refused(scene):
    for content in (b"What is this?" * 300, (scene / "whole.h5").read_bytes()[:9000]):
        (scene / "out.h5.part").write_bytes(content)
        assert_refused(scene, "is ")


def test_a_part_beyond_a_limit_is_not_gone_on_with(shot):
    shot.scene(STRETCHY, frames="1-12")
    limit = ["--fail-on", "stretch=0.01"]
    first = shot.run("bake", "scene.toml", "-o", "out.h5", "--quiet", *limit)
    again = shot.run("bake", "scene.toml", "-o", "out.h5", "--quiet", "--resume", *limit)
    assert first.code == again.code == INVALID and first.err == again.err
    whole = shot.bake(out="whole.h5")
    assert shot.run("bake", "scene.toml", "-o", "out.h5", "--resume").code == GOOD
    assert (shot / "out.h5").read_bytes() == whole.read_bytes()


def test_a_part_without_figures_cannot_be_judged(shot):
    shot.scene(STRETCHY + "[cache]\nstats = false\n", frames="1-12")
    limit = ["--fail-on", "stretch=0.01"]
    assert shot.run("bake", "scene.toml", "-o", "out.h5", "--quiet", *limit).code == INVALID
    before = (shot / "out.h5.part").read_bytes()
    assert_one_error(shot.run("bake", "scene.toml", "-o", "out.h5", "--quiet", "--resume", *limit), INPUT, "out.h5.part",
                     "no figures for --fail-on", "--force starts anew")
    assert (shot / "out.h5.part").read_bytes() == before


# Disks and other programs


def test_a_bake_goes_on_after_a_full_disk(shot):
    write_hair(shot / "a.hair", hanging(strands=200))
    whole = shot.bake(scene=shot.scene('[cache]\ncompression = "none"\n', frames="1-40"), out="whole.h5")
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--quiet", preexec_fn=limit_file_size)
    assert_one_error(run, DISK, "out.h5.part", "cannot write frame")
    run = shot.run("bake", "scene.toml", "-o", "out.h5", "--resume")
    assert run.code == GOOD and "resuming after frame " in run.err
    assert (shot / "out.h5").read_bytes() == whole.read_bytes()


def test_a_full_disk_keeps_a_bake_that_goes_on_readable(shot):
    """On a disk of 200 KiB that only the program sees: full, again, and then with room."""
    script = ("mount -t tmpfs -o size=200k none disk || exit 99; "
              '"$@"; test $? = 5 || exit 1; "$@" --resume; test $? = 5 || exit 2; cp disk/out.h5.part kept/; '
              'mount -o remount,size=9m disk || exit 99; "$@" --resume; code=$?; cp disk/* kept/; exit $code')
    for folder in ("disk", "kept"):
        (shot / folder).mkdir()
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c"]
    probe = subprocess.run([*command, "mount -t tmpfs -o size=1m none disk && mount -o remount,size=2m disk"], cwd=shot.folder,
                           capture_output=True, check=False) if shutil.which("unshare") else None
    if probe is None or probe.returncode != 0:
        pytest.skip("no file system may be mounted here")
    write_hair(shot / "a.hair", hanging(strands=200))
    whole = shot.bake(scene=shot.scene('[cache]\ncompression = "none"\n', frames="1-40"), out="whole.h5")
    run = subprocess.run([*command, script, "sh", PROGRAM, "bake", "scene.toml", "-o", "disk/out.h5", "--quiet", "--checkpoint", "1e-6"],
                         cwd=shot.folder, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert run.returncode == GOOD, run.stderr
    assert run.stderr.count("No space left on device; free some space") == 2
    number = read(shot / "kept/out.h5.part")["frames/number"]
    assert 0 < len(number) < 40
    np.testing.assert_array_equal(positions(shot / "kept/out.h5.part")[:len(number)], positions(whole)[:len(number)])
    assert (shot / "kept/out.h5").read_bytes() == whole.read_bytes()


def start_long(shot, *arguments):
    shot.scene(frames="1-1000000")
    events = shot / "events.jsonl"  # a pipe that nobody reads would hold the bake
    with events.open("w") as out:
        process = shot.start("bake", "scene.toml", "-o", "out.h5", "--json", *arguments, stdout=out, stderr=subprocess.PIPE)
    while events.read_text().count('"event":"frame"') < 3:
        assert process.poll() is None, process.stderr.read()
    return process


@pytest.mark.parametrize("deed", ["removed", "replaced"])
def test_a_part_that_somebody_takes_away_is_said(shot, deed):
    process = start_long(shot)
    (shot / "out.h5.part").unlink()
    if deed == "replaced":
        (shot / "out.h5.part").write_text("mine")
    _, errors = process.communicate(timeout=100)
    assert process.returncode == DISK
    assert errors == "strandbake: error: out.h5.part: was removed or replaced while it was written; bake again\n"
    assert deed == "removed" or (shot / "out.h5.part").read_text() == "mine"


def test_a_bake_that_is_still_running_is_not_resumed(shot):
    process = start_long(shot)
    second = shot.run("bake", "scene.toml", "-o", "out.h5", "--resume", "--quiet")
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=100)
    assert_one_error(second, DISK, "out.h5.part", "written by another program")
    assert process.returncode == INTERRUPTED
    assert len(read(shot / "out.h5.part")["frames/number"]) >= 3


def test_info_follows_a_bake_that_is_running(shot):
    process = start_long(shot)
    seen = []
    for _ in range(30):
        run = shot.run("info", "out.h5.part", "--json")
        assert run.code == GOOD, run.err
        seen.append(json.loads(run.out)["frames"])
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=100)
    assert 3 <= seen[0] and seen == sorted(seen) and seen[-1] > seen[0]


@pytest.mark.parametrize("arguments", [["--checkpoint", "-1"], ["--checkpoint", "often"], ["--resume", "yes"]])
def test_a_command_line_without_sense_ends_with_2(shot, arguments):
    assert shot.run("bake", shot.scene(), *arguments).code == USAGE
