"""Compiled kernels: their time is a figure of its own, they are stored, and bounds are checked."""

from pathlib import Path

import pytest

import sabench
from benchmarks.bounds_check import checked_environment
from sabench.dataset.reader import Dataset
from sabench.tasks.conformance import warm_up
from sabench.tasks.solve_and_score import solve
from sabench.utils.kernel_folder import kernel_folder
from tests.helpers.commands import run_python
from tests.helpers.plug_ins import write_solver
from tests.helpers.refusals import refused

KERNEL = """
import numba
@numba.njit
def fill(volume):
    for z in range(volume.shape[0]):
        volume[z] = np.median(volume[z])
"""
ZEROS = "return Reconstruction(np.zeros(case.grid.shape, dtype=np.float32))"


@pytest.fixture
def solvers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_compilation_is_no_work(quick: Dataset, tmp_path: Path, solvers: Path) -> None:
    """The kernel compiles for about a second in every run, since it has no cache."""
    write_solver(solvers, "compiler", f"fill(np.zeros((2, 2, 2)))\n{ZEROS}", KERNEL)
    made = solve("compiler", quick, tmp_path / "r.h5")
    assert made.compile_s is not None
    assert made.seconds is not None
    assert made.compile_s > 0.3
    assert made.seconds < 0.5 * made.compile_s
    figures = sabench.score(quick, tmp_path / "r.h5")
    assert (figures["seconds"], figures["compile_s"]) == (made.seconds, made.compile_s)


WAITING = f"""
start = time.process_time()
while time.process_time() - start < 0.5:
    np.sqrt(np.arange(1000.0))
time.sleep(4.5)
{ZEROS}
"""


@pytest.mark.slow
def test_waits_are_no_work(quick: Dataset, tmp_path: Path, solvers: Path) -> None:
    write_solver(solvers, "waiting", WAITING)
    made = solve("waiting", quick, tmp_path / "r.h5", threads=1)
    assert made.seconds is not None
    assert made.cpu_share is not None
    assert made.seconds > 4.5
    assert 0.4 < made.seconds * made.cpu_share < 1.5


@pytest.mark.slow
def test_kernels_of_a_solver_are_stored() -> None:
    """The solver runs in a child process, which may write there."""
    (warmed,) = warm_up(["asa"])
    assert (warmed.solver, warmed.verdict) == ("asa", "obeyed")
    assert list(kernel_folder().rglob("cpu_kernels.*.nbc"))


def test_an_unknown_solver_is_refused_before_anything_is_compiled() -> None:
    with refused("nobody"):
        next(warm_up(["ray_triangulation", "nobody"]))


_KERNEL = """
import numba
import numpy as np


@numba.njit(parallel=True)
def fill(values, count):
    for i in numba.prange(count):
        values[i] = 1.0


fill(np.zeros(4), {count})
"""


@pytest.mark.slow
@pytest.mark.parametrize(("count", "code"), [(4, 0), (5, 1)])
def test_an_index_beyond_an_array_is_an_error(tmp_path: Path, count: int, code: int) -> None:
    script = tmp_path / "kernel.py"
    script.write_text(_KERNEL.format(count=count), encoding="utf-8")
    done = run_python(script, env=checked_environment(tmp_path))
    assert done.returncode == code
    assert ("IndexError" in done.stderr) == (code == 1)
