"""Rooflines of this machine: the best speeds, of which benchmarks give fractions."""

import timeit
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

_TRIAD = 1 << 25  # float32 numbers in each of three arrays: 128 MiB, far beyond any cache
_LINE, _ROUNDS = (
    2048,
    20000,
)  # float32 numbers in a line that stays in the first cache, and how often it is read
_TABLE = 1 << 20  # float32 numbers of a picture of 1024 x 1024 pixels


def fastest_s(work: Callable[[], object], repeats: int = 3) -> float:
    """Measure the seconds of the fastest of several runs, after one to warm up."""
    work()
    return min(timeit.repeat(work, number=1, repeat=repeats))


def triad_gb_s() -> float:
    """Measure the memory bandwidth of a = b + s c, with all threads.

    Arrays exceed the caches; 12 bytes a number (STREAM).
    """
    a, b, c = (np.ones(_TRIAD, dtype=np.float32) for _ in range(3))
    return 12.0 * _TRIAD / fastest_s(lambda: _triad(a, b, c)) / 1e9


def cached_gigaloads_s() -> float:
    """Measure loads of float32 from lines in first caches, all threads, 1e9/s."""
    lines = np.ones((numba.get_num_threads(), _LINE), dtype=np.float32)
    return 4.0 * _LINE * _ROUNDS * len(lines) / fastest_s(lambda: _read_lines(lines)) / 1e9


def gathered_gigaloads_s() -> float:
    """Measure loads of float32 from near pixels by computed index, 1e9/s.

    All threads load from an image.
    """
    table, out = np.ones(_TABLE, dtype=np.float32), np.empty(_TABLE, dtype=np.float32)
    rng = np.random.default_rng(0)
    index = np.clip(
        np.arange(_TABLE) + rng.integers(-4, 5, _TABLE) + 1024 * rng.integers(-4, 5, _TABLE),
        0,
        _TABLE - 1,
    ).astype(np.uint32)
    return 16.0 * _TABLE / fastest_s(lambda: [_gather(table, index, out) for _ in range(16)]) / 1e9


@numba.njit(cache=True, parallel=True, fastmath=True)
def _triad(a: Any, b: Any, c: Any) -> None:
    for i in numba.prange(len(a)):
        a[i] = b[i] + np.float32(1.5) * c[i]


@numba.njit(cache=True, parallel=True, fastmath=True)
def _read_lines(lines: Any) -> Any:
    total = np.zeros(len(lines), dtype=np.float32)
    for thread in numba.prange(len(lines)):
        line, sink = lines[thread], np.zeros(_LINE - 3, dtype=np.float32)
        for _ in range(_ROUNDS):
            for i in range(_LINE - 3):
                sink[i] = line[i] + line[i + 1] * line[i + 2] - line[i + 3]
        total[thread] = sink.sum()
    return total


@numba.njit(cache=True, parallel=True, fastmath=True)
def _gather(table: Any, index: Any, out: Any) -> None:
    for i in numba.prange(len(index)):
        out[i] = table[index[i]]
