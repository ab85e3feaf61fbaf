"""groom: hair made from a few numbers, and grooms converted to .hair."""

import hashlib
import os
import struct
import subprocess
import sys

import numpy as np
import pytest
from conftest import DISK, GOOD, INPUT, SOURCE, USAGE, assert_one_error, hanging, read, write_tfx3

SMALL = ["--strands", "40", "--vertices", "8"]


def read_hair(path):
    """Vertex counts and points of a .hair file that has both and nothing else."""
    data = path.read_bytes()
    magic, strands, points, flags = struct.unpack_from("<4s3I", data)
    assert magic == b"HAIR" and flags == 3 and len(data) == 128 + 2 * strands + 12 * points
    counts = np.frombuffer(data, "<u2", strands, 128).astype(int) + 1
    assert counts.sum() == points
    return counts, np.frombuffer(data, "<f4", 3 * points, 128 + 2 * strands).reshape(-1, 3)


@pytest.mark.parametrize("style", ["straight", "wavy", "curly", "ponytail", "fur"])
def test_each_style_makes_hair_that_bakes(shot, style):
    run = shot.run("groom", "--style", style, *SMALL, "-o", "made.hair")
    assert run.code == GOOD and run.err == "" and run.out == "made.hair: 40 strands, 320 vertices\n"
    counts, points = read_hair(shot / "made.hair")
    assert (counts == 8).all() and np.isfinite(points).all()
    assert np.linalg.norm(points, axis=1).min() > 0.0999  # outside the head
    found = read(shot.bake(scene=shot.scene(files='["made.hair"]', frames="1-3")))
    assert np.isfinite(found["frames/position"]).all()
    np.testing.assert_array_equal(found["rest/position"], points)


def test_the_same_seed_makes_the_same_bytes(shot):
    digests = []
    for seed in ("7", "7", "8"):
        assert shot.run("groom", "--style", "curly", *SMALL, "--seed", seed, "-o", "a.hair", "--force").code == GOOD
        digests.append(hashlib.sha256((shot / "a.hair").read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]


def test_each_parameter_has_an_effect(shot):
    made = set()
    for changed in ({}, {"style": "wavy"}, {"strands": 41}, {"vertices": 9}, {"length": 0.1}, {"length-variation": 0.5},
                    {"curl-radius": 0.02}, {"curl-turns": 7}, {"clump": 0}, {"seed": 5}):
        options = {"style": "curly", "strands": 40, "vertices": 8, **changed}
        run = shot.run("groom", *(f"--{name}={value}" for name, value in options.items()), "-o", "x.hair", "--force")
        assert run.code == GOOD, run.err
        made.add((shot / "x.hair").read_bytes())
    assert len(made) == 10


@pytest.mark.parametrize("preset, strands, vertices", [
    ("model1", 19776, 221078), ("model2", 20000, 259993), ("model3", 20000, 1373047)])
def test_presets_have_the_sizes_of_the_paper(shot, preset, strands, vertices):
    run = shot.run("groom", "--preset", preset, "-o", "p.hair")
    assert run.code == GOOD and run.out == f"p.hair: {strands} strands, {vertices} vertices\n"
    counts, points = read_hair(shot / "p.hair")
    assert len(counts) == strands and len(points) == vertices and len(set(counts)) > 1


def test_a_groom_is_converted_with_its_units_and_axes(shot):
    points = hanging(strands=3) * 100
    write_tfx3(shot / "c.tfx", points[..., [0, 2, 1]] * np.float32([1, -1, 1]), both_ends=False)  # +Z up, centimetres
    run = shot.run("groom", "--from", "c.tfx", "--units", "cm", "--up", "+Z", "-o", "c.hair")
    assert run.code == GOOD and run.err == ""
    counts, converted = read_hair(shot / "c.hair")
    assert list(counts) == [6, 6, 6]
    np.testing.assert_allclose(converted, hanging(strands=3).reshape(-1, 3), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("arguments", [
    [], ["-o", "new.hair", "--style", "bald"], ["-o", "new.hair", "--strands", "0"], ["-o", "new.hair", "--strands", "many"],
    ["-o", "new.hair", "--length", "-1"], ["-o", "new.hair", "--vertices", "1"], ["-o", "new.hair", "--clump", "nan"],
    ["-o", "new.hair", "--preset", "model4"], ["-o", "new.hair", "--preset", "model1", "--strands", "4"],
    ["-o", "new.hair", "--from", "a.hair", "--style", "fur"], ["-o", "new.hair", "--units", "cm"],
    ["-o", "new.hair", "--from", "a.hair", "--units", "parsec"], ["-o", "new.hair", "--from", "a.hair", "--up", "W"],
    ["-o", "new.hair", "--strands", "10000000", "--vertices", "10000"],
])
def test_a_command_line_without_sense_ends_with_2(shot, arguments):
    run = shot.run("groom", *arguments)
    assert run.code == USAGE and run.out == "" and run.err != ""
    assert shot.files() == ["a.hair"]


def test_an_existing_file_stays_without_force(shot):
    old = (shot / "a.hair").read_bytes()
    assert_one_error(shot.run("groom", *SMALL, "-o", "a.hair"), DISK, "a.hair", "--force")
    assert (shot / "a.hair").read_bytes() == old
    assert shot.run("groom", *SMALL, "-o", "a.hair", "--force").code == GOOD
    assert (shot / "a.hair").read_bytes() != old
    assert_one_error(shot.run("groom", *SMALL, "-o", "none/a.hair"), DISK, "none/a.hair")
    assert_one_error(shot.run("groom", "--from", "none.tfx", "-o", "b.hair"), INPUT, "none.tfx")
    assert shot.files() == ["a.hair"]


def test_the_script_of_the_demo_head_makes_the_committed_file(shot):
    subprocess.run([sys.executable, SOURCE / "scripts/make_demo_head.py", os.fspath(shot / "head.gltf")], check=True)
    assert (shot / "head.gltf").read_bytes() == (SOURCE / "scenes/demo_head.gltf").read_bytes()
