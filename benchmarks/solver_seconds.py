"""Law of the seconds of solvers: `benchmarks/solver_seconds.py [SOLVER ...]`.

The seconds of a solver should depend neither on the state of numba's cache nor on what its process
has done before. Every bundled solver, or those named, solves the small data set of its task
(`scenes/conformance`) in new processes, twice in each: in a first round with a cache of kernels
that is empty at its start, then in `--runs` rounds with the cache that the first one leaves.
Printed are the seconds in the first round (cold), the smallest of the others (warm), those of the
second time in one process (again), what compiling took, and the ratios cold / warm and
warm / again. A solver misses if cold / warm is farther from 1 than 20 % and the difference is more
than 0.05 s. Other processes only add to seconds, so that a solver that misses is tried with a
second empty cache, and its smaller seconds count. The second time in one process may be shorter:
solvers keep what they computed from the cameras. A busy machine tells nothing: see `load` in the
record.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sabench import plugins, tasks
from sabench.evaluation.environment import machine, versions
from sabench.tasks.conformance import example
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

_APART, _NOISE_S = 0.2, 0.05
_OTHERS = {"openlpt", "optv"}  # programs of others, which few machines have
# as in the processes of `sabench solve`: what their server has loaded, and no more
_CHILD = """
import sys
from pathlib import Path

import h5py

import sabench.algorithms.refocus
import sabench.algorithms.tomography.problem
from sabench.tasks.solve_and_score import solve_at_desk

solver, data, folder = sys.argv[1:]
for number in range(2):
    out = Path(folder) / f"{number}.h5"
    solve_at_desk(solver, {}, Path(data), out, threads=None, isolated=False)
    with h5py.File(out) as file:
        print(file.attrs["seconds"], file.attrs["compile_s"])
    out.unlink()
"""


def measure(solver: str, data: Path, cache: Path) -> list[tuple[float, float]]:
    """Solve twice in one new process; return seconds and compile_s of each."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-c", _CHILD, solver, str(data), folder]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"{solver}: {done.stderr.strip().splitlines()[-1]}")
    lines = (line.split() for line in done.stdout.splitlines()[-2:])
    return [(float(seconds), float(compiling)) for seconds, compiling in lines]


def judge(
    solver: str, cold: list[tuple[float, float]], later: list[list[tuple[float, float]]]
) -> dict[str, Any]:
    """Compare first rounds, with kernels to compile, with the later ones."""
    first = min(cold)
    warm, again = (min(run[n][0] for run in later) for n in (0, 1))
    return {
        "solver": solver,
        "cold_s": first[0],
        "warm_s": warm,
        "again_s": again,
        "compile_cold_s": first[1],
        "compile_warm_s": min(run[0][1] for run in later),
        "cold_over_warm": first[0] / warm,
        "warm_over_again": warm / again,
        "missed": abs(first[0] / warm - 1.0) > _APART and abs(first[0] - warm) > _NOISE_S,
    }


def say(row: dict[str, Any]) -> None:
    """Print the line of a solver."""
    seconds = "".join(f"{row[key]:9.3f}" for key in ("cold_s", "warm_s", "again_s"))
    ratios = f"{row['cold_over_warm']:11.2f}{row['warm_over_again']:12.2f}"
    missed = "  missed" if row["missed"] else ""
    print(f"{row['solver']:<32}{seconds}{row['compile_cold_s']:11.2f}{ratios}{missed}")


def compare(names: list[str], runs: int, folder: Path) -> list[dict[str, Any]]:
    """Solve in all rounds, and judge; what misses is tried with a second empty cache."""
    rounds: dict[str, list[list[tuple[float, float]]]] = {name: [] for name in names}

    def solve(name: str, cache: str) -> list[tuple[float, float]]:
        plugin = plugins.load("solvers", name)
        data = example(tasks.of(plugin.task), plugin.sees, folder).root
        return measure(name, data, folder / cache)

    for number in range(1 + runs):
        for name in progress_bar(names, f"round {number + 1} of {1 + runs}"):
            rounds[name].append(solve(name, "cache"))
    rows = []
    for name in progress_bar(names, "judge"):
        (cold, _), *later = rounds[name]
        row = judge(name, [cold], later)
        if row["missed"]:
            row = judge(name, [cold, solve(name, f"cache-{name}")[0]], later)
        rows.append(row)
    return rows


def main() -> None:
    """Measure, print one line for each solver, and write a record."""
    reader = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    reader.add_argument("solvers", nargs="*")
    reader.add_argument("--runs", type=int, default=3)
    reader.add_argument("--output", type=Path)
    chosen = reader.parse_args()
    names = chosen.solvers or [one for one in plugins.names("solvers") if one not in _OTHERS]
    with tempfile.TemporaryDirectory() as folder:
        rows = compare(names, chosen.runs, Path(folder))
    print(f"{'solver':<32}   cold s   warm s  again s  compile s  cold/warm  warm/again")
    for row in rows:
        say(row)
    if chosen.output:
        head = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "machine": machine()}
        record = head | {"versions": versions(), "load": os.getloadavg(), "rows": rows}
        chosen.output.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
