"""Common parts of all tables: rows with verdicts, arrays simulated in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sabench.algorithms.refocus import refocus_sum
from sabench.algorithms.refocus.thresholding import auto_k, extract, occupancy
from sabench.api import Observation
from sabench.api.truth import Particles
from sabench.evaluation.suite_loading import load_suite, override
from sabench.evaluation.suites import SceneCase
from sabench.evaluation.thesis.best_threshold import quality_of_k
from sabench.evaluation.thesis.catalogue import UNSTATED
from sabench.evaluation.thesis.published import published_volume
from sabench.geometry.grid import Grid
from sabench.metrics.particle_detection import Counts, count_thesis, detect
from sabench.metrics.synthesised_field import true_field
from sabench.plotting.charts import Figure
from sabench.scenes import Scene
from sabench.scenes.cameras import CameraSpec
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F32, F64
from sabench.utils.confidence import mean_of
from sabench.utils.progress import console

ADEQUATE = 0.75  # the Q that the thesis asks for
AGREES = 0.05  # a measured value this close to the thesis's reproduces it
KS = np.linspace(0.0, 20.0, 401)


@dataclass(frozen=True)
class Row:
    """Row of a table: a value of the thesis and the measured one.

    Attributes
    ----------
    thesis : its value, or its claim in words; None where it says nothing.
    measured : mean over the seeds; None where there is no such value.
    verdict : in words.
    ci95 : half width of the 95 % confidence interval of `measured`; None for a single seed.
    seeds : how many values the mean is of.
    note : what else was seen.
    item : of `TABLES`, that measured it.
    pixels : side of small images of a quick trial; None at full size.
    """

    name: str
    thesis: float | str | None
    measured: float | None
    verdict: str
    ci95: float | None = None
    seeds: int = 0
    note: str = ""
    item: str = ""
    pixels: int | None = None


Item = Row | Figure  # what a table yields
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
    """Judge whether a value is the thesis's to within `AGREES`, else better or worse.

    Parameters
    ----------
    better : which values are; "neither" for a quantity that is neither good nor bad.
    """
    if thesis is None:
        return UNSTATED
    if abs(measured - thesis) <= AGREES * abs(thesis):
        return "reproduced"
    if better == "neither":
        return "differs"
    return "exceeds" if (measured > thesis) == (better == "larger") else "below"


def at_least(name: str, thesis: float, values: Sequence[float], note: str = "") -> Row:
    """Make a row of a value for which the thesis gives a lower bound."""
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
    given = scene.tracers.particles if scene.tracers is not None else {}
    if "per_mm3" in given:
        values["particles.per_mm3"] = density(scene) / factor**2
    if "count" in given:
        values["particles.count"] = round(given["count"] / factor**2)
    if scene.cameras.each:
        values["cameras.each"] = [_coarsen_camera(one, factor) for one in scene.cameras.each]
    return override(scene, values, scene.title)


def _coarsen_camera(one: CameraSpec, factor: float) -> dict[str, Any]:
    """Make a camera's own table for larger pixels."""
    own: dict[str, Any] = one.model_dump(exclude_none=True)
    if one.pixel_mm is not None:
        own["pixel_mm"] = one.pixel_mm * factor
    if one.principal_point_px is not None:
        own["principal_point_px"] = [(x + 0.5) / factor - 0.5 for x in one.principal_point_px]
    return own


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
    console.print(
        f"{scene.title}: {len(shot.particles)} particles, seed {seed}",
        markup=False,
        highlight=False,
    )
    return shot


@dataclass(frozen=True)
class Quality:
    """Quality factor Q of a refocused frame.

    Attributes
    ----------
    best, best_k : at the threshold that makes it largest, as the thesis tunes it with the truth at
        hand.
    blind, blind_k : at the threshold that the images alone suggest.
    """

    best: float
    best_k: float
    blind: float
    blind_k: float


@dataclass(frozen=True)
class Judged:
    """Q of a frame, and its true and ghost particles by the thesis's rule."""

    quality: Quality
    counts: Counts


