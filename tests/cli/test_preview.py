"""preview: what is in a cache, in pictures."""

import os
import shutil
import signal
import struct
import subprocess

import h5py
import numpy as np
import pytest
from conftest import DISK, GOOD, INPUT, INTERRUPTED, USAGE, assert_one_error, cut, hanging, write_hair

Image = pytest.importorskip("PIL.Image")

SCENE = '''[[region]]
name = "left"
strands = {range = "0-1"}
[[region]]
name = "right"
[[collider]]
sphere = {center = [0.01, 1.53, 0.005], radius = 0.02}
[cache]
precision = 1e-5
'''


@pytest.fixture
def cache(shot):
    return shot.bake(scene=shot.scene(SCENE))


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def png_size(path):
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n" and data[-8:-4] == b"IEND"
    return struct.unpack(">II", data[16:24])


def change(cache, name, edit):
    """A copy with something else in it."""
    copy = cache.with_name(name)
    shutil.copy(cache, copy)
    with h5py.File(copy, "r+") as file:
        edit(file)
    return copy


# Sheets


def test_a_sheet_has_all_frames(shot, cache):
    run = shot.run("preview", "out.h5", "-o", "out.png", "--size", "48x40")
    assert run.code == GOOD and run.err == "" and run.out.startswith("out.png: 4 frames of 48 x 40, ")
    width, height = png_size(shot / "out.png")
    assert width >= 96 and height >= 40
    assert shot.files() == ["a.hair", "out.h5", "out.png", "scene.toml"]


def test_the_picture_is_the_same_on_any_number_of_threads(shot, cache):
    for name, threads in (("one.png", "1"), ("three.png", "3")):
        for color in ("region", "speed"):
            run = shot.run("preview", "out.h5", "-o", f"{color}-{name}", "--color", color, env={"OMP_NUM_THREADS": threads})
            assert run.code == GOOD, run.err
    for color in ("region", "speed"):
        assert (shot / f"{color}-one.png").read_bytes() == (shot / f"{color}-three.png").read_bytes()


def test_frames_are_chosen(shot, cache):
    for options, count in ((["--count", "2"], 2), (["--frames", "2-3"], 2), (["--frames", "4"], 1), (["--frames", "3-100"], 2),
                           (["--every", "3"], 2), (["--frames", "2-4", "--every", "2"], 2)):
        run = shot.run("preview", "out.h5", "-o", "out.png", "--size", "32x32", "--force", *options)
        assert run.code == GOOD and run.out.startswith(f"out.png: {count} frame")
    assert_one_error(shot.run("preview", "out.h5", "-o", "new.png", "--frames", "7-9"), INPUT, "out.h5", "7-9")


def test_an_unfinished_cache_is_drawn(shot, cache):
    cut(cache, "out.h5.part", 2)
    assert shot.run("preview", "out.h5.part", "-o", "out.png", "--size", "32x32").out.startswith("out.png: 2 frames")
    cut(cache, "none.part", 0)
    assert_one_error(shot.run("preview", "none.part", "-o", "none.png"), INPUT, "none.part", "no frame")


def test_each_view_is_another_picture(shot, cache):
    pictures = set()
    views = [[], ["--azimuth", "120"], ["--elevation", "62.5"], ["--fov", "60.5"], ["--from", "0,1.6,1"],
             ["--from", "0,1.6,1", "--look-at", "0.1,1.5,0"], ["--hair-only"]]
    for options in views:
        assert shot.run("preview", "out.h5", "-o", "out.png", "--size", "64x64", "--count", "1", "--force", *options).code == GOOD
        pictures.add((shot / "out.png").read_bytes())
    assert len(pictures) == len(views)


def test_a_collider_is_drawn_where_it_is(shot, cache):
    """From straight in front, 0.2 m away, 60 degrees wide: the sphere of 0.02 m is in the middle, 35 pixels in radius."""
    view = ["--count", "1", "--size", "400x400", "--from", "0.01,1.53,0.205", "--look-at", "0.01,1.53,0", "--fov", "60"]
    assert shot.run("preview", "out.h5", "-o", "with.png", *view).code == GOOD
    assert shot.run("preview", "out.h5", "-o", "without.png", "--hair-only", *view).code == GOOD
    differs = (np.abs(pixels(shot / "with.png") - pixels(shot / "without.png")).max(axis=2) > 10)[-404:-4, 4:404]
    rows, columns = np.nonzero(differs)
    radius = 200 / np.tan(np.radians(30)) * 0.02 * 0.98 / 0.2
    assert abs(rows.mean() - 200) < 5 and abs(columns.mean() - 200) < 2
    assert len(rows) == pytest.approx(np.pi * radius**2, rel=0.12)  # some of the hair in its shade with it


