"""Input that is wrong: one sentence with the place, exit code 3, nothing written. Input that is odd: a warning."""

import json
import re

import numpy as np
import pytest
from conftest import GOOD, INPUT, assert_one_error, hanging, positions, read, write_hair, write_tfx3, write_tfx4


def refused(shot, *arguments):
    """The faults as check lists them; bake must say and do the same."""
    check = shot.run("check", "scene.toml", *arguments)
    bake = shot.run("bake", "scene.toml", *arguments)
    assert (bake.code, bake.out, bake.err) == (check.code, check.out, check.err)
    assert check.code == INPUT and check.out == "", check.err
    *faults, last = [line for line in check.err.splitlines() if not line.startswith("strandbake: warning: ")]
    assert last == f"strandbake: error: the scene has {len(faults)} fault{'s' if len(faults) > 1 else ''}", check.err
    assert not (shot / "scene.h5").exists() and not (shot / "scene.h5.part").exists()
    return faults


def assert_fault(shot, place, *words, arguments=()):
    faults = refused(shot, *arguments)
    assert len(faults) == 1, faults
    assert faults[0].startswith(place + ": "), faults[0]
    for word in words:
        assert word in faults[0], faults[0]


# The scene


@pytest.mark.parametrize("text, place, words", [
    ("[wind]\ngsut = 1", "7:1", ['"gsut": unknown key', 'did you mean "gust"?']),
    ("[winds]\ngust = 1", "6:2", ['"winds": unknown key', 'did you mean "wind"?']),
    ("[wind]\ngust = true", "7:8", ['"wind.gust" is true', "must be a number"]),
    ("[wind]\nvelocity = [1, 2]", "7:12", ["a list of 2", "a list of 3 numbers"]),
    ("[wind]\nvelocity = [1, \"a\", 2]", "7:16", ['the text "a"']),
    ("[wind]\ngust = -0.5", "7:8", ['"wind.gust" is -0.5', "at least 0"]),
    ("[wind]\ngust = nan", "7:8", ["nan"]),
    ("[wind]\ngust = {1 = 0.5, x = 1}", "7:18", ['"x"', "frames"]),
    ("[wind]\nperiod = {1 = 1, 2 = 2}", "7:10", ["a table", "must be a number"]),
    ("[forces]\ngravity = [0, inf, 0]", "7:15", ["inf", "finite"]),
    ("[solver]\nprecision = \"half\"", "7:13", ['"half"', '"float" or "double"']),
    ('[[region]]\nname = "a"\nlocal = {method = 5}', "8:19", ["from 1 to 4"]),
    ('[[region]]\nname = "a"\nlocal.iterations = 1.5', "8:20", ["whole number"]),
    ('[[region]]\nname = "a"\nstrands = {range = "4-2"}', "8:20", ["runs backwards", "2-4"]),
    ('[[region]]\nname = "a"\nstrands = {range = "0-5"}', "8:20", ["strand 5 is not there", "the groom has 5 strands"]),
    ('[[region]]\nname = "a"\nstrands = {file = "b.hair"}', "8:19", ['"b.hair"', 'did you mean "a.hair"?']),
    ('[[region]]\nname = "a"\nstrands = {box = {min = [5, 5, 5]}}\n[[region]]\nname = "b"', "8:11",
     ['region "a" has no strands']),
    ('[[region]]\nname = "a"\n[[region]]\nname = "b"\nstrands = {range = "0-4"}', "6:1",
     ['region "a" has no strands', "the other regions take them all"]),
    ('[[region]]\nname = "a"\nstrands = {range = "0-3"}\n[[region]]\nname = "b"\nstrands = {range = "3-4"}', "11:11",
     ['region "b" claims strand 3, which region "a" has already']),
    ('[[region]]\nname = "a"\nstrands = {range = "0, 2"}', "6:1",
     ["no region takes strand 1 and 2 more", "[[region]] without `strands`"]),
    ('[[region]]\nstrands = {range = "0-4"}', "6:1", ["has no name"]),
    ('[[collider]]\nnode = "Head"\nsphere = {radius = 1}', "7:8", ["there is no animation"]),
    ("[[collider]]\nsphere = {radius = -1}", "7:20", ["from 0 to 1000000000"]),
    ("[[collider]]", "6:1", ["has no shape"]),
    ('[head]\nnode = "Head"', "7:8", ["there is no animation"]),
    ('[cache]\ncompression = "deflate:13"', "7:15", ['"deflate:13"', '"none"']),
    ("[cache]\nprecision = -1", "7:13", ["from 0 to 1 (m)"]),
    ("[wind\ngust = 1", "6:6", ["this is not TOML"]),
])
def test_a_fault_of_the_scene_is_said_with_its_place(shot, text, place, words):
    shot.scene(text)
    assert_fault(shot, f"scene.toml:{place}", *words)


