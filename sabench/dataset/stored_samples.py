"""Samples on disk: of a shard, or groups of frames of a data set."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
import numpy.typing as npt

from sabench.api import Observation
from sabench.api.truth import Particles, ParticleView
from sabench.dataset import schema
from sabench.dataset.arrays import Fetch, read_declared
from sabench.dataset.cameras import CamerasFile, check_setup, check_true_cameras
from sabench.dataset.hdf5 import check_streams, find_array, name_faults, read_array
from sabench.dataset.reader import Dataset, StoredFrames
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F32, I64, U16
from sabench.utils.errors import InputError
from sabench.utils.files import inside

Value = TypeVar("Value")


class StoredShard:
    """Samples of one shard; its files are opened at the first use.

    Attributes
    ----------
    entry : what the manifest says of it.
    shape : of each sample's images (frame, camera, row, column).
    """

    def __init__(self, root: Path, contents: schema.ShardedContents, entry: schema.ShardEntry):
        self.entry = entry
        self._root, self.shape = root, contents.shape
        self._truth = contents.truth if isinstance(contents, schema.SamplesManifest) else None
        self._files: dict[str, Any] = {}
        self._arrays: dict[str, Any] = {}
        self._process = os.getpid()

    def __len__(self) -> int:
        return self.entry.samples

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is open: another process opens files of its own."""
        return {**self.__dict__, "_files": {}, "_arrays": {}}

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()
        self._files, self._arrays = {}, {}

    def sample(self, row: int) -> StoredSample:
        """Read the number and the images of a sample."""
        number, frames = self.integer("observation", "number", row), ShardSample(self, row)
        return StoredSample(number, frames.images, frames, range(self.shape[0]))

    def check(self, numbers: I64) -> None:
        """Read all that is not an image, and check that the samples have these numbers.

        Raises InputError for other numbers, missing arrays, or values that contradict each other.
        """
        for side in schema.SIDES[: 1 if self._truth is None else 2]:
            got = self.array(side, "number", (len(self),), "i")
            if not np.array_equal(got, numbers):
                raise InputError(
                    f"{self.path(side)}: number: expected the samples {_listed(numbers)}, got "
                    f"{_listed(got)}"
                )
        self._check_pixels("observation", "images", "u")
        for row in range(len(self)):
            one = ShardSample(self, row)
            _ = one.setup
            if self._truth is None:
                continue
            _ = one.seed, one.redrawn, one.drawn, one.true_cameras
            for kind, read in (("particles", one.particles), ("views", one.views)):
                for frame in range(self.shape[0] if kind in self._truth else 0):
                    read(frame)
            if "radiance" in self._truth and not row:
                self._check_pixels("truth", "radiance", "f")

    def _check_pixels(self, side: str, name: str, kind: str) -> None:
        with name_faults(self.path(side)):
            node = find_array(self.file(side), name, (len(self), *self.shape), kind)
            check_streams(node, f"{self.path(side)}: {name}")

    def need(self, kind: str) -> None:
        """Refuse a kind of truth that the data set was generated without."""
        if self._truth is not None and kind not in self._truth:
            raise InputError(
                f"{self._root}: expected {kind} in its truth, got one that was generated with "
                f"{', '.join(self._truth) or 'none'}"
            )

    def setups(self) -> list[CamerasFile]:
        """Read the setups that samples share."""
        path = self.path("observation")
        setups = [check_setup(value, path) for value in self.values("observation", "setups")]
        for one in setups:
            first = one.cameras[0]
            got = (one.frames, len(one.cameras), first.rows, first.columns)
            if got != self.shape:
                raise InputError(f"{path}: setups: expected images of {self.shape}, got {got}")
        return setups

    @property
    def ends(self) -> I64:
        """Rows at which the particles of each frame of each sample end."""
        ends: I64 = self.array("truth", "particles/end", (len(self), self.shape[0]), "i")
        if (np.diff(ends.reshape(-1), prepend=0) < 0).any():
            raise InputError(f"{self.path('truth')}: particles/end: expected ascending numbers")
        return ends.reshape(-1)

    def integer(self, side: str, name: str, row: int) -> int:
        """Read a sample's value of an array with one number for each."""
        return int(self.array(side, name, (len(self),), "i")[row])

    def pick(self, values: Sequence[Value], side: str, name: str, row: int) -> Value:
        """Select the one of some values that a sample has."""
        place = self.integer(side, name, row)
        if not 0 <= place < len(values):
            raise InputError(
                f"{self._root}: {self.entry.name}: {name}: expected 0 to {len(values) - 1}, got "
                f"{place}"
            )
        return values[place]

    def values(self, side: str, name: str) -> list[Any]:
        """Read a list of JSON values."""
        text = self.array(side, name, (None,), "u").tobytes()
        try:
            values = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self.path(side)}: {name}: expected JSON, got {error}") from error
        if not isinstance(values, list):
            raise InputError(f"{self.path(side)}: {name}: expected a list of values")
        return values

    def array(self, side: str, name: str, shape: tuple[int | None, ...], kind: str) -> Any:
        """Read an array once."""
        with name_faults(self.path(side)):
            read = functools.partial(read_array, self.file(side), name, shape, kind)
            return self.once(f"{side}/{name}", read)

    def part(
        self, side: str, name: str, shape: tuple[int | None, ...], kind: str, part: Any
    ) -> npt.NDArray[Any]:
        """Read a part of an array; the array is checked once."""
        with name_faults(self.path(side)):
            find = functools.partial(find_array, self.file(side), name, shape, kind)
            return np.asarray(self.once(f"node of {side}/{name}", find)[part])

    def once(self, name: str, read: Callable[[], Value]) -> Value:
        """Read something, unless it has been read since the files were opened."""
        if name not in self._arrays:
            self._arrays[name] = read()
        value: Value = self._arrays[name]
        return value

    def path(self, side: str) -> Path:
        """Name the file of a side."""
        return inside(self._root, schema.shard_file(side, self.entry.name))

    def file(self, side: str) -> Any:
        """Open a side's file, anew in a process that was forked."""
        if self._process != os.getpid():
            self._files, self._arrays, self._process = {}, {}, os.getpid()
        if side not in self._files:
            if side == "truth" and self._truth is None:
                raise InputError(
                    f"{self._root}: expected a data set with its truth, got the observation side "
                    "alone"
                )
            path = self.path(side)
            if not path.is_file():
                raise InputError(f"{path}: expected a shard, found none")
            with name_faults(path):
                self._files[side] = h5py.File(path, "r")
        return self._files[side]


