"""The command view and sabench.view, and the page in a browser without network."""

import base64
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import sabench
from sabench.apps.viewer.contents import Frame, PageContents, of_dataset, of_scene
from sabench.apps.viewer.points import ObjectCloud
from sabench.apps.viewer.view import render_contents
from sabench.dataset.copies import copy_observation
from sabench.dataset.reader import Dataset
from sabench.plotting.kinds import FOUND, MISSED, TRUE
from sabench.scenes import load_scene
from tests.conftest import Command
from tests.helpers.browser import Browser
from tests.helpers.commands import refuse, succeed
from tests.helpers.refusals import refused


@pytest.mark.slow
def test_a_result_is_shown_next_to_its_data_set(
    command: Command, quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    done = succeed(command("view", quick.root, quick_result, "-o", "mine.html", "--json"))
    summary = json.loads(done.stdout)
    assert summary["cameras"] == 4
    assert summary["particles"] >= 600
    assert summary["notes"] == ["Particles of the result are local maxima of its volume."]
    page = (tmp_path / "mine.html").read_text(encoding="utf-8")
    assert summary["bytes"] == len(page.encode()) < 15_000_000
    succeed(command("view", quick_result, "-o", "alone.html"))
    assert (tmp_path / "alone.html").read_text(encoding="utf-8") == page
    refuse(command("view", quick.root, "-o", "mine.html"), "mine.html")


@pytest.mark.parametrize("what", ["cylinder-tank", "quick.toml"])
def test_a_rig_is_shown(command: Command, tmp_path: Path, quick_toml: str, what: str) -> None:
    (tmp_path / "quick.toml").write_text(quick_toml, encoding="utf-8")
    done = succeed(command("view", what))
    assert done.stdout.startswith("view.html: 4 camera(s), 0 frame(s), 0 particles, 0 bubbles, 0.")


def test_cameras_of_a_data_set_are_shown_without_its_images(quick: Dataset) -> None:
    made = sabench.view(quick.root / "cameras.json")
    assert made.summary["cameras"] == 4
    assert made.summary["frames"] == 0


@pytest.mark.slow
def test_the_observation_side_shows_finds(
    quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    copy_observation(quick, tmp_path / "blind")
    blind = sabench.open_dataset(tmp_path / "blind")
    made = sabench.view(blind, quick_result)
    assert made.summary["particles"] > 300
    assert "found; no truth is known" in made.html
    assert sabench.view(blind).summary["particles"] == 0


@pytest.mark.parametrize(
    "words", ["nothing", "nothing.h5", "quick result.h5", ".", "broken.h5", "away.h5"]
)
def test_errors_of_view(command: Command, quick_result: Path, tmp_path: Path, words: str) -> None:
    (tmp_path / "broken.h5").write_bytes(b"no HDF5")
    shutil.copy(quick_result, tmp_path / "away.h5")
    done = command("view", *words.split())
    assert (done.stdout, done.stderr.count("\n")) == ("", 1)
    refuse(done, words.split()[0])
    assert not (tmp_path / "view.html").exists()


def test_notebooks_show_the_page_in_a_frame_of_its_own(tmp_path: Path) -> None:
    made = sabench.view(sabench.load_scene("quick"))
    shown = made._repr_html_()
    assert shown.startswith('<iframe sandbox="allow-scripts" srcdoc="&lt;!DOCTYPE html&gt;')
    assert shown.count("<") == 2  # the page is text of an attribute
    path = made.save(tmp_path / "rig.html")
    assert path.read_text(encoding="utf-8") == made.html
    with refused("rig.html"):
        made.save(path)
    made.save(path, overwrite=True)


EVIL = '</script><img src=x onerror="document.title=1">'
SHOWN = "sabenchView.objects.points.geometry.attributes.position.count"
NO_WEBGL = """const real = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : real.call(this, kind, ...rest);
};"""
# what Chromium says of drawing in software
EXPECTED = ("software WebGL", "GPU stall due to ReadPixels")


@pytest.fixture(scope="module")
def browser(browser: Browser) -> Browser:
    none = {"latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    browser.devtools("Network.enable")
    browser.devtools("Network.emulateNetworkConditions", offline=True, **none)
    return browser


def moving(count: int = 40) -> PageContents:
    contents = of_scene(load_scene("quick"), "made up")
    low, high = contents.surroundings.low_mm, contents.surroundings.high_mm
    start = np.random.default_rng(1).uniform(low + 1.0, high - 1.0, (count, 3))
    kind = np.repeat([TRUE, FOUND, MISSED], [count // 2, count // 4, count // 4]).astype(np.uint8)
    nothing = ObjectCloud.of_kind(np.zeros((0, 3)), TRUE)
    about = (kind, np.arange(count), np.full((count, 3), 3.0))
    frames = tuple(
        Frame(n, 0.1 * n, ObjectCloud.of_kind(start + 0.3 * n, *about), nothing) for n in range(3)
    )
    return replace(contents, title=EVIL, frames=frames, labels={"found": EVIL, "missed": "missed"})


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("view") / "moving.html"
    file.write_text(render_contents(moving())[0], encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory, quick: Dataset) -> Path:
    file = tmp_path_factory.mktemp("view") / "quick.html"
    file.write_text(render_contents(of_dataset(quick))[0], encoding="utf-8")
    return file


def open_page(browser: Browser, page: Path, width: int = 1400) -> None:
    browser.complaints()
    browser.open(page, width=width)
    browser.wait("document.documentElement.dataset.ready")


@pytest.mark.slow_but_first
@pytest.mark.parametrize("mode", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1400])
def test_axe_finds_nothing(browser: Browser, page: Path, width: int, mode: str) -> None:
    browser.prefer(mode)
    open_page(browser, page, width)
    browser.ask("document.querySelectorAll('details').forEach(details => { details.open = true })")
    found = browser.violations()
    browser.prefer(None)
    assert found == []


def faults(browser: Browser) -> list[str]:
    return [one for one in browser.complaints() if not any(known in one for known in EXPECTED)]


def drawing(browser: Browser) -> np.ndarray:
    browser.ask("new Promise(done => setTimeout(done, 350))")  # the drawing at rest
    box = browser.ask(
        "(({x, y, width, height}) => ({x, y, width, height}))"
        "(document.getElementById('stage').getBoundingClientRect())"
    )
    shot = browser.devtools("Page.captureScreenshot", format="png", clip=box | {"scale": 1})
    data = np.frombuffer(base64.b64decode(shot["data"]), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image).astype(int)


def test_all_points_are_drawn_without_faults(browser: Browser, page: Path) -> None:
    open_page(browser, page)
    assert browser.ask(SHOWN) == 40
    assert browser.ask("sabenchView.space.renderer.info.render.points") == 40
    assert faults(browser) == []


@pytest.mark.slow
def test_kinds_can_be_left_out(browser: Browser, page: Path) -> None:
    open_page(browser, page)
    before = drawing(browser)
    for box in ("//fieldset[@id='particles']//label[1]//input", "//button[text()='errors only']"):
        browser.press(box)
        after = drawing(browser)
        assert np.abs(after - before).max() > 50
        before = after
    ticks = "[...document.querySelectorAll('#particles input')].map(one => one.checked)"
    assert browser.ask(ticks) == [False, False, True]


def test_time_goes_on_and_paths_are_drawn(browser: Browser, page: Path) -> None:
    open_page(browser, page)
    first = browser.ask("sabenchView.objects.points.geometry.uuid")
    assert browser.ask("sabenchView.objects.lines") is None
    browser.press("//input[@aria-label='Frame']", "\ue014\ue014")
    assert "frame 2, t = 0.2 s" in browser.ask("document.querySelector('#time output').textContent")
    assert browser.ask("sabenchView.objects.points.geometry.uuid") != first
    # two steps back for each of 40 particles, two ends each
    count = "sabenchView.objects.lines.geometry.attributes.position.count"
    assert browser.ask(count) == 2 * 2 * 40
    browser.press("//input[@aria-label='velocities']", "\ue014")
    assert browser.ask("sabenchView.objects.arrows.geometry.attributes.position.count") == 2 * 40
    assert faults(browser) == []


@pytest.mark.slow_but_first
@pytest.mark.parametrize("key", ["\ue012", "\ue013", "+", "-"])
def test_keys_move_the_view_and_0_takes_it_back(browser: Browser, page: Path, key: str) -> None:
    open_page(browser, page)
    place = "sabenchView.space.camera.position.toArray()"
    home = np.array(browser.ask(place))
    browser.press("//div[@id='stage']/canvas", key)
    assert np.linalg.norm(np.array(browser.ask(place)) - home) > 0.1
    browser.press("//div[@id='stage']/canvas", "0")
    assert browser.ask(place) == pytest.approx(home.tolist())


@pytest.mark.slow_but_first
@pytest.mark.parametrize("width", [390, 1400])
def test_nothing_is_wider_than_the_screen(browser: Browser, pictured: Path, width: int) -> None:
    open_page(browser, pictured, width)
    browser.press("//summary")
    assert browser.ask("document.documentElement.scrollWidth") <= width
    names = browser.ask(
        "[...document.querySelectorAll('button, select, input, canvas[tabindex]')]"
        ".filter(one => !(one.ariaLabel || one.labels?.length || one.textContent)).length"
    )
    assert names == 0
    assert faults(browser) == []


@pytest.mark.slow
def test_particles_are_marked_where_the_image_shows_them(browser: Browser, pictured: Path) -> None:
    open_page(browser, pictured)
    script = """(() => {{
      const images = sabenchView.images, marks = [...images.marks()], canvas = images.picture.image;
      const own = document.createElement("canvas").getContext("2d");
      Object.assign(own.canvas, {{ width: canvas.width, height: canvas.height }});
      own.drawImage(canvas, 0, 0);
      const pixels = own.getImageData(0, 0, canvas.width, canvas.height).data;
      const at = (x, y) => pixels[4 * (Math.floor(y) * canvas.width + Math.floor(x))];
      const mean = values => values.reduce((a, b) => a + b, 0) / values.length;
      const inside = marks.filter(([, x, y]) => x > 0 && y > 0 && x < 320 && y < 240);
      return [inside.length, mean(inside.map(([, x, y]) => at(x, y))), mean([...pixels])];
    }})()"""
    for number in range(2):
        browser.wait("sabenchView.images.picture.image")
        count, marked, every = browser.ask(script.replace("{{", "{").replace("}}", "}"))
        assert count > 200, number
        assert marked > 100.0, number
        assert every < 80.0, number
        browser.press("//button[@aria-label='next camera']")
        browser.ask("new Promise(done => setTimeout(done, 200))")


def test_without_webgl_there_is_a_sentence_and_the_rest(browser: Browser, pictured: Path) -> None:
    added = browser.devtools("Page.addScriptToEvaluateOnNewDocument", source=NO_WEBGL)
    try:
        open_page(browser, pictured)
        assert "no WebGL" in browser.ask("document.getElementById('stage').textContent")
        assert browser.ask("document.getElementById('tables').open")
        assert browser.count("svg.drawing") == 2
        assert browser.ask("[...sabenchView.images.marks()].length") > 200
    finally:
        browser.devtools("Page.removeScriptToEvaluateOnNewDocument", **added)


@pytest.mark.slow
def test_without_scripts_there_are_drawings_and_tables(browser: Browser, pictured: Path) -> None:
    browser.devtools("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(pictured, width=1400)
        root = browser.devtools("DOM.getDocument")["root"]["nodeId"]
        found = browser.devtools("DOM.querySelector", nodeId=root, selector="noscript p")
        text = browser.devtools("DOM.getOuterHTML", nodeId=found["nodeId"])["outerHTML"]
        assert "allow it to run" in text
        drawings = browser.devtools("DOM.querySelectorAll", nodeId=root, selector="svg.drawing")
        assert len(drawings["nodeIds"]) == 2
    finally:
        browser.devtools("Emulation.setScriptExecutionDisabled", value=False)


@pytest.mark.slow
def test_many_points_are_drawn_by_the_page_in_software(browser: Browser, tmp_path: Path) -> None:
    file = tmp_path / "many.html"
    file.write_text(render_contents(moving(6000))[0], encoding="utf-8")
    open_page(browser, file)
    if not browser.ask("sabenchView.space.software"):
        pytest.skip("WebGL has a graphics card here")
    before = drawing(browser)
    browser.ask("(() => { sabenchView.objects.raster.canvas.style.visibility = 'hidden'; })()")
    points = np.abs(drawing(browser) - before).max(axis=2) > 20
    assert 0.002 < points.mean() < 0.5
    labels = """(() => {
      const { objects } = sabenchView, { canvas, context } = objects.raster;
      objects.material.uniforms.sizes.value.fill(0);  // no points
      objects.drawRaster();
      const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
      return data.filter((value, place) => place % 4 === 3 && value > 0).length;
    })()"""
    assert browser.ask(labels) > 100  # names and lengths lie on top