@pytest.mark.parametrize("override, words", [
    ("bake.fps=0", ["more than 0"]), ("bake.frames=9-1", ["runs backwards", "1-9"]), ("bake.frames=all", ['"all"']),
    ("bake.fpss=24", ['did you mean "fps"?']), ("bake.fps", ["="]), ("region.tail.damping=0.1", ['no region is named "tail"']),
    ("collider[0].sphere.radius=1", ["no entries"]), ("groom.units=parsec", ["parsec", "cm"]),
    ("groom.files=none.hair", ["no such file"]),
])
def test_a_fault_of_an_override_names_the_override(shot, override, words):
    shot.scene()
    assert_fault(shot, f"--set {override}", *words, arguments=["--set", override])


def test_frames_backwards_and_no_frame_rate(shot):
    shot.scene(frames="9-1")
    assert_fault(shot, "scene.toml:2:10", "runs backwards", '"1-9"')
    (shot / "scene.toml").write_text('[bake]\nfps = 0\n[groom]\nfiles = "a.hair"\n')
    assert_fault(shot, "scene.toml:2:7", '"bake.fps" is 0', "more than 0")


def test_a_scene_that_cannot_be_read(shot):
    for verb in ("check", "bake"):
        assert_one_error(shot.run(verb, "none.toml"), INPUT, "none.toml", "cannot be opened")
        assert_one_error(shot.run(verb, "."), INPUT, "this is a folder")
    (shot / "scene.toml").write_bytes((shot / "a.hair").read_bytes())
    faults = refused(shot)
    assert faults[0].startswith("scene.toml:1:") and "this is not TOML" in faults[0]


def test_a_file_that_is_not_there_is_said_with_what_would_do(shot):
    shot.scene(files='["a.hair", "sub/b.hair"]')
    assert_fault(shot, "scene.toml:4:20", '"sub/b.hair": no such file beside the scene;', "--search", "STRANDBAKE_PATH")
    assert_fault(shot, "scene.toml:4:20", "or in the search path", arguments=["--search", "nowhere"])
    (shot / "sub").mkdir()
    (shot / "sub/b.hair").mkdir()  # a folder is no file
    assert_fault(shot, "scene.toml:4:20", "no such file")
    shot.scene('[head]\nanimation = "dance.glb"\nnode = "Head"\n')
    assert_fault(shot, "scene.toml:7:13", '"dance.glb": no such file')


# Grooms


def faulty_hair(vertex=None, counts=None):
    def write(path):
        points = hanging()
        if vertex is not None:
            points[3, 2] = vertex
        write_hair(path, list(points))
        if counts is not None:
            data = bytearray(path.read_bytes())
            data[128:138] = np.array(counts, "<u2").tobytes()
            path.write_bytes(data)
    return write


def nan_tfx(path):
    points = hanging()
    points[1, 4, 0] = np.nan
    write_tfx3(path, points, both_ends=False)


