"""Seconds to render bubbles with nine cameras of 1024 x 1024 pixels.

    python benchmarks/bubbles.py [bubbles[@error] ...]

By default 200@0.01, 2,000@0.01, 10,000@0.05 and 2,000 bubbles of 0.6 mm median radius in 200 x 200
x 100 mm. An error is the mean over the image of relative standard errors; without one, images have
the error that a scene has by default, which is the mean over pixels that show bubbles. Of 10,000,
many hide each other, and dark pixels of many paths take long to reach a percent. Prints one JSON
value: seconds, the largest error of the nine images, and the fraction of the central camera's image
that bubbles cover.
"""

import json
import sys
import time
from typing import Any

import numpy as np

from sabench.scenes import Scene, build_rig, parse_scene
from sabench.simulation.camera_view import render_camera_view, tank_and_lights
from sabench.simulation.frames import Frames
from sabench.simulation.rendering import bubbles_traced
from sabench.utils.arrays import F64

_DEFAULT = "200@0.01", "2000@0.01", "10000@0.05", "2000"


def scene_of(count: int) -> Scene:
    """Make the scene: the array of `plunging-jet-21` and a box full of bubbles."""
    from sabench.scenes import load_scene

    values: dict[str, Any] = load_scene("plunging-jet-21").to_dict()
    values["title"] = f"{count} bubbles"
    values["volume"] = {"center_mm": [0.0, 125.0, 150.0], "size_mm": [200.0, 200.0, 100.0]}
    del values["render"]["relative_error"]
    values["bubbles"] = {
        "generator": "bubble_field",
        "count": count,
        "radius_mm": 0.6,
        "radius_range_mm": [0.15, 2.5],
    }
    return parse_scene(values, "benchmark")


def measure_frame(count: int, error: float | None) -> dict[str, float]:
    """Render one frame with all cameras; kernels are compiled before."""
    scene = scene_of(count)
    rig = build_rig(scene)
    frame = Frames(scene, rig, 1).at(0)
    bubbles = frame.bubbles
    assert bubbles is not None
    tank, lights = tank_and_lights(scene)
    bubbles_traced.render(rig.cameras[0], tank, bubbles, (), lights, 1.0, 1)
    shown: list[tuple[F64, float]] = []
    start = time.perf_counter()
    for number, camera in enumerate(rig.cameras):
        if error is None:
            view = render_camera_view(frame, number)
            shown.append((view.photons, (view.sight and view.sight.error) or 0.0))
        else:
            given = camera, tank, bubbles, (), lights, error, 1000 * number
            seen = bubbles_traced.render(*given)
            shown.append((seen.photons, seen.error or 0.0))
    seconds = time.perf_counter() - start
    photons = shown[4][0]
    covered = float((photons < 0.9 * np.median(photons)).mean())
    return {
        "bubbles": count,
        "seconds": round(seconds, 1),
        "error": round(max(own for _, own in shown), 4),
        "covered": round(covered, 3),
    }


def main() -> None:
    """Measure all counts, one after another."""
    asked = [argument.partition("@") for argument in sys.argv[1:] or _DEFAULT]
    runs = [measure_frame(int(count), float(error) if error else None) for count, _, error in asked]
    print(json.dumps({"cameras": 9, "pixels": [1024, 1024], "runs": runs}, indent=1))


if __name__ == "__main__":
    main()