class ShardSample(StoredFrames):
    """Frames of one sample of a shard."""

    def __init__(self, shard: StoredShard, row: int) -> None:
        self._shard, self._row = shard, row

    @property
    def setup(self) -> CamerasFile:
        """Read the cameras, wall, grid and sensor levels."""
        setups = self._shard.once("setups", self._shard.setups)
        return self._shard.pick(setups, "observation", "setup", self._row)

    @property
    def true_cameras(self) -> tuple[Camera, ...]:
        """Read the cameras that took the images."""
        shard, setup = self._shard, self.setup
        if "true_cameras" not in shard.file("truth"):
            return setup.pinholes
        values = shard.once("true", lambda: shard.values("truth", "true_cameras"))
        value = shard.pick(values, "truth", "true_camera", self._row)
        return check_true_cameras(value, shard.path("truth"), setup)

    @property
    def seed(self) -> int:
        """Read the seed."""
        return self._shard.integer("truth", "seed", self._row)

    @property
    def redrawn(self) -> int:
        """Read how often the values were drawn again."""
        return self._shard.integer("truth", "redrawn", self._row)

    @property
    def drawn(self) -> dict[str, Any]:
        """Read the values that vary."""
        shard = self._shard
        values = shard.once("drawn", lambda: shard.values("truth", "drawn"))
        if len(values) != len(shard) or not isinstance(values[self._row], dict):
            raise InputError(
                f"{shard.path('truth')}: drawn: expected an object for each of {len(shard)} samples"
            )
        return dict(values[self._row])

    @functools.cached_property
    def images(self) -> U16:
        """Read the grey values (frame, camera, row, column)."""
        shape = (len(self._shard), *self._shard.shape)
        return self._shard.part("observation", "images", shape, "u", self._row)

    def raw_images(self, frame: int) -> U16:
        """Select the grey values (camera, row, column) of a frame."""
        images: U16 = self.images[frame]
        return images

    def radiance(self, frame: int) -> F32:
        """Read the noise-free radiance (camera, row, column), photons / (mm2 sr)."""
        self._shard.need("radiance")
        shape = (len(self._shard), *self._shard.shape)
        return self._shard.part("truth", "radiance", shape, "f", (self._row, frame))

    def particles(self, frame: int) -> Particles:
        """Read the true particles of a frame."""
        fetch = self._fetch("particles", frame)
        return read_declared(Particles, fetch, "particles", self._shard.path("truth"))

    def views(self, frame: int) -> list[ParticleView]:
        """Read the true particle images of a frame in each camera."""
        cameras, path = self._shard.shape[1], self._shard.path("truth")
        fetch = self._fetch("views", frame, cameras)

        def of_camera(camera: int) -> Fetch:
            return lambda name, shape, kinds: fetch(name, shape, kinds)[:, camera]

        return [
            read_declared(ParticleView, of_camera(camera), "views", path)
            for camera in range(cameras)
        ]

    def _fetch(self, kind: str, frame: int, *sizes: int) -> Fetch:
        """Make a reader of arrays (particle, *sizes, ...) for the particles of a frame."""
        self._shard.need(kind)
        ends, place = self._shard.ends, self._row * self._shard.shape[0] + frame
        part = slice(int(ends[place - 1]) if place else 0, int(ends[place]))

        @functools.cache
        def fetch(name: str, shape: tuple[int | None, ...], kinds: str) -> npt.NDArray[Any]:
            stored = (int(ends[-1]), *sizes, *shape[1:])
            return self._shard.part("truth", name, stored, kinds, part)

        return fetch


