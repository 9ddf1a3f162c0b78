"""Codes behind bubbles: figure 1-3 and section 2.2.2."""

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.algorithms.refocus import Join
from sabench.api import Code, Observation
from sabench.apps.surfaces import refocus_frame
from sabench.evaluation.reproduction import Item
from sabench.evaluation.suite_loading import override
from sabench.geometry.grid import Grid
from sabench.geometry.surfaces import Cylinder, Plane, Surface
from sabench.metrics.code_reading import read_volume, reading, single_views
from sabench.plotting.drawing import Figure, Panel
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.camera_view import render_camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering.sensor import expose
from sabench.tasks.see_through import code_plane
from sabench.utils.arrays import F32, F64
from sabench.worlds.bubbles_and_bodies import code_of

from .chapter_5 import render_first_frame
from .common import claim, coarsen, image_panel, make_row, run

_METHODS = ("additive", "multiplicative", "dark", "mart")


def fig_1_3(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure cells read, contrast and separation, per method and in single views."""
    scene = coarsen(load_scene("see-through"), pixels)
    readings: dict[str, list[dict[str, float]]] = {}
    panels: list[Panel] = []
    for seed in seeds:
        frame, _, case = render_first_frame(scene, seed)
        code = code_of(scene, seed, 0)
        single = [
            reading(cells, code.dark)
            for cells in single_views(case.images, frame.rig.cameras, code.points_mm)
        ]
        readings.setdefault("single views, mean", []).append(
            {key: float(np.nanmean([view[key] for view in single])) for key in single[0]}
        )
        readings.setdefault("best single view", []).append(
            max(single, key=lambda view: view["read_percent"])
        )
        for method in _METHODS:
            volume = run("see_through", case, method=method).volume
            readings.setdefault(method, []).append(
                reading(read_volume(case.grid, volume, code.points_mm), code.dark)
            )
            if seed == seeds[0]:
                panels.append(image_panel(method, code_plane(case.grid, volume, code), y=""))
        if seed == seeds[0]:
            panels = [*_views(scene, seed, case, code), *panels]
    yield Figure("fig-1-3", "a code behind bubbles", tuple(panels), across=3)
    for name, every in readings.items():
        yield make_row(
            f"{name}: cells read, %",
            None,
            [read["read_percent"] for read in every],
            "guessing gives 50",
        )
        yield make_row(f"{name}: d'", None, [read["separation"] for read in every])
        yield make_row(f"{name}: contrast", None, [read["contrast"] for read in every])
    best, blind = (
        np.array([read["read_percent"] for read in readings[name]])
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
    clear = expose(
        bare.sensor, render_camera_view(frame, middle).photons, frame.sensor_noise(middle)
    )
    return [
        image_panel("(a) without bubbles", clear, y=""),
        image_panel("(b) one view", case.images[middle], y=""),
    ]


_JOINS: tuple[Join, ...] = ("additive", "dark")
_PIXEL_MM, _MARGIN_MM = 0.25, 2.0
_STEP_MM = 1.0  # of the planes of which the best is taken
Readings = dict[str, list[dict[str, float]]]


def section_2_2_2(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure cells read and separation on the cylinder and in the best plane."""
    scene = coarsen(load_scene("curved-wall"), pixels)
    readings: Readings = {}
    for seed in seeds:
        case, code = render_first_frame(scene, seed)[2], code_of(scene, seed, 0)
        single = [
            reading(cells, code.dark)
            for cells in single_views(case.images, case.cameras, code.points_mm)
        ]
        best = max(single, key=lambda view: view["read_percent"])
        readings.setdefault("best single view", []).append(best)
        panels = [image_panel("(a) one view", case.images[len(case.images) // 2], y="")]
        for join in _JOINS:
            panels += _measure(scene, seed, case, join, readings)
        if seed == seeds[0]:
            yield Figure(
                "section-2-2-2", "a code on a cylinder behind bubbles", tuple(panels), across=3
            )
    yield from _table(readings)


def _table(readings: Readings) -> Iterator[Item]:
    for name, every in readings.items():
        reads = [read["read_percent"] for read in every]
        yield make_row(f"{name}: cells read, %", None, reads, "guessing gives 50")
        yield make_row(f"{name}: d'", None, [read["separation"] for read in every])
    for join in _JOINS:
        curved, flat = (
            np.array([read["separation"] for read in readings[f"{join}, {where}"]])
            for where in ("cylinder", "best plane")
        )
        yield claim(
            f"{join}: a focal surface need not be plane",
            "section 2.2.2",
            float((curved / flat).min()),
            bool((curved > flat).all()),
            "least ratio of d' on the cylinder to that in the best plane",
        )


def _measure(
    scene: Scene, seed: int, case: Observation, join: Join, readings: Readings
) -> list[Panel]:
    """Read the code on the cylinder, and in the plane with the best reading."""
    code, flat = code_of(scene, seed, 0), _flat_code(scene, seed)
    plate = scene.world.solids[0]
    reach = 2.0 * np.abs(flat.points_mm).max(axis=(0, 1)) + _MARGIN_MM
    curved = Cylinder(
        center_mm=tuple(plate["place_mm"]),
        size_mm=(float(reach[0]), float(reach[1])),
        pixel_mm=_PIXEL_MM,
        radius_mm=plate["bend_radius_mm"],
    )
    image = refocus_frame(case, curved, join)[0].values
    readings.setdefault(f"{join}, cylinder", []).append(_read(curved, image, flat.points_mm, code))
    planes = [_read_plane(case, join, code, z) for z in _depths(code)]
    best, shown = max(planes, key=lambda plane: plane[0]["separation"])
    readings.setdefault(f"{join}, best plane", []).append(best)
    return [
        image_panel(f"{join}: {name}", values, y="")
        for name, values in (("cylinder", image), ("best plane", shown))
    ]


def _depths(code: Code) -> F64:
    z = code.points_mm[..., 2]
    return np.arange(np.floor(z.min()), z.max() + _STEP_MM, _STEP_MM)


def _flat_code(scene: Scene, seed: int) -> Code:
    """Make the same code before it is bent, in (arc length, Y, 0) of its frame."""
    plate = {key: value for key, value in scene.world.solids[0].items() if key != "bend_radius_mm"}
    plate["place_mm"] = [0.0, 0.0, scene.volume.center_mm[2]]
    flat = code_of(override(scene, {"solids": [plate]}, scene.title), seed, 0)
    return Code(flat.points_mm - np.asarray(plate["place_mm"]), flat.dark)


def _read_plane(
    case: Observation, join: Join, code: Code, z_mm: float
) -> tuple[dict[str, float], F32]:
    """Read the code in a plane of constant Z, where the middle camera sees its cells."""
    eye = case.cameras[len(case.cameras) // 2]
    cells = eye.carry(code.points_mm.reshape(-1, 3), z_mm)
    reach = 2.0 * np.abs(cells).max(axis=0) + _MARGIN_MM
    plane = Plane(
        center_mm=(0.0, 0.0, z_mm), size_mm=(float(reach[0]), float(reach[1])), pixel_mm=_PIXEL_MM
    )
    image = refocus_frame(case, plane, join)[0].values
    points = np.column_stack([cells, np.zeros(len(cells))]).reshape(code.points_mm.shape)
    return _read(plane, image, points, code), image


def _read(surface: Surface, image: F32, own_mm: F64, code: Code) -> dict[str, float]:
    """Read the code in a surface's image at points (cell, point, 3) as (u, v, 0)."""
    u, v = surface.axes_mm
    step = surface.pixel_mm
    grid = Grid((float(u[0]), float(v[0]), 0.0), (step, step, 1.0), (1, len(v), len(u)))
    return reading(read_volume(grid, image[None], own_mm), code.dark)
