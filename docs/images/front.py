"""Draw the picture of README from the scene particle-tracking: python docs/images/front.py [FILE].

The rig, an image, a reconstruction against the truth, and trajectories, on a white card that is
read in light and dark mode and on a phone.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image
from rig import INK, RAY, Eye, box, draw_rig

import sabench
from sabench.api import Reconstruction
from sabench.apps.viewer.contents import Frame, of_dataset
from sabench.apps.viewer.points import link_to_earlier
from sabench.apps.viewer.surroundings import Surroundings
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result
from sabench.plotting.kinds import COLOURS, KINDS
from sabench.plotting.pictures import BRIGHTEST, GAMMA, grey_levels

_MARKS = {"found": "o", "missed": "D", "ghost": "X", "duplicate": "^"}
_TEXT = 23.0  # points at 100 dots per inch: 9 pixels on a screen of 390


def draw_labelled(axes: Any, around: Surroundings) -> None:
    """Draw the rig, and its volume enlarged, with words."""
    wall = around.describe()["walls"][0]
    eye = Eye([-165.0, -105.0, 235.0], [10.0, 5.0, -60.0])
    zoom = axes.inset_axes((0.62, 0.33, 0.38, 0.38))
    for place in (axes, zoom):
        draw_rig(place, eye, around)
        place.set_aspect("equal")
    axes.autoscale_view()
    middle, half = eye(around.center_mm) + np.array([0.012, -0.004]), 0.062
    zoom.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] + half, middle[1] - half))
    zoom.set(xticks=[], yticks=[], anchor="W")
    corner, line = (middle[0] - half, middle[1] - half), {"color": INK, "lw": 1.5}
    axes.add_patch(Rectangle(corner, 2.0 * half, 2.0 * half, fill=False, **line))
    arrow = {"arrowprops": line | {"arrowstyle": "-", "shrinkA": 0, "shrinkB": 0}}
    edge = eye([*wall["high"], wall["depths"][-1] / 2.0])
    for start, end in ((middle + np.array([half, -0.5 * half]), (0.62, 0.5)), (edge, (0.36, 0.17))):
        axes.annotate("", start, end, textcoords=axes.transAxes, **arrow)
    style = {"fontsize": _TEXT, "color": INK}
    words = {"cameras": (0.5, 0.92), "water": (0.02, -0.03), "glass": (0.33, 0.09)}
    for word, (x, y) in (words | {"volume": (0.66, 0.335)}).items():
        axes.text(x, y, word, transform=axes.transAxes, **style, zorder=9)


def draw_image(axes: Any, data: Dataset) -> None:
    """Draw the first camera's first image."""
    case = data.observation(0)
    light = case.images[0].astype(np.float32) - np.float32(case.black_dn)
    top = float(np.percentile(light, BRIGHTEST))
    axes.imshow(grey_levels(light, top, GAMMA), cmap="gray", interpolation="nearest", aspect="auto")
    margin = 0.1 * len(light)
    axes.set_ylim(len(light) - margin, margin)


def draw_reconstruction(axes: Any, data: Dataset, result: Path, window: Any) -> None:
    """Draw the brightest voxel along Z in a window (x, y) in mm, and the particles' kinds."""
    opened = open_result(result, data)
    volume, grid = opened.read(Reconstruction).volume, data.setup.grid
    low, high = grid.box_mm
    flat = volume.max(axis=0)
    extent = (low[0], high[0], high[1], low[1])
    shown = grey_levels(flat, float(np.percentile(flat, BRIGHTEST)), GAMMA)
    axes.imshow(shown, cmap="gray", extent=extent, interpolation="bilinear")
    axes.set(xlim=window[0], ylim=window[1][::-1])
    cloud = of_dataset(data, opened).frames[0].particles
    x, y = cloud.position_mm[:, :2].T
    inside = (x > window[0][0]) & (x < window[0][1]) & (y > window[1][0]) & (y < window[1][1])
    for kind, marker in _MARKS.items():
        rows = inside & (cloud.kind == KINDS.index(kind))
        if rows.any():
            style = {"fillstyle": "none", "ms": 17, "mew": 3.5, "ls": "", "color": COLOURS[kind]}
            axes.plot(x[rows], y[rows], marker=marker, label=f"{kind} {rows.sum()}", **style)
    place = {"loc": "upper left", "bbox_to_anchor": (-0.03, 0.0), "borderpad": 0.2}
    style = {"handletextpad": 0.0, "columnspacing": 0.5, "fontsize": _TEXT, "frameon": False}
    axes.legend(ncols=len(_MARKS), **place, **style)