@dataclass(frozen=True)
class Refocused:
    """Refocused frame without threshold, with the truth in its voxels.

    Attributes
    ----------
    case : the frame with the grid of the volume.
    truths : true particles as fractional voxel indices (n, 3).
    volume, field : what refocusing gave and the E_s that it should become, (z, y, x).
    """

    case: Observation
    truths: F64
    volume: F32
    field: F32

    @classmethod
    def from_shot(cls, shot: Shot, grid: Grid, particles: Particles, volume: F32) -> Refocused:
        """Make one from a volume on its grid and the particles in the grid's space."""
        field = true_field(grid, particles, shot.views)
        return cls(
            replace(shot.observation, grid=grid),
            grid.to_voxels(particles.position_mm),
            volume,
            field,
        )

    def quality(self) -> Quality:
        """Compute Q (equation 2.13) with thresholds subtracted from what exceeds them."""
        values = quality_of_k(self.volume, self.field, KS, "reduced", self.case.grid.scored)
        top, blind = int(values.argmax()), auto_k(self.volume, occupancy(self.case), "reduced")
        return Quality(
            float(values[top]), float(KS[top]), float(np.interp(blind, KS, values)), blind
        )

    def judge(self) -> Judged:
        """Compute Q, and count particles at the threshold with the best Q.

        This is the thesis's procedure. The volume is left thresholded.
        """
        quality, grid = self.quality(), self.case.grid
        found = detect(extract(self.volume, quality.best_k, "reduced"))
        return Judged(
            quality,
            count_thesis(found, self.truths, grid.in_scored(found), grid.in_scored(self.truths)),
        )


def map_shift_average(shot: Shot) -> Refocused:
    """Refocus by the thesis's algorithm of chapter 2, in its own voxels."""
    return Refocused.from_shot(shot, *published_volume(shot))


def additive(shot: Shot) -> Refocused:
    """Refocus additively by equation 3.3 with exact projections.

    Every voxel of the scene's grid is the mean of all cameras.
    """
    seen = shot.observation
    volume = refocus_sum(seen.normalised_images(), seen.cameras, seen.grid)
    volume /= np.float32(len(seen.cameras))
    return Refocused.from_shot(shot, seen.grid, shot.particles, volume)


METHODS: Mapping[str, Callable[[Shot], Refocused]] = {
    "map-shift-average": map_shift_average,
    "additive": additive,
}


_seen: dict[tuple[str, int], Mapping[str, Judged]] = {}


def judge_methods(scene: Scene, seed: int) -> Mapping[str, Judged]:
    """Refocus one frame by each method; cached, because several tables use it."""
    key = scene.hash, seed
    if key not in _seen:
        shot = simulate_frame(scene, seed)
        _seen[key] = {name: method(shot).judge() for name, method in METHODS.items()}
    return _seen[key]


def measure_quality(scene: Scene, seed: int) -> dict[str, Quality]:
    """Compute Q of one frame by each method."""
    return {name: frame.quality for name, frame in judge_methods(scene, seed).items()}


def count_methods(scene: Scene, seed: int) -> dict[str, Counts]:
    """Count true and ghost particles of one frame by each method."""
    return {name: frame.counts for name, frame in judge_methods(scene, seed).items()}


def detection_rows(name: str, found: Sequence[Counts], note: str = "") -> list[Row]:
    """Make rows of true particles and ghosts of several seeds.

    The thesis shows such figures as curves without numbers.
    """
    true = make_row(f"{name}: true %", None, [counts.true_percent for counts in found], note)
    ghosts = [counts.ghost_percent for counts in found]
    return [
        true,
        make_row(f"{name}: ghost %", None, [value for value in ghosts if value is not None], note),
    ]


def settings(
    solver: str, window: tuple[int, int, int], overlap: float, grid: Grid
) -> dict[str, Any]:
    """Make a PIV solver's parameters with the thesis's windows.

    The first windows of `piv3d` are twice as long, for larger displacements.

    A coarse copy of an array has fewer voxels: windows are then as large as fit, in whole steps.
    """
    fitting = tuple(
        min(own, 4 * (there // 4)) for own, there in zip(window, grid.shape[::-1], strict=True)
    )
    same = {"window": fitting, "overlap": overlap}
    return same | ({"first_window": tuple(2 * own for own in fitting)} if solver == "piv3d" else {})
