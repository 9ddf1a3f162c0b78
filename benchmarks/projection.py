"""Speed and exactness of refractive projection.

`python benchmarks/projection.py [points]` prints JSON.

One run spreads its points over 20 random walls of 0 to 4 layers. Speed is also given against
numpy's square root on the same number of values, taken in the same run, so that figures of
different machines can be compared.
"""

import functools
import json
import sys
import timeit
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sabench.geometry import projection_kernels
from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall, solve_slope, trace_to_points
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64, Bool
from sabench.utils.progress import progress_bar

_WALLS = 20
_BEFORE_MM = 450.0  # from the pinhole to the outer face
_STEEP = np.deg2rad(80.0)


def random_wall(rng: np.random.Generator, layers: int) -> Wall:
    """Draw a tilted wall: indices from 1 to 2.4, 0.01 to 50 mm per layer."""
    normal = np.array([*rng.uniform(-0.5, 0.5, 2), 1.0])
    x, y, z = (float(v) for v in normal / np.linalg.norm(normal))
    indices = rng.uniform(1.0, 2.4, layers + 2).tolist()
    stack = tuple(
        Layer(f"layer {i}", index, float(10.0 ** rng.uniform(-2.0, np.log10(50.0))))
        for i, index in enumerate(indices[1:-1])
    )
    return Wall(
        (float(rng.uniform(-40, 40)), float(rng.uniform(-40, 40)), 0.0),
        (x, y, z),
        indices[0],
        stack,
        indices[-1],
    )


def facing(wall: Wall) -> Camera:
    """Make a camera that looks along the wall's normal."""
    x, y, z = (float(v) for v in np.asarray(wall.point_mm) - _BEFORE_MM * np.asarray(wall.normal))
    return Camera(
        name="camera_00",
        rows=1000,
        columns=1000,
        center_mm=(x, y, z),
        rotation=aimed_rotation(np.asarray(wall.normal)),
        principal_distance_mm=85.0,
        pixel_mm=0.01,
        principal_point_px=(499.5, 499.5),
        distortion=Distortion(),
        focal_length_mm=80.0,
        f_number=16.0,
        wall=wall,
    )


def random_points(rng: np.random.Generator, camera: Camera, wall: Wall, count: int) -> F64:
    """Draw points in the fluid, up to 60 degrees off the normal, 1 to 200 mm deep."""
    axes, depth = np.asarray(camera.rotation), wall.thickness_mm + rng.uniform(1.0, 200.0, count)
    radius = (_BEFORE_MM + depth) * np.tan(np.deg2rad(60.0)) * np.sqrt(rng.random(count))
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    across = radius[:, None] * (np.cos(angle)[:, None] * axes[0] + np.sin(angle)[:, None] * axes[1])
    return np.asarray(
        np.asarray(camera.center_mm) + across + (_BEFORE_MM + depth)[:, None] * axes[2]
    )


def worst_residual_mm(camera: Camera, wall: Wall, points: F64) -> float:
    """Compute errors of the paths' lateral distances, in extended precision."""
    normal, offset = np.asarray(wall.normal), points - np.asarray(camera.center_mm)
    radius = np.linalg.norm(offset - (offset @ normal)[:, None] * normal, axis=1)
    depths: list[F64 | float] = [
        _BEFORE_MM,
        *(layer.thickness_mm for layer in wall.layers),
        wall.depth_of(points) - wall.thickness_mm,
    ]
    slope = solve_slope(wall.indices, depths, radius)[0].astype(np.longdouble)
    invariant = np.longdouble(wall.indices.min()) * slope / np.sqrt(1 + slope**2)
    lateral = np.zeros_like(slope)
    for depth, index in zip(depths, wall.indices, strict=True):
        sine = invariant / np.longdouble(index)
        lateral += depth * (slope if index == wall.indices.min() else sine / np.sqrt(1 - sine**2))
    return float(np.abs(lateral - radius).max())


def round_trip(camera: Camera, wall: Wall, points: F64) -> tuple[F64, Bool, F64]:
    """Compute distances (n,) of points from the rays of their pixels, mm.

    Also returns which rays stay within `_STEEP` in all media, and what rounding allows.

    A direction that is off by one rounding misses its point by dR/d(angle) times that: near total
    reflection in a rare layer no double can do better.
    """
    pixels, valid = camera.project(points)
    rays = camera.back_project(pixels)
    if not (valid.all() and rays.valid.all()):
        raise SystemExit("expected every point to have a path")
    sine = wall.air_index * np.linalg.norm(
        np.cross(camera.directions(pixels)[0], wall.normal), axis=1
    )
    depths: list[F64 | float] = [
        _BEFORE_MM,
        *(layer.thickness_mm for layer in wall.layers),
        wall.depth_of(points) - wall.thickness_mm,
    ]
    slack = sum(
        depth * wall.air_index * n**2 / (n**2 - sine**2) ** 1.5
        for depth, n in zip(depths, wall.indices, strict=True)
    )
    miss = np.linalg.norm(np.cross(points - rays.origins_mm, rays.directions), axis=1)
    allowed = np.finfo(np.float64).eps * (
        slack + np.linalg.norm(points - np.asarray(camera.center_mm), axis=1)
    )
    return miss, np.asarray(sine < np.sin(_STEEP) * wall.indices.min()), np.asarray(allowed)


