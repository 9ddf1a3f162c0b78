"""Seconds to render bubbles with nine cameras of 1024 x 1024 pixels.

The mean relative standard error is one percent.

    python benchmarks/bubbles.py [bubbles[@error] ...]

By default 200, 2,000 and 10,000@0.05 bubbles of 0.6 mm median radius in 200 x 200 x 100 mm; the
last ones hide each other, and dark pixels of many paths take long to reach a percent. Prints one
JSON value: seconds, the largest error of the nine images, and the fraction of the central camera's
image that bubbles cover.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from sabench.scenes import Scene, build_rig, parse_scene
from sabench.simulation.camera_view import lights_of, tank_of
from sabench.simulation.frames import Frames
from sabench.simulation.rendering.bubbles_traced import render

_ERROR = 0.01


def scene_of(count: int) -> Scene:
    """Make the scene: the array of `plunging-jet-21` and a box full of bubbles."""
    from sabench.scenes import load_scene

    values: dict[str, Any] = load_scene("plunging-jet-21").to_dict()
    values["title"] = f"{count} bubbles"
    values["volume"] = {"center_mm": [0.0, 125.0, 150.0], "size_mm": [200.0, 200.0, 100.0]}
    values["bubbles"] = {
        "generator": "bubble_field",
        "count": count,
        "radius_mm": 0.6,
        "radius_range_mm": [0.15, 2.5],
    }
    return parse_scene(values, "benchmark")


def measure_frame(count: int, error: float) -> dict[str, float]:
    """Render one frame with all cameras; kernels are compiled before."""
    scene = scene_of(count)
    rig = build_rig(scene)
    bubbles = Frames(scene, rig, 1).at(0).bubbles
    assert bubbles is not None
    lights, tank = lights_of(scene), tank_of(scene)
    render(rig.cameras[0], tank, bubbles, (), lights, 1.0, 1)
    start = time.perf_counter()
    shown = [
        render(camera, tank, bubbles, (), lights, error, 1000 * number)
        for number, camera in enumerate(rig.cameras)
    ]
    seconds = time.perf_counter() - start
    covered = float((shown[4].photons < 0.9 * np.median(shown[4].photons)).mean())
    return {
        "bubbles": count,
        "seconds": round(seconds, 1),
        "error": round(max(one.error for one in shown), 4),
        "covered": round(covered, 3),
    }


def main() -> None:
    """Measure all counts, one after another."""
    asked = [argument.partition("@") for argument in sys.argv[1:] or ("200", "2000", "10000@0.05")]
    runs = [measure_frame(int(count), float(error or _ERROR)) for count, _, error in asked]
    print(json.dumps({"cameras": 9, "pixels": [1024, 1024], "runs": runs}, indent=1))


if __name__ == "__main__":
    main()
