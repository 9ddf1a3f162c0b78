"""The leaderboard: standings of submissions, safe archives, and curves."""

import gzip
import io
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.evaluation.leaderboard.archives import submitted_files
from sabench.evaluation.leaderboard.board import over_seeds
from sabench.evaluation.leaderboard.cells import mean_rank, ranks, ranks_of_distinct
from sabench.evaluation.leaderboard.page_content import cases_of
from sabench.evaluation.leaderboard.standings import Board, boards_of, curves_of
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import latest, read_records
from tests.helpers.refusals import refused
from tests.system.test_board import record

SEEDS = (1, 2, 3, 4, 5)


def results(solver: str, scores: dict[str, tuple[float, ...]], **changes: Any) -> list[Record]:
    made = []
    for level, values in scores.items():
        own: dict[str, Any] = {"suite": "trial"} | dict.fromkeys(
            ("case", "scene_hash", "difficulty"), level
        )
        for seed, q in zip(SEEDS, values, strict=False):
            run = {"seed": seed, "dataset": f"{level}-{seed}", "rms_px": 0.1 + q / 7.0}
            made.append(record(solver, q, **(own | run | changes)))
    return made


def around(value: float, scatter: float = 0.01) -> tuple[float, ...]:
    """Scores of five seeds."""
    return tuple(value + scatter * one for one in (0.0, 1.0, -1.0, 0.5, -0.5))


def easy(solver: str, q: float, **changes: Any) -> list[Record]:
    return results(solver, {"easy": around(q)}, **changes)


def board(records: list[Record]) -> Board:
    (only,) = boards_of(cases_of(over_seeds(records)))
    return only


def standing(records: list[Record]) -> dict[str, tuple[int | None, list[int | None], list[str]]]:
    """Place, ranks and notes of every line by its solver."""
    found = {}
    for line in board(records).lines:
        ranks, notes = [cell.rank for cell in line.cells], [cell.note for cell in line.cells]
        found[line.result.row["solver"]] = line.place, ranks, notes
    return found


def places(records: list[Record]) -> dict[str, int | None]:
    return {name: place for name, (place, *_) in standing(records).items()}


def test_entries_that_seeds_cannot_tell_apart_share_a_rank() -> None:
    """Pairs tell more apart than intervals do: seeds are more or less difficult for everybody."""
    close = np.array([around(0.80, 0.05), around(0.79, 0.05)[::-1], around(0.5, 0.05)])
    assert ranks(close, larger=True) == [1, 1, 3]
    assert ranks(-close, larger=False) == [1, 1, 3]
    hard = np.array(around(0.0, 0.2))
    assert ranks(np.array([0.80 + hard, 0.79 + hard]), larger=True) == [1, 2]


def test_ranks_follow_the_order_of_the_entries() -> None:
    rng = np.random.default_rng(1)
    scores = rng.random((7, 1)) + 0.1 * rng.random((7, 5))
    order = rng.permutation(7)
    found = ranks(scores, larger=True)
    assert ranks(scores[order], larger=True) == [found[row] for row in order]
    assert ranks(3.0 * scores + 2.0, larger=True) == found


def test_neither_scatter_nor_a_result_sent_again_nor_a_missing_case_improves_a_rank() -> None:
    """Nobody beats the third beyond chance, but the second is better."""
    scores = np.array([[0.9] * 5, [0.8] * 5, [0.1, 0.99, 0.1, 0.99, 0.4]])
    assert ranks(scores, larger=True) == [1, 2, 2]
    scores = np.array([[0.9], [0.9], [0.9], [0.8]])
    assert ranks_of_distinct(scores, True, ["a", "a", "a", "b"]) == [1, 1, 1, 2]
    assert ranks_of_distinct(scores, True, ["a", "c", "d", "b"]) == [1, 1, 1, 4]
    assert mean_rank([1, None, 3], [4, 4, 4]) == 3.0
    assert mean_rank([1, 2], [2, 2]) == 1.5


def test_solvers_are_placed_by_their_mean_rank() -> None:
    good = results("good", {"easy": around(0.9), "hard": around(0.8)})
    assert standing([*results("fair", {"easy": around(0.7), "hard": around(0.6)}), *good]) == {
        "good": (1, [1, 1], ["", ""]),
        "fair": (2, [2, 2], ["", ""]),
    }


