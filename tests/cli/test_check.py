"""check: every fault of a scene at once, or the plan of what would be run."""

import re

import pytest
from conftest import GOOD, INPUT, SOURCE, hanging, write_hair


def plan_of(run):
    """{"region \"tail\"": {"wind": "runs", ...}, ...}"""
    assert run.code == GOOD, run.err
    plan = {}
    for line in run.out.splitlines():
        if not line.startswith(" "):
            part = plan.setdefault(line, {})
        else:
            name, value = re.fullmatch(r"  (.{14}) (.+)", line).groups()
            part[name.strip()] = value
    return plan


def test_the_plan_goes_to_stdout_and_nothing_is_written(shot):
    run = shot.run("check", shot.scene())
    assert run.code == GOOD and run.err == ""
    assert list(plan_of(run)) == ["groom", "head", 'region "hair"', "bake"]
    assert shot.files() == ["a.hair", "scene.toml"]


def test_the_plan_says_what_is_skipped_and_why(shot):
    shot.scene('''[wind]
velocity = [1, 0, 0]
[[region]]
name = "all"
strands = {range = "0-1"}
global = {range = 0.5}
[[region]]
name = "nothing"
strands = {range = "2"}
drag = 0
local = {stiffness = 0}
global = {stiffness = 0}
lengths = {iterations = 0}
[[region]]
name = "too"
local = {iterations = 0, method = 2}
global = {range = 0}
[cache]
velocity = true
stats = false
''')
    plan = plan_of(shot.run("check", "scene.toml"))
    assert plan["groom"] == {"strands": "5", "vertices": "30"}
    assert plan["head"] == {"motion": "skipped, there is no animation: the head stands still",
                            "collisions": "skipped, there are no colliders"}
    assert plan['region "all"'] == {
        "strands": "2 with 12 vertices", "wind": "runs", "global shape": "runs on 50 % of each strand from the root",
        "rod": "skipped, method = \"shape\"", "local shape": "runs, method 1, 3 iterations", "edge lengths": "runs, directly"}
    assert plan['region "nothing"'] == {
        "strands": "1 with 6 vertices", "wind": "skipped, drag = 0", "global shape": "skipped, stiffness = 0 in every frame",
        "rod": "skipped, method = \"shape\"", "local shape": "skipped, stiffness = 0 in every frame", "edge lengths": "skipped, iterations = 0"}
    assert plan['region "too"'] == {
        "strands": "2 with 12 vertices", "wind": "runs", "global shape": "skipped, range = 0",
        "rod": "skipped, method = \"shape\"", "local shape": "skipped, iterations = 0", "edge lengths": "runs, directly"}
    assert plan["bake"]["velocity"] == "written" and plan["bake"]["stats"] == "skipped, cache.stats = false"


def test_a_pass_runs_if_it_does_something_in_any_frame(shot):
    shot.scene('[wind]\nvelocity = {3 = [0, 0, 0], 4 = [1, 0, 0]}\n[[region]]\nname = "hair"\n'
               "local = {stiffness = {3 = 0, 4 = 0.1}}\nglobal = {stiffness = {1 = 0, 4 = 0, 5 = 1}}\n")
    region = plan_of(shot.run("check", "scene.toml"))['region "hair"']
    assert region["wind"] == "runs"
    assert region["local shape"] == "runs, method 1, 3 iterations"
    assert region["global shape"] == "skipped, stiffness = 0 in every frame"  # frame 5 is none of 1 to 4
    earlier = plan_of(shot.run("check", "scene.toml", "--set", "bake.frames=1-3"))['region "hair"']
    assert earlier["wind"] == "skipped, there is no wind in any frame"
    assert earlier["local shape"] == "skipped, stiffness = 0 in every frame"


def test_the_plan_tells_frames_head_memory_and_disk(shot, head):
    collider = "[[collider]]\nsphere = {radius = 0.1}\n"
    shot.scene(head + collider + collider + 'node = "Head"\n', frames="1-240")
    plan = plan_of(shot.run("check", "scene.toml", "--set", "bake.preroll=12", "--set", "solver.precision=double", "--set",
                            "cache.compression=none"))
    assert re.fullmatch(r'node "Head" of head\.gltf, clip ".+", 5 s', plan["head"]["motion"])
    assert plan["head"]["collisions"] == "runs, 2 spheres, each where strands are in its reach"
    assert plan["bake"]["frames"] == "1 to 240, 24 a second, 4 substeps each, after 12 that are simulated but not written"
    assert re.fullmatch(r"openmp, double, \d+ threads?", plan["bake"]["solver"])
    assert plan["bake"]["disk"] == "84.4 KiB"  # 240 frames of 30 vertices of 12 bytes
    assert re.fullmatch(r"about [\d.]+ KiB: solver [\d.]+ KiB, frame 720 B", plan["bake"]["memory"])


