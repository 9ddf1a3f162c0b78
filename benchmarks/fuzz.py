"""Damaged files, given to the functions behind the commands that read them.

Files are scenes, suites, data sets, results, submissions and records.

    python benchmarks/fuzz.py 10000 [--seed 0] [--kind scene ...] [--limit 5] [--keep build/fuzz]

Each must be refused with one sentence (an InputError) or succeed, within the limit, without a
crash, without another exception and without touching a file outside the output folder. Cases are
made from the seed, the kind and a number alone. Prints a table. Files that cause a fault are kept
with its message, and the exit code is 1. Runs in one forked process at a time, which is replaced
when it dies or hangs; a hang counts when it is repeated.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
from sabench.utils.errors import InputError  # noqa: E402
from sabench.utils.processes import isolated_reading  # noqa: E402
from tests.helpers.untrusted import KINDS, Base, check_sentence, make_base  # noqa: E402

_LIMIT_S = 5.0
_WARM_S, _MAKE_S = 120.0, 60.0
_ADDRESSES = 16_000_000_000  # bytes: what asks for more than this shall have been refused before
_OUTCOMES = ("refused", "accepted", "fault")


def fuzz(
    kinds: list[str], count: int, seed: int, limit_s: float, root: Path, keep: Path
) -> dict[str, Counter[str]]:
    """Count outcomes by kind of `count` cases, which alternate between the kinds."""
    with multiprocessing.get_context("fork").Pool(
        1
    ) as elsewhere:  # once kernels have run in parallel, a process may not fork
        base = elsewhere.apply(make_base, (root / "base",))
    table = {kind: Counter[str]() for kind in kinds}
    with contextlib.ExitStack() as stack:
        worker = Worker(base, root, seed, limit_s)
        stack.callback(lambda: worker.stop())
        for number in range(count):
            kind = kinds[number % len(kinds)]
            outcome, words = worker.case(kind, number)
            if outcome == "hang":  # another program may have held the machine up
                outcome, words = worker.case(kind, number)
            if outcome in ("hang", "crash"):
                outcome, words = "fault", f"{outcome}: {words}"
            table[kind][outcome] += 1
            folder = root / "cases" / f"{kind}-{number}"
            if outcome == "fault":
                _keep(folder, keep / folder.name, words)
            shutil.rmtree(folder, ignore_errors=True)
            if sys.stderr.isatty() or number % 500 == 499:
                print(
                    f"{number + 1} of {count}",
                    end="\r" if sys.stderr.isatty() else "\n",
                    file=sys.stderr,
                    flush=True,
                )
    return table


def _keep(folder: Path, copy: Path, words: str) -> None:
    print(f"fault: {copy}: {words.strip().splitlines()[-1][:200]}", file=sys.stderr, flush=True)
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy, symlinks=True)
    (copy / "fault.txt").write_text(words, encoding="utf-8", errors="replace")


class Worker:
    """Forked process that makes and runs one case after the other."""

    def __init__(self, base: Base, root: Path, seed: int, limit_s: float) -> None:
        self._settings, self._limit_s = (base, root, seed, 0.6 * limit_s), limit_s
        self._process: BaseProcess | None = None
        self._pipe: Connection

    def case(self, kind: str, number: int) -> tuple[str, str]:
        """Run a case: refused, accepted, fault, crash or hang, and its message."""
        if self._process is None:
            self._start()
        self._pipe.send((kind, number))
        made = self._answer(_MAKE_S)
        return made if made[0] != "made" else self._answer(self._limit_s)

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, *self._settings))
        self._process.start()
        theirs.close()
        outcome, words = self._answer(_WARM_S)
        if outcome != "warm":
            raise RuntimeError(f"undamaged input fails: {outcome}, {words}")

    def _answer(self, limit_s: float) -> tuple[str, str]:
        assert self._process is not None
        try:
            if self._pipe.poll(limit_s):
                answer: tuple[str, str] = self._pipe.recv()
                return answer
            fate = "hang", f"no end within {limit_s:g} s"
        except (EOFError, ConnectionResetError):
            self._process.join()
            fate = "crash", f"exit code {self._process.exitcode}"
        self.stop()
        return fate

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
        self._process = None


def _work(pipe: Connection, base: Base, root: Path, seed: int, probe_s: float) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    silent = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(silent, number)
    (root / "tmp").mkdir(exist_ok=True)
    tempfile.tempdir = str(root / "tmp")
    isolated_reading._CPU_S = probe_s  # below the limit that is tested here
    try:
        _warm_up(base, root)
        pipe.send(("warm", ""))
    except BaseException:
        pipe.send(("fault", traceback.format_exc()))
        return
    while True:
        kind, number = pipe.recv()
        pipe.send(
            _run_case(
                pipe,
                base,
                root / "cases" / f"{kind}-{number}",
                kind,
                random.Random(f"{seed} {kind} {number}"),
            )
        )


def _warm_up(base: Base, root: Path) -> None:
    """Load and compile what the cases need, outside their limits."""
    from sabench.tasks.solve_and_score import score, solve

    out = root / "warm" / str(os.getpid())
    out.mkdir(parents=True)
    solve("asa", base.particles, out / "a.h5", parameters={"k": 3.0})
    score(base.particles, out / "a.h5")
    for track, path in base.results.items():
        if track == "bubbles":
            continue  # its scores need bubbles; the case feeds the reading alone
        score(base.target if track == "calibration" else base.particles, path)
    from sabench.evaluation.leaderboard.submissions import submit

    submit(base.results["reconstruction"], "warm", [base.particles.root], out / "leaderboard")


def _run_case(
    pipe: Connection, base: Base, folder: Path, kind: str, rng: random.Random
) -> tuple[str, str]:
    inputs, out = folder / "in", folder / "out"
    shutil.rmtree(folder, ignore_errors=True)
    for path in (inputs, out):
        path.mkdir(parents=True)
    os.chdir(inputs)
    root = folder.parents[1]
    try:
        feed = KINDS[kind](base, inputs, out, rng)
    except Exception:
        return "fault", f"the case could not be made: {traceback.format_exc()}"
    before = dict(_tree(root, out))
    pipe.send(("made", ""))
    try:
        outcome, words = _outcome(feed)
        changed = dict(_tree(root, out)).items() ^ before.items()
        left = [str(path) for path in out.rglob(".*.partial-*")]
        assert not changed, (
            f"files outside the output folder changed: {sorted(name for name, _ in changed)[:3]}"
        )
        assert not left, f"half-written files are left: {left}"
    except Exception:
        return "fault", traceback.format_exc()
    return outcome, words


def _outcome(feed: Any) -> tuple[str, str]:
    try:
        feed()
    except InputError as error:
        check_sentence(str(error))
        return "refused", str(error)
    return "accepted", ""


def _tree(root: Path, out: Path) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """List all files below the root, without the output folder, and their stamps."""
    for path, folders, files in os.walk(root):
        if Path(path) == out:
            folders.clear()
            continue
        for name in (*files, *folders):
            full = os.path.join(path, name)  # noqa: PTH118 (many files, many times)
            if full != str(out):
                entry = os.lstat(full)
                yield (
                    full,
                    (
                        entry.st_mode,
                        entry.st_size if name in files else 0,
                        entry.st_mtime_ns if name in files else 0,
                    ),
                )


def main() -> None:
    """Read the command line, fuzz, print the table."""
    reader = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    reader.add_argument("count", type=int)
    reader.add_argument("--seed", type=int, default=0)
    reader.add_argument("--kind", action="append", choices=sorted(KINDS))
    reader.add_argument("--limit", type=float, default=_LIMIT_S, help="seconds for each case")
    reader.add_argument("--keep", type=Path, default=ROOT / "build" / "fuzz")
    asked = reader.parse_args()
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        table = fuzz(
            asked.kind or sorted(KINDS),
            asked.count,
            asked.seed,
            asked.limit,
            Path(folder),
            asked.keep.absolute(),
        )
    print(
        f"{'kind':<12}{'count':>8}"
        + "".join(f"{name + ('s' if name == 'fault' else ''):>10}" for name in _OUTCOMES)
    )
    for kind, row in [*table.items(), ("all", sum(table.values(), Counter()))]:
        print(
            f"{kind:<12}{sum(row.values()):>8}" + "".join(f"{row[name]:>10}" for name in _OUTCOMES)
        )
    print(f"seed {asked.seed}, {time.monotonic() - start:.0f} s")
    sys.exit(any(row["fault"] for row in table.values()))


if __name__ == "__main__":
    main()