@dataclass(frozen=True)
class StoredSample:
    """One sample on disk; its truth is read when it is asked for.

    Attributes
    ----------
    number : number of the sample.
    images : (frame, camera, row, column) grey values.
    """

    number: int
    images: U16
    _store: Dataset | ShardSample
    _frames: range  # of the store
    _setup: CamerasFile | None = None  # None: that of the store

    @property
    def setup(self) -> CamerasFile:
        """Nominal cameras, wall, grid and sensor levels, which solvers receive."""
        return self._setup or self._store.setup

    def observation(self, frame: int = 0) -> Observation:
        """Build what a solver sees of a frame."""
        if not 0 <= frame < len(self._frames):
            raise InputError(f"frame {frame}: expected 0 to {len(self._frames) - 1}")
        return self._store.observation(self._frames[frame])

    @property
    def seed(self) -> int:
        """Seed of the sample: truth, as all below, not for solvers."""
        return self._store.seed

    @property
    def redrawn(self) -> int:
        """Number of times that its values were drawn again, as no such scene can be."""
        return self._store.redrawn if isinstance(self._store, ShardSample) else 0

    @property
    def drawn(self) -> dict[str, Any]:
        """Values of the keys that vary."""
        return self._store.drawn if isinstance(self._store, ShardSample) else {}

    @property
    def true_cameras(self) -> tuple[Camera, ...]:
        """Cameras that took the images."""
        return self._store.true_cameras

    @property
    def particles(self) -> tuple[Particles, ...]:
        """True particles of each frame, the same rows for the same `id`."""
        return tuple(self._store.particles(frame) for frame in self._frames)

    @property
    def views(self) -> tuple[tuple[ParticleView, ...], ...]:
        """True particle images of each frame and camera."""
        return tuple(tuple(self._store.views(frame)) for frame in self._frames)

    @property
    def radiance(self) -> F32:
        """Radiance (frame, camera, row, column) without noise, photons / (mm2 sr)."""
        return np.stack([self._store.radiance(frame) for frame in self._frames])


class FrameGroups:
    """Samples of a data set: its groups of pulses, or else its frames."""

    def __init__(self, data: Dataset) -> None:
        self._data, self._size = data, data.setup.pulses
        if data.setup.frames % self._size:
            raise InputError(f"{data.root}: expected frames in groups of {self._size}")

    def __len__(self) -> int:
        return self._data.setup.frames // self._size

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def sample(self, row: int) -> StoredSample:
        """Read the images of a group, and select its times."""
        frames = range(row * self._size, (row + 1) * self._size)
        times = tuple(self._data.setup.time_s(frame) for frame in frames)
        setup = self._data.setup.model_copy(update={"frames": self._size, "times_s": times})
        images = np.stack([self._data.raw_images(frame) for frame in frames])
        return StoredSample(row, images, self._data, frames, setup)


def _listed(numbers: I64) -> str:
    some = ", ".join(str(number) for number in numbers[:3].tolist())
    return some if len(numbers) <= 3 else f"{some}, ..."
