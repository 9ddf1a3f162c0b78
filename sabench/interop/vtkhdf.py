"""Export of data sets and results to VTKHDF, which ParaView and VTK read."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench import tasks
from sabench.api import Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.estimates import Estimate
from sabench.api.truth import Solid
from sabench.dataset.hdf5 import create_hdf5, delay_interrupts
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import border_pixels, light_paths
from sabench.geometry.grid import Grid, divergence, gradient, vorticity
from sabench.metrics.bubble_detection import AnyBubbles, match_bubbles
from sabench.metrics.particle_detection import classify
from sabench.metrics.reconstruction_error import true_field
from sabench.plotting.kinds import FOUND, GHOST
from sabench.scenes import BubbleWorld
from sabench.tasks.velocimetry import truth_at
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar
from sabench.worlds.library.overlaps import shapes_of
from sabench.worlds.tracers import sample_lattice

_NODES = 50  # nodes of the exact field along the volume's longest edge, by default
# version of VTKHDF: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
_VERSION = 2, 0
Data = dict[str, npt.NDArray[Any]]


def write(root: Path, data: Dataset, found: Result | None) -> None:
    """Write a data set's truth, or a result of it, into a folder that is there.

    There is one file for each frame and kind, and one of the rig.

    A data set gives what it shows: `particles` with `volume` (the synthesised field) and, where
    there is a flow, `flow`; `bubbles`; `bodies`. A result gives `volume` and, if it has some,
    `particles`, or `particles` alone with the ids of the true ones that they are, and `missed`
    (true ones of the scored box that were not found), or `velocity`
    with the exact field and the error of every vector, or `bubbles` with the errors of those that
    are matched to true ones. Without the truth a result gives its own arrays alone. Lengths are mm,
    velocities mm/s.

    Raises InputError for a result of another kind.
    """
    write_rig(root / "rig.vtkhdf", data.setup.cameras, data.setup.grid)
    if found is None:
        _export_truth(root, data)
    else:
        task = tasks.of(found.task)
        if task.estimate not in _WRITERS:
            names = " or ".join(kind.__name__ for kind in _WRITERS)
            raise InputError(
                f"{found.path}: expected a result of {names}, got one of {task.estimate.__name__}"
            )
        for frame in progress_bar(task.frames(data), "export"):
            _WRITERS[task.estimate](root, data, frame, task.read(data, found, frame))


def _export_truth(root: Path, data: Dataset) -> None:
    scene, world = data.scene, data.scene.world
    step = scene.flow_grid_mm or (max(scene.volume.size_mm) / _NODES,) * 3
    for frame in progress_bar(range(data.setup.frames), "export"):
        if "particles" in data.shows:
            particles, grid = data.particles(frame), data.setup.grid
            names = ("id", "diameter_mm", "velocity_mm_s")
            values = {name: getattr(particles, name) for name in names}
            write_points(root / f"particles_{frame:04d}.vtkhdf", particles.position_mm, values)
            volume = {"intensity": true_field(grid, particles, data.views(frame))}
            path = root / f"volume_{frame:04d}.vtkhdf"
            write_lattice(path, grid.low_mm, grid.voxel_mm, volume)
        if world.tracers is not None and world.tracers.flow is not None:
            field, slopes = sample_lattice(scene, frame, step, data.manifest.seed)
            path = root / f"flow_{frame:04d}.vtkhdf"
            write_lattice(path, field.low_mm, field.step_mm, _field(field, slopes))
        if isinstance(world, BubbleWorld) and world.bubbles is not None:
            bubbles = data.bubbles(frame)
            about = _shapes(bubbles) | {"id": bubbles.id, "velocity_mm_s": bubbles.velocity_mm_s}
            write_points(root / f"bubbles_{frame:04d}.vtkhdf", bubbles.center_mm, about)
        if isinstance(world, BubbleWorld) and world.solids:
            write_surfaces(root / f"bodies_{frame:04d}.vtkhdf", data.solids(frame))


def _write_reconstruction(root: Path, data: Dataset, frame: int, estimate: Reconstruction) -> None:
    grid, values = data.setup.grid, {"intensity": estimate.volume}
    write_lattice(root / f"volume_{frame:04d}.vtkhdf", grid.low_mm, grid.voxel_mm, values)
    if estimate.particles_mm is not None:
        write_points(root / f"particles_{frame:04d}.vtkhdf", estimate.particles_mm, {})


def _write_velocity(root: Path, data: Dataset, frame: int, field: Velocity) -> None:
    local = field.in_own_axes()
    slopes = gradient(local.velocity_mm_s, local.step_mm)
    values = _field(field, slopes) | {"valid": field.valid.astype(np.uint8)}
    if field.plane_axes is not None:
        values["vorticity_1_s"] = vorticity(slopes)[..., 2:] * field.axes[2]
    if data.has_truth:
        pair = next(pair for pair in data.setup.pairs() if pair[0] == frame)
        exact = truth_at(data, pair, field)
        values |= {"exact_mm_s": exact, "error_mm_s": field.velocity_mm_s - exact}
    path = root / f"velocity_{frame:04d}.vtkhdf"
    write_lattice(path, field.low_mm, field.step_mm, values, field.axes)


def _write_detections(root: Path, data: Dataset, frame: int, estimate: Detections) -> None:
    values = _shapes(estimate)
    if data.has_truth:
        true = data.bubbles(frame)
        i, j = match_bubbles(estimate.center_mm, true.center_mm, true.radius_mm)
        hit = np.zeros(len(estimate.center_mm), dtype=np.uint8)
        identity, error_mm = np.full(len(hit), -1), np.full((len(hit), 3), np.nan)
        radius_mm = error_mm[:, 0].copy()
        hit[i], identity[i] = 1, true.id[j]
        error_mm[i] = estimate.center_mm[i] - true.center_mm[j]
        radius_mm[i] = estimate.radius_mm[i] - true.radius_mm[j]
        values |= {"matched": hit, "true_id": identity, "kind": np.where(hit, FOUND, GHOST)}
        values |= {"error_mm": error_mm, "radius_error_mm": radius_mm}
    write_points(root / f"bubbles_{frame:04d}.vtkhdf", estimate.center_mm, values)


def _write_particles(root: Path, data: Dataset, frame: int, cloud: FoundParticles) -> None:
    given = {"intensity": cloud.intensity, "track": cloud.trajectory}
    about: Data = {name: array for name, array in given.items() if array is not None}
    if data.has_truth:
        true, grid = data.particles(frame), data.setup.grid
        kind, i, j = classify(grid.to_voxels(cloud.position_mm), grid.to_voxels(true.position_mm))
        identity = np.full(len(kind), -1)
        identity[i] = true.id[j]
        about |= {"matched": (kind == FOUND).astype(np.uint8), "true_id": identity, "kind": kind}
        missed = ~np.isin(true.id, identity) & grid.in_scored(grid.to_voxels(true.position_mm))
        path = root / f"missed_{frame:04d}.vtkhdf"
        write_points(path, true.position_mm[missed], {"id": true.id[missed]})
    write_points(root / f"particles_{frame:04d}.vtkhdf", cloud.position_mm, about)


_WRITERS: dict[type[Estimate], Callable[[Path, Dataset, int, Any], None]] = {
    Reconstruction: _write_reconstruction,
    Velocity: _write_velocity,
    Detections: _write_detections,
    FoundParticles: _write_particles,
}


def _shapes(bubbles: AnyBubbles) -> Data:
    """Collect sizes and rotations of bubbles.

    `shape_mm` is the matrix (9 numbers) that transforms a ball of radius 1 into the bubble, for
    ParaView's tensor glyphs.
    """
    shape = shapes_of(np.sqrt(bubbles.semi_axes_mm), bubbles.turn)
    return {
        "radius_mm": bubbles.radius_mm,
        "semi_axes_mm": bubbles.semi_axes_mm,
        "turn": bubbles.turn.reshape(-1, 9),
        "shape_mm": shape.reshape(-1, 9),
    }


def _field(field: Velocity, slopes: F64) -> Data:
    return {
        "velocity_mm_s": field.velocity_mm_s,
        "vorticity_1_s": vorticity(slopes),
        "divergence_1_s": divergence(slopes),
    }


def write_lattice(
    path: Path,
    low_mm: tuple[float, float, float],
    step_mm: tuple[float, float, float],
    data: Data,
    axes: F64 | None = None,
) -> None:
    """Write arrays (z, y, x) or (z, y, x, 3) on a lattice as VTK's image data.

    Its axes are the rows of a matrix (3, 3), by default the world's; VTK has them as columns.
    """
    shape = next(iter(data.values())).shape[:3]
    ends = [index for count in shape[::-1] for index in (0, count - 1)]
    head = {
        "WholeExtent": np.array(ends),
        "Origin": np.array(low_mm),
        "Spacing": np.array(step_mm),
        "Direction": (np.eye(3) if axes is None else axes.T).ravel(),
    }
    with create_hdf5(path) as (file, check), delay_interrupts():
        _begin(file, "ImageData", head)
        for name, values in data.items():
            if shape[0] == 1:  # VTK reads a plane as an array without this axis
                values = values[0]
            packing = {"chunks": (1, *values.shape[1:]), "compression": "gzip"}
            name = f"VTKHDF/PointData/{name}"
            file.create_dataset(name, data=values, compression_opts=1, **packing)
        check()


def write_points(path: Path, points_mm: F64, data: Data) -> None:
    """Write points (n, 3) with values as VTK's poly data."""
    values = {f"PointData/{name}": array for name, array in data.items()}
    _write_cells(path, points_mm, "Vertices", np.arange(len(points_mm))[:, None], values)


