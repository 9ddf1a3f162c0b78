"""Rays a second of both ray tracers, next to Mitsuba's integrator `path`.

`python benchmarks/rays.py [--record]` prints JSON and, with --record, writes it to the record of
these machines.

- **particles**: nine cameras of `demo` (50,000 particles behind glass, nine rays a pixel), twice:
  the first image of a process, the median of all others, and the median of a second cloud. `path`
  follows rays through the same interfaces to diffuse balls, under an even sky, for three segments.
- **bubbles**: 2,000 bubbles of `bubbles.py` in one image of 1024 x 1024 pixels, 16 rays a pixel.
  `path` follows as many through the front wall and as many spheres to an emitter of the panel's
  size; it has no rear wall and no lens.

Seconds are CPU seconds. Rays are those of all pixels, also where nothing is traced.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.bubbles import scene_of
from sabench.geometry.camera import Camera
from sabench.scenes import Rig, Scene, build_rig, load_scene
from sabench.simulation import camera_view
from sabench.simulation.camera_view import tank_and_lights
from sabench.simulation.frames import FrameContent, Frames
from sabench.simulation.rendering import particles_traced
from sabench.simulation.rendering.bubble_stage import Stager
from sabench.utils import backend

RECORD = Path(__file__).with_name("records") / "epyc-2-cores-llvm.json"
_REPEATS, _PASSES, _RAYS = 3, 4, 4


def particles(scene: Scene, rig: Rig) -> dict[str, float]:
    """Measure images of two clouds."""
    seconds = [_images(Frames(scene, rig, seed, "mitsuba").at(0)) for seed in (1, 2)]
    rays = rig.cameras[0].rows * rig.cameras[0].columns * scene.render.samples_per_pixel
    usual = float(np.median(seconds[0][1:]))
    return {
        "first_image_s": seconds[0][0],
        "image_s": usual,
        "second_cloud_image_s": float(np.median(seconds[1])),
        "million_rays_per_s": rays / usual / 1e6,
        "path_million_rays_per_s": rays / _path_to_balls(scene, rig) / 1e6,
    }


def _images(frame: FrameContent) -> list[float]:
    return [
        _cpu(partial(camera_view.render_camera_view, frame, k))
        for k in range(len(frame.rig.cameras))
    ]


def _path_to_balls(scene: Scene, rig: Rig) -> float:
    """Measure `path` with the first camera, interfaces, and balls of two voxels' radius."""
    mi, camera = backend.mitsuba(), rig.cameras[0]
    frame = Frames(scene, rig, 1, "mitsuba").at(0)
    assert frame.tracers is not None
    positions = frame.tracers.particles.position_mm
    origin = positions.mean(axis=0)
    radii = np.full(len(positions), 2.0 * scene.grid.voxel_mm[0])
    shapes = particles_traced.interfaces(mi, origin, camera)
    shapes["cloud"] = particles_traced.balls(mi, positions - origin, radii)
    shapes["sky"] = {"type": "constant"}
    return _path_seconds(shapes, camera, origin, 4, scene.render.samples_per_pixel)


def bubbles(scene: Scene) -> dict[str, float]:
    """Measure one image of bubbles."""
    mi, rig = backend.mitsuba(), build_rig(scene)
    from sabench.simulation.rendering import bubble_integrator  # needs the variant

    camera, shown = rig.cameras[4], Frames(scene, rig, 1).at(0).bubbles
    assert shown is not None
    tank, lights = tank_and_lights(scene)
    stager = Stager(camera, tank, shown, (), lights, (), None, None)
    stage, pixels = stager(0.0), np.arange(camera.rows * camera.columns, dtype=np.uint32)
    several = np.repeat(pixels, _PASSES)
    seeds = np.tile(np.arange(_PASSES, dtype=np.uint32), len(pixels))
    given = stage, camera, stager.origin, several, _RAYS, seeds, np.zeros_like(seeds)
    bubble_integrator.radiance(*given)
    own = min(_cpu(lambda: bubble_integrator.radiance(*given)) for _ in range(_REPEATS))
    shapes = particles_traced.interfaces(mi, stager.origin, camera)
    index = {"int_ior": shown.index, "ext_ior": tank.fluid_index}
    shapes["bubble"] = {"type": "dielectric", **index}
    for n, (center, axes) in enumerate(zip(shown.center_mm, shown.semi_axes_mm, strict=True)):
        place = (center - stager.origin).tolist()
        radius, surface = float(axes.mean()), {"type": "ref", "id": "bubble"}
        shapes[f"sphere_{n}"] = {"type": "sphere", "center": place, "radius": radius, "a": surface}
    panel = stage.panel
    assert panel is not None
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1] = panel.edges
    frame[:3, 2] = np.cross(*panel.edges) / np.linalg.norm(np.cross(*panel.edges))
    frame[:3, 3] = panel.center
    facing = frame[:3, 2] @ (np.asarray(camera.center_mm) - stager.origin - panel.center)
    frame[:3, :2] *= 1.0 if facing > 0.0 else [1.0, -1.0]
    frame[:3, 2] *= np.sign(facing)
    place = mi.ScalarTransform4f(frame)
    shapes["panel"] = {"type": "rectangle", "to_world": place, "light": {"type": "area"}}
    path = _path_seconds(shapes, camera, stager.origin, 64, _PASSES * _RAYS)
    rays = len(pixels) * _PASSES * _RAYS / 1e6
    return {"million_rays_per_s": rays / own, "path_million_rays_per_s": rays / path}


def _path_seconds(
    shapes: dict[str, Any], camera: Camera, origin: Any, depth: int, samples: int
) -> float:
    mi = backend.mitsuba()
    eye, forward = np.asarray(camera.center_mm) - origin, np.asarray(camera.rotation[2])
    view = mi.ScalarTransform4f().look_at(
        origin=eye.tolist(),
        target=(eye + forward).tolist(),
        up=(-np.asarray(camera.rotation[1])).tolist(),
    )
    width = np.degrees(2.0 * np.arctan(camera.columns / (2.0 * camera.focal_px)))
    film = {"type": "hdrfilm", "width": camera.columns, "height": camera.rows}
    film |= {"rfilter": {"type": "box"}, "pixel_format": "luminance"}
    sensor = {"type": "perspective", "fov": float(width), "fov_axis": "x", "to_world": view}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth, "rr_depth": depth},
            "sensor": sensor | {"film": film, "near_clip": 1.0, "far_clip": 1e5},
            **shapes,
        }
    )

    def render() -> None:
        np.array(mi.render(scene, spp=samples))

    render()
    return min(_cpu(render) for _ in range(_REPEATS))


def _cpu(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    """Measure both, and print and record them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", action="store_true")
    keep = parser.parse_args().record
    demo = load_scene("demo")
    found = {"particles": particles(demo, build_rig(demo)), "bubbles": bubbles(scene_of(2000))}
    rounded = {
        name: {key: float(f"{value:.3g}") for key, value in one.items()}
        for name, one in found.items()
    }
    print(json.dumps(rounded, indent=1))
    if keep:
        record = json.loads(RECORD.read_text(encoding="utf-8")) | {"rays": rounded}
        RECORD.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
