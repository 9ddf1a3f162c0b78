"""The command that runs tests with numba's bounds checks finds an index beyond an array."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.bounds_check import checked_environment

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
def test_an_index_beyond_an_array_is_an_error_in_a_parallel_loop(
    tmp_path: Path, count: int, code: int
) -> None:
    script = tmp_path / "kernel.py"
    script.write_text(_KERNEL.format(count=count), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)],
        env=checked_environment(tmp_path),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code
    assert ("IndexError" in done.stderr) == (code == 1)
