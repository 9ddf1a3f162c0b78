"""Independent random streams, one for each purpose, frame and camera."""

import zlib

import numpy as np


def stream(seed: int, purpose: str, *indices: int) -> np.random.Generator:
    """Return the random generator of one purpose of a data set's seed.

    Purposes are "particles", "sensor" and so on. `indices` select a frame or a camera of it. Equal
    arguments give equal numbers, whatever else is drawn (numpy's SeedSequence with the purpose and
    the indices as its spawn key).
    """
    key = (zlib.crc32(purpose.encode()), *indices)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
