"""Figure 1-3: code behind bubbles, read in single views and refocused planes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sabench.api import Code, Observation
from sabench.api.make import make_algorithm
from sabench.evaluation.suite_loading import override
from sabench.evaluation.thesis.chapter_5 import render_first_frame
from sabench.evaluation.thesis.common import Item, claim, coarsen, make_row
from sabench.metrics.code_reading import read_volume, reading, single_views
from sabench.plotting.charts import Figure, Panel, Picture
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.camera_view import render
from sabench.simulation.frames import Frames
from sabench.simulation.rendering.sensor import expose
from sabench.tasks.see_through import code_plane
from sabench.utils.arrays import F64
from sabench.worlds.readable_codes import code_of

SEEDS = 3
_METHODS = ("additive", "multiplicative", "dark", "mart")


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure cells read, contrast and separation, per method and in single views."""
    scene = coarsen(load_scene("see-through"), pixels)
    found: dict[str, list[dict[str, float]]] = {}
    panels: list[Panel] = []
    for seed in seeds:
        frame, _, case = render_first_frame(scene, seed)
        code = code_of(scene, seed, 0)
        single = [
            reading(cells, code.dark)
            for cells in single_views(case.images, frame.rig.cameras, code.points_mm)
        ]
        found.setdefault("single views, mean", []).append(
            {key: float(np.nanmean([one[key] for one in single])) for key in single[0]}
        )
        found.setdefault("best single view", []).append(
            max(single, key=lambda one: one["read_percent"])
        )
        for method in _METHODS:
            algorithm: Any = make_algorithm("see_through", {"method": method})
            volume = algorithm.solve(case).volume
            found.setdefault(method, []).append(
                reading(read_volume(case.grid, volume, code.points_mm), code.dark)
            )
            if seed == seeds[0]:
                panels.append(_panel(method, code_plane(case.grid, volume, code)))
        if seed == seeds[0]:
            panels = [*_views(scene, seed, case, code), *panels]
    yield Figure("fig-1-3", "a code behind bubbles", tuple(panels), across=3)
    for name, every in found.items():
        yield make_row(
            f"{name}: cells read, %",
            None,
            [one["read_percent"] for one in every],
            "guessing gives 50",
        )
        yield make_row(f"{name}: d'", None, [one["separation"] for one in every])
        yield make_row(f"{name}: contrast", None, [one["contrast"] for one in every])
    best, blind = (
        np.array([one["read_percent"] for one in found[name]])
        for name in ("additive", "best single view")
    )
    yield claim(
        "refocusing shows what no single view shows",
        "figure 1-3",
        float((best - blind).min()),
        bool((best > blind).all()),
        "least gain, %",
    )


def _views(scene: Scene, seed: int, case: Observation, code: Code) -> list[Panel]:
    """Show the middle camera's image without bubbles and with them."""
    bare = override(scene, {"bubbles": {"generator": "bubble_field", "count": 0}}, scene.title)
    middle = len(case.images) // 2
    frame = Frames(bare, build_rig(bare, bare.title), seed).at(0)
    clear = expose(bare.sensor, render(frame, middle).photons, frame.sensor_noise(middle))
    return [
        _panel("(a) without bubbles", clear.astype(np.float64)),
        _panel("(b) one view", case.images[middle].astype(np.float64)),
    ]


def _panel(title: str, values: F64) -> Panel:
    return Panel(
        title,
        "px",
        "",
        (Picture(values, (0.0, 0.0), (float(values.shape[1] - 1), float(values.shape[0] - 1))),),
    )