def fastest(work: Callable[[], object], repeats: int = 3) -> float:
    """Measure the seconds of the fastest of several runs."""
    return min(timeit.repeat(work, number=1, repeat=repeats))


def demo_points_per_s(count: int) -> float:
    """Measure the speed on the demo's corner camera, in its own volume."""
    scene = load_scene("demo")
    low, size = (
        np.asarray(scene.volume.center_mm) - np.asarray(scene.volume.size_mm) / 2.0,
        np.asarray(scene.volume.size_mm),
    )
    points = low + np.random.default_rng(1).random((count, 3)) * size
    camera = build_rig(scene).cameras[0]
    return count / fastest(lambda: camera.project(points))


def kernel_on_demo(count: int) -> dict[str, float]:
    """Measure the kernel alone on separate x, y, z, and the path by numpy.

    Both use one thread. The kernel's worst path is summed in extended precision.

    The demo's corner camera is taken as if it faced the wall, so that a pixel is a tangent without
    more rounding than the kernel's own.
    """
    scene = load_scene("demo")
    low, size = (
        np.asarray(scene.volume.center_mm) - np.asarray(scene.volume.size_mm) / 2.0,
        np.asarray(scene.volume.size_mm),
    )
    points = low + np.random.default_rng(2).random((count, 3)) * size
    camera = replace(build_rig(scene).cameras[0], principal_point_px=(0.0, 0.0))
    wall, center = camera.wall, np.asarray(camera.center_mm)
    assert isinstance(wall, Wall)
    x, y, z = np.ascontiguousarray(points.T)
    column, row = np.empty(count), np.empty(count)
    frame, lens = (
        (*np.eye(3).ravel().tolist(),),
        (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    )
    media = projection_kernels.media_of(wall, center)
    projection_kernels.project(x, y, z, camera.center_mm, frame, media, lens, column, row)
    seconds = fastest(
        lambda: projection_kernels.project(
            x, y, z, camera.center_mm, frame, media, lens, column, row
        ),
        9,
    )
    traced = fastest(lambda: trace_to_points(wall, center, points))
    tangent = np.hypot(column.astype(np.longdouble), row)
    sine = wall.air_index * tangent / np.sqrt(1 + tangent**2)
    depths = [
        -wall.depth_of(center),
        *(layer.thickness_mm for layer in wall.layers),
        wall.depth_of(points) - wall.thickness_mm,
    ]
    lateral = sum(
        depth * sine / np.sqrt(np.longdouble(index) ** 2 - sine**2)
        for depth, index in zip(depths, wall.indices, strict=True)
    )
    radius = np.hypot(points[:, 0].astype(np.longdouble) - center[0], points[:, 1] - center[1])
    return {
        "kernel_points_per_s": round(count / seconds),
        "traced_points_per_s": round(count / traced),
        "kernel_worst_residual_mm": float(np.abs(lateral - radius).max()),
    }


def main() -> None:
    """Print times and errors of projections."""
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    rng, count = np.random.default_rng(0), -(-total // _WALLS)
    rows = []
    for k in progress_bar(range(_WALLS), "walls"):
        wall = random_wall(rng, k % 5)
        camera = facing(wall)
        points = random_points(rng, camera, wall, count)
        miss, steady, allowed = round_trip(camera, wall, points)
        seconds = fastest(functools.partial(camera.project, points))
        plain = fastest(functools.partial(replace(camera, wall=None).project, points))
        rows.append(
            (
                seconds,
                plain,
                worst_residual_mm(camera, wall, points),
                miss[steady].max(),
                miss.max(),
                (miss / allowed).max(),
                steady.mean(),
            )
        )
    seconds, plain, residual, miss_steady, miss_all, roundings, share = np.array(rows).T
    values = rng.random(total)
    kernel, demo = fastest(lambda: np.sqrt(values), 9) / total, demo_points_per_s(total)
    report = {
        "points": count * _WALLS,
        "walls": _WALLS,
        "points_per_s": round(count * _WALLS / seconds.sum()),
        "points_per_s_slowest_wall": round(count / seconds.max()),
        "points_per_s_demo": round(demo),
        "points_per_s_plain_air": round(count * _WALLS / plain.sum()),
        **kernel_on_demo(total),
        "sqrt_per_s": round(1.0 / kernel),
        "square_roots_per_point": round(seconds.sum() / (count * _WALLS) / kernel, 1),
        "square_roots_per_point_demo": round(1.0 / demo / kernel, 1),
        "worst_residual_mm": residual.max(),
        "worst_round_trip_mm_within_80_deg": miss_steady.max(),
        "share_within_80_deg": round(share.mean(), 4),
        "worst_round_trip_mm": miss_all.max(),
        "worst_round_trip_in_roundings": round(roundings.max(), 2),
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
