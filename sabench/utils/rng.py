"""Independent random streams, one for each purpose, frame and camera."""

import zlib

import numpy as np

from sabench.utils.errors import InputError


def stream(seed: int, purpose: str, *indices: int) -> np.random.Generator:
    """Return the random generator of one purpose of a data set's seed.

    Purposes are "particles", "sensor" and so on. `indices` select a frame or a camera of it. Equal
    arguments give equal numbers, whatever else is drawn (numpy's SeedSequence with the purpose and
    the indices as its spawn key).
    """
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise InputError(f"seed: expected a whole number from 0 to 2^63 - 1, got {seed!r}")
    key = (zlib.crc32(purpose.encode()), *indices)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
