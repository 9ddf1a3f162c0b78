"""Counter-based random numbers for kernels: Philox4x32-10.

A block of four words depends on a key and a counter alone, whatever is drawn elsewhere and on
whatever thread. Source: Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2,
3", Proc. SC11 (2011), section 3.3.
"""

from typing import Any

import numpy as np

from sabench.utils.compiled import inner_kernel, numba

_ROUNDS = 10
_FIRST, _SECOND = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)  # multipliers
_FIRST_STEP, _SECOND_STEP = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)  # of the key's words
_HALF = np.uint64(32)  # bits of a word

Key = tuple[np.uint64, np.uint64]


def draw_key(rng: np.random.Generator) -> Key:
    """Draw a key: two words of 32 bits."""
    number = int(rng.integers(1 << 64, dtype=np.uint64))
    return np.uint64(number & 0xFFFFFFFF), np.uint64(number >> 32)


@numba.njit(cache=True, inline="always")
def _low(number: Any) -> Any:
    """Return the lower word of a uint64."""
    return np.uint64(np.uint32(number))


@numba.njit(cache=True, inline="always")
def block(key: Any, c0: Any, c1: Any, c2: Any, c3: Any) -> Any:
    """Compute the block of a counter: four words of 32 bits, each in a uint64."""
    k0, k1 = key
    for _ in range(_ROUNDS):
        even, odd = _FIRST * c0, _SECOND * c2
        c0, c1 = (odd >> _HALF) ^ c1 ^ k0, _low(odd)
        c2, c3 = (even >> _HALF) ^ c3 ^ k1, _low(even)
        k0, k1 = _low(k0 + _FIRST_STEP), _low(k1 + _SECOND_STEP)
    return c0, c1, c2, c3


@inner_kernel()
def fill_blocks(key: Any, first: Any, c1: Any, c2: Any, c3: Any, words: Any) -> None:
    """Fill in blocks (4, n) of counters whose first word counts up from `first`."""
    for n in range(words.shape[1]):
        words[0, n], words[1, n], words[2, n], words[3, n] = block(
            key, first + np.uint64(n), c1, c2, c3
        )
