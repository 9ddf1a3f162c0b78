"""Calibration targets: poses, detected points and prior knowledge."""

import numpy as np

from sabench.api.generators import TargetGenerator
from sabench.api.make import generator_of
from sabench.api.truth import Placed, Prior
from sabench.geometry.camera import Camera
from sabench.scenes import Scene, TargetWorld
from sabench.scenes.build import domain_of
from sabench.scenes.calibration import Detection
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError
from sabench.utils.rng import stream


def pose_target(scene: Scene, seed: int) -> Placed:
    """Put a scene's target at its position in every frame.

    Raises InputError: a scene without a calibration target.
    """
    world = scene.world
    if not isinstance(world, TargetWorld):
        raise InputError(f"{scene.title}: targets: expected a scene with a target, got none")
    maker: TargetGenerator = generator_of(world.target)
    domain, frames = domain_of(scene), scene.frames
    poses = tuple(maker.pose(domain, seed, frame, frames) for frame in range(frames))
    return Placed(maker.target(), poses)


def exact_pixels(camera: Camera, points_mm: F64) -> F64:
    """Project points (frame, point, 3) to pixels (frame, point, 2); NaN outside."""
    pixels, valid = camera.project(points_mm.reshape(-1, 3))
    pixels[~(valid & camera.contains(pixels))] = np.nan
    return pixels.reshape(*points_mm.shape[:2], 2)


def found_pixels(
    detection: Detection | None, exact: F64, seed: int, camera: int
) -> tuple[F64, Bool]:
    """Perturb pixels (frame, point, 2) as detection does; also the outliers.

    Pixels are NaN where a point is missed; outliers are (frame, point).
    """
    if detection is None:
        return exact.copy(), np.zeros(exact.shape[:2], dtype=np.bool_)
    rng = stream(seed, "detection", camera)
    noise, elsewhere = rng.standard_normal(exact.shape), rng.standard_normal(exact.shape)
    chance, half = rng.random((3, *exact.shape[:2])), rng.random((len(exact), 3))
    outliers = np.asarray(chance[0] < detection.outliers)
    far = np.where(outliers[..., None], detection.outlier_px * elsewhere, 0.0)
    pixels = exact + detection.noise_px * noise + far
    pixels[(chance[1] < detection.missing) | _hide_points(detection, exact, half)] = np.nan
    return pixels, outliers & np.isfinite(pixels).all(axis=-1)


def _hide_points(detection: Detection, exact: F64, half: F64) -> Bool:
    """Choose points (frame, point) behind a straight edge across the target.

    `half` are three random numbers per frame.
    """
    hidden = np.zeros(exact.shape[:2], dtype=np.bool_)
    for frame in np.flatnonzero(half[:, 0] < detection.hidden):
        angle = 2.0 * np.pi * half[frame, 1]
        along = exact[frame] @ np.array([np.cos(angle), np.sin(angle)])
        if np.isfinite(along).any():
            low, high = np.nanmin(along), np.nanmax(along)
            hidden[frame] = along > low + (0.25 + 0.5 * half[frame, 2]) * (high - low)
    return hidden


def prior(scene: Scene, placed: Placed, seed: int) -> Prior:
    """Draw the prior knowledge of positions that the scene's table allows.

    Raises InputError: a known point of a frame or number that the target does not have.
    """
    spec, exact = scene.calibration, placed.points_mm
    initial, given, sigma = exact.copy(), np.full_like(exact, np.nan), np.full_like(exact, np.nan)
    if spec is None:
        return Prior(initial, given, sigma)
    error_mm = spec.points * max(scene.volume.size_mm)
    initial += error_mm * stream(seed, "rough points").standard_normal(exact.shape)
    if spec.blank:
        initial[:] = placed.target.points_mm + np.asarray(scene.volume.center_mm)
    rng = stream(seed, "known points")
    for number, point in enumerate(spec.known):
        if point.frame >= exact.shape[0] or point.point >= exact.shape[1]:
            raise InputError(
                f"calibration.known.{number}: expected one of {exact.shape[0]} frames and of "
                f"{exact.shape[1]} points, "
                f"got {point.frame} and {point.point}"
            )
        axes = ["xyz".index(axis) for axis in point.axes]
        drawn = exact[point.frame, point.point] + point.sigma_mm * rng.standard_normal(3)
        given[point.frame, point.point, axes] = drawn[axes]
        sigma[point.frame, point.point, axes] = point.sigma_mm
    return Prior(initial, given, sigma)
