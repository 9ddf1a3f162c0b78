"""Write a data set frame by frame into a temporary folder that becomes the data set when it is complete."""

from __future__ import annotations

import contextlib
import importlib.metadata
import platform
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench import __version__
from sabench.api import Velocity
from sabench.arrays import F32, F64, U16, Bool
from sabench.codes import has_code
from sabench.dataset import layout
from sabench.dataset.cost import check_affordable
from sabench.dataset.hdf import created, uninterrupted
from sabench.dataset.images import write_exr, write_tiff
from sabench.files import canonical_json, complete_or_nothing, sha256
from sabench.imaging.particle_images import ParticleImages
from sabench.imaging.sensor import white_level
from sabench.imaging.sightlines import Sight
from sabench.optics.camera import Camera
from sabench.rig import Rig
from sabench.scene import Scene
from sabench.targets import Placed, Prior
from sabench.world import Bubbles, Particles, Solid

_RECORDED = ("mitsuba", "drjit", "numpy", "scipy", "miepython", "h5py", "tifffile", "OpenEXR")


class DatasetWriter:
    """Takes the frames of one data set; made by `dataset_writer`."""

    def __init__(self, root: Path, truth: Any, check: Callable[[], None]) -> None:
        self.root, self._truth, self._check = root, truth, check

    def add_image(self, camera: Camera, frame: int, grey: U16, radiance: F32) -> None:
        """Store one camera's picture of a frame."""
        path = self.root / layout.image_name(camera.name, frame, "tif")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tiff(path, grey)
        write_exr(path.with_suffix(".exr"), radiance)

    def add_particles(self, frame: int, particles: Particles) -> None:
        """Store a frame's particles; `add_view` then stores what each camera receives of them."""
        values = {name: getattr(particles, name) for name in ("id", "position_mm", "diameter_mm", "velocity_mm_s")}
        self._store(layout.frame_group(frame), values)

    def add_flow(self, frame: int, field: Velocity, gradient: F64) -> None:
        """Store a frame's exact flow on a lattice."""
        values = {
            "velocity_mm_s": field.velocity_mm_s,
            "gradient_1_s": gradient,
            "low_mm": np.array(field.low_mm),
            "step_mm": np.array(field.step_mm),
        }
        self._store(f"{layout.frame_group(frame)}/flow", values)

    def add_view(self, frame: int, camera: Camera, images: ParticleImages) -> None:
        """Store where and how bright one camera receives a frame's particles."""
        small: dict[str, npt.NDArray[Any]] = {"sigma_px": images.sigma_px.astype(np.float32), "visible": images.visible.astype(np.uint8)}
        self._store(f"{layout.frame_group(frame)}/cameras/{camera.name}", {"pixel": images.pixel, "photons": images.photons, **small})

    def add_phases(self, frame: int, bubbles: Bubbles, solids: Sequence[Solid]) -> None:
        """Store a frame's bubbles and bodies."""
        values = {name: getattr(bubbles, name) for name in ("id", "center_mm", "semi_axes_mm", "turn", "velocity_mm_s")}
        self._store(f"{layout.frame_group(frame)}/bubbles", {**values, "index": np.array([bubbles.index])})
        for number, solid in enumerate(solids):
            self._store(f"{layout.frame_group(frame)}/bodies/{number}", {"vertices_mm": solid.vertices_mm, "faces": solid.faces})

    def add_sight(self, frame: int, camera: Camera, sight: Sight, error: float) -> None:
        """Store what one camera truly sees of a frame's bubbles and bodies, and the relative standard error of its picture."""
        group = f"{layout.frame_group(frame)}/sights/{camera.name}"
        self._store(group, {"number": sight.number, "depth_mm": sight.depth_mm, "path_mm": sight.path_mm}, packed=True)
        self._store(group, {"visible": sight.visible, "pixel": sight.pixel, "contour": sight.contour, "error": np.array([error])})

    def add_target(self, placed: Placed) -> None:
        """Store a calibration target and its true places."""
        head = {"format": layout.FORMAT, "version": layout.VERSION}
        (self.root / layout.TARGET).write_text(canonical_json({**head, "target": asdict(placed.target)}), encoding="utf-8")
        for frame, pose in enumerate(placed.poses):
            self._store(layout.frame_group(frame), {"turn": pose.turn, "place_mm": pose.place_mm})

    def add_sighting(self, camera: Camera, exact: F64, outliers: Bool) -> None:
        """Store where one camera truly sees the target's points (frame, point, 2), and which of those that it found are elsewhere (frame, point)."""
        self._store(f"cameras/{camera.name}", {"pixel": exact, "outlier": outliers.astype(np.uint8)})

    def add_points(self, pixels: F64, prior: Prior) -> None:
        """Store what solvers see of the target: pixels (camera, frame, point, 2), and what is known of its places."""
        values = {"pixels": pixels, "rough_mm": prior.rough_mm, "known_mm": prior.known_mm, "known_sigma_mm": prior.known_sigma_mm}
        with created(self.root / layout.POINTS) as (file, _), uninterrupted():
            file.attrs["format"], file.attrs["version"] = layout.FORMAT, layout.VERSION
            for name, value in values.items():
                file.create_dataset(name, data=value)

    def _store(self, group: str, values: dict[str, npt.NDArray[Any]], *, packed: bool = False) -> None:
        how = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if packed else {}
        with uninterrupted():
            for name, value in values.items():
                self._truth.create_dataset(f"{group}/{name}", data=value, **how)
            self._truth.flush()
        self._check()