def test_the_plan_tells_how_many_substeps_motion_needs(shot, head):
    shot.scene(head, frames="1-240")
    frames = plan_of(shot.run("check", "scene.toml", "--set", "bake.substeps=auto", "--set", "bake.preroll=2"))["bake"]["frames"]
    found = re.fullmatch(r"1 to 240, 24 a second, 1 to (\d+) substeps each, (\d+) in all \(auto, tolerance 0\.001 m\), after 2 that "
                         r"are simulated but not written", frames)
    most, total = map(int, found.groups())
    assert 1 < most <= 1000 and 241 - 1 + most <= total <= 241 * most
    finer = plan_of(shot.run("check", "scene.toml", "--set", "bake.substeps=auto", "--set", "bake.tolerance=1e-5"))["bake"]["frames"]
    assert 9 * most <= int(re.search(r"1 to (\d+) substeps", finer)[1]) <= 10 * most  # ten times, rounded up
    shot.scene(frames="1-240", name="still.toml")
    still = plan_of(shot.run("check", "still.toml", "--set", "bake.substeps=auto"))["bake"]["frames"]
    assert ", 1 substeps each, 239 in all" in still


def test_every_fault_is_listed_at_once_in_order_with_its_place(shot):
    write_hair(shot / "b.hair", hanging(strands=2))
    (shot / "cut.hair").write_bytes((shot / "a.hair").read_bytes()[:200])
    (shot / "faulty.toml").write_text('''[bake]
frames = "9-1"
fps = 0
substeps = 2.5
[groom]
files = ["a.hair", "cut.hair", "none.hair"]
units = "parsec"
[wind]
gust = -1
direction = [1, 0, 0]
[[region]]
name = "tail"
dampnig = 0.1
strands = {range = "0-3"}
[[region]]
name = "tail"
strands = {range = "x"}
[cache]
compression = "zip"
''')
    run = shot.run("check", "faulty.toml")
    assert run.code == INPUT and run.out == ""
    lines = run.err.splitlines()
    expected = [
        (2, 10, "runs backwards"), (3, 7, '"bake.fps" is 0'), (4, 12, "whole number"), (7, 9, "parsec"),
        (9, 8, '"wind.gust" is -1'),
        (10, 1, '"direction": unknown key'), (13, 1, 'did you mean "damping"?'), (16, 8, "a name of its own"), (17, 20, '"x"'),
        (19, 15, '"zip"'), (6, 20, "cut.hair"), (6, 32, '"none.hair": no such file'),
    ]
    assert len(lines) == len(expected) + 1, run.err
    for line, (row, column, word) in zip(lines, expected):
        assert line.startswith(f"faulty.toml:{row}:{column}: ") and word in line
    assert lines[-1] == "strandbake: error: the scene has 12 faults"
    # bake says the same and ends the same way.
    bake = shot.run("bake", "faulty.toml")
    assert (bake.code, bake.out, bake.err) == (run.code, run.out, run.err)
    assert shot.files() == ["a.hair", "b.hair", "cut.hair", "faulty.toml"]


def test_faults_of_the_scene_do_not_hide_those_of_its_strands(shot):
    shot.scene('[[region]]\nname = "a"\nstrands = {range = "0-3"}\n[[region]]\nname = "b"\nstrands = {range = "3-9"}\n'
               '[[region]]\nname = "c"\nstrands = {range = "2-4"}\ndampnig = 1\n')
    run = shot.run("check", "scene.toml")
    lines = run.err.splitlines()
    assert len(lines) == 4, run.err
    assert lines[0].startswith("scene.toml:15:1: ") and "dampnig" in lines[0]
    assert lines[1].startswith("scene.toml:11:20: ") and "strand 9 is not there: the groom has 5 strands" in lines[1]
    assert lines[2].startswith("scene.toml:14:11: ") and 'region "c" claims strand 2 and 1 more, which region "a" has' in lines[2]