def test_one_lucky_seed_ranks_before_nobody() -> None:
    five = [*easy("a", 0.7), *easy("b", 0.6)]
    found = standing([*five, *results("lucky", {"easy": (0.99,)})])
    assert list(found) == ["a", "b", "lucky"]
    assert found["lucky"] == (None, [None], ["1 of 5 seeds"])
    crowd = [one for n in range(9) for one in results(f"lucky {n}", {"easy": (0.99,)})]
    assert standing([*five, *crowd])["a"][0] == 1


def test_a_submission_with_further_seeds_makes_nobody_incomplete() -> None:
    sent = {"submission": {"name": "Ann", "date": "2026-01-02"}}
    more = [
        {**one, "seed": seed, "dataset": f"easy-{seed}"}
        for seed, one in enumerate(easy("much", 0.1, **sent) * 2, 1)
    ]
    found = standing([*easy("a", 0.7), *more])
    assert found["a"] == (1, [1], [""])
    assert found["much"] == (2, [2], [""])


def test_a_solver_that_misses_a_case_comes_after_the_others() -> None:
    whole, hard = {"easy": around(0.5), "hard": around(0.4)}, {"hard": around(0.0)}
    records = [
        *results("whole", whole),
        *easy("easy only", 0.9),
        *[*easy("declines", 0.8), *results("declines", hard, error="no", declined=True)],
        *[*easy("fails", 0.8), *results("fails", hard, error="it broke")],
    ]
    found = standing(records)
    assert next(iter(found)) == "whole"
    assert found["whole"][0] == 1
    assert found["easy only"][2] == ["", "not measured"]
    assert found["declines"][2] == ["", "declined"]
    assert found["fails"][2] == ["", "failed"]
    assert [place for place, *_ in found.values()] == [1, None, None, None]


def test_a_seed_that_failed_makes_a_result_incomplete() -> None:
    one = easy("one", 0.9)
    one[3] |= {"error": "it broke", "q": None}
    assert standing([*one, *easy("other", 0.1)])["one"][0] is None


def test_the_gate_of_the_task_holds() -> None:
    records = [
        record(name, task="velocimetry", rms_voxel=error, yield_percent=share, suite="trial")
        for name, error, share in (("little", 0.001, 10.0), ("good", 0.1, 90.0))
    ]
    assert standing(records)["little"] == (None, [None], ["not ranked"])


def test_a_result_sent_under_another_name_shares_the_line_of_the_first() -> None:
    sent = {"submission": {"name": "Eve", "date": "2026-01-02"}}
    lines = board([*easy("copy", 0.8, **sent), *easy("original", 0.8), *easy("third", 0.7)]).lines
    assert [line.result.row["solver"] for line in lines] == ["original", "third"]
    assert [line.place for line in lines] == [1, 2]
    assert [one["solver"] for one in lines[0].also] == ["copy"]


def test_equal_counts_alone_are_not_one_result() -> None:
    """Two solvers may both find everything."""
    records = [record(name, 1.0, suite="trial", peak_f1=1.0) for name in ("a", "b")]
    found = standing([one | {"q": 1.0} for one in records])
    assert set(found) == {"a"}  # Q is measured: to the last digit equal is one result
    counted = [
        record(name, task="see_through", read_percent=100.0, suite="trial") for name in ("a", "b")
    ]
    assert places(counted) == {"a": 1, "b": 1}


def test_one_solver_on_two_machines_is_one_entry() -> None:
    records = [
        *easy("a", 0.8),
        *results("a", {"easy": (0.99,)}, machine={"cpu": "another"}),
        *easy("b", 0.7),
    ]
    assert places(records) == {"a": 1, "b": 2}


def test_another_version_of_a_case_or_of_its_data_is_not_compared() -> None:
    old = easy("old", 0.9, scene_hash="older", date="2026-01-01T00:00:00Z")
    new = easy("new", 0.1, date="2026-02-01T00:00:00Z")
    assert list(standing([*old, *new])) == ["new"]
    other = [one | {"identity": "of an older simulation", "scene_hash": "easy"} for one in old]
    found = standing([*other, *new])
    assert found["new"][0] == 1
    assert found["old"] == (None, [None], ["0 of 5 seeds"])


def test_suites_renderers_and_splits_have_standings_of_their_own() -> None:
    records = [
        *easy("a", 0.8),
        *easy("a", 0.8, suite="other", scene_hash="another"),
        *easy("a", 0.8, renderer="mitsuba"),
        *easy("a", 0.8, split="hidden"),
    ]
    found = boards_of(cases_of(over_seeds(records)))
    assert len({(one.suite, one.renderer, one.split) for one in found}) == len(found) == 4