@contextlib.contextmanager
def dataset_writer(
    target: Path, name: str, scene: Scene, rig: Rig, told: tuple[Camera, ...], seed: int, renderer: str, *, overwrite: bool = False
) -> Iterator[DatasetWriter]:
    """A writer whose frames become the data set at `target` when the block ends well, and vanish otherwise.

    Parameters
    ----------
    rig : the true optics.
    told : the cameras that solvers are told.
    """
    with complete_or_nothing(target, overwrite=overwrite) as root:
        check_affordable(name, scene, rig, root.parent)
        root.mkdir()
        (root / layout.SCENE).write_text(_with_copies(scene, root).to_toml(), encoding="utf-8")
        (root / layout.CAMERAS).write_text(canonical_json(_observation(scene, rig, told)), encoding="utf-8")
        if scene.calibration:
            (root / layout.TRUE_CAMERAS).write_text(canonical_json(_true_cameras(rig)), encoding="utf-8")
        with created(root / layout.TRUTH) as (truth, check):
            with uninterrupted():
                truth.attrs["format"], truth.attrs["version"] = layout.FORMAT, layout.VERSION
            yield DatasetWriter(root, truth, check)
        (root / layout.MANIFEST).write_text(_manifest(root, name, scene, seed, renderer), encoding="utf-8")


def _with_copies(scene: Scene, root: Path) -> Scene:
    """The scene with copies of its files in the data set."""
    places = {}
    for table, path in scene.files.items():
        places[table] = Path(layout.GIVEN) / f"{table}{path.suffix}"
        (root / layout.GIVEN).mkdir(exist_ok=True)
        shutil.copyfile(path, root / places[table])
    return scene.with_files(places)


def _observation(scene: Scene, rig: Rig, told: tuple[Camera, ...]) -> dict[str, Any]:
    sensor = {"black_dn": scene.sensor.black_level_dn, "white_dn": white_level(scene.sensor), "bit_depth": scene.sensor.bit_depth}
    head: dict[str, Any] = {"format": layout.FORMAT, "version": layout.VERSION, "frames": scene.frames, "interval_s": scene.interval_s}
    if scene.timing is not None:
        head |= {"times_s": [scene.time_s(frame) for frame in range(scene.frames)], "pulses": len(scene.timing.pulses_s)}
    if scene.preprocessing:
        head["preprocessing"] = [step.model_dump() for step in scene.preprocessing]
    if scene.bubbles is not None or scene.solids:
        head["shows"] = (["particles"] if scene.particles else []) + ["bubbles"] + (["code"] if has_code(scene) else [])
    wall = asdict(rig.wall) if rig.wall else None
    told_too = {"unknown": list(scene.unknown)} if scene.unknown else {}
    return {**head, "wall": wall, "cameras": layout.camera_records(told), "grid": asdict(rig.grid), "sensor": sensor, **told_too}


def _true_cameras(rig: Rig) -> dict[str, Any]:
    return {"format": layout.FORMAT, "version": layout.VERSION, "cameras": layout.camera_records(rig.cameras)}


def _manifest(root: Path, name: str, scene: Scene, seed: int, renderer: str) -> str:
    paths = sorted(path for path in root.rglob("*") if path.is_file())
    files = {path.relative_to(root).as_posix(): layout.FileEntry(bytes=path.stat().st_size, sha256=sha256(path)) for path in paths}
    versions = {"sabench": __version__, "python": platform.python_version()}
    versions |= {package: importlib.metadata.version(package) for package in _RECORDED}
    return layout.sealed({
        "format": layout.FORMAT, "version": layout.VERSION, "content_hash": layout.content_hash(files), "scene": name,
        "scene_hash": scene.hash, "seed": seed, "renderer": renderer, "versions": versions,
        "files": {key: entry.model_dump() for key, entry in files.items()},
    })  # fmt: skip
