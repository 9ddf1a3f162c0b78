"""Cost of the first call of each solver: `benchmarks/first_calls.py [SOLVER ...] [--write]`.

Every bundled solver, or those named, solves the small data set of its task
(`scenes/conformance`) in two new processes: with an empty folder of kernels, then with the one that
the first left. Printed are the CPU seconds of both, their difference, and the compiled kernels.
`--write` stores the kernels in sabench/tasks/kernels.json, which the bar of compiling counts to.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from sabench import plugins, tasks
from sabench.tasks.conformance import example
from sabench.utils.errors import InputError

KERNELS = Path(tasks.__file__).with_name("kernels.json")
_OTHERS = {"openlpt", "optv"}  # programs of others, which few machines have
_CHILD = """
import sys
from pathlib import Path

import sabench.algorithms.refocus
import sabench.algorithms.tomography.problem
from sabench.tasks.solve_and_score import run_plug_in

solver, data, out = sys.argv[1:]
run_plug_in(solver, {}, Path(data), Path(out), threads=None, isolated=False)
"""


def measure(solver: str, data: Path, folder: Path) -> tuple[float, float, int]:
    """Measure the CPU seconds of the first and the second process, and count kernels."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / solver)}
    seconds = []
    for number in range(2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        words = [sys.executable, "-c", _CHILD, solver, str(data), str(folder / f"{number}.h5")]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise InputError(f"{solver}: {done.stderr.strip().splitlines()[-1]}")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        (folder / f"{number}.h5").unlink()
    return seconds[0], seconds[1], sum(1 for _ in (folder / solver).rglob("*.nbi"))


def main() -> None:
    """Measure, print a line for each solver, and store the numbers of kernels."""
    reader = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    reader.add_argument("solvers", nargs="*")
    reader.add_argument("--write", action="store_true")
    chosen = reader.parse_args()
    names = chosen.solvers or [one for one in plugins.names("solvers") if one not in _OTHERS]
    kernels = json.loads(KERNELS.read_text(encoding="utf-8")) if KERNELS.is_file() else {}
    print(f"{'solver':<32}{'first':>8}{'second':>8}{'more':>8}{'kernels':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            plugin = plugins.load("solvers", name)
            data = example(tasks.of(plugin.task), plugin.sees, Path(folder)).root
            try:
                first, second, count = measure(name, data, Path(folder))
            except InputError as error:  # one that declines the example
                print(error, flush=True)
                continue
            row = f"{first:8.1f}{second:8.1f}{first - second:8.1f}{count:9}"
            print(f"{name:<32}{row}", flush=True)
            kernels[name] = count
    if chosen.write:
        text = json.dumps(dict(sorted(kernels.items())), indent=1)
        KERNELS.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
