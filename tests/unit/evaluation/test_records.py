"""Records: many writers lose and tear nothing, and reading trusts nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sabench.evaluation.records import Head, append, latest, read_records

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
        append(path, head | {"solver": name, "seed": seed, "label": name * 3000})

children = [context.Process(target=write, args=(f"w{number}",)) for number in range(writers)]
for child in children:
    child.start()
for child in children:
    child.join()
sys.exit(any(child.exitcode for child in children))
"""


def record(solver: str, q: float | None = None, **changes: Any) -> dict[str, Any]:
    """A record as a run writes it."""
    return {
        "scene": "tank",
        "scene_hash": "5c" * 32,
        "dataset": "da" * 32,
        "seed": 1,
        "renderer": "splat",
        "solver": solver,
        "parameters": {},
        "q": q,
        "versions": {"numpy": "2.0"},
        "run_hash": "01",
        "machine": {"cpu": "some processor"},
        **changes,
    }


def solvers(folder: Path) -> list[str]:
    return [found["solver"] for found in read_records(folder)]


def test_records_come_in_the_order_of_files_and_lines_with_defaults(tmp_path: Path) -> None:
    (tmp_path / "b.jsonl").write_text(json.dumps(record("third", 0.5)) + "\n")
    (tmp_path / "a.jsonl").write_text(
        json.dumps(record("first")) + "\n\n" + json.dumps(record("second")) + "\n"
    )
    assert solvers(tmp_path) == ["first", "second", "third"]
    assert read_records(tmp_path)[2] == {
        **Head.model_validate(record("third")).model_dump(),
        "q": 0.5,
    }


def test_no_folder_holds_no_records(tmp_path: Path) -> None:
    assert read_records(tmp_path / "absent") == []


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


def test_a_file_that_is_one_torn_line_starts_anew(tmp_path: Path) -> None:
    (tmp_path / "a.jsonl").write_bytes(b"x" * 200_000)
    append(tmp_path / "a.jsonl", record("next"))
    assert (tmp_path / "a.jsonl").read_bytes().count(b"x") < 10
    assert solvers(tmp_path) == ["next"]


WRONG: list[dict[str, Any]] = [
    {"case": 1},
    {"axes": []},
    {"label": ["x"]},
    {"seed": True},
    {"version": 3},
    {"track": "x"},
    {"submission": {"name": "", "date": "x"}},
]
BROKEN = [
    b"{",
    b"[1]",
    b'{"scene": "tank"}',
    b"\xff\xfe",
    json.dumps(record("x", float("nan"))).encode(),
    b"[" * 200_000,
]
BROKEN += [json.dumps(record("x", **changes)).encode() for changes in WRONG]


@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_line_is_named_and_left_out(
    tmp_path: Path, broken: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = json.dumps(record("whole")).encode()
    (tmp_path / "a.jsonl").write_bytes(whole + b"\n" + broken + b"\n" + whole + b"\n")
    assert solvers(tmp_path) == ["whole", "whole"]
    assert "a.jsonl: line 2 is left out: expected a record" in " ".join(
        capsys.readouterr().err.split()
    )


def test_latest_keeps_the_last_of_each_run() -> None:
    old, new = record("a", 0.5), record("a", 0.6)
    others = [
        record("b"),
        record("a", seed=2),
        record("a", parameters={"passes": 2}),
        record("a", split="hidden"),
        record("a", machine={"cpu": "another"}),
        record("a", renderer="mitsuba"),
        record("a", submission={"name": "x", "date": "2026-01-01"}),
    ]
    assert latest([old, *others, new]) == [new, *others]


def test_sixteen_writers_at_once_lose_and_tear_nothing(tmp_path: Path) -> None:
    file = tmp_path / "a.jsonl"
    words = [sys.executable, "-c", FORKS, str(file), str(WRITERS), str(LINES)]
    subprocess.run(words, check=True)
    found = read_records(tmp_path)
    assert len(file.read_bytes().splitlines()) == len(found) == WRITERS * LINES
    for number in range(WRITERS):
        assert [one["seed"] for one in found if one["solver"] == f"w{number}"] == list(range(LINES))


def test_records_of_version_1_call_the_task_track(tmp_path: Path) -> None:
    old = record("old") | {"version": 1, "track": "bubbles"}
    old.pop("task", None)
    new = record("new") | {"version": 2, "task": "particles"}
    (tmp_path / "a.jsonl").write_text(f"{json.dumps(old)}\n{json.dumps(new)}\n")
    found = read_records(tmp_path)
    assert [(one["task"], one["version"]) for one in found] == [("bubbles", 2), ("particles", 2)]
    assert all("track" not in one for one in found)
