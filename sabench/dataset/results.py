"""A solver's estimate on disk: docs/formats/result.md is its contract."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sabench.api import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.dataset import schema
from sabench.dataset.hdf5 import (
    created,
    finite,
    names_in,
    opened,
    read_array,
    read_attributes,
    uninterrupted,
)
from sabench.dataset.reader import Dataset
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.polynomial_cameras import PlanePolynomials, Projective, Soloff
from sabench.tasks.columns import COLUMNS
from sabench.utils.arrays import I64, triple
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing
from sabench.utils.validation import printable

FORMAT, VERSION = "sabench-result", 1
_ATTRIBUTES = (
    "format",
    "version",
    "dataset",
    "track",
    "solver",
    "parameters",
    "seconds",
    "peak_mb",
    "reconstruction_s",
)
MODELS: dict[type[Any], str] = {
    Camera: "pinhole",
    Projective: "projective",
    Soloff: "soloff",
    PlanePolynomials: "polynomial_planes",
}  # what a camera's `model` says in a result


@dataclass(frozen=True)
class Result:
    """A result file: which data set it belongs to, who made it and at what cost (None where it does not say)."""

    path: Path
    track: str
    solver: str
    parameters: dict[str, Any]
    seconds: float | None
    peak_mb: float | None
    grid: Grid
    reconstruction_s: float | None = None

    def reconstruction(self, frame: int) -> Reconstruction:
        """The estimate of a frame, checked for shape and finite values."""
        group = schema.frame_group(frame)
        with opened(self.path) as file:
            volume = read_array(file, f"{group}/volume", self.grid.shape, "f").astype(np.float32)
            finite(volume, f"{self.path}: {group}/volume")
            if "particles_mm" not in names_in(file, group):
                return Reconstruction(volume)
            found = read_array(file, f"{group}/particles_mm", (None, 3), "f").astype(np.float64)
            return Reconstruction(volume, finite(found, f"{self.path}: {group}/particles_mm"))

    def velocity(self, frame: int) -> Velocity:
        """The field of the pair that starts with a frame, checked for shape and finite values."""
        group = f"{schema.frame_group(frame)}/velocity"
        with opened(self.path) as file:
            valid = read_array(file, f"{group}/valid", (None, None, None), "u") > 0
            field = read_array(file, f"{group}/velocity_mm_s", (*valid.shape, 3), "f").astype(
                np.float64
            )
            low, step = (
                finite(
                    read_array(file, f"{group}/{name}", (3,), "f"), f"{self.path}: {group}/{name}"
                )
                for name in ("low_mm", "step_mm")
            )
        return Velocity(
            triple(low), triple(step), finite(field, f"{self.path}: {group}/velocity_mm_s"), valid
        )

    def particles(self, frame: int) -> FoundParticles:
        """The particles that were found in a frame, checked as `FoundParticles` are."""
        group = f"{schema.frame_group(frame)}/particles"
        with opened(self.path) as file:
            position = read_array(file, f"{group}/position_mm", (None, 3), "f").astype(np.float64)
            n, names = len(position), names_in(file, group)
            intensity = (
                read_array(file, f"{group}/intensity", (n,), "f").astype(np.float64)
                if "intensity" in names
                else None
            )
            number = (
                read_array(file, f"{group}/track", (n,), "iu").astype(np.int64)
                if "track" in names
                else None
            )
        try:
            return FoundParticles(position, intensity, number)
        except InputError as error:
            raise InputError(f"{self.path}: {group}: {error}") from error

    def bubbles(self, frame: int) -> Detections:
        """The bubbles that were found in a frame, checked as `Detections` are."""
        group = f"{schema.frame_group(frame)}/bubbles"
        with opened(self.path) as file:
            center = read_array(file, f"{group}/center_mm", (None, 3), "f").astype(np.float64)
            n = len(center)
            axes = read_array(file, f"{group}/semi_axes_mm", (n, 3), "f").astype(np.float64)
            turn = read_array(file, f"{group}/turn", (n, 3, 3), "f").astype(np.float64)
        try:
            return Detections(center, axes, turn)
        except InputError as error:
            raise InputError(f"{self.path}: {group}: {error}") from error

    def tracks(self, frame: int) -> I64 | None:
        """Numbers (n,) of the tracks that a frame's bubbles belong to, or None where the file has none."""
        group = f"{schema.frame_group(frame)}/bubbles"
        with opened(self.path) as file:
            if "track" not in names_in(file, group):
                return None
            count = len(read_array(file, f"{group}/center_mm", (None, 3), "f"))
            number = read_array(file, f"{group}/track", (count,), "iu").astype(np.int64)
        values, times = np.unique(number, return_counts=True)
        if len(values) < count:
            raise InputError(
                f"{self.path}: {group}/track: expected different numbers, got {values[times.argmax()]} for {times.max()} bubbles"
            )
        return number

    def calibration(self) -> Calibration:
        """The estimated cameras and points."""
        where = f"{self.path}: calibration/cameras"
        with opened(self.path) as file:
            text = read_array(file, "calibration/cameras", (None,), "u").astype(np.uint8).tobytes()
            names = names_in(file, "calibration")
            points = (
                read_array(file, "calibration/points_mm", (None, None, 3), "f").astype(np.float64)
                if "points_mm" in names
                else None
            )
            used = (
                read_array(file, "calibration/used", (None, None, None), "u") > 0
                if "used" in names
                else None
            )
        try:
            records = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{where}: expected JSON, got {error}") from error
        if not isinstance(records, list):
            raise InputError(f"{where}: expected a list, got {type(records).__name__}")
        return Calibration(
            tuple(_camera(record, f"{where}: {number}") for number, record in enumerate(records)),
            points,
            used,
        )


