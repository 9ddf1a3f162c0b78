"""Estimates made without the observations, to test the scores.

Each of them must be refused with one sentence, or rank no better than `Task.empty`. They are what
an estimate can choose: where it lies, how much it contains, what it leaves out, and how large its
numbers are. Some of them break their class's rules, as a file of another program may.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.api import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.estimates import Estimate
from sabench.dataset.reader import Dataset
from sabench.dataset.results import result_writer
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.tasks.solve_and_score import score
from sabench.tasks.task import Figures, Task
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError

Make = Callable[[int], Any]  # the estimate of a frame
_MANY = 1_000_000
_FAR_MM = 1e5
_HUGE = 1e300


@dataclass(frozen=True)
class Trial:
    """Scores of one estimate, by its name; or, with `figures` None, the error message."""

    name: str
    figures: Figures | None
    refusal: str = ""


def try_all(task: Task, data: Dataset, out: Path) -> Iterator[Trial]:
    """Score every estimate of a task as a result file written to `out`."""
    for name, make in estimates(task, data).items():
        with result_writer(out, data, "nobody", task.name, {}, overwrite=True) as writer:
            for frame in task.frames(data):
                writer.add(make(frame), frame)
        try:
            yield Trial(name, score(data, out))
        except InputError as error:
            yield Trial(name, None, str(error))


def estimates(task: Task, data: Dataset) -> dict[str, Make]:
    makers: dict[type[Estimate], Callable[[Dataset], dict[str, Make]]] = {
        Reconstruction: _volumes,
        FoundParticles: _particles,
        Detections: _bubbles,
        Velocity: _fields,
        Calibration: _calibrations,
    }
    return {"empty": lambda frame: task.empty(data, frame), **makers[task.estimate](data)}


def _volumes(data: Dataset) -> dict[str, Make]:
    shape, middle = data.setup.grid.shape, _clouds(data)["one element"](0)

    def filled(value: float) -> Reconstruction:
        return Reconstruction(np.full(shape, value, dtype=np.float32))

    def one_voxel(frame: int) -> Reconstruction:
        volume = np.zeros(shape, dtype=np.float32)
        volume[shape[0] // 2, shape[1] // 2, shape[2] // 2] = 1.0
        return Reconstruction(volume)

    def noise(frame: int, share: float = 1.0) -> Reconstruction:
        rng = np.random.default_rng(frame)
        volume = rng.random(shape, dtype=np.float32)
        return Reconstruction(np.where(rng.random(shape) < share, volume, np.float32(0.0)))

    return {
        "constant": lambda frame: filled(1.0),
        "negative": lambda frame: filled(-1.0),
        "random": noise,
        "random points": lambda frame: noise(frame, 1e-3),
        "one element": one_voxel,
        "a million duplicates": lambda frame: replace(
            filled(1.0), particles_mm=np.repeat(middle, _MANY, axis=0)
        ),
        "far away": lambda frame: replace(filled(1.0), particles_mm=middle + _FAR_MM),
        "NaN": lambda frame: filled(np.nan),
        "3e38": lambda frame: filled(3e38),
        "positions of 1e300": lambda frame: replace(filled(1.0), particles_mm=middle + _HUGE),
    }


def _clouds(data: Dataset) -> dict[str, Callable[[int], F64]]:
    """Make clouds (n, 3) of points in mm without the observations."""
    grid = data.setup.grid
    size = np.asarray(grid.voxel_mm) * grid.shape[::-1]
    middle = (np.asarray(grid.low_mm) + size / 2.0)[None]

    def scattered(frame: int, count: int = 60) -> F64:
        rng = np.random.default_rng(frame)
        return np.asarray(middle + (rng.random((count, 3)) - 0.5) * size)

    lattice = (np.stack(np.meshgrid(*[np.arange(20.0)] * 3), axis=-1).reshape(-1, 3) + 0.5) / 20.0
    return {
        "constant": lambda frame: middle + (lattice - 0.5) * size,
        "random": scattered,
        "many at random": lambda frame: scattered(frame, 10_000),
        "one element": lambda frame: middle,
        "a million duplicates": lambda frame: np.repeat(middle, _MANY, axis=0),
        "far away": lambda frame: scattered(frame) + _FAR_MM,
        "NaN": lambda frame: np.full((2, 3), np.nan),
        "1e300": lambda frame: scattered(frame, 2) + _HUGE,
    }


def _particles(data: Dataset) -> dict[str, Make]:
    clouds = _clouds(data)

    def of(cloud: Callable[[int], F64]) -> Make:
        return lambda frame: _unchecked(FoundParticles, position_mm=cloud(frame))

    return {name: of(cloud) for name, cloud in clouds.items()}


def _bubbles(data: Dataset) -> dict[str, Make]:
    clouds = _clouds(data)

    def of(cloud: Callable[[int], F64], radius_mm: float = 1.0) -> Make:
        def make(frame: int) -> Any:
            center_mm = cloud(frame)
            return _unchecked(
                Detections,
                center_mm=center_mm,
                semi_axes_mm=np.full(center_mm.shape, radius_mm),
                turn=np.tile(np.eye(3), (len(center_mm), 1, 1)),
            )

        return make

    radii = {"radius 0": 0.0, "radius -1": -1.0, "radius 1e300": _HUGE, "radius 1e9": 1e9}
    small = {"many small": of(clouds["many at random"], 0.1)}  # no ghosts among large bubbles
    return {name: of(cloud) for name, cloud in clouds.items()} | {
        **{name: of(clouds["random"], radius) for name, radius in radii.items()},
        **small,
    }


def _fields(data: Dataset) -> dict[str, Make]:
    grid = data.setup.grid
    size = np.asarray(grid.voxel_mm) * grid.shape[::-1]

    def field(**changes: Any) -> Any:
        values = {
            "low_mm": tuple((np.asarray(grid.low_mm) + size / 8.0).tolist()),
            "step_mm": tuple((size / 4.0).tolist()),
            "velocity_mm_s": np.zeros((4, 4, 4, 3)),
            "valid": np.ones((4, 4, 4), dtype=np.bool_),
        }
        return _unchecked(Velocity, **(values | changes))

    def noise(frame: int) -> Any:
        rng = np.random.default_rng(frame)
        return field(velocity_mm_s=rng.normal(0.0, 1e3, (4, 4, 4, 3)))

    single, few = np.zeros((4, 4, 4), dtype=np.bool_), np.zeros((4, 4, 4), dtype=np.bool_)
    single[1, 2, 1], few[::2, ::2] = True, True
    node = {"velocity_mm_s": np.zeros((1, 1, 1, 3)), "valid": np.ones((1, 1, 1), dtype=np.bool_)}
    fields = {
        "at rest": field(),
        "constant": field(velocity_mm_s=np.full((4, 4, 4, 3), 1e3)),
        "far away": field(low_mm=(_FAR_MM, _FAR_MM, 0.0)),
        "nothing valid": field(valid=np.zeros((4, 4, 4), dtype=np.bool_)),
        "one valid node": field(valid=single),
        "a quarter of the nodes": field(valid=few),
        "one node": field(**node),
        "one wide node": field(**node, step_mm=(1e9, 1e9, 1e9)),
        "no nodes": field(
            velocity_mm_s=np.zeros((0, 4, 4, 3)), valid=np.zeros((0, 4, 4), dtype=np.bool_)
        ),
        "tiny step": field(step_mm=(1e-9, 1e-9, 1e-9)),
        "step 0": field(step_mm=(0.0, 1.0, 1.0)),
        "negative step": field(step_mm=(-1.0, 1.0, 1.0)),
        "step NaN": field(step_mm=(np.nan, 1.0, 1.0)),
        "step 1e300": field(step_mm=(_HUGE, 1.0, 1.0)),
        "NaN": field(velocity_mm_s=np.full((4, 4, 4, 3), np.nan)),
        "1e300": field(velocity_mm_s=np.full((4, 4, 4, 3), _HUGE)),
        "1e11": field(velocity_mm_s=np.full((4, 4, 4, 3), 1e11)),
        "first node at 1e300": field(low_mm=(_HUGE, 0.0, 0.0)),
    }
    makers: dict[str, Make] = {name: _of_every_frame(estimate) for name, estimate in fields.items()}
    return makers | {"random": noise}


def _calibrations(data: Dataset) -> dict[str, Make]:
    cameras = data.setup.pinholes
    names = [camera.name for camera in cameras]
    calibrations = {
        "far away": Calibration(
            tuple(_moved(camera, _FAR_MM * (-1) ** number) for number, camera in enumerate(cameras))
        ),
        "one place": Calibration(tuple(replace(cameras[0], name=name) for name in names)),
        "turned around": Calibration(tuple(replace(camera, rotation=_BACK) for camera in cameras)),
        "rotation 0": Calibration(
            tuple(replace(camera, rotation=((0.0,) * 3,) * 3) for camera in cameras)
        ),
        "distance 0": _distances(data, 0.0),
        "distance -100": _distances(data, -100.0),
        "distance 1e300": _distances(data, _HUGE),
        "distance 1e11": _distances(data, 1e11),
    }
    if data.shows_target:
        shape = data.calibration_case().initial_mm.shape
        used = np.zeros((len(cameras), *shape[:2]), dtype=np.bool_)
        two = used.copy()
        two[:2, 0, 0] = True
        rng = np.random.default_rng(0)
        calibrations |= {
            "nothing used": Calibration(cameras, None, used),
            "one point used": Calibration(cameras, None, two),
            "points NaN": Calibration(cameras, np.full(shape, np.nan)),
            "points 1e300": Calibration(cameras, np.full(shape, _HUGE)),
            "points 1e11": Calibration(cameras, np.full(shape, 1e11)),
            "points behind the cameras": Calibration(cameras, np.full(shape, -1e6)),
            "constant points": Calibration(cameras, np.zeros(shape)),
            "random points": Calibration(cameras, rng.normal(0.0, 100.0, shape), used),
        }
    return {name: _of_every_frame(calibration) for name, calibration in calibrations.items()}


_BACK: Any = tuple(triple(row) for row in rotation_matrices(np.array([0.0, np.pi, 0.0])))


def _moved(camera: Any, away_mm: float) -> Any:
    x, y, z = camera.center_mm
    return replace(camera, center_mm=(x + away_mm, y, z))


def _distances(data: Dataset, distance_mm: float) -> Calibration:
    cameras: Any = data.setup.cameras
    changed = (replace(camera, principal_distance_mm=distance_mm) for camera in cameras)
    return Calibration(tuple(changed))


def _of_every_frame(estimate: Estimate) -> Make:
    return lambda frame: estimate


def _unchecked(kind: type[Estimate], **values: Any) -> Any:
    """Make an estimate without its checks, as a file of another program may hold it."""
    estimate = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(estimate, name, value)
    return estimate
