"""Kernels that were compiled in advance are there for later commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from sabench.tasks.warm_up import warm_up
from sabench.utils.errors import InputError
from sabench.utils.kernel_folder import kernel_folder

PLUGIN = '''"""Compiles."""

import numba
import numpy as np

from sabench.api import Observation, Reconstruction, Solver


@numba.njit(cache=True)
def fill(volume):
    volume[:] = 1.0


class Compiler(Solver):
    """Compiles a kernel of its own."""

    name = "compiler"

    def solve(self, case: Observation) -> Reconstruction:
        volume = np.zeros(case.grid.shape, dtype=np.float32)
        fill(volume)
        return Reconstruction(volume)
'''


def test_kernels_of_a_solver_are_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path))
    (tmp_path / "solvers").mkdir()
    (tmp_path / "solvers" / "compiler.py").write_text(PLUGIN)
    before = set(kernel_folder().rglob("compiler.fill-*.nbc"))
    (warmed,) = warm_up(["compiler"])
    assert warmed.compile_s > 0.0
    assert len(set(kernel_folder().rglob("compiler.fill-*.nbc")) - before) == 1


def test_an_unknown_solver_is_refused_before_anything_is_compiled() -> None:
    with pytest.raises(InputError, match="nobody"):
        next(warm_up(["ray_triangulation", "nobody"]))
