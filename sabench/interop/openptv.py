"""OpenPTV (http://www.openptv.net), the package optv: files in and out.

Written are orientation files, images and settings; read are particles and links.

Its world has Y up and Z towards the cameras, and its origin must lie in the fluid: the grid's
centre. A wall is one plane-parallel layer ("glass"), given by the vector from the origin to its
inner face. The centre of the first pixel is (0.5, 0.5), and distortion is a polynomial of mm about
the image's centre.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tifffile

from sabench.api import FoundParticles
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.refraction import Wall
from sabench.interop.foreign import BRIGHT, ForeignWorld, to_8_bits
from sabench.utils.arrays import F32, F64, I64, triple
from sabench.utils.files import read_json
from sabench.utils.processes import python

if TYPE_CHECKING:  # it loads numba, which scores do without
    from sabench.interop.image_statistics import FrameStatistics

MOST_CAMERAS = 4
_AXES = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))  # axes of OpenPTV's world in ours
_BETWEEN = 0.5  # position of a thin wall, as a fraction of the distance to a camera without one


@dataclass(frozen=True)
class Settings:
    """Parameters of OpenPTV; lengths in mm, on the sensor in px.

    Attributes
    ----------
    threshold : grey value of 255 that belongs to a particle image.
    discontinuity : rise of grey values, away from a peak, that begins another particle image.
    tolerance_px : half the width of the band about an epipolar line.
    move_mm : largest displacement from frame to frame, along every axis.
    change_mm : largest change of it.
    angle_gon : largest change of its direction.
    """

    threshold: int
    discontinuity: int
    tolerance_px: float
    move_mm: float
    change_mm: float
    angle_gon: float


def derive_settings(
    seen: FrameStatistics,
    displacement_px: float = 10.0,
    tolerance_px: float = 1.0,
    discontinuity: int = 5,
    change: float = 0.5,
    angle_gon: float = 100.0,
) -> Settings:
    """Derive settings from the statistics of the first frame.

    Parameters
    ----------
    displacement_px : largest displacement from frame to frame.
    tolerance_px, discontinuity, angle_gon : as in `Settings`.
    change : largest change of a displacement, over the largest displacement.
    """
    move = displacement_px * seen.mm_per_px
    threshold = max(2, round(BRIGHT * seen.floor))
    return Settings(threshold, discontinuity, tolerance_px, move, change * move, angle_gon)


def missing() -> str | None:
    """Return how to install the program; None if it is installed."""
    return python.missing_package("optv", "optv")


def unfit(camera: Camera) -> str | None:
    """Return why OpenPTV cannot describe a camera; None if it can."""
    if camera.wall and not isinstance(camera.wall, Wall):
        return "OpenPTV supports plane walls, and this wall is a cylinder"
    if camera.wall and len(camera.wall.layers) > 1:
        return f"OpenPTV supports one layer of glass, and this wall has {len(camera.wall.layers)}"
    lens = camera.distortion
    if lens == Distortion():
        return None
    if camera.tilt_deg != UPRIGHT:
        return "OpenPTV has no tilted sensor behind a lens with distortion"
    middle = ((camera.columns - 1) / 2.0, (camera.rows - 1) / 2.0)
    if not np.allclose(camera.principal_point_px, middle, atol=1e-3):
        return (
            "OpenPTV has distortion about the centre of the image, and this camera has it elsewhere"
        )
    return None


def unlike(cameras: Sequence[Camera]) -> str | None:
    """Return why OpenPTV cannot describe cameras together; None if it can."""
    first = cameras[0]
    for camera in cameras:
        if list_media(camera) != list_media(first):
            got = f"{camera.name} has another than {first.name}"
            return f"OpenPTV supports one kind of wall, and {got}"
        if camera.pixel_mm != first.pixel_mm:
            return (
                f"OpenPTV supports one pixel pitch, and {camera.name} has {camera.pixel_mm:g} mm "
                f"where {first.name} has {first.pixel_mm:g} mm"
            )
    return None


def world_of(grid: Grid) -> ForeignWorld:
    """Make OpenPTV's world for a volume: its origin is the centre of the grid."""
    return ForeignWorld(triple(np.mean(grid.centers_mm(), axis=0)), _AXES)


def orientation_text(camera: Camera, world: ForeignWorld) -> str:
    """Format a camera's .ori file; raises ValueError for a camera that is `unfit`."""
    if reason := unfit(camera):
        raise ValueError(f"{camera.name}: {reason}")
    camera = camera.upright()
    axes = np.asarray(world.axes)
    right, down, forward = (axes @ row for row in np.asarray(camera.rotation))
    rotation = np.column_stack([right, -down, -forward])
    angles = [
        np.arctan2(-rotation[1, 2], rotation[2, 2]),
        np.arcsin(rotation[0, 2]),
        np.arctan2(-rotation[0, 1], rotation[0, 0]),
    ]
    position = world.into(np.asarray([camera.center_mm]))[0]
    across, above = (np.asarray(camera.principal_point_px) + 0.5) * camera.pixel_mm - np.array(
        [camera.columns, camera.rows]
    ) * camera.pixel_mm / 2.0
    rows = [position, angles, [], *rotation, [], [across, -above]]
    rows += [[camera.principal_distance_mm], [], _glass(camera, world, position)]
    return "\n".join(" ".join(repr(float(value)) for value in row) for row in rows) + "\n"