@pytest.mark.parametrize("name, write, words", [
    ("b.hair", faulty_hair(vertex=[0, np.nan, 0]), ["strand 3, vertex 2", "nan"]),
    ("b.hair", faulty_hair(vertex=[np.inf, 0, 0]), ["strand 3, vertex 2", "inf"]),
    ("b.tfx", nan_tfx, ["strand 1, vertex 4", "nan"]),
    ("b.obj", lambda p: p.write_text("v 0 0 0\nv 0 1 nan\nl 1 2\n"), ["nan"]),
    ("b.hair", faulty_hair(counts=[5, 5, 0, 5, 5]), ["strand 2 has one vertex", "needs two"]),
    ("b.tfx", lambda p: write_tfx4(p, hanging(vertices=2)[:, :1], np.zeros((5, 1))), ["strand 0 has one vertex"]),
    ("b.hair", faulty_hair(counts=[5, 5, 6, 5, 5]), ["byte 8", "30 points", "make 31"]),
    ("b.hair", lambda p: p.write_bytes(b"HAIR"), ["byte 0"]),
    ("b.hair", lambda p: p.write_bytes(b""), ["byte 0"]),
    ("b.hair", lambda p: p.write_text("hello"), ["HAIR", "another format"]),
    ("b.tfx", lambda p: p.write_bytes(b"\0" * 400), ["byte 0", "version"]),
    ("b.obj", lambda p: p.write_text("v 0 0 0\nv 0 1 0\nl 1 9\n"), [":3", "9"]),
    ("b.obj", lambda p: p.write_text("v 0 0 0\n"), ["strand"]),
    ("b.abc", lambda p: p.write_bytes(b"Ogawa\xff\0\1"), [".hair, .tfx and .obj"]),
])
def test_a_faulty_groom_is_refused_with_the_place(shot, name, write, words):
    write(shot / name)
    shot.scene(files=f'["a.hair", "{name}"]')
    assert_fault(shot, "scene.toml:4:20", name, *words)


def test_a_truncated_groom_is_refused(shot):
    write_tfx3(shot / "b.tfx", hanging(), both_ends=True)
    whole = {name: (shot / name).read_bytes() for name in ("a.hair", "b.tfx")}
    shot.scene(files='["a.hair", "b.tfx"]')
    for name, column in (("a.hair", 10), ("b.tfx", 20)):
        for size in (len(whole[name]) - 1, len(whole[name]) // 2, 100):
            (shot / name).write_bytes(whole[name][:size])
            assert_fault(shot, f"scene.toml:4:{column}", name, f"the file ends at byte {size}")
        (shot / name).write_bytes(whole[name])
    assert shot.run("check", "scene.toml").code == GOOD


def test_zero_length_segments_are_simulated_with_a_warning_that_counts_them(shot):
    points = hanging(strands=7)
    points[2, 3] = points[2, 2]
    points[4, 1:] = points[4, 0]  # all of a strand in one place
    write_hair(shot / "a.hair", list(points))
    for method in (1, 2, 3, 4):
        shot.scene(f'[[region]]\nname = "r"\nlocal = {{method = {method}}}\nglobal = {{stiffness = 0}}\n'
                   "[forces]\ngravity = [4, -9, 0]\n", frames="1-8")
        run = shot.run("bake", "scene.toml", "--force", "--quiet")
        assert run.code == GOOD and run.out == ""
        assert re.fullmatch(r"strandbake: warning: .*a\.hair: 6 segments .* strand 2\n", run.err)
        frames = positions(shot / "scene.h5")
        assert np.isfinite(frames).all() and (frames[-1] != frames[0]).any()


def test_bytes_behind_the_groom_are_left_out_with_a_warning(shot):
    write_hair(shot / "a.hair", list(hanging()), extra=b"12345")
    run = shot.run("bake", shot.scene())
    assert run.code == GOOD and "5 bytes behind it" in run.err


def test_strands_of_two_vertices_ride_the_head(shot, head):
    """Both are pinned, so nothing is simulated."""
    write_hair(shot / "a.hair", list(hanging(vertices=2)))
    found = read(shot.bake(scene=shot.scene(head, frames="1-30")))
    rest = np.c_[found["rest/position"].astype(float), np.ones(10)]
    for matrix, frame in zip(found["frames/head"], found["frames/position"]):
        np.testing.assert_allclose(frame, (rest @ matrix.T)[:, :3], atol=2e-6)  # a few float32 steps at 1.6
    assert (found["frames/position"][-1] != found["frames/position"][0]).any()


# Animations


def gltf(nodes, clips):
    """A glTF without buffers: clips are names of animations without channels."""
    children = [k for k in range(len(nodes)) if not any(k in n.get("children", []) for n in nodes)]
    return json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": children}], "nodes": nodes,
                       "animations": [{"name": c, "channels": [], "samplers": []} for c in clips]})


