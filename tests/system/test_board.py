"""The leaderboard: records are read safely, the page escapes them, and it works in a browser."""

from __future__ import annotations

import contextlib
import html
import json
import re
import shutil
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench import board, pictures
from sabench.errors import InputError
from sabench.records import Record

HOSTILE = "<script>alert(1)</script>"
_FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-quic", "--no-proxy-server",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip


def record(solver: str, q: float | None = None, **changes: Any) -> Record:
    """A record as a run writes it, with only the scores that are asked for."""
    scores = dict.fromkeys(("q", "true_percent", "ghost_percent", "precision", "recall", "rms_px", "seconds", "peak_mb"))
    return {
        "scene": "tank", "scene_hash": "5c" * 32, "dataset": "da" * 32, "seed": 1, "renderer": "splat", "solver": solver,
        "parameters": {}, **scores, "q": q, "error": None, "versions": {"numpy": "2.0"}, "pictures": None, "run_hash": "0123456789abcdef",
        "machine": {"cpu": "some processor", "cores": 8, "system": "Linux", "backend": "llvm"}, **changes,
    }  # fmt: skip


def page_of(records: list[Record], folder: Path) -> str:
    """The page of these records as text."""
    board.build_page(records, folder / "pictures", folder / "index.html")
    return (folder / "index.html").read_text(encoding="utf-8")


def draw(folder: Path, names: list[str]) -> None:
    """Pictures of six small cameras and of a small volume under these names."""
    rng = np.random.default_rng(1)
    volume = rng.random((9, 30, 40)).astype(np.float32) ** 20
    folder.mkdir(parents=True)
    (folder / "images.png").write_bytes(pictures.montage(rng.integers(90, 3000, (6, 48, 64), dtype=np.uint16), 100.0, 4095.0))
    for name in names:
        (folder / name).write_bytes(pictures.slice_picture(volume, (slice(0, 9), slice(2, 28), slice(3, 37))))


# The page as text


def test_text_of_a_record_is_escaped(tmp_path: Path) -> None:
    hostile = record(HOSTILE, 0.5, scene="<img src=x onerror=alert(2)>", parameters={'"quoted"': "' onclick='alert(3)"})
    page = page_of([hostile, record("b", error="<b>bad</b>")], tmp_path)
    assert html.escape(HOSTILE) in page
    assert HOSTILE not in page
    assert "<img" not in page
    assert "<b>bad" not in page
    assert '"quoted"' not in page
    assert "' onclick=" not in page
    assert page.count("<script") == 1
    assert "alert" not in page[page.index("<script") :]


def test_half_a_surrogate_pair_does_not_stop_the_page(tmp_path: Path) -> None:
    assert "solver?" in page_of([record("solver\ud800", 0.5)], tmp_path)


def test_the_page_loads_nothing(tmp_path: Path) -> None:
    page = page_of([record("a", 0.5)], tmp_path)
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'" in page
    assert not re.search(r"https?:|url\(|@import|src=\"(?!data:)", page)


def test_rows_are_ranked_and_sections_kept_apart(tmp_path: Path) -> None:
    records = [record("low", 0.1), record("unknown"), record("failed", error="it broke"), record("high", 0.9), record("alone", 0.5, case="tank-2")]
    page = page_of(records, tmp_path)
    assert re.findall(r'<th scope="row">(\w+)', page) == ["high", "low", "unknown", "failed", "alone"]
    assert page.count("<table>") == 2
    assert page == page_of(records[::-1], tmp_path)


def test_seeds_of_a_case_become_one_row(tmp_path: Path) -> None:
    seeds = [record("a", q, seed=seed, case="tank-0.1", axes={"particles.per_pixel": 0.1}) for seed, q in ((2, 0.6), (1, 0.5), (3, 0.7))]
    page = page_of(
        [*seeds, record("b", 0.4, seed=1, case="tank-0.1"), record("a", 0.9, seed=1, case="tank-0.1", label="tuned", parameters={"k": 2})], tmp_path
    )
    assert re.findall(r'<th scope="row">(\w+)', page) == ["tuned", "a", "b"]
    assert re.findall(r'<td class="number" data-value="([^"]+)">(0\.[^<]+)<', page) == [("0.9", "0.900"), ("0.6", "0.600 ± 0.248"), ("0.4", "0.400")]
    assert "seeds 1, 2, 3" in page
    assert "particles.per_pixel 0.1" in page


def test_a_score_that_some_seeds_lack_is_the_mean_of_the_others() -> None:
    (row,) = board.over_seeds([record("a", 0.5, seed=1, rms_px=0.25), record("a", 0.7, seed=2, error="it broke")])
    assert (row["case"], row["seeds"], row["error"]) == ("tank", [1, 2], "1 of 2 seeds: it broke")
    assert (row["q"].mean, row["rms_px"].mean, row["rms_px"].half_width, row["recall"]) == (0.6, 0.25, None, None)