def _glass(camera: Camera, world: ForeignWorld, position: F64) -> F64:
    """Compute the vector from the origin to the glass's inner face, along its normal.

    Raises ValueError if the origin does not lie in the fluid.
    """
    if not isinstance(camera.wall, Wall):
        axis = int(np.abs(position).argmax())
        return np.asarray(_BETWEEN * np.eye(3)[axis] * position)
    wall = camera.wall
    depth = float(wall.depth_of(np.asarray(world.origin_mm))) - wall.thickness_mm
    if depth <= 0.0:
        raise ValueError(
            f"{camera.name}: OpenPTV needs the origin of the world in the fluid, and it lies "
            f"{-depth:.3g} mm before it"
        )
    return np.asarray(-depth * (np.asarray(world.axes) @ np.asarray(wall.normal)))


def distortion_text(camera: Camera) -> str:
    """Format a camera's .addpar file: k1 k2 k3 p1 p2, scale and shear."""
    lens, b = camera.distortion, camera.principal_distance_mm
    values = [lens.k1 / b**2, lens.k2 / b**4, lens.k3 / b**6, lens.p2 / b, -lens.p1 / b, 1.0, 0.0]
    return " ".join(repr(value) for value in values) + "\n"


def list_media(camera: Camera) -> dict[str, Any]:
    """List refractive indices and thicknesses of the media."""
    wall = camera.wall
    if wall is None:
        return {"n1": 1.0, "n2": [1.0], "n3": 1.0, "d": [0.0]}
    layer = wall.layers[0] if wall.layers else None
    index, thick = (layer.index, layer.thickness_mm) if layer else (wall.fluid_index, 0.0)
    return {"n1": wall.air_index, "n2": [index], "n3": wall.fluid_index, "d": [thick]}


def write_frame(folder: Path, frame: int, images: F32) -> None:
    """Write images (camera, row, column), bright peaks 1, as an 8-bit TIFF stack."""
    path = folder / f"frame_{frame:05d}.tif"
    tifffile.imwrite(path, to_8_bits(images), photometric="minisblack")


def ends_mm(grid: Grid, world: ForeignWorld) -> F64:
    """Compute opposite corners (2, 3) of a volume in OpenPTV's world."""
    return np.sort(world.into(np.stack(grid.centers_mm(1.0))), axis=0)


def write_project(
    folder: Path, cameras: tuple[Camera, ...], grid: Grid, frames: int, settings: Settings
) -> None:
    """Write orientations, distortions and settings into the folder of the images."""
    world = world_of(grid)
    for number, camera in enumerate(cameras):
        (folder / f"cam{number}.ori").write_text(orientation_text(camera, world), encoding="utf-8")
        (folder / f"cam{number}.addpar").write_text(distortion_text(camera), encoding="utf-8")
    first = cameras[0]
    ends = ends_mm(grid, world)
    project = asdict(settings) | {
        "cameras": len(cameras),
        "frames": frames,
        "image_size": [first.columns, first.rows],
        "pixel_mm": first.pixel_mm,
        "media": list_media(first),
        "x_mm": ends[:, 0].tolist(),
        "z_mm": ends[:, 2].tolist(),
    }
    (folder / "project.json").write_text(json.dumps(project), encoding="utf-8")


def solve(folder: Path, grid: Grid, frames: int) -> list[FoundParticles]:
    """Run OpenPTV on a project folder; read particles and their trajectories."""
    python.run_module("sabench.interop.openptv_process", folder, "OpenPTV", "sabench frame", frames)
    positions = [
        np.array(read_json(folder / f"found_{frame:05d}.json"), dtype=np.float64).reshape(-1, 3)
        for frame in range(frames)
    ]
    world = world_of(grid)
    tracks = join_links([len(points) for points in positions], read_json(folder / "links.json"))
    return [
        FoundParticles(world.back(points), None, number)
        for points, number in zip(positions, tracks, strict=True)
    ]


def join_links(counts: list[int], links: list[list[int]]) -> list[I64]:
    """Assign trajectory numbers (n,) of each frame from links to the frame before.

    A link is the row of the same particle in the frame before, below zero for none.
    """
    out: list[I64] = []
    born = 0
    for frame, count in enumerate(counts):
        complete = frame < len(links) and len(links[frame]) == count
        before = np.array(links[frame] if complete else [-1] * count, dtype=np.int64)
        number = np.full(count, -1, dtype=np.int64)
        if frame:
            linked = (before >= 0) & (before < counts[frame - 1])
            number[linked] = out[-1][before[linked]]
            _, first = np.unique(number, return_index=True)
            twice = np.setdiff1d(np.arange(count), first)
            number[twice] = -1
        new = np.flatnonzero(number < 0)
        number[new] = born + np.arange(len(new))
        born += len(new)
        out.append(number)
    return out
