"""Speed of the plane sweep on the demo's rig: `python benchmarks/refocus.py [scene] [planes]` prints JSON.

Nine cameras of 1000 x 1000 pixels, 80 planes, random images. Speed is also given against OpenCV's bilinear remap on the same number of
samples, taken in the same run with the maps ready; the sweep also computes its maps, one polynomial per camera and plane, and folds.
"""

from __future__ import annotations

import functools
import json
import os
import sys
import timeit
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sabench import backend
from sabench.arrays import F32
from sabench.progress import track
from sabench.reproject import Fold, plane_maps, sweep
from sabench.rig import Rig, build_rig, load_scene
from sabench.volume import Grid


def mean_of(dr: Any, samples: Any) -> Any:
    return sum(samples) / len(samples)


def product_of(dr: Any, samples: Any) -> Any:
    return dr.exp2(sum(dr.log2(dr.maximum(sample, 0.01)) for sample in samples) * (3.0 / len(samples)))


def timed(work: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of several runs, after one to warm up."""
    work()
    return min(timeit.repeat(work, number=1, repeat=repeats))


def remap_all(images: F32, maps: list[tuple[F32, F32]], planes: int) -> None:
    """As many bilinear samples as a sweep takes."""
    for _ in track(range(planes), "cv2.remap"):
        for image, (column, row) in zip(images, maps, strict=True):
            cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def middle_maps(rig: Rig) -> list[tuple[F32, F32]]:
    """Exact pixel coordinates of the middle plane's voxels in every camera."""
    x, y, z = rig.grid.axes_mm
    across, down = np.meshgrid(x, y)
    points = np.column_stack([across.ravel(), down.ravel(), np.full(across.size, z[len(z) // 2])])
    maps = []
    for camera in track(rig.cameras, "maps for cv2.remap"):
        pixels = camera.project(points)[0].astype(np.float32).reshape(*across.shape, 2)
        maps.append((np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])))
    return maps


def high_water_mib() -> float | None:
    """The process's largest resident memory so far (VmHWM); None where Linux does not say."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024.0


def main() -> None:
    rig = build_rig(load_scene(sys.argv[1] if len(sys.argv) > 1 else "demo"))
    planes = int(sys.argv[2]) if len(sys.argv) > 2 else rig.grid.shape[0]
    grid: Grid = replace(rig.grid, shape=(planes, *rig.grid.shape[1:]))
    first = rig.cameras[0]
    images = np.random.default_rng(0).random((len(rig.cameras), first.rows, first.columns), dtype=np.float32)
    giga = len(rig.cameras) * float(np.prod(grid.shape)) / 1e9
    folds: dict[str, Fold] = {"mean": mean_of, "product": product_of}
    seconds = {name: timed(functools.partial(sweep, images, rig.cameras, grid, fold), 2) for name, fold in folds.items()}
    peak = high_water_mib()
    maps = middle_maps(rig)
    seconds["remap"] = timed(lambda: remap_all(images, maps, planes), 1)
    fitted = timed(lambda: plane_maps(rig.cameras, grid), 1)
    report = {
        "backend": backend.choose().why,
        "cores": os.cpu_count(),
        "cameras": len(rig.cameras),
        "grid_zyx": grid.shape,
        "gigasamples": round(giga, 4),
        "mean_gigasamples_per_s": round(giga / seconds["mean"], 3),
        "product_gigasamples_per_s": round(giga / seconds["product"], 3),
        "remap_gigasamples_per_s": round(giga / seconds["remap"], 3),
        "mean_against_remap": round(seconds["remap"] / seconds["mean"], 3),
        "product_against_remap": round(seconds["remap"] / seconds["product"], 3),
        "plane_maps_s": round(fitted, 3),
        "peak_memory_mib": None if peak is None else round(peak),
        "volume_mib": round(4.0 * float(np.prod(grid.shape)) / 2**20),
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
