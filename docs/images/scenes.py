"""Draw each bundled scene: one camera's image next to the rig.

Run python docs/images/scenes.py [NAME ...]. Pictures go to scenes/pictures, also in the wheel.
"""

import sys

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from rig import Eye, draw_rig

from sabench import plugins
from sabench.apps.viewer.contents import of_scene
from sabench.apps.viewer.surroundings import Surroundings
from sabench.plotting.pictures import BRIGHTEST, GAMMA, grey_levels
from sabench.scenes import Scene, build_rig, load_scene
from sabench.scenes.world import ParticleWorld
from sabench.simulation.camera_view import record_image, render_camera_view
from sabench.simulation.frames import Frames
from sabench.utils.arrays import F64, U8

_SIDE = 240  # pixels of each half of a picture
_QUALITY = 50  # of webp: below 25 KB
_FROM = np.array([-0.56, -0.36, 0.75])  # direction of the eye: left, above, behind the volume


def draw_image(scene: Scene) -> U8:
    """Render the first image of a camera near the middle, quickly; grey values (_SIDE, _SIDE)."""
    render = scene.render.model_copy(update={"relative_error": 0.1, "samples_per_pixel": 4})
    scene, world = scene.model_copy(update={"render": render}), scene.world
    traced = not isinstance(world, ParticleWorld)
    frames = Frames(scene, build_rig(scene), 1, "mitsuba" if traced else "splat")
    frame = frames.at(0)
    camera = len(frames.rig.cameras) // 2 - bool(scene.occluders)  # not the covered one
    if frame.target is not None and scene.lighting is None:  # points, no images
        lens = frames.rig.cameras[camera]
        pixels, valid = lens.project(frame.pose(frame.target.points_mm))
        return draw_points(pixels[valid] * _SIDE / lens.rows)
    image = record_image(frame, render_camera_view(frame, camera), camera).astype(np.float64)
    light = cut(image - scene.sensor.black_level_dn, min(image.shape) if traced else _SIDE)
    gamma = GAMMA if world.tracers else 1.0
    return grey_levels(light, float(np.percentile(light, BRIGHTEST)), gamma)


def draw_points(places: F64) -> U8:
    """Draw points (n, 2) as dots."""
    sheet = np.zeros((_SIDE, _SIDE), dtype=np.uint8)
    for place in np.rint(places * 16).astype(int).tolist():
        cv2.circle(sheet, place, 24, 255, -1, cv2.LINE_AA, 4)
    return sheet


def cut(image: F64, side: int) -> F64:
    """Cut the middle square of an image, dark beyond its borders, and scale it to _SIDE."""
    image = np.pad(image, [(max(side - size + 1, 0) // 2,) * 2 for size in image.shape])
    top, left = ((size - side) // 2 for size in image.shape)
    square = image[top : top + side, left : left + side]
    method = cv2.INTER_AREA if side > _SIDE else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(square, (_SIDE, _SIDE), interpolation=method))


def draw_space(around: Surroundings) -> U8:
    """Draw a rig (_SIDE, _SIDE, 3), seen from the side and behind the volume."""
    centers = np.array([camera.center_mm for camera in around.cameras])
    points = np.array([*centers, around.low_mm, around.high_mm])
    size = float(np.ptp(points, axis=0).max())
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    sheet = Figure(figsize=(2.4, 2.4), dpi=100)
    axes = sheet.add_axes((0.02, 0.02, 0.96, 0.96))
    draw_rig(axes, Eye(middle + 2.2 * size * _FROM, middle), around, size / 1100.0, 0.5)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.invert_yaxis()
    axes.axis("off")
    canvas = FigureCanvasAgg(sheet)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def main(*names: str) -> None:
    """Draw the named scenes, or all."""
    folder = plugins.bundled_folder("scenes") / "pictures"
    folder.mkdir(exist_ok=True)
    for name in names or plugins.list_scenes():
        scene = load_scene(name)
        light = np.repeat(draw_image(scene)[..., None], 3, axis=2)
        picture = np.hstack([light, draw_space(of_scene(scene, name).surroundings)])
        Image.fromarray(picture).save(folder / f"{name}.webp", quality=_QUALITY, method=6)


if __name__ == "__main__":
    main(*sys.argv[1:])