def two_clips(data):
    """The demo's head with its clip twice, under two names."""
    scene = json.loads(data)
    clip = scene["animations"][0]
    scene["animations"] = [{**clip, "name": "Walk"}, {**clip, "name": "Nod"}]
    return json.dumps(scene)


def test_a_clip_that_is_not_there_is_said_with_those_that_are(shot, head):
    (shot / "head.gltf").write_text(two_clips((shot / "head.gltf").read_text()))
    shot.scene(head + 'clip = "Dance"\n')
    assert_fault(shot, "scene.toml:7:13", "head.gltf", '"Dance"', '"Walk"', '"Nod"')
    shot.scene(head)
    assert_fault(shot, "scene.toml:7:13", "head.gltf", '"Walk"', '"Nod"')  # which of them?
    assert shot.run("check", "scene.toml", "--set", "head.clip=Nod").code == GOOD


def test_a_node_that_is_not_there_is_said_with_the_closest(shot, head):
    shot.scene(head.replace('"Head"', '"Haed"'))
    assert_fault(shot, "scene.toml:8:8", "head.gltf", '"Haed"', '"Head"')
    shot.scene(head + '[[collider]]\nnode = "Nekc"\nsphere = {radius = 0.1}\n')
    assert_fault(shot, "scene.toml:10:8", '"Nekc"', '"Neck"')


def test_a_name_that_several_nodes_bear_is_refused_with_their_paths(shot):
    nodes = [{"name": "Body", "children": [1, 2]}, {"name": "Left", "children": [3]}, {"name": "Right", "children": [4]},
             {"name": "Head"}, {"name": "Head"}]
    (shot / "two.gltf").write_text(gltf(nodes, []))
    shot.scene('[head]\nanimation = "two.gltf"\nnode = "Head"\n')
    assert_fault(shot, "scene.toml:8:8", "2 nodes", "Left/Head", "Right/Head", "path")
    assert shot.run("check", "scene.toml", "--set", "head.node=Left/Head").code == GOOD


def test_a_truncated_or_foreign_animation_is_refused(shot, head):
    whole = (shot / "head.gltf").read_bytes()
    shot.scene(head)
    for data in (whole[:len(whole) // 2], whole[:-3], whole[:40], b"", b"hello", (shot / "a.hair").read_bytes()):
        (shot / "head.gltf").write_bytes(data)
        assert_fault(shot, "scene.toml:7:13", "head.gltf")


def test_an_animation_without_node_or_file(shot, head):
    shot.scene('[head]\nanimation = "head.gltf"\n')
    assert_fault(shot, "scene.toml:7:13", "no node of it carries the hair")
    shot.scene(head + 'units = "parsec"\n')
    assert_fault(shot, "scene.toml:9:9", "parsec")
    shot.scene(head, files='{file = "a.hair", space = "head"}')
    assert refused(shot)


def test_a_head_that_shrinks_to_nothing_is_refused_before_the_bake(shot):
    nodes = [{"name": "Root", "scale": [1, 1, 0], "children": [1]}, {"name": "Head"}]
    (shot / "flat.gltf").write_text(gltf(nodes, []))
    for space in ("world", "head"):
        shot.scene('[head]\nanimation = "flat.gltf"\nnode = "Head"\n')
        faults = refused(shot, "--set", f"groom.space={space}")
        assert len(faults) == 1 and "squashed flat" in faults[0]
