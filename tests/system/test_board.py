"""The leaderboard as a file: its content, its order, and no markup from records."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sabench.evaluation.leaderboard import board, page_content
from sabench.evaluation.record_schema import Record
from sabench.plotting import pictures
from sabench.tasks import NAMES

HOSTILE = "</script><script>alert(1)</script><!--<script>"


def record(solver: str, q: float | None = None, **changes: Any) -> Record:
    unknown = "true_percent ghost_percent precision recall rms_px seconds peak_mb error pictures"
    hashes = {"scene_hash": "5c" * 32, "dataset": "da" * 32, "run_hash": "0123456789abcdef"}
    cpu = {"cpu": "some processor", "cores": 8, "system": "Linux", "backend": "llvm"}
    head = {"scene": "tank", "seed": 1, "renderer": "splat", "parameters": {}}
    head |= {"versions": {"numpy": "2.0"}, "machine": cpu, "solver": solver, "q": q}
    return dict.fromkeys(unknown.split()) | hashes | head | changes


def page_of(records: list[Record], folder: Path) -> str:
    board.build_page(records, folder / "pictures", folder / "index.html")
    return (folder / "index.html").read_text(encoding="utf-8")


def block(text: str, name: str = "data") -> Any:
    (found,) = re.findall(
        rf'<script type="application/json" id="{name}">(.*?)</script>', text, re.DOTALL
    )
    return json.loads(found)


def solvers(text: str) -> list[str]:
    data = block(text)
    return [data["texts"][row["solver"]] for row in data["rows"]]


def draw(folder: Path, names: list[str]) -> None:
    """Pictures of six small cameras and of a small volume under these names."""
    rng = np.random.default_rng(1)
    volume = rng.random((9, 30, 40)).astype(np.float32) ** 20
    folder.mkdir(parents=True)
    images = rng.integers(90, 3000, (6, 48, 64), dtype=np.uint16)
    (folder / "images.png").write_bytes(pictures.montage(images, 100.0, 4095.0))
    shown = pictures.slice_picture(volume, (slice(0, 9), slice(2, 28), slice(3, 37)))
    for name in names:
        (folder / name).write_bytes(shown)


STATIC = r'<section class="static">.*?</section>\n'


def without_data(text: str) -> str:
    return re.sub(r'(?<=id="data">).*?(?=</script>)', "", text, count=1, flags=re.DOTALL)


class Elements(HTMLParser):
    """The elements of a text with their attributes, and its words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, tuple[tuple[str, str | None], ...]]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, tuple(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.mark.slow
@pytest.mark.parametrize("name", [HOSTILE, "<img src=x>", "' onclick='x", "</table>", "&lt;b>"])
def test_no_text_of_a_record_is_markup(tmp_path: Path, name: str) -> None:
    """The page has the same elements, and the static table the text of the record as it is."""
    pages = []
    for own in ("plain", name):
        about = {"suite": own, "case": own, "card": {"paper": own}, "same_estimates_as": own}
        one = record(own, 0.5, label=own, scene=own, parameters={own: own}, **about)
        pages.append(page_of([one, record("b", error=own)], tmp_path))
    plain, hostile = (Elements(without_data(one)) for one in pages)
    assert plain.elements == hostile.elements
    assert len(plain.elements) > 8
    hostile = Elements("".join(re.findall(STATIC, without_data(pages[1]), re.DOTALL)))
    assert name in "".join(hostile.words)


def test_the_page_loads_nothing_and_runs_two_scripts_only(tmp_path: Path) -> None:
    text = page_of([record("a", 0.5)], tmp_path)
    policy = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert len(policy) == 1
    assert "default-src 'none'; img-src data:; style-src 'sha256-" in policy[0]
    assert "unsafe" not in policy[0]
    assert policy[0].count("sha256-") == 3
    loads = r"<link(?! rel=\"icon\" href=\"data:,\")|@import|url\(|<[a-z]+ src="
    assert not re.search(loads, text.replace(board.library(), ""))


def test_rows_are_ranked_and_cases_kept_apart(tmp_path: Path) -> None:
    records = [
        record("low", 0.1),
        record("unknown"),
        record("failed", error="it broke"),
        record("high", 0.9),
        record("alone", 0.5, case="tank-2"),
    ]
    text = page_of(records, tmp_path)
    assert solvers(text) == ["high", "low", "unknown", "failed", "alone"]
    assert [case["name"] for case in block(text)["cases"]] == ["tank", "tank-2"]
    assert text == page_of(records[::-1], tmp_path)


def test_what_the_gate_does_not_admit_comes_after_the_others(tmp_path: Path) -> None:
    def field(solver: str, error: float | None, share: float, **changes: Any) -> Record:
        scores = {"rms_voxel": error, "yield_percent": share}
        return record(solver, task="velocimetry", **scores, **changes)

    records = [
        field("little", 0.001, 49.9),
        field("good", 0.1, 90.0),
        field("a seed left out", 0.01, 90.0),
        field("a seed left out", None, 90.0, seed=2),
        field("fair", 0.3, 50.0),
    ]
    text = page_of(records, tmp_path)
    assert solvers(text)[:2] == ["good", "fair"]
    assert [row["ranked"] for row in block(text)["rows"]] == [True, True, False, False]
    gate = "rms voxel ranks results whose yield % is 50 or more."
    assert block(text)["tasks"]["velocimetry"]["gate"] == gate
    assert all("gate" in task for task in block(text)["tasks"].values())


def test_seeds_of_a_case_become_one_row(tmp_path: Path) -> None:
    seeds = [
        record("a", q, seed=seed, case="tank-0.1", axes={"particles.per_pixel": 0.1})
        for seed, q in ((2, 0.6), (1, 0.5), (3, 0.7))
    ]
    others = [
        record("b", 0.4, seed=1, case="tank-0.1"),
        record("a", 0.9, seed=1, case="tank-0.1", label="tuned", parameters={"k": 2}),
    ]
    data = block(page_of([*seeds, *others], tmp_path))
    assert [data["texts"][row["solver"]] for row in data["rows"]] == ["tuned", "a", "b"]
    assert [row["scores"][0] for row in data["rows"]] == [
        [0.9],
        [0.6, pytest.approx(0.248414, abs=1e-6)],
        [0.4],
    ]
    assert data["rows"][1]["seeds"] == [1, 2, 3]
    assert data["rows"][1]["values"][0] == [0.5, 0.6, 0.7]
    assert data["cases"][0]["axes"] == "particles.per_pixel 0.1"


def test_a_solver_that_could_read_the_truth_is_marked(tmp_path: Path) -> None:
    """One seed on a machine that could not confine it is enough; old records do not say."""
    records = [
        record("a", 0.9, seed=1, isolated=True),
        record("a", 0.9, seed=2, isolated=False),
        record("b", 0.8, isolated=True),
        record("c", 0.7),
    ]
    text = page_of(records, tmp_path)
    assert [row["open"] for row in block(text)["rows"]] == [True, False, False]
    (static,) = re.findall(STATIC, without_data(text), re.DOTALL)
    assert re.findall(r'<th scope="row">(.*?)</th>', static) == ["a (not isolated)", "b", "c"]


@pytest.mark.parametrize(
    "changes",
    [
        {"machine": {"cpu": "another"}},
        {"renderer": "mitsuba"},
        {"split": "hidden"},
        {"submission": {"name": "somebody", "date": "2026-01-02"}},
    ],
)
def test_what_is_not_the_same_entry_is_another_row(changes: dict[str, Any]) -> None:
    rows = board.over_seeds([record("a", 0.5), record("a", 0.6, seed=2, **changes)])
    assert [row["q"].mean for row in rows] == [0.5, 0.6]


def test_every_task_has_a_page(tmp_path: Path) -> None:
    data = block(page_of([record("a", task=task) for task in NAMES], tmp_path))
    assert list(data["tasks"]) == list(NAMES)
    assert all(task["pictured"]["heading"] for task in data["tasks"].values())


@pytest.mark.parametrize("name", ["../secret", "/secret", "a/../../secret", "link"])
def test_pictures_outside_the_folder_are_not_shown(tmp_path: Path, name: str) -> None:
    draw(tmp_path / "secret", ["truth.png"])
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "link").symlink_to(tmp_path / "secret")
    text = page_of([record("a", 0.5, pictures=name)], tmp_path)
    assert solvers(text) == ["a"]
    assert "album0" not in text


