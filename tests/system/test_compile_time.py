"""Seconds of a solver do not contain the compilation of its kernels."""

from __future__ import annotations

from pathlib import Path

import pytest

import sabench
from sabench.dataset.reader import Dataset
from sabench.tasks.solve_and_score import solve


def test_the_first_run_is_as_fast_as_the_second(
    quick: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a fresh cache: its first run compiles for seconds, its second does not.

    The limit is loose, for a busy machine: the first run would take 20 times as long.
    """
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    (tmp_path / "kernels").mkdir()
    first, second = (
        solve("map_shift_average", quick, tmp_path / f"{number}.h5") for number in range(2)
    )
    assert first.compile_s is not None
    assert second.compile_s is not None
    assert first.seconds is not None
    assert second.seconds is not None
    assert first.compile_s > 5.0 * second.compile_s
    assert first.seconds < 3.0 * second.seconds
    figures = sabench.score(quick, tmp_path / "0.h5")
    assert figures["compile_s"] == first.compile_s
