"""Independent random streams named by what they are for, so that nothing drawn elsewhere can change them."""

import zlib

import numpy as np


def stream(seed: int, purpose: str, *indices: int) -> np.random.Generator:
    """The generator of one purpose ("particles", "sensor"), and of one frame or camera of it, under a data set's seed.

    Two calls with the same arguments give the same numbers whatever else was generated before,
    after or never (numpy's SeedSequence with the purpose and the indices as its spawn key).
    """
    key = (zlib.crc32(purpose.encode()), *indices)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
