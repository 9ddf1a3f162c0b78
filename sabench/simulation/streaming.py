"""Independent samples of a scene in memory, batch after batch.

A sample is what `generate` would make of the scene with a seed of its own: other particles, other
noise, and other values of the keys that the scene's `vary` lists. Sample n depends on the seed and
n alone, so that a stream goes on anywhere, with any size of batches.
"""

from __future__ import annotations

import contextlib
import itertools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles
from sabench.images.preprocessing import takes_all_frames
from sabench.scenes import Rig, Scene, build_rig, load_scene, parse_scene
from sabench.scenes.variation import draw_values, extremes, with_values
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import observation_of, record_frame
from sabench.simulation.recording.job import Job
from sabench.simulation.renderer_choice import Renderer, choose_renderer
from sabench.utils.arrays import F64, I64, U16
from sabench.utils.backend import limit_kernels
from sabench.utils.errors import InputError
from sabench.utils.rng import stream as random_stream

_SMALL_PX = 4_000_000  # of all cameras: threads that meet cost more time than they save
_MOST_DRAWS = 1000  # of one sample's values: none of them gives a scene that can be


@dataclass(frozen=True)
class Sample:
    """One sample.

    Attributes
    ----------
    number : in the stream.
    scene, seed : it is what `simulate` makes of these.
    drawn : values of the keys that vary.
    redrawn : how often these were drawn again, as no such scene can be.
    images : (frame, camera, row, column) grey values.
    particles : true particles of each frame, the same rows for the same `id`.
    rig : true cameras, grid and occluders.
    """

    number: int
    scene: Scene
    seed: int
    drawn: dict[str, Any]
    redrawn: int
    images: U16
    particles: tuple[Particles, ...]
    rig: Rig

    def observation(self, frame: int = 0) -> Observation:
        """Build what a solver sees of a frame."""
        content = Frames(self.scene, self.rig, self.seed, "splat").assemble(frame)
        every = takes_all_frames(self.scene.preprocessing or ())
        lowest = self.images.min(axis=0) if every else None
        return observation_of(content, list(self.images[frame]), lowest)


@dataclass(frozen=True)
class Batch:
    """Samples whose images have one shape.

    Attributes
    ----------
    samples : one after the other.
    images : (sample, frame, camera, row, column) grey values.
    """

    samples: tuple[Sample, ...]
    images: U16

    @property
    def numbers(self) -> I64:
        """Numbers (sample,) in the stream."""
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


def stream_samples(
    scene: Scene | str | Path,
    *,
    seed: int = 0,
    batch: int = 1,
    start: int = 0,
    samples: int | None = None,
    split: tuple[str, Sequence[float]] | None = None,
    backend: Renderer = "splat",
    key: str | None = None,
) -> Iterator[Batch]:
    """Make independent samples of a scene with particles.

    Parameters
    ----------
    scene : with particles alone; also a file, or the name of a bundled scene.
    batch : samples together; the last batch may have fewer.
    start : number of the first sample: the stream goes on as if those before had been made.
    samples : number after the last; by default the stream has no end.
    split : a name and shares, such as ("train", (80, 10, 10)): only the samples that `split_of`
        puts into "train", "validation" or "test".
    backend : "splat" or "mitsuba".
    key : that `stream_key` gave when the stream was begun, for one that goes on.

    Raises
    ------
    InputError
        As `simulate`; a range of `vary` at whose ends no scene can be, unless impossible samples
        are redrawn; cameras that differ in number or size; another key.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if key is not None and key != (now := stream_key(scene, seed=seed, backend=backend)):
        raise InputError(
            f"{scene.title}: expected the stream {key[:12]}, got {now[:12]}: the scene, the seed, "
            "the renderer, or the version of sabench or of a library that it renders with has "
            "changed since the stream began"
        )
    least = {"batch": (batch, 1), "start": (start, 0)}
    if samples is not None:
        least["samples"] = samples, start
    for name, (value, smallest) in least.items():
        if value < smallest:
            raise InputError(f"{name}: expected a number from {smallest} on, got {value}")
    numbers = itertools.count(start) if samples is None else iter(range(start, samples))
    if split is not None:
        numbers = _of_split(numbers, *_check_split(split))
    return _batches(_Maker(scene, seed, choose_renderer(backend)), batch, numbers)


def stream_key(scene: Scene | str | Path, *, seed: int = 0, backend: Renderer = "splat") -> str:
    """Compute a hash of all that a stream's samples depend on but their numbers.

    That is the scene, the seed, the renderer, the code of sabench and the versions of libraries.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    return Job(scene, seed, choose_renderer(backend), scene.title).key