def test_the_bundled_pictures_are_those_of_the_bundled_records() -> None:
    folder = Path(__file__).resolve().parents[2] / "leaderboard" / "records"
    pictures = folder / "pictures"
    there = {path.relative_to(pictures).as_posix() for path in pictures.rglob("*.webp")}
    lines = (folder / "standard.jsonl").read_text(encoding="utf-8").splitlines()
    pictured = [one for one in map(json.loads, lines) if one["pictures"] and not one["error"]]
    assert len({one["case"] for one in pictured}) == 57
    for one in pictured:
        named = {"images", "truth", f"{one['solver']}-{one['run_hash'][:8]}"}
        assert {f"{one['pictures']}/{name}.webp" for name in named} <= there
    assert {Path(name).parent.name for name in there} == {one["pictures"] for one in pictured}


def test_pictures_are_those_of_the_seed_that_has_them(tmp_path: Path) -> None:
    draw(tmp_path / "pictures" / "tank-2", ["truth.png", "a-22222222.png", "a-22222222.error.png"])
    seeds = [
        record("a", 0.5, run_hash="11111111aa"),
        record("a", 0.6, seed=2, run_hash="22222222bb", pictures="tank-2"),
    ]
    assert set(block(page_of(seeds, tmp_path), "album0")) == {"images", "truth", "row0", "error0"}


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["run s --seed {} --solver a"] * 3, ["run s --seed 1 --seed 2 --seed 12 --solver a"]),
        (["run s --seed {}"] * 3, ["run s --seed 1 --seed 2 --seed 12"]),
        (["run s"] * 3, ["run s"]),
        (["run s --seed {}", "run t --seed {}", None], ["run s --seed 1", "run t --seed 2"]),
        ([None] * 3, []),
    ],
)
def test_one_command_makes_all_seeds_again(texts: list[str | None], expected: list[str]) -> None:
    runs = [
        record("a", seed=seed, command=text and f"sabench {text.format(seed)}")
        for seed, text in zip((1, 2, 12), texts, strict=True)
    ]
    assert page_content.commands(runs) == [f"sabench {one}" for one in expected]


