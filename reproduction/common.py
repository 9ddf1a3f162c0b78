"""Common parts of all tables: rows with verdicts, arrays simulated in memory."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sabench.api import Observation, VolumePair
from sabench.api.make import make_algorithm, make_solver
from sabench.evaluation.reproduction import Row
from sabench.evaluation.suite_loading import load_suite, override
from sabench.evaluation.suites import SceneCase
from sabench.geometry.grid import Grid
from sabench.plotting.drawing import Curve, Panel, Picture
from sabench.scenes import Scene
from sabench.scenes.cameras import CameraSpec
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64
from sabench.utils.confidence import mean_of
from sabench.utils.progress import say
from sabench.worlds.advection import advect
from sabench.worlds.tracers import TOLERANCE, require_flow

from .catalogue import UNSTATED

ADEQUATE = 0.75  # the Q that the thesis asks for
AGREES = 0.05  # a measured value this close to the thesis's reproduces it


Better = Literal["larger", "smaller", "neither"]


def make_row(
    name: str,
    thesis: float | None,
    values: Sequence[float],
    note: str = "",
    better: Better = "neither",
) -> Row:
    """Make a row of a value that the thesis may state."""
    mean = mean_of(values)
    if mean is None:
        return Row(name, thesis, None, "not reached", note=note)
    judged = verdict(mean.mean, thesis, better)
    return Row(name, thesis, mean.mean, judged, mean.half_width, mean.count, note)


def verdict(measured: float, thesis: float | None, better: Better = "neither") -> str:
    """Compare a value with the thesis's: equal to within `AGREES`, better or worse.

    `better` says which values are; "neither": the quantity is neither good nor bad.
    """
    if thesis is None:
        return UNSTATED
    if abs(measured - thesis) <= AGREES * abs(thesis):
        return "reproduced"
    if better == "neither":
        return "differs"
    return "exceeds" if (measured > thesis) == (better == "larger") else "below"


def at_least(name: str, thesis: float, values: Sequence[float], note: str = "") -> Row:
    """Make a row of a value with a lower bound in the thesis."""
    row = make_row(name, thesis, values, note)
    reached = row.measured is not None and row.measured >= thesis
    return replace(row, verdict="reproduced" if reached else "below")


def claim(name: str, thesis: str, measured: float | None, holds: bool, note: str = "") -> Row:
    """Make a row of a claim in words, with the figure that decides it."""
    return Row(name, thesis, measured, "reproduced" if holds else "not reproduced", note=note)


def cases(suite: str) -> list[SceneCase]:
    """List the scenes' cases of a suite, once each whatever its seeds are."""
    every = load_suite(suite)[1]
    return list({case.name: case for case in every if isinstance(case, SceneCase)}.values())


def coarsen(scene: Scene, pixels: int | None) -> Scene:
    """Make a coarse copy of a scene, with `pixels` x `pixels` larger pixels.

    The array, the volume and the number of particles per pixel are the same; voxels are larger, of
    the same shape.
    """
    if pixels is None:
        return scene
    factor = scene.cameras.columns / pixels
    values: dict[str, Any] = {
        "cameras.rows": round(scene.cameras.rows / factor),
        "cameras.columns": pixels,
        "cameras.pixel_mm": scene.cameras.pixel_mm * factor,
        "grid.voxel_mm": [edge * factor for edge in scene.grid.voxel_mm],
    }
    tracers = scene.world.tracers
    given = tracers.particles if tracers is not None else {}
    if "per_mm3" in given:
        values["particles.per_mm3"] = density(scene) / factor**2
    if "count" in given:
        values["particles.count"] = round(given["count"] / factor**2)
    if scene.cameras.each:
        values["cameras.each"] = [_coarsen_camera(camera, factor) for camera in scene.cameras.each]
    return override(scene, values, scene.title)


