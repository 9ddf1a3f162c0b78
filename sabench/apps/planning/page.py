"""Page of a plan: warnings, drawings of the rig and figures, as one HTML file.

Each drawing is a projection along one edge of the volume. Walls and the light sheet are cut where
the plane through the volume's middle meets them.
"""

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup
from skimage.measure import find_contours

from sabench.apps.planning.plan import Plan
from sabench.apps.planning.viewing import Viewing
from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import WallRecord
from sabench.geometry.refraction import Wall
from sabench.plotting.outlines import OUTLINE_KINDS, STYLE, Outline, draw_outlines
from sabench.plotting.page import render_page
from sabench.scenes import Scene
from sabench.scenes.illumination import Illumination
from sabench.utils.arrays import F64

_NODES = 500  # nodes of a section along each side
_MARGIN, _NEAR = 0.08, 0.6  # margins around the rig and the volume, share of their size
_CAMERA = 0.03  # length of a camera's symbol, of the window
_AXES = ("x", "y", "z")


def draw_rig(scene: Scene, view: Viewing) -> list[tuple[str, str]]:
    """Draw a rig as pairs of a title and an SVG element.

    Parameters
    ----------
    scene : with the laser as it is in the fluid.
    """
    drawings = []
    for vertical in (edge for edge in range(3) if edge != view.axis):
        plane = (view.axis, vertical)
        for words, (low, high) in (("rig", _whole(view, plane)), ("volume", _near(view, plane))):
            outlines = list(_outlines(scene, view, plane, low, high))
            names = _AXES[view.axis], _AXES[vertical]
            title = f"{words.capitalize()}, {names[0]} and {names[1]}"
            drawings.append((title, draw_outlines(title, outlines, low, high, names)))
    return drawings


def _corners(view: Viewing, plane: tuple[int, int]) -> F64:
    grid = view.rig.grid
    size = np.array(grid.voxel_mm) * grid.shape[::-1]
    half = size[list(plane)] / 2.0
    middle = view.center_mm[list(plane)]
    return np.asarray(middle + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))


def _whole(view: Viewing, plane: tuple[int, int]) -> tuple[F64, F64]:
    """Find the window (2,), (2,) that holds all cameras and the volume."""
    centers = np.array([camera.center_mm for camera in view.rig.cameras])[:, plane]
    points = np.concatenate([centers, _corners(view, plane)])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * (high - low).max()
    return low - margin, high + margin


def _near(view: Viewing, plane: tuple[int, int]) -> tuple[F64, F64]:
    corners = _corners(view, plane)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = _NEAR * (high - low).max()
    return low - margin, high + margin


def _outlines(
    scene: Scene, view: Viewing, plane: tuple[int, int], low: F64, high: F64
) -> Iterator[Outline]:
    yield Outline("volume", _corners(view, plane), closed=True)
    # make points (row, column, 3) of the plane through the volume's middle
    points = np.tile(view.center_mm, (_NODES, _NODES, 1))
    steps = np.linspace(low, high, _NODES)
    points[..., plane[0]] = steps[None, :, 0]
    points[..., plane[1]] = steps[:, None, 1]
    section = points
    cameras = view.rig.cameras
    walls = list(dict.fromkeys(camera.wall for camera in cameras if camera.wall is not None))
    for wall in walls:
        for depth in _faces(wall):
            for line in _contours(wall.depth_of(section) - depth, low, high):
                yield Outline("wall", line)
    if scene.illumination is not None:
        dark = _outside(scene.illumination, section, view.center_mm, walls)
        for line in _borders(dark, low, high):
            yield Outline("sheet", line, closed=True)
    for camera in view.rig.cameras:
        for ray in _rays(camera, view, plane):
            yield Outline("ray", ray)
        # make a camera's triangle (3, 2) with its tip at the pinhole
        length_mm = _CAMERA * (high - low).max()
        tip, forward = (
            np.asarray(axis)[list(plane)] for axis in (camera.center_mm, camera.rotation[2])
        )
        side = np.array([-forward[1], forward[0]])
        back = tip - length_mm * forward
        yield Outline(
            "camera",
            np.array([tip, back + length_mm / 2.0 * side, back - length_mm / 2.0 * side]),
            closed=True,
        )


def _faces(wall: WallRecord) -> list[float]:
    """List the depths of a wall's faces: outer, inner and back wall."""
    behind = wall.depth_mm if isinstance(wall, Wall) else None
    return [0.0, wall.thickness_mm, *([] if behind is None else [wall.thickness_mm + behind])]


def _contours(values: F64, low: F64, high: F64) -> list[F64]:
    """Find the zero lines (n, 2) in mm of the values (row, column) of a window."""
    lines = find_contours(values, 0.0)
    return [low + line[:, ::-1] / (_NODES - 1) * (high - low) for line in lines]


