"""Splits of independent samples, and the shards that hold them.

A sample's split follows from a hash of its number, and a shard holds samples of one split: none can
get into two splits, however many samples there are and whoever makes them.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import I64
from sabench.utils.errors import InputError


def split_of(number: int, shares: Sequence[float]) -> str:
    """Name the split of a sample: "train", "validation", "test", "split-3" and on.

    By a hash of its number, so that a sample stays in its split however many are made.
    """
    check_shares(shares)
    place = zlib.crc32(number.to_bytes(8, "little")) / 2.0**32 * sum(shares)
    ends = list(itertools.accumulate(shares))
    index = next((n for n, end in enumerate(ends) if place < end), len(shares) - 1)
    return split_names(len(shares))[index]


def split_names(count: int) -> list[str]:
    """Name a number of splits."""
    return ["train", "validation", "test", *(f"split-{n}" for n in range(3, count))][:count]


def check_shares(shares: Sequence[float]) -> None:
    """Refuse shares that no sample can be divided by."""
    if not shares or min(shares) < 0.0 or not 0.0 < sum(shares) < float("inf"):
        raise InputError(
            f"split: expected shares of 0 or more, not all of them 0, got {list(shares)}"
        )


@dataclass(frozen=True)
class Shard:
    """Samples of one shard.

    Attributes
    ----------
    name : "train-00000" and on; of its files, too.
    split : of all its samples.
    numbers : (n,) of its samples, ascending.
    """

    name: str
    split: str
    numbers: I64


def plan_shards(samples: int, shares: Sequence[float], size: int) -> list[Shard]:
    """Divide samples from 0 on into shards of at most `size`, split by split.

    All shards of a split but its last are full.
    """
    check_shares(shares)
    hashes = np.array([zlib.crc32(n.to_bytes(8, "little")) for n in range(samples)])
    ends = np.array(list(itertools.accumulate(shares)))
    splits = np.searchsorted(ends, hashes / 2.0**32 * sum(shares), side="right")
    splits = np.minimum(splits, len(shares) - 1)  # as `split_of`, all at a time
    return [
        shard
        for index, name in enumerate(split_names(len(shares)))
        for shard in _shards(name, np.flatnonzero(splits == index), size)
    ]


def _shards(split: str, numbers: I64, size: int) -> Iterator[Shard]:
    for index, first in enumerate(range(0, len(numbers), size)):
        yield Shard(f"{split}-{index:05d}", split, numbers[first : first + size])
