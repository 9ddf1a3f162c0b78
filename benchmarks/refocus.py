"""Speed of synthetic aperture refocusing.

`python benchmarks/refocus.py [planes]` prints JSON.

Nine cameras behind glass (demo), the thesis's 25 in air, and nine cameras anywhere behind a leaning
wall; 1000 x 1000 voxels, random images. A sample is one camera at one voxel. The time holds all
that a frame costs: the spline's coefficients, rectifying, adding or multiplying. What depends on
the cameras alone is computed once before. Shares are of limits measured in the same run: four loads
from the first cache for each bilinear sample, and OpenCV's bilinear remap.
"""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.rooflines import cached_gigaloads_s, fastest_s, gathered_gigaloads_s, triad_gb_s
from sabench.algorithms.refocus import refocus_by_shifts, refocus_log2, refocus_sum
from sabench.algorithms.refocus.slabs import deviation_px, slabs
from sabench.geometry.grid import Grid
from sabench.scenes import Rig, build_rig, load_scene, parse_scene
from sabench.utils import backend
from sabench.utils.arrays import F32
from sabench.utils.progress import progress_bar


def scattered_rig() -> Rig:
    """Make nine cameras at different distances, behind a wall tilted by ten degrees."""
    values = load_scene("demo").to_dict()
    values["wall"]["normal"] = [
        float(np.sin(np.radians(10.0))),
        0.0,
        float(np.cos(np.radians(10.0))),
    ]
    values["wall"]["point_mm"] = [0.0, 0.0, -10.0]
    positions = [
        {"center_mm": [x, y, -485.0 - 12.0 * k]}
        for k, (x, y) in enumerate(
            (x, y) for y in (-204.0, 0.0, 204.0) for x in (-204.0, 0.0, 204.0)
        )
    ]
    values["cameras"]["layout"] = {"kind": "list", "places": positions}
    return build_rig(parse_scene(values, "scattered"))


def remap_gigasamples_s(images: F32, rig: Rig) -> float:
    """Measure OpenCV's bilinear remap to the middle plane, 1e9 samples/s."""
    x, y, z = rig.grid.axes_mm
    across, down = np.meshgrid(x, y)
    points = np.column_stack([across.ravel(), down.ravel(), np.full(across.size, z[len(z) // 2])])
    maps = [
        camera.project(points)[0].astype(np.float32).reshape(*across.shape, 2)
        for camera in progress_bar(rig.cameras, "maps for cv2.remap")
    ]
    pairs = [(np.ascontiguousarray(m[..., 0]), np.ascontiguousarray(m[..., 1])) for m in maps]
    seconds = fastest_s(
        lambda: [
            cv2.remap(image, column, row, cv2.INTER_LINEAR)
            for image, (column, row) in zip(images, pairs, strict=True)
        ]
    )
    return len(images) * across.size / seconds / 1e9


def high_water_mib() -> float | None:
    """Read the process's peak resident memory (VmHWM); None where unavailable."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024.0


def measure(rig: Rig, planes: int, loads: float) -> dict[str, Any]:
    """Measure speeds on one rig."""
    grid: Grid = replace(rig.grid, shape=(planes, *rig.grid.shape[1:]))
    cameras = rig.cameras
    images = np.random.default_rng(0).random(
        (len(cameras), cameras[0].rows, cameras[0].columns), dtype=np.float32
    )
    giga = len(cameras) * float(np.prod(grid.shape)) / 1e9
    parts = slabs(cameras, grid)
    geometry = fastest_s(lambda: slabs(cameras, grid), 1)
    works = {
        "asa": lambda: refocus_sum(images, cameras, grid),
        "msa": lambda: refocus_log2(images, cameras, grid, 0.01),
        "map_shift_average": lambda: refocus_by_shifts(images, cameras, grid),
    }
    report: dict[str, Any] = {
        "cameras": len(cameras),
        "grid_zyx": grid.shape,
        "slabs": len(parts),
        "deviation_px": round(max(deviation_px(part, cameras, grid) for part in parts), 5),
        "geometry_s": round(geometry, 3),
    }
    remap = remap_gigasamples_s(images, rig)
    for name, work in works.items():
        seconds = fastest_s(work)
        report[name] = {
            "s": round(seconds, 3),
            "gigasamples_per_s": round(giga / seconds, 2),
            "against_remap": round(giga / seconds / remap, 2),
            "share_of_loads": round(4.0 * giga / seconds / loads, 3),
        }
    return report | {
        "peak_memory_mib": high_water_mib(),
        "volume_mib": round(4.0 * float(np.prod(grid.shape)) / 2**20),
    }


def scaling(rig: Rig, planes: int, loads: float) -> dict[str, dict[str, dict[str, float]]]:
    """Measure additive refocusing with fewer cameras, planes and voxels.

    Returns seconds, and the fraction of the roofline of loads.
    """
    images = np.random.default_rng(0).random(
        (len(rig.cameras), rig.cameras[0].rows, rig.cameras[0].columns), dtype=np.float32
    )
    cases = {
        "cameras": {str(n): (n, planes, rig.grid.shape[1]) for n in (5, 10, 25)},
        "planes": {
            str(n): (len(rig.cameras), n, rig.grid.shape[1])
            for n in (planes // 4, planes, 4 * planes)
        },
        "across": {str(n): (len(rig.cameras), planes, n) for n in (250, 500, 1000)},
    }
    return {
        axis: {key: _one_size(rig, images, size, loads) for key, size in sizes.items()}
        for axis, sizes in cases.items()
    }


def _one_size(rig: Rig, images: F32, size: tuple[int, int, int], loads: float) -> dict[str, float]:
    count, planes, across = size
    grid = replace(rig.grid, shape=(planes, across, across))
    seconds = fastest_s(lambda: refocus_sum(images[:count], rig.cameras[:count], grid))
    samples = count * planes * across**2 / 1e9
    return {
        "s": round(seconds, 3),
        "gigasamples_per_s": round(samples / seconds, 2),
        "share_of_loads": round(4.0 * samples / seconds / loads, 3),
    }


def main() -> None:
    """Print times of refocusing as JSON."""
    planes = int(sys.argv[1]) if len(sys.argv) > 1 else 80
    loads = cached_gigaloads_s()
    report: dict[str, Any] = {
        "backend": backend.choose().why,
        "cores": os.cpu_count(),
        "triad_gb_per_s": round(triad_gb_s(), 1),
        "cached_gigaloads_per_s": round(loads, 1),
        "gathered_gigaloads_per_s": round(gathered_gigaloads_s(), 2),
    }
    rigs = {
        "demo": build_rig(load_scene("demo")),
        "thesis-50x50x10": build_rig(load_scene("thesis-50x50x10")),
        "scattered": scattered_rig(),
    }
    for name, rig in rigs.items():
        report[name] = measure(rig, planes, loads)
    report["asa_scaling"] = scaling(rigs["thesis-50x50x10"], planes, loads)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