def decoded(data: bytes) -> Any:
    return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_lone_pixel_survives_the_montage() -> None:
    images = np.full((5, 600, 900), 100, dtype=np.uint16)
    images[4, 599, 899] = 4095
    mosaic = decoded(pictures.montage(images, 100.0, 4095.0))
    assert mosaic.shape[1] <= 900
    assert (mosaic == 255).sum() == 1


def test_a_slice_shows_the_central_window_of_the_scored_part() -> None:
    volume = np.zeros((5, 320, 260), dtype=np.float32)
    scored = (slice(1, 4), slice(10, 310), slice(20, 240))
    # the window's first voxel: (300 - 200) / 2 down, (220 - 200) / 2 across
    volume[2, 10 + 50, 20 + 10] = 1.0
    volume[1, 160, 130] = volume[2, 10 + 49, 130] = 5.0  # another plane, another row
    shown = decoded(pictures.slice_picture(volume, scored))
    assert shown.shape == (400, 400)
    assert np.array_equal(np.argwhere(shown), [(0, 0), (0, 1), (1, 0), (1, 1)])


def bgr(data: bytes) -> Any:
    """The colour in the middle of each voxel of a picture of 10 x 10 voxels."""
    return decoded(data)[20::40, 20::40].astype(int)


def test_errors_have_the_sign_of_the_difference_and_do_not_depend_on_the_estimate_s_scale() -> None:
    scored = (slice(0, 3), slice(0, 10), slice(0, 10))
    truth, guess = np.zeros((3, 10, 10), dtype=np.float32), np.zeros((3, 10, 10), dtype=np.float32)
    truth[1, 2, 1:9] = guess[1, 2, 1:9] = 1.0  # found
    truth[1, 7, 7] = guess[1, 5, 1] = 1.0  # missed, and a ghost
    shown = bgr(pictures.error_slice(guess, truth, scored))
    assert np.array_equal(shown, bgr(pictures.error_slice(7.0 * guess, truth, scored)))
    blue, _, red = np.moveaxis(shown, -1, 0)
    assert blue[7, 7] > red[7, 7] + 100
    assert red[5, 1] > blue[5, 1] + 100
    right = np.ones((10, 10), dtype=bool)
    right[[7, 5], [7, 1]] = right[2] = False
    assert (shown[right] == 247).all()


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_the_truth_has_no_errors_and_nothing_misses_all(scale: float) -> None:
    truth = np.random.default_rng(1).random((3, 10, 10)).astype(np.float32)
    scored = (slice(0, 3), slice(0, 10), slice(0, 10))
    assert (bgr(pictures.error_slice(scale * truth, truth, scored)) >= 245).all()
    nothing = pictures.error_slice(np.zeros_like(truth), truth, scored)
    blue, _, red = np.moveaxis(bgr(nothing), -1, 0)
    assert (blue > red).all()