def draw_trajectories(axes: Any, frames: tuple[Frame, ...], around: Surroundings) -> Any:
    """Draw the found trajectories over all frames in the volume, coloured by speed."""
    middle = around.center_mm
    eye = Eye([*(middle + np.array([-14.0, -13.0, -24.0]))], [*middle])
    box(axes, eye, around.low_mm, around.high_mm, fc="none", ec=RAY, lw=1.2)
    every = [frame.particles for frame in frames]
    clouds = [cloud.select(cloud.kind == KINDS.index("found")) for cloud in every]
    lines, speeds = [], []
    for cloud, earlier in zip(clouds[1:], clouds, strict=False):
        rows = link_to_earlier(cloud, earlier)
        now = np.flatnonzero(rows >= 0)
        ends = earlier.position_mm[rows[now]], cloud.position_mm[now]
        lines.append(eye(np.stack(ends, axis=1)))
        speeds.append(np.linalg.norm(cloud.velocity_mm_s[now], axis=1))
    values = np.concatenate(speeds)
    shown = LineCollection(np.concatenate(lines), cmap="viridis", lw=2.6, capstyle="round")
    shown.set_array(values)
    shown.set_clim(0.0, float(np.percentile(values, 98.0)))
    axes.add_collection(shown)
    return shown


def main(file: str = str(Path(__file__).with_name("front.png"))) -> None:
    """Generate, solve and draw."""
    matplotlib.rcParams["font.family"] = "DejaVu Sans"
    sheet = Figure(figsize=(14.0, 12.4), dpi=100)
    frame = {"fill": False, "ec": "#d5dae0", "lw": 3.0, "transform": sheet.transFigure}
    sheet.add_artist(Rectangle((0.0, 0.0), 1.0, 1.0, **frame))
    places = [(0.02, 0.54), (0.52, 0.54), (0.02, 0.075), (0.52, 0.075)]
    titles = (
        "1  rig",
        "2  what a camera records",
        "3  reconstruction, scored",
        "4  trajectories, mm/s",
    )
    panels: list[Any] = []
    for (x, y), title in zip(places, titles, strict=True):
        panels.append(sheet.add_axes((x, y, 0.46, 0.41), anchor="NW"))
        panels[-1].set_title(title, fontsize=_TEXT, color=INK, loc="left", weight="bold", pad=8)
        panels[-1].set(xticks=[], yticks=[])
    with tempfile.TemporaryDirectory() as folder:
        data = sabench.generate("particle-tracking", Path(folder, "data"), seed=1)
        for solver, own in (("msa", {"k": 1.5}), ("shake_the_box", {})):
            sabench.solve(solver, data, Path(folder, f"{solver}.h5"), parameters=own)
        contents = of_dataset(data, open_result(Path(folder, "shake_the_box.h5"), data))
        draw_labelled(panels[0], contents.surroundings)
        draw_image(panels[1], data)
        draw_reconstruction(panels[2], data, Path(folder, "msa.h5"), ((-2.8, 1.4), (-1.8, 1.52)))
        speeds = draw_trajectories(panels[3], contents.frames, contents.surroundings)
    for panel in (panels[0], panels[3]):
        panel.set_aspect("equal")
        panel.autoscale_view()
        panel.invert_yaxis()
        panel.axis("off")
    place = sheet.add_axes((0.53, 0.058, 0.41, 0.02))
    bar = sheet.colorbar(speeds, cax=place, orientation="horizontal")
    bar.ax.tick_params(labelsize=_TEXT - 3)
    canvas = FigureCanvasAgg(sheet)
    canvas.draw()
    card = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    card.quantize(256, dither=Image.Dither.NONE).save(file, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
