"""The page of `strandbake view` in a browser: Debian's Chromium, which PyPI's playwright drives."""

import io
import pathlib
import shutil
import subprocess

import numpy as np
import pytest
from conftest import PROGRAM, SOURCE

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed; scripts/dcc-packages.sh build/dcc does it")
Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")

SCENE = """[bake]
frames = "1-48"
[groom]
files = ["a.hair"]
space = "head"
[head]
animation = "head.gltf"
node = "Head"
[[region]]
name = "first half"
strands = {range = "0-399"}
[[region]]
name = "second half"
[[collider]]
sphere = {center = [0, 0, 0], radius = 0.09}
space = "node"
node = "Head"
"""


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view")
    (folder / "scene.toml").write_text(SCENE)
    shutil.copy(SOURCE / "scenes/demo_head.gltf", folder / "head.gltf")
    for words in (["groom", "--style", "straight", "--strands", "800", "--vertices", "12", "-o", "a.hair"],
                  ["bake", "scene.toml", "-o", "shot.h5", "--quiet"], ["view", "shot.h5", "-o", "shot.html"]):
        subprocess.run([PROGRAM, *words], cwd=folder, check=True, capture_output=True, timeout=300)
    return folder / "shot.html"


@pytest.fixture(scope="module")
def chromium():
    with playwright.sync_playwright() as library:
        # Drawn by the processor: what a machine without a graphics card has. There is no sandbox for root.
        browser = library.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader",
                                                                          "--enable-unsafe-swiftshader"])
        yield browser
        browser.close()


class Tab:
    """The page, opened, and all that it asked for and complained about."""

    def __init__(self, browser, page_file, script=None):
        self.page = browser.new_page(viewport={"width": 800, "height": 600})
        self.complaints, self.asked = [], []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        if script:
            self.page.add_init_script(script)
        self.page.goto(pathlib.Path(page_file).as_uri())

    def picture(self):
        """What the canvas shows after the next two frames, less the panels."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        with Image.open(io.BytesIO(self.page.screenshot())) as image:
            return np.asarray(image.convert("RGB")).astype(int)[190:530]

    def frame(self):
        return self.page.locator("#frame").inner_text()

    def show_frame(self, index):
        self.page.locator("#scrub").fill(str(index))


@pytest.fixture
def tab(chromium, page_file):
    tab = Tab(chromium, page_file)
    tab.page.locator("#bar").wait_for(state="visible", timeout=60000)
    yield tab
    tab.page.close()
    assert tab.complaints == [] and tab.asked == [pathlib.Path(page_file).as_uri()]


def brown(picture):
    """How many pixels are hair: the wall is blue, the head grey."""
    return int(((picture[..., 0] > picture[..., 2] + 12) & (picture[..., 0] < 200)).sum())


def differing(one, other):
    return int((np.abs(one - other).max(axis=2) > 20).sum())


def test_the_page_shows_hair_and_says_what_it_is(tab):
    assert tab.page.title() == "shot.h5" and tab.page.locator("#message").is_hidden()
    assert tab.page.locator("#facts").inner_text() == "800 of 800 strands, 48 frames, 24 a second"
    assert tab.page.locator("#switches label").all_inner_texts() == ["first half", "second half", "colliders and head", "follow the head"]
    assert tab.frame() == "1 / 48"
    picture = tab.picture()
    assert brown(picture) > 5000
    assert (np.ptp(picture[:, :60], axis=(0, 1)) < 60).all()  # the wall beside it


def test_a_drag_turns_it_and_the_wheel_comes_nearer(tab):
    before = tab.picture()
    mouse = tab.page.mouse
    mouse.move(400, 300)
    mouse.down()
    mouse.move(560, 320, steps=4)
    mouse.up()
    turned = tab.picture()
    assert differing(before, turned) > 2000
    mouse.wheel(0, -300)
    assert brown(tab.picture()) > 1.3 * brown(turned)
    mouse.dblclick(400, 300)
    assert differing(before, tab.picture()) < 50
    tab.page.keyboard.down("Shift")
    mouse.down()
    mouse.move(500, 300, steps=3)
    mouse.up()
    tab.page.keyboard.up("Shift")
    moved = tab.picture()
    assert differing(before[:, :700], moved[:, 100:]) < 0.5 * differing(before, moved)


def test_regions_and_colliders_are_switched_by_a_click(tab):
    with_head = tab.picture()
    tab.page.get_by_text("colliders and head").click()
    assert differing(with_head, tab.picture()) > 2000
    whole = brown(tab.picture())
    tab.page.get_by_text("first half").click()
    half = brown(tab.picture())
    assert 0.2 * whole < half < 0.97 * whole
    tab.page.get_by_text("second half").click()
    assert brown(tab.picture()) == 0
    for text in ("first half", "second half", "colliders and head"):
        tab.page.get_by_text(text).click()
    assert differing(with_head, tab.picture()) == 0


def test_it_plays_pauses_and_scrubs(tab):
    first = tab.picture()
    tab.show_frame(20)
    assert tab.frame() == "21 / 48"
    assert differing(first, tab.picture()) > 1000
    tab.page.keyboard.press("Home")
    tab.show_frame(0)
    assert differing(first, tab.picture()) == 0
    tab.page.locator("#play").click()
    tab.page.wait_for_function("() => Number(document.getElementById('scrub').value) > 3", timeout=60000)
    assert tab.page.locator("#play").inner_text() == "Pause"
    tab.page.locator("#play").click()
    stopped = tab.frame()
    assert stopped != "1 / 48" and tab.page.locator("#play").inner_text() == "Play"
    one = tab.picture()
    assert tab.frame() == stopped and differing(one, tab.picture()) == 0
    tab.page.locator("#picture").focus()
    tab.show_frame(10)
    tab.page.locator("#picture").focus()
    tab.page.keyboard.press("ArrowRight")
    assert tab.frame() == "12 / 48"


@pytest.mark.parametrize("script, words", [
    ("HTMLCanvasElement.prototype.getContext = () => null", "WebGL 2"),
    ("delete window.DecompressionStream", "too old"),
])
def test_a_browser_that_cannot_show_it_says_so(chromium, page_file, script, words):
    tab = Tab(chromium, page_file, script)
    tab.page.locator("#message", has_text=words).wait_for(timeout=60000)
    assert tab.page.locator("#bar").is_hidden() and tab.complaints == []
    tab.page.close()
