"""Seconds on a GPU and on the CPU beside it, and differences of their results.

    python benchmarks/gpu.py [--record]

Each part runs in two processes of its own on the same machine, one on LLVM with all cores and one
on CUDA, and their results are compared. Prints JSON of elapsed seconds and of the
largest differences; with --record, writes it to `records/gpu.json`.

- **particles**: nine traced images of `demo` (50,000 particles behind glass, nine rays a pixel):
  the first one of a process, and the median of the others of a second cloud.
- **bubbles**: nine images of 1024 x 1024 pixels with 2,000 bubbles to an error of 1 %
  (`bubbles.py`).
- **refocusing**: additive and multiplicative, of random images of `demo`'s nine cameras to 80 x
  1000 x 1000 voxels.
- **gradient**: cost and gradient of inverse rendering, the first time and once compiled
  (`inverse_rendering.py`'s scene, 256 x 256 pixels, 0.05 particles per pixel).
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks import bubbles, inverse_rendering
from sabench.algorithms.particles import fit_cameras
from sabench.algorithms.refocus import refocus_log2, refocus_sum
from sabench.geometry.volume_polynomials import points_in_mm
from sabench.scenes import build_rig, load_scene
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import simulate
from sabench.simulation.rendering import bubbles_traced
from sabench.utils import backend
from sabench.utils.arrays import F32, F64

RECORD = Path(__file__).with_name("records") / "gpu.json"
KINDS = "llvm", "cuda"
_REPEATS = 5
Measured = tuple[dict[str, float], F32 | F64]


def particles() -> Measured:
    """Trace images of two clouds; keep those of the second."""
    scene = load_scene("demo")
    rig, seconds, shown = build_rig(scene), [], []
    for seed in (1, 2):
        frame = Frames(scene, rig, seed, "mitsuba").at(0)
        for camera in range(len(rig.cameras)):
            took, view = _timed(lambda: camera_view.render_camera_view(frame, camera))  # noqa: B023
            seconds.append(took)
            shown.append(view.photons)
    half = len(rig.cameras)
    seen = np.stack(shown[half:])
    return {"first_image_s": seconds[0], "image_s": float(np.median(seconds[half:]))}, seen


def bubble_images() -> Measured:
    """Trace 2,000 bubbles with nine cameras."""
    scene = bubbles.scene_of(2000)
    rig = build_rig(scene)
    shown = Frames(scene, rig, 1).at(0).bubbles
    assert shown is not None
    tank, lights = camera_view.tank_and_lights(scene)
    given = tank, shown, (), lights
    first, _ = _timed(lambda: bubbles_traced.render(rig.cameras[0], *given, 1.0, 1))
    seconds, views = _timed(
        lambda: [
            bubbles_traced.render(camera, *given, 0.01, 1000 * number).photons
            for number, camera in enumerate(rig.cameras)
        ]
    )
    return {"first_image_s": first, "nine_images_s": seconds}, np.stack(views)


def refocusing() -> Measured:
    """Refocus random images onto 80 planes."""
    rig = build_rig(load_scene("demo"))
    grid = replace(rig.grid, shape=(80, *rig.grid.shape[1:]))
    count, one = len(rig.cameras), rig.cameras[0]
    images = np.random.default_rng(0).random((count, one.rows, one.columns), dtype=np.float32)
    works: dict[str, Callable[[], F32]] = {
        "additive": lambda: refocus_sum(images, rig.cameras, grid),
        "multiplicative": lambda: refocus_log2(images, rig.cameras, grid, 0.01),
    }
    seconds, kept = {}, []
    for name, work in works.items():
        seconds[f"{name}_s"] = min(_timed(work)[0] for _ in range(_REPEATS))
        kept.append(work()[::8])
    return seconds, np.stack(kept)


def gradient() -> Measured:
    """Differentiate the cost of a search's particles in four images of 256 x 256 pixels."""
    shot = simulate(inverse_rendering.scene_of(0.05, 256), seed=1)
    found = inverse_rendering.search(shot)
    descent = inverse_rendering.descent
    model = descent.image_model(found, shot.observation, fit_cameras(shot.observation))
    images = descent.DifferentiableImages(model)
    place = points_in_mm(found.maps, found.position)
    logs = np.log(found.light / model.typical)
    images.lay_out(place)
    first, _ = _timed(lambda: images.cost_and_slopes(place, logs))
    usual = min(_timed(lambda: images.cost_and_slopes(place, logs))[0] for _ in range(_REPEATS))
    _, slopes, _ = images.cost_and_slopes(place, logs)
    return {"particles": len(place), "first_s": first, "usual_s": usual}, slopes


PARTS: dict[str, Callable[[], Measured]] = {
    "particles": particles,
    "bubbles": bubble_images,
    "refocusing": refocusing,
    "gradient": gradient,
}


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def measure(part: str, folder: Path) -> dict[str, Any]:
    """Run a part on both backends, and compare."""
    seconds: dict[str, Any] = {}
    for kind in KINDS:
        subprocess.run(
            [sys.executable, __file__, "--part", part, "--into", str(folder / kind)],
            env=os.environ | {backend.CHOICE_VARIABLE: kind},
            check=True,
        )
        seconds[kind] = json.loads((folder / kind).with_suffix(".json").read_text())
    cpu, gpu = (np.load((folder / kind).with_suffix(".npy")).astype(float) for kind in KINDS)
    apart, scale = np.abs(gpu - cpu), np.abs(cpu).max()
    return seconds | {
        "largest_difference": float(f"{apart.max() / scale:.3g}"),
        "rms_difference": float(f"{np.sqrt((apart**2).mean()) / scale:.3g}"),
        "sum_ratio": float(gpu.sum() / cpu.sum()),
    }


def device() -> str:
    """Name the GPU and the number of cores beside it."""
    asked = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    if shutil.which(asked[0]) is None:
        sys.exit("expected a GPU with CUDA and nvidia-smi, found none")
    name = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    return f"{name}, {os.cpu_count()} cores"


def main() -> None:
    """Measure all parts, or one in this process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--part", choices=PARTS)
    parser.add_argument("--into", type=Path)
    asked = parser.parse_args()
    if asked.part:
        seconds, kept = PARTS[asked.part]()
        rounded = {
            key: float(f"{value:.3g}") if isinstance(value, float) else value
            for key, value in seconds.items()
        }
        asked.into.with_suffix(".json").write_text(json.dumps(rounded), encoding="utf-8")
        np.save(asked.into.with_suffix(".npy"), kept)
        return
    found: dict[str, Any] = {"machine": device(), "date": f"{datetime.now():%Y-%m-%d}"}
    with tempfile.TemporaryDirectory() as folder:
        for part in PARTS:
            found[part] = measure(part, Path(folder))
            print(part, json.dumps(found[part]), file=sys.stderr, flush=True)
    print(json.dumps(found, indent=1))
    if asked.record:
        RECORD.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