def test_a_record_that_says_less_of_its_case_is_compared_with_the_others() -> None:
    """As older records do, and submissions of data sets that nobody has run."""
    found = board([*easy("old", 0.7, suite=None, difficulty=None), *easy("new", 0.8)])
    assert [line.place for line in found.lines] == [1, 2]
    assert found.columns[0].name == "easy"


def test_a_column_of_several_cases_is_their_mean() -> None:
    records = [
        one | {"case": f"{one['case']}-{number}", "scene_hash": f"{number}"}
        for number in (1, 2)
        for one in easy("a", 0.2 * number)
    ]
    only = board(records)
    (cell,) = only.lines[0].cells
    assert only.columns[0].cases == (0, 1)
    assert cell.score is not None
    assert cell.score.mean == pytest.approx(0.3)
    assert cell.score.count == 5


def test_speed_counts_above_the_stated_score_only() -> None:
    runs = ("slow", 0.9, 9.0), ("quick", 0.8, 2.0), ("wrong", 0.1, 0.1), ("unknown", 0.85, None)
    made = (easy(name, q, seconds=seconds, reference_s=0.5) for name, q, seconds in runs)
    records = [one for own in made for one in own]
    cells = {line.result.row["solver"]: line.cells[0] for line in board(records).lines}
    assert [name for name, cell in cells.items() if cell.fastest] == ["quick"]
    assert len(cells) == 4
    assert not cells["wrong"].sufficient
    assert cells["quick"].kernels == 4.0


Make = Callable[[Path], Path]


def zipped(
    path: Path, members: dict[str, bytes], mode: int = 0, method: int = zipfile.ZIP_DEFLATED
) -> Path:
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in members.items():
            info = zipfile.ZipInfo(name)
            info.external_attr, info.compress_type = mode << 16, method
            file.writestr(info, content)
    return path


def taped(
    path: Path, name: str, content: bytes = b"", kind: bytes = tarfile.REGTYPE, target: str = ""
) -> Path:
    with tarfile.open(path, "w:gz" if path.suffix == ".gz" else "w") as file:
        info = tarfile.TarInfo(name)
        info.type, info.linkname, info.size = kind, target, len(content)
        file.addfile(info, io.BytesIO(content))
    return path


@pytest.mark.parametrize("ending", ["zip", "tar", "tar.gz"])
def test_result_files_come_out_as_they_went_in(tmp_path: Path, ending: str) -> None:
    path, content = tmp_path / f"a.{ending}", bytes(range(256)) * 50
    if ending == "zip":
        others = dict.fromkeys(("notes.txt", "__MACOSX/._two.h5", "__MACOSX/._card.toml"), b"none")
        zipped(path, {"b/two.h5": content, "b/card.toml": b"card", **others})
    else:
        taped(path, "b/two.h5", content)
    with submitted_files(path) as found:
        assert [(name, one.read_bytes()) for name, one in found.results] == [("b/two.h5", content)]
        assert [name for name, _ in found.cards] == ["b/card.toml"] * (ending == "zip")
        places = [file for _, file in (*found.results, *found.cards)]
    assert not any(place.exists() for place in places)