def test_the_camera_can_follow_the_head(shot, head):
    """A groom that rides a head which walks away: in place in each picture, or ever smaller in a common one."""
    cache = shot.bake(scene=shot.scene("[[region]]\nname = 'a'\nsimulate = false\n" + head, frames="1-3"))
    with h5py.File(cache, "r+") as file:
        for frame in range(3):
            file["frames/position"][frame] = file["rest/position"][:] + [4 * frame, 0, 0]
            matrix = np.eye(4)
            matrix[0, 3] = 4 * frame
            file["frames/head"][frame] = matrix
    view = ["--size", "100x100", "--hair-only", "--frames", "1-2"]
    assert shot.run("preview", "out.h5", "-o", "follow.png", "--follow", *view).code == GOOD
    assert shot.run("preview", "out.h5", "-o", "stay.png", *view).code == GOOD
    sheet = pixels(shot / "follow.png")
    first, second = (sheet[-104:-30, x:x + 100] for x in (4, 108))
    assert np.abs(first - second).max() <= 30 and np.ptp(first) > 60  # the same but for rounding
    stay = pixels(shot / "stay.png")
    assert np.abs(stay[-104:-30, 4:104] - stay[-104:-30, 108:208]).max() > 2


# Colours


def test_errors_are_red_where_the_caches_differ(shot, cache):
    def move(file):
        positions = file["frames/position"][:]
        positions[1:, 24:] += [0, 0, 0.01]  # the last strand
        file["frames/position"][:] = positions

    change(cache, "moved.h5", move)
    view = ["--color", "error", "--against", "out.h5", "--hair-only", "--size", "200x200", "--from", "0.02,1.55,0.3"]
    run = shot.run("preview", "moved.h5", "-o", "error.png", "--frames", "2", *view)
    assert run.code == GOOD and run.err == ""
    tile = pixels(shot / "error.png")[-200:-4, 4:204]
    red = (tile[..., 0] > 1.6 * tile[..., 1]) & (tile[..., 0] > 1.6 * tile[..., 2]) & (tile[..., 0] > 60)
    blue = (tile[..., 2] > 1.6 * tile[..., 0]) & (tile[..., 2] > 60)
    assert red.sum() > 50 and blue.sum() > 50
    assert np.nonzero(red)[1].min() > np.nonzero(blue)[1].max()  # the last strand is the rightmost
    again = shot.run("preview", "moved.h5", "-o", "same.png", "--frames", "1", *view)
    assert again.code == GOOD
    first = pixels(shot / "same.png")[-200:-4, 4:204]
    assert not ((first[..., 0] > 1.6 * first[..., 1]) & (first[..., 0] > 60)).any()


def test_speed_and_stretch_have_colours_of_their_own(shot, cache):
    pictures = set()
    for options in (["region"], ["stretch"], ["speed"], ["speed", "--scale", "100"], ["stretch", "--scale", "1e-7"]):
        assert shot.run("preview", "out.h5", "-o", "out.png", "--force", "--size", "64x64", "--color", *options).code == GOOD
        pictures.add((shot / "out.png").read_bytes())
    assert len(pictures) == 5
    with_velocity = shot.bake(out="v.h5", scene=shot.scene(SCENE + "velocity = true\n", name="v.toml"))
    assert shot.run("preview", with_velocity, "-o", "v.png", "--color", "speed", "--size", "64x64").code == GOOD


def test_an_unfit_golden_cache_is_refused(shot, cache):
    write_hair(shot / "b.hair", hanging(4))
    shot.bake(scene=shot.scene(name="b.toml", files='["b.hair"]'), out="b.h5")
    cut(cache, "two.part", 2)
    show = ["preview", "out.h5", "-o", "out.png", "--color", "error"]
    assert_one_error(shot.run(*show, "--against", "b.h5"), INPUT, "b.h5", "4 strands")
    assert_one_error(shot.run(*show, "--against", "two.part"), INPUT, "two.part", "no frame 3")
    assert_one_error(shot.run(*show, "--against", "none.h5"), INPUT, "none.h5")
    assert_one_error(shot.run(*show), USAGE, "--against")
    assert_one_error(shot.run("preview", "out.h5", "-o", "out.png", "--against", "out.h5"), USAGE, "--color error")
    assert not (shot / "out.png").exists()


