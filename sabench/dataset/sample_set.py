"""Samples on disk for training loops: indexed, iterated, in batches, by split.

They are those of shards, or the frames of a data set of version 1. One sample at a time is read, so
that the memory does not depend on their number.
"""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from sabench.api.truth import Particles
from sabench.dataset import schema
from sabench.dataset.reader import Dataset
from sabench.dataset.stored_samples import FrameGroups, StoredSample, StoredShard
from sabench.utils.arrays import F64, I64, U16
from sabench.utils.errors import InputError


class AnySample(Protocol):
    """Sample of a stream or of a data set."""

    @property
    def number(self) -> int:
        """Number of the sample."""

    @property
    def images(self) -> U16:
        """Grey values (frame, camera, row, column)."""

    @property
    def drawn(self) -> dict[str, Any]:
        """Values of the keys that vary."""

    @property
    def particles(self) -> tuple[Particles, ...]:
        """True particles of each frame."""


S = TypeVar("S", bound=AnySample, covariant=True)


@dataclass(frozen=True)
class Batch(Generic[S]):
    """Samples with images of equal shape.

    Attributes
    ----------
    samples : one after the other.
    images : (sample, frame, camera, row, column) grey values.
    """

    samples: tuple[S, ...]
    images: U16

    @property
    def numbers(self) -> I64:
        """Numbers (sample,)."""
        return np.array([one.number for one in self.samples])

    @property
    def drawn(self) -> dict[str, Any]:
        """Values (sample,) of each key that varies; lists where they are no numbers."""
        keys = self.samples[0].drawn
        return {key: np.asarray([one.drawn[key] for one in self.samples]) for key in keys}

    def displacements_mm(self, first: int = 0, second: int = 1) -> list[tuple[F64, F64]]:
        """Give positions and displacements between two frames, for each sample.

        Both are (n, 3), those of the particles that both frames have.
        """
        return [_moves(one.particles[first], one.particles[second]) for one in self.samples]

    def arrays(self, particles: int | None = None) -> dict[str, npt.NDArray[Any]]:
        """Yield arrays with samples along the first axis, for machine learning libraries.

        `number` and `images`; with `particles`, the largest number of them in any frame, also
        `position_mm` (sample, frame, particle, 3), zero where there is none, and `present` (sample,
        frame, particle).

        Raises InputError for a frame with more particles.
        """
        arrays: dict[str, npt.NDArray[Any]] = {"number": self.numbers, "images": self.images}
        if particles is not None:
            shape = (*self.images.shape[:2], particles)
            positions, present = np.zeros((*shape, 3)), np.zeros(shape, dtype=np.bool_)
            for row, one in enumerate(self.samples):
                for frame, truth in enumerate(one.particles):
                    if len(truth) > particles:
                        raise InputError(
                            f"sample {one.number}: expected at most {particles} particles, got "
                            f"{len(truth)}"
                        )
                    positions[row, frame, : len(truth)] = truth.position_mm
                    present[row, frame, : len(truth)] = True
            arrays |= {"position_mm": positions, "present": present}
        return arrays


def make_batch(samples: Sequence[S]) -> Batch[S]:
    """Put samples together; raises InputError for images of different shapes."""
    images = [one.images for one in samples]
    for one in samples:
        if one.images.shape != images[0].shape:
            raise InputError(
                f"sample {one.number}: expected images (frame, camera, row, column) of one shape "
                f"in all samples, got {images[0].shape} in sample {samples[0].number} and "
                f"{one.images.shape} here"
            )
    return Batch(tuple(samples), np.stack(images))


def _moves(first: Particles, second: Particles) -> tuple[F64, F64]:
    _, i, j = np.intersect1d(first.id, second.id, assume_unique=True, return_indices=True)
    return first.position_mm[i], second.position_mm[j] - first.position_mm[i]


_OPEN = 128  # shards whose files are open, two each
Store = StoredShard | FrameGroups


