"""Mitsuba renderer of calibration targets under lamps."""

from typing import Any

import numpy as np

from sabench.api.truth import Target
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import transmittance
from sabench.geometry.rigid_motion import Pose
from sabench.scenes.illumination import Lighting
from sabench.simulation.rendering.lamps import facing_of, place_lamps
from sabench.simulation.rendering.particle_images import diffract
from sabench.simulation.rendering.particles_traced import interfaces
from sabench.utils import backend
from sabench.utils.arrays import F64, Bool

_CELLS = 6  # of a ChArUco marker and its black frame, along each side
_QUIET = 0.75  # white around a board's pattern, in pitches


def render(
    camera: Camera, target: Target, pose: Pose, lighting: Lighting, center_mm: F64, samples: int
) -> F64:
    """Render relative photons (rows, columns) of a target.

    They are relative to those that saturate a pixel at `lighting.exposure` 1.

    Parameters
    ----------
    center_mm : where a white surface that faces the cameras gives the exposure asked for.
    samples : rays per pixel.
    """
    mi = backend.mitsuba()
    from sabench.simulation.rendering import target_integrator  # needs the variant

    origin = pose.position_mm
    scene = mi.load_dict(
        {"type": "scene", **interfaces(mi, origin, camera), **_shapes(mi, target, pose)}
    )
    more = 0 if target.pattern in ("circles", "wand") else 1
    squares = target.columns + more, target.rows + more
    sizes = target.pitch_mm, target.mark_mm
    paint = target_integrator.Paint(
        target.pattern, squares, *sizes, marker_bits(target), pose.rotation.T
    )
    lamps = place_lamps(lighting, camera, center_mm, origin)
    planes = len(camera.wall.layers) + 1 if camera.wall else 0
    radiance = target_integrator.integrate_target(
        scene, camera, origin, paint, lamps, planes, samples
    ).astype(np.float64)
    if camera.wall is not None:  # the exposure asked for is that seen through the wall
        facing, pinhole = facing_of(camera), np.asarray(camera.center_mm)
        passed = float(transmittance(camera.wall, pinhole, facing[None])[0])
        radiance /= passed * (camera.wall.air_index / camera.wall.fluid_index) ** 2
    photons = radiance * camera.etendue() / camera.etendue().max()
    return diffract(camera, photons, lighting.wavelength_nm)


def marker_bits(target: Target) -> Bool:
    """Return white cells (marker, cell) of a ChArUco board's markers.

    Markers are in the order of the white squares; there are none for other targets.
    """
    if target.pattern != "charuco":
        return np.zeros((0, _CELLS * _CELLS), dtype=np.bool_)
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    count = (target.columns + 1) * (target.rows + 1) // 2
    markers = [cv2.aruco.generateImageMarker(dictionary, n, _CELLS) for n in range(count)]
    return np.stack([marker.ravel() > 0 for marker in markers])


def _shapes(mi: Any, target: Target, pose: Pose) -> dict[str, Any]:
    """Describe a board as a rectangle with a white margin, a wand as balls."""
    matte = {"type": "diffuse"}
    if target.pattern == "wand":
        balls = pose(target.points_mm) - pose.position_mm
        return {
            f"ball_{i}": {
                "type": "sphere",
                "center": ball.tolist(),
                "radius": target.mark_mm / 2.0,
                "bsdf": matte,
            }
            for i, ball in enumerate(balls)
        }
    width, height = (
        (count + 1) / 2.0 * target.pitch_mm + _QUIET * target.pitch_mm
        for count in (target.columns, target.rows)
    )
    frame = np.eye(4)
    frame[:3, :3] = pose.rotation * [width, height, 1.0]
    return {"board": {"type": "rectangle", "to_world": mi.ScalarTransform4f(frame), "bsdf": matte}}