def _coarsen_camera(camera: CameraSpec, factor: float) -> dict[str, Any]:
    """Make a camera's own table for larger pixels."""
    table: dict[str, Any] = camera.model_dump(exclude_none=True)
    if camera.pixel_mm is not None:
        table["pixel_mm"] = camera.pixel_mm * factor
    if camera.principal_point_px is not None:
        table["principal_point_px"] = [(x + 0.5) / factor - 0.5 for x in camera.principal_point_px]
    return table


def density(scene: Scene) -> float:
    """Compute particles per mm3."""
    return float(scene.particle_world.particles["per_mm3"])


def with_density(scene: Scene, per_mm3: float) -> Scene:
    """Change a scene's number of particles per mm3."""
    return override(scene, {"particles.per_mm3": per_mm3}, scene.title)


def per_pixel(scene: Scene) -> float:
    """Compute particles per pixel of one camera (ppp)."""
    return (
        density(scene)
        * float(np.prod(scene.volume.size_mm))
        / (scene.cameras.rows * scene.cameras.columns)
    )


def simulate_frame(scene: Scene, seed: int) -> Shot:
    """Simulate a frame of the scene, and print that."""
    shot = simulate(scene, seed=seed)
    report(f"{scene.title}: {len(shot.particles)} particles, seed {seed}")
    return shot


def report(text: str) -> None:
    """Print a line on the progress to standard error."""
    say(text)


def run(solver: str, problem: Any, **parameters: Any) -> Any:
    """Solve a problem by a solver of its task."""
    algorithm: Any = make_algorithm(solver, parameters)
    return algorithm.solve(problem)


def reconstruct(solver: str, observations: Sequence[Observation], interval_s: float) -> VolumePair:
    """Reconstruct the volumes of two frames."""
    first, other = (make_solver(solver, {}).solve(case).volume for case in observations)
    return VolumePair(first, other, observations[0].grid, interval_s)


def exact_displacements(
    scene: Scene, points_mm: F64, start_s: float, end_s: float, seed: int = 0
) -> F64:
    """Compute exact displacements (n, 3), mm, over an interval.

    They are those of what is at the points in the middle of the interval.
    """
    flow, tolerance = require_flow(scene, seed), TOLERANCE * max(scene.volume.size_mm)
    middle = (start_s + end_s) / 2.0
    after = advect(flow, points_mm, middle, end_s, tolerance)
    return np.asarray(after - advect(flow, points_mm, middle, start_s, tolerance))


def finite_row(name: str, values: Iterable[float]) -> Row:
    """Make a row that the thesis does not state, of the values that exist."""
    return make_row(name, None, [float(value) for value in values if np.isfinite(value)])


def curve_of_means(label: str, x: Sequence[float], draws: Iterable[Iterable[float]]) -> Curve:
    """Draw means and half widths of the finite values at each x, if any."""
    means = [mean_of([value for value in values if np.isfinite(value)]) for values in draws]
    measured = [(place, mean) for place, mean in zip(x, means, strict=True) if mean]
    spread = [mean.half_width or 0.0 for _, mean in measured]
    return Curve(label, [place for place, _ in measured], [m.mean for _, m in measured], spread)


def image_panel(title: str, image: npt.ArrayLike, x: str = "px", y: str = "px") -> Panel:
    """Draw an image over its pixels."""
    shown = np.asarray(image, dtype=np.float64)
    rows, columns = shown.shape
    return Panel(title, x, y, (Picture(shown, (0.0, 0.0), (columns - 1.0, rows - 1.0)),))


def settings(
    solver: str, window: tuple[int, int, int], overlap: float, grid: Grid
) -> dict[str, Any]:
    """Make a PIV solver's parameters with the thesis's windows.

    The first windows of `piv3d` are twice as long, for larger displacements.

    A coarse copy of an array has fewer voxels: windows are then as large as fit, in whole steps.
    """
    fitting = tuple(
        min(edge, 4 * (most // 4)) for edge, most in zip(window, grid.shape[::-1], strict=True)
    )
    same = {"window": fitting, "overlap": overlap}
    return same | ({"first_window": tuple(2 * n for n in fitting)} if solver == "piv3d" else {})
