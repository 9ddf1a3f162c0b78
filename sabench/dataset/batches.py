"""Samples that are together in a batch, from a stream or from a data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from sabench.api.truth import Particles
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
    """Samples whose images have one shape.

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
        """Give arrays whose first axis is the sample, for libraries of machine learning.

        `number` and `images`; with `particles`, the largest number of them in any frame, also
        `position_mm` (sample, frame, particle, 3), zero where there is none, and `present` (sample,
        frame, particle).

        Raises
        ------
        InputError
            A frame with more particles.
        """
        arrays: dict[str, npt.NDArray[Any]] = {"number": self.numbers, "images": self.images}
        if particles is not None:
            shape = (*self.images.shape[:2], particles)
            positions, present = np.zeros((*shape, 3)), np.zeros(shape, dtype=np.bool_)
            for row, one in enumerate(self.samples):
                for frame, own in enumerate(one.particles):
                    _check_count(one.number, len(own), particles)
                    positions[row, frame, : len(own)] = own.position_mm
                    present[row, frame, : len(own)] = True
            arrays |= {"position_mm": positions, "present": present}
        return arrays


def _check_count(number: int, count: int, most: int) -> None:
    if count > most:
        raise InputError(f"sample {number}: expected at most {most} particles, got {count}")


def make_batch(samples: Sequence[S]) -> Batch[S]:
    """Put samples together.

    Raises
    ------
    InputError
        Images of different shapes.
    """
    images = [one.images for one in samples]
    for one, own in zip(samples, images, strict=True):
        if own.shape != images[0].shape:
            raise InputError(
                f"sample {one.number}: expected images (frame, camera, row, column) of one shape "
                f"in all samples, got {images[0].shape} in sample {samples[0].number} and "
                f"{own.shape} here"
            )
    return Batch(tuple(samples), np.stack(images))


def _moves(first: Particles, second: Particles) -> tuple[F64, F64]:
    _, i, j = np.intersect1d(first.id, second.id, assume_unique=True, return_indices=True)
    return first.position_mm[i], second.position_mm[j] - first.position_mm[i]
