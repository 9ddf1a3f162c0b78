"""Reader of one shard, sample by sample."""

import contextlib
import functools
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from sabench.api import Observation
from sabench.api.truth import Particles, View
from sabench.dataset import schema
from sabench.dataset.arrays import Fetch, read_arrays
from sabench.dataset.cameras import CamerasFile, check_setup, check_true_cameras
from sabench.dataset.hdf5 import check_streams, find_array, read_array
from sabench.dataset.reader import build_observation
from sabench.geometry.camera import Camera
from sabench.images.preprocessing import takes_all_frames
from sabench.utils.arrays import F32, I64, U16
from sabench.utils.errors import InputError
from sabench.utils.files import inside


class StoredShard:
    """Samples of one shard; its files are opened at the first use.

    Attributes
    ----------
    entry : its entry in the manifest.
    """

    def __init__(self, root: Path, contents: schema.ShardedContents, entry: schema.ShardEntry):
        self.entry = entry
        self._root, self._shape = root, contents.shape
        self._truth = contents.truth if isinstance(contents, schema.SamplesManifest) else None
        self._files: dict[str, Any] = {}
        self._arrays: dict[str, Any] = {}
        self._process = os.getpid()

    def __len__(self) -> int:
        return self.entry.samples

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is open: another process opens the files again."""
        return {**self.__dict__, "_files": {}, "_arrays": {}}

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()
        self._files, self._arrays = {}, {}

    def check(self, numbers: I64) -> None:
        """Read all that is not an image, and check that the samples have these numbers.

        Raises InputError for other numbers, missing arrays, or values that contradict each other.
        """
        for side in schema.SIDES[: 1 if self._truth is None else 2]:
            got = self._all(side, "number", (len(self),), "i")
            if not np.array_equal(got, numbers):
                raise InputError(
                    f"{self._path(side)}: number: expected the samples {_listed(numbers)}, got "
                    f"{_listed(got)}"
                )
        self._check_pixels("observation", "images", "u")
        for row in range(len(self)):
            self.setup(row)
            if self._truth is not None:
                for read in (self.seed, self.redrawn, self.drawn, self.true_cameras):
                    read(row)
                if "particles" in self._truth:
                    self.particles(row)
                if "views" in self._truth:
                    self.views(row)
                if "radiance" in self._truth and not row:
                    self._check_pixels("truth", "radiance", "f")

    def _check_pixels(self, side: str, name: str, kind: str) -> None:
        with _reported(self._path(side)):
            node = find_array(self._file(side), name, (len(self), *self._shape), kind)
            check_streams(node, f"{self._path(side)}: {name}")

    def number(self, row: int) -> int:
        """Return the number of a sample."""
        return int(self._all("observation", "number", (len(self),), "i")[row])

    def images(self, row: int) -> U16:
        """Read the grey values (frame, camera, row, column) of a sample."""
        shape = (len(self), *self._shape)
        images: U16 = self._part("observation", "images", shape, "u", slice(row, row + 1))[0]
        return images

    def setup(self, row: int) -> CamerasFile:
        """Read the cameras, wall, grid and sensor levels of a sample."""
        places = self._all("observation", "setup", (len(self),), "i")
        setups: list[CamerasFile] = self._checked("setups", self._read_setups)
        return setups[self._place(places, row, len(setups), "setup")]

    def observation(self, row: int, frame: int, images: U16) -> Observation:
        """Build what a solver sees of a frame of a sample with such images."""
        setup = self.setup(row)
        if not 0 <= frame < setup.frames:
            raise InputError(f"frame {frame}: expected 0 to {setup.frames - 1}")
        return build_observation(
            images[frame],
            setup.cameras,
            setup.grid,
            (setup.sensor.black_dn, setup.sensor.white_dn),
            setup.preprocessing,
            lowest=images.min(axis=0) if takes_all_frames(setup.preprocessing) else None,
            by_camera=setup.sensor.by_camera,
        )

    def true_cameras(self, row: int) -> tuple[Camera, ...]:
        """Read the cameras that took a sample's images."""
        setup = self.setup(row)
        if "true_cameras" not in self._file("truth"):
            return setup.pinholes
        places = self._all("truth", "true_camera", (len(self),), "i")
        values = self._checked("true", lambda: self._texts("truth", "true_cameras"))
        value = values[self._place(places, row, len(values), "true_camera")]
        return check_true_cameras(value, self._path("truth"), setup)

    def seed(self, row: int) -> int:
        """Read the seed of a sample."""
        return int(self._all("truth", "seed", (len(self),), "i")[row])

    def redrawn(self, row: int) -> int:
        """Read how often a sample's values were drawn again."""
        return int(self._all("truth", "redrawn", (len(self),), "i")[row])

    def drawn(self, row: int) -> dict[str, Any]:
        """Read the values of a sample that vary."""
        values = self._checked("drawn", lambda: self._texts("truth", "drawn"))
        if len(values) != len(self) or not isinstance(values[row], dict):
            raise InputError(
                f"{self._path('truth')}: drawn: expected an object for each of {len(self)} samples"
            )
        return dict(values[row])

    def particles(self, row: int) -> tuple[Particles, ...]:
        """Read the true particles of each frame of a sample."""
        return tuple(self._particles(part) for part in self._parts("particles", row))

    def views(self, row: int) -> tuple[tuple[View, ...], ...]:
        """Read the true particle images of each frame and camera of a sample."""
        return tuple(self._views(part) for part in self._parts("views", row))

    def radiance(self, row: int) -> F32:
        """Read the noise-free radiance (frame, camera, row, column), photons / (mm2 sr)."""
        self._need("radiance")
        shape = (len(self), *self._shape)
        light: F32 = self._part("truth", "radiance", shape, "f", slice(row, row + 1))[0]
        return light

    def _particles(self, part: slice) -> Particles:
        def fetch(name: str, shape: tuple[int | None, ...], kinds: str) -> npt.NDArray[Any]:
            return self._part("truth", name, (int(self._ends[-1]), *shape[1:]), kinds, part)

        return read_arrays(Particles, fetch, "particles", self._path("truth"))

    def _views(self, part: slice) -> tuple[View, ...]:
        cameras, count = self._shape[1], part.stop - part.start

        @functools.cache
        def stored(name: str, shape: tuple[int | None, ...], kinds: str) -> npt.NDArray[Any]:
            return self._part(
                "truth", name, (int(self._ends[-1]), cameras, *shape[1:]), kinds, part
            )

        def of_camera(camera: int) -> Fetch:
            return lambda name, shape, kinds: stored(name, shape, kinds)[:, camera]

        return tuple(
            read_arrays(View, of_camera(camera), "views", self._path("truth"), {"n": count})
            for camera in range(cameras)
        )

    def _parts(self, kind: str, row: int) -> Iterator[slice]:
        self._need(kind)
        ends, frames = self._ends, self._shape[0]
        for place in range(row * frames, (row + 1) * frames):
            yield slice(int(ends[place - 1]) if place else 0, int(ends[place]))

    @property
    def _ends(self) -> I64:
        """End rows of the particles of each frame of each sample."""
        shape = (len(self), self._shape[0])
        ends: I64 = self._all("truth", "particles/end", shape, "i").reshape(-1)
        if (np.diff(ends, prepend=0) < 0).any():
            raise InputError(f"{self._path('truth')}: particles/end: expected ascending numbers")
        return ends

    def _need(self, kind: str) -> None:
        if self._truth is not None and kind not in self._truth:
            raise InputError(
                f"{self._root}: expected {kind} in its truth, got one that was generated with "
                f"{', '.join(self._truth) or 'none'}"
            )

    def _place(self, places: I64, row: int, count: int, name: str) -> int:
        place = int(places[row])
        if not 0 <= place < count:
            raise InputError(
                f"{self._root}: {self.entry.name}: {name}: expected 0 to {count - 1}, got {place}"
            )
        return place

    def _read_setups(self) -> list[CamerasFile]:
        path = self._path("observation")
        setups = [check_setup(value, path) for value in self._texts("observation", "setups")]
        for one in setups:
            first = one.cameras[0]
            got = (one.frames, len(one.cameras), first.rows, first.columns)
            if got != self._shape:
                raise InputError(f"{path}: setups: expected images of {self._shape}, got {got}")
        return setups

    def _texts(self, side: str, name: str) -> list[Any]:
        text = self._all(side, name, (None,), "u").tobytes()
        try:
            values = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self._path(side)}: {name}: expected JSON, got {error}") from error
        if not isinstance(values, list):
            raise InputError(f"{self._path(side)}: {name}: expected a list of values")
        return values

    def _checked(self, name: str, read: Callable[[], Any]) -> Any:
        key = f"checked {name}"
        if key not in self._arrays:
            self._arrays[key] = read()
        return self._arrays[key]

    def _all(self, side: str, name: str, shape: tuple[int | None, ...], kind: str) -> Any:
        with _reported(self._path(side)):
            read = functools.partial(read_array, self._file(side), name, shape, kind)
            return self._checked(f"{side}/{name}", read)

    def _part(
        self, side: str, name: str, shape: tuple[int | None, ...], kind: str, part: slice
    ) -> npt.NDArray[Any]:
        """Read a part of an array; the array is checked once."""
        with _reported(self._path(side)):
            find = functools.partial(find_array, self._file(side), name, shape, kind)
            return np.asarray(self._checked(f"node of {side}/{name}", find)[part])

    def _path(self, side: str) -> Path:
        return inside(self._root, schema.shard_file(side, self.entry.name))

    def _file(self, side: str) -> Any:
        """Open a side's file, anew in a process that was forked."""
        if self._process != os.getpid():
            self._files, self._arrays, self._process = {}, {}, os.getpid()
        if side not in self._files:
            if side == "truth" and self._truth is None:
                raise InputError(
                    f"{self._root}: expected a data set with its truth, got the observation side "
                    "alone"
                )
            path = self._path(side)
            if not path.is_file():
                raise InputError(f"{path}: expected a shard, found none")
            with _reported(path):
                self._files[side] = h5py.File(path, "r")
        return self._files[side]


def _listed(numbers: I64) -> str:
    some = ", ".join(str(number) for number in numbers[:3].tolist())
    return some if len(numbers) <= 3 else f"{some}, ..."


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Name the file in any fault of the HDF5 library."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise InputError(
            f"{path}: expected an intact HDF5 file, got {type(error).__name__}: {error}"
        ) from error
