"""Reader of data sets: observations for solvers, truth for scores."""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sabench.api import CalibrationCase, Observation, Shown, truth
from sabench.dataset import schema
from sabench.dataset.arrays import AnyArrays, group_of, read_declared
from sabench.dataset.cameras import CamerasFile, read_cameras, read_true_cameras
from sabench.dataset.hdf5 import names_in, open_hdf5, read_array
from sabench.dataset.recorded import ReferencesFile, read_references
from sabench.dataset.schema import Contents, Manifest, RecordedManifest
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel, describe_cameras
from sabench.geometry.grid import Grid
from sabench.images.flaws import Flaws
from sabench.images.preprocessing import WHITE, Step, preprocess, takes_all_frames
from sabench.images.tiff_exr import read_exr, read_tiff
from sabench.plotting.card import Card
from sabench.scenes import Scene
from sabench.utils.arrays import F32, F64, U16, Bool
from sabench.utils.errors import InputError
from sabench.utils.files import inside, is_file, read_toml
from sabench.utils.validation import validate


def build_observation(
    images: U16,
    cameras: tuple[CameraModel, ...],
    grid: Grid,
    levels: tuple[float, float],
    steps: Sequence[Step],
    *,
    lowest: U16 | None = None,
    by_camera: Sequence[tuple[float, float]] = (),
    backlit: bool = False,
    masked: Bool | None = None,
) -> Observation:
    """Build the observation of raw images, after the steps of preprocessing.

    Steps would spread hot pixels, and darken reflections: both are replaced before, unless the
    images are backlit.

    Parameters
    ----------
    levels : grey values of no light and of saturation.
    lowest : each pixel's least value over all frames; only where a step needs it.
    by_camera : those of each camera, where they differ: all images are brought to one black level.
    masked : pixels (camera, row, column) that do not count, as if a reflection covered them.
    """
    if by_camera:
        lowest = None if lowest is None else _align_levels(lowest, levels[0], by_camera)[0]
        images, levels = _align_levels(images, levels[0], by_camera)
    if not steps and masked is None:
        return Observation(images, cameras, grid, *levels)
    flaws = None
    if not backlit:
        from sabench.images.repair import repair  # numba is loaded at the first use

        black = np.uint16(np.rint(levels[0]))
        shown = images if masked is None else np.where(masked, black, images)
        images, flaws = repair(shown, *levels)
        if masked is not None:
            images = np.where(masked, black, images)
            flaws = Flaws(flaws.points, flaws.covered | masked)
    if steps:
        images, levels = preprocess(images, *levels, steps, lowest), (0.0, float(WHITE))
    return Observation(images, cameras, grid, *levels, flaws)


def _align_levels(
    images: U16, black_dn: float, by_camera: Sequence[tuple[float, float]]
) -> tuple[U16, tuple[float, float]]:
    """Subtract each camera's dark level and add `black_dn`, in whole grey values.

    Returns the images with one black and one white level, which saturated pixels have.
    """
    widest = max(round(camera_white - black) for black, camera_white in by_camera)
    white = min(round(black_dn) + widest, np.iinfo(np.uint16).max)
    aligned = np.empty_like(images)
    for image, out, (black, camera_white) in zip(images, aligned, by_camera, strict=True):
        grey = image.astype(np.int64) - round(black) + round(black_dn)
        out[:] = np.where(image >= camera_white, white, np.clip(grey, 0, white))
    return aligned, (black_dn, float(white))


class StoredFrames(Protocol):
    """Frames on disk with one setup: a data set folder, or a sample of a shard.

    A store reads its setup and images, from which observations are built here, and its truth:
    `seed`, `true_cameras`, and the `particles`, `views` and `radiance` of a frame.
    """

    @property
    def setup(self) -> CamerasFile:
        """Cameras, wall, grid and sensor levels that solvers receive."""

    def raw_images(self, frame: int) -> U16:
        """Read the images (camera, row, column) of a frame as they were recorded."""

    @property
    def masked(self) -> Bool | None:
        """Pixels (camera, row, column) that masks leave out; None without masks."""
        return None

    def observation(self, frame: int, steps: Sequence[Step] | None = None) -> Observation:
        """Read one frame as a solver receives it, or after other steps of preprocessing."""
        images, setup = self.raw_images(frame), self.setup
        steps = setup.preprocessing if steps is None else steps
        return build_observation(
            images,
            setup.cameras,
            setup.grid,
            (setup.sensor.black_dn, setup.sensor.white_dn),
            steps,
            lowest=self._lowest if takes_all_frames(steps) else None,
            by_camera=setup.sensor.by_camera,
            backlit="bubbles" in setup.shows,
            masked=self.masked,
        )

    @cached_property
    def _lowest(self) -> U16:
        lowest = self.raw_images(0).copy()
        for frame in range(1, self.setup.frames):
            np.minimum(lowest, self.raw_images(frame), out=lowest)
        return lowest