def test_a_selection_with_a_fault_takes_no_blame_twice(shot):
    for strands in ('{rnge = "0-3"}', '{range = "z"}', '{file = "b.hair"}', "3"):
        shot.scene(f'[[region]]\nname = "a"\nstrands = {strands}\n[[region]]\nname = "b"\nstrands = {{range = "0-4"}}\n')
        run = shot.run("check", "scene.toml")
        assert run.code == INPUT and run.err.splitlines()[-1].endswith("the scene has 1 fault"), run.err


@pytest.mark.parametrize("text, settings, place", [
    ("rod = {stiffness = 5}", [], "scene.toml:8:7"), ('hair = "wet"', [], "scene.toml:8:8"),
    ("", ["--set", "region.hair.rod.young=3e9"], "--set region.hair.rod.young=3e9"),
])
def test_a_method_that_may_have_been_forgotten_is_told(shot, text, settings, place):
    shot.scene(f'[[region]]\nname = "hair"\n{text}\n')
    key = "hair" if "wet" in text else "rod"
    run = shot.run("check", "scene.toml", *settings)
    assert run.code == GOOD
    assert run.err == (f'strandbake: warning: {place}: "{key}" has no part in region "hair", which has method = "shape" as none is '
                       'given; did you mean method = "rod"?\n')
    for method in ("shape", "rod"):
        assert shot.run("check", "scene.toml", *settings, "--set", f"region.hair.method={method}").err == ""


@pytest.mark.parametrize("hair, young", [("medium", "4000000000 Pa"), ("wet", "1600000000 Pa")])
def test_a_shear_modulus_that_floats_cannot_tell_beside_youngs_is_a_fault(shot, hair, young):
    shot.scene(f'[[region]]\nname = "hair"\nmethod = "rod"\nhair = "{hair}"\nrod = {{shear = 1}}\n')
    run = shot.run("check", "scene.toml")
    assert run.code == INPUT
    assert run.err.startswith('scene.toml:10:16: "shear" is 1 Pa, but must be from 0.01 to 100 times "young", which is ' + young)
    shot.scene(f'[[region]]\nname = "hair"\nmethod = "rod"\nhair = "{hair}"\nrod = {{shear = 1e9}}\n')
    assert shot.run("check", "scene.toml").code == GOOD


def test_warnings_stand_beside_the_plan(shot):
    write_hair(shot / "a.hair", [[[0, 0, 0], [0, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 1, 0]]])
    run = shot.run("check", shot.scene())
    assert run.code == GOOD and "region" in run.out
    assert re.fullmatch(r"strandbake: warning: .*a\.hair: 2 segments .*\n", run.err)


def test_check_is_the_same_from_any_folder(shot):
    shot.scene()
    (shot / "sub").mkdir()
    assert shot.run("check", "../scene.toml", cwd=shot / "sub").out == shot.run("check", "scene.toml").out


@pytest.mark.parametrize("arguments", [["docs"], ["docs", "--example"]])
def test_docs_goes_to_stdout(shot, arguments):
    run = shot.run(*arguments)
    assert run.code == GOOD and run.err == "" and len(run.out.splitlines()) > 50


def test_the_page_of_the_scene_file_is_the_committed_one(shot):
    assert shot.run("docs").out == (SOURCE / "docs/SCENE.md").read_text(), "run `strandbake docs > docs/SCENE.md`"


def test_the_example_is_a_good_scene_once_it_names_a_groom(shot):
    text = shot.run("docs", "--example").out
    (shot / "empty.toml").write_text(text)
    empty = shot.run("check", "empty.toml")
    assert empty.code == INPUT and len(empty.err.splitlines()) == 2 and "no groom" in empty.err
    assert text.count("files = []") == 1
    (shot / "scene.toml").write_text(text.replace("files = []", 'files = ["a.hair"]'))
    run = shot.run("check", "scene.toml")
    assert run.code == GOOD and run.err == ""
    shot.scene(frames="1-24")
    assert run.out == shot.run("check", "scene.toml").out  # every parameter at its default


def test_the_plan_of_a_rod_tells_what_it_takes_the_place_of(shot):
    shot.scene('[[region]]\nname = "hair"\nmethod = "rod"\nrod = {iterations = 2, exact_lengths = false}\n')
    region = plan_of(shot.run("check", "scene.toml"))['region "hair"']
    assert region["rod"] == "runs, 2 iterations, hair stretches as Young's modulus has it"
    assert region["local shape"] == region["edge lengths"] == 'skipped, method = "rod"'