def camera_record(camera: CameraModel) -> dict[str, Any]:
    """A camera of any model as JSON keeps it."""
    return {"model": MODELS[type(camera)], **asdict(cast(Any, camera))}


def _camera(record: Any, where: str) -> CameraModel:
    """A camera from its record."""
    kinds = {name: kind for kind, name in MODELS.items()}
    if not isinstance(record, dict) or record.get("model") not in kinds:
        raise InputError(
            f"{where}: model: expected one of {', '.join(sorted(kinds))}, got {record.get('model') if isinstance(record, dict) else record!r}"
        )
    try:
        made: CameraModel = TypeAdapter(kinds[record["model"]]).validate_python(
            {k: v for k, v in record.items() if k != "model"}
        )
    except ValidationError as error:
        raise InputError(
            f"{where}: {error.errors()[0]['loc']}: {error.errors()[0]['msg']}"
        ) from error
    return made


class ResultWriter:
    """Takes the frames of one result; made by `result_writer`."""

    def __init__(self, file: Any, check: Callable[[], None]) -> None:
        self._file, self._check = file, check

    def add(self, frame: int, reconstruction: Reconstruction) -> None:
        """Store a frame's estimate."""
        volume = reconstruction.volume
        chunk = (1, min(256, volume.shape[1]), min(256, volume.shape[2]))
        with uninterrupted():
            group = self._file.create_group(schema.frame_group(frame))
            group.create_dataset(
                "volume", data=volume, chunks=chunk, compression="gzip", compression_opts=1
            )
            if reconstruction.particles_mm is not None:
                group.create_dataset("particles_mm", data=reconstruction.particles_mm)
            self._file.flush()
        self._check()

    def add_velocity(self, frame: int, velocity: Velocity) -> None:
        """Store the field of the pair that starts with a frame."""
        values = {
            "velocity_mm_s": velocity.velocity_mm_s,
            "valid": velocity.valid.astype(np.uint8),
            "low_mm": np.array(velocity.low_mm),
            "step_mm": np.array(velocity.step_mm),
        }
        with uninterrupted():
            group = self._file.create_group(f"{schema.frame_group(frame)}/velocity")
            for name, value in values.items():
                group.create_dataset(name, data=value)
            self._file.flush()
        self._check()

    def add_particles(self, frame: int, found: FoundParticles) -> None:
        """Store the particles that were found in a frame."""
        with uninterrupted():
            group = self._file.create_group(f"{schema.frame_group(frame)}/particles")
            for name in ("position_mm", "intensity", "track"):
                if getattr(found, name) is not None:
                    group.create_dataset(name, data=getattr(found, name))
            self._file.flush()
        self._check()

    def add_bubbles(self, frame: int, found: Detections) -> None:
        """Store the bubbles that were found in a frame."""
        with uninterrupted():
            group = self._file.create_group(f"{schema.frame_group(frame)}/bubbles")
            for name in ("center_mm", "semi_axes_mm", "turn"):
                group.create_dataset(name, data=getattr(found, name))
            self._file.flush()
        self._check()

    def add_tracks(self, frame: int, number: I64) -> None:
        """Store which tracks the bubbles of a frame, added before, belong to."""
        with uninterrupted():
            self._file[f"{schema.frame_group(frame)}/bubbles"].create_dataset("track", data=number)
            self._file.flush()
        self._check()

    def add_calibration(self, calibration: Calibration) -> None:
        """Store a calibration: cameras as JSON, points and the observations that count."""
        text = canonical_json([camera_record(camera) for camera in calibration.cameras])
        with uninterrupted():
            group = self._file.create_group("calibration")
            group.create_dataset("cameras", data=np.frombuffer(text.encode(), dtype=np.uint8))
            if calibration.points_mm is not None:
                group.create_dataset("points_mm", data=calibration.points_mm)
            if calibration.used is not None:
                group.create_dataset("used", data=calibration.used.astype(np.uint8))
            self._file.flush()
        self._check()

    def set_reconstruction(self, seconds: float) -> None:
        """Say what the reconstruction of a frame cost that a velocity field was measured in: seconds (mean)."""
        with uninterrupted():
            self._file.attrs["reconstruction_s"] = seconds

    def set_cost(self, seconds: float, peak_mb: float | None) -> None:
        """Say what one frame cost: seconds (mean), and the process's peak resident memory (None: not known)."""
        with uninterrupted():
            self._file.attrs["seconds"] = seconds
            if peak_mb is not None:
                self._file.attrs["peak_mb"] = peak_mb