def split_of(number: int, shares: Sequence[float]) -> str:
    """Name the split of a sample: "train", "validation", "test", "split-3" and on.

    By a hash of its number, so that a sample stays in its split however many are made.
    """
    if not shares or min(shares) < 0.0 or not sum(shares) > 0.0:
        raise InputError(f"split: expected shares that are not negative, got {list(shares)}")
    place = zlib.crc32(number.to_bytes(8, "little")) / 2.0**32 * sum(shares)
    ends = list(itertools.accumulate(shares))
    index = next((n for n, end in enumerate(ends) if place < end), len(shares) - 1)
    return split_names(len(shares))[index]


def split_names(count: int) -> list[str]:
    """Name a number of splits."""
    return ["train", "validation", "test", *(f"split-{n}" for n in range(3, count))][:count]


def _check_split(split: tuple[str, Sequence[float]]) -> tuple[str, Sequence[float]]:
    """Refuse a split that no sample can be in."""
    if isinstance(split, str) or len(split) != 2:
        raise InputError(f'split: expected a name and shares, ("train", (80, 20)), got {split!r}')
    name, shares = split
    split_of(0, shares)
    if name not in (names := split_names(len(shares))):
        raise InputError(f"split: expected one of {', '.join(names)}, got {name!r}")
    if not shares[names.index(name)] > 0.0:
        raise InputError(f"split: expected a share of {name} above 0, got {list(shares)}")
    return name, shares


def _of_split(numbers: Iterator[int], name: str, shares: Sequence[float]) -> Iterator[int]:
    return (number for number in numbers if split_of(number, shares) == name)


def _batches(maker: _Maker, batch: int, numbers: Iterator[int]) -> Iterator[Batch]:
    while chosen := list(itertools.islice(numbers, batch)):
        made = tuple(maker.make(number) for number in chosen)
        _check_shapes(made)
        yield Batch(made, np.stack([one.images for one in made]))


def _check_shapes(made: Sequence[Sample]) -> None:
    for one in made[1:]:
        if one.images.shape != made[0].images.shape:
            raise InputError(
                f"{one.scene.title}: expected images (frame, camera, row, column) of one shape in "
                f"all samples, got {made[0].images.shape} in sample {made[0].number} and "
                f"{one.images.shape} in sample {one.number}"
            )


class _Maker:
    """Makes samples of one scene, and keeps what they share."""

    def __init__(self, scene: Scene, seed: int, renderer: str) -> None:
        if scene.tracers is None or scene.bubbles is not None or scene.solids:
            raise InputError(f"{scene.title}: expected a scene with particles alone")
        self.scene, self.seed, self.renderer = scene, seed, renderer
        self.rig = build_rig(scene, scene.title)
        if scene.vary is not None and scene.vary.impossible == "refuse":
            for drawn in extremes(scene.vary):
                self._possible(drawn, "at the ends of its ranges")

    def make(self, number: int) -> Sample:
        """Make a sample."""
        scene, rig, drawn, redrawn = self._choose(number)
        own = int(random_stream(self.seed, "sample", number).integers(2**62))
        frames = Frames(scene, rig, own, self.renderer)
        small = sum(camera.rows * camera.columns for camera in rig.cameras) < _SMALL_PX
        with limit_kernels(1) if small else contextlib.nullcontext():
            images, particles = _record(frames)
        return Sample(number, scene, own, drawn, redrawn, images, particles, rig)

    def _choose(self, number: int) -> tuple[Scene, Rig, dict[str, Any], int]:
        """Draw a sample's values, again and again if the scene asks for it."""
        vary = self.scene.vary
        if vary is None:
            return self.scene, self.rig, {}, 0
        for attempt in range(_MOST_DRAWS):
            drawn = draw_values(vary, self.seed, number, attempt)
            try:
                return *self._possible(drawn, f"sample {number}"), drawn, attempt
            except InputError:
                if vary.impossible == "refuse":
                    raise
        raise InputError(
            f"{self.scene.title}: vary: expected values of sample {number} that give a scene, got "
            f"none in {_MOST_DRAWS} draws"
        )

    def _possible(self, drawn: dict[str, Any], which: str) -> tuple[Scene, Rig]:
        """Make the scene and rig of some values; errors name these."""
        values = with_values(self.scene.to_dict(), drawn)
        try:
            scene = parse_scene(values, self.scene.title)
            return scene, build_rig(scene, self.scene.title)
        except InputError as error:
            named = ", ".join(f"{key} = {value}" for key, value in drawn.items())
            raise InputError(f"{error} (vary, {which}: {named})") from error


def _record(frames: Frames) -> tuple[U16, tuple[Particles, ...]]:
    """Record all frames: images (frame, camera, row, column), and particles."""
    images, particles = [], []
    for number in range(frames.scene.frames):
        content = frames.at(number)
        images.append(record_frame(content))
        if content.tracers is not None:
            particles.append(content.tracers.particles)
    return np.stack(images), tuple(particles)


def _moves(first: Particles, second: Particles) -> tuple[F64, F64]:
    _, i, j = np.intersect1d(first.id, second.id, assume_unique=True, return_indices=True)
    return first.position_mm[i], second.position_mm[j] - first.position_mm[i]
