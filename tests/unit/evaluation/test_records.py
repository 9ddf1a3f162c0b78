"""Records: many writers lose and tear nothing, and reading trusts nothing."""

import json
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from sabench import tasks
from sabench.evaluation.record_schema import RecordHead, score_faults
from sabench.evaluation.records import append, latest, read_records
from sabench.evaluation.solver_card import LONGEST_TEXT
from tests.conftest import ROOT
from tests.helpers.refusals import check_sentence, refused

WRITERS, LINES = 16, 40
FORKS = """
import multiprocessing
import sys
from pathlib import Path
from sabench.evaluation.records import append
head = {"scene": "tank", "scene_hash": "5c", "dataset": "da", "renderer": "splat"}
head |= {"parameters": {}, "run_hash": "0", "versions": {}, "machine": {}}
path, writers, lines = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
context = multiprocessing.get_context("fork")
start = context.Barrier(writers)

def write(name):
    start.wait()
    for seed in range(lines):
        append(path, head | {"solver": name, "seed": seed, "command": name * 3000})

children = [context.Process(target=write, args=(f"w{number}",)) for number in range(writers)]
for child in children:
    child.start()
for child in children:
    child.join()
sys.exit(any(child.exitcode for child in children))
"""


def record(solver: str, q: float | None = None, **changes: Any) -> dict[str, Any]:
    head = {"scene": "tank", "scene_hash": "5c" * 32, "dataset": "da" * 32, "seed": 1}
    head |= {"renderer": "splat", "solver": solver, "parameters": {}, "q": q}
    head |= {"versions": {"numpy": "2.0"}, "run_hash": "01", "machine": {"cpu": "some processor"}}
    return head | changes


def solvers(folder: Path) -> list[str]:
    return [found["solver"] for found in read_records(folder)]


def test_records_come_in_the_order_of_files_and_lines_with_defaults(tmp_path: Path) -> None:
    (tmp_path / "b.jsonl").write_text(json.dumps(record("third", 0.5)) + "\n")
    (tmp_path / "a.jsonl").write_text(
        json.dumps(record("first")) + "\n\n" + json.dumps(record("second")) + "\n"
    )
    assert solvers(tmp_path) == ["first", "second", "third"]
    head = RecordHead.model_validate(record("third")).model_dump()
    assert read_records(tmp_path)[2] == {**head, "q": 0.5}


@pytest.mark.parametrize("kept", [1, 10, -1])
def test_a_torn_last_line_is_left_out_and_cut_off_before_the_next(
    tmp_path: Path, kept: int, capsys: pytest.CaptureFixture[str]
) -> None:
    torn = json.dumps(record("pläne", label="x" * 100_000), ensure_ascii=False).encode()[:kept]
    file = tmp_path / "a.jsonl"
    file.write_bytes(json.dumps(record("whole")).encode() + b"\n" + torn)
    assert solvers(tmp_path) == ["whole"]
    append(file, record("next"))
    assert solvers(tmp_path) == ["whole", "next"]
    assert capsys.readouterr().err == ""


VALUES: dict[str, list[Any]] = {
    "case": [1, "\ud800"],
    "axes": [[]],
    "label": [["x"], "\x1b[2J"],
    "seed": [True, -1, 2**63],
    "version": [3],
    "submission": [{"name": "", "date": "x"}],
    "reference_s": [1.7e308, -1.0],
    "q": [2.5, 10**400, True, "0.9", [0.9]],
    "peak_f1_within_0.5": [1.5, "much"],
    "seconds": [-1.0],
    "peak_mb": [1e300],
    "recall": [1.5],
    "true_percent": [-3.0],
    "rms_px": [-0.5],
    "solver": ["x" * 201, "a\nb"],
    "command": ["sabench run s\nrm -r ."],
    "pictures": ["../../etc", "/etc", "a/../../b", "a\\b", "a\0b"],
    "parameters": [{"a": [[[[[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]]]]]}],
    "unknown": [{"a": 1}, "x" * 201],
    "x" * 201: [1],
}
DATES = ("9999-99-99", "2026-02-30")
WRONG: list[dict[str, Any]] = [{key: one} for key, every in VALUES.items() for one in every]
WRONG += [{"submission": {"name": "Ann", "date": date}} for date in DATES]
WRONG += [{"task": "calibration", "true_px": -1.0}]
BROKEN = [
    b"{",
    b"[1]",
    b'{"scene": "tank"}',
    b"\xff\xfe",
    json.dumps(record("x", float("nan"))).encode(),
    b"[" * 200_000,
    b"[" * 90_000,
    b"1" * 90_000,
    json.dumps(record("x")).encode()[:-1] + b', "seed": 2}',
    json.dumps(record("x")).encode().replace(b'"parameters": {', b'"parameters": {"a": 1, "a": 2'),
    json.dumps(record("x")).encode()[:-1] + b', "q": 1e999}',
    json.dumps(record("x", label="x\u00e9"), ensure_ascii=False).encode("latin-1"),
]
BROKEN += [json.dumps(record("x") | changes).encode() for changes in WRONG]


