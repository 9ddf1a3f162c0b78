"""Statistics of a data set, in some dozens of figures.

A bug that the generator and the solvers share may leave scores unchanged; it shows in these
figures.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.dataset.reader import Dataset
from sabench.evaluation.gates.independent_projection import retrace
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F64
from sabench.worlds.bubbles_and_bodies import code_of

_TRACED = 40  # points that are projected a second time


def fingerprint(data: Dataset) -> dict[str, float]:
    """Compute statistics of the truth and of the images, over all frames.

    Figures that do not exist, as for a camera that sees nothing, are left out.

    Returns figures by names like `camera_00.column_mean`. `retraced_px` is the largest distance of
    true pixels from those of a second implementation of refraction (`retrace`), which reads the
    scene's own numbers.
    """
    figures = dict(_truth(data)) | dict(_pictures(data))
    for number, camera in enumerate(data.true_cameras):
        points, pixels = _collect_pixels(data, number)
        figures |= _spread(f"{camera.name}.", ("column", "row"), pixels)
        figures |= dict(_light(data, number))
        again = retrace(data.scene, camera, points[:_TRACED])
        figures[f"{camera.name}.retraced_px"] = float(
            np.nanmax(np.linalg.norm(again - pixels[:_TRACED], axis=1), initial=0.0)
        )
        figures[f"{camera.name}.sightline_mm"] = _beside(camera, points[:_TRACED], pixels[:_TRACED])
        center_mm = np.asarray(data.scene.volume.center_mm)[None]
        nominal = data.setup.cameras[number].project(center_mm)[0]
        figures |= _spread(f"{camera.name}.told_", ("column", "row"), nominal)
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def _beside(camera: Camera, points: F64, pixels: F64) -> float:
    """Compute the largest distance (mm) of points from their own lines of sight.

    The lines of sight start at the true pixels, and cross the wall in the reverse direction.
    """
    rays = camera.back_project(pixels)
    offset = points - rays.origins_mm
    across = offset - np.sum(offset * rays.directions, axis=1, keepdims=True) * rays.directions
    return float(np.max(np.linalg.norm(across, axis=1), initial=0.0))


def _spread(prefix: str, names: Sequence[str], values: F64) -> dict[str, float]:
    """Compute mean and standard deviation of every column of values (n, k).

    Rows with NaN are left out.
    """
    finite = values[np.isfinite(values).all(axis=1)]
    if not len(finite):
        return {}
    both = {"mean": finite.mean(axis=0)} | ({"std": finite.std(axis=0)} if len(finite) > 1 else {})
    return {
        f"{prefix}{name}_{kind}": float(value)
        for kind, values in both.items()
        for name, value in zip(names, values, strict=True)
    }


def _join(parts: Sequence[object], key: str) -> F64:
    """Join an array of all frames."""
    return np.concatenate([getattr(part, key) for part in parts])


def _truth(data: Dataset) -> Iterator[tuple[str, float]]:
    """Compute statistics of true positions, sizes and velocities."""
    frames, axes = range(data.setup.frames), ("x", "y", "z")
    if data.shows_target:
        yield from _spread("target.", axes, data.placed().points_mm.reshape(-1, 3)).items()
        guess_mm = data.calibration_case().initial_mm.reshape(-1, 3)
        yield from _spread("target.told_", axes, guess_mm).items()
        return
    if "particles" in data.shows:
        every = [data.particles(frame) for frame in frames]
        yield "particles.count", float(sum(map(len, every)))
        diameter = _join(every, "diameter_mm")[:, None]
        yield from _spread("particles.", axes, _join(every, "position_mm")).items()
        yield from _spread("particles.velocity_", axes, _join(every, "velocity_mm_s")).items()
        yield from _spread("particles.", ("diameter",), diameter).items()
    if "bubbles" in data.shows:
        balls = [data.bubbles(frame) for frame in frames]
        yield "bubbles.count", float(sum(map(len, balls)))
        yield from _spread("bubbles.", axes, _join(balls, "center_mm")).items()
        yield from _spread("bubbles.axis_", ("0", "1", "2"), _join(balls, "semi_axes_mm")).items()
    if "code" in data.shows:
        code = code_of(data.scene, data.manifest.seed, 0)
        yield from _spread("code.", axes, code.points_mm[code.dark].reshape(-1, 3)).items()


def _collect_pixels(data: Dataset, number: int) -> tuple[F64, F64]:
    """Collect true points (n, 3) of all frames, and their pixels (n, 2) in a camera.

    Points that the camera does not see are left out.
    """
    frames = range(data.setup.frames)
    if data.shows_target:
        points = data.placed().points_mm.reshape(-1, 3)
        pixels = data.sightings()[0][number].reshape(-1, 2)
    elif "particles" in data.shows:
        points = _join([data.particles(frame) for frame in frames], "position_mm")
        views = [data.views(frame)[number] for frame in frames]
        pixels = np.where(_join(views, "visible")[:, None], _join(views, "pixel"), np.nan)
    else:
        points = _join([data.bubbles(frame) for frame in frames], "center_mm")
        camera = data.true_cameras[number]
        pixels = _join([data.sight(frame, camera) for frame in frames], "pixel")
    valid = np.isfinite(pixels).all(axis=1)
    return points[valid], pixels[valid]


def _light(data: Dataset, number: int) -> Iterator[tuple[str, float]]:
    """Compute statistics of light, outlines and detected points in one camera."""
    name, frames = data.true_cameras[number].name, range(data.setup.frames)
    if data.shows_target:
        exact, case = data.sightings()[0][number], data.calibration_case()
        off = (case.pixels[number] - exact).reshape(-1, 2)
        yield from _spread(f"{name}.found_off_", ("column", "row"), off).items()
        yield f"{name}.found", float(case.found[number].sum())
        return
    if "particles" in data.shows:
        views = [data.views(frame)[number] for frame in frames]
        keys = ("photons", "sigma_px")
        light = np.column_stack([_join(views, key) for key in keys])
        yield from _spread(f"{name}.", keys, light).items()
        yield f"{name}.visible", float(sum(view.visible.sum() for view in views))
    if "bubbles" in data.shows:
        sights = [data.sight(frame, data.true_cameras[number]) for frame in frames]
        outlines = np.ptp(_join(sights, "contour").astype(np.float64), axis=1)
        yield from _spread(f"{name}.outline_", ("width", "height"), outlines).items()
        yield f"{name}.outline_seen", float(_join(sights, "visible").mean())
        depth_mm = np.nanmean([np.nanmean(sight.depth_mm) for sight in sights])
        yield f"{name}.surface_depth_mean", float(depth_mm)


def _pictures(data: Dataset) -> Iterator[tuple[str, float]]:
    """Compute statistics of the grey values that solvers receive.

    They are mean, standard deviation and centroid, for the first and the last frame.
    """
    if not any(name.startswith("images/") for name in data.manifest.files):
        return
    for frame in sorted({0, data.setup.frames - 1}):
        for camera, image in zip(data.true_cameras, data.observation(frame).images, strict=True):
            where, grey = f"{camera.name}.frame_{frame}.", image.astype(np.float64)
            yield f"{where}grey_mean", float(grey.mean())
            yield f"{where}grey_std", float(grey.std())
            contrast = np.abs(grey - np.median(grey))
            for axis, name in ((1, "column"), (0, "row")):
                weight = contrast.sum(axis=1 - axis)
                total = max(float(weight.sum()), 1e-300)
                yield f"{where}grey_{name}", float(weight @ np.arange(len(weight)) / total)
