"""Damaged files, given to the functions behind the commands that read them.

Files are scenes, suites, data sets of all kinds, results of all tasks, submissions, records,
baselines, secrets, interrupted generations, fields and tracks and meshes of other programs, and
folders of `sabench calibrate`.

    python benchmarks/fuzz.py --count 100000 [--jobs 8] [--seed 0] [--kind scene ...]

Each must be refused with one sentence (an InputError) or succeed, within 5 s of CPU time and 1.5 GB
of memory, without a crash, without another exception and without touching a file outside the output
folder. Cases are made from the seed, the kind and a number alone: `--only NUMBER --kind KIND` runs
one again. Prints a table with a line for each kind. Files that cause a fault are kept with its
message, and the exit code is 1. Each job runs its cases in a forked process, which is replaced when
it dies or hangs; a hang counts when it is repeated.
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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
from sabench.utils import backend, memory  # noqa: E402
from sabench.utils.errors import InputError  # noqa: E402
from sabench.utils.processes import call  # noqa: E402
from tests.helpers.untrusted import (  # noqa: E402
    KINDS,
    Base,
    check_sentence,
    make_base,
    solve_here,
)
from tests.helpers.untrusted_files import describe_calibration  # noqa: E402

_LIMIT_S = 5.0  # of CPU time
_PATIENCE = 12.0  # times as much of real time
_WARM_S, _MAKE_S = 300.0, 60.0
_LOOK_S = 0.2  # between looks at the memory of a case
_MOST_MB = 1500.0  # of one process
_LARGEST_KEPT = 1 << 28  # bytes of a file
_ADDRESSES = 16_000_000_000  # bytes: what asks for more than this shall have been refused before
_OUTCOMES = ("refused", "accepted", "traceback", "crash", "hang", "memory")
_FAULTS = _OUTCOMES[2:]


@dataclass
class Tally:
    """Outcomes and seconds by kind, and the largest memory of a process, MB."""

    outcomes: dict[str, Counter[str]]
    seconds: dict[str, float]
    peak_mb: float = 0.0

    def add(self, other: Tally) -> None:
        """Add those of another job."""
        for kind, row in other.outcomes.items():
            self.outcomes.setdefault(kind, Counter()).update(row)
        for kind, seconds in other.seconds.items():
            self.seconds[kind] = self.seconds.get(kind, 0.0) + seconds
        self.peak_mb = max(self.peak_mb, other.peak_mb)


@dataclass(frozen=True)
class Plan:
    """Cases of a run: their numbers, and kinds that alternate."""

    kinds: tuple[str, ...]
    numbers: range
    seed: int
    limit_s: float
    keep: Path


def fuzz(plan: Plan, root: Path, jobs: int) -> Tally:
    """Run all cases of a plan, in several jobs."""
    fork = multiprocessing.get_context("fork")
    with fork.Pool(1) as elsewhere:  # once kernels have run in parallel, a process may not fork
        base = elsewhere.apply(make_base, (root / "base",))
    total = _empty(plan)
    with ProcessPoolExecutor(jobs, mp_context=fork) as pool:
        rest = [
            pool.submit(_job, replace(plan, numbers=plan.numbers[job::jobs]), base, root, job)
            for job in range(jobs)
        ]
        for one in rest:
            total.add(one.result())
    return total


def _empty(plan: Plan) -> Tally:
    return Tally({kind: Counter() for kind in plan.kinds}, dict.fromkeys(plan.kinds, 0.0))


def _job(plan: Plan, base: Base, root: Path, job: int) -> Tally:
    tally = _empty(plan)
    own = root / f"job-{job}"
    own.mkdir()
    with contextlib.ExitStack() as stack:
        worker = Worker(base, own, plan.seed, plan.limit_s)
        stack.callback(lambda: worker.stop())
        for done, number in enumerate(plan.numbers):
            kind = plan.kinds[number % len(plan.kinds)]
            start = time.monotonic()
            outcome, words = worker.case(kind, number)
            tally.seconds[kind] += time.monotonic() - start
            if outcome == "hang":  # another program may have held the machine up
                outcome, words = worker.case(kind, number)
            tally.outcomes[kind][outcome] += 1
            folder = own / "cases" / f"{kind}-{number}"
            if outcome in _FAULTS:
                _keep(folder, plan.keep / folder.name, f"{outcome}: {words}")
            shutil.rmtree(folder, ignore_errors=True)
            if done % 500 == 499:
                text = f"job {job}: {done + 1} of {len(plan.numbers)}"
                print(text, file=sys.stderr, flush=True)
        tally.peak_mb = worker.peak_mb
    return tally


def _keep(folder: Path, copy: Path, words: str) -> None:
    print(f"fault: {copy}: {words.strip().splitlines()[-1][:200]}", file=sys.stderr, flush=True)
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy, symlinks=True, ignore=_large)
    (copy / "fault.txt").write_text(words, encoding="utf-8", errors="replace")


def _large(folder: str, names: list[str]) -> list[str]:
    """Choose files that are not kept: those with holes would fill the disk."""
    return [name for name in names if os.lstat(Path(folder) / name).st_size > _LARGEST_KEPT]


class Worker:
    """Forked process that makes and runs one case after the other."""

    def __init__(self, base: Base, root: Path, seed: int, limit_s: float) -> None:
        self._settings, self._limit_s = (base, root, seed), limit_s
        self._process: BaseProcess | None = None
        self._pipe: Connection
        self.peak_mb = 0.0

    def case(self, kind: str, number: int) -> tuple[str, str]:
        """Run a case: its outcome, and its message."""
        if self._process is None:
            self._start()
        self._pipe.send((kind, number))
        made = self._answer(_MAKE_S)
        if made[0] != "made":
            return made
        self._largest = 0.0
        answer = self._answer(self._limit_s)
        self.peak_mb = max(self.peak_mb, self._largest)
        if answer[0] in _OUTCOMES[:2] and self._largest > _MOST_MB:
            self.stop()  # what it keeps is not the next case's
            return "memory", f"{self._largest:.0f} MB"
        return answer

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
        """Wait for an answer until the process has taken that CPU time, and look at its memory."""
        assert self._process is not None
        start, before = time.monotonic(), _used(self._process.pid)[0]
        try:
            while not self._pipe.poll(_LOOK_S):
                cpu_s, held_mb = _used(self._process.pid)
                self._largest = max(self._largest, held_mb)
                if cpu_s - before > limit_s or time.monotonic() - start > _PATIENCE * limit_s:
                    fate = "hang", f"no end within {limit_s:g} s"
                    break
            else:
                answer: tuple[str, str, float] = self._pipe.recv()
                self._largest = max(self._largest, answer[2])
                return answer[:2]
        except (EOFError, ConnectionResetError):
            self._process.join()
            fate = "crash", f"exit code {self._process.exitcode}"
        self.stop()
        return fate

    _largest = 0.0

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
        self._process = None


def _used(pid: int | None) -> tuple[float, float]:
    """Return the CPU seconds of a process and all below it, and the largest memory of one."""
    cpu_s, largest = 0.0, 0.0
    with contextlib.suppress(psutil.Error):
        head = psutil.Process(pid)
        for one in (head, *head.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                times = one.cpu_times()
                cpu_s += times.user + times.system
                cpu_s += times.children_user + times.children_system
                largest = max(largest, one.memory_info().rss / 1e6)
    return cpu_s, largest


def _work(pipe: Connection, base: Base, root: Path, seed: int) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    os.environ[backend.CHOICE_VARIABLE] = "llvm"  # a device asks for more addresses than these
    silent = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(silent, number)
    (root / "tmp").mkdir(exist_ok=True)
    tempfile.tempdir = str(root / "tmp")
    call._CPU_S = 2.0  # below the limit that is tested here
    call.preload("trimesh", "h5py", "vtkmodules.all")  # thousands of children need them
    try:
        _warm_up(base, root)
        pipe.send(("warm", "", 0.0))
    except BaseException:
        pipe.send(("traceback", traceback.format_exc(), 0.0))
        return
    while True:
        kind, number = pipe.recv()
        folder = root / "cases" / f"{kind}-{number}"
        case = _run_case(pipe, base, folder, kind, random.Random(f"{seed} {kind} {number}"))
        pipe.send((*case, memory.peak_mb() or 0.0))


def _warm_up(base: Base, root: Path) -> None:
    """Load and compile what the cases need, outside their limits."""
    from sabench.tasks.solve_and_score import score

    out = root / "warm" / str(os.getpid())
    out.mkdir(parents=True)
    for data in (base.particles, base.target, base.code):
        solve_here(data.root, out / f"{data.root.name}.h5")
        score(data, out / f"{data.root.name}.h5")
    for task, path in base.results.items():
        score(base.data_of(task), path)
    from sabench.apps.own_calibration.calibrate import calibrate

    describe_calibration(base.target, out / "mine")
    calibrate(out / "mine", out / "calibrated", "refractive_autocal", {})
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
        return "traceback", f"the case could not be made: {traceback.format_exc()}"
    before = dict(_tree(root, out))
    memory.forget_peak()
    pipe.send(("made", "", 0.0))
    try:
        outcome, words = _outcome(feed)
        changed = dict(_tree(root, out)).items() ^ before.items()
        left = [str(path) for path in out.rglob(".*.partial-*")]
        assert not changed, (
            f"files outside the output folder changed: {sorted(name for name, _ in changed)[:3]}"
        )
        assert not left, f"half-written files are left: {left}"
    except Exception:
        return "traceback", traceback.format_exc()
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
    reader.add_argument("--count", type=int, default=1000)
    reader.add_argument("--jobs", type=int, default=1)
    reader.add_argument("--seed", type=int, default=0)
    reader.add_argument("--kind", action="append", choices=sorted(KINDS))
    reader.add_argument("--only", type=int, help="number of one case to run again")
    reader.add_argument("--limit", type=float, default=_LIMIT_S, help="CPU seconds for each case")
    reader.add_argument("--keep", type=Path, default=ROOT / "build" / "fuzz")
    asked = reader.parse_args()
    start = time.monotonic()
    numbers = range(asked.count) if asked.only is None else range(asked.only, asked.only + 1)
    kinds = tuple(asked.kind or sorted(KINDS))
    plan = Plan(kinds, numbers, asked.seed, asked.limit, asked.keep.absolute())
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        tally = fuzz(plan, Path(folder), min(asked.jobs, len(numbers)))
    _show(tally)
    print(
        f"seed {asked.seed}, largest process {tally.peak_mb:.0f} MB, "
        f"{time.monotonic() - start:.0f} s"
    )
    sys.exit(any(row[name] for row in tally.outcomes.values() for name in _FAULTS))


def _show(tally: Tally) -> None:
    columns = ("refused", "accepted", "tracebacks", "crashes", "hangs", "memory", "ms each")
    print(f"{'kind':<12}{'count':>8}" + "".join(f"{name:>11}" for name in columns))
    total = ("all", sum(tally.outcomes.values(), Counter()), sum(tally.seconds.values()))
    each = [(kind, row, tally.seconds[kind]) for kind, row in tally.outcomes.items()]
    for kind, row, seconds in [*each, total]:
        cells = "".join(f"{row[name]:>11}" for name in _OUTCOMES)
        number = row.total()
        print(f"{kind:<12}{number:>8}{cells}{1e3 * seconds / max(number, 1):>11.0f}")


if __name__ == "__main__":
    main()