def test_a_folder_and_a_single_file(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("b.h5", "in/a.h5", "notes.txt", "in/my.card.toml"):
        (tmp_path / name).write_bytes(b"x")
    with submitted_files(tmp_path) as found:
        assert [name for name, _ in found.results] == ["b.h5", "in/a.h5"]
        assert [name for name, _ in found.cards] == ["in/my.card.toml"]
    with submitted_files(tmp_path / "notes.txt") as found:
        assert [name for name, _ in found.results] == ["notes.txt"]


def same_names(path: Path) -> Path:
    with tarfile.open(path, "w") as file:
        for _ in range(2):
            file.addfile(tarfile.TarInfo("a.h5"))
    return path


def no_zip(path: Path) -> Path:
    path.write_bytes(b"PK no zip")
    return path


def long_name(path: Path) -> Path:
    """An archive with a member's name of 100 MB, which a reader would hold in memory."""
    info = tarfile.TarInfo("././@LongLink")
    info.type, info.size = tarfile.GNUTYPE_LONGNAME, 100_000_000
    path.write_bytes(gzip.compress(info.tobuf(tarfile.GNU_FORMAT) + bytes(100_000_000), 1))
    return path


LARGE, LINK = bytes(50_000_000), 0o120777
BAD: dict[str, Make] = {
    "a.zip": lambda path: zipped(path, {"/etc/x.h5": b"x"}),
    "b.zip": lambda path: zipped(path, {"a/../../x.h5": b"x"}),
    "c.zip": lambda path: zipped(path, {"c:\\x.h5": b"x"}),
    "d.zip": lambda path: zipped(path, {"x.h5": b"/etc/passwd"}, LINK),
    "e.zip": lambda path: zipped(path, {"x.h5": b"x"}, method=zipfile.ZIP_LZMA),
    "f.zip": lambda path: zipped(path, {"a.h5": LARGE}),
    "g.zip": lambda path: zipped(path, {f"{number}.h5": b"" for number in range(1001)}),
    "h.zip": lambda path: zipped(path, {"notes.txt": b"x"}),
    "i.zip": no_zip,
    "j.tar": lambda path: taped(path, "x.h5", kind=tarfile.SYMTYPE, target="/etc/passwd"),
    "k.tar": lambda path: taped(path, "x.h5", kind=tarfile.LNKTYPE, target="../x"),
    "l.tar": lambda path: taped(path, "x.h5", kind=tarfile.CHRTYPE),
    "m.tar": lambda path: taped(path, "../x.h5", b"x"),
    "n.tar.gz": lambda path: taped(path, "x.h5", LARGE),
    "o.tar.gz": long_name,
    "p.tar": same_names,
}


@pytest.mark.parametrize("name", BAD)
def test_dishonest_archives_are_refused(tmp_path: Path, name: str) -> None:
    path = BAD[name](tmp_path / name)
    with refused(name), submitted_files(path):
        pytest.fail("it was opened")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("part", ["", "a.h5"])
def test_links_in_folders(tmp_path: Path, part: str) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.h5").symlink_to("/etc/passwd")
    with refused("a.h5"), submitted_files(tmp_path / "in" / part):
        pytest.fail("it was opened")


RECORDS = Path(__file__).resolve().parents[3] / "leaderboard" / "records"


def found(records: list[Record]) -> list[tuple[str, list[tuple[float, str]]]]:
    cases = cases_of(over_seeds(records))
    name = [case[0]["case"] for case in cases]
    curves = curves_of(cases)
    return [(one.quantity, [(value, name[at]) for value, at in one.points]) for one in curves]


def varied(name: str, axes: dict[str, Any], **changes: Any) -> Record:
    head: dict[str, Any] = {"case": name, "scene_hash": name, "suite": "trial", "axes": axes}
    return record("a", 0.5, **{**head, **changes})


def test_varied_values_make_a_curve_for_each_value_of_the_others() -> None:
    records = [
        varied(f"{ppp}-{n}", {"particles.per_pixel": ppp, "frames": n})
        for ppp in (0.1, 0.05, 0.2)
        for n in (1, 3)
    ]
    curves = found(records)
    assert [curve for curve in curves if curve[0] == "particles per pixel"] == [
        ("particles per pixel", [(ppp, f"{ppp}-{n}") for ppp in (0.05, 0.1, 0.2)]) for n in (1, 3)
    ]
    assert [name for name, _ in curves] == ["particles per pixel"] * 2 + ["frames"] * 3


@pytest.mark.parametrize("key", ["suite", "scene", "renderer", "split"])
def test_cases_of_other_suites_scenes_and_renderers_are_apart(key: str) -> None:
    other = {"split": "hidden"}.get(key, "other")
    assert found([varied("a", {"x": 1.0}), varied("b", {"x": 2.0}, **{key: other})]) == []


def test_recorded_cases_and_cases_without_numbers_make_no_curve() -> None:
    assert found([varied("a", {}), varied("b", {})]) == []
    for value in ("text", True, None, [1.0], {"kind": "grid"}):
        assert found([varied("a", {"x": value}), varied("b", {"x": 2.0})]) == []
    head: dict[str, Any] = {"recorded": True, "task": "particles"}
    assert found([varied(name, {"x": n}, **head) for n, name in enumerate("ab")]) == []


def test_bundled_scenes_are_compared_as_a_whole() -> None:
    records = latest(read_records(RECORDS))
    curves = dict(found([one for one in records if one["task"] == "reconstruction"]))
    assert curves["cameras"] == [(4, "reconstruction-cameras"), (9, "reconstruction-standard")]
    assert curves["calibration error, px"][0] == (0.0, "reconstruction-standard")
    names = {name for points in curves.values() for _, name in points}
    assert not names & {"reconstruction-easy", "reconstruction-hard"}