def write_surfaces(path: Path, solids: Sequence[Solid]) -> None:
    """Write the triangles of bodies as VTK's poly data.

    `body` is the number of each triangle's body, in the order of a scene's `solids`.
    """
    before = np.cumsum([0, *(len(solid.vertices_mm) for solid in solids[:-1])])
    pairs = zip(solids, before, strict=True)
    faces = np.concatenate([solid.faces + first for solid, first in pairs])
    body = np.repeat(np.arange(len(solids)), [len(solid.faces) for solid in solids])
    vertices_mm = np.concatenate([solid.vertices_mm for solid in solids])
    _write_cells(path, vertices_mm, "Polygons", faces, {"CellData/body": body})


def write_rig(path: Path, cameras: Sequence[CameraModel], grid: Grid) -> None:
    """Write light paths around each camera's view, and the volume's edges, as lines.

    `camera` is the number of each line's camera, -1 for the volume.
    """
    low, high = grid.box_mm
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1)
    corners = corners.reshape(-1, 3)
    lines = [corners[[a, b]] for a in range(8) for b in range(a) if (a ^ b) in (1, 2, 4)]
    owner = [-1] * len(lines)
    for number, camera in enumerate(cameras):
        paths = light_paths(camera, border_pixels(camera), low, high)
        along = np.stack([paths[:, :-1], paths[:, 1:]], axis=2).reshape(-1, 2, 3)
        around = np.stack([paths, np.roll(paths, -1, axis=0)], axis=2)[:, 1:].reshape(-1, 2, 3)
        segments = [segment for segment in (*along, *around) if np.isfinite(segment).all()]
        lines += segments
        owner += [number] * len(segments)
    ends = np.arange(2 * len(lines)).reshape(-1, 2)
    points = np.concatenate(lines)
    _write_cells(path, points, "Lines", ends, {"CellData/camera": np.array(owner)})


def _write_cells(path: Path, points_mm: F64, kind: str, cells: I64, data: Data) -> None:
    """Write cells (n, corners) of one kind as VTK's poly data.

    Values are those of points or of cells.
    """
    with create_hdf5(path) as (file, check), delay_interrupts():
        root = _begin(file, "PolyData", {})
        root["NumberOfPoints"], root["Points"] = np.array([len(points_mm)]), points_mm
        for name in ("Vertices", "Lines", "Polygons", "Strips"):
            part = cells if name == kind else cells[:0]
            group = root.create_group(name)
            group["NumberOfConnectivityIds"] = np.array([part.size])
            group["NumberOfCells"], group["Connectivity"] = np.array([len(part)]), part.ravel()
            group["Offsets"] = part.shape[1] * np.arange(len(part) + 1)
        for name, values in data.items():
            root[name] = values
        check()


def _begin(file: Any, kind: str, head: Data) -> Any:
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = np.array(_VERSION)
    root.attrs["Type"] = np.bytes_(kind)  # VTK requires a string of fixed length
    for name, values in head.items():
        root.attrs[name] = values
    root.create_group("PointData")
    return root