# Clips


def test_a_gif_plays_in_time(shot, cache):
    run = shot.run("preview", "out.h5", "-o", "out.gif", "--size", "64x48")
    assert run.code == GOOD and run.out.startswith("out.gif: 4 frames of 64 x 48, ")
    with Image.open(shot / "out.gif") as gif:
        assert gif.n_frames == 4 and gif.size == (64, 48) and gif.info["loop"] == 0
        durations = []
        for frame in range(4):
            gif.seek(frame)
            durations.append(gif.info["duration"])
        assert sum(durations) == 170  # 4 frames at 24 a second, in hundredths
        last = np.asarray(gif.convert("RGB")).astype(int)
    # As the sheet has it, but for 255 colours.
    assert shot.run("preview", "out.h5", "-o", "out.mp4.png", "--size", "64x48").code == GOOD
    tile = pixels(shot / "out.mp4.png")[-52:-4, -68:-4]
    assert np.abs(last - tile)[:36].mean() < 3


def test_a_gif_of_many_frames_a_second_leaves_some_out(shot):
    shot.bake(scene=shot.scene(frames="1-6"), out="fast.h5")
    with h5py.File(shot / "fast.h5", "r+") as file:
        file.attrs.modify("fps", np.float64(120))
    run = shot.run("preview", "fast.h5", "-o", "out.gif", "--size", "64x48")
    assert run.code == GOOD and run.out.startswith("out.gif: 2 frames")


@pytest.mark.skipif(shutil.which("ffmpeg") is None or shutil.which("ffprobe") is None, reason="needs ffmpeg")
def test_an_mp4_opens_in_ffmpeg(shot, cache):
    name = "-of: frames.mp4"  # what ffmpeg could take for an option or a protocol
    run = shot.run("preview", "out.h5", f"-o{name}", "--size", "64x48")
    assert run.code == GOOD, run.err
    probe = subprocess.run(["ffprobe", "-v", "error", "-count_frames", "-show_entries",
                            "stream=codec_name,width,height,r_frame_rate,nb_read_frames,pix_fmt", "-of", "csv=p=0",
                            f"file:{shot / name}"], check=True, capture_output=True, text=True)
    assert probe.stdout.strip() == "h264,64,48,yuv420p,24/1,4"
    assert_one_error(shot.run("preview", "out.h5", "-o", "odd.mp4", "--size", "65x48"), USAGE, "65x48", "even")
    assert_one_error(shot.run("preview", "out.h5", "-o", "none/a.mp4"), DISK, "none/a.mp4")
    assert shot.files() == [name, "a.hair", "out.h5", "scene.toml"]


def test_without_ffmpeg_or_with_one_that_fails_nothing_is_left(shot, cache):
    tools = shot / "tools"
    tools.mkdir()
    assert_one_error(shot.run("preview", "out.h5", "-o", "out.mp4", env={"PATH": str(tools)}), DISK, "out.mp4", "ffmpeg", "not installed")
    (tools / "ffmpeg").write_text('#!/bin/sh\necho "Unknown encoder" >&2\nexit 1\n')
    (tools / "ffmpeg").chmod(0o755)
    run = shot.run("preview", "out.h5", "-o", "out.mp4", "--size", "640x480", env={"PATH": f"{tools}:{os.environ['PATH']}"})
    assert run.code == DISK and run.err.splitlines()[-1].endswith("out.mp4: ffmpeg cannot write the MP4: Unknown encoder")
    assert shot.files() == ["a.hair", "out.h5", "scene.toml", "tools"]


@pytest.mark.parametrize("name", ["out.gif", "out.mp4"])
def test_an_interrupted_clip_leaves_nothing(shot, cache, name):
    if name == "out.mp4" and shutil.which("ffmpeg") is None:
        pytest.skip("needs ffmpeg")
    with h5py.File(cache, "r+") as file:
        for group in (file["frames"], file["stats"]):
            for item in group.values():
                item.resize(3000, axis=0)
                item[4:] = item[3]
        file["frames/number"][:] = np.arange(3000)
    process = shot.start("preview", "out.h5", "-o", name, "--size", "640x480", stderr=subprocess.PIPE)
    while not list(shot.folder.glob(f"{name}.*.part")):
        assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == INTERRUPTED and "interrupted" in err.splitlines()[-1]
    assert shot.files() == ["a.hair", "out.h5", "scene.toml"]


