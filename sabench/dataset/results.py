"""Result files of solvers; docs/formats/result.md is their contract."""

import contextlib
import functools
import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

import h5py
import numpy as np

from sabench.api import estimates
from sabench.api.estimates import Calibration, Estimate
from sabench.api.solvers import TaskName
from sabench.dataset import hdf5
from sabench.dataset.arrays import group_of, read_declared, write_arrays
from sabench.dataset.reader import Dataset
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.camera_records import decode_cameras
from sabench.geometry.grid import Grid
from sabench.plotting.card import Card
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from sabench.utils.validation import printable

FORMAT = "sabench-result"
VERSION = 2
_COSTS = ("seconds", "peak_mb", "compile_s", "reconstruction_s", "cpu_share")
_FLAGS = ("isolated", "whole_process")
_ATTRIBUTES = (
    *("format", "version", "dataset", "identity", "task", "solver", "parameters"),
    *_COSTS,
    *_FLAGS,
)
ITERATIONS = "iterations"  # group of estimates on the way
MOST_ITERATIONS = 100  # of which a file may have estimates
AnEstimate = TypeVar("AnEstimate", bound=Estimate)


@dataclass(frozen=True, repr=False)
class Result(Card):
    """Result file: its data set, its solver and the costs.

    A cost that the file does not give is None. `seconds` excludes `compile_s`, the time for
    compiling or loading kernels. `isolated`: the solver received the observation side only.
    `whole_process`: `seconds` is the run time of a program's process. `cpu_share` is the CPU
    seconds per second of the solver's process while it solved: below one it waited, above one it
    used several cores.
    """

    path: Path
    task: TaskName
    solver: str
    parameters: dict[str, Any]
    seconds: float | None
    peak_mb: float | None
    grid: Grid
    reconstruction_s: float | None = None
    compile_s: float | None = None
    cpu_share: float | None = None
    isolated: bool = False
    whole_process: bool = False

    @property
    def costs(self) -> dict[str, float | None]:
        """Costs and flags by their names in the file."""
        return {name: getattr(self, name) for name in (*_COSTS, *_FLAGS)}

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (f"Result {self.path}",)
        yield "task", self.task
        yield "solver", self.solver
        memory = f", at most {self.peak_mb:.0f} MB" if self.peak_mb else ""
        yield "time", f"{self.seconds:.3g} s per frame{memory}" if self.seconds else "unknown"
        yield "grid", str(self.grid)

    def _picture(self) -> bytes:
        """Draw the first frame's estimate."""
        kinds: dict[str, type[Estimate]] = {"particles": estimates.FoundParticles}
        kinds |= {"velocimetry": estimates.Velocity, "bubbles": estimates.Detections}
        return self.read(kinds.get(self.task, estimates.Reconstruction))._picture()

    def read(self, kind: type[AnEstimate], frame: int = 0) -> AnEstimate:
        """Read an estimate, by the arrays that its class declares.

        Raises InputError for an array that is missing, has another shape or type, or holds values
        that are not finite or that the estimate refuses.
        """
        return self._read(kind, group_of(kind, frame))

    def iterations(self, kind: type[AnEstimate]) -> Iterator[tuple[int, float, AnEstimate]]:
        """Read numbers, seconds and estimates of the iterations that it stores.

        Raises as `read` does.
        """
        with hdf5.open_hdf5(self.path) as file:
            names = hdf5.names_in(file, ITERATIONS)
            numbers = sorted(int(name) for name in names if name.isascii() and name.isdigit())
        if len(numbers) > MOST_ITERATIONS:
            raise InputError(
                f"{self.path}: {ITERATIONS}: expected at most {MOST_ITERATIONS}, got {len(numbers)}"
            )
        for number in numbers:
            group = f"{ITERATIONS}/{number}"
            with hdf5.open_hdf5(self.path) as file:
                (seconds,) = hdf5.read_array(file, f"{group}/seconds", (1,), "f")
            took = _cost(float(seconds), f"{self.path}: {group}/seconds")
            yield number, took or 0.0, self._read(kind, group)

    def _read(self, kind: type[AnEstimate], group: str) -> AnEstimate:
        sizes = dict(zip("zyx", self.grid.shape, strict=True))
        with hdf5.open_hdf5(self.path) as file:
            fetch, names = functools.partial(hdf5.read_array, file), hdf5.names_in(file, group)
            return read_declared(kind, fetch, group, file.filename, sizes, names)