@contextlib.contextmanager
def result_writer(
    target: Path,
    dataset: Dataset,
    solver: str,
    track: str,
    parameters: dict[str, Any],
    *,
    overwrite: bool = False,
) -> Iterator[ResultWriter]:
    """A writer whose frames become the result file `target` when the block ends well, and vanish otherwise."""
    with complete_or_nothing(target, overwrite=overwrite) as path, created(path) as (file, check):
        with uninterrupted():
            file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
            file.attrs["dataset"], file.attrs["track"], file.attrs["solver"] = (
                dataset.content_hash,
                track,
                solver,
            )
            file.attrs["parameters"] = json.dumps(parameters, sort_keys=True)
        yield ResultWriter(file, check)


def open_result(path: str | Path, dataset: Dataset) -> Result:
    """Open a result of this data set.

    Raises
    ------
    InputError
        Not a result file, or one of another data set.
    """
    file_path = Path(path)
    with opened(file_path) as file:
        head = _head(file)
    if head.get("dataset") != dataset.content_hash:
        raise InputError(
            f"{path}: expected a result of the data set {dataset.content_hash[:12]} ({dataset.root}), got one of {str(head.get('dataset'))[:12]}"
        )
    parameters = _parameters(str(head.get("parameters", "{}")), path)
    seconds, peak_mb, before_s = (
        _cost(head.get(key), f"{path}: attribute {key}")
        for key in ("seconds", "peak_mb", "reconstruction_s")
    )
    track = str(head.get("track", "reconstruction"))
    if track not in COLUMNS:
        raise InputError(
            f"{path}: attribute track: expected one of {', '.join(COLUMNS)}, got {track!r}"
        )
    return Result(
        file_path,
        track,
        printable(str(head.get("solver", "unknown"))),
        parameters,
        seconds,
        peak_mb,
        dataset.rig.grid,
        before_s,
    )


def dataset_of(path: Path) -> str:
    """The content hash of the data set that a result file says it belongs to; raises as `open_result` does."""
    with opened(path) as file:
        return str(_head(file).get("dataset"))


def _head(file: Any) -> dict[str, Any]:
    """The attributes of a result file of this format."""
    head = read_attributes(file, _ATTRIBUTES)
    if head.get("format") != FORMAT or head.get("version") != VERSION:
        got = f"{head.get('format')!r} version {head.get('version')}"
        raise InputError(
            f"{file.filename}: expected format {FORMAT!r} version {VERSION}, got {got}"
        )
    return head


def _parameters(text: str, path: str | Path) -> dict[str, Any]:
    where = f"{path}: attribute parameters: expected a JSON object"
    try:
        value = json.loads(text)
        json.dumps(value, allow_nan=False)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}, got {text[:80]!r}") from error
    if not isinstance(value, dict):
        raise InputError(f"{where}, got {text[:80]!r}")
    return value


def _cost(value: Any, where: str) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not 0.0 <= value < float("inf"):
        raise InputError(f"{where}: expected one number that is not negative, got {value!r}")
    return float(value)