def test_another_machine_or_renderer_is_another_row() -> None:
    records = [record("a", 0.5), record("a", 0.6, seed=2, machine={"cpu": "another"}), record("a", 0.7, seed=2, renderer="mitsuba")]
    assert [row["q"].mean for row in board.over_seeds(records)] == [0.5, 0.6, 0.7]


def test_a_page_without_records_says_how_to_make_one(tmp_path: Path) -> None:
    assert "sabench run quick" in page_of([], tmp_path)


@pytest.mark.parametrize("name", ["../secret", "/secret", "a/../../secret"])
def test_pictures_outside_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "secret").mkdir()
    with pytest.raises(InputError, match="inside the folder"):
        page_of([record("a", 0.5, pictures=name)], tmp_path)


# Pictures


def decoded(data: bytes) -> Any:
    import cv2

    return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_lone_pixel_survives_the_montage() -> None:
    images = np.full((5, 600, 900), 100, dtype=np.uint16)
    images[4, 599, 899] = 4095
    mosaic = decoded(pictures.montage(images, 100.0, 4095.0))
    assert mosaic.shape[1] <= 900
    assert (mosaic == 255).sum() == 1


@pytest.mark.parametrize(("cameras", "shape"), [(1, (40, 60)), (3, (60, 40)), (10, (48, 64)), (16, (7, 900))])
def test_any_array_makes_a_montage(cameras: int, shape: tuple[int, int]) -> None:
    mosaic = decoded(pictures.montage(np.full((cameras, *shape), 100, dtype=np.uint16), 100.0, 4095.0))
    assert mosaic.shape[1] <= 900
    assert set(np.unique(mosaic)) <= {0, 200}


def test_a_slice_shows_the_central_window_of_the_scored_part() -> None:
    volume = np.zeros((5, 320, 260), dtype=np.float32)
    scored = (slice(1, 4), slice(10, 310), slice(20, 240))
    volume[2, 10 + 50, 20 + 10] = 1.0  # the window's first voxel: (300 - 200) / 2 down, (220 - 200) / 2 across
    volume[1, 160, 130] = volume[2, 10 + 49, 130] = 5.0  # another plane, another row
    shown = decoded(pictures.slice_picture(volume, scored))
    assert shown.shape == (400, 400)
    assert np.array_equal(np.argwhere(shown), [(0, 0), (0, 1), (1, 0), (1, 1)])


def test_an_empty_volume_is_black_and_an_empty_scored_part_is_refused() -> None:
    volume = np.zeros((3, 30, 50), dtype=np.float32)
    assert not decoded(pictures.slice_picture(volume, (slice(0, 3), slice(0, 30), slice(0, 50)))).any()
    with pytest.raises(ValueError, match="with voxels"):
        pictures.slice_picture(volume, (slice(0, 0), slice(0, 30), slice(0, 50)))


# The page in a browser


class Browser:
    """As much of WebDriver as these tests need; one session of a chromedriver on this machine."""

    def __init__(self, port: int, binary: str, profile: Path) -> None:
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        self._base = f"http://127.0.0.1:{port}/session"
        options = {"binary": binary, "args": [*_FLAGS, f"--user-data-dir={profile}"]}
        wanted = {"alwaysMatch": {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}}
        self._base += "/" + self._send("POST", "", {"capabilities": wanted})["sessionId"]

    def _send(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._base + path, data, {"Content-Type": "application/json"}, method=method)
        with self._opener.open(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def open(self, page: Path, width: int = 1200) -> None:
        metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self._send("POST", "/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": metrics})
        self._send("POST", "/url", {"url": page.as_uri()})

    def ask(self, script: str) -> Any:
        return self._send("POST", "/execute/sync", {"script": f"return {script};", "args": []})

    def press(self, heading: str, key: str | None = None) -> None:
        """Click the button of that heading in the first table, or press a key on it."""
        path = f"//th/button[text()='{heading}']"
        element = next(iter(self._send("POST", "/element", {"using": "xpath", "value": path}).values()))
        self._send("POST", f"/element/{element}/" + ("click" if key is None else "value"), {} if key is None else {"text": key})

    def solvers(self) -> list[str]:
        found: list[str] = self.ask("[...document.querySelector('tbody').rows].map(row => row.cells[0].textContent)")
        return found

    def complaints(self) -> list[str]:
        return [entry["message"] for entry in self._send("POST", "/se/log", {"type": "browser"})]

    def close(self) -> None:
        self._send("DELETE", "")