class ResultWriter:
    """Writer of one result's estimates; made by `result_writer`.

    `keeps_iterations` asks for estimates on the way, of solvers that have them.
    """

    keeps_iterations = False

    def __init__(self, file: Any, check: Callable[[], None]) -> None:
        self._file, self._check = file, check

    def add(self, estimate: Estimate, frame: int = 0) -> None:
        """Store an estimate, by the arrays that its class declares."""
        self._add(estimate, group_of(type(estimate), frame))

    def add_iteration(self, estimate: Estimate, number: int, seconds: float) -> None:
        """Store the first frame's estimate after an iteration, and its seconds."""
        self._add(estimate, f"{ITERATIONS}/{number}")
        with hdf5.delay_interrupts():
            self._file[ITERATIONS][str(number)].create_dataset("seconds", data=[seconds])

    def _add(self, estimate: Estimate, name: str) -> None:
        with hdf5.delay_interrupts():
            write_arrays(self._file, estimate, name)
            self._file.flush()
        self._check()

    def set(self, **costs: float | None) -> None:
        """Store costs and flags by their names in `Result`, but not None and False."""
        given = {name: one for name, one in costs.items() if one is not None and one is not False}
        with hdf5.delay_interrupts():
            self._file.attrs.update({name: +one for name, one in given.items()})


@contextlib.contextmanager
def result_writer(
    target: Path,
    dataset: Dataset,
    solver: str,
    task: TaskName,
    parameters: dict[str, Any],
    *,
    overwrite: bool = False,
) -> Iterator[ResultWriter]:
    """Open a writer of the result file `target`.

    The file appears when the block ends without an error; otherwise nothing is left of it.
    """
    with (
        complete_or_nothing(target, overwrite=overwrite) as path,
        hdf5.create_hdf5(path) as (file, check),
    ):
        with hdf5.delay_interrupts():
            file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
            file.attrs["dataset"], file.attrs["solver"] = dataset.content_hash, solver
            file.attrs["task"] = task
            file.attrs["parameters"] = json.dumps(parameters, sort_keys=True)
            if dataset.identity is not None:
                file.attrs["identity"] = dataset.identity
        yield ResultWriter(file, check)


def open_result(path: str | Path, dataset: Dataset) -> Result:
    """Open a result of this data set.

    Raises InputError for another kind of file, or one of another data set.
    """
    file_path = Path(path)
    with hdf5.open_hdf5(file_path) as file:
        head = _head(file)
    if not _names(head).fits(dataset):
        raise InputError(
            f"{path}: expected a result of the data set {dataset.content_hash[:12]} "
            f"({dataset.root}), got one of {str(head.get('dataset'))[:12]}"
        )
    costs: dict[str, Any] = {
        key: _cost(head.get(key), f"{path}: attribute {key}") for key in _COSTS
    }
    flags = {key: bool(head.get(key, 0) == 1) for key in _FLAGS}
    text = str(head.get("parameters", "{}"))
    where = f"{path}: attribute parameters: expected a JSON object"
    try:
        value = json.loads(text)
        json.dumps(value, allow_nan=False)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}, got {text[:80]!r}") from error
    if not isinstance(value, dict):
        raise InputError(f"{where}, got {text[:80]!r}")
    return Result(
        path=file_path,
        task=_task(head, path),
        solver=_solver(head),
        parameters=value,
        grid=dataset.setup.grid,
        **costs,
        **flags,
    )