# Wrong input


def test_numbers_that_are_not_finite_are_left_out_and_said(shot, cache):
    def spoil(file):
        positions = file["frames/position"][:]
        positions[2, 3] = np.nan
        positions[3, 8] = [0, 3e8, 0]
        file["frames/position"][:] = positions
        file["frames/head"][1] = np.nan
        file["frames/collider"][1] = np.nan
        file["frames/collider"][2] = [0, 0, 0, -1]

    change(cache, "nan.h5", spoil)
    for color in (["region"], ["stretch"], ["speed"], ["error", "--against", "out.h5"]):
        run = shot.run("preview", "nan.h5", "-o", "out.png", "--force", "--size", "64x64", "--color", *color)
        assert run.code == GOOD, run.err
        assert run.err == ("strandbake: warning: nan.h5: frame 3: 1 strand is not drawn: there are vertices that are not finite, or "
                           "over 1000 km away\n")
    run = shot.run("preview", "out.h5", "-o", "out.png", "--force", "--size", "64x64", "--color", "error", "--against", "nan.h5")
    assert run.code == GOOD and run.err == ""
    assert_one_error(shot.run("preview", "nan.h5", "-o", "new.png", "--frames", "2", "--follow"), INPUT, "nan.h5", "frame 2", "--follow")


def test_a_damaged_chunk_is_said(shot, cache):
    with h5py.File(cache) as file:
        chunk = file["frames/position"].id.get_chunk_info(2)
    data = bytearray(cache.read_bytes())
    data[chunk.byte_offset + 4:chunk.byte_offset + 20] = bytes(16)
    (shot / "bad.h5").write_bytes(data)
    for name in ("bad.png", "bad.gif"):
        assert_one_error(shot.run("preview", "bad.h5", "-o", name), INPUT, "bad.h5", "damaged", "/frames/position")
        assert not (shot / name).exists() and not list(shot.folder.glob(f"{name}*.part"))


def test_nothing_is_overwritten_and_what_cannot_be_written_is_said(shot, cache):
    (shot / "old.png").write_text("old")
    assert_one_error(shot.run("preview", "out.h5", "-o", "old.png"), DISK, "old.png", "--force")
    assert (shot / "old.png").read_text() == "old"
    for name in ("none/out.png", "none/out.gif"):
        assert_one_error(shot.run("preview", "out.h5", "-o", name, "--size", "32x32"), DISK, name)
    assert shot.run("preview", "out.h5").code == shot.run("preview", "-o", "new.png").code == USAGE
    for option, value in (("--size", "3x3"), ("--size", "64"), ("--size", "64x"), ("--size", "9000x64"), ("--frames", "x"),
                          ("--frames", "3-1"), ("--count", "0"), ("--every", "0"), ("--elevation", "100"), ("--fov", "0"),
                          ("--from", "1,2"), ("--from", "1,2,x"), ("--from", "nan,0,0"), ("--look-at", "1,2,3"), ("--color", "blue"),
                          ("--scale", "0"), ("--scale", "nan"), ("--azimuth", "nan"), ("--azimuth", "inf"), ("--fov", "12x"), ("-o", "new.bmp"), ("-o", "new")):
        words = ["preview", "out.h5", option, value] + ([] if option == "-o" else ["-o", "new.png"])
        assert shot.run(*words).code == USAGE, words
    assert shot.run("preview", "out.h5", "-o", "new.png", "--from", "0,0,1", "--azimuth", "3").code == USAGE
    assert_one_error(shot.run("preview", "out.h5", "-o", "new.gif", "--count", "2"), USAGE, "--every")
    os.mkfifo(shot / "pipe.png")
    assert_one_error(shot.run("preview", "out.h5", "-o", "pipe.png", "--force"), DISK, "pipe.png", "a pipe")
    (shot / "pipe.png").unlink()
    assert_one_error(shot.run("preview", "out.h5", "-o", "new.png", "--size", "8192x8192"), USAGE, "4 pictures")
    assert shot.files() == ["a.hair", "old.png", "out.h5", "scene.toml"]