def _borders(values: F64, low: F64, high: F64) -> list[F64]:
    """Find the closed lines (n, 2) in mm around values (row, column) below zero."""
    step = (high - low) / (_NODES - 1)
    padded = np.pad(values, 1, constant_values=np.abs(values).max() + 1.0)
    return [low + (line[:, ::-1] - 1.0) * step for line in find_contours(padded, 0.0)]


def _outside(light: Illumination, points: F64, center_mm: F64, walls: list[WallRecord]) -> F64:
    """Compute how far points (..., 3) are outside the light in the fluid, mm."""
    normal, along = (
        np.asarray(axis) / np.linalg.norm(axis) for axis in (light.sheet_normal, light.direction)
    )
    offset = points - center_mm
    across = np.abs(offset @ normal - (light.shift_mm or 0.0)) - light.thickness_mm / 2.0
    height = np.abs(offset @ np.cross(normal, along)) - light.height_mm / 2.0
    outside = np.maximum(across, height)
    for wall in walls:
        outside = np.maximum(outside, wall.thickness_mm - wall.depth_of(points))
    return np.asarray(outside)


def _rays(camera: Camera, view: Viewing, plane: tuple[int, int]) -> Iterator[F64]:
    """Follow lines of sight (3, 2) of the image's middle and of two of its edges."""
    rotation = np.abs(np.asarray(camera.rotation)[:2, plane[1]])
    column, row = (camera.columns - 1) / 2.0, (camera.rows - 1) / 2.0
    step = np.array([column, 0.0]) if rotation[0] > rotation[1] else np.array([0.0, row])
    pixels = np.array([column, row]) + step * np.array([[-1.0], [0.0], [1.0]])
    rays = camera.back_project(pixels)
    size = np.array(view.rig.grid.voxel_mm) * view.rig.grid.shape[::-1]
    reach = np.linalg.norm(rays.origins_mm - view.center_mm, axis=1) + np.linalg.norm(size) / 2.0
    ends = rays.origins_mm + reach[:, None] * rays.directions
    for origin, end in zip(rays.origins_mm[rays.valid], ends[rays.valid], strict=True):
        yield np.array([camera.center_mm, origin, end])[:, plane]


_NAMES = {
    "sheet": "light",
    "volume": "volume",
    "wall": "faces of the wall",
    "ray": "lines of sight: middle and edges of the images",
    "camera": "cameras",
}

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Plan: {{ title }}</title>
<style>
body { font: 15px/1.45 sans-serif; color: #000; background: #fff; margin: 1.5em auto;
       max-width: 1180px; padding: 0 1em; }
h1 { font-size: 1.35em; } h2 { font-size: 1.1em; margin-top: 1.6em; }
.drawings { display: flex; flex-wrap: wrap; gap: 1.2em; }
figure { margin: 0; } figcaption { font-weight: bold; margin-bottom: 0.3em; }
svg.drawing { max-width: 100%; height: auto; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: 0.15em 0.7em; border-bottom: 1px solid #ddd; }
td.value { text-align: right; font-variant-numeric: tabular-nums; }
code { background: #f3f3f3; padding: 0 0.2em; }
.warnings li { margin: 0.3em 0; }
.legend svg { vertical-align: middle; } .legend span { margin-right: 1.4em; }
{{ style }}
</style>
</head>
<body>
<h1>{{ title }}</h1>
<h2>Warnings</h2>
{% if advice %}
<ul class="warnings">
{% for one in advice %}
<li><code>{{ one.key }}</code>: {{ one.sentence }}</li>
{% endfor %}
</ul>
{% else %}
<p>None.</p>
{% endif %}
<h2>Rig</h2>
<p class="legend">
{% for kind, name in legend %}
<span><svg width="22" height="14">
<rect class="{{ kind }}" x="2" y="2" width="18" height="10"/>
</svg> {{ name }}</span>
{% endfor %}
</p>
<div class="drawings">
{% for name, drawing in drawings %}
<figure><figcaption>{{ name }}</figcaption>
{{ drawing }}
</figure>
{% endfor %}
</div>
{% for section in sections %}
<h2>{{ section.title | capitalize }}</h2>
<table>
<tr><th>figure</th><th>value</th><th>meaning</th><th>equation or source</th></tr>
{% for one in section.quantities %}
<tr><td><code>{{ one.key }}</code></td><td class="value">{{ one.text }}</td>
<td>{{ one.meaning }}</td><td>{{ one.source }}</td></tr>
{% endfor %}
</table>
{% endfor %}
<p>Numbers in brackets are equations of J. Belden, Synthetic Aperture Imaging for Three Dimensional
Resolution of Fluid Flows, MIT.</p>
</body>
</html>
"""


def render_plan(plan: Plan) -> str:
    """Render a plan as a self-contained page."""
    values = {
        "title": plan.scene.title,
        "advice": plan.advice,
        "drawings": [(name, Markup(svg)) for name, svg in draw_rig(plan.scene, plan.viewing)],
        "sections": plan.sections,
        "legend": [(kind, _NAMES[kind]) for kind in reversed(OUTLINE_KINDS)],
        "style": Markup(STYLE),
    }
    return render_page(_PAGE, values)
