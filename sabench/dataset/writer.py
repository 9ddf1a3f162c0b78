"""Writer of data sets: a temporary folder that becomes the data set."""

import contextlib
import importlib.metadata
import platform
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sabench.api import Shown
from sabench.api.truth import Sight, Sighting, Target, TargetPoints
from sabench.dataset import schema
from sabench.dataset.arrays import Named, group_of, named_arrays, write_arrays
from sabench.dataset.cameras import list_cameras, wall_entry
from sabench.dataset.hdf5 import create_hdf5, delay_interrupts
from sabench.geometry.camera import Camera
from sabench.scenes import Rig, Scene
from sabench.utils.files import canonical_json, complete_or_nothing, file_series
from sabench.utils.version import SIMULATION, __version__

_RECORDED = ("mitsuba", "drjit", "numpy", "scipy", "h5py", "tifffile", "OpenEXR")
_PACKED = tuple(one.label for one in Sight.ARRAYS if one.packed)


class DatasetWriter:
    """Writer of the parts of one data set, made by `dataset_writer`."""

    def __init__(self, root: Path, truth: Any, check: Callable[[], None]) -> None:
        self.root, self._truth, self._check = root, truth, check
        self.files: dict[str, schema.FileEntry] = {}

    def store(self, arrays: Named) -> None:
        """Store arrays of parts by their names in the file of truth."""
        with delay_interrupts():
            for name, value in arrays.items():
                packed = name.rpartition("/")[2] in _PACKED
                self._truth.create_dataset(name, data=value, **(schema.PACK if packed else {}))
            self._truth.flush()
        self._check()

    def take(self, file: Path, name: str, entry: schema.FileEntry) -> None:
        """Link a file of known size and checksum; the original also remains."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.hardlink_to(file)
        except OSError:  # a file system without hard links
            shutil.copyfile(file, path)
        self.files[name] = entry

    def add_target(self, target: Target) -> None:
        """Store a calibration target."""
        head = {"format": schema.FORMAT, "version": schema.VERSION}
        (self.root / schema.TARGET).write_text(
            canonical_json({**head, "target": asdict(target)}), encoding="utf-8"
        )

    def add_sighting(self, camera: str, sighting: Sighting) -> None:
        """Store the true images of a target's points in one camera."""
        self.store(named_arrays(sighting, group_of(Sighting, which=camera)))

    def add_points(self, points: TargetPoints) -> None:
        """Store a target's observed pixels and the positions known beforehand."""
        with create_hdf5(self.root / schema.POINTS) as (file, _), delay_interrupts():
            file.attrs["format"], file.attrs["version"] = schema.FORMAT, schema.VERSION
            write_arrays(file, points, "")


@contextlib.contextmanager
def dataset_writer(
    target: Path,
    name: str,
    scene: Scene,
    rig: Rig,
    nominal: tuple[Camera, ...],
    seed: int,
    renderer: str,
    *,
    shows: tuple[Shown, ...] = (),
    overwrite: bool = False,
) -> Iterator[DatasetWriter]:
    """Open a writer of the data set at `target`.

    The data set appears when the block ends without an error; otherwise nothing is left of it.

    Parameters
    ----------
    rig : the true optics.
    nominal : the cameras handed to solvers.
    shows : kinds of objects in the frames, where that is more than particles or a target.
    """
    with complete_or_nothing(target, overwrite=overwrite) as root:
        root.mkdir()
        (root / schema.SCENE).write_text(with_copies(scene, root).to_toml(), encoding="utf-8")
        setup, true = list_setups(scene, rig, nominal, shows)
        (root / schema.CAMERAS).write_text(canonical_json(setup), encoding="utf-8")
        if true is not None:
            (root / schema.TRUE_CAMERAS).write_text(canonical_json(true), encoding="utf-8")
        with create_hdf5(root / schema.TRUTH) as (truth, check):
            with delay_interrupts():
                truth.attrs["format"], truth.attrs["version"] = schema.FORMAT, schema.VERSION
            writer = DatasetWriter(root, truth, check)
            yield writer
        schema.write_manifest(
            root,
            schema.list_files(root, writer.files),
            identity=schema.identity_of(scene.hash, seed, renderer, SIMULATION),
            scene=name,
            scene_hash=scene.hash,
            seed=seed,
            renderer=renderer,
            versions=list_versions(),
        )


def list_setups(
    scene: Scene, rig: Rig, nominal: tuple[Camera, ...], shows: tuple[Shown, ...] = ()
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Make the contents of cameras.json and true_cameras.json.

    The second is None where the true cameras are the nominal ones.
    """
    keys: dict[str, Any] = {
        "frames": scene.frames,
        "interval_s": scene.interval_s,
        "sensor": {
            "black_dn": scene.sensor.black_level_dn,
            "white_dn": scene.sensor.white_dn,
            "bit_depth": scene.sensor.bit_depth,
        },
    }
    if by_camera := scene.sensor.levels_by_camera(len(nominal)):
        keys["sensor"]["by_camera"] = by_camera
    if scene.timing is not None:
        keys["times_s"] = [scene.time_s(frame) for frame in range(scene.frames)]
        keys["pulses"] = len(scene.timing.pulses_s)
    if scene.preprocessing:
        keys["preprocessing"] = [step.model_dump() for step in scene.preprocessing]
    if scene.unknown:
        keys["unknown"] = scene.unknown
    if scene.calibration and scene.calibration.known_cameras:
        keys["known_cameras"] = True
    keys = keys | ({"shows": shows} if shows else {})
    keys |= {"wall": wall_entry(nominal), "grid": rig.grid}
    setup = list_cameras(nominal, **keys)
    if not scene.calibration:
        return setup, None
    true = wall_entry(rig.cameras)
    walls = {"wall": true} if true != wall_entry(nominal) else {}
    return setup, list_cameras(rig.cameras, **walls)


def with_copies(scene: Scene, root: Path) -> Scene:
    """Copy the scene's files into the data set; the scene then names the copies."""
    return scene.with_files(
        {table: _copy_given(root, table, path) for table, path in scene.files.items()}
    )


def _copy_given(root: Path, table: str, path: Path) -> Path:
    """Copy a file, or a series into a folder of its own; return the new path."""
    files = file_series(path)
    if files == [path]:
        copy = Path(schema.GIVEN) / f"{table}{path.suffix}"
        (root / schema.GIVEN).mkdir(exist_ok=True)
        shutil.copyfile(path, root / copy)
        return copy
    folder = Path(schema.GIVEN) / table
    (root / folder).mkdir(parents=True)
    for one in files:
        shutil.copyfile(one, root / folder / one.name)
    return folder / path.name


def list_versions() -> dict[str, str]:
    """List the versions of all that the bytes of a data set depend on."""
    programs = {"sabench": __version__, "simulation": SIMULATION}
    programs |= {"python": platform.python_version()}
    return programs | {package: importlib.metadata.version(package) for package in _RECORDED}