class SampleSet(Sequence[StoredSample]):
    """Samples of a data set, made by `open_samples`.

    Attributes
    ----------
    root : folder of the data set.
    content_hash : hash of the bytes of this copy of it.
    """

    def __init__(self, root: Path, content_hash: str, stores: Sequence[tuple[str, Store]]) -> None:
        self.root, self.content_hash, self._stores = root, content_hash, tuple(stores)
        self._ends = list(itertools.accumulate(len(store) for _, store in self._stores))
        self._open: dict[int, None] = {}  # numbers of stores, the last used one at the end

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: Any) -> Any:
        """Read a sample by its place; a slice gives a list of samples."""
        if isinstance(index, slice):
            return [self[place] for place in range(*index.indices(len(self)))]
        place = int(index) + len(self) * (index < 0)
        if not 0 <= place < len(self):
            raise IndexError(f"{self.root}: expected 0 to {len(self) - 1}, got {index}")
        number = bisect.bisect_right(self._ends, place)
        self._open.pop(number, None)
        self._open[number] = None
        if len(self._open) > _OPEN:
            oldest = next(iter(self._open))
            del self._open[oldest]
            self._stores[oldest][1].close()
        store = self._stores[number][1]
        return store.sample(place - (self._ends[number] - len(store)))

    def __iter__(self) -> Iterator[StoredSample]:
        return (self[place] for place in range(len(self)))

    @cached_property
    def splits(self) -> dict[str, int]:
        """Number of samples of each split."""
        counts: dict[str, int] = {}
        for name, store in self._stores:
            counts[name] = counts.get(name, 0) + len(store)
        return counts

    def split(self, name: str) -> SampleSet:
        """Select the samples of a split; raises InputError if there is none."""
        if name not in self.splits:
            raise InputError(
                f"{self.root}: expected one of the splits {', '.join(self.splits)}, got {name!r}"
            )
        stores = [(split, store) for split, store in self._stores if split == name]
        return SampleSet(self.root, self.content_hash, stores)

    def batches(
        self,
        batch: int,
        *,
        shuffle: int | None = None,
        start: int = 0,
        part: tuple[int, int] = (0, 1),
    ) -> Iterator[Batch[StoredSample]]:
        """Read the samples in batches; the last one may have fewer.

        Parameters
        ----------
        shuffle : seed of their order, such as the number of the epoch; by default that on disk. Of
            very many shards, it is that of groups of shards, and of the samples in each group.
        start : batches to leave out: an epoch resumes as if they had been read.
        part : (k, n) for every n-th batch from the k-th on: n processes share an epoch.
        """
        if batch < 1:
            raise InputError(f"batch: expected 1 or more, got {batch}")
        order = np.arange(len(self)) if shuffle is None else self._shuffled(shuffle)
        number, count = part
        firsts = range(0, len(order), batch)
        for first in itertools.islice(firsts, start + (number - start) % count, None, count):
            yield make_batch([self[place] for place in order[first : first + batch].tolist()])

    def _shuffled(self, seed: int) -> I64:
        """Shuffle shards, and then the samples of as many as may be open."""
        rng = np.random.default_rng(seed)
        shards = rng.permutation(len(self._stores)).tolist()
        order = []
        for first in range(0, len(shards), _OPEN):
            group = [
                np.arange(self._ends[n] - len(self._stores[n][1]), self._ends[n])
                for n in shards[first : first + _OPEN]
            ]
            order.append(rng.permutation(np.concatenate(group)))
        return np.concatenate(order)


def open_samples(path: str | Path, split: str | None = None) -> SampleSet:
    """Open independent samples, or the frames of a data set.

    Checksums are not checked here: see `verify`.

    Parameters
    ----------
    split : only the samples of this one: "train", "validation", "test".

    Raises InputError for a missing data set, one without images, or without such a split.
    """
    root = Path(path)
    contents = schema.read_manifest(root)
    stores: list[tuple[str, Store]]
    if isinstance(contents, schema.ShardedContents):
        stores = [(one.split, StoredShard(root, contents, one)) for one in contents.shards]
    else:
        stores = [("train", FrameGroups(Dataset(root, contents)))]
    samples = SampleSet(root, contents.content_hash, stores)
    return samples if split is None else samples.split(split)
