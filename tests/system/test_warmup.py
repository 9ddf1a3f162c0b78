"""Kernels that were compiled in advance are there for later commands."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sabench.tasks.warm_up import warm_up
from sabench.utils.errors import InputError


def run(cache: Path) -> list[dict[str, Any]]:
    """Call the command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "sabench", "warmup", "ray_triangulation", "--json"],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        check=True,
    )
    rows: list[dict[str, Any]] = json.loads(done.stdout)
    return rows


def test_the_second_time_nothing_is_compiled(tmp_path: Path) -> None:
    (first,), (second,) = run(tmp_path), run(tmp_path)
    assert first["solver"] == second["solver"] == "ray_triangulation"
    assert first["verdict"] == second["verdict"] == "obeyed"
    kernels = list(tmp_path.rglob("*.nbc"))
    assert kernels
    assert second["compile_s"] < 0.5 * first["compile_s"]


def test_an_unknown_solver_is_refused_before_anything_is_compiled() -> None:
    with pytest.raises(InputError, match="nobody"):
        next(warm_up(["ray_triangulation", "nobody"]))