@dataclass(frozen=True)
class DatasetNames:
    """Hashes of the data set that a result belongs to.

    `content_hash` names one copy of it, `identity` every copy; None in results of a private test
    set and of before it was introduced.
    """

    content_hash: str
    identity: str | None

    def fits(self, dataset: Dataset) -> bool:
        """Return whether this is a copy of the result's data set."""
        known = self.identity is not None and self.identity == dataset.identity
        return known or self.content_hash == dataset.content_hash


def read_result_cameras(path: Path) -> tuple[CameraModel, ...]:
    """Read the cameras that a solver of the task calibration has estimated.

    Raises InputError for another kind of file, or one without cameras.
    """
    with hdf5.open_hdf5(path) as file:
        task = _task(_head(file), path)
        if task != "calibration":
            raise InputError(
                f"{path}: expected a result of the task calibration, got one of {task}"
            )
        code = hdf5.read_array(file, f"{Calibration.GROUP}/cameras", (None,), "u")
    try:
        return decode_cameras(code.astype(np.uint8))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def read_dataset_names(path: Path) -> DatasetNames:
    """Read which data set a result belongs to; raises as `open_result`."""
    with hdf5.open_hdf5(path) as file:
        return _names(_head(file))


def read_solver(path: Path) -> str:
    """Read the name of the solver of a result; raises as `open_result`."""
    with hdf5.open_hdf5(path) as file:
        return _solver(_head(file))


def _solver(head: dict[str, Any]) -> str:
    return printable(str(head.get("solver", "unknown")))


def add_identity(path: Path, dataset: Dataset) -> None:
    """Add the data set's identity to a result that was made of its observation side."""
    if dataset.identity is not None:
        with hdf5.delay_interrupts(), h5py.File(path, "r+") as file:
            file.attrs["identity"] = dataset.identity


def _names(head: dict[str, Any]) -> DatasetNames:
    identity = head.get("identity")
    return DatasetNames(str(head.get("dataset")), None if identity is None else str(identity))


def _head(file: Any) -> dict[str, Any]:
    head = hdf5.read_attributes(file, _ATTRIBUTES)
    version = head.get("version")
    if head.get("format") != FORMAT or version != VERSION:
        got = f"{head.get('format')!r} version {version}"
        raise InputError(
            f"{file.filename}: expected format {FORMAT!r} version {VERSION}, got {got}"
        )
    return head


def _task(head: dict[str, Any], path: str | Path) -> Any:
    task, known = str(head.get("task", "reconstruction")), get_args(TaskName)
    if task not in known:
        raise InputError(
            f"{path}: attribute task: expected one of {', '.join(known)}, got {task!r}"
        )
    return task


def _cost(value: Any, where: str) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not 0.0 <= value < float("inf"):
        raise InputError(f"{where}: expected one number that is not negative, got {value!r}")
    return float(value)


_LEFT_OUT = "track"  # sabench numbers trajectories where a file does not


def estimate_hash(path: Path) -> str:
    """Hash the names, shapes and values of all arrays of a result that sabench wrote.

    The solver's name, its parameters and costs, estimates after iterations, the numbers of
    trajectories and the compression do not count.
    """
    found: dict[str, Any] = {}

    def collect(name: str, node: Any) -> None:
        counts = name.rpartition("/")[2] != _LEFT_OUT and not name.startswith(f"{ITERATIONS}/")
        if isinstance(node, h5py.Dataset) and counts:
            found[name] = node

    content = hashlib.sha256()
    with hdf5.open_hdf5(path) as file:
        file.visititems(collect)
        for name in sorted(found):
            node = found[name]
            content.update(f"{name}\0{node.shape}\0{node.dtype.str}\0".encode())
            content.update(node[...].tobytes())
    return content.hexdigest()
