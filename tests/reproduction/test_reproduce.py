"""The command reproduce: catalogue, results, passages and page."""

import itertools
import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import sabench
from reproduction import MEASUREMENTS, catalogue, chapter_2_density, chapter_5, report, reproduce
from reproduction.chapter_2_cameras import by_cameras, falls_to
from reproduction.chapter_2_density import crossings, plane_spacing_mm
from reproduction.chapter_6_jet import count_passages
from reproduction.common import (
    at_least,
    cases,
    claim,
    coarsen,
    density,
    make_row,
    per_pixel,
    verdict,
    with_density,
)
from reproduction.page import render
from reproduction.refocused_frames import METHODS, measure_quality
from sabench import plugins
from sabench.evaluation.reproduction import Row
from sabench.evaluation.suite_loading import override
from sabench.evaluation.suites import SceneCase
from sabench.plotting.drawing import Figure
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.in_memory import make_particles
from sabench.utils.errors import InputError
from tests.conftest import Command
from tests.docs.pages import ROOT
from tests.helpers.commands import refuse, succeed
from tests.helpers.refusals import check_sentence, refused

KEYS = {"name", "thesis", "measured", "verdict", "ci95", "seeds", "note"}
QUICK = ["--seeds", "2", "--pixels", "60"]


@pytest.mark.slow
def test_rows_as_json_in_a_file_and_as_a_table(command: Command, tmp_path: Path) -> None:
    done = succeed(command("reproduce", "table-2-3", *QUICK, "--json", "-o", "rows.json"))
    rows = json.loads(done.stdout)
    assert json.loads((tmp_path / "rows.json").read_text()) == rows
    assert all(set(row) >= KEYS for row in rows)
    quality = next(row for row in rows if row["name"] == "Q of 13 cameras, additive")
    assert 0.5 < quality["measured"] < 1.0
    assert quality["seeds"] == 2
    assert quality["ci95"] > 0.0
    assert "particles, seed 2" in done.stderr
    done = succeed(command("reproduce", "table-2-3", *QUICK))
    assert "particles per pixel of all cameras" in done.stdout
    assert "reproduced" in done.stdout
    assert "125,000" in done.stdout


@pytest.mark.slow
def test_curves_and_values_are_on_a_page(command: Command, tmp_path: Path) -> None:
    words = ("--figures", "pictures", "--json", "-o", "rows.json")
    done = succeed(command("reproduce", "fig-4-27", "fig-4-9", *words))
    assert Counter(row["item"] for row in json.loads(done.stdout))["fig-4-27"] == 17
    picture = cv2.imread(str(tmp_path / "pictures" / "fig-4-27.png"))
    assert picture is not None
    assert picture.shape[1] > picture.shape[0] > 200
    assert (picture.reshape(-1, 3) != 255).any(axis=1).mean() > 0.01
    page = (tmp_path / "pictures" / "index.html").read_text()
    assert page.count("<img ") == page.count('src="fig-4-27.png"') == 1
    assert 'href="#fig-4-9"' in page
    assert "turn, degrees 4: mean error, px" in page
    assert page.count("<tr><td>fig-") == 118


def test_rows_of_other_names_stay_in_the_file(command: Command, tmp_path: Path) -> None:
    other = {"item": "fig-2-6", "name": "a", "verdict": "exceeds"}
    old = {"item": "fig-4-9", "name": "b", "verdict": "exceeds"}
    (tmp_path / "rows.json").write_text(json.dumps([other, old]))
    succeed(command("reproduce", "fig-4-9", "-o", "rows.json"))
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert other in rows
    assert old not in rows
    assert [row["item"] for row in rows].count("fig-4-9") == 2


