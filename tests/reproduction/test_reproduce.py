"""The command `sabench reproduce` on coarse copies of the arrays.

Also a missing folder.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

import sabench
from reproduction import MEASUREMENTS, chapter_2_density, chapter_5, report, reproduce
from reproduction.common import coarsen
from sabench import plugins
from sabench.evaluation.reproduction import Row
from sabench.evaluation.suite_loading import override
from sabench.plotting.charts import Figure
from sabench.scenes import Scene, load_scene
from sabench.utils.errors import InputError
from tests.conftest import Command

KEYS = {"name", "thesis", "measured", "verdict", "ci95", "seeds", "note"}
QUICK = ["--seeds", "2", "--pixels", "60"]


def test_rows_as_json_and_in_a_file(command: Command, tmp_path: Path) -> None:
    done = command("reproduce", "table-2-3", *QUICK, "--json", "-o", "rows.json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert json.loads((tmp_path / "rows.json").read_text()) == rows
    assert all(set(row) >= KEYS for row in rows)
    quality = next(row for row in rows if row["name"] == "Q of 13 cameras, additive")
    assert 0.5 < quality["measured"] < 1.0
    assert quality["seeds"] == 2
    assert quality["ci95"] > 0.0
    assert "particles, seed 2" in done.stderr


def test_rows_as_a_table(command: Command) -> None:
    done = command("reproduce", "table-2-3", *QUICK)
    assert done.returncode == 0, done.stderr
    assert "particles per pixel of all cameras" in done.stdout
    assert "reproduced" in done.stdout
    assert "125,000" in done.stdout


def test_curves_become_pictures(command: Command, tmp_path: Path) -> None:
    done = command("reproduce", "fig-4-27", "--figures", "pictures", "--json")
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)) == 17
    picture = cv2.imread(str(tmp_path / "pictures" / "fig-4-27.png"))
    assert picture is not None
    assert picture.shape[1] > picture.shape[0] > 200
    assert (picture.reshape(-1, 3) != 255).any(axis=1).mean() > 0.01


def test_a_page_shows_all_values_beside_the_curves(command: Command, tmp_path: Path) -> None:
    done = command("reproduce", "fig-4-27", "fig-4-9", "--figures", "pictures", "-o", "rows.json")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "pictures" / "index.html").read_text()
    assert page.count("<img ") == page.count('src="fig-4-27.png"') == 1
    assert 'href="#fig-4-9"' in page
    assert "turn, degrees 4: mean error, px" in page
    assert page.count("<tr><td>fig-") == 118


def test_rows_of_other_names_stay_in_the_file(command: Command, tmp_path: Path) -> None:
    other = {"item": "fig-2-6", "name": "a", "verdict": "exceeds"}
    old = {"item": "fig-4-9", "name": "b", "verdict": "exceeds"}
    (tmp_path / "rows.json").write_text(json.dumps([other, old]))
    done = command("reproduce", "fig-4-9", "-o", "rows.json")
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert other in rows
    assert old not in rows
    assert [row["item"] for row in rows].count("fig-4-9") == 2


def test_an_interrupted_measurement_keeps_the_rows_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
def test_a_file_of_something_else_is_not_overwritten(
    command: Command, tmp_path: Path, text: str
) -> None:
    (tmp_path / "rows.json").write_text(text)
    done = command("reproduce", "fig-4-9", "-o", "rows.json")
    assert done.returncode == 2
    assert "rows.json: expected rows that `sabench reproduce -o` wrote" in done.stderr
    assert (tmp_path / "rows.json").read_text() == text


def test_all_tables_and_figures_are_listed(command: Command) -> None:
    done = command("reproduce", "--list", "--json")
    assert done.returncode == 0, done.stderr
    entries = json.loads(done.stdout)
    assert [entry["name"][:3] for entry in entries] == ["tab"] * 7 + ["fig"] * 118
    assert "fig-c-21" in command("reproduce", "--list").stdout


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "expected names of tables and figures, all, or --list"),
        (("--list", "fig-2-6"), "expected no names beside --list, got fig-2-6"),
    ],
)
def test_names_or_list_are_needed(command: Command, words: tuple[str, ...], expected: str) -> None:
    done = command("reproduce", *words)
    assert done.returncode == 2
    assert expected in done.stderr


def test_an_unknown_table_is_refused(command: Command) -> None:
    done = command("reproduce", "table-9")
    assert done.returncode == 2
    assert "expected one of all, table-2-1, table-2-1-best, fig-2-4, fig-2-6" in done.stderr
    assert "Traceback" not in done.stderr


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
    "fig-1-3",
    "flow-behind-bodies",
    "drops-over-time",
    "three-phases",
    "section-2-2-2",
    "fig-6-5",
    "fig-6-6",
    "table-5-2",
    "fig-2-17",
    "fig-5-7",
    "fig-5-15",
    "fig-5-22",
    "fig-5-21",
    "fig-5-24",
    "fig-5-28",
    "fig-2-18",
    "fig-4-16",
    "fig-4-18",
    "fig-4-23",
    "fig-4-25",
    "fig-4-28",
    "fig-6-3",
    "appendix-c",
    "fig-2-7-cameras",
)


def seen_by_nine(name: str) -> Scene:
    """Load a scene of 5 x 5 cameras with every other one of them."""
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
    "three-phases": {
        "_BUBBLES": ("separated_bubbles",),
        "_TRACERS": ("ray_triangulation",),
    },
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


@pytest.fixture(autouse=True)
def one_jet_and_a_fast_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chapter_5, "HEIGHTS", (21,))
    monkeypatch.setattr(chapter_5, "SOLVER", "minimum_image")
    monkeypatch.setattr(chapter_5, "FRAMES", 3)


@pytest.mark.parametrize("table", [name for name in MEASUREMENTS if name != "table-2-1-best"])
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


def test_a_missing_folder_is_an_error_that_says_where_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.setattr(plugins, "bundled_folder", lambda kind: tmp_path / kind)
    for words in (["--list"], ["fig-4-9"]):
        done = command("reproduce", *words)
        assert done.returncode == 2
        assert f"{tmp_path / 'reproduction'}: expected the reproduction" in done.stderr
        assert "copy the folder reproduction/ of sabench's source repository" in done.stderr
    with pytest.raises(InputError, match="source repository"):
        sabench.reproduce(["fig-4-9"])


def test_the_public_function_yields_rows_and_figures() -> None:
    found = list(sabench.reproduce(["fig-4-27"], seeds=1))
    assert {type(one) for one in found} == {Row, Figure}
    assert {one.item for one in found if isinstance(one, Row)} == {"fig-4-27"}
