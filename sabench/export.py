"""Volumes, particles and velocity fields in files that other programs open: VTKHDF, which ParaView and VTK read."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sabench.api import Velocity
from sabench.arrays import F64
from sabench.dataset.hdf import created, uninterrupted
from sabench.dataset.read import Dataset, open_dataset
from sabench.dataset.result import Result, open_result
from sabench.errors import InputError
from sabench.files import complete_or_nothing
from sabench.flows import divergence, vorticity
from sabench.metrics.velocity import gradient
from sabench.motion import lattice
from sabench.progress import track
from sabench.scoring import true_field
from sabench.tracks.velocimetry import true_velocity

Format = Literal["vtk"]
_NODES = 50  # of the exact field along the volume's longest edge, where the scene names no lattice
_VERSION = (2, 0)  # of VTKHDF: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
Data = dict[str, npt.NDArray[Any]]


def export(dataset: Dataset | str | Path, out: str | Path, result: str | Path | None = None, *, to: Format = "vtk", overwrite: bool = False) -> Path:
    """Write a data set's truth, or a result of it, into a folder; one file for each frame and kind.

    A data set gives `particles`, `volume` (the synthesised field) and, where there is a flow, `flow`. A result gives `volume` and, if it has some,
    `particles`, or else `velocity` with the exact field and the error of every vector. Lengths are mm, velocities mm/s.

    Raises
    ------
    InputError
        No data set or result, one of cameras, another format than vtk, or an existing folder.
    """
    if to != "vtk":
        raise InputError(f"to: expected vtk, got {to!r}")
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    if data.shows_target:
        raise InputError(f"{data.root}: expected a data set with particles, got one with a calibration target")
    found = open_result(result, data) if result is not None else None
    with complete_or_nothing(Path(out), overwrite=overwrite) as root:
        root.mkdir()
        if found is None:
            _export_truth(root, data)
        elif found.track == "velocimetry":
            _export_velocities(root, data, found)
        elif found.track == "reconstruction":
            _export_reconstructions(root, data, found)
        else:
            raise InputError(f"{found.path}: expected a result with volumes or velocities, got one of the track {found.track}")
    return Path(out)


def _export_truth(root: Path, data: Dataset) -> None:
    scene, grid = data.scene, data.rig.grid
    step = scene.flow_grid_mm or (max(scene.volume.size_mm) / _NODES,) * 3
    for frame in track(range(data.rig.frames), "export"):
        particles = data.particles(frame)
        about = {"id": particles.id, "diameter_mm": particles.diameter_mm, "velocity_mm_s": particles.velocity_mm_s}
        write_points(root / f"particles_{frame:04d}.vtkhdf", particles.position_mm, about)
        volume = true_field(grid, particles, data.views(frame))
        write_lattice(root / f"volume_{frame:04d}.vtkhdf", grid.low_mm, grid.voxel_mm, {"intensity": volume})
        if scene.flow:
            field, slopes = lattice(scene, frame, step)
            write_lattice(root / f"flow_{frame:04d}.vtkhdf", field.low_mm, field.step_mm, _field(field, slopes))


def _export_reconstructions(root: Path, data: Dataset, result: Result) -> None:
    grid = data.rig.grid
    for frame in track(range(data.rig.frames), "export"):
        found = result.reconstruction(frame)
        write_lattice(root / f"volume_{frame:04d}.vtkhdf", grid.low_mm, grid.voxel_mm, {"intensity": found.volume})
        if found.particles_mm is not None:
            write_points(root / f"particles_{frame:04d}.vtkhdf", found.particles_mm, {})


def _export_velocities(root: Path, data: Dataset, result: Result) -> None:
    for pair in track(data.rig.pairs(), "export"):
        field = result.velocity(pair[0])
        exact = true_velocity(data, pair, field.positions_mm.reshape(-1, 3)).reshape(field.velocity_mm_s.shape)
        values = _field(field, gradient(field.velocity_mm_s, field.step_mm)) | {
            "valid": field.valid.astype(np.uint8), "exact_mm_s": exact, "error_mm_s": field.velocity_mm_s - exact
        }  # fmt: skip
        write_lattice(root / f"velocity_{pair[0]:04d}.vtkhdf", field.low_mm, field.step_mm, values)


def _field(field: Velocity, slopes: F64) -> Data:
    """Velocities and what their gradients (z, y, x, 3, 3) say."""
    return {"velocity_mm_s": field.velocity_mm_s, "vorticity_1_s": vorticity(slopes), "divergence_1_s": divergence(slopes)}


def write_lattice(path: Path, low_mm: tuple[float, float, float], step_mm: tuple[float, float, float], data: Data) -> None:
    """Arrays (z, y, x) or (z, y, x, 3) on a lattice along the axes, as VTK's image data."""
    shape = next(iter(data.values())).shape[:3]
    ends = [index for count in shape[::-1] for index in (0, count - 1)]
    head = {"WholeExtent": np.array(ends), "Origin": np.array(low_mm), "Spacing": np.array(step_mm), "Direction": np.eye(3).ravel()}
    with created(path) as (file, check), uninterrupted():
        _begin(file, "ImageData", head)
        for name, values in data.items():
            chunk = (1, *values.shape[1:])
            file.create_dataset(f"VTKHDF/PointData/{name}", data=values, chunks=chunk, compression="gzip", compression_opts=1)
        check()


def write_points(path: Path, points_mm: F64, data: Data) -> None:
    """Points (n, 3) with values of each, as VTK's poly data."""
    count = len(points_mm)
    with created(path) as (file, check), uninterrupted():
        root = _begin(file, "PolyData", {})
        root["NumberOfPoints"], root["Points"] = np.array([count]), points_mm
        for name in ("Vertices", "Lines", "Polygons", "Strips"):
            cells = count if name == "Vertices" else 0
            group = root.create_group(name)
            group["NumberOfConnectivityIds"], group["NumberOfCells"] = np.array([cells]), np.array([cells])
            group["Connectivity"], group["Offsets"] = np.arange(cells), np.arange(cells + 1)
        for name, values in data.items():
            root[f"PointData/{name}"] = values
        check()


def _begin(file: Any, kind: str, head: Data) -> Any:
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = np.array(_VERSION)
    root.attrs["Type"] = np.bytes_(kind)  # VTK wants a string of fixed length
    for name, values in head.items():
        root.attrs[name] = values
    root.create_group("PointData")
    return root