@contextlib.contextmanager
def driver(program: str) -> Iterator[int]:
    """A chromedriver on a free port; it is gone when the block ends."""
    with subprocess.Popen([program, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            started = (re.search(r"started successfully on port (\d+)", line) for line in process.stdout)
            yield next(int(match[1]) for match in started if match)
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    chromium, program = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or program is None:
        pytest.skip("chromium and chromedriver are not both on the PATH")
    with driver(program) as port, contextlib.closing(Browser(port, chromium, tmp_path_factory.mktemp("profile"))) as session:
        yield session


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four solvers, one of them hostile by name and one failed, on one scene with pictures, and a second scene without."""
    folder = tmp_path_factory.mktemp("page")
    draw(folder / "pictures" / "tank-1", ["truth.png", "add-01234567.png", "ten-01234567.png"])
    records = [
        record("add", 0.5, seconds=9.0, peak_mb=100.0, pictures="tank-1", parameters={"a_very_long_parameter_name_without_a_space": "x" * 60}),
        record("ten", 0.25, seconds=10.0, peak_mb=None, pictures="tank-1"),
        record(HOSTILE, None, seconds=200.0, peak_mb=99.5, pictures="tank-1", parameters={"a": '"><img src=x onerror="document.title=1">'}),
        record("broken", error="solver broken: its process ended with exit code -9"),
        record("add", 0.7, scene="x" * 100),
    ]
    board.build_page(records, folder / "pictures", folder / "index.html")
    return folder / "index.html"


def test_a_click_sorts_numbers_as_numbers_and_nulls_last(browser: Browser, page: Path) -> None:
    browser.open(page)
    assert browser.solvers() == ["add", "ten", HOSTILE, "broken"]
    browser.press("seconds")
    assert browser.solvers() == ["add", "ten", HOSTILE, "broken"]
    browser.press("seconds")
    assert browser.solvers() == [HOSTILE, "ten", "add", "broken"]
    browser.press("peak MB")
    assert browser.solvers() == [HOSTILE, "add", "ten", "broken"]
    browser.press("peak MB")
    assert browser.solvers() == ["add", HOSTILE, "ten", "broken"]


@pytest.mark.parametrize("key", ["\ue007", " "], ids=["enter", "space"])
def test_a_key_sorts_and_aria_says_so(browser: Browser, page: Path, key: str) -> None:
    sorted_by = "[...document.querySelectorAll('table')[0].querySelectorAll('[aria-sort]')].map(th => [th.textContent, th.ariaSort])"
    browser.open(page)
    assert browser.ask(sorted_by) == [["Q", "descending"]]
    browser.press("solver", key)
    assert browser.ask(sorted_by) == [["solver", "ascending"]]
    browser.press("solver", key)
    assert browser.ask(sorted_by) == [["solver", "descending"]]
    assert browser.solvers() == ["ten", "add", HOSTILE, "broken"]


def test_pictures_show_and_nothing_complains(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.press("Q")
    widths = browser.ask("[...document.images].map(image => image.naturalWidth)")
    assert len(widths) == 4
    assert min(widths) > 0
    assert browser.ask("[document.scripts.length, document.title]") == [1, "sabench leaderboard"]
    assert browser.complaints() == []


def test_the_policy_stops_what_comes_from_outside(browser: Browser, page: Path) -> None:
    """The test above would see a complaint: this one provokes it."""
    browser.open(page)
    browser.ask("document.body.append(Object.assign(new Image(), {src: 'absent.png'}))")
    assert any("Content Security Policy" in complaint for complaint in browser.complaints())


@pytest.mark.parametrize("width", [400, 1200])
def test_only_the_table_scrolls_sideways(browser: Browser, page: Path, width: int) -> None:
    browser.open(page, width)
    browser.ask("document.querySelectorAll('details').forEach(details => { details.open = true })")
    assert browser.ask("innerWidth") == width
    assert browser.ask("document.documentElement.scrollWidth") <= width
    assert browser.ask("[...document.querySelectorAll('.box')].every(box => getComputedStyle(box).overflowX === 'auto')")


def test_figures_that_no_solver_of_a_case_has_take_no_column(tmp_path: Path) -> None:
    page = page_of([record("a", 0.5, recall=None), record("b", 0.4, recall=0.7), record("c", None, scene="other", error="no light")], tmp_path)
    other, tank = (re.findall(">([^<>]+)</button>", head) for head in re.findall(r"<thead>(.*?)</thead>", page, re.S))
    assert tank == ["solver", "parameters", "Q", "recall", "machine"]
    assert other == ["solver", "parameters", "Q", "machine"]
