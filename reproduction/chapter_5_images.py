"""Figures 5-5 to 5-11: refocused planes, feature potential E, minimum images.

The bubbles' true positions say where E and the images are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from sabench.algorithms.bubbles.features import (
    STACK,
    WINDOW,
    attenuate,
    compute_potential,
    darkness,
    find_outlines,
    minimum_images,
)
from sabench.api import Observation
from sabench.api.truth import Bubbles
from sabench.evaluation.reproduction import Item
from sabench.geometry.grid import Grid
from sabench.metrics.averages import mean_of_finite
from sabench.plotting.drawing import Cloud, Curve, Figure, Panel, Picture
from sabench.scenes import load_scene
from sabench.utils.arrays import F32, F64, I64, Bool

from .chapter_5 import render_first_frame
from .common import claim, coarsen, finite_row, image_panel

_SCENE = "plunging-jet-21"
_OFF_MM = 10.0  # of the refocused planes before and behind the middle one: figure 5-6
_EDGE, _SMALL_PX = 0.05, 4.0  # as `minimum_image` takes them
_NEAR = 5  # planes between a bubble and its peak of E: section 5.4.3
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)  # of points on a rim
_FLAT = 1e-6  # spread of a window: the thesis normalises windows in which nothing is, too
_RINGS = np.linspace(0.4, 1.0, 7)  # parts of the radius where a rim may be darkest
_KINDS = ("large", "small")  # by `_SMALL_PX`


@dataclass(frozen=True)
class Stack:
    """Refocused darkness before and after attenuation, and feature potential.

    Attributes
    ----------
    before, after : minimum images of every `STACK` planes.
    potential, cut : E (plane, window row, window column), of all windows, and 0 in those of small
        spread, as the solvers have it.
    voxels : (n, 4) column, row, plane and radius of the true bubbles in voxels.
    """

    case: Observation
    volume: F32
    before: list[F32]
    after: list[F32]
    potential: F32
    cut: F32
    voxels: F64

    @classmethod
    def of(cls, case: Observation, bubbles: Bubbles) -> Stack:
        """Refocus a frame, and attenuate it once."""
        volume, grid = darkness(case), case.grid
        original = volume.copy()
        before = [dark for dark, _ in minimum_images(volume)]
        potential = compute_potential(volume, WINDOW, _FLAT)
        attenuate(volume, potential, WINDOW)
        after = [dark for dark, _ in minimum_images(volume)]
        place = (bubbles.center_mm - np.asarray(grid.low_mm)) / np.asarray(grid.voxel_mm)
        voxels = np.column_stack([place, bubbles.radius_mm / grid.voxel_mm[0]])
        cut = compute_potential(original, WINDOW)
        return cls(case, original, before, after, potential, cut, voxels)

    def kinds(self) -> dict[str, I64]:
        """Sort the bubbles by size; their rows."""
        large = 2.0 * self.voxels[:, 3] >= _SMALL_PX
        return {"large": np.flatnonzero(large), "small": np.flatnonzero(~large)}

    def rim(self, bubble: int, part: float = 1.0) -> tuple[I64, I64]:
        """List rows and columns (n,) of the voxels at a part of a bubble's radius."""
        x, y, _, radius = self.voxels[bubble] * [1.0, 1.0, 1.0, part]
        height, width = self.volume.shape[1:]
        rows = np.clip(np.rint(y + radius * np.sin(_ANGLES)), 0, height - 1).astype(np.int64)
        columns = np.clip(np.rint(x + radius * np.cos(_ANGLES)), 0, width - 1).astype(np.int64)
        return rows, columns

    def plane(self, bubble: int) -> int:
        """Return the plane through a bubble's centre."""
        return int(np.clip(np.rint(self.voxels[bubble, 2]), 0, len(self.volume) - 1))

    def over_depth(self, bubble: int, potential: F32) -> F64:
        """Return E (plane,) of the window with the largest E on a bubble's outline."""
        rows, columns = self.rim(bubble)
        _, down, across = potential.shape
        i, j = np.minimum(rows // WINDOW, down - 1), np.minimum(columns // WINDOW, across - 1)
        every = potential[:, i, j]
        return every[:, int(every[self.plane(bubble)].argmax())].astype(np.float64)


def fig_5_7(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure E at bubbles, contrast and edges of minimum images; means over frames."""
    scene = coarsen(load_scene(_SCENE), pixels)
    values: dict[str, list[float]] = {}
    for seed in seeds:
        _, bubbles, case = render_first_frame(scene, seed)
        stack = Stack.of(case, bubbles)
        if seed == seeds[0]:
            yield from _planes(stack)
            yield _minimum_figure(stack)
            shown = {
                kind: _typical(stack, which) for kind, which in stack.kinds().items() if len(which)
            }
            yield _depth_figure(stack, shown)
            yield Figure(
                "fig-5-10",
                "minimum images of a large and of a small bubble",
                tuple(_crop(stack, bubble, f"{kind} bubble") for kind, bubble in shown.items()),
                inch=(3.4, 3.4),
            )
        # measure bright centres and gradients at rims in attenuated images. The rim is the darkest
        # ring
        out = {}
        for kind, which in stack.kinds().items():
            centers, gradients = [], []
            for bubble in which:
                dark = stack.after[stack.plane(bubble) // STACK]
                rim = max(float(np.mean(dark[stack.rim(int(bubble), part)])) for part in _RINGS)
                x, y = np.rint(stack.voxels[bubble, :2]).astype(np.int64)
                inside = 0 <= y < dark.shape[0] and 0 <= x < dark.shape[1]
                if rim > 0.0 and inside:
                    centers.append(float(dark[y, x]) / rim)
                    gradients.append(_gradient(dark, x, y, float(stack.voxels[bubble, 3])))
            out[f"darkness of centre over rim, {kind} bubbles"] = _median(centers)
            out[f"largest gradient per voxel, {kind} bubbles"] = _median(gradients)
        for key, value in (_peaks(stack) | _contrasts(stack) | out).items():
            values.setdefault(key, []).append(value)
    for key, every in values.items():
        yield finite_row(key, every)
    means = {key: mean_of_finite(every) for key, every in values.items()}
    if None not in means.values():
        yield from _claims({key: mean for key, mean in means.items() if mean is not None})


def _claims(mean: dict[str, float]) -> Iterator[Item]:
    levels = [mean["E, large bubbles"], mean["E, small bubbles"], mean["E, background"]]
    yield claim(
        "5-7: E of large bubbles over that of small ones",
        "small bubbles have lower peaks, noise has none",
        levels[0] / levels[1],
        levels[0] > levels[1] > levels[2],
        f"small ones over background {levels[1] / levels[2]:.3g}",
    )
    share = mean["distribution of E, large bubbles"]
    yield claim(
        "5-8: cumulative distribution of E at large bubbles",
        "high levels near one",
        share,
        share > 0.9,
    )
    before, after = mean["contrast, original"], mean["contrast, attenuated"]
    yield claim(
        "5-9: contrast after over before attenuation",
        "attenuation suppresses noise",
        after / before,
        after > before,
    )
    centers = [mean[f"darkness of centre over rim, {kind} bubbles"] for kind in _KINDS]
    yield claim(
        "5-10: darkness of the centre over that of the rim, large over small bubbles",
        "a large bubble has a bright centre, a small one only dark pixels",
        centers[0] / centers[1],
        centers[0] < centers[1],
    )


def _peaks(stack: Stack) -> dict[str, float]:
    """Measure E and its rank over depth near the planes of bubbles, and E elsewhere."""
    out: dict[str, float] = {}
    for kind, which in stack.kinds().items():
        near, ranks, hits, left = [], [], [], []
        for bubble in which:
            over, plane = stack.over_depth(bubble, stack.potential), stack.plane(bubble)
            part = slice(max(plane - _NEAR, 0), plane + _NEAR + 1)
            near.append(float(over[part].max()))
            ranks.append(float(np.mean(over <= near[-1])))
            hits.append(abs(int(over.argmax()) - plane) <= _NEAR)
            cut = stack.over_depth(bubble, stack.cut)
            left.append(bool(cut.any()) and abs(int(cut.argmax()) - plane) <= _NEAR)
        out[f"E, {kind} bubbles"] = _median(near)
        out[f"distribution of E, {kind} bubbles"] = _median(ranks)
        share = f"share with the largest E within {_NEAR} planes, {kind} bubbles"
        out[share], out[f"{share}, the solvers' least spread"] = _mean(hits), _mean(left)
    out["E, background"] = _median(list(stack.potential[stack.potential > 0.0]))
    return out


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _mean(values: Sequence[float | bool]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _contrasts(stack: Stack) -> dict[str, float]:
    """Measure the mean darkness of rims over the rms darkness next to bubbles."""
    out = {}
    for name, images in (("original", stack.before), ("attenuated", stack.after)):
        values = []
        for number, dark in enumerate(images):
            rim, around = _masks(stack, number, dark.shape)
            if rim.any():
                values.append(float(dark[rim].mean() / np.sqrt(np.mean(dark[~around] ** 2))))
        out[f"contrast, {name}"] = _mean(values)
    return out


def _masks(stack: Stack, number: int, shape: tuple[int, ...]) -> tuple[Bool, Bool]:
    """Mark pixels on rims of a stack's bubbles, and those in or near any of them."""
    rim, around = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.uint8)
    for bubble in np.flatnonzero(stack.voxels[:, 2].round() // STACK == number):
        rim[stack.rim(int(bubble))] = 1
        x, y, _, radius = stack.voxels[bubble]
        cv2.circle(around, (round(x), round(y)), int(np.ceil(radius)) + WINDOW, 1, -1)
    return rim.astype(np.bool_), around.astype(np.bool_)


def _gradient(dark: F32, x: int, y: int, radius: float) -> float:
    """Find the largest gradient of darkness in and around a bubble."""
    reach = int(np.ceil(radius)) + 2
    part = dark[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
    across = cv2.Sobel(part, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    down = cv2.Sobel(part, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    return float(cv2.magnitude(across, down).max())


def _typical(stack: Stack, which: I64) -> int:
    """Select the bubble with the median E at its plane."""
    bubbles = which.tolist()
    levels = [stack.over_depth(n, stack.potential)[stack.plane(n)] for n in bubbles]
    return int(which[np.argsort(levels)[len(levels) // 2]])


def _depth_figure(stack: Stack, shown: dict[str, int]) -> Figure:
    """Draw figures 5-7 and 5-8: E over depth of windows, and its distribution."""
    z = stack.case.grid.axes_mm[2]
    over = []
    for kind, bubble in shown.items():
        name = f"{kind} bubble at {z[stack.plane(bubble)]:.1f} mm"
        over.append(Curve(name, list(z), list(stack.over_depth(bubble, stack.potential))))
    rank = list(np.arange(1, len(z) + 1) / len(z))
    shares, marks = [], []
    for kind, bubble in shown.items():
        values = np.sort(stack.over_depth(bubble, stack.potential))
        shares.append(Curve(f"window of the {kind} one", list(values), rank))
        level = stack.over_depth(bubble, stack.potential)[[stack.plane(bubble)]]
        marks.append(
            Cloud(f"{kind} bubble", level, np.searchsorted(values, level, "right") / len(z))
        )
    return Figure(
        "fig-5-7",
        "E of windows on the outlines of two bubbles",
        (
            Panel("5-7", "Z, mm", "E", tuple(over), log="y"),
            Panel("5-8", "E", "share of planes", (*shares, *marks), log="x"),
        ),
    )


def _crop(stack: Stack, bubble: int, title: str) -> Panel:
    """Draw the attenuated minimum image around a bubble."""
    dark = stack.after[stack.plane(bubble) // STACK]
    x, y = np.rint(stack.voxels[bubble, :2]).astype(np.int64)
    reach = int(np.ceil(2.0 * stack.voxels[bubble, 3])) + 3
    rows = slice(max(y - reach, 0), y + reach + 1)
    columns = slice(max(x - reach, 0), x + reach + 1)
    part = 1.0 - dark[rows, columns].astype(np.float64)
    low = float(columns.start), float(rows.start)
    high = low[0] + part.shape[1] - 1.0, low[1] + part.shape[0] - 1.0
    return Panel(title, "voxels", "voxels", (Picture(part, low, high),))


def _minimum_figure(stack: Stack) -> Figure:
    """Draw figures 5-9 and 5-11: minimum images before and after, and outlines."""
    grid, number = stack.case.grid, len(stack.volume) // 2 // STACK
    dark = stack.after[number]
    depth = np.zeros_like(dark)
    outlines = find_outlines(dark, depth, _EDGE, _SMALL_PX).shapes
    circles = np.column_stack(
        [
            outlines[:, :2] * grid.voxel_mm[:2] + np.asarray(grid.low_mm[:2]),
            np.sqrt(outlines[:, 2] * outlines[:, 3]) * grid.voxel_mm[0],
        ]
    )
    before, after = (1.0 - dark[number].astype(np.float64) for dark in (stack.before, stack.after))
    return Figure(
        "fig-5-11",
        "minimum image of 50 planes",
        (
            _plane(grid, "original (5-9a)", before),
            _plane(grid, "attenuated (5-9b)", after),
            _plane(grid, "outlines", after, circles),
        ),
        inch=(4.8, 4.4),
    )


def _planes(stack: Stack) -> Iterator[Figure]:
    """Draw figures 5-5 and 5-6: a view, and the middle third of three planes."""
    case = stack.case
    grid, view = case.grid, case.images[len(case.images) // 2]
    yield Figure("fig-5-5", "a backlit view", (image_panel("", view),), inch=(5.5, 5.5))
    middle, step = len(stack.volume) // 2, round(_OFF_MM / grid.voxel_mm[2])
    planes = [int(np.clip(middle + off, 0, len(stack.volume) - 1)) for off in (-step, 0, step)]
    panels = [
        _plane(grid, f"Z = {grid.axes_mm[2][n]:.1f} mm", 1.0 - stack.volume[n].astype(np.float64))
        for n in planes
    ]
    yield Figure("fig-5-6", "refocused planes", tuple(panels), inch=(4.6, 4.2))


def _plane(grid: Grid, title: str, values: F64, rings: F64 | None = None) -> Panel:
    third = slice(len(values) // 3, 2 * len(values) // 3)
    x, y, values = grid.axes_mm[0], grid.axes_mm[1][third], values[third]
    rings = rings[(rings[:, 1] >= y[0]) & (rings[:, 1] <= y[-1])] if rings is not None else None
    return Panel(
        title,
        "X, mm",
        "Y, mm",
        (Picture(values, (float(x[0]), float(y[0])), (float(x[-1]), float(y[-1])), rings),),
    )
