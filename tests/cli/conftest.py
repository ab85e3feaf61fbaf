"""What the tests of the program share: running it, and small grooms and scenes to run it on.

STRANDBAKE_PROGRAM names the program, STRANDBAKE_SOURCE the project's folder; left out: the release build of this project.
"""

import functools
import json
import os
import pathlib
import re
import struct
import subprocess
from types import SimpleNamespace

import h5py
import jsonschema
import numpy as np
import pytest

SOURCE = pathlib.Path(os.environ.get("STRANDBAKE_SOURCE") or pathlib.Path(__file__).parents[2]).resolve()
PROGRAM = str(pathlib.Path(os.environ.get("STRANDBAKE_PROGRAM") or SOURCE / "build/release/cli/strandbake").resolve())

GOOD, INVALID, USAGE, INPUT, DEVICE, DISK, NON_FINITE, INTERRUPTED = 0, 1, 2, 3, 4, 5, 6, 130

# Without the settings of whoever runs the tests.
ENVIRONMENT = {k: v for k, v in os.environ.items() if not k.startswith(("STRANDBAKE_", "OMP_"))}


def write_hair(path, strands, extra=b""):
    """A .hair file of strands, each an array [vertices, 3]."""
    points = np.concatenate([np.asarray(s, "<f4").reshape(-1, 3) for s in strands])
    segments = np.array([len(s) - 1 for s in strands], "<u2")
    header = struct.pack("<4s4I5f88s", b"HAIR", len(strands), len(points), 3, 0, 1, 0, 1, 1, 1, b"")
    path.write_bytes(header + segments.tobytes() + points.tobytes() + extra)


def write_tfx4(path, points, free):
    """A TressFX 4.x file; points [strands, vertices, 3], free [strands, vertices] is 0 where a vertex is pinned."""
    strands, vertices, _ = points.shape
    header = struct.pack("<fII5I128x", 4.0, strands, vertices, 160, 0, 0, 0, 0)
    path.write_bytes(header + np.concatenate([points, free[..., None]], axis=2).astype("<f4").tobytes())


def write_tfx3(path, points, both_ends):
    """A TressFX 3.x file; points [strands, vertices, 3]."""
    strands, vertices, _ = points.shape
    header = struct.pack("<f4I124x6I128x", 3.0, strands, vertices, 0, int(both_ends), 296, 0, 0, 0, 0, 0)
    path.write_bytes(header + points.astype("<f4").tobytes())


def hanging(strands=5, vertices=6, length=0.1):
    """Straight strands at the height of 1.6 m: [strands, vertices, 3]."""
    points = np.zeros((strands, vertices, 3), np.float32)
    points[..., 0] = 0.01 * np.arange(strands)[:, None]
    points[..., 1] = 1.6 - length * np.arange(vertices) / (vertices - 1)
    return points


def strict_schema(schema):
    """The schema without fields that it does not name: scripts must ignore those, the program must not print them."""
    if isinstance(schema, list):
        return [strict_schema(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    strict = {key: strict_schema(part) for key, part in schema.items()}
    if schema.get("type") == "object" and "properties" in schema:
        strict.setdefault("additionalProperties", False)
    return strict


@functools.cache
def validator(verb):
    return jsonschema.Draft202012Validator(strict_schema(json.loads((SOURCE / f"docs/schemas/{verb}.json").read_text())))


def validated(verb, out):
    """The JSON objects that a verb printed, each held against its schema: an event a line, or one object."""
    objects = [json.loads(line) for line in out.splitlines()] if verb == "bake" else [json.loads(out)]
    for each in objects:
        validator(verb).validate(each)
    return objects


class Shot:
    """A folder with a groom in it, and the program run in it."""

    def __init__(self, folder):
        self.folder = folder
        write_hair(folder / "a.hair", hanging())

    def __truediv__(self, name):
        return self.folder / name

    def scene(self, text="", name="scene.toml", files='["a.hair"]', frames="1-4"):
        """Writes a scene. Its first lines are always the same, so `text` begins in line 6."""
        head = f'[bake]\nframes = "{frames}"\n[groom]\nfiles = {files}\n\n'
        (self.folder / name).write_text(head + text)
        return name

    def groom_of(self, path, strands=None):
        """Makes the groom of a scene of the project, as the comment at its head says; returns whether it has one. `strands`: so many,
        in place of those of the comment."""
        found = re.search(r"^#   strandbake (groom .*)$", pathlib.Path(path).read_text(), re.MULTILINE)
        if not found:
            return False
        arguments = found[1].split()
        if strands:
            arguments[arguments.index("--strands") + 1] = str(strands)
        result = self.run(*arguments)
        assert result.code == GOOD, result.err
        return True

    def run(self, *arguments, cwd=None, env=None, **more):
        run = subprocess.run([PROGRAM, *map(os.fspath, arguments)], cwd=cwd or self.folder, env={**ENVIRONMENT, **(env or {})},
                             stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, timeout=600,
                             check=False, **more)
        if "--json" in arguments and run.stdout:
            validated(arguments[0], run.stdout)
        return SimpleNamespace(code=run.returncode, out=run.stdout, err=run.stderr)

    def start(self, *arguments, **more):
        """Starts the program and does not wait for it. It may be killed, so what it would write for coverage goes elsewhere: half of
        it would spoil what the others write."""
        env = {**ENVIRONMENT, "GCOV_PREFIX": f"{self.folder}.coverage"}
        return subprocess.Popen([PROGRAM, *map(os.fspath, arguments)], cwd=self.folder, env=env, stdin=subprocess.DEVNULL, text=True,
                                **more)

    def bake(self, *arguments, scene="scene.toml", out="out.h5", **more):
        """A bake that must be good; returns the path of its cache."""
        run = self.run("bake", scene, "-o", out, *arguments, **more)
        assert run.code == GOOD, run.err
        return self.folder / out

    def files(self):
        return sorted(p.name for p in self.folder.iterdir())


def read(path):
    """All data sets of a cache by name, as arrays."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def positions(path):
    return read(path)["frames/position"]


def cut(cache, name, frames):
    """The cache as a bake that ended early leaves it."""
    with h5py.File(cache) as file, h5py.File(cache.with_name(name), "w") as part:
        for key, value in file.attrs.items():
            part.attrs[key] = value
        for key in file:
            file.copy(key, part)
        part.attrs["complete"] = np.uint8(0)
        for group in (part["frames"], part["stats"]):
            for item in group.values():
                item.resize(frames, axis=0)


def assert_one_error(run, code, *words):
    """One sentence on stderr that names the place, nothing on stdout."""
    assert run.code == code, run.err
    assert run.out == ""
    lines = run.err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("strandbake: error: "), run.err
    for word in words:
        assert word in lines[0]


@pytest.fixture
def shot(tmp_path):
    return Shot(tmp_path)


@pytest.fixture
def head(shot):
    """The demo's head beside the scene, as head.gltf; the lines of a scene that ride it."""
    (shot / "head.gltf").write_bytes((SOURCE / "scenes/demo_head.gltf").read_bytes())
    return '[head]\nanimation = "head.gltf"\nnode = "Head"\n'