@dataclass(frozen=True, repr=False)
class Dataset(Card, StoredFrames):
    """Data set folder; a frame is read when it is requested."""

    root: Path
    contents: Contents

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (f"Dataset {self.root}",)
        setup, truth = self.setup, "with" if self.has_truth else "without"
        even = setup.frames > 1 and setup.times_s is None
        yield "frames", f"{setup.frames}{f', {setup.interval_s:g} s apart' if even else ''}"
        yield "cameras", describe_cameras(setup.cameras)
        yield "shows", f"{', '.join(setup.shows)}, {truth} truth"
        yield "hash", self.content_hash[:12]

    def _picture(self) -> bytes:
        """Draw the first camera's first image."""
        from sabench.plotting.pictures import thumbnail

        sensor, dark = self.setup.sensor, not {"bubbles", "code"}.isdisjoint(self.setup.shows)
        return thumbnail(self.raw_image(0, 0), sensor.black_dn, sensor.white_dn, dark=dark)

    @property
    def content_hash(self) -> str:
        """Hash of the bytes of this copy of the data set."""
        return self.contents.content_hash

    @property
    def identity(self) -> str | None:
        """Hash of what defines the data set, equal on all processors.

        None for the observation side alone, which must not disclose it, and for data sets of before
        it was introduced.
        """
        return self.contents.identity if isinstance(self.contents, Manifest) else None

    @property
    def has_truth(self) -> bool:
        """True unless it is recorded, or the folder holds the observation side alone."""
        return isinstance(self.contents, Manifest)

    @property
    def recorded(self) -> bool:
        """True for images recorded by real cameras, without truth."""
        return isinstance(self.contents, RecordedManifest)

    @property
    def manifest(self) -> Manifest:
        """Contents and origin: truth, not for solvers."""
        if not isinstance(self.contents, Manifest):
            recorded = "a recorded one, which has none: see `sabench quality`"
            got = recorded if self.recorded else "the observation side alone"
            raise InputError(f"{self.root}: expected a data set with its truth, got {got}")
        return self.contents

    @cached_property
    def setup(self) -> CamerasFile:
        """Read the cameras, wall, grid and sensor levels that solvers receive."""
        return read_cameras(self.root)

    @cached_property
    def true_cameras(self) -> tuple[Camera, ...]:
        """Read the cameras that took the images: truth, not for solvers.

        They are those of `setup`, unless the data set has a calibration error.
        """
        if schema.TRUE_CAMERAS not in self.manifest.files:
            return self.setup.pinholes
        return read_true_cameras(self.root, self.setup)

    @property
    def seed(self) -> int:
        """Seed of all random numbers: truth, not for solvers."""
        return self.manifest.seed

    @cached_property
    def scene(self) -> Scene:
        """Read the resolved scene: truth, not for solvers."""
        path = self._truth(schema.SCENE)
        scene = validate(Scene, read_toml(path), str(path))
        return scene.with_files(
            {table: inside(self.root, file.as_posix()) for table, file in scene.files.items()}
        )

    @cached_property
    def masked(self) -> Bool | None:
        """Read which pixels (camera, row, column) masks leave out; None without masks."""
        if not any(schema.mask_name(one.name) in self.contents.files for one in self.setup.cameras):
            return None
        first = self.setup.cameras[0]
        masked = np.zeros((len(self.setup.cameras), first.rows, first.columns), dtype=np.bool_)
        for camera, leaves_out in zip(self.setup.cameras, masked, strict=True):
            name = schema.mask_name(camera.name)
            if name in self.contents.files:
                leaves_out[:] = read_tiff(inside(self.root, name), leaves_out.shape) == 0
        return masked

    def raw_images(self, frame: int) -> U16:
        """Read the images (camera, row, column) of a frame as they were recorded."""
        cameras = range(len(self.setup.cameras))
        return np.stack([self.raw_image(camera, frame) for camera in cameras])

    def raw_image(self, number: int, frame: int) -> U16:
        """Read the image (row, column) of a frame and camera as it was recorded."""
        self._check_frame(frame)
        camera = self.setup.cameras[number]
        if self.references is not None:
            return self.references.read(camera.name, frame, (camera.rows, camera.columns))
        path = inside(self.root, schema.image_name(camera.name, frame, "tif"))
        return read_tiff(path, (camera.rows, camera.columns))

    @cached_property
    def references(self) -> ReferencesFile | None:
        """Read where the images of a recorded data set lie, if they are not in it."""
        if not self.recorded or schema.REFERENCES not in self.contents.files:
            return None
        return read_references(self.root)

    def radiance(self, frame: int) -> list[F32]:
        """Read the noise-free radiance of every camera, photons / (mm2 sr).

        It is truth, not for solvers.
        """
        self._check_frame(frame)
        return [
            read_exr(
                self._truth(schema.image_name(camera.name, frame, "exr")),
                (camera.rows, camera.columns),
            )
            for camera in self.setup.cameras
        ]

    def particles(self, frame: int) -> truth.Particles:
        """Read the true particles of a frame."""
        with self._open_truth(frame) as file:
            return _read(file, truth.Particles, frame)

    def views(self, frame: int) -> list[truth.ParticleView]:
        """Read every camera's true particle images, in the cameras' order."""
        with self._open_truth(frame) as file:
            n = len(read_array(file, f"{schema.frame_group(frame)}/id", (None,), "i"))
            return [
                _read(file, truth.ParticleView, frame, one.name, n=n) for one in self.setup.cameras
            ]

    def bubbles(self, frame: int) -> truth.Bubbles:
        """Read the true bubbles of a frame."""
        with self._open_truth(frame) as file:
            return _read(file, truth.Bubbles, frame)

    def solids(self, frame: int) -> list[truth.Solid]:
        """Read the true bodies of a frame."""
        with self._open_truth(frame) as file:
            count = len(names_in(file, f"{schema.frame_group(frame)}/bodies"))
            return [_read(file, truth.Solid, frame, number) for number in range(count)]

    def sight(self, frame: int, camera: CameraModel) -> truth.Sight:
        """Read the true view of a frame's bubbles and bodies by one camera."""
        with self._open_truth(frame) as file:
            n = len(read_array(file, f"{schema.frame_group(frame)}/bubbles/id", (None,), "i"))
            sizes = {"rows": camera.rows, "columns": camera.columns, "n": n}
            return _read(file, truth.Sight, frame, camera.name, **sizes)

    @property
    def shows(self) -> tuple[Shown, ...]:
        """Kinds of objects in the frames: a target, or particles, bubbles, or both.

        Bodies may be there in any case.
        """
        return ("target",) if self.shows_target else self.setup.shows

    @property
    def shows_target(self) -> bool:
        """True if its frames show a calibration target."""
        return schema.TARGET in self.contents.files

    def calibration_case(self) -> CalibrationCase:
        """Read all frames of a target as a solver receives them."""
        target, setup = self._target(), self.setup
        sizes = {"camera": len(setup.cameras), "frame": setup.frames}
        with open_hdf5(inside(self.root, schema.POINTS)) as file:
            points = _read(file, truth.TargetPoints, point=len(target.points_mm), **sizes)
        return CalibrationCase(
            target,
            points.pixels,
            setup.pinholes,
            points.initial_mm,
            points.known_mm,
            points.known_sigma_mm,
            setup.unknown,
            setup.known_cameras,
        )

    def placed(self) -> truth.Placed:
        """Read the target's true positions and rotations: not for solvers."""
        target = self._target()
        with open_hdf5(self._truth()) as file:
            poses = [_read(file, truth.TargetPose, n) for n in range(self.setup.frames)]
            return truth.Placed(target, tuple(poses))

    def sightings(self) -> tuple[F64, Bool]:
        """Read the true pixels of the target's points, and which are outliers.

        Pixels (camera, frame, point, 2), NaN where a camera does not see the point; outliers
        (camera, frame, point).

        Truth, not for solvers.
        """
        sizes = {"frame": self.setup.frames, "point": len(self._target().points_mm)}
        with open_hdf5(self._truth()) as file:
            sightings = [
                _read(file, truth.Sighting, which=camera.name, **sizes)
                for camera in self.setup.cameras
            ]
        pixels, outliers = [one.pixel for one in sightings], [one.outlier for one in sightings]
        return np.stack(pixels), np.stack(outliers)

    def _target(self) -> truth.Target:
        if not self.shows_target:
            raise InputError(
                f"{self.root}: expected a data set with a calibration target, got one with "
                "particles"
            )
        return schema.read_target(self.root)

    def _truth(self, name: str = schema.TRUTH) -> Path:
        _ = self.manifest  # raises where there is no truth
        return inside(self.root, name)

    def _open_truth(self, frame: int) -> contextlib.AbstractContextManager[Any]:
        self._check_frame(frame)
        return open_hdf5(self._truth())

    def _check_frame(self, frame: int) -> None:
        if not 0 <= frame < self.setup.frames:
            raise InputError(f"{self.root}: frame {frame}: expected 0 to {self.setup.frames - 1}")


def _read(
    file: Any, kind: type[AnyArrays], frame: int = 0, which: str | int = "", **sizes: int
) -> AnyArrays:
    """Read what a class declares from an HDF5 file."""
    group = group_of(kind, frame, which)
    names = names_in(file, group) if any(one.optional for one in kind.ARRAYS) else ()
    fetch = functools.partial(read_array, file)
    return read_declared(kind, fetch, group, file.filename, sizes, names)


def open_dataset(path: str | Path) -> Dataset:
    """Open a data set folder.

    Checksums are not checked here: see `verify`.

    Raises InputError for a missing data set, or one of another format.
    """
    root = Path(path)
    contents = schema.read_manifest(root)
    if isinstance(contents, schema.ShardedContents):
        raise InputError(
            f"{root}: expected a data set of frames, got one of independent samples: open it with "
            "sabench.open_samples"
        )
    return Dataset(root, contents)


def datasets_in(folder: Path) -> Iterator[Dataset]:
    """Open the data sets that a folder is or holds; skip what cannot be read."""
    for root in (folder, *sorted(folder.iterdir())):
        if not root.name.startswith(".") and is_file(root / schema.MANIFEST):
            with contextlib.suppress(InputError):
                yield open_dataset(root)