@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_line_is_named_and_left_out(
    tmp_path: Path, broken: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = json.dumps(record("whole")).encode()
    (tmp_path / "a.jsonl").write_bytes(whole + b"\n" + broken + b"\n" + whole + b"\n")
    assert solvers(tmp_path) == ["whole", "whole"]
    assert "a.jsonl: line 2" in " ".join(capsys.readouterr().err.split())


def test_long_lines_take_little_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (tmp_path / "a.jsonl").open("wb") as file:
        file.write(json.dumps(record("whole")).encode() + b"\n")
        for _ in range(100):
            file.write(b"x" * 1_000_000)
        file.write(b"\n" + json.dumps(record("next")).encode() + b"\n")
    tracemalloc.start()
    try:
        assert solvers(tmp_path) == ["whole", "next"]
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()
    assert f" {LONGEST_TEXT} " in capsys.readouterr().err


def test_warnings_are_short_and_few(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = json.dumps(record("x" * 5000, 5.0, seed=-1, case="\x1b" * 90)) + "\n"
    (tmp_path / "a.jsonl").write_text(line * 150)
    assert read_records(tmp_path) == []
    warnings = capsys.readouterr().err.splitlines()
    assert len(warnings) == 21
    assert max(map(len, warnings)) < 400 + len(str(tmp_path))
    check_sentence(warnings[-1], "130")


def test_every_bundled_record_is_kept(capsys: pytest.CaptureFixture[str]) -> None:
    folder = ROOT / "leaderboard" / "records"
    count = sum(len(path.read_text().splitlines()) for path in folder.glob("*.jsonl"))
    assert len(read_records(folder)) == count > 100
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("task", tasks.NAMES)
def test_ranges_of_scores(task: str) -> None:
    """No score that ranks can be better than the best possible one."""
    ranges = {score.key: score.range for score in tasks.of(task).all_scores}
    assert ranges["seconds"] == ranges["peak_mb"] == (0.0, 1e15)
    for score in tasks.of(task).all_scores:
        low, high = ranges[score.key]
        if score.counted and score.better == "larger":
            assert (low, high) == (0.0, 100.0 if score.unit == "%" else 1.0), score.key
    first = tasks.of(task).columns[0]
    assert ranges[first.key] in ((-1.0, 1.0), (0.0, 1.0), (0.0, 100.0), (0.0, 1e15))
    assert not list(score_faults(task, dict.fromkeys(ranges)))
    assert len(list(score_faults(task, {key: float("nan") for key in ranges}))) == len(ranges)


@pytest.mark.parametrize(
    "changes", [{"q": 2.5}, {"q": float("nan")}, {"solver": "x" * 201}, {"parameters": {"a": {1}}}]
)
def test_what_would_be_left_out_is_not_written(tmp_path: Path, changes: dict[str, Any]) -> None:
    with refused():
        append(tmp_path / "a.jsonl", record("x") | changes)
    assert not list(tmp_path.iterdir())


def test_the_first_of_a_submission_stays() -> None:
    by = {"name": "Ann", "date": "2026-01-01"}
    first, again = (record("a", q, submission=by) for q in (0.5, 0.9))
    others = [
        record("a", 0.6, submission=by | {"date": "2026-01-02"}),
        record("a", 0.7, submission=by, parameters={"k": 2}),
        record("a", 0.8, submission=by | {"name": "Bob"}),
    ]
    assert latest([first, again, *others]) == [first, *others]


def test_latest_keeps_the_last_of_each_run() -> None:
    old, new = record("a", 0.5), record("a", 0.6)
    changes: list[dict[str, Any]] = [
        {"seed": 2},
        {"parameters": {"passes": 2}},
        {"split": "hidden"},
    ]
    changes += [{"machine": {"cpu": "another"}}, {"renderer": "mitsuba"}]
    changes += [{"submission": {"name": "x", "date": "2026-01-01"}}]
    others = [record("b"), *(record("a", **one) for one in changes)]
    assert latest([old, *others, new]) == [new, *others]


def test_latest_decides_by_date_whichever_file_comes_last(tmp_path: Path) -> None:
    """`standard.jsonl` is read after `local.jsonl`."""
    dates = ("2026-01-02T00:00:00Z", "2026-01-01T23:59:59Z", None)
    for date, other in ((dates[0], dates[1]), (dates[1], dates[2])):
        folder = tmp_path / str(other)
        append(folder / "local.jsonl", record("a", 0.6, date=date))
        append(folder / "standard.jsonl", record("a", 0.5, date=other))
        every = read_records(folder)
        assert [one["q"] for one in every] == [0.6, 0.5]
        assert [one["q"] for one in latest(every)] == [0.6]


@pytest.mark.slow
def test_sixteen_writers_at_once_lose_and_tear_nothing(tmp_path: Path) -> None:
    file = tmp_path / "a.jsonl"
    subprocess.run([sys.executable, "-c", FORKS, str(file), str(WRITERS), str(LINES)], check=True)
    found = read_records(tmp_path)
    assert len(file.read_bytes().splitlines()) == len(found) == WRITERS * LINES
    for number in range(WRITERS):
        assert [one["seed"] for one in found if one["solver"] == f"w{number}"] == list(range(LINES))
