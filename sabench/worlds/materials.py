"""Materials of a mixture of particles: which particle is of which."""

from __future__ import annotations

import numpy as np

from sabench.scenes.illumination import Tracer
from sabench.utils.arrays import I64
from sabench.utils.rng import stream

_GOLDEN, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def material_numbers(tracer: Tracer, seed: int, ids: I64) -> I64:
    """Draw the materials (n,) of particles.

    They are 0 for the tracer's own, then those of its mixture. A particle keeps its material,
    whatever other particles there are: the draw is a hash of its number (SplitMix64, after Steele,
    Lea and Flood 2014).
    """
    if not tracer.mixture:
        return np.zeros(len(ids), dtype=np.int64)
    key = stream(seed, "materials").integers(1 << 63, dtype=np.uint64)
    with np.errstate(over="ignore"):
        mixed = (ids.astype(np.uint64) + key) * np.uint64(_GOLDEN)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(_FIRST)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(_SECOND)
    drawn = ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
    bounds = np.cumsum([one.share for one in tracer.mixture])
    number = np.searchsorted(bounds, drawn, side="right") + 1
    return np.asarray(np.where(number > len(bounds), 0, number), dtype=np.int64)