@pytest.mark.slow
def test_an_interruption_keeps_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the first ones of the new rows: `--list` would take them for all."""

    def stopped(names: list[str], *given: int | None) -> Iterator[Row | Figure]:
        found = list(reproduce(names, *given))
        if names == ["fig-4-27"]:
            yield found[0]
            raise KeyboardInterrupt
        yield from found

    monkeypatch.setattr(report, "reproduce", stopped)
    file = tmp_path / "rows.json"
    old = [{"item": name, "name": "a", "verdict": "exceeds"} for name in ("fig-4-27", "fig-4-9")]
    file.write_text(json.dumps(old))
    with pytest.raises(KeyboardInterrupt):
        report.measure(["fig-4-9", "fig-4-27"], None, None, file, None)
    rows = json.loads(file.read_text())
    assert [row["item"] for row in rows] == ["fig-4-27", "fig-4-9", "fig-4-9"]
    assert old[0] in rows


@pytest.mark.parametrize("text", ['{"a": 1}', "[1]", "no JSON", '[{"item": "fig-4-9"}]'])
def test_other_files_are_not_overwritten(command: Command, tmp_path: Path, text: str) -> None:
    (tmp_path / "rows.json").write_text(text)
    check_sentence(refuse(command("reproduce", "fig-4-9", "-o", "rows.json")).stderr, "rows.json")
    assert (tmp_path / "rows.json").read_text() == text


def test_all_tables_and_figures_are_listed(command: Command) -> None:
    done = succeed(command("reproduce", "--list", "--json"))
    assert [entry["name"][:3] for entry in json.loads(done.stdout)] == ["tab"] * 7 + ["fig"] * 118
    assert "fig-c-21" in command("reproduce", "--list").stdout


@pytest.mark.parametrize(("words", "key"), [((), "--list"), (("--list", "fig-2-6"), "fig-2-6")])
def test_names_or_list_are_needed(command: Command, words: tuple[str, ...], key: str) -> None:
    refuse(command("reproduce", *words), key)


def test_an_unknown_table_is_refused(command: Command) -> None:
    refuse(command("reproduce", "table-9"), "table-9", *MEASUREMENTS)
    with pytest.raises(InputError) as caught:
        reproduce(["table-2-4"])
    assert re.search(r"table-2-4: .*; did you mean table-2-\d\?", str(caught.value))
    assert all(one.title for one in MEASUREMENTS.values())


@pytest.mark.slow
def test_the_best_tomographic_solver_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chapter_2_density, "SOLVERS", ("mlos_sart", "mlos_smart"))
    row = next(reproduce(["table-2-1-best"], 2, 60))
    assert isinstance(row, Row)
    assert row.name == "50x50x10-D0.2: Q at 15 per mm3"
    assert row.note.split(";")[0] in ("mlos_sart", "mlos_smart")
    assert row.seeds == 2
    assert row.measured is not None
    assert row.verdict == ("reproduced" if row.measured >= 0.75 else "below")


SLOW = (
    *("fig-1-3", "flow-behind-bodies", "drops-over-time", "three-phases", "section-2-2-2"),
    *("fig-6-5", "fig-6-6", "table-5-2", "fig-2-17", "fig-5-7", "fig-5-15", "fig-5-22", "fig-5-21"),
    *("fig-5-24", "fig-5-28", "fig-2-18", "fig-4-16", "fig-4-18", "fig-4-23", "fig-4-25"),
    *("fig-4-28", "fig-6-3", "appendix-c", "fig-2-7-cameras"),
)


def seen_by_nine(name: str) -> Scene:
    layout = {"kind": "grid", "columns": 3, "rows": 3, "spacing_mm": [120.0, 120.0]}
    return override(load_scene(name), {"cameras.layout": layout}, name)


JOINT = {"joint": "refractive_autocal"}
SHORTER: dict[str, dict[str, Any]] = {  # of what takes long, fewer kinds and cameras
    "fig-2-7-cameras": {"_CALIBRATIONS": ("refractive_autocal",), "_RECONSTRUCTIONS": ("msa",)},
    "fig-2-17": {"_SOLVERS": (("asa", "piv3d_plain"),)},
    "fig-2-18": {"_VOLUMES": ("asa",), "_PIV": ("piv3d_plain",)},
    "fig-1-3": {"_METHODS": ("additive",), "load_scene": seen_by_nine},
    "section-2-2-2": {"_JOINS": ("additive",), "_STEP_MM": 5.0, "load_scene": seen_by_nine},
    "fig-6-5": {"_SOLVERS_OF_FRAMES": ("minimum_image",)},
    "flow-behind-bodies": {
        "_SCENES": {"propeller": "flow-behind-propeller"},
        "_CAMERAS": {5: (1, 3, 4, 5, 7)},
        "_SOLVERS": ("ray_triangulation",),
    },
    "drops-over-time": {"_SOLVERS_OVER_TIME": ("minimum_image",), "FRAMES": 2},
    "three-phases": {"_BUBBLES": ("separated_bubbles",), "_TRACERS": ("ray_triangulation",)},
    "fig-4-16": {"STARTS": (0.01,)},
    "appendix-c": {"STARTS": (0.001,), "EVERY_NOISE": (0.5,)},
    "fig-4-23": {"SOLVERS": JOINT, "STEPS": {"test 1": 4.0}},
    "fig-4-28": {"SOLVERS": JOINT},
    "fig-6-3": {
        "_SHIFTS_PX": (),
        "_SOLVERS": {"linear": "linear_autocal"},
        "coarsen": lambda scene, pixels: coarsen(scene, 160),
    },
    "fig-4-25": {"STEPS": {"test 1": 4.0}},
}


_QUICK = {"fig-4-9", "table-5-1"}  # of the daily tier


@pytest.fixture(autouse=True)
def one_jet_and_a_fast_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chapter_5, "HEIGHTS", (21,))
    monkeypatch.setattr(chapter_5, "SOLVER", "minimum_image")
    monkeypatch.setattr(chapter_5, "FRAMES", 3)


@pytest.mark.parametrize(
    "table",
    [
        pytest.param(name, marks=() if name in _QUICK else pytest.mark.slow)
        for name in MEASUREMENTS
        if name != "table-2-1-best"
    ],
)
def test_every_table_yields_rows(table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SHORTER.get(table, {}).items():
        monkeypatch.setattr(f"reproduction.{MEASUREMENTS[table].module}.{name}", value)
    pixels = 300 if table.startswith(("fig-5", "table-5-2")) else 60  # bubbles need outlines
    items = reproduce([table], 1 if table in SLOW else 2, pixels)
    rows = (item for item in items if isinstance(item, Row))
    found = list(itertools.islice(rows, 1 if table in SLOW else 4))
    assert found
    for row in found:
        assert row.name
        assert row.verdict
        assert row.measured is not None


def test_a_missing_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.setattr(plugins, "bundled_folder", lambda kind: tmp_path / kind)
    for words in (["--list"], ["fig-4-9"]):
        refuse(command("reproduce", *words), f"{tmp_path / 'reproduction'}")
    with refused():
        sabench.reproduce(["fig-4-9"])


def test_the_public_function_yields_rows_and_figures() -> None:
    found = list(sabench.reproduce(["fig-4-27"], seeds=1))
    assert {type(one) for one in found} == {Row, Figure}
    assert {one.item for one in found if isinstance(one, Row)} == {"fig-4-27"}


@pytest.mark.parametrize(
    ("measured", "thesis", "better", "expected"),
    [
        (1.04, 1.0, "larger", "reproduced"),
        (0.96, 1.0, "larger", "reproduced"),
        (1.06, 1.0, "larger", "exceeds"),
        (0.94, 1.0, "larger", "below"),
        (-1.04, -1.0, "larger", "reproduced"),
        (1.04, 1.0, "smaller", "reproduced"),
        (0.94, 1.0, "smaller", "exceeds"),
        (1.06, 1.0, "smaller", "below"),
        (1.06, 1.0, "neither", "differs"),
        (3.0, None, "larger", catalogue.UNSTATED),
        (1.0, None, "neither", catalogue.UNSTATED),
    ],
)
def test_verdicts(measured: float, thesis: float | None, better: Any, expected: str) -> None:
    """A smaller error exceeds, and a quantity differs."""
    assert verdict(measured, thesis, better) == expected


def test_rows_hold_the_mean_over_seeds_a_bound_or_a_claim() -> None:
    row = make_row("x", 2.0, [1.0, 2.0, 3.0], "note")
    assert (row.measured, row.verdict, row.seeds, row.note) == (2.0, "reproduced", 3, "note")
    assert row.ci95 == pytest.approx(2.484, abs=1e-3)
    missing = make_row("x", 2.0, [])
    assert (missing.measured, missing.ci95, missing.verdict) == (None, None, "not reached")
    for measured, expected in (([0.8, 0.9], "reproduced"), ([0.74], "below"), ([], "below")):
        assert at_least("x", 0.75, measured).verdict == expected
    for holds, expected in ((True, "reproduced"), (False, "not reproduced")):
        assert claim("x", "it falls", 0.5, holds).verdict == expected


@pytest.mark.parametrize("start", [0.5, 3.0, 20.0])
def test_the_crossing_is_found_from_either_side(start: float) -> None:
    """Q falls as a straight line: it is 0.75 at 3.0 for seed 1, and at 3.1 for seed 2."""

    def quality(per_mm3: float, seed: int) -> float:
        return 0.75 - 0.05 * (per_mm3 - 3.0 - 0.1 * (seed - 1))

    assert crossings(quality, start, [1, 2]) == pytest.approx([3.0, 3.1])
    assert crossings(lambda per_mm3, seed: 0.9, start, [1]) == []


def test_the_first_fall_below_a_level() -> None:
    assert falls_to(0.75, [0.0, 1.0, 2.0], [0.9, 0.8, 0.7]) == pytest.approx(1.5)
    assert falls_to(0.75, [0.0, 1.0], [0.9, 0.8]) is None
    assert falls_to(0.75, [0.0, 1.0], [0.7, 0.6]) is None


@pytest.mark.parametrize("case", cases("table-2-1"), ids=lambda case: str(case.name))
def test_plane_spacing_is_that_of_equation_2_10(case: SceneCase) -> None:
    rig = build_rig(case.scene)
    across, _, along = rig.grid.voxel_mm
    distance = -rig.cameras[12].center_mm[2]
    baseline = (rig.cameras[13].center_mm[0] - rig.cameras[12].center_mm[0]) / distance
    expected = across / baseline / (1.0 - across / (baseline * distance))
    found = plane_spacing_mm(rig.cameras[12], rig.cameras[13], across)
    assert found == pytest.approx(expected, rel=1e-9)
    assert along == pytest.approx(expected, rel=0.01)


def test_a_coarse_copy_has_the_same_cameras_and_as_many_particles_per_pixel() -> None:
    scene = with_density(load_scene("thesis-50x50x10"), 6.0)
    coarse = coarsen(scene, 100)
    assert coarsen(scene, None) == scene
    assert per_pixel(coarse) == pytest.approx(per_pixel(scene)) == 0.15
    assert density(coarse) == pytest.approx(0.06)
    assert len(make_particles(coarse, 1, 0)) == 1500
    fine_rig, coarse_rig = build_rig(scene), build_rig(coarse)
    assert coarse_rig.grid.shape == (8, 100, 100)
    for fine, small in zip(fine_rig.cameras, coarse_rig.cameras, strict=True):
        assert (small.center_mm, small.rotation) == (fine.center_mm, fine.rotation)
        assert small.principal_distance_mm == pytest.approx(fine.principal_distance_mm, rel=1e-12)


def test_numbers_of_cameras_are_those_of_the_cases() -> None:
    found = by_cameras("fig-2-7a")
    assert [cameras for cameras, _ in found] == [5, 9, 13, 17, 21, 25] * 3
    densities = [density(case.scene) for _, case in found]
    np.testing.assert_allclose(densities, np.repeat([2.0, 3.0, 5.0], 6))


@pytest.mark.slow
def test_quality_falls_with_density_and_depends_on_the_threshold() -> None:
    scene = load_scene("array-9")
    scenes = (coarsen(with_density(scene, per_mm3), 100) for per_mm3 in (1.0, 8.0))
    few, many = (measure_quality(one, 1) for one in scenes)
    for method in METHODS:
        assert few[method].best > many[method].best > 0.5
        assert few[method].best >= few[method].blind > 0.9 * few[method].best


CHAPTERS = {"1": 3, "2": 19, "3": 8, "4": 31, "5": 30, "6": 6, "c": 21}
BEYOND = {  # ours, or claims in the text
    *("table-2-1-best", "fig-2-7-cameras", "section-2-2-2", "section-2-3-2", "section-2-4"),
    *("section-3-2-1", "fig-5-28", "flow-behind-bodies", "drops-over-time", "three-phases"),
}


def test_it_holds_every_table_and_figure_once() -> None:
    names = [entry.name for entry in catalogue.read_catalogue()]
    tables = [name for name in names if name.startswith("table-")]
    numbers = ("2-1", "2-2", "2-3", "3-1", "4-1", "5-1", "5-2")
    assert tables == [f"table-{number}" for number in numbers]
    figures = [name for name in names if name.startswith("fig-")]
    expected = [f"fig-{chapter}-{n + 1}" for chapter in CHAPTERS for n in range(CHAPTERS[chapter])]
    assert sorted(figures) == sorted(expected)


def test_what_measures_an_entry_exists_and_all_that_measures_is_in_it() -> None:
    entries = catalogue.read_catalogue()
    used = {entry.item for entry in entries if entry.item}
    assert used == set(MEASUREMENTS) - BEYOND
    assert all(bool(entry.item) != bool(entry.unmeasured) for entry in entries)
    assert not [entry.name for entry in entries if entry.rows and not entry.item]


def test_every_entry_has_rows_in_the_record() -> None:
    rows = catalogue.read_rows(catalogue.MEASURED)
    measured = {row["item"] for row in rows}
    for entry in catalogue.read_catalogue():
        if entry.item in measured:
            assert catalogue.rows_of(entry, rows), entry.name
    assert not [row["name"] for row in rows if row["pixels"]]


ROWS = [("Q of nine", "reproduced"), ("Q of five", "exceeds"), ("spread", catalogue.UNSTATED)]


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (catalogue.Entry("fig-1", "", "here"), "1 reproduced, 1 exceeds"),
        (catalogue.Entry("fig-1", "", "here", "nine"), "reproduced"),
        (catalogue.Entry("fig-1", "", "here", "spread"), "measured; the thesis has no value"),
        (catalogue.Entry("fig-1", "", "there"), "not measured yet"),
        (catalogue.Entry("fig-1", "", unmeasured="photograph"), "photograph"),
    ],
)
def test_verdicts_are_summed_up(entry: catalogue.Entry, expected: str) -> None:
    rows = [{"item": "here", "name": name, "verdict": verdict} for name, verdict in ROWS]
    assert catalogue.judge(entry, rows) == expected


FOLDER = ROOT / "docs" / "results"
SECTIONS: list[dict[str, Any]] = tomllib.loads(
    (ROOT / "reproduction" / "results.toml").read_text(encoding="utf-8")
)["section"]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda one: str(one["title"]))
def test_tables_are_rectangular_and_commands_exist(section: dict[str, Any]) -> None:
    for table in section.get("table", ()):
        assert {len(row) for row in table["rows"]} == {len(table["columns"])}
    words = section.get("command", "sabench reproduce").partition(" --")[0].split()
    assert words[:2] == ["sabench", "reproduce"]
    assert set(words[2:]) <= set(MEASUREMENTS)


def test_the_page_has_every_image_and_verdict_and_its_links_lead_to_files() -> None:
    page = render()
    targets = re.findall(r"\]\(([^()\s]+)\)", page)
    assert len(targets) > 40
    assert not [target for target in targets if not (FOLDER / target).is_file()]
    shown = set(re.findall(r"reproduction/images/([\w-]+)\.png", page))
    assert shown == {file.stem for file in (ROOT / "reproduction" / "images").iterdir()}
    lines = re.findall(r"^\| (?:table|fig)-\S+ \| .+ \| .+ \| .* \|$", page, re.MULTILINE)
    assert len(lines) == 125


START = np.arange(-50.0, 0.0, 0.5) + 0.25  # drops at 10 mm/s, one every 0.5 mm: 20 a second pass


@pytest.mark.parametrize(
    ("along", "numbers", "at", "expected"),
    [
        # 1 passes in the second frame and comes back, 2 is beyond from the start, 3 passes last
        ([[0.0, 2.0, -1.0], [1.5, 3.0, 0.5], [0.5, 4.0, 2.0]], [[1, 2, 3]] * 3, 1.0, [0, 1, 2]),
        ([[0.0], [], [2.0]], [[7], [], [7]], 1.0, [0, 0, 1]),  # it misses the frame at the plane
        ([[0.0], [2.0]], [[1], [2]], 1.0, [0, 0]),  # a broken trajectory
        ([START, START + 10.0, START + 20.0], [np.arange(100)] * 3, 0.0, [0, 20, 40]),
    ],
)
def test_a_trajectory_counts_once_and_only_from_before_to_beyond(
    along: list[Any], numbers: list[Any], at: float, expected: list[int]
) -> None:
    places = [np.array(one, dtype=np.float64) for one in along]
    assert count_passages(places, [np.array(one, np.int64) for one in numbers], at) == expected
