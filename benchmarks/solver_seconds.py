"""Law of the seconds of solvers: `benchmarks/solver_seconds.py [SOLVER ...]`.

The seconds of a solver should depend neither on the state of numba's cache nor on what its process
has done before. Every bundled solver, or those named, solves the small data set of its task
(`scenes/conformance`) in new processes, twice in each: in a first round with a cache of kernels
that is empty at its start, then in `--runs` rounds with the cache that the first one leaves.
Printed are the seconds in the first round (cold), the smallest of the others (warm), those of the
second time in one process (again), what compiling took, and the ratios cold / warm and warm /
again. The last columns are the CPU seconds of the solver without those of the compiler, which other
processes change less. A solver misses if cold / warm is farther from 1 than 20 % and the difference
is more than 0.05 s. Other processes only add to seconds, so that a solver that misses is tried with
a second empty cache, and its smaller seconds count. The second time in one process may be shorter:
solvers keep what they computed from the cameras. A busy machine tells nothing: see `load` in the
record.
"""

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
from sabench.evaluation.records import machine, versions
from sabench.tasks.conformance import example
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

_APART, _NOISE_S = 0.2, 0.05
_OTHERS = {"openlpt", "optv"}  # programs of others, which few machines have
# as in the processes of `sabench solve`: what their server has loaded, and no more
_CHILD = """
import sys
import time
from pathlib import Path

import h5py
from numba.core import event

import sabench.algorithms.refocus
import sabench.algorithms.tomography.problem
from sabench import plugins
from sabench.tasks.solve_and_score import run_plug_in


class Compiler(event.Listener):
    # CPU seconds while numba's compiler is held
    held, cpu_s = 0, 0.0

    def on_start(self, event):
        self.cpu_s -= 0.0 if self.held else time.process_time()
        self.held += 1

    def on_end(self, event):
        self.held -= 1
        self.cpu_s += 0.0 if self.held else time.process_time()


solver, data, folder = sys.argv[1:]
compiler, spent = Compiler(), []
event.register("numba:compiler_lock", compiler)
plug_in = plugins.load("solvers", solver)
plain = plug_in.solve


def solve(self, case):
    start = time.process_time() - compiler.cpu_s
    try:
        return plain(self, case)
    finally:
        spent.append(time.process_time() - compiler.cpu_s - start)


plug_in.solve = solve
for number in range(2):
    out = Path(folder) / f"{number}.h5"
    run_plug_in(solver, {}, Path(data), out, threads=None, isolated=False)
    with h5py.File(out) as file:
        print(file.attrs["seconds"], file.attrs["compile_s"], sum(spent) / len(spent))
    spent.clear()
    out.unlink()
"""


Run = list[tuple[float, float, float]]  # seconds, compile_s and CPU seconds of each time


def measure(solver: str, data: Path, cache: Path) -> Run:
    """Solve twice in one new process."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-c", _CHILD, solver, str(data), folder]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"{solver}: {done.stderr.strip().splitlines()[-1]}")
    lines = (line.split() for line in done.stdout.splitlines()[-2:])
    return [(float(seconds), float(compiling), float(cpu_s)) for seconds, compiling, cpu_s in lines]


def judge(solver: str, cold: Run, later: list[Run]) -> dict[str, Any]:
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
        "cpu_cold_s": min(one[2] for one in cold),
        "cpu_warm_s": min(run[0][2] for run in later),
        "missed": abs(first[0] / warm - 1.0) > _APART and abs(first[0] - warm) > _NOISE_S,
    }


def say(row: dict[str, Any]) -> None:
    """Print the line of a solver."""
    seconds = "".join(f"{row[key]:9.3f}" for key in ("cold_s", "warm_s", "again_s"))
    ratios = f"{row['cold_over_warm']:11.2f}{row['warm_over_again']:12.2f}"
    cpu = f"{row['cpu_cold_s']:12.3f}{row['cpu_warm_s']:12.3f}"
    missed = "  missed" if row["missed"] else ""
    print(f"{row['solver']:<32}{seconds}{row['compile_cold_s']:11.2f}{ratios}{cpu}{missed}")


def compare(names: list[str], runs: int, folder: Path) -> list[dict[str, Any]]:
    """Solve in all rounds, and judge; what misses is tried with a second empty cache."""
    rounds: dict[str, list[Run]] = {name: [] for name in names}

    def solve(name: str, cache: str) -> Run:
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
    columns = (
        "   cold s   warm s  again s  compile s  cold/warm  warm/again  cpu cold s  cpu warm s"
    )
    print(f"{'solver':<32}{columns}")
    for row in rows:
        say(row)
    if chosen.output:
        head = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "machine": machine()}
        record = head | {"versions": versions(), "load": os.getloadavg(), "rows": rows}
        chosen.output.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
